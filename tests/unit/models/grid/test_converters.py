"""Converter plants at buses: they rest, their derivatives are exact, limits hold."""

from __future__ import annotations

import numpy as np
import pytest
from plant_shim import BlockFailure, BlockShim
from sparse_blocks import agreeing_blocks

from interarea.cosim.explorer.wasm import page_sources
from interarea.models.blocks.plant import event_parameters, plant_block
from interarea.models.case.case import load_case
from interarea.models.case.events import events_of
from interarea.models.errors import CaseError
from interarea.models.grid.equilibrium import operating_point
from interarea.models.grid.machine_tables import in_plant_order

PLANT = {"PLANT": 1, "plant_Kp": 18.0, "plant_Ki": 5.0, "plant_Tfv": 0.05, "plant_Tfltr": 0.02}
ACTIVE = {"plant_FFLAG": 1, "plant_Kpg": 1.0, "plant_Kig": 0.05, "plant_Tp": 0.25, "plant_Tg": 0.1}
#: name -> parameters, states
CONTROLS = {
    "alone": ({}, 5),
    "plant": (PLANT | ACTIVE, 11),
    "voltage": ({"QFLAG": 1, "VFLAG": 1}, 6),
    "factor": ({"PFFLAG": 1, "PQFLAG": 1, "LVPLSW": 1}, 7),
    "remote": (PLANT | {"plant_REFFLAG": 1, "plant_VCFLAG": 1, "plant_Xc": 0.05, "plant_Kp": 1.0}, 8),
}


def with_converter(control="alone", base="two-area-thesis", **more):
    parameters = CONTROLS[control][0] | more
    row = {"bus": 8, "base_mva": 200.0, "P_mw": 100.0, "Q_mvar": 20.0}
    row["control"] = {"kind": "wecc_converter"} | parameters
    return load_case(base).with_changes({"converters": {"pv1": row}})


@pytest.mark.parametrize(
    ("control", "network", "base"),
    [*((c, "dense", "two-area-thesis") for c in CONTROLS), ("plant", "sparse", "kundur-manual")],
)
def test_it_rests_and_the_derivatives_are_those_of_differences(control, network, base):
    plant = BlockShim(plant_block(with_converter(control, base), network=network))
    own = np.array([n.startswith("pv1.") for n in plant.state_names])
    assert own.sum() == CONTROLS[control][1]
    rates, y = plant.derivatives(plant.x)
    assert np.max(np.abs(rates)) < 5e-11
    assert y[plant.output_names.index("pv1.p")] == pytest.approx(1.0, abs=1e-11)
    assert y[plant.output_names.index("pv1.q")] == pytest.approx(0.2, abs=1e-11)
    rates_off, outputs_off = plant.directional_errors(1e-4, 1e-5)
    assert rates_off < 1e-7
    assert outputs_off < 1e-6


def test_its_current_is_that_of_the_closed_form_and_it_stops_at_imax():
    """Active current is asked beyond Imax; S/V is then Imax, and p_mod does nothing more."""
    plant = BlockShim(plant_block(with_converter("alone", Imax=0.6), more=["bus8.v"]))
    u = plant.u.copy()
    u[plant.input_names.index("pv1_p_mod")] = 1.0
    _, x, y = plant.run(1.0, 0.002, u)
    p, q, v = (y[-1, plant.output_names.index(key)] for key in ("pv1.p", "pv1.q", "bus8.v"))
    states = {n: x[-1, k] for k, n in enumerate(plant.state_names)}
    assert complex(p, q) == pytest.approx(2.0 * v * complex(states["pv1.ip"], states["pv1.iq"]), abs=1e-12)
    assert abs(complex(p, q)) / v / 2.0 == pytest.approx(0.6, abs=1e-3)
    assert p > 1.05  # so it did move


def test_a_deadband_of_no_width_is_none_in_the_linear_model():
    """The plant control acts: d rpi' = Ki d e and d qext' = (Kp d e + d rpi - d qext)/Tfv, e the error."""
    shim = BlockShim(plant_block(with_converter("remote", plant_Kp=2.0, plant_Ki=5.0)))
    A, at = shim.jacobians()[0], {n: k for k, n in enumerate(shim.state_names)}
    measured, integral, order = (at[f"pv1.{n}"] for n in ("rv", "rpi", "qext"))
    assert A[integral, measured] == pytest.approx(-5.0)
    assert A[order, measured] == pytest.approx(-2.0 / PLANT["plant_Tfv"])
    by_voltage = BlockShim(plant_block(with_converter("alone", Kqv=2.0)))
    at = {n: k for k, n in enumerate(by_voltage.state_names)}
    # iq' = (iqcmd - iq)/Tg, of which Kqv (Vref0 - vm)
    assert by_voltage.jacobians()[0][at["pv1.iq"], at["pv1.vm"]] < -2.0 / 0.02 + 15.0


def _into_branches(case, bus, V):
    """Return the current that leaves a bus over its branches, from the voltages of both their ends."""
    current = 0j
    for row in case.branches:
        if bus in (row.from_bus, row.to_bus):
            a, b = (
                (V[row.from_bus], V[row.to_bus]) if row.from_bus == bus else (V[row.to_bus], V[row.from_bus])
            )
            current += (a - b) / complex(row.r, row.x) + 0.5j * row.b * a
    return current


@pytest.mark.parametrize("network", ["dense", "sparse"])
def test_after_a_trip_its_current_is_zero_and_the_bus_balances(network):
    """Kirchhoff's law at its bus, where nothing else is: the branches take what it gives, then nothing."""
    case = with_converter("plant")
    assert not any(row.bus == 8 for row in (*case.loads, *case.shunts, *case.machines))
    events = events_of([{"kind": "device_trip", "device": "pv1", "start_s": 0.1}], where="test")
    block = plant_block(case, network=network, more=["*"])
    plant = BlockShim(block, event_parameters(case, events))
    time_s, x, y = plant.run(0.3, 0.002)
    at = {name: k for k, name in enumerate(plant.output_names)}
    power = y[:, at["pv1.p"]] + 1j * y[:, at["pv1.q"]]
    for k in (0, 20, len(time_s) - 1):
        V = {
            bus.number: complex(*(y[k, at[f"bus{bus.number}.{part}"]] for part in ("re", "im")))
            for bus in case.buses
        }
        outflow = V[8] * np.conj(_into_branches(case, 8, V))
        assert outflow == pytest.approx(power[k], abs=1e-10)
    assert power[20] == pytest.approx(1.0 + 0.2j, abs=1e-9)
    tripped = time_s > 0.101
    assert np.all(power[tripped] == 0.0)
    own = [k for k, name in enumerate(plant.state_names) if name.startswith("pv1.")]
    assert np.array_equal(x[-1, own], x[np.flatnonzero(tripped)[0], own])


def test_its_controls_hold_their_states_in_a_dip():
    """Below plant_Vfrz the plant control stands, below Vdip the electrical one, to the last bit."""
    more = {"plant_Kp": 1.0, "plant_Vfrz": 0.9, "Vdip": 0.9, "QFLAG": 1, "VFLAG": 1}
    case = with_converter("remote", **more)
    dip = {"kind": "bus_fault", "bus": 8, "start_s": 0.1, "end_s": 0.2, "x_pu": 0.05}
    plant = BlockShim(
        plant_block(case, more=["bus8.v"]), event_parameters(case, events_of([dip], where="test"))
    )
    time_s, x, y = plant.run(0.6, 0.001)
    low = y[:, plant.output_names.index("bus8.v")] < 0.9
    held = np.flatnonzero(low & (time_s > 0.1005) & (time_s < 0.1995))
    assert len(held) > 90
    at = {name: k for k, name in enumerate(plant.state_names)}
    for name in ("rpi", "vq", "iqpi"):
        course = x[:, at[f"pv1.{name}"]]
        assert np.all(course[held] == course[held[0]])
        assert np.ptp(course[time_s > 0.25]) > 1e-7
    assert np.ptp(x[held, at["pv1.rv"]]) > 0.01  # the measurement does not stand


@pytest.mark.parametrize(
    ("more", "says"),
    [
        ({"Imax": 0.4}, "is 0.5213 at the equilibrium, above"),
        ({"QMAX": 0.05}, "qlim is 0.1 at the equilibrium, above QMAX = 0.05"),
        ({"PFFLAG": 1, "QFLAG": 1}, "a power factor gives a reactive power, not a voltage"),
    ],
)
def test_what_cannot_rest_is_named(more, says):
    with pytest.raises(CaseError) as reported:
        operating_point(with_converter("alone", **more))
    assert says in str(reported.value).replace("0.521308", "0.5213")


@pytest.mark.slow
def test_a_page_of_a_grid_without_devices_at_buses_takes_none():
    """PLANT_NO_BUS_DEVICES leaves their code out: the bits stay, a grid with devices is refused."""
    case, alone = load_case("two-area-thesis"), ("-DPLANT_NO_BUS_DEVICES", "-O0")
    whole, without = (BlockShim(plant_block(case), flags=flags) for flags in ((), alone))
    for one, other in zip(
        whole.derivatives(whole.x + 1e-3), without.derivatives(whole.x + 1e-3), strict=True
    ):
        assert np.array_equal(one, other)
    with pytest.raises(BlockFailure, match=r"port\.table"):
        BlockShim(plant_block(with_converter("plant")), flags=alone)
    assert page_sources(load_case("two-area-svc"))["layout.h"].count(b"PLANT_NO_BUS_DEVICES") == 1
    assert page_sources(case)["layout.h"].count(b"PLANT_NO_BUS_DEVICES") == 2


@pytest.mark.parametrize("control", ["plant", "voltage"])
def test_the_sparse_blocks_have_its_state_matrix(control):
    """`interarea import` judges a large grid by these blocks; each of the two inputs has its own column."""
    case = in_plant_order(with_converter(control))
    blocks, _, B = agreeing_blocks(case)
    assert blocks.inputs[-2:] == ("pv1_p_mod", "pv1_q_mod")
    assert np.all(np.abs(B[:, -2:]).max(axis=0) > 0.05)
