"""Batteries, REGC_A with REEC_C: state of charge in closed form, what happens at its ends, its record."""

from __future__ import annotations

import itertools

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

STORE = {"BATTERY": 1, "PMIN": -1.0, "Tsoc": 3600.0, "SOCini": 0.5, "SOCmin": 0.2, "SOCmax": 0.8}
SHARE = 2.0  #: its base over that of the case


def with_battery(base="two-area-thesis", P_mw=100.0, **more):
    row = {"bus": 8, "base_mva": 100.0 * SHARE, "P_mw": P_mw, "Q_mvar": 20.0}
    row["control"] = {"kind": "wecc_converter"} | STORE | more
    return load_case(base).with_changes({"converters": {"b1": row}})


def run(case, seconds, p_mod, events=(), step_s=0.002):
    """Return time, voltage of its bus, its states and its power on its own base after p_mod steps at once."""
    block = plant_block(case, more=["bus8.v"])
    plant = BlockShim(block, event_parameters(case, events_of(list(events), where="test")))
    u = plant.u.copy()
    u[plant.input_names.index("b1_p_mod")] = p_mod
    time_s, x, y = plant.run(seconds, step_s, u)
    states = {n.removeprefix("b1."): x[:, k] for k, n in enumerate(plant.state_names) if n.startswith("b1.")}
    at = {name: y[:, k] for k, name in enumerate(plant.output_names)}
    return time_s, at["bus8.v"], states, at["b1.p"] / SHARE


@pytest.mark.parametrize(("network", "base"), [("dense", "two-area-thesis"), ("sparse", "kundur-manual")])
@pytest.mark.parametrize("P_mw", [100.0, -100.0])
def test_it_rests_and_the_derivatives_are_those_of_differences(network, base, P_mw):
    plant = BlockShim(plant_block(with_battery(base, P_mw), network=network))
    assert "b1.soc" in plant.state_names
    rates, y = plant.derivatives(plant.x)
    assert np.max(np.abs(rates)) < 5e-11
    assert y[plant.output_names.index("b1.p")] == pytest.approx(P_mw / 100.0, abs=1e-11)
    off, outputs_off = plant.directional_errors(1e-4, 1e-5)
    assert off < 1e-7 and outputs_off < 1e-6


@pytest.mark.slow
def test_at_rest_it_stands_for_20_s_and_a_plant_without_store_has_no_such_state():
    _, _, states, p = run(with_battery(), 20.0, 0.0)
    assert max(np.max(np.abs(course - course[0])) for course in (*states.values(), p)) < 1e-12
    assert "b1.soc" not in BlockShim(plant_block(with_battery(BATTERY=0))).state_names


@pytest.mark.slow
@pytest.mark.parametrize("p_mod", [0.1, -0.2])
def test_the_charge_falls_by_what_it_gives_beyond_its_rest(p_mod):
    """soc = SOCini - (1/Tsoc) int (p - p0) dt; once the order is carried out, by p_mod t/Tsoc."""
    time_s, _, states, p = run(with_battery(), 10.0, p_mod)
    energy = np.append(0.0, np.cumsum(np.diff(time_s) * 0.5 * (p[1:] + p[:-1] - 2.0 * 0.5)))
    assert states["soc"] == pytest.approx(0.5 - energy / 3600.0, abs=1e-9)
    late = time_s > 5.0
    slope = np.polyfit(time_s[late], states["soc"][late], 1)[0]
    assert slope == pytest.approx(-p_mod / 3600.0, rel=2e-2)  # vt moves while the measured one follows


PARTS = 10  #: of a step of the plant


def block_diagram(time_s, volts, p_mod, p):
    """Integrate order, current and charge at the given voltages by Heun's method: REEC_C as published."""

    def rates(s, v, step):
        vm, pord, ip, soc = s
        most = 0.0 if soc <= p["SOCmin"] else 1.1
        least = 0.0 if soc >= p["SOCmax"] else -1.1
        command = min(max(min(max(pord, -1.0), 1.0) / max(vm, 0.01), least), most)
        rate = min(max((0.5 + step - pord) / 0.02, -99.0), 99.0)
        taken = v * ip - (0.5 if least * most else 0.0)
        return np.array([(v - vm) / 0.02, rate, min((command - ip) / 0.02, 10.0), -taken / p["Tsoc"]])

    s = np.array([volts[0], 0.5, 0.5 / volts[0], p["SOCini"]])
    course = [s]
    for k in range(len(time_s) - 1):
        h = (time_s[k + 1] - time_s[k]) / PARTS
        between = np.linspace(volts[k], volts[k + 1], PARTS + 1)
        for v, following in itertools.pairwise(between):
            first = rates(s, v, p_mod)
            s = s + h / 2 * (first + rates(s + h * first, following, p_mod))
        course.append(s)
    return dict(zip(("vm", "pord", "ip", "soc"), np.array(course).T, strict=True))


@pytest.mark.parametrize(("p_mod", "end"), [(0.4, "SOCmin"), (-1.2, "SOCmax")])
def test_at_its_ends_it_gives_or_takes_nothing_as_in_the_block_diagram(p_mod, end):
    """Empty, its active current may only be below 0, full only above: against another writing of it."""
    more = {"Tsoc": 4.0, "SOCini": 0.5}
    time_s, volts, states, p = run(with_battery(**more), 6.0, p_mod)
    expected = block_diagram(time_s, volts, p_mod, STORE | more)
    reached = np.flatnonzero(states["soc"] <= STORE[end] if end == "SOCmin" else states["soc"] >= STORE[end])
    assert 500 < reached[0] < 2000
    for name in ("pord", "ip", "soc"):
        before = np.arange(len(time_s)) < reached[0] - 2
        assert states[name][before] == pytest.approx(expected[name][before], abs=2e-5), name
    assert states["soc"] == pytest.approx(expected["soc"], abs=5e-4)
    assert np.max(np.abs(p[reached[0] + 100 :])) < 2e-3


@pytest.mark.parametrize(("soc", "least", "most"), [(0.1, -1.1, 0.0), (0.5, -1.1, 1.1), (0.9, 0.0, 1.1)])
@pytest.mark.parametrize("order", [0.4, -0.4])
def test_an_empty_battery_takes_charge_and_a_full_one_gives_it(soc, least, most, order):
    """Tg ip' is the order over the voltage within the ends; Tsoc soc' = -p there, p0 - p between."""
    plant = BlockShim(plant_block(with_battery()))
    x, at = plant.x.copy(), {n.removeprefix("b1."): k for k, n in enumerate(plant.state_names)}
    x[at["soc"]], x[at["pord"]] = soc, order
    rates, y = plant.derivatives(x)
    expected = np.clip(order / x[at["vm"]], least, most)
    assert rates[at["ip"]] == pytest.approx((expected - x[at["ip"]]) / 0.02, rel=1e-12)
    p = y[plant.output_names.index("b1.p")] / SHARE
    between = 0.2 < soc < 0.8
    assert rates[at["soc"]] == pytest.approx(((0.5 if between else 0.0) - p) / 3600.0, abs=1e-14)


def test_the_sparse_blocks_have_its_state_matrix():
    blocks, _, _ = agreeing_blocks(in_plant_order(with_battery()))
    assert blocks.inputs[-2:] == ("b1_p_mod", "b1_q_mod")


@pytest.mark.parametrize(
    ("P_mw", "more", "says"),
    [
        (100.0, {"SOCini": 0.2}, "at the equilibrium, above ipmax = 0"),
        (-100.0, {"SOCini": 0.8}, "at the equilibrium, below ipmin = -0"),
        (100.0, {"SOCini": 1.2}, "SOCini = 1.2, allowed: at least 0 and at most 1"),
        (100.0, {"SOCmax": 0.1}, "SOCmin = 0.2, SOCmax = 0.1, allowed: SOCmin <= SOCmax; swap them"),
    ],
)
def test_what_cannot_rest_is_named(P_mw, more, says):
    with pytest.raises(CaseError) as reported:
        operating_point(with_battery(P_mw=P_mw, **more))
    assert says in str(reported.value)


RECORD = """4 'REGCA1' 1 0 0.02 10 0.9 0.4 1.22 1.2 0.8 0.4 -1.3 0.02 0.7 99 -99 0.7 /
4 'NAME' 1 0 0 0 0 0 -99 99 0.02 0 0 0 1.1 -1.1 0 0.05 0.8 -0.8 1.1 0.9 0 0.1 0 40 0.02 9 -9 1 -1 1.3 0.02
  0 0 0 0 0 0 0 0 0 0 0 0 0 0 0 0 7200 0.6 0.9 0.1 /
"""


def imported(folder, record):
    return import_psse(*pair_with(folder, record)).case


@pytest.mark.parametrize("name", ["REECC1", "REECCU1"])
def test_a_record_becomes_a_battery(tmp_path, name):
    record = RECORD.replace("NAME", name)
    if name == "REECCU1":  # a user-written one: 5 whole numbers, 45 reals
        record = record.replace("4 'REECCU1' 1", "4 'USRMDL' 1 'REECCU1' 102 0 5 45 7 6")
    case = imported(tmp_path, record)
    values = case.converters[0].control.parameters
    result = [values[key] for key in ("BATTERY", "REECA", "PMIN", "Tsoc", "SOCini", "SOCmax", "SOCmin")]
    assert result == [1.0, 0.0, -1.0, 7200.0, 0.6, 0.9, 0.1]
    plant = BlockShim(plant_block(case))
    assert np.max(np.abs(plant.derivatives(plant.x)[0])) < 1e-8


def test_a_second_electrical_control_is_refused(tmp_path):
    record = RECORD.replace("NAME", "REECC1")
    b = RECORD.splitlines()[1].replace("NAME", "REECB1") + " /"
    with pytest.raises(CaseError, match=r"G4 has REECB1 and REECC1, allowed: one"):
        imported(tmp_path, record + b + "\n")
