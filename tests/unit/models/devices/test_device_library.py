"""The package's devices: at rest, the same in C as in Python, out to a DYR record and back."""

from __future__ import annotations

import ctypes
from pathlib import Path

import numpy as np
import pytest
from plant_shim import compile_shared

from interarea.models.devices.c_expression import parameter_rows
from interarea.models.devices.dyr import device_for_dyr, dyr_fields, dyr_models
from interarea.models.devices.emit import devices_header
from interarea.models.devices.instance import Instance
from interarea.models.devices.language.device import FBASE, KINDS, MBASE
from interarea.models.devices.library import device_model, library
from interarea.models.devices.rest import rest_of
from interarea.models.devices.rows import row_of
from interarea.models.errors import DeviceError

PLANT = Path(__import__("interarea.models").models.__file__).parent / "c" / "plant" / "flow"
#: one operating point of a machine; the phasors fit vt, and pe = vd id + vq iq
SEEN = {"vt": 1.0, "vd": 0.6, "vq": 0.8, "id": 0.7, "iq": 0.5, "pe": 0.82, "slip": 0.0, "ifd": 1.9}
SEEN |= {"vc": 1.0, "vs": 0.0, "pm": 0.82, "p": 0.4, "q": 0.1, "p_mod": 0.0, "q_mod": 0.0}
SEEN |= {"q_mod1": 0.0, "q_mod2": 0.0}
SEEN |= {
    "vdr": 1.04,
    "vdi": 1.0,
    "vr": 0.8,
    "vi": 0.6,
    "ir": 0.38,
    "ii": 0.16,
    "v1": 1.0,
    "p1": -0.5,
    "v2": 1.0,
    "p2": 0.5,
    "vreg": 1.0,
    "vdrop": 1.0,
    "pbr": 0.4,
    "qbr": 0.1,
}
OUTPUT = {
    "exciter": 1.8,
    "governor": 0.82,
    "svc": 0.1,
    "statcom": 0.1,
    "converter": 0.4,
    "hvdc": 1.0,
    "source": 0.7,
    "vsc": -0.5,
}

#: fields of a typical record; public data and the examples of the standards
RECORDS = {
    "REGCA1": "1 0.02 10 0.9 0.4 1.22 1.2 0.8 0.4 -1.3 0.02 0.7 99 -99 0.7",
    "REGCB1": "1 0 0.02 0.02 99 -99 10 0.01 1.3",
    "WTDTA1": "5 0.5 0.8 1.5 1.2",
    "WTARA1": "0.007 3",
    "WTPTA1": "25 150 30 3 0.1 0.3 27 -1 10 -10",
    "WTTQA1": "1 0.5 2.5 0.066667 60 1.1 0 0.2 0.58 0.4 0.72 0.72 0.866 0.86 1 50",
    "REGCC1": "1 0 0.02 0.02 99 -99 10 0.01 1.3 0.5 20 30 300 12 -12",
    "REECB1": "0 0 1 1 0 0.85 1.2 0.02 -0.05 0.05 1 1.1 -1.1 1 0.05 0.44 -0.44 1.1 0.9 0 0.1 1 40 0.02 "
    "9 -9 1 0 1.1 0.02",
    "REECA1": "0 0 1 1 0 0 0.85 1.2 0.02 -0.05 0.05 1 1.1 -1.1 1 0.2 -0.1 0.3 0.05 0.44 -0.44 1.1 0.9 0 "
    "0.1 1 40 0.05 0.02 9 -9 1 0 1.1 0.02 0.1 0.5 0.6 1 1 1.2 0 0 0.2 0.1 0.5 0.4 0.8 1 0 0",
    "REECC1": "0 0 1 1 0 0.85 1.2 0.02 -0.05 0.05 1 1.1 -1.1 1 0.05 0.44 -0.44 1.1 0.9 0 0.1 1 40 "
    "0.02 9 -9 1 -1 1.1 0.02 0.1 0.5 0.6 1 1 1.2 0 0 0.2 0.1 0.5 0.4 0.8 1 0 0 7200 0.6 0.9 0.1",
    "REPCA1": "0 0 0 0 0 0 1 0.02 18 5 0 0.05 0.7 0 0 0.02 0.1 -0.1 -0.01 0.01 0.43 -0.43 1 0.05 0.25 "
    "-0.0006 0.0006 9 -9 1 0 0.1 20 5",
    "REGFMA1": "1 1 0.01 0.01 0.01 2 1.15 0 0.9 0 0.44 -0.44 0.01 0.05 0.01 0.1 3 20 0 5.86",
    "REGFMB1": "0 0 1 1 1 1 0.05 0.1 5 0.02 0.05 -0.05 0.265 2.65 0.2 -0.2 "
    "0.02 0.5 1 100 50 1 0.9 2 1.5 0.02 0.02 0.01 0.01 1 0.05",
    "GDFORM": "0.05 0 5.86 0.01 0.01 0.1 1 0 1.2 0 0.01 2 1 -1 3 20 0.01 0.01 1",
    "DERA1": "1 1 0 1 1 1 0.02 0.05 -0.05 0.05 2 0 0.02 0.02 20 5 -0.0006 0.0006 0.1 -0.1 1.1 0 0.5 -0.5 "
    "0.02 0.1 10 1.2 0.44 0.49 1.2 1.15 0.16 0.2 0.16 0.3 0.7 59.3 60.5 0.16 0.2 0.02 2 0.02 0.8 1 -1",
    "CSVGN1": "0 20 0 1 0.15 1 0.005 0 1 0 60",
    "SEXS": "0.1 10 100 0.05 -5 5",
    "SCRX": "0.1 10 100 0.05 -5 5 0 10",
    "IEEET1": "0.02 40 0.05 5 -5 1 0.5 0.06 1 0 2.85 0.3 3.8 0.6",
    "IEEEX1": "0.02 40 0.05 2 1 0 -5 0 0.5 0.06 1 0 2.85 0.3 3.8 0.6",
    "ESDC1A": "0.02 40 0.05 0 0 5 -5 1 0.5 0.06 1 0 2.85 0.3 3.8 0.6",
    "EXDC1": "0 40 0 2 1 5 -5 0 0.5 0.06 1 0 2.85 0.3 3.8 0.6",
    "ESDC2A": "0.02 40 0.05 2 1 5 -5 1 0.5 0.06 1 0 2.85 0.3 3.8 0.6",
    "EXDC2": "0.02 40 0.05 0 0 5 -5 1 0.5 0 1 0 2.85 0.3 3.8 0.6",
    "IEEET2": "0.02 40 0.05 5 -5 1 0.5 0.06 1 0.5 2.85 0.3 3.8 0.6",
    "EXAC1": "0.01 10 1 200 0.02 8 -8 0.8 0.03 1 0.2 0.38 1 3.14 0.03 4.18 0.1",
    "ESAC1A": "0.01 0.2 0.1 200 0.02 10 -10 0.8 0.03 1 0.2 0.38 1 3.14 0.03 4.18 0.1 8 -8",
    "EXAC2": "0.01 0 0 300 0.01 8 -8 25 100 -100 0.6 10 1 0.03 1 0.28 0.35 1 4.4 3.3 0.01 4.4 0.04",
    "ESAC2A": "0.01 0 0 300 0.01 8 -8 25 100 -100 0.6 4.4 1 0.03 1 0.28 0.35 1 3.3 0.01 4.4 0.04",
    "ESAC6A": "0.02 500 0.1 0.02 9 3 75 -75 44 -36 1 19 0.08 75 0.02 0.02 0.17 1.9 1.6 5.5 0.2 7.4 0.04",
    "ESAC8B": "0.02 80 5 10 0.1 1 0 35 -35 1.2 1 6.5 0.3 9 3",
    "AC8B": "0.02 80 5 10 0.1 35 -35 1 0.01 35 -35 0.55 1.1 1 1.2 8 0 6.5 0.3 9 3",
    "DC4B": "0 0 0.02 20 20 20 0.01 2.7 -0.9 2 0.2 1 0.8 0.1 1 0 1.75 0.08 2.33 0.27",
    "EXST1": "0.02 9 -9 1 10 200 0.02 6 -6 0.05 0.01 1",
    "EXAC4": "0.02 9 -9 1 10 200 0.02 6 -6 0.05",
    "ESST1A": "1 1 0.02 9 -9 1 10 0.1 0.2 200 0.02 8 -8 6 -6 0.05 0.01 1 4 4.4",
    "ESST2A": "0.02 120 0.15 1 0 1 0.5 0.02 0.56 4.88 8 1.82 5",
    "ESST3A": "0.02 0.2 -0.2 8 6 1 200 0.02 10 -10 1 4.4 4.83 8.6 1.1 0.09 5.8 20 0.4 1 0",
    "ESST4B": "0.02 10 10 1 -0.87 0.02 1 0.2 1 -0.87 0.1 6.7 0.1 8.4 0.1 0.1 10",
    "ST6B": "1 0.012 18 45 0.3 0.01 4.81 -3.85 1 1 1.1 17.3 4.16 4.81 -3.85 1 0.02",
    "ST8C": "0 0 0 0 0.02 8 4 4.5 -1 3 0.5 1.1 -0.9 6 0.01 6 -5 0.9 0.01 0.1 1.2 0.1 0.05 10 8 0.05 0.3 2",
    "EXPIC1": "0.02 4 0.2 1 -0.9 0.1 0.2 0.05 1.2 -0.9 0.02 1 0.1 6.5 -6.5 1 0.3 0 0 0 0 5.5 1 0.08",
    "TGOV1": "0.05 0.5 1.2 0 3 10 0.1",
    "GAST": "0.05 0.4 0.1 3 1 2 1.1 -0.05 0.1",
    "HYGOV": "0.05 0.4 6 0.05 0.5 0.2 1 0 1.3 1.2 0.5 0.08",
    "IEEEG1": "0 0 20 0.2 0.1 0.1 0.3 -0.5 1 0 0.25 0.3 0 5 0.4 0 0.4 0.3 0 0.3 0 0",
    "IEEEG2": "20 10 3 0.5 1 0 1.5",
    "GGOV1": "1 1 0.04 1 0.05 -0.05 10 2 0.1 1 1 0.15 0.5 1.5 0.2 0.1 0 0 3 2 0.67 1 0 0.1 -0.1 "
    "0.001 0.01 10 0.1 0 0.0005 4 5 99 -99",
    "IEEEG3": "0.4 0.04 0.2 -0.2 1 0 0.05 0.4 5 1.5 0.5 1 1.5 1",
    "IEESGO": "0.2 0.1 0.1 0.3 7 0.4 20 0.7 0.5 1.1 0",
    "DEGOV": "0.01 0.02 0.2 10 0.25 0.01 0.04 0.02 1.1 0",
    "DEGOV1": "1 0.01 0.02 0.2 10 0.25 0.01 0.04 0.02 1.1 0 0.05 0.1",
    "PIDGOV": "0 0.05 0.3 2 0.5 0.3 0.05 0.1 0.5 0.1 0.5 0.4 0.8 0.85 1 1 0 1 1.2 0.2 -0.2",
    "WPIDHY": "0.3 -0.05 2 0.5 0.3 0.05 0.1 0.2 -0.2 1 0 1.2 1.1 0 0.5 0.1 0.5 0.4 0.8 0.85 1",
    "IEEEST": "3 0 0.06 0.02 0.1 0.003 0.05 0.001 0.2 0.02 0.1 0.03 5 10 3 0.1 -0.1 1.2 0.8",
    "STAB2A": "1 2 0.25 2 0.55 1 0.01 0.03",
    "STAB1": "2 5 3 0.05 2 0.04 0.1",
    "PSS2A": "1 0 3 0 5 1 2 3 0.1 2 0 2 0.3 1 0.5 0.1 10 0.2 0.02 0.3 0.03 0.1 -0.1",
    "PSS2B": "1 0 3 0 2 4 2 3 0.1 2 0 2 0.3 1 0.5 0.1 10 0.2 0.02 0.3 0.03 0.1 0.02 2 -2 2 -2 0.1 -0.1",
    "PSS2C": "1 0 3 0 2 4 2 3 0.1 2 0 2 0.3 1 0.5 0.1 10 0.2 0.02 0.3 0.03 0.1 0.02 2 -2 2 -2 0.1 -0.1 "
    "0.05 0.01 0.2 0.1 0 0",
    "PSSSIM": "0 34 30 5 6 7 8 100 20 0.06 0.04 0.08 0.04 1 0",
    "ST2CUT": "1 0 3 0 1 0.1 0.01 0.02 3 3 0.2 0.02 0.3 0.03 0.1 0.02 0.1 -0.1 0 0",
    "IEE2ST": "1 0 4 0 1 0.1 0 0 3 3 0.2 0.02 0 0 0 0 0.1 -0.1 1.2 0.8",
    "IEEEVC": "0.01 0.05",
    "COMP": "0.05",
    "MAXEX2": "1 2.5 1.1 120 1.2 40 1.5 15 1 0.002 -0.05",
    "WSIEG1": "0 0 20 0.2 0.1 0.1 0.3 -0.5 1 0 0.25 0.3 0 5 0.4 0 0.4 0.3 0 0.3 0 0 0.0006 0.0002 0.01 "
    "0 0 0.3 0.4 0.6 0.8 0.8 0.95 1 1.02 0",
}
OWN = {
    "svc": {"K": 10.0, "TR": 0.05, "TC": 0.65, "TB": 0.2},
    "csvgn1": {"K": 20.0, "T2": 0.5, "T4": 1.0, "CBASE": 60.0},
    "statcom": {"KR": 50.0},
    "tcsc": {"T": 0.02},
    "lcc": {"R": 0.04, "L": 0.01},
    "vsc": {"KEEPV1": 1.0, "PFIRST2": 0.0},
    "static": {"KA": 200.0, "TA": 0.02, "TR": 0.01, "Efd_min": -4.0, "Efd_max": 4.0},
    "static_tgr": {"KA": 200.0, "TA": 0.02, "TR": 0.01, "TC": 1.0, "TB": 10.0},
    "st1a": {"KA": 200.0, "TA": 0.02, "TR": 0.01, "TC": 1.0, "TB": 10.0, "VRmin": -4, "VRmax": 4, "KC": 0.1},
    "dc1": {"KA": 20.0, "TA": 0.05, "TR": 0.05, "TE": 0.36, "KF": 0.12, "TF": 1.8, "Aex": 0.005, "Bex": 1.0},
    "speed": {"K": 20.0, "Tw": 10.0, "T1": 0.05, "T2": 0.02, "T3": 3, "T4": 5.4, "Vs_min": -1, "Vs_max": 1},
    "steam": {"Rp": 0.05, "Tsr": 0.1, "Tsm": 0.2, "vg_min": -0.1, "vg_max": 0.1}
    | {"T5": 0.3, "T4": 7.0, "F5": 0.3, "F4": 0.7},
}  # fmt: skip


class Record:
    """A record as a DYR reader gives it."""

    def __init__(self, model: str, text: str) -> None:
        self.model, self.bus, self.where = model, 1, "test.dyr:1"
        self.fields = text.split()


def typical():
    for model, text in RECORDS.items():
        result = device_for_dyr(Record(model, text))
        yield model, result.model, dict(result.parameters)
    for key, values in OWN.items():
        yield key, library()[key], values


TYPICAL = {name: (model, settings) for name, model, settings in typical()}


def complete(model, settings):
    return {p.name: settings.get(p.name, p.default) for p in model.device.parameters} | {
        MBASE: 100.0,
        FBASE: 60.0,
    }


def model_xe(model):
    return next(p.default for p in model.device.parameters if p.name == "Xe")


def at_rest(name):
    model, values = TYPICAL[name]
    kind = model.device.kind
    inputs = {key: SEEN[key] for key in KINDS[kind].inputs}
    behind = 1.0 / model_xe(model) if values.get("REGCB") == 1.0 else 0.0  # its states are E/(jXe)
    inputs |= {"iq": SEEN["q"] + behind} if kind == "converter" else {}
    inputs |= {"iord": 1.0, "xr": 0.3, "xi": 0.3} if kind == "hvdc" else {}
    inputs |= {"e": 1.05, "theta": np.arctan2(0.6, 0.8)} if kind == "source" else {}
    inputs |= {"iq1": 0.1, "ip2": 0.5, "iq2": 0.1} if kind == "vsc" else {}
    output = OUTPUT.get(kind) if model.device.references else None
    return rest_of(model, complete(model, values), inputs, output, name), inputs


def off_rest(name, seed):
    """Instance, states and inputs, ever further from rest: as many as leave some over in every tile."""
    point, inputs = at_rest(name)
    n, rng = len(point.states), np.random.default_rng(seed)
    xs = [np.array(point.states) + s * rng.standard_normal(n) for s in np.geomspace(1e-3, 3.0, 13)]
    seen = [{k: v + 0.3 * rng.standard_normal() for k, v in inputs.items()} for _ in xs]
    return point.instance, xs, seen


def test_every_device_has_a_typical_record():
    assert {model.device.key for model, _ in TYPICAL.values()} == set(library())
    assert set(RECORDS) == set(dyr_models())


def test_a_device_is_looked_up_by_the_name_of_its_file():
    assert all(model.device.key == key for key, model in library().items())
    for name in ("../exciters/sexs", "SEXS.toml", ""):
        with pytest.raises(DeviceError, match="does not exist"):
            device_model(name, "exciter", {})


@pytest.mark.parametrize("name", TYPICAL)
def test_rest_stands_still_and_gives_the_output(name):
    point, inputs = at_rest(name)
    values, rates = point.instance.run(point.states, inputs)
    device = point.instance.model.device
    assert np.abs(rates).max(initial=0.0) <= 1e-9
    if device.references:
        assert values[device.output] == pytest.approx(OUTPUT[device.kind], rel=1e-12)
    assert values[device.output] == pytest.approx(point.output, rel=1e-12, abs=1e-15)


@pytest.mark.parametrize("name", RECORDS)
def test_a_record_goes_in_and_out(name):
    model, values = TYPICAL[name]
    if model.device.kind == "converter":
        pytest.skip("several records make up one")
    out, fields = dyr_fields(model, complete(model, values))
    row = dyr_models()[name][1]
    filled = [k for k, field in enumerate(row.fields) if field != "-"]
    if out == name:
        assert [fields[k] for k in filled] == [float(RECORDS[name].split()[k]) for k in filled]
    again = device_for_dyr(Record(out, " ".join(map(repr, fields))))
    assert complete(model, dict(again.parameters)) == complete(model, values)


DRIVER = """
#include "devices.h"
#include "processor.h"
#include "tiles.h"
void drive(size_t device, size_t n, uint64_t has, size_t lanes, double *table, const double *machine,
           const DeviceSignals *in, const double *x, double *dx);
void drive(size_t device, size_t n, uint64_t has, size_t lanes, double *table, const double *machine,
           const DeviceSignals *in, const double *x, double *dx)
{
    const DeviceGroup group = { table, machine, n, has, NO_NOTES };
    device_prepare(device, table, n);
    TILED(device_run, lanes, n, device, &group, in, x, dx);
}
/* The decisions at x into words, or at x whether they are others. */
int note(size_t device, size_t n, uint64_t has, size_t lanes, double *table, const double *machine,
         const DeviceSignals *in, const double *x, double *dx, double *words, int watch);
int note(size_t device, size_t n, uint64_t has, size_t lanes, double *table, const double *machine,
         const DeviceSignals *in, const double *x, double *dx, double *words, int watch)
{
    double switched = 0.0;
    const Notes notes = { words, watch ? &switched : NULL, NULL, NULL, NULL, 0, n, 0 };
    const DeviceGroup group = { table, machine, n, has, notes };
    TILED(device_run, lanes, n, device, &group, in, x, dx);
    return switched > 0.0;
}
size_t rows_of(size_t device);
size_t rows_of(size_t device) { return device_rows(device); }
size_t lanes_of_this_machine(void);
size_t lanes_of_this_machine(void) { return processor_lanes(); }
"""
HELD = """
#define PLANT_HELD
#define NAME(f) f##_held
#include "devices.h"
double hold(size_t device, size_t n, uint64_t has, double *table, const double *machine,
            const DeviceSignals *in, const double *x, double *dx, double *words, double *onto);
double hold(size_t device, size_t n, uint64_t has, double *table, const double *machine,
            const DeviceSignals *in, const double *x, double *dx, double *words, double *onto)
{
    double worst = -INFINITY;
    const DeviceGroup group = { table, machine, n, has, { words, NULL, &worst, onto, NULL, 0, n, 0 } };
    device_run(device, &group, in, x, dx);
    return worst;
}
"""
#: members of DeviceSignals, in the order of elements.h
MEMBERS = (
    *("vt", "vd", "vq", "id", "iq", "pe", "slip", "ifd", "pref_step", "vc", "vs", "pm", "efd", "vl"),
    *("b", "i", "ip", "idc", "delta", "ip1", "p", "q", "p_mod", "q_mod", "vdr", "vdi"),
    *("vr", "vi", "v1", "p1", "v2", "p2", "ir", "ii", "vreg", "vdrop", "pbr", "qbr", "q_mod1", "q_mod2"),
)


class Driver:
    """Runs the generated C of some devices."""

    def __init__(self, models, folder: Path) -> None:
        self.models = list(models)
        source = folder / "driver.c"
        source.write_text(DRIVER)
        held = folder / "held.c"
        held.write_text(HELD)
        header = folder / "devices.h"
        header.write_text(devices_header(self.models))
        flags = ("-std=c99", "-O0", "-ffp-contract=off", "-Wall", "-Wextra", "-Wpedantic", "-Wconversion")
        tiles = (PLANT / "tile_4.c", PLANT / "tile_8.c")
        path = compile_shared((source, held, header, *tiles), (*flags, "-Werror", f"-I{PLANT}"))
        self.c = ctypes.CDLL(str(path))
        self.c.rows_of.restype = self.c.lanes_of_this_machine.restype = ctypes.c_size_t
        self.c.hold.restype = ctypes.c_double
        self.words = np.zeros(64)

    def run(self, model, instances, xs, inputs, lanes=0, mode="drive"):
        """Rates and outputs of devices of one structure next to each other, `lanes` at a time.

        mode : "note" and "watch" their decisions, `self.measured` whether they are others; "hold" them,
            `self.measured` by how much the one that fits least is overrun, `self.onto` held states on limits
        """
        device, n = self.models.index(model), len(instances)
        table = np.zeros((self.c.rows_of(ctypes.c_size_t(device)), n))
        for k, instance in enumerate(instances):
            parameters = [instance.values[row] for row in parameter_rows(model)]
            table[: len(parameters), k] = parameters
        x = np.ascontiguousarray(np.array(xs).T)
        dx = np.zeros_like(x)
        signals = {key: np.array([seen.get(key, 0.0) for seen in inputs], dtype=float) for key in MEMBERS}
        pointers = (ctypes.c_void_p * len(MEMBERS))(*(signals[key].ctypes.data for key in MEMBERS))
        where = np.arange(n, dtype=float)
        first = [ctypes.c_size_t(device), ctypes.c_size_t(n), ctypes.c_uint64(instances[0].has)]
        wide = [ctypes.c_size_t(lanes)]
        arrays = [a.ctypes.data_as(ctypes.c_void_p) for a in (table, where)] + [pointers]
        arrays += [a.ctypes.data_as(ctypes.c_void_p) for a in (x, dx)]
        self.c.drive(*first, *wide, *arrays)
        words, self.onto = self.words.ctypes.data_as(ctypes.c_void_p), x.copy()
        if mode in ("note", "watch"):
            self.measured = self.c.note(*first, *wide, *arrays, words, ctypes.c_int(mode == "watch"))
        elif mode == "hold":
            onto = self.onto.ctypes.data_as(ctypes.c_void_p)
            dx[:], signals[model.device.output][:] = np.nan, 0.0
            self.measured = self.c.hold(*first, *arrays, words, onto)
        return dx.T, signals[model.device.output]


@pytest.fixture(scope="module")
def driver(tmp_path_factory):
    return Driver(library().values(), tmp_path_factory.mktemp("driver"))


@pytest.mark.parametrize("name", TYPICAL)
def test_c_and_python_agree_far_from_rest(driver, name):
    """Two writings of the same elements: limits, gates and cut-offs are met on the mode."""
    point, inputs = at_rest(name)
    instance, rng = point.instance, np.random.default_rng(5)
    spread = np.geomspace(1e-3, 3.0, 40)
    xs = [np.array(point.states) + s * rng.standard_normal(len(point.states)) for s in spread]
    seen = [{k: v + s * rng.standard_normal() * 0.3 for k, v in inputs.items()} for s in spread]
    rates, outputs = driver.run(instance.model, [instance] * len(xs), xs, seen)
    for k, (x, at) in enumerate(zip(xs, seen, strict=True)):
        values, expected = instance.run(x, at)
        size = 1.0 + np.abs(np.array(expected, dtype=float))
        assert np.abs((rates[k] - expected) / size).max(initial=0.0) < 1e-11
        assert outputs[k] == pytest.approx(values[instance.model.device.output], rel=1e-11, abs=1e-13)


@pytest.mark.parametrize("name", TYPICAL)
def test_devices_side_by_side_have_the_bits_of_each_alone(driver, name):
    instance, xs, seen = off_rest(name, 11)
    alone = driver.run(instance.model, [instance] * len(xs), xs, seen)
    for lanes in (4, 8):
        if lanes <= driver.c.lanes_of_this_machine():
            result = driver.run(instance.model, [instance] * len(xs), xs, seen, lanes)
            np.testing.assert_array_equal(result[0], alone[0])
            np.testing.assert_array_equal(result[1], alone[1])


@pytest.mark.parametrize("name", TYPICAL)
def test_decisions_held_where_they_were_made_give_the_same_bits(driver, name):
    """Noted by any number of lanes; none is overrun there, and held states are on their limits or inside."""
    instance, xs, seen = off_rest(name, 13)
    free = driver.run(instance.model, [instance] * len(xs), xs, seen)
    for lanes in (0, *(n for n in (4, 8) if n <= driver.c.lanes_of_this_machine())):
        driver.words[:] = np.nan
        driver.run(instance.model, [instance] * len(xs), xs, seen, lanes, "note")
        driver.run(instance.model, [instance] * len(xs), xs, seen, lanes, "watch")
        assert not driver.measured
        held = driver.run(instance.model, [instance] * len(xs), xs, seen, mode="hold")
        np.testing.assert_array_equal(held[0], free[0])
        np.testing.assert_array_equal(held[1], free[1])
        assert driver.measured <= 0.0
        np.testing.assert_array_equal(driver.onto.T, np.array(xs))


def test_a_limit_overrun_is_watched_and_measured(driver):
    """SEXS: noted inside its limits, then the field voltage 0.7 above the upper one, its input above that."""
    point, inputs = at_rest("SEXS")
    instance = point.instance
    inside, beyond = np.array(point.states), np.array(point.states)
    at = list(instance.state_names).index("efd")
    beyond[at] = instance.values["EMAX"] + 0.7
    inputs = inputs | {"vs": 10.0}
    driver.run(instance.model, [instance], [inside], [inputs], mode="note")
    driver.run(instance.model, [instance], [beyond], [inputs], mode="watch")
    assert driver.measured
    driver.run(instance.model, [instance], [beyond], [inputs], mode="hold")
    assert driver.measured == pytest.approx(0.7, rel=1e-12)
    driver.run(instance.model, [instance], [beyond], [inputs], mode="note")
    below = beyond.copy()
    below[at] -= 0.9  # behind its limit, as where that rises
    rates, outputs = driver.run(instance.model, [instance], [below], [inputs], mode="hold")
    assert outputs[0] == instance.values["EMAX"] == driver.onto[at, 0]
    assert rates[0][at] == pytest.approx(0.2 / instance.values["TE"], rel=1e-12)


@pytest.mark.parametrize("name", ["ESST1A", "EXAC1", "IEEEST", "PSS2B", "HYGOV"])
def test_absent_parts_are_absent_in_c_too(driver, name):
    """Every time that may be 0 set to 0 in turn: fewer states, and still the same in C and Python."""
    model, settings = TYPICAL[name]
    for p in model.device.parameters:
        if p.unit != "s" or p.low != 0.0 or p.open or not complete(model, settings)[p.name]:
            continue
        values = point_values(name) | {p.name: 0.0}
        try:
            instance = Instance(model, values)
        except DeviceError as error:
            assert "form a loop without a state" in str(error) or "TF = 0 with KF" in str(error)
            continue
        x = 0.1 + 0.05 * np.arange(len(instance.states))
        rates, outputs = driver.run(model, [instance], [x], [SEEN])
        signals, expected = instance.run(x, SEEN)
        np.testing.assert_allclose(rates[0], expected, rtol=1e-11, atol=1e-12)
        assert outputs[0] == pytest.approx(signals[model.device.output], rel=1e-11)


def point_values(name):
    return at_rest(name)[0].instance.values


@pytest.mark.parametrize("name", TYPICAL)
def test_declared_dependencies_cover_the_derivatives(name):
    """Complex steps at 10 points: no nonzero entry that is not declared."""
    point, inputs = at_rest(name)
    instance, rng = point.instance, np.random.default_rng(7)
    rates, output = instance.depends_on()
    names, n = instance.state_names, len(instance.states)
    step = 1e-30
    for _ in range(10):
        x = [complex(v + 0.05 * rng.standard_normal()) for v in point.states]
        seen = {k: complex(v + 0.05 * rng.standard_normal()) for k, v in inputs.items()}
        for what in (*(f"x.{s}" for s in names), *seen):
            z, at = list(x), dict(seen)
            if what.startswith("x."):
                z[names.index(what[2:])] += 1j * step
            else:
                at[what] += 1j * step
            values, dz = instance.run(z, at)
            for k in range(n):
                assert complex(dz[k]).imag == 0.0 or what in rates[names[k]], (names[k], what)
            assert complex(values[instance.model.device.output]).imag == 0.0 or what in output, what


#: parameters of each device that its equations only compare with numbers
SWITCHES = {
    "wecc_converter": "PLANT",
    "regfm_b1": "wFlag",
    "der_a": "TypeFlag",
    "lcc": "POWER",
    "vsc": "KEEPV1",
}


@pytest.mark.parametrize(("key", "switch"), SWITCHES.items())
def test_a_switch_is_a_whole_number(key: str, switch: str) -> None:
    device = library()[key].device
    assert row_of(device, {switch: 1})[switch] == 1.0
    with pytest.raises(
        DeviceError, match=rf"^\.{switch} = 0\.5, allowed: a whole number, at least 0 and at most 1$"
    ):
        row_of(device, {switch: 0.5})


def test_what_the_equations_calculate_with_is_no_switch() -> None:
    devices = {key: model.device for key, model in library().items()}
    assert "ICS" in devices["ieeest"].switches and "A1" not in devices["ieeest"].switches
    assert not devices["sexs"].switches
    for device in devices.values():
        for name in device.switches:
            default = device.by_name[name].default
            assert default is None or default == round(default)
