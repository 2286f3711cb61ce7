"""Windings of the q axis: two for whoever has Tq01, one without; where saturation acts tells them apart."""

from __future__ import annotations

import pytest

from interarea.models.case.case import Case, load_case
from interarea.models.errors import CaseError
from interarea.models.grid.equilibrium import operating_point

SATURATED = {"S10": 0.1, "S12": 0.4}


def with_windings(**values: object) -> Case:
    change = {"saturation": "none", "flux_saturation": SATURATED, **values}
    return load_case("kundur-manual").with_changes({"machines": {"G2": change}})


def state(case: Case, name: str) -> float:
    point = operating_point(case)
    return dict(zip(point.state_names, point.states, strict=True))[name].start


def test_a_machine_with_equal_reactances_is_the_limit_of_unequal_ones() -> None:
    """GENROU with X'q = Xq: saturation drives the outer winding as with any X'q."""
    equal, near = (state(with_windings(Xq1=x), "G2.ed1") for x in (1.7, 1.7 * (1.0 - 1e-9)))
    assert abs(equal) > 1e-3
    assert equal == pytest.approx(near, abs=1e-8)


def test_without_tq01_nothing_moves_the_outer_winding() -> None:
    assert state(with_windings(Xq1=1.7, Tq01="none"), "G2.ed1") == 0.0


def test_one_winding_has_one_reactance() -> None:
    with pytest.raises(CaseError, match=r"Xq1 = 0\.55 without Tq01, allowed: Xq1 = Xq = 1\.7"):
        with_windings(Tq01="none")
