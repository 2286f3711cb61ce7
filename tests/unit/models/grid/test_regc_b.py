"""Converters REGC_B, a voltage behind an impedance: its current, its rest, its block diagram, its record."""

from __future__ import annotations

import numpy as np
import pytest
from grid_text import pair_with
from one_converter import SHARE, X_TO_BUS, behind_a_line, beside_machines, course, solved, states_of
from plant_shim import BlockShim
from sparse_blocks import agreeing_blocks

from interarea.models.blocks.plant import event_parameters, plant_block
from interarea.models.case.case import load_case
from interarea.models.case.events import events_of
from interarea.models.errors import CaseError
from interarea.models.grid.equilibrium import operating_point
from interarea.models.grid.machine_tables import in_plant_order
from interarea.models.importers.psse import import_psse

BEHIND = {"REGCB": 1, "Re": 0.01, "Xe": 0.2, "Te": 0.01, "Imax": 1.3}


def with_converter(base="two-area-thesis", **more):
    return beside_machines(BEHIND | more, base)


@pytest.mark.parametrize("more", [{}, {"RATEFLAG": 1, "PQFLAG": 1}, {"Re": 0.0}])
@pytest.mark.parametrize(("network", "base"), [("dense", "two-area-thesis"), ("sparse", "kundur-manual")])
def test_it_rests_and_the_derivatives_are_those_of_differences(network, base, more):
    plant = BlockShim(plant_block(with_converter(base, **more), network=network))
    own = states_of(plant)
    assert {"ipg", "iqg", "ip", "iq"} < set(own) and len(own) == 7 + more.get("RATEFLAG", 0)
    rates, y = plant.derivatives(plant.x)
    assert np.max(np.abs(rates)) < 5e-11
    assert y[plant.output_names.index("pv1.p")] == pytest.approx(1.0, abs=1e-11)
    assert y[plant.output_names.index("pv1.q")] == pytest.approx(0.2, abs=1e-11)
    off, outputs_off = plant.directional_errors(1e-4, 1e-5)
    assert off < 1e-7 and outputs_off < 1e-6


def test_its_power_is_that_of_a_voltage_behind_its_impedance():
    """S = V conj((E - V)/(Re + jXe)), E in the frame of V by both states; off rest and in a fault too."""
    fault = {"kind": "bus_fault", "bus": 9, "start_s": 0.05, "end_s": 0.1, "x_pu": 0.05}
    block = plant_block(with_converter(), more=["bus8.v"])
    plant = BlockShim(block, event_parameters(with_converter(), events_of([fault], where="test")))
    _, x, y = plant.run(0.3, 0.001)
    at = states_of(plant)
    z, u = complex(0.01, 0.2), y[:, plant.output_names.index("bus8.v")]
    E = z * (x[:, at["ip"]] - 1j * x[:, at["iq"]])
    S = SHARE * u * np.conj((E - u) / z)
    for part, expected in (("p", S.real), ("q", S.imag)):
        assert y[:, plant.output_names.index(f"pv1.{part}")] == pytest.approx(expected, abs=1e-11)
    assert np.ptp(u) > 0.1


@pytest.mark.slow
def test_at_rest_it_stands_for_20_s():
    _, own, _ = course(with_converter(), 20.0, 0.002)
    assert max(np.max(np.abs(path - path[0])) for path in own.values()) < 1e-12


def block_diagram(first, at, p, p_mod, q_mod):
    """Integrate the published diagram with scipy; bus voltage by |u (1 + jX Y) - jX E Y| = 1, a quadratic."""
    Y, jX = 1.0 / complex(p["Re"], p["Xe"]), 1j * X_TO_BUS

    def volts(y):
        c, d = 1.0 + jX * Y, -jX * y
        a, b, e = abs(c) ** 2, (np.conj(c) * d).real, abs(d) ** 2 - 1.0
        return (-b + np.sqrt(b * b - a * e)) / a

    def rates(t, s):
        vm, vf, pord, iql, ipg, iqg, ip, iq = s
        u = volts(ip - 1j * iq)
        most = min(p["Imax"], p["ICON"])
        iqc = np.clip(iql, -most, most)
        ipc = np.clip(pord / vm, 0.0, np.sqrt(most**2 - iqc**2))
        towards = ipc * vf if p["RATEFLAG"] else ipc
        current = ipg / vf if p["RATEFLAG"] else ipg
        target = (current - 1j * iqg) + u * Y
        return [
            (u - vm) / 0.02,
            (u - vf) / 0.02,
            (0.5 + p_mod - pord) / 0.02,
            ((0.1 + q_mod) / vm - iql) / 0.02,
            min((towards - ipg) / 0.02, p["Rrpwr"]),
            min((iqc - iqg) / 0.02, p["Iqrmax"]),
            (target.real - ip) / p["Te"],
            (-target.imag - iq) / p["Te"],
        ]

    begin = [first.get(name, first["vm"]) for name in ORDER]
    return dict(zip(ORDER, solved(rates, begin, at), strict=True))


ORDER = ("vm", "vf", "pord", "iqlag", "ipg", "iqg", "ip", "iq")


@pytest.mark.slow
@pytest.mark.parametrize(
    ("more", "reaches"),
    [
        ({}, {}),
        ({"RATEFLAG": 1, "Rrpwr": 2.0}, {"Rrpwr": 9.0}),
        ({"Rrpwr": 2.0, "Iqrmax": 1.0}, {"Rrpwr": 9.0, "Iqrmax": 9.0}),
        ({"ICON": 0.7}, {"ICON": 9.0}),
    ],
)
def test_it_follows_the_block_diagram(more, reaches):
    """Orders of P and Q step at once; the diagram without what the run is about goes elsewhere."""
    p = {"RATEFLAG": 0, "Rrpwr": 10.0, "Iqrmax": 999.0, "ICON": 99.0} | BEHIND | more
    time_s, states, _ = course(behind_a_line(BEHIND | more), 0.5, 0.0005, {"p_mod": 0.3, "q_mod": 0.1})
    first = {name: path[0] for name, path in states.items()}
    expected = block_diagram(first, time_s, p, 0.3, 0.1)
    for name in ORDER:
        if name in states:
            assert states[name] == pytest.approx(expected[name], abs=2e-5), name
    if reaches:
        other = block_diagram(first, time_s, p | reaches, 0.3, 0.1)
        assert max(np.max(np.abs(other[name] - expected[name])) for name in ORDER) > 5e-3


def test_the_sparse_blocks_have_its_state_matrix():
    blocks, _, _ = agreeing_blocks(in_plant_order(with_converter()))
    assert blocks.inputs[-2:] == ("pv1_p_mod", "pv1_q_mod")


@pytest.mark.parametrize(
    ("more", "says"),
    [
        ({"ICON": 0.4}, "is 0.5213"),
        ({"LVPLSW": 1}, "REGC_B has no LVPLSW"),
        ({"REGCB": 0, "RATEFLAG": 1}, "REGC_A has no RATEFLAG"),
        ({"Te": 0.0}, "Te = 0.0, allowed: above 0"),
    ],
)
def test_what_has_no_meaning_or_rest_is_named(more, says):
    with pytest.raises(CaseError) as reported:
        operating_point(with_converter(**more))
    assert says in str(reported.value)


RECORD = """4 'REGCB1' 1 1 0 0.02 0.03 99 -99 10 0.015 1.2 /
4 'REECB1' 1 0 0 0 0 0 -99 99 0.02 0 0 0 1.1 -1.1 0 0.05 0.8 -0.8 1.1 0.9 0 0.1 0 40
  0.02 9 -9 1 0 1.3 0.02 /
"""


def imported(folder, record=RECORD):
    return import_psse(*pair_with(folder, record)).case


def test_a_record_becomes_a_converter_behind_the_impedance_of_the_raw_file(tmp_path):
    case = imported(tmp_path)
    values = case.converters[0].control.parameters
    result = [values[key] for key in ("REGCB", "RATEFLAG", "Tfltr", "Iqrmin", "Te", "ICON", "Imax")]
    assert result == [1.0, 1.0, 0.03, -99.0, 0.015, 1.2, 1.3]
    assert values["Xe"] == pytest.approx(load_case("kundur-pss").machine("G4").Xd1, rel=1e-9)
    plant = BlockShim(plant_block(case))
    assert np.max(np.abs(plant.derivatives(plant.x)[0])) < 1e-8


def test_two_converters_of_one_unit_are_refused(tmp_path):
    beside = "4 'REGCA1' 1 0 0.02 10 0.9 0.4 1.22 1.2 0.8 0.4 -1.3 0.02 0.7 99 -99 0.7 /\n"
    with pytest.raises(CaseError, match=r"G4 has REGCA1 and REGCB1, allowed: one"):
        imported(tmp_path, RECORD + beside)
