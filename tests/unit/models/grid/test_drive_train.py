"""Drive trains WTDTA1 of wind plants: their energy in closed form, their poles by hand, PFLAG, record."""

from __future__ import annotations

import numpy as np
import pytest
from grid_text import pair_with
from one_converter import NAME, SHARE, beside_machines, course, states_of
from plant_shim import BlockShim
from sparse_blocks import agreeing_blocks

from interarea.models.blocks.plant import plant_block
from interarea.models.errors import CaseError
from interarea.models.grid.machine_tables import in_plant_order
from interarea.models.importers.psse import import_psse

ONE = {"TRAIN": 1, "H": 4.0, "DAMP": 0.5}
TWO = ONE | {"Htfrac": 0.85, "Freq1": 1.6, "Dshaft": 1.5}
#: name -> parameters, states of the drive train
TRAINS = {
    "one": (ONE, {"wg"}),
    "two": (TWO, {"wg", "wt", "tsh"}),
    "speed": (TWO | {"PFLAG": 1, "REECA": 1}, {"wg", "wt", "tsh"}),
}


def run(more, seconds, p_mod=0.0, events=()):
    """Return time, the states of the plant by name and its power on its base after p_mod steps at once."""
    time_s, own, out = course(beside_machines(more), seconds, 0.001, {"p_mod": p_mod}, events)
    return time_s, own, out[f"{NAME}.p"] / SHARE


@pytest.mark.parametrize(("network", "base"), [("dense", "two-area-thesis"), ("sparse", "kundur-manual")])
@pytest.mark.parametrize("name", TRAINS)
def test_it_rests_and_the_derivatives_are_those_of_differences(name, network, base):
    parameters, own = TRAINS[name]
    plant = BlockShim(plant_block(beside_machines(parameters, base), network=network))
    assert own <= set(states_of(plant)) and len(states_of(plant)) == 5 + len(own)
    rates, y = plant.derivatives(plant.x)
    assert np.max(np.abs(rates)) < 5e-11
    assert y[plant.output_names.index(f"{NAME}.p")] == pytest.approx(1.0, abs=1e-11)
    off, outputs_off = plant.directional_errors(1e-4, 1e-5)
    assert off < 1e-7 and outputs_off < 1e-6


@pytest.mark.slow
def test_at_rest_it_stands_for_20_s():
    _, own, p = run(TRAINS["speed"][0], 20.0)
    assert max(np.max(np.abs(path - path[0])) for path in (*own.values(), p)) < 1e-11


FAULT = {"kind": "bus_fault", "bus": 8, "start_s": 0.1, "end_s": 0.25, "x_pu": 0.05}


@pytest.mark.slow
@pytest.mark.parametrize("PFLAG", [0, 1])
@pytest.mark.parametrize("two", [False, True])
def test_what_it_takes_and_gives_is_its_energy(two, PFLAG):
    """H ((1 + w)^2 - 1) of each mass and T^2/2K of the shaft are the integral of P0 - P, without damping."""
    shaft = {"Htfrac": 0.85, "Freq1": 1.6} if two else {}
    more = {"TRAIN": 1, "H": 4.0, "PFLAG": PFLAG, "REECA": 1} | shaft
    time_s, own, p = run(more, 3.0, -0.05, [FAULT])
    work = np.append(0.0, np.cumsum(np.diff(time_s) * 0.5 * (1.0 - p[1:] - p[:-1])))
    Ht = 4.0 * 0.85 if two else 0.0
    energy = (4.0 - Ht) * ((1.0 + own["wg"]) ** 2 - 1.0)
    if two:
        K = 2.0 * (2.0 * np.pi * 1.6) ** 2 * Ht * (4.0 - Ht) / 4.0
        energy = energy + Ht * ((1.0 + own["wt"]) ** 2 - 1.0) + (own["tsh"] ** 2 - 0.5**2) / (2.0 * K)
    assert np.ptp(work) > 0.02
    assert energy == pytest.approx(work, abs=2e-4)  # trapezes over the jumps of P


@pytest.mark.parametrize("name", TRAINS)
def test_its_poles_are_those_by_hand(name):
    """Of the block of A of its own states; P is 0.5 and, with PFLAG, moves through other states only."""
    parameters, own = TRAINS[name]
    plant = BlockShim(plant_block(beside_machines(parameters)))
    at = [states_of(plant)[n] for n in sorted(own)]
    A = plant.jacobians()[0][np.ix_(at, at)]
    P, D, H = 0.5, 0.5, 4.0
    if name == "one":
        expected = np.array([[(-P + P - D) / (2 * H)]])
    else:
        Ht, Ds = 0.85 * H, 1.5
        Hg, K = H - Ht, 2 * (2 * np.pi * 1.6) ** 2 * Ht * (H - Ht) / H
        expected = np.array(  # of tsh, wg, wt
            [
                [0.0, -K, K],
                [1 / (2 * Hg), (-Ds + P - D) / (2 * Hg), Ds / (2 * Hg)],
                [-1 / (2 * Ht), Ds / (2 * Ht), (-Ds - P) / (2 * Ht)],
            ]
        )
        fast = max(np.abs(np.linalg.eigvals(expected).imag)) / (2 * np.pi)
        assert fast == pytest.approx(1.6, rel=0.02)  # Freq1, but for the damping
    assert np.max(np.abs(A - expected)) < 1e-9


def test_with_pflag_the_order_of_power_follows_the_speed():
    """Tpord pord' = pref (1 + wg) - pord."""
    plant = BlockShim(plant_block(beside_machines(TRAINS["speed"][0])))
    x, at = plant.x.copy(), states_of(plant)
    x[at["wg"]] = 0.03
    rates, _ = plant.derivatives(x)
    assert rates[at["pord"]] == pytest.approx(0.5 * 0.03 / 0.02, rel=1e-10)


def test_the_sparse_blocks_have_its_state_matrix():
    blocks, _, _ = agreeing_blocks(in_plant_order(beside_machines(TRAINS["speed"][0])))
    assert blocks.inputs[-2:] == (f"{NAME}_p_mod", f"{NAME}_q_mod")


@pytest.mark.parametrize(
    ("more", "says"),
    [
        (
            {"PFLAG": 1},
            "PFLAG takes the speed of a drive train: set TRAIN to 1 (record WTDTA1), or PFLAG to 0",
        ),
        (ONE | {"Htfrac": 0.5}, "two masses need a shaft: give Freq1 at least 0.01 Hz, or Htfrac 0"),
        (ONE | {"H": 0.0}, "H = 0.0, allowed: above 0"),
    ],
)
def test_what_has_no_meaning_is_named(more, says):
    with pytest.raises(CaseError) as reported:
        plant_block(beside_machines(more))
    assert says in str(reported.value)


RECORD = """4 'REGCA1' 1 0 0.02 10 0.9 0.4 1.22 1.2 0.8 0.4 -1.3 0.02 0.7 99 -99 0.7 /
4 'REECA1' 1 0 0 0 0 1 0 -99 99 0.02 0 0 0 1.1 -1.1 0 0 0 0 0.05 0.8 -0.8 1.1 0.9 0 0.1 0 40 0 0.02
  9 -9 1 0 1.3 0.02 0 0 0 0 0 0 0 0 0 0 0 0 0 0 0 0 /
"""
TRAIN = "4 'WTDTA1' 1 5 0.5 0.8 1.5 1.2 /\n"


def test_a_record_is_the_drive_train_of_its_plant(tmp_path):
    case = import_psse(*pair_with(tmp_path, RECORD + TRAIN)).case
    values = case.converters[0].control.parameters
    keys = ("TRAIN", "PFLAG", "H", "DAMP", "Htfrac", "Freq1", "Dshaft")
    assert [values[key] for key in keys] == [1.0, 1.0, 5.0, 0.5, 0.8, 1.5, 1.2]
    plant = BlockShim(plant_block(case))
    assert np.max(np.abs(plant.derivatives(plant.x)[0])) < 1e-8


@pytest.mark.parametrize(
    ("record", "says"),
    [
        (RECORD + TRAIN.replace(" 1.2 /", " /"), "WTDTA1 has 4 fields, allowed: 5"),
        (TRAIN, "G4 has no REGCA1 or REGCB1 or REGCC1, which is the converter itself"),
    ],
)
def test_records_that_make_no_plant_are_refused_with_their_line(tmp_path, record, says):
    with pytest.raises(CaseError) as reported:
        import_psse(*pair_with(tmp_path, record))
    assert says in str(reported.value) and ".dyr:" in str(reported.value)
