"""Thirteen forced oscillations on the 240 buses, of the kinds of the IEEE-NASPI contest of 2021.

The contest had sources in governors, exciters, loads and HVDC, two at once, and near resonance with a mode
(web.eecs.utk.edu/~kaisun/Oscillation/contestcases.html); places, frequencies and sizes here are our own, and
so are the waves in reactive power of a converter plant. Four plants that the case has as currents get their
control (`wecc_converter`), and the link from Intermountain to Adelanto, in the case a load and a source, is
one with voltage-source converters.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import interarea as ia
from interarea.cosim.records.model_source import INPUT, LOAD, MECHANICAL, REFERENCE

CONVERTERS = ("G2533", "G3932", "G5032_S", "G7031_W")
LINK = {"from_bus": 2604, "to_bus": 2600, "base_mva": 2000.0, "vdc_kv": 1000.0, "P_mw": 1845.7, "r_ohm": 48.0}
LINK_ENDS = ("L2604_I", "L2600_I")


@dataclass(frozen=True)
class Wave:
    """A sine on an input of the plant, held between steps."""

    step_s: ClassVar[float] = 0.02
    input: str
    frequency_hz: float
    size_pu: float


def contest():
    """Return the case, and of each oscillation name, events, waves and {frequency: {(place, kind)}}."""
    return with_converters(ia.load_case("wecc-240")), [
        task("governor", governor("G2634", 0.63)),
        task("governor, near inter-area 2", governor("G7031_G", 0.706)),
        task("governor, near local area 1.2", governor("G1431_G", 1.187)),
        task("governor, square", governor("G4132_H", 0.27, shape="square")),
        task("exciter", exciter("G3831", 0.95)),
        task("exciter, near inter-area 1", exciter("G5032_C", 0.382)),
        task("exciter, harmonics", exciter("G6335_C", 0.41, harmonics=[0.4, 0.2])),
        task("load", load("L4203_I", 0.52)),
        task("load, square, near inter-area 3", load("L2408_I", 0.889, shape="square")),
        task("converter, active power", Wave("C5032_S_p_mod", 0.63, 0.03)),
        task("converter, reactive power", Wave("C2533_q_mod", 0.82, 0.03)),
        task("dc link", Wave("ippdc_p_mod", 0.33, 0.02)),
        task("two sources at one frequency", governor("G1034_G", 0.614), exciter("G6533_C", 0.614)),
    ]


def with_converters(case):
    """Return the case with `CONVERTERS` as plants and the link."""
    loads = {row.name: row for row in case.loads}
    plants = {
        name.replace("G", "C"): {
            "bus": loads[name].bus,
            "base_mva": -1.2 * loads[name].P_mw,
            "P_mw": -loads[name].P_mw,
            "Q_mvar": -loads[name].Q_mvar,
            "control": {"kind": "wecc_converter", "Imax": 1.3},
        }
        for name in CONVERTERS
    }
    out = {name: {"in_service": False} for name in (*CONVERTERS, *LINK_ENDS)}
    change = {"loads": out, "converters": plants, "vscs": {"ippdc": LINK}}
    return case.with_changes(change, name="wecc-240-converters")


def task(name, *acts):
    """Return an oscillation: name, events, waves, true sources by frequency."""
    events = [act for act in acts if not isinstance(act, Wave)]
    waves = tuple(act for act in acts if isinstance(act, Wave))
    kinds = {"mechanical_power": MECHANICAL, "voltage_reference": REFERENCE, "load": LOAD}
    lines: dict[float, set[tuple[str, str]]] = {}
    for e in events:
        place = e["load"] if e["on"] == "load" else e["machine"]
        lines.setdefault(e["frequency_hz"], set()).add((place, kinds[e["on"]]))
    for wave in waves:
        lines.setdefault(wave.frequency_hz, set()).add((wave.input, INPUT))
    return name, events, waves, lines


def governor(machine, f, **more):
    return {"on": "mechanical_power", "machine": machine, "frequency_hz": f, "size_pu": 0.02, **more}


def exciter(machine, f, **more):
    return {"on": "voltage_reference", "machine": machine, "frequency_hz": f, "size_pu": 0.01, **more}


def load(name, f, **more):
    return {"on": "load", "load": name, "frequency_hz": f, "size_pu": 0.05, **more}
