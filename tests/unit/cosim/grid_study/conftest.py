"""What the tests of a grid's study share."""

from __future__ import annotations

import pytest

from interarea.cosim.grid_study import operating_points


@pytest.fixture
def few_points(monkeypatch: pytest.MonkeyPatch) -> None:
    """Leave a study the grid as it is, two outages and one other load: each point costs a tenth of it."""
    monkeypatch.setattr(operating_points, "LOADS", (0.9,))
    monkeypatch.setattr(operating_points, "TIE_SHARE", 0.0)
    monkeypatch.setattr(operating_points, "CHOSEN", 2)
    monkeypatch.setattr(operating_points, "USABLE", 4)
