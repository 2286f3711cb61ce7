"""Reactive power of a VSC link against its active power, as dampers of the mode between two areas."""

from __future__ import annotations

import numpy as np
import pytest

from interarea.cosim.designs.ranked_loops import ranked_loops
from interarea.cosim.designs.short_designs import short_designs
from interarea.cosim.run.artefacts import linear_matrices
from interarea.models.case.case import load_case

CASE = "two-area-actuators"
INPUTS = ("vsc1_p_mod", "vsc1_q_mod_to", "vsc1_q_mod_from")
MODES = {"band_hz": (0.1, 2.5), "below": 0.2}  # as the command


@pytest.mark.slow
def test_loops_rank_it_beside_exciters_and_active_power_by_the_residues(cache):
    """Index: residue over the largest, from eigenvectors of the dense matrices."""
    case = load_case(CASE)
    choice = ranked_loops(case, cache, **MODES, kinds=("speed",), together=1, most=200)
    m = linear_matrices(case, cache)
    values, right = np.linalg.eig(m.A)
    weak = -values.real < 0.2 * np.abs(values)
    (k,) = np.flatnonzero(weak & (np.abs(values.imag / (2.0 * np.pi) - 0.64) < 0.05))
    reach = np.abs(np.linalg.inv(right)[k] @ m.B)
    index = dict(zip(m.input_labels, reach / reach.max(), strict=True))
    assert index["G4_vs"] == 1.0 and {*INPUTS, "hvdc1_p_mod", "svc1_v_mod"} <= index.keys()
    scores = {one.actuators[0]: one.score for one in choice.sets}
    assert scores == pytest.approx(index, rel=1e-6)
    # at equal power: .29 and .18 of active power's
    of_p = [scores[name] / scores["vsc1_p_mod"] for name in INPUTS]
    assert of_p == pytest.approx([1.0, 0.289, 0.176], abs=1e-3)


@pytest.mark.slow
def test_active_power_damps_more_than_reactive_power_at_equal_effort(cache):
    """As docs/actuators.md prints it; .6 pu of 100 MVA per rad/s.

    Of active power the search ends at .247 or at .290, and of reactive power at bus 7 at .123 or .126,
    depending on the last bits of the plant.
    """
    case = load_case(CASE)
    choice = ranked_loops(case, cache, **MODES, kinds=("speed",), actuators=INPUTS, together=1, most=6)
    rows = short_designs(case, choice.sets, cache)
    damping = {row.chosen.actuators[0]: row.damping for row in rows}
    assert 0.245 <= damping.pop("vsc1_p_mod") <= 0.292
    assert 0.121 <= damping.pop("vsc1_q_mod_from") <= 0.128
    assert damping == pytest.approx({"vsc1_q_mod_to": 0.144}, abs=2e-3)
    assert all(row.own == pytest.approx(0.087, abs=1e-3) for row in rows)
