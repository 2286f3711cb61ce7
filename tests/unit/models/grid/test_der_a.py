"""DER_A: at rest, against a record of PSS/E, and against its block diagram written a second time."""

from __future__ import annotations

import tomllib
from pathlib import Path

import numpy as np
import pytest
from plant_shim import BlockShim
from sparse_blocks import agreeing_blocks

from interarea.models.blocks.plant import event_parameters, plant_block
from interarea.models.case.case import load_case
from interarea.models.case.events import events_of
from interarea.models.devices.dyr import dyr_models
from interarea.models.devices.library import library
from interarea.models.devices.release import released
from interarea.models.devices.rows import numbers_of, row_of
from interarea.models.errors import CaseError, DeviceError
from interarea.models.grid.equilibrium import operating_point
from interarea.models.grid.machine_tables import in_plant_order
from interarea.models.importers.file import import_grid
from interarea.models.importers.imported import ImportOptions

TRACES = Path(__file__).parents[5] / "shared" / "reference" / "psse_traces"
RECORD = TRACES / "DERA_FREQFLAG0"
BY_FREQUENCY = {"FreqFlag": 1, "Ddn": 20.0, "Dup": 5.0, "Trf": 0.05}
#: name -> parameters, states
CONTROLS = {
    "plain": ({}, 16),
    "factor": ({"PfFlag": 1, "PQFlag": 1, "FtripFlag": 0, "VtripFlag": 0, "Tv": 0, "Trv": 0}, 13),
    "frequency": (BY_FREQUENCY | {"Kqv": 2.0, "dbd1": 0.0, "dbd2": 0.0}, 18),
    "storage": (BY_FREQUENCY | {"TypeFlag": 0, "Pmin": -1.0, "fdbd1": 0.0, "fdbd2": 0.0}, 18),
}


def with_der(control="plain", P_mw=100.0, base="two-area-thesis", **more):
    row = {"bus": 8, "base_mva": 200.0, "P_mw": P_mw, "Q_mvar": 20.0}
    row["control"] = {"kind": "der_a"} | CONTROLS[control][0] | more
    return load_case(base).with_changes({"converters": {"der1": row}})


@pytest.mark.parametrize(
    ("control", "network", "base"),
    [*((c, "dense", "two-area-thesis") for c in CONTROLS), ("frequency", "sparse", "kundur-manual")],
)
def test_it_rests_and_the_derivatives_are_those_of_differences(control, network, base):
    P_mw = -60.0 if control == "storage" else 100.0
    plant = BlockShim(plant_block(with_der(control, P_mw, base), network=network))
    own = np.array([n.startswith("der1.") for n in plant.state_names])
    assert own.sum() == CONTROLS[control][1]
    rates, y = plant.derivatives(plant.x)
    assert np.max(np.abs(rates)) < 5e-11
    assert y[plant.output_names.index("der1.p")] == pytest.approx(P_mw / 100.0, abs=1e-11)
    assert y[plant.output_names.index("der1.q")] == pytest.approx(0.2, abs=1e-11)


def test_the_sparse_blocks_have_its_state_matrix():
    """By the direction of its voltage too, which only the frequency needs."""
    case = in_plant_order(with_der("frequency", fdbd1=0.0, fdbd2=0.0))
    blocks, _, _ = agreeing_blocks(case)
    assert blocks.inputs[-2:] == ("der1_p_mod", "der1_q_mod")


def run(case, seconds, *events, step_s=0.001):
    """Return time, the voltage of bus 8, and states and outputs of the converter by name."""
    block = plant_block(case, more=["bus8.re", "bus8.im"])
    plant = BlockShim(block, event_parameters(case, events_of(list(events), where="test")))
    time_s, x, y = plant.run(seconds, step_s)
    at = {name: k for k, name in enumerate(plant.output_names)}
    own = {n.removeprefix("der1."): x[:, k] for k, n in enumerate(plant.state_names) if "der1." in n}
    own |= {part: y[:, at[f"der1.{part}"]] for part in "pq"}
    return time_s, y[:, at["bus8.re"]] + 1j * y[:, at["bus8.im"]], own


def off(error, low, high):
    """An error outside its deadband."""
    return error - np.clip(error, low, high) if high > low else error


class Trips:
    """Times beyond thresholds, what stays, lowest and highest voltage: as the published logic counts them."""

    def __init__(self, p, f0):
        self.p, self.f0 = p, f0
        self.time = dict.fromkeys(("vl0", "vl1", "vh0", "vh1", "fl", "fh"), 0.0)
        self.gone: set[str] = set()
        self.low, self.high = np.inf, -np.inf

    def share(self, dt, v, df):
        p, f = self.p, self.f0 * (1.0 + df)
        beyond = {"vl0": v < p["vl0"], "vl1": v < p["vl1"], "vh0": v > p["vh0"], "vh1": v > p["vh1"]}
        beyond = {name: p["VtripFlag"] and is_so for name, is_so in beyond.items()}
        by_frequency = p["FtripFlag"] and v >= p["Vpr"]
        beyond |= {"fl": by_frequency and f < p["fl"], "fh": by_frequency and f > p["fh"]}
        for name, is_so in beyond.items():
            self.time[name] = self.time[name] + dt if is_so else 0.0
            if self.time[name] >= p[f"t{name}"]:
                self.gone.add(name)
        self.low, self.high = min(self.low, v), max(self.high, v)
        if self.gone & {"vl0", "vh0", "fl", "fh"}:
            return 0.0
        if not p["VtripFlag"]:
            return 1.0
        linear = np.clip(v, p["vl0"], p["vl1"])
        worst = np.clip(self.low, p["vl0"], linear) if "vl1" in self.gone else linear
        below = (worst + p["Vrfrac"] * (linear - worst) - p["vl0"]) / (p["vl1"] - p["vl0"])
        linear = np.clip(v, p["vh1"], p["vh0"])
        worst = np.clip(self.high, linear, p["vh0"]) if "vh1" in self.gone else linear
        return below * (p["vh0"] - worst - p["Vrfrac"] * (linear - worst)) / (p["vh0"] - p["vh1"])


def block_diagram(case, times, V, **changed):
    """Integrate the published diagram at the voltages V of its bus by Heun's method, with counted timers.

    changed : parameters other than the case's. Returns ip, iq and the connected share at `times`.
    """
    row = case.converters[0]
    p = {q.name: q.default for q in library()["der_a"].device.parameters}
    p |= {k: float(v) for k, v in row.control.parameters.items()} | changed
    w0, size, angle = 2 * np.pi * case.frequency_hz, np.abs(V), np.unwrap(np.angle(V))
    P, Q = row.P_mw / row.base_mva, row.Q_mvar / row.base_mva
    trips = Trips(p, case.frequency_hz)

    def rates(s, u, theta, share):
        vm, pm, x, mult, iql, iq, xi, pord, ip = s
        df = (theta - x) / (w0 * p["Trf"])
        e = off(-df, p["fdbd1"], p["fdbd2"])
        error = np.clip(P + (p["Dup"] if e > 0 else p["Ddn"]) * e - pm, p["femin"], p["femax"])
        whole = p["Kpg"] * error + xi
        outwards = (whole > p["Pmax"] and error > 0) or (whole < p["Pmin"] and error < 0)
        order = np.clip(whole, p["Pmin"], p["Pmax"]) if p["FreqFlag"] else P
        rate = np.clip((order - pord) / p["Tpord"], p["dPmin"], p["dPmax"])
        extra = np.clip(p["Kqv"] * off(size[0] - vm, p["dbd1"], p["dbd2"]), p["Iql1"], p["Iqh1"])
        least, most = (0.0 if p["TypeFlag"] else -p["Imax"]), p["Imax"]
        active, reactive = np.clip(pord, p["Pmin"], p["Pmax"]) / max(vm, 0.01), iql + extra
        if p["PQFlag"]:
            active = np.clip(active, least, most)
            left = np.sqrt(most**2 - active**2)
            reactive = np.clip(reactive, -left, left)
        else:
            reactive = np.clip(reactive, -most, most)
            left = np.sqrt(most**2 - reactive**2)
            active = np.clip(active, max(least, -left), left)
        rise = (mult * active - ip) / p["Tg"]
        measured = u * ip if p["FreqFlag"] else pord
        expected = (pm * Q / P if p["PfFlag"] else Q) / max(vm, 0.01)
        rise = min(rise, p["rrpwr"]) if P > 0 else max(rise, -p["rrpwr"])
        slopes = [(u - vm) / p["Trv"], (measured - pm) / p["Tp"], (theta - x) / p["Trf"]]
        slopes += [(share - mult) / p["Tv"], (expected - iql) / p["Tiq"], (mult * reactive - iq) / p["Tg"]]
        slopes += [0.0 if outwards or not p["FreqFlag"] else p["Kig"] * error, rate, rise]
        return np.array(slopes)

    s = np.array([size[0], P, angle[0], 1.0, Q / size[0], Q / size[0], P, P, P / size[0]])
    courses = [s]
    for k in range(len(times) - 1):
        h = times[k + 1] - times[k]
        share = trips.share(h, s[0], (angle[k] - s[2]) / (w0 * p["Trf"]))
        first = rates(s, size[k], angle[k], share)
        s = s + h / 2 * (first + rates(s + h * first, size[k + 1], angle[k + 1], share))
        courses.append(s)
    courses = np.array(courses)
    return courses[:, 8], courses[:, 5], courses[:, 3]


def beyond_a_sample(own, course):
    """Return by how much they differ at most, less what `course` moves from one sample to the next there."""
    moved = np.abs(np.diff(course))
    return np.max(np.abs(own - course) - np.maximum(np.append(moved, 0.0), np.append(0.0, moved)))


FAULT = {"kind": "bus_fault", "bus": 8, "start_s": 0.1, "x_pu": 0.08}
LOAD = {"kind": "load_step", "bus": 9, "start_s": 0.1}
VOLTS = {"vl0": 0.3, "vl1": 0.8, "tvl0": 0.3, "tvl1": 0.15, "Imax": 0.56}
VOLTS |= {"Kqv": 2.0, "dbd1": -0.05, "dbd2": 0.05}
HIGH = {"vh1": 1.0, "vh0": 1.2, "tvh1": 0.1, "Kqv": 3.0, "dbd1": -0.02, "dbd2": 0.02, "Iql1": -0.1}
SLOW = {"fl": 59.9, "tfl": 0.3}
#: name -> parameters, event, share connected at the end (None: some), another value of what it is about
COURSES = {
    "short dip": (VOLTS | {"PQFlag": 1}, FAULT | {"end_s": 0.2}, 1.0, {"tvl1": 0.05}),
    "dip": (VOLTS, FAULT | {"end_s": 0.35}, None, {"Imax": 9.0}),
    "active priority": (VOLTS | {"PQFlag": 1, "PfFlag": 1}, FAULT | {"end_s": 0.35}, None, {"Imax": 9.0}),
    "deep dip": (VOLTS, FAULT | {"end_s": 0.45, "x_pu": 0.01}, 0.0, {"tvl0": 9.0}),
    "high voltage": (HIGH, LOAD | {"p_pu": -6.0, "q_pu": -1.0}, None, {"Iql1": -9.0}),
    "high frequency": (
        BY_FREQUENCY | {"dPmin": -0.02},
        LOAD | {"p_pu": -3.0, "q_pu": 0.0},
        1.0,
        {"dPmin": -9.0},
    ),
    "low frequency": (
        BY_FREQUENCY | {"Pmax": 0.51, "Dup": 20.0},
        LOAD | {"p_pu": 3.0, "q_pu": 0.0},
        1.0,
        {"Pmax": 9.0},
    ),
    "trip": (BY_FREQUENCY | SLOW, LOAD | {"p_pu": 4.0, "q_pu": 0.0}, 0.0, {"tfl": 9.0}),
    "no trip below Vpr": (SLOW | {"Vpr": 2.0}, LOAD | {"p_pu": 4.0, "q_pu": 0.0}, 1.0, {"Vpr": 0.0}),
}


@pytest.mark.slow
@pytest.mark.parametrize("name", COURSES)
def test_it_follows_the_block_diagram(name):
    """And what the run is about acts: the diagram with another value of that goes elsewhere."""
    parameters, event, end, about = COURSES[name]
    case = with_der(**parameters)
    times, V, own = run(case, 2.0, event, step_s=0.0005)
    course, other = block_diagram(case, times, V), block_diagram(case, times, V, **about)
    assert max(np.max(np.abs(one - two)) for one, two in zip(course, other, strict=True)) > 0.01
    for part, one in zip(("ip", "iq", "mult"), course, strict=True):
        assert beyond_a_sample(own[part], one) < 3e-3, part
    if end is None:
        assert 0.05 < course[2][-1] < 0.95
    else:
        assert course[2][-1] == pytest.approx(end, abs=1e-3)


def record_line(bus, **changes):
    """Return the DYR record with the constants of the trace; its fh of 2 pu in Hz."""
    traces = tomllib.loads((TRACES / "manifest.toml").read_text())["trace"]
    constants = next(t for t in traces if t["id"] == RECORD.name)["constants"]["DERA1 at 102-1"]
    constants = constants | {
        "TypeFlag": constants["GenFlag"],
        "Iqh1": constants["Iqmax"],
        "Iql1": constants["Iqmin"],
    }
    constants |= {"Vref0": 0.0, "fh": 120.0} | changes
    fields = dyr_models()["DERA1"][1].fields
    return f"{bus} 'USRMDL' 1 'DERAU1' 101 1 6 41 10 23 {' '.join(str(constants[f]) for f in fields)} /\n"


def record_case(folder, text):
    path = folder / "grid.dyr"
    path.write_text((RECORD / "ThreeBus_DERA.dyr").read_text() + text)
    return import_grid(
        RECORD / "ThreeBusMulti.raw", dyr=path, options=ImportOptions(P_exponent=1.0, Q_exponent=2.0)
    ).case


@pytest.mark.slow
@pytest.mark.skipif(not RECORD.exists(), reason="needs ../shared/reference")
def test_it_follows_the_record_of_psse(tmp_path):
    """Line 101-102 opens at 2 s: voltage and angle of bus 102, largest error as a share of the range."""
    case = record_case(tmp_path, record_line(102))
    opened = events_of([{"kind": "branch_trip", "branch": "101-102", "start_s": 2.0}], where="test")
    block = plant_block(case, more=[f"bus{k}.{part}" for k in (101, 102) for part in ("re", "im")])
    plant = BlockShim(block, event_parameters(case, opened))
    t, _, y = plant.run(4.0, 0.0025)
    seen = {key: y[:, k] for k, key in enumerate(plant.output_names)}
    V = seen["bus102.re"] + 1j * seen["bus102.im"]
    turned = V / (seen["bus101.re"] + 1j * seen["bus101.im"])
    record = np.array(
        [
            [float(v) for v in row.split(",")]
            for row in (RECORD / f"{RECORD.name}.csv").read_text().split()[1:]
        ]
    )
    record = record[(record[:, 0] < 1.99) | (record[:, 0] > 2.001)]
    for k, own in ((1, np.abs(V)), (2, np.angle(turned, deg=True))):
        error = np.abs(np.interp(record[:, 0], t, own) - record[:, k]) / np.ptp(record[:, k])
        assert error.max() < 3.45e-3
        assert error[-1] < 3e-4


@pytest.mark.parametrize(
    ("changes", "says"),
    [
        (
            {"vl1": 1.1, "vh1": 1.15},
            "its rate 6.25 1/s, as 0.959127 is below vl1 = 1.1",
        ),
        (
            {"fh": 59.9},
            "its rate 6.25 1/s, as 0 is above fh/FBASE - 1",
        ),
        ({"Pmax": 0.4}, "pord (active power order) is 0.5 at the equilibrium, above Pmax = 0.4"),
        ({"Imax": 0.4}, "at the equilibrium, above"),
        ({"vl0": 0.5}, "give vl1 the larger one"),
        ({"vh1": 0.45}, "give vh1 the larger one"),
        ({"tvl0": 0.0}, "tvl0"),
    ],
)
def test_what_cannot_rest_is_named(changes, says):
    with pytest.raises(CaseError) as reported:
        operating_point(with_der("plain", **changes))
    assert says in str(reported.value)


@pytest.mark.parametrize(("kind", "flag"), [("der_a", "PQFlag"), ("wecc_converter", "PQFLAG")])
@pytest.mark.parametrize("priority", [0.0, 1.0])
def test_a_circle_of_the_current_that_cannot_be_released_is_named(kind, flag, priority):
    """Each limit of a current follows from the other: spelling one out ends."""
    model = library()[kind]
    numbers = numbers_of(model.device, row_of(model.device, {"Imax": 0.405, flag: priority}), 100.0, 60.0)
    seen = {"vt": 1.0, "p": 0.4, "q": 0.1, "p_mod": 0.0, "q_mod": 0.0, "vr": 0.8, "vi": 0.6, "iq": 0.1}
    seen |= {"vreg": 1.0, "vdrop": 1.0, "pbr": 0.4, "qbr": 0.1}
    with pytest.raises(
        DeviceError, match=r"test: i[pq]cmd is 0\.[14] at the equilibrium, above i[pq]max = 0\."
    ):
        released(model, numbers, seen, 0.4, "test")


@pytest.mark.skipif(not RECORD.exists(), reason="needs ../shared/reference")
def test_a_record_beside_another_converter_is_refused(tmp_path):
    beside = "102 'REGCA1' 1 1 0.02 10 0.9 0.4 1.22 1.2 0.8 0.4 -1.3 0.02 0.7 99 -99 0.7 /\n"
    with pytest.raises(CaseError, match=r"G102 has DERA1 and REGCA1, allowed: DERA1 alone"):
        record_case(tmp_path, record_line(102) + beside)
    with pytest.raises(CaseError, match=r"DERA1 .*PfFlag = 2"):
        record_case(tmp_path, record_line(102, PfFlag=2))
