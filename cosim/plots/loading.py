"""Matplotlib loaded by a program that shows nobody its help."""

from __future__ import annotations

from typing import Any


def load_plots() -> None:
    """Load matplotlib without the lists of properties in its docstrings, which take a third of its loading.

    For a command: in a notebook these lists are what help on `Axes.plot` prints. Figures are the same.
    """
    from matplotlib import artist as module

    artist: Any = module
    written = artist.kwdoc

    def left_out(_artist: object) -> str:
        return ""

    artist.kwdoc = left_out
    try:
        import matplotlib.axes
        import matplotlib.figure  # noqa: F401
    finally:
        artist.kwdoc = written
