"""Figures: the numbers drawn are those given, the bytes depend on nothing else."""

from __future__ import annotations

import errno
import sys
from pathlib import Path

import numpy as np
import pytest
from matplotlib.figure import Figure

from interarea.cosim.plots import curves as plots
from interarea.cosim.plots.diagrams import generalised_plant_diagram, one_line_diagram
from interarea.cosim.plots.mode_shapes import participation_plot
from interarea.models.case.case import load_case
from interarea.models.grid.powerflow import solve_powerflow


def test_the_same_data_give_the_same_bytes(tmp_path: Path) -> None:
    t = np.linspace(0.0, 5.0, 501)
    files = [
        plots.save_figure(
            plots.time_plot({"a": (t, np.sin(t)), "b": (t, np.cos(t))}, ylabel="y"), tmp_path / f"{k}.svg"
        )
        for k in range(2)
    ]
    assert files[0].read_bytes() == files[1].read_bytes()
    assert b"<text" not in files[0].read_bytes()  # text is outlines: no font is needed to look alike


def test_time_plot_draws_the_values_in_thousandths() -> None:
    t = np.array([0.0, 1.0, 2.0])
    axes = plots.time_plot({"dw24": (t, np.array([0.0, 1e-3, -2e-3]))}, ylabel="y").axes[0]
    assert axes.lines[0].get_ydata() == pytest.approx([0.0, 1.0, -2.0])


def test_participation_plot_shows_the_largest_first() -> None:
    figure = participation_plot({"G1.slip": 0.2, "G2.slip": 0.5, "G1.eq1": 0.1}, ["G1", "G2"], count=2)
    labels = [label.get_text() for label in figure.axes[0].get_yticklabels()]
    assert labels == ["G2.slip", "G1.slip"]


def test_latency_panels_has_one_panel_for_each_latency() -> None:
    t = np.linspace(0.0, 1.0, 11)
    curves = {f"{k} ms": (t, t * k) for k in (1, 2, 3)}
    figure = plots.latency_panels(curves, ("none", (t, t)), "y")
    assert [a.get_title() for a in figure.axes if a.get_visible()] == ["", "", ""]
    assert [a.get_title(loc="left") for a in figure.axes if a.get_visible()] == list(curves)


def test_curves_are_told_apart_without_colour() -> None:
    t = np.array([0.0, 1.0])
    figure = plots.time_plot(dict.fromkeys("abcd", (t, t)), ylabel="y")
    assert (
        len({(line.get_linestyle(), str(line._unscaled_dash_pattern)) for line in figure.axes[0].lines}) == 4
    )


def test_one_line_diagram_names_every_bus_and_machine() -> None:
    case = load_case("two-area-thesis")
    places = {bus.number: (float(k), float(k % 2)) for k, bus in enumerate(case.buses)}
    figure = one_line_diagram(solve_powerflow(case), places)
    words = {text.get_text() for text in figure.axes[0].texts}
    assert {str(bus.number) for bus in case.buses} <= words
    assert {m.name for m in case.machines} <= words
    assert "700 MW" in words  # dispatch of G1, Kundur1994 Ex. 12.6


def test_generalised_plant_diagram_has_its_four_boxes() -> None:
    words = {text.get_text() for text in generalised_plant_diagram().axes[0].texts}
    assert {"K(s)", "G(s)", "W₁(s)", "W₂(s)"} <= words


def test_a_marks_name_stands_above_the_axes_and_the_legend_beside_no_curve() -> None:
    t = np.linspace(0.0, 20.0, 200)
    figure = plots.time_plot(
        {"a": (t, np.sin(t)), "b": (t, np.cos(t))}, marks={"signal lost": 1.5}, ylabel="y"
    )
    figure.canvas.draw()
    (axes,) = figure.axes
    top = axes.get_window_extent().y1
    (legend,) = figure.legends
    name = next(text for text in axes.texts if text.get_text() == "signal lost")
    assert name.get_window_extent().y0 >= top
    assert legend.get_window_extent().y0 >= top
    assert not legend.get_window_extent().overlaps(name.get_window_extent())


def test_every_column_of_latency_panels_has_its_time_axis() -> None:
    t = np.linspace(0.0, 20.0, 200)
    figure = plots.latency_panels(
        {f"{k} ms": (t, np.sin(t)) for k in range(3)}, ("none", (t, np.cos(t))), "y"
    )
    shown = [a for a in figure.axes if a.get_visible()]
    assert [a.get_xlabel() for a in shown] == ["", "time (s)", "time (s)"]
    assert [a.xaxis.get_tick_params()["labelbottom"] for a in shown] == [False, True, True]


def test_two_that_draw_one_figure_at_once_do_not_meet(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """While one is drawing, another begins and ends with the same file, as two studies do in one cache."""
    path, alone = tmp_path / "f" / "figure.svg", tmp_path / "alone.svg"
    figure, axes = plots.new_figure(1, 1)
    axes.plot([0.0, 1.0], [0.0, 1.0])
    plots.save_figure(figure, alone)
    draw = Figure.savefig
    nested: list[Path] = []

    def savefig(self: Figure, *arguments: object, **options: object) -> None:
        if not nested:
            nested.append(path)
            plots.save_figure(figure, path)
        draw(self, *arguments, **options)  # type: ignore[arg-type]

    monkeypatch.setattr(Figure, "savefig", savefig)
    assert plots.save_figure(figure, path) == path
    assert path.read_bytes() == alone.read_bytes()
    assert [p.name for p in path.parent.iterdir()] == ["figure.svg"]


@pytest.mark.parametrize("error", [MemoryError(), OSError(errno.EIO, "Input/output error", "DejaVuSans.ttf")])
def test_a_font_that_cannot_be_read_is_told(
    error: Exception, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """matplotlib's reader of fonts lets the interpreter print the error and draws on without the glyph."""
    draw = Figure.savefig

    def savefig(self: Figure, *arguments: object, **options: object) -> None:
        _Dies(error)
        draw(self, *arguments, **options)  # type: ignore[arg-type]

    figure, _ = plots.new_figure(1, 1)
    monkeypatch.setattr(Figure, "savefig", savefig)
    hook = sys.unraisablehook
    with pytest.raises(type(error)) as reported:
        plots.save_figure(figure, tmp_path / "figure.svg")
    assert reported.value is error and not list(tmp_path.iterdir()) and sys.unraisablehook is hook
    monkeypatch.setattr(Figure, "savefig", draw)
    assert plots.save_figure(figure, tmp_path / "figure.svg").stat().st_size > 1000


class _Dies:
    """Where an error comes out of the end of an object, the interpreter prints it and goes on."""

    def __init__(self, error: Exception) -> None:
        self.error = error

    def __del__(self) -> None:
        raise self.error
