"""How well the energy flows at the two ends of a line agree, beyond what the line itself takes.

    W1 + W2 = energy of its resistance + energy stored in its reactance and capacitance

A line with resistance takes energy of either sign, and the stored energy changes while an oscillation grows
or decays. Both follow from the voltages and the impedance, which the motion of the phasors determines:
I1 = y (V1 - V2) + j b V1, where I and V move. The powers at rest show another difference, in the ratio of
the instrument transformers at both ends: P1 + P2 is the loss.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations
from typing import Any

import numpy as np
import numpy.typing as npt

from .record import Array
from .terminals import Narrow, Terminal

_AGREE = 0.2  # of what remains between the ends of a line, and of the ratio of their powers
_MISFIT = 0.2  # of the motion of the currents, more is not that of a line between both
_AT_REST = 0.25  # of the current at rest, between the line determined and the measurement

_Phasors = npt.NDArray[np.complex128]


@dataclass(frozen=True)
class LineEnds:
    """The two ends of a line. measured : sum of their flows over the mean size. own : the same of the
    energy of the line itself. ratio : of the powers at rest, beyond 1 and the loss. apart : what remains of
    the sum without the line's own energy and with powers that agree at rest. own, ratio : None where
    the record does not determine them; apart is then with what it does determine."""

    ends: tuple[str, str]
    measured: float
    own: float | None
    ratio: float | None
    apart: float

    @property
    def agree(self) -> bool:
        """Whether the measurements at both ends can be trusted."""
        return self.apart <= _AGREE and abs(self.ratio or 0.0) <= _AGREE

    @property
    def text(self) -> str:
        """In words."""
        parts = [] if self.own is None else [f"the line's own energy {self.own:+.1%}"]
        parts += [] if self.ratio is None else [f"powers at rest apart by {abs(self.ratio):.1%}"]
        of = f" (as measured {self.measured:+.1%}; {', '.join(parts)})" if parts else ""
        agree = "agree to" if self.agree else "disagree by"
        return f"the ends {' and '.join(self.ends)} {agree} {self.apart:.1%}{of}"

    def as_dict(self) -> dict[str, Any]:
        """Return plain types, for JSON."""
        return {**vars(self), "ends": list(self.ends)}


def pairs_of(terminals: Sequence[Terminal]) -> list[tuple[Terminal, Terminal]]:
    """Return the terminals that are the two ends of one line.

    In the IEEE form both have one device name, such as ``Ln:4-6``, at two substations.
    """
    by_device: dict[str, list[Terminal]] = {}
    for terminal in terminals:
        device = ":".join(terminal.name.split(":")[2:])
        if "-" in device:
            by_device.setdefault(device, []).append(terminal)
    return [pair for same in by_device.values() for pair in combinations(same, 2)]


def line_ends(a: Terminal, b: Terminal, narrow: Narrow) -> LineEnds:
    """Return how well the energy flows at the ends of a line agree in a band."""
    ends = (a.name, b.name)
    taken = _energy(a, b, _powers(a), _powers(b), narrow)
    mean = float(np.mean(np.abs(taken)))
    if not mean > 0.0:
        return LineEnds(ends, 0.0, None, None, 0.0)
    measured = float(np.sum(taken)) / mean
    line = None if a.Q is None or b.Q is None else _of_the_line(a, b, narrow)
    if line is None:
        return LineEnds(ends, measured, None, None, abs(measured))
    own = float(np.sum(_energy(a, b, *line, narrow)))
    ratio = _ratio_at_rest(a, b, float(np.mean((line[0] + line[1]).real)))
    half = 0.5 * (ratio or 0.0)
    return LineEnds(
        ends, measured, own / mean, ratio, abs(float(taken @ [1.0 - half, 1.0 + half]) - own) / mean
    )


def _powers(terminal: Terminal) -> _Phasors:
    """Return P + jQ."""
    Q = 0.0 if terminal.Q is None else terminal.Q
    return np.asarray(terminal.P + 1j * Q, dtype=np.complex128)


def _energy(a: Terminal, b: Terminal, S1: _Phasors, S2: _Phasors, narrow: Narrow) -> Array:
    """Return the slopes of W of powers at two terminals."""
    S = np.column_stack([S1, S2])
    log_v, angle = (np.column_stack(x) for x in ((a.log_v, b.log_v), (a.angle, b.angle)))
    return narrow.slopes(narrow.power(*map(narrow.of, (S.real, S.imag, log_v, angle))))


def _of_the_line(a: Terminal, b: Terminal, narrow: Narrow) -> tuple[_Phasors, _Phasors] | None:
    """Return P + jQ at both ends of the line that the motion determines; None where it is not a line."""
    V1, V2 = (np.exp(t.log_v + 1j * (t.angle - a.angle)) for t in (a, b))  # turned with the first
    I1, I2 = (np.conj(_powers(t) / V) for t, V in ((a, V1), (b, V2)))
    half = 1j * float(np.mean(((I1 + I2) / (V1 + V2)).imag))  # of the charging
    sent = 0.5 * (I1 - half * V1 - I2 + half * V2)  # through the series impedance, mean of both ends
    across, through = _motion(V1 - V2, narrow), _motion(sent, narrow)
    size = np.vdot(across, across).real
    if not size > 0.0:
        return None
    y = complex(np.vdot(across, through)) / size
    misfit = np.linalg.norm(through - y * across) / np.linalg.norm(through)
    at_rest = abs(np.mean(sent - y * (V1 - V2))) / abs(np.mean(sent))
    if not (misfit <= _MISFIT and at_rest <= _AT_REST and y.imag < 0.0):
        return None
    series = y * (V1 - V2)
    return V1 * np.conj(half * V1 + series), V2 * np.conj(half * V2 - series)


def _motion(phasors: _Phasors, narrow: Narrow) -> _Phasors:
    """Return the motion of phasors in the band."""
    both = narrow.inside(narrow.of(np.column_stack([phasors.real, phasors.imag])))
    return both[:, 0] + 1j * both[:, 1]


def _ratio_at_rest(a: Terminal, b: Terminal, loss: float) -> float | None:
    """Return by which share the powers at rest differ beyond the loss; None where they are too small.

    Powers below their swing, or below the reactive ones, show errors of phase instead.
    """
    S1, S2 = _powers(a), _powers(b)
    P = 0.5 * (S1 - S2).real
    least = max(float(np.std(P)), abs(float(np.mean(S1.imag))), abs(float(np.mean(S2.imag))))
    if not abs(float(np.mean(P))) > least:
        return None
    return (float(np.mean((S1 + S2).real)) - loss) / float(np.mean(P))
