"""Figures of a study: one style, a palette for colour-blind readers, the same bytes for the same data.

Every function returns a matplotlib figure drawn without pyplot; `save_figure`
writes it as SVG with text as outlines, so that it looks the same everywhere.
Speeds come in pu and are drawn in thousandths of a pu.
"""

from __future__ import annotations

import io
import re
import sys
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

import matplotlib as mpl
import numpy as np
import numpy.typing as npt
from matplotlib.axes import Axes
from matplotlib.axis import Axis
from matplotlib.backends.backend_svg import FigureCanvasSVG
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from interarea.models.files import write_whole

if TYPE_CHECKING:
    import control

Array = npt.NDArray[np.float64]
Curve = tuple[npt.ArrayLike, npt.ArrayLike]

INK, MUTED, GRID = "#1f2328", "#6e7781", "#d0d7de"
#: Okabe and Ito's palette without its yellow, in the order of use.
SERIES = ("#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00", "#56b4e9")
DASHES: tuple[Any, ...] = ("-", (0, (5, 1.5)), (0, (1.2, 1.2)), (0, (6, 1.5, 1.2, 1.5)), "-", (0, (5, 1.5)))

STYLE: Any = {
    "svg.fonttype": "path",
    "svg.hashsalt": "interarea",
    "font.family": "DejaVu Sans",
    "font.size": 9,
    "mathtext.fontset": "dejavusans",
    "axes.titlesize": 9,
    "axes.titlelocation": "left",
    "axes.labelsize": 9,
    "axes.edgecolor": MUTED,
    "axes.labelcolor": INK,
    "axes.linewidth": 0.7,
    "axes.grid": True,
    "axes.axisbelow": True,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "text.color": INK,
    "xtick.color": MUTED,
    "ytick.color": MUTED,
    "xtick.labelcolor": INK,
    "ytick.labelcolor": INK,
    "xtick.labelsize": 8,
    "ytick.labelsize": 8,
    "grid.color": GRID,
    "grid.linewidth": 0.5,
    "lines.linewidth": 1.4,
    "legend.fontsize": 8,
    "legend.frameon": False,
    "figure.constrained_layout.use": True,
    "path.simplify": True,
    "path.simplify_threshold": 0.3,
}
_LAID_OUT: Any = {"figure.autolayout": False, "figure.constrained_layout.use": False}
WIDTH = 6.4  #: inches; one text column


def new_figure(rows: int = 1, cols: int = 1, *, height: float = 2.6, **kwargs: Any) -> tuple[Figure, Any]:
    """Return an empty figure in the house style and its axes (array when there are several)."""
    with mpl.rc_context(STYLE):
        figure = Figure(figsize=(WIDTH, height), layout="constrained")
        axes = figure.subplots(rows, cols, **kwargs)
    return figure, axes


def save_figure(figure: Figure, path: Path, *, transparent: bool = False, outlines: bool = True) -> Path:
    """Write a figure: SVG without a date, PNG at 160 dpi, by the path's suffix.

    transparent : for a page that brings its own light or dark ground; by itself a figure stands on white.
    outlines : text of an SVG as outlines; else as text, to be found, copied and read out.
    """
    metadata = {"Date": None, "Creator": "interarea"} if path.suffix == ".svg" else None
    drawn = io.BytesIO()
    style = STYLE | _LAID_OUT | ({} if outlines else {"svg.fonttype": "none"})
    with mpl.rc_context(style), _nothing_ignored():
        if path.suffix == ".svg":
            _lay_out(figure)
        figure.savefig(drawn, format=path.suffix[1:], transparent=transparent, metadata=metadata, dpi=160)
        figure.set_layout_engine(None)  # laid out: saved again, it is drawn once instead of twice
    data = drawn.getvalue()
    if path.suffix == ".svg":  # a path on one line instead of one line a point
        data = re.sub(rb'(?<= d=")[^"]*', lambda d: b" ".join(d.group().split()), data)
    return write_whole(path, data)


def _lay_out(figure: Figure) -> None:
    """Lay a figure out for SVG where that is still to be done; `savefig` would draw all of it for that."""
    engine, canvas, dpi = figure.get_layout_engine(), figure.canvas, figure.dpi
    if engine is None:
        return
    FigureCanvasSVG(figure)  # text is as wide as this canvas measures it
    figure.dpi = 72  # as in an SVG
    engine.execute(figure)
    figure.dpi = dpi
    figure.set_canvas(canvas)
    figure.set_layout_engine(None)


@contextmanager
def _nothing_ignored() -> Iterator[None]:
    """Raise at the end what the interpreter only printed: a glyph that could not be read is left out."""
    ignored: list[BaseException] = []
    printed = sys.unraisablehook

    def keep(what: sys.UnraisableHookArgs) -> None:
        if what.exc_value is None or isinstance(what.exc_value, MemoryError | OSError):
            ignored.append(what.exc_value or MemoryError())
        else:
            printed(what)

    sys.unraisablehook = keep
    try:
        yield
    except Exception as error:
        if ignored:  # matplotlib tells what came of it ("failed to load glyph"), this one why
            raise ignored[0] from error
        raise
    finally:
        sys.unraisablehook = printed
    if ignored:
        raise ignored[0]


def singular_value_plot(
    systems: Mapping[str, control.StateSpace], omega: Array, *, ylabel: str = "dB"
) -> Figure:
    """Draw the largest singular value of each system over frequency (rad/s)."""
    from interarea.design.linear.norms import response  # loads python-control, a second

    figure, axes = new_figure()
    with mpl.rc_context(STYLE):
        for k, (label, system) in enumerate(systems.items()):
            top = np.linalg.norm(response(system, omega), 2, axis=(1, 2)).astype(np.float64)
            _magnitude(axes, omega, top, label, k)
        _frequency_axis(axes, omega)
        axes.set_ylabel(f"largest singular value ({ylabel})")
        axes.legend()
    return figure


def bode_plot(systems: Mapping[str, control.StateSpace], omega: Array) -> Figure:
    """Draw magnitude and phase of each input-output pair: one column per input, one output."""
    from interarea.design.linear.norms import response  # loads python-control, a second

    first = next(iter(systems.values()))
    inputs = first.input_labels
    figure, axes = new_figure(2, len(inputs), height=3.7, sharex=True, sharey="row", squeeze=False)
    with mpl.rc_context(STYLE):
        for j, name in enumerate(inputs):
            for k, (label, system) in enumerate(systems.items()):
                curve = response(system, omega)[:, 0, j]
                _magnitude(axes[0, j], omega, np.abs(curve), label, k)
                phase = np.degrees(np.unwrap(np.angle(curve)))
                phase -= 360.0 * np.round(phase[len(phase) // 2] / 360.0)
                axes[1, j].semilogx(omega, phase, color=SERIES[k], linestyle=DASHES[k])
            axes[0, j].set_title(f"from {signal_label(name)}")
            _frequency_axis(axes[1, j], omega)
        figure.set_layout_engine(
            "constrained", wspace=0.08
        )  # the last label of one column from the first of the next
        axes[0, 0].set_ylabel("gain (dB)")
        axes[1, 0].set_ylabel("phase (deg)")
        axes[0, 0].legend()
    return figure


def magnitude_plot(curves: Mapping[str, Array], omega: Array, ylabel: str) -> Figure:
    """Draw given magnitudes (not dB) over frequency, e.g. a sensitivity beside its weight."""
    figure, axes = new_figure()
    with mpl.rc_context(STYLE):
        for k, (label, magnitude) in enumerate(curves.items()):
            _magnitude(axes, omega, magnitude, label, k)
        _frequency_axis(axes, omega)
        axes.set_ylabel(ylabel)
        axes.legend()
    return figure


def _magnitude(axes: Axes, omega: Array, magnitude: Array, label: str, k: int) -> None:
    decibels = 20.0 * np.log10(np.maximum(magnitude, 1e-12))
    axes.semilogx(omega, decibels, color=SERIES[k], linestyle=DASHES[k], label=label)


def _frequency_axis(axes: Axes, omega: Array) -> None:
    _powers_as_text(axes.xaxis)
    axes.set_xlim(float(omega[0]), float(omega[-1]))
    axes.set_xlabel("frequency (rad/s)")


def signal_label(name: str) -> str:
    """Return a signal name as a reader writes it: `G2_dw` -> Δω of G2."""
    machine, _, quantity = name.partition("_")
    return f"Δω of {machine}" if quantity == "dw" else name


def difference_label(name: str, power: int = 3) -> str:
    """Return the axis label of a speed difference drawn in 10^-power pu: `dw24` -> Δω24."""
    symbol = f"Δω{name[2:].translate(_LOW)}" if name.startswith("dw") else name
    return f"{symbol} ({_power_of_ten(-power)} pu)"


#: digits as indices and exponents; of letters there are too few
_LOW = str.maketrans("0123456789", "₀₁₂₃₄₅₆₇₈₉")
_HIGH = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")


def _power_of_ten(exponent: int) -> str:
    return f"10{str(exponent).translate(_HIGH)}"


def _powers_as_text(axis: Axis) -> None:
    """Label the decades of a log axis with text a page can find, which takes no parser of formulas."""
    axis.set_major_formatter(lambda value, _: _power_of_ten(round(float(np.log10(value)))))
    axis.set_minor_formatter("")


def time_plot(
    curves: Mapping[str, Curve],
    *,
    ylabel: str,
    scale: float = 1e3,
    span_s: tuple[float, float] | None = None,
    marks: Mapping[str, float] | None = None,
    height: float = 2.5,
) -> Figure:
    """Draw time responses on one axis, names above it; `marks` names instants with a vertical line (s)."""
    figure, axes = new_figure(height=height)
    with mpl.rc_context(STYLE):
        for k, (label, (time, value)) in enumerate(curves.items()):
            axes.plot(time, scale * np.asarray(value), color=SERIES[k], linestyle=DASHES[k], label=label)
        _time_axis(axes, curves, span_s, scale)
        for label, at in (marks or {}).items():
            mark_instant(axes, at, label)
        axes.set_ylabel(ylabel)
        figure.legend(loc="outside upper right", ncols=min(4, len(curves)))
    return figure


def mark_instant(axes: Axes, at_s: float, label: str) -> None:
    """Draw a vertical line at `at_s` and its name above the axes, where no curve is."""
    axes.axvline(at_s, color=MUTED, linewidth=0.9, linestyle=(0, (2, 2)))
    axes.annotate(
        label,
        (at_s, 1.0),
        xycoords=("data", "axes fraction"),
        xytext=(0, 2),
        textcoords="offset points",
        ha="center",
        va="bottom",
        fontsize=7.5,
        color=MUTED,
    )


def _time_axis(
    axes: Axes, curves: Mapping[str, Curve], span_s: tuple[float, float] | None, scale: float
) -> None:
    first = np.asarray(next(iter(curves.values()))[0])
    start, end = span_s or (float(first[0]), float(first[-1]))
    axes.set_xlim(start, end)
    if span_s is not None:
        shown = [np.asarray(v)[(np.asarray(t) >= start) & (np.asarray(t) <= end)] for t, v in curves.values()]
        top = max(float(np.max(np.abs(v))) for v in shown) * scale * 1.1
        axes.set_ylim(-top, top)
    axes.xaxis.set_major_locator(MaxNLocator(10, integer=end - start >= 5))
    axes.set_xlabel("time (s)")


def label_columns(axes: Any, used: int, xlabel: str) -> None:
    """Hide the panels beyond the first `used` of a grid; label the time or frequency under every column."""
    for panel in axes.flat[used:]:
        panel.set_visible(False)
    columns = axes.shape[1]
    for panel in axes.flat[max(0, used - columns) : used]:
        panel.tick_params(labelbottom=True)
        panel.set_xlabel(xlabel)


def latency_panels(curves: Mapping[str, Curve], reference: tuple[str, Curve], ylabel: str) -> Figure:
    """Draw one small panel per latency, each over the response without latency, on one scale.

    Growing responses leave the panel: the scale is twice the reference's peak.
    """
    rows = -(-len(curves) // 2)
    figure, axes = new_figure(rows, 2, height=0.9 + 1.05 * rows, sharex=True, sharey=True, squeeze=False)
    label, (t0, y0) = reference
    peak = 2.0e3 * float(np.max(np.abs(np.asarray(y0))))
    with mpl.rc_context(STYLE):
        for panel, (name, (time, value)) in zip(axes.flat, curves.items(), strict=False):
            panel.plot(time, 1e3 * np.asarray(value), color=SERIES[0], linewidth=1.2, label="with latency")
            panel.plot(
                t0, 1e3 * np.asarray(y0), color=SERIES[1], linestyle=DASHES[1], linewidth=0.9, label=label
            )
            panel.set_title(name, fontsize=8, pad=2)
            panel.set_ylim(-peak, peak)
            panel.set_xlim(float(np.asarray(t0)[0]), float(np.asarray(t0)[-1]))
            panel.xaxis.set_major_locator(MaxNLocator(5, integer=True))
        label_columns(axes, len(curves), "time (s)")
        handles, labels = axes[0, 0].get_legend_handles_labels()
        figure.legend(handles, labels, loc="outside upper right", ncols=2)
        figure.supylabel(ylabel, fontsize=9)
    return figure


def latency_damping_plot(
    exact: Mapping[str, Sequence[Sequence[float]]],
    measured: Mapping[str, Sequence[Sequence[float]]],
    margin_s: Mapping[str, float | None],
) -> Figure:
    """Draw damping against latency: exact characteristic roots as lines, co-simulated ring-downs as marks.

    exact, measured : wiring -> rows (latency in s, damping ratio); margin_s : wiring -> exact margin or None.
    """
    figure, axes = new_figure(height=2.9)
    with mpl.rc_context(STYLE):
        axes.axhline(0.0, color=INK, linewidth=0.8)
        for k, (wiring, rows) in enumerate(exact.items()):
            delay, zeta = np.asarray(rows, dtype=float).T
            axes.plot(1e3 * delay, zeta, color=SERIES[k], linestyle=DASHES[k], label=f"{wiring}, exact")
            event_times = np.asarray(measured.get(wiring, ()), dtype=float).reshape(-1, 2)
            if len(event_times):
                axes.plot(
                    1e3 * event_times[:, 0],
                    event_times[:, 1],
                    "os^"[k % 3],
                    color=SERIES[k],
                    markersize=4.5,
                    markerfacecolor="none",
                    label=f"{wiring}, co-simulated",
                )
            margin = margin_s.get(wiring)
            if margin is not None and np.isfinite(margin):
                axes.axvline(1e3 * margin, color=MUTED, linewidth=0.9, linestyle=(0, (2, 2)))
                axes.annotate(
                    f"margin {1e3 * margin:.1f} ms",
                    (1e3 * margin, 0.96),
                    xycoords=("data", "axes fraction"),
                    xytext=(-4, 0),
                    textcoords="offset points",
                    ha="right",
                    va="top",
                    fontsize=8,
                    color=MUTED,
                )
        axes.set_xlabel("latency (ms)")
        axes.set_ylabel("least damping ratio, swing modes")
        figure.legend(loc="outside upper center", ncols=2 if measured else len(exact), fontsize=8)
    return figure


def hankel_plot(values: Mapping[str, npt.ArrayLike], orders: Mapping[str, int]) -> Figure:
    """Draw Hankel singular values (not dB) on a log axis; a vertical line marks each order in `orders`."""
    figure, axes = new_figure(height=2.3)
    with mpl.rc_context(STYLE):
        for k, (label, hankel) in enumerate(values.items()):
            sigma = np.asarray(hankel, dtype=float)
            axes.semilogy(
                np.arange(1, sigma.size + 1),
                sigma,
                "o-s"[2 * (k % 2)],
                color=SERIES[k],
                markersize=3,
                linestyle=DASHES[k],
                linewidth=0.8,
                label=label,
            )
            if label in orders:
                axes.axvline(orders[label] + 0.5, color=SERIES[k], linewidth=0.9, linestyle=(0, (2, 2)))
        _powers_as_text(axes.yaxis)
        axes.set_xlabel("state of the balanced plant")
        axes.set_ylabel("Hankel singular value")
        axes.legend()
    return figure
