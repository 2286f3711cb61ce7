"""Converters REGC_C, a voltage by a phase-locked loop: its current, rest, block diagram, angles, record."""

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

LOCKED = {"REGCC": 1, "Re": 0.01, "Xe": 0.2, "Te": 0.01, "Imax": 1.3, "Kip": 0.5, "Kii": 20.0}
LOCKED |= {"Kppll": 30.0, "Kipll": 300.0}
STATES = {"wpll", "theta", "ipu", "iqu", "e", "delta", "ipg", "iqg"}
DROOP = {"PLANT": 1, "plant_FFLAG": 1, "plant_Kpg": 0.5, "plant_Kig": 0.5, "plant_Tp": 0.1, "plant_Tg": 0.1}
DROOP |= {"plant_Ddn": 10.0, "plant_Dup": 10.0, "plant_Kp": 1.0, "plant_Ki": 1.0, "plant_Tfltr": 0.02}


def with_converter(base="two-area-thesis", where=None, **more):
    return beside_machines(LOCKED | more, base, **(where or {}))


@pytest.mark.parametrize(
    ("more", "where"),
    [
        ({}, {}),
        ({"RATEFLAG": 1, "PQFLAG": 1}, {}),
        (DROOP, {}),
        (
            DROOP | {"plant_REFFLAG": 1, "plant_VCFLAG": 1, "plant_Xc": 0.05},
            {"regulates": 9, "measures": "8-9 a"},
        ),
    ],
)
@pytest.mark.parametrize(("network", "base"), [("dense", "two-area-thesis"), ("sparse", "kundur-manual")])
def test_it_rests_and_the_derivatives_are_those_of_differences(network, base, more, where):
    plant = BlockShim(plant_block(with_converter(base, where, **more), network=network))
    own = set(states_of(plant))
    assert own >= STATES and not {"ip", "iq"} & own
    rates, y = plant.derivatives(plant.x)
    assert np.max(np.abs(rates)) < 5e-11
    assert y[plant.output_names.index("pv1.p")] == pytest.approx(1.0, abs=1e-11)
    assert y[plant.output_names.index("pv1.q")] == pytest.approx(0.2, abs=1e-11)
    off, outputs_off = plant.directional_errors(1e-4, 1e-5)
    assert off < 1e-7 and outputs_off < 1e-6


@pytest.mark.parametrize("network", ["dense", "sparse"])
def test_its_power_is_that_of_a_voltage_behind_its_impedance(network):
    """S = V conj((E - V)/(Re + jXe)), E by its angle and size, off rest and in a fault too."""
    fault = {"kind": "bus_fault", "bus": 9, "start_s": 0.05, "end_s": 0.1, "x_pu": 0.05}
    case = with_converter()
    block = plant_block(case, network=network, more=["bus8.re", "bus8.im"])
    plant = BlockShim(block, event_parameters(case, events_of([fault], where="test")))
    _, x, y = plant.run(0.3, 0.001)
    at = states_of(plant)
    out = {n: y[:, k] for k, n in enumerate(plant.output_names)}
    V = out["bus8.re"] + 1j * out["bus8.im"]
    E = x[:, at["e"]] * np.exp(1j * x[:, at["delta"]])
    S = SHARE * V * np.conj((E - V) / complex(0.01, 0.2))
    for part, expected in (("p", S.real), ("q", S.imag)):
        assert out[f"pv1.{part}"] == pytest.approx(expected, abs=1e-10)
    assert np.ptp(np.abs(V)) > 0.1


@pytest.mark.slow
def test_at_rest_it_stands_for_20_s():
    _, own, _ = course(with_converter(), 20.0, 0.002)
    assert max(np.max(np.abs(path - path[0])) for path in own.values()) < 1e-9


def test_all_angles_together_move_nothing():
    """A r = 0 with r = 1 on the angles of rotors, of the loop and of its voltage."""
    plant = BlockShim(plant_block(with_converter(**DROOP | {"plant_Ddn": 0.0, "plant_Dup": 0.0})))
    angles = np.array([name.endswith((".delta", ".theta")) for name in plant.state_names], dtype=float)
    assert angles.sum() == 6
    A = plant.jacobians()[0]
    assert np.max(np.abs(A @ angles)) < 1e-9 * np.max(np.abs(A))


def block_diagram(first, at, p, p_mod, q_mod):
    """Integrate REGC_C by scipy with its voltage by components in the frame of the loop."""
    Y, line, z = 1.0 / complex(p["Re"], p["Xe"]), 1.0 / (1j * X_TO_BUS), complex(p["Re"], p["Xe"])

    def rates(t, s):
        vm, vf, pord, iql, ipg, iqg, xw, theta, xp, xq, ed, eq = s
        E = complex(ed, eq) * np.exp(1j * theta)
        V = (line + E * Y) / (line + Y)
        u, own = abs(V), V * np.exp(-1j * theta)
        most = min(p["Imax"], p["ICON"])
        iqc = np.clip(iql, -most, most)
        ipc = np.clip(pord / vm, 0.0, np.sqrt(most**2 - iqc**2))
        towards = ipc * vf if p["RATEFLAG"] else ipc
        expected = ipg / vf if p["RATEFLAG"] else ipg
        current = (complex(ed, eq) - own) * Y
        error_p, error_q = expected - current.real, iqg + current.imag
        voltage = complex(p["Kip"] * error_p + xp, -(p["Kip"] * error_q + xq))
        target = own + z * voltage
        w = p["Kppll"] * own.imag + xw
        stands = (w > p["wmax"] and own.imag > 0.0) or (w < p["wmin"] and own.imag < 0.0)
        return [
            (u - vm) / 0.02,
            (u - vf) / 0.02,
            (0.5 + p_mod - pord) / 0.02,
            ((0.1 + q_mod) / vm - iql) / 0.02,
            min((towards - ipg) / 0.02, p["Rrpwr"]),
            min((iqc - iqg) / 0.02, p["Iqrmax"]),
            0.0 if stands else p["Kipll"] * own.imag,
            np.clip(w, p["wmin"], p["wmax"]),
            p["Kii"] * error_p,
            p["Kii"] * error_q,
            (target.real - ed) / p["Te"],
            (target.imag - eq) / p["Te"],
        ]

    turned = first["e"] * np.exp(1j * (first["delta"] - first["theta"]))
    begin = [first.get(name, first["vm"]) for name in ORDER[:-2]] + [turned.real, turned.imag]
    return dict(zip(ORDER, solved(rates, begin, at), strict=True))


ORDER = ("vm", "vf", "pord", "iqlag", "ipg", "iqg", "wpll", "theta", "ipu", "iqu", "ed", "eq")


@pytest.mark.slow
@pytest.mark.parametrize(
    ("more", "reaches"),
    [
        ({}, {"Kip": 5.0}),
        ({"RATEFLAG": 1, "Rrpwr": 2.0}, {"Rrpwr": 9.0}),
        ({"Rrpwr": 2.0, "Iqrmax": 1.0}, {"Iqrmax": 9.0}),
        ({"ICON": 0.7}, {"ICON": 9.0}),
        ({"wmax": 0.3, "wmin": -0.3}, {"wmax": 9.0}),
    ],
)
def test_it_follows_the_block_diagram(more, reaches):
    """Orders of P and Q step at once; the diagram without what the run is about goes elsewhere."""
    p = {"RATEFLAG": 0, "Rrpwr": 10.0, "Iqrmax": 999.0, "ICON": 99.0, "wmax": 12.0, "wmin": -12.0}
    p |= LOCKED | more
    time_s, states, _ = course(behind_a_line(LOCKED | more), 0.5, 0.0005, {"p_mod": 0.3, "q_mod": 0.1})
    first = {name: path[0] for name, path in states.items()}
    turned = states["e"] * np.exp(1j * (states["delta"] - states["theta"]))
    states |= {"ed": turned.real, "eq": turned.imag}
    expected = block_diagram(first, time_s, p, 0.3, 0.1)
    for name in ORDER:
        if name in states:
            scale = 10.0 if name == "wpll" else 1.0  # rad/s
            assert states[name] == pytest.approx(expected[name], abs=2e-5 * scale), name
    other = block_diagram(first, time_s, p | reaches, 0.3, 0.1)
    assert max(np.max(np.abs(other[name] - expected[name])) for name in ORDER) > 5e-3


def test_the_sparse_blocks_have_its_state_matrix():
    blocks, _, _ = agreeing_blocks(in_plant_order(with_converter()))
    assert blocks.inputs[-2:] == ("pv1_p_mod", "pv1_q_mod")


@pytest.mark.parametrize(
    ("more", "says"),
    [
        ({"ICON": 0.4}, "is 0.5213"),
        ({"LVPLSW": 1}, "REGC_C has no LVPLSW"),
        ({"REGCB": 1}, "set REGCB or REGCC to 0"),
        ({"Kii": 0.0}, "Kii = 0.0, allowed: above 0"),
    ],
)
def test_what_has_no_meaning_or_rest_is_named(more, says):
    with pytest.raises(CaseError) as reported:
        operating_point(with_converter(**more))
    assert says in str(reported.value)


RECORD = """4 'REGCC1' 1 1 0 0.02 0.03 99 -99 10 0.015 1.2 0.6 15 25 250 11 -9 /
4 'REECB1' 1 0 0 0 0 0 -99 99 0.02 0 0 0 1.1 -1.1 0 0.05 0.8 -0.8 1.1 0.9 0 0.1 0 40
  0.02 9 -9 1 0 1.3 0.02 /
"""


@pytest.mark.parametrize("user", [False, True])
def test_a_record_becomes_a_converter_behind_the_impedance_of_the_raw_file(tmp_path, user):
    record = RECORD.replace("'REGCC1' 1", "'USRMDL' 1 'REGCCU1' 101 1 2 13 8 2") if user else RECORD
    case = import_psse(*pair_with(tmp_path, record)).case
    values = case.converters[0].control.parameters
    keys = (
        "REGCC",
        "REGCB",
        "RATEFLAG",
        "Tfltr",
        "Te",
        "ICON",
        "Kip",
        "Kii",
        "Kppll",
        "Kipll",
        "wmax",
        "wmin",
    )
    assert [values[key] for key in keys] == [
        1.0,
        0.0,
        1.0,
        0.03,
        0.015,
        1.2,
        0.6,
        15.0,
        25.0,
        250.0,
        11.0,
        -9.0,
    ]
    assert values["Xe"] == pytest.approx(load_case("kundur-pss").machine("G4").Xd1, rel=1e-9)
    plant = BlockShim(plant_block(case))
    assert np.max(np.abs(plant.derivatives(plant.x)[0])) < 1e-8


def test_a_record_cut_off_is_refused_with_its_line(tmp_path):
    with pytest.raises(CaseError, match=r"grid.dyr:\d+: REGCC1 has 14 fields, allowed: 15.*cut off"):
        import_psse(*pair_with(tmp_path, RECORD.replace(" 11 -9 /", " 11 /")))
