"""Modulation of reactive power or ac voltage at the ends of a VSC link: derivatives, rest, limits, names."""

from __future__ import annotations

import numpy as np
import pytest
from independent.vsc_link import Side
from plant_shim import BlockShim
from test_vsc_link import ROW, between, shown, with_link

from interarea.models.blocks.plant import plant_block
from interarea.models.case.case import load_case
from interarea.models.errors import CaseError
from interarea.models.grid.equilibrium import operating_point
from interarea.models.grid.powerflow import solve_powerflow

ENDS = ("from", "to")
KEEPS = [{}, {"from_keeps": "v"}, {"to_keeps": "v"}, {"from_keeps": "v", "to_keeps": "v"}]


def inputs_of(row):
    """Return the names of its inputs as its row has to give them."""
    return ["vsc1_p_mod", *(f"vsc1_{row.get(f'{end}_keeps', 'q')}_mod_{end}" for end in ENDS)]


def moved(case, stop_s=3.0, **inputs):
    """Return what is shown and the states after steps of inputs at 0 s; case: with more of its keys."""
    plant = BlockShim(plant_block(case, more=["vsc1.*", "bus2.v", "bus3.v"]))
    u = plant.u.copy()
    for name, value in inputs.items():
        u[plant.input_names.index(name)] = value
    _, x, y = plant.run(stop_s, 0.001, u)
    return shown(plant, y[-1]), dict(zip(plant.state_names, x[-1], strict=True))


def changed(case, **row):
    return case.with_changes({"vscs": {"vsc1": row}})


@pytest.mark.parametrize("row", KEEPS)
def test_an_input_has_the_name_of_what_its_end_keeps(row):
    block = plant_block(with_link(**row))
    inputs = [v for v in block.table.reals if v.role == "input" and v.name.startswith("vsc1_")]
    assert [v.name for v in inputs] == inputs_of(row)
    for variable, end in zip(inputs[1:], ENDS, strict=True):
        assert f"{end}_bus of vsc1" in variable.description
        assert ("voltage" if "v_mod" in variable.name else "reactive power") in variable.description


@pytest.mark.parametrize("network", ["dense", "sparse"])
@pytest.mark.parametrize("row", KEEPS)
def test_the_derivatives_by_its_inputs_are_complex_steps_of_its_device_and_have_a_closed_form(network, row):
    """Of q: 1/(u TI) into the current; of v: KPV/TI, and KIV into the integral; nothing at the other end."""
    case = with_link(**row)
    plant = BlockShim(plant_block(case, network=network))
    link = next(d for d in operating_point(case).controls.devices if d.prefix == "vsc1")
    flow = solve_powerflow(case)
    seen = {
        "p_mod": 0.0,
        "q_mod1": 0.0,
        "q_mod2": 0.0,
        "v1": abs(flow.voltage(7)),
        "v2": abs(flow.voltage(9)),
    }
    seen |= {"p1": flow.at_buses[0].real / 2.0, "p2": flow.inverters[0].real / 2.0}
    signals = ("p_mod", "q_mod1", "q_mod2")
    places = [plant.state_names.index(f"vsc1.{s.name}") for s in link.rest.instance.states]
    for k, (name, signal) in enumerate(zip(inputs_of(row), signals, strict=True)):
        vu = np.zeros(len(plant.u))
        vu[plant.input_names.index(name)] = 1.0
        rates, outputs = plant.directional(np.zeros(len(plant.x)), vu, plant.x, plant.u)
        _, expected = link.rest.instance.run([complex(v) for v in link.rest.states], seen | {signal: 1e-30j})
        slopes = np.array([complex(v).imag / 1e-30 for v in expected])
        assert np.max(np.abs(rates[places] - slopes)) < 1e-9 * np.max(np.abs(slopes))
        assert np.count_nonzero(rates) == np.count_nonzero(slopes) > 0
        assert not np.any(outputs)
        if k > 0:
            closed = {f"vsc1.iq{k}": 1.0 / (0.01 * seen[f"v{k}"])}
            if "v_mod" in name:
                closed = {f"vsc1.iq{k}": 1.0 / 0.01, f"vsc1.iqv{k}": 20.0}
            nonzero = {n: r for n, r in zip(plant.state_names, rates, strict=True) if r != 0.0}
            assert nonzero == pytest.approx(closed, rel=1e-12)


@pytest.mark.parametrize("network", ["dense", "sparse"])
@pytest.mark.parametrize("row", KEEPS)
def test_the_derivatives_off_rest_are_those_of_differences(network, row):
    """In a random direction of states and all inputs, the modulations not at 0."""
    errors = BlockShim(plant_block(with_link(**row), network=network)).directional_errors(1e-3, 1e-4)
    assert max(errors) < 1e-9


@pytest.mark.slow
@pytest.mark.parametrize("P", [0.9, -0.6])
@pytest.mark.parametrize("step", [0.1, -0.1])
def test_a_step_of_reactive_power_ends_at_the_power_flow_with_so_much_more(P, step):
    """u^4 - (E^2 + 2 X Q) u^2 + X^2 (P^2 + Q^2) = 0 at each end; there the voltage is that of another Q."""
    case, link = between(P, "q", "p")
    before, _ = moved(case, stop_s=0.01)
    link.start()
    out = link.dc_current(P, 1.0) - link.loss[1]
    for end, bus, k in (("from", 2, 0), ("to", 3, 1)):
        y, x = moved(case, **{f"vsc1_q_mod_{end}": step})
        Q = [link.Q[j] + step * (j == k) for j in (0, 1)]
        for j, (side, p) in enumerate(zip(link.ends, (-P, out), strict=True)):
            u, ip, iq = side.at_rest(p, Q[j])
            assert y[f"bus{2 + j}.v"] == pytest.approx(u, abs=1e-9)
            assert (x[f"vsc1.ip{j + 1}"], x[f"vsc1.iq{j + 1}"]) == pytest.approx((ip, iq), abs=1e-9)
        assert y[f"vsc1.q_{end}"] == pytest.approx(Q[k], abs=1e-9)
        assert (y[f"bus{bus}.v"] - before[f"bus{bus}.v"]) * step > 0.01 * step * step


@pytest.mark.slow
@pytest.mark.parametrize("end", ENDS)
def test_a_step_of_voltage_ends_at_that_voltage_with_the_reactive_power_that_it_takes(end):
    """Against (u (u - X iq))^2 + (X P)^2 = (u E)^2 of the source behind its reactance."""
    case, link = between(0.7, "v", "p")
    before, _ = moved(case, stop_s=0.01)
    y, _ = moved(case, stop_s=8.0, **{f"vsc1_v_mod_{end}": 0.02})
    k, bus = (0, 2) if end == "from" else (1, 3)
    side, u, P = link.ends[k], before[f"bus{bus}.v"] + 0.02, y[f"vsc1.p_{end}"]
    Q = (u * u - np.sqrt((u * side.E) ** 2 - (side.X * P) ** 2)) / side.X
    assert y[f"bus{bus}.v"] == pytest.approx(u, abs=1e-8)
    assert y[f"vsc1.q_{end}"] == pytest.approx(Q, abs=1e-7)
    assert y[f"bus{5 - bus}.v"] == pytest.approx(
        before[f"bus{5 - bus}.v"], abs=1e-8
    )  # the other end keeps it


@pytest.mark.slow
@pytest.mark.parametrize(("keeps", "limit"), [("q", "q_mod_pu"), ("v", "v_mod_pu")])
@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_beyond_its_limit_an_input_does_no_more(keeps, limit, sign):
    case = changed(between(0.5, keeps, "p")[0], **{limit: 0.03})
    for end in ENDS:
        name = f"vsc1_{keeps}_mod_{end}"
        (at, _), (beyond, _), (below, _) = (moved(case, **{name: sign * size}) for size in (0.03, 5.0, 0.02))
        assert beyond == pytest.approx(at, abs=1e-9)
        assert abs(at[f"vsc1.q_{end}"] - below[f"vsc1.q_{end}"]) > 5e-3


@pytest.mark.parametrize("end", ENDS)
@pytest.mark.parametrize("first", ["p", "q"])
def test_at_the_current_limit_the_component_with_priority_has_all_it_asks_for(end, first):
    """1 pu of reactive power beside .9 pu of power, 1.1 pu of current."""
    case, link = between(0.9, "q", first)
    case = changed(case, q_mod_pu=2.0)
    k, bus = (0, 2) if end == "from" else (1, 3)
    before, _ = moved(case, stop_s=0.01)
    y, x = moved(case, **{f"vsc1_q_mod_{end}": 1.0})
    ip, iq, u = x[f"vsc1.ip{k + 1}"], x[f"vsc1.iq{k + 1}"], y[f"bus{bus}.v"]
    assert np.hypot(ip, iq) == pytest.approx(1.1, abs=1e-6)
    expected = link.Q[k] + 1.0
    if first == "p":
        assert y[f"vsc1.p_{end}"] == pytest.approx(before[f"vsc1.p_{end}"], abs=1e-6)
        assert y[f"vsc1.q_{end}"] < expected - 0.05
    else:
        assert y[f"vsc1.q_{end}"] == pytest.approx(expected, abs=1e-6)
        assert abs(y[f"vsc1.p_{end}"]) < abs(before[f"vsc1.p_{end}"]) - 0.02
    side: Side = link.ends[k]
    assert u == pytest.approx(side.volts(ip, iq), abs=1e-9)


def test_both_ends_modulate_without_each_other_and_beside_the_power():
    """Steps of all three inputs where the ends have their own voltages: each ends where it would alone."""
    case, link = between(0.5, "q", "p")
    steps = {"vsc1_p_mod": 0.05, "vsc1_q_mod_from": 0.04, "vsc1_q_mod_to": -0.07}
    y, _ = moved(case, **steps)
    assert y["vsc1.p_from"] == pytest.approx(-0.55, abs=1e-8)
    assert y["vsc1.p_to"] == pytest.approx(link.dc_current(0.55, 1.0) - link.loss[1], abs=1e-7)
    assert (y["vsc1.q_from"], y["vsc1.q_to"]) == pytest.approx((0.14, 0.08), abs=1e-8)


@pytest.mark.parametrize("key", ["q_mod_pu", "v_mod_pu"])
@pytest.mark.parametrize("value", [0.0, -0.1, float("nan")])
def test_a_limit_that_is_not_above_0_is_refused_with_the_key(key, value):
    with pytest.raises(CaseError) as caught:
        load_case("two-area-thesis").with_changes({"vscs": {"vsc1": ROW | {key: value}}})
    assert f"vsc1.{key}" in str(caught.value) and "allowed" in str(caught.value)
    assert "\n" not in str(caught.value)
