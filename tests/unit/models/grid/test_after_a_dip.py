"""REEC_A after a voltage dip: its clock in closed form, what it holds, its diagram a second time, record."""

from __future__ import annotations

import numpy as np
import pytest
from grid_text import pair_with
from plant_shim import BlockShim
from sparse_blocks import agreeing_blocks

from interarea.models.blocks.plant import event_parameters, plant_block
from interarea.models.case.case import load_case
from interarea.models.case.events import events_of
from interarea.models.errors import CaseError
from interarea.models.grid.equilibrium import operating_point
from interarea.models.grid.machine_tables import in_plant_order
from interarea.models.importers.psse import import_psse

BEGIN, END, STEP = 0.1, 0.25, 0.0005
DIP = {"kind": "bus_fault", "bus": 8, "start_s": BEGIN, "end_s": END, "x_pu": 0.08}
EACH = {"REECA": 1, "Vdip": 0.8, "Vup": 1.2, "Kqv": 1.5, "dbd1": -0.05, "dbd2": 0.05, "Imax": 1.1}
#: name -> parameters, the same with another value of what it is about
HOLDS = {
    "constant": ({"Thld": 0.2, "Iqfrz": 0.2}, {"Thld": 0.1}),
    "by voltage": ({"Thld": -0.2, "dbd1": 0.0, "dbd2": 0.0}, {"Thld": 0.0}),
    "active": ({"Thld2": 0.3, "Imax": 0.6}, {"Thld2": 0.0}),
    "active first": (
        {"Thld2": 0.3, "PQFLAG": 1, "Vp1": 0.5, "Ip1": 0.2, "Vp2": 0.9, "Ip2": 0.9},
        {"Thld2": 0.1},
    ),
    "both": ({"Thld": 0.1, "Iqfrz": -0.1, "Thld2": 0.25, "Imax": 0.6}, {"Iqfrz": 0.0}),
}


def with_converter(base="two-area-thesis", **more):
    row = {"bus": 8, "base_mva": 200.0, "P_mw": 100.0, "Q_mvar": 20.0}
    row["control"] = {"kind": "wecc_converter"} | EACH | more
    return load_case(base).with_changes({"converters": {"pv1": row}})


def run(case, seconds=0.8):
    """Return time, voltage of bus 8 and the states of the converter by name."""
    block = plant_block(case, more=["bus8.v"])
    plant = BlockShim(block, event_parameters(case, events_of([DIP], where="test")))
    time_s, x, y = plant.run(seconds, STEP)
    own = {n.removeprefix("pv1."): x[:, k] for k, n in enumerate(plant.state_names) if n.startswith("pv1.")}
    return time_s, y[:, plant.output_names.index("bus8.v")], own


@pytest.mark.parametrize(
    ("name", "network", "base"),
    [*((n, "dense", "two-area-thesis") for n in HOLDS), ("both", "sparse", "kundur-manual")],
)
def test_it_rests_and_the_derivatives_are_those_of_differences(name, network, base):
    more = HOLDS[name][0]
    plant = BlockShim(plant_block(with_converter(base, **more), network=network))
    own = {n.removeprefix("pv1.") for n in plant.state_names if n.startswith("pv1.")}
    held = ({"since"} if "Thld" in more else set()) | ({"back", "ipkept"} if "Thld2" in more else set())
    assert own == {"vm", "pord", "iqlag", "ip", "iq"} | held
    rates, _ = plant.derivatives(plant.x)
    assert np.max(np.abs(rates)) < 5e-11
    off, outputs_off = plant.directional_errors(1e-4, 1e-5)
    assert off < 1e-7 and outputs_off < 1e-6


@pytest.mark.slow
def test_at_rest_it_stands_for_20_s():
    plant = BlockShim(plant_block(with_converter(**HOLDS["both"][0])))
    own = [k for k, name in enumerate(plant.state_names) if name.startswith("pv1.")]
    _, x, _ = plant.run(20.0, 0.002)
    assert np.max(np.abs(x[:, own] - x[0, own])) < 1e-12


@pytest.mark.parametrize(("key", "clock"), [("Thld", "since"), ("Thld2", "back")])
@pytest.mark.parametrize("seconds", [0.05, 0.3])
def test_a_clock_is_at_2_in_the_dip_and_at_1_when_its_time_is_over(key, clock, seconds):
    """2 - (t - end)/Thld after the dip, whatever the step; below 1 it goes to 0."""
    time_s, _, own = run(with_converter(**{key: seconds}))
    after = time_s - END
    falls = (after >= 0.0) & (after <= seconds)
    assert own[clock][falls] == pytest.approx(2.0 - after[falls] / seconds, abs=2e-7)
    assert own[clock][(time_s > BEGIN + 0.1) & (after < 0.0)] == pytest.approx(2.0, abs=2e-7)
    assert own[clock][-1] < (1.0 if 2.0 * seconds > time_s[-1] - END else 1e-6)


@pytest.mark.parametrize("Thld", [0.2, -0.2])
@pytest.mark.parametrize("clock", [1.5, 0.5])
def test_what_is_added_to_the_reactive_current_while_it_holds(Thld, clock):
    """Tg iq' = iqlag + added - iq with added Iqfrz, or Kqv (Vref0 - vm), and nothing once it is over."""
    plant = BlockShim(plant_block(with_converter(Thld=Thld, Iqfrz=0.2, dbd1=0.0, dbd2=0.0)))
    x, at = plant.x.copy(), {n.removeprefix("pv1."): k for k, n in enumerate(plant.state_names)}
    rest = x[at["vm"]]
    x[at["since"]], x[at["vm"]] = clock, rest - 0.1
    rates, _ = plant.derivatives(x)
    added = 0.0 if clock < 1.0 else 0.2 if Thld > 0.0 else 1.5 * 0.1
    assert rates[at["iq"]] == pytest.approx((x[at["iqlag"]] + added - x[at["iq"]]) / 0.02, rel=1e-11)
    assert rates[at["since"]] == pytest.approx(-5.0)


@pytest.mark.parametrize("clock", [1.5, 0.5])
def test_the_active_current_keeps_its_limit_of_the_dip(clock):
    """Tg ip' is the kept limit less ip, which stands; then that of the circle again, which it follows."""
    plant = BlockShim(plant_block(with_converter(Thld2=0.2)))
    x, at = plant.x.copy(), {n.removeprefix("pv1."): k for k, n in enumerate(plant.state_names)}
    x[at["back"]], x[at["ipkept"]] = clock, 0.3
    rates, _ = plant.derivatives(x)
    order, now = x[at["pord"]] / x[at["vm"]], np.sqrt(1.1**2 - x[at["iqlag"]] ** 2)
    assert rates[at["ip"]] == pytest.approx(((0.3 if clock > 1.0 else order) - x[at["ip"]]) / 0.02, abs=1e-9)
    assert rates[at["ipkept"]] == pytest.approx(0.0 if clock > 1.0 else (now - 0.3) / 0.005, rel=1e-11)


def block_diagram(time_s, volts, first, p):
    """Integrate REEC_A and REGC_A at the voltages of the bus by Heun's method, with counted times."""
    p = {"Thld": 0.0, "Thld2": 0.0, "Iqfrz": 0.0, "PQFLAG": 0} | EACH | p
    names = ("vm", "pord", "iqlag", "ip", "iq")
    s, held, rest = np.array([first[n] for n in names]), None, volts[0]
    since = since2 = np.inf  # s after the last dip

    def currents(s, dip):
        vm, pord, iql = s[:3]
        error = rest - vm
        if p["dbd2"] > p["dbd1"]:
            error -= np.clip(error, p["dbd1"], p["dbd2"])
        by_voltage = np.clip(p["Kqv"] * error, -1.1, 1.1)
        goes_on = not dip and since < abs(p["Thld"])
        added = by_voltage if dip or (goes_on and p["Thld"] < 0.0) else p["Iqfrz"] if goes_on else 0.0
        table = np.interp(vm, [p["Vp1"], p["Vp2"]], [p["Ip1"], p["Ip2"]]) if "Vp1" in p else 99.0
        expected, active, most = iql + added, pord / max(vm, 0.01), p["Imax"]
        if p["PQFLAG"]:
            limit = min(table, most)
            used = held if held is not None else limit
            ip = np.clip(active, 0.0, used)
            left = np.sqrt(most**2 - ip**2)
            return ip, np.clip(expected, -left, left), limit
        iq = np.clip(expected, -most, most)
        limit = min(table, np.sqrt(most**2 - iq**2))
        return np.clip(active, 0.0, held if held is not None else limit), iq, limit

    def rates(s, v, dip):
        ip, iq, _ = currents(s, dip)
        stands = 0.0 if dip else 1.0
        return np.array(
            [
                (v - s[0]) / 0.02,
                stands * (0.5 - s[1]) / 0.02,
                stands * (0.1 / max(s[0], 0.01) - s[2]) / 0.02,
                min((ip - s[3]) / 0.02, 10.0),
                (iq - s[4]) / 0.02,
            ]
        )

    course, limit = [s], None
    for k in range(len(time_s) - 1):
        h, dip = time_s[k + 1] - time_s[k], volts[k] < p["Vdip"]
        if dip:
            since = since2 = 0.0
        held = limit if not dip and since2 < p["Thld2"] - 1e-9 else None
        if held is None:
            limit = currents(s, dip)[2]
        one = rates(s, volts[k], dip)
        following = volts[k] if (volts[k + 1] < p["Vdip"]) != dip else volts[k + 1]
        s = s + h / 2 * (one + rates(s + h * one, following, dip))
        if not dip:
            since, since2 = since + h, since2 + h
        course.append(s)
    return dict(zip(names, np.array(course).T, strict=True))


@pytest.mark.slow
@pytest.mark.parametrize("name", HOLDS)
def test_it_follows_the_block_diagram(name):
    """And what the run is about acts: the diagram with another value of that goes elsewhere."""
    more, other = HOLDS[name]
    time_s, volts, own = run(with_converter(**more))
    first = {n: course[0] for n, course in own.items()}
    expected, elsewhere = (block_diagram(time_s, volts, first, p) for p in (more, more | other))
    print({n: np.max(np.abs(own[n] - expected[n])) for n in expected})
    for n in ("ip", "iq"):
        assert own[n] == pytest.approx(expected[n], abs=3e-3), n
    assert max(np.max(np.abs(elsewhere[n] - expected[n])) for n in ("ip", "iq")) > 0.02


def test_the_sparse_blocks_have_its_state_matrix():
    blocks, _, _ = agreeing_blocks(in_plant_order(with_converter(**HOLDS["both"][0])))
    assert blocks.inputs[-2:] == ("pv1_p_mod", "pv1_q_mod")


@pytest.mark.parametrize(
    ("more", "says"),
    [
        ({"Thld": 0.001}, "Thld = 0.001; give Thld at least 0.005 s, or 0: none"),
        ({"Thld": -0.001}, "Thld = -0.001; give Thld at least 0.005 s, or 0: none"),
        ({"Thld2": 0.001}, "Thld2 = 0.001; give Thld2 at least 0.005 s, or 0: none"),
        ({"Thld2": -1.0}, "Thld2 = -1.0, allowed: at least 0"),
        ({"REECA": 0, "Thld": 0.1}, "only REEC_A holds after a dip: set REECA to 1"),
        ({"Vdip": 1.1, "Thld": 0.1}, "its rate 800 1/s, as 0.959127 is below Vdip = 1.1"),
    ],
)
def test_what_has_no_meaning_or_rest_is_named(more, says):
    with pytest.raises(CaseError) as reported:
        operating_point(with_converter(**more))
    assert says in str(reported.value)


RECORD = """4 'REGCA1' 1 0 0.02 10 0.9 0.4 1.22 1.2 0.8 0.4 -1.3 0.02 0.7 99 -99 0.7 /
4 'REECA1' 1 0 0 0 0 0 0 0.85 1.2 0.02 -0.05 0.05 2 1.1 -1.1 0 0.15 -0.5 0.25 0.05 0.8 -0.8 1.1 0.9 0 0.1 0
  40 0 0.02 9 -9 1 0 1.3 0.02 0 0 0 0 0 0 0 0 0 0 0 0 0 0 0 0 /
"""


def test_a_record_holds_after_a_dip(tmp_path):
    case = import_psse(*pair_with(tmp_path, RECORD)).case
    values = case.converters[0].control.parameters
    assert [values[key] for key in ("REECA", "Iqfrz", "Thld", "Thld2")] == [1.0, 0.15, -0.5, 0.25]
    plant = BlockShim(plant_block(case))
    assert any(name.endswith(".since") for name in plant.state_names)
    assert np.max(np.abs(plant.derivatives(plant.x)[0])) < 1e-8
