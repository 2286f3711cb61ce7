r"""How much later, larger or smaller each signal may come: exact, by where roots touch the axis.

Of the loop with the return matrix :math:`R(s) = G(s) K(s)` (signals, signals) and
:math:`S = (I - R)^{-1}`, cut at signal i alone,

.. math:: L_i(s) = 1 - 1/S_{ii}(s)

comes back. With that signal k times as large and late by tau a root lies at s where
:math:`k\, e^{-s\tau} L_i(s) = 1`. So for a latency :math:`|L_i(j\omega)| = 1` and
:math:`\tau = (\arg L_i \bmod 2\pi)/\omega`, for a scale :math:`\operatorname{Im} L_i(j\omega) = 0` and
:math:`k = 1/L_i`, and for all signals equally late the same of the eigenvalues of R. Frequencies are
bracketed on a grid that resolves the resonances and refined to rounding: no rational model of a latency
enters.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any, TypeAlias

import control
import numpy as np
import numpy.typing as npt
from scipy.optimize import brentq

from ..delay.curves import delayed_loop
from ..delay.margin import resonance_grid, unit_crossings
from ..delay.signal_conditions import Condition
from ..delay.transfer_matrix import transfer_matrix
from ..linear.linearise import select
from ..linear.matrices import ZERO_EIGENVALUE, decays
from ..reduction.gramians import matrices
from .large_loop import LargePlant

Matrix = npt.NDArray[np.float64]
ComplexArray = npt.NDArray[np.complex128]
Returned: TypeAlias = Callable[[ComplexArray], ComplexArray]

ALL = "all signals"  #: the row of signals that are equally late
SEARCHED_S = 10.0  #: latencies above this are not looked for
SEARCHED_SCALE = 100.0  #: nor are factors of a larger magnitude
_LOWEST, _HIGHEST = 1e-3, 1e3  # rad/s
_SHOWN = 4  # signals in a line of words


@dataclass(frozen=True)
class Contact:
    """Where a root touches the axis: frequency (Hz; 0: a real root) at an operating point."""

    value: float
    frequency_hz: float
    point: str


@dataclass(frozen=True)
class SignalMargin:
    """What a loop bears of one signal while all others are there at once; None: nothing found.

    delay : latency, s. lower, upper : factors on it between which the loop is stable; not of `ALL`.
    """

    signal: str
    delay: Contact | None
    lower: Contact | None = None
    upper: Contact | None = None

    def nearer(self, other: SignalMargin) -> SignalMargin:
        """Return the narrower of both, of each kind."""
        return SignalMargin(
            self.signal,
            _nearest((self.delay, other.delay), 0.0),
            _nearest((self.lower, other.lower), 1.0),
            _nearest((self.upper, other.upper), 1.0),
        )

    def as_dict(self) -> dict[str, Any]:
        """Return the record as JSON values."""
        return asdict(self)


def _nearest(contacts: Iterable[Contact | None], to: float) -> Contact | None:
    met = (contact for contact in contacts if contact is not None)
    return min(met, key=lambda contact: abs(contact.value - to), default=None)


def signal_margins(
    plants: Mapping[str, control.StateSpace | LargePlant], K: control.StateSpace
) -> tuple[SignalMargin, ...]:
    """Return the margins of each signal that `K` answers, the least over all plants; first that of `ALL`.

    plants : operating point -> plant as `judge_family` takes it. A loop that is not stable as it is has no
        margins: then there are none at all.
    """
    least: dict[str, SignalMargin] = {}
    if not all(_stable(plant, K) for plant in plants.values()):
        return ()
    for point, plant in plants.items():
        for margin in _margins_at(point, plant, K):
            least[margin.signal] = least[margin.signal].nearer(margin) if margin.signal in least else margin
    return tuple(least.values())


def _margins_at(
    point: str, plant: control.StateSpace | LargePlant, K: control.StateSpace
) -> list[SignalMargin]:
    _, B, _, D = matrices(K)
    answered = [bool(np.any(B[:, k]) or np.any(D[:, k])) for k in range(len(K.input_labels))]
    signals = [name for name, seen in zip(K.input_labels, answered, strict=True) if seen]
    if not signals:
        return []
    returned = _returned(plant, K, signals)
    grid = _grid(plant, K, signals)
    R = returned(np.asarray(1j * grid, dtype=np.complex128))
    L = _cut(R)
    margins = []
    if len(signals) > 1:
        among = min(len(signals), len(K.output_labels))
        common = _delay(point, grid, _largest(R)[:, :among], lambda s: _largest(returned(s))[:, :among])
        margins.append(SignalMargin(ALL, common))
    for k, signal in enumerate(signals):

        def cut(s: ComplexArray, k: int = k) -> ComplexArray:
            return np.asarray(_cut(returned(s))[:, k : k + 1])

        lower, upper = _scales(point, grid, L[:, k], cut)
        margins.append(SignalMargin(signal, _delay(point, grid, L[:, k : k + 1], cut), lower, upper))
    return margins


def _stable(plant: control.StateSpace | LargePlant, K: control.StateSpace) -> bool:
    if isinstance(plant, LargePlant):
        return plant.facts(K, Condition("N")).stable
    values = np.linalg.eigvals(delayed_loop(plant, K).balanced().undelayed())
    return decays(values)


def _returned(
    plant: control.StateSpace | LargePlant, K: control.StateSpace, signals: Sequence[str]
) -> Returned:
    """Return s (N,) -> what comes back of each signal (N, signals, signals)."""
    outputs = list(K.output_labels)
    own = transfer_matrix(select(K, list(signals), outputs))
    if isinstance(plant, LargePlant):
        response = plant.response(outputs, signals)
        return lambda s: np.asarray(np.stack([response(complex(each)) for each in s]) @ own.at(s))
    G = transfer_matrix(select(plant, outputs, list(signals)))
    return lambda s: np.asarray(G.at(s) @ own.at(s))


def _grid(plant: control.StateSpace | LargePlant, K: control.StateSpace, signals: Sequence[str]) -> Matrix:
    """Return frequencies (rad/s) that resolve the loop, and that with each signal cut.

    Of a large plant those alone that resolve swings.
    """
    poles = np.empty(0, dtype=complex)
    if not isinstance(plant, LargePlant):
        loops = [delayed_loop(plant, K, lost=lost) for lost in ((), *((each,) for each in signals))]
        poles = np.concatenate([np.linalg.eigvals(loop.balanced().undelayed()) for loop in loops])
    return resonance_grid(poles, _LOWEST, _HIGHEST)


def _cut(R: ComplexArray) -> ComplexArray:
    """Return what comes back (N, signals) of each signal cut alone, from the return matrix (N, n, n)."""
    S = np.linalg.inv(np.eye(R.shape[-1]) - R).astype(complex)
    return np.asarray(1.0 - 1.0 / np.diagonal(S, axis1=1, axis2=2))


def _largest(R: ComplexArray) -> ComplexArray:
    """Return the eigenvalues (N, n) of the return matrix, largest first."""
    values = np.linalg.eigvals(R)
    return np.asarray(np.take_along_axis(values, np.argsort(-np.abs(values), axis=1), axis=1))


def _delay(point: str, grid: Matrix, on_grid: ComplexArray, of: Returned) -> Contact | None:
    """Return the smallest latency at which something that comes back (N, branches) meets itself."""
    contacts = []
    for branch in range(on_grid.shape[1]):

        def excess(omega: float, branch: int = branch) -> float:
            return float(np.abs(of(np.array([1j * omega]))[0, branch])) - 1.0

        for omega in unit_crossings(excess, grid, np.abs(on_grid[:, branch]) - 1.0):
            angle = float(np.angle(of(np.array([1j * omega]))[0, branch])) % (2.0 * np.pi)
            contacts.append(Contact(angle / omega, omega / (2.0 * np.pi), point))
    return _nearest((contact for contact in contacts if contact.value <= SEARCHED_S), 0.0)


def _scales(
    point: str, grid: Matrix, on_grid: ComplexArray, of: Returned
) -> tuple[Contact | None, Contact | None]:
    """Return the factors nearest to 1, below and above it, at which what comes back (N, 1) meets itself."""

    def returned(s: complex) -> complex:
        return complex(of(np.array([s]))[0, 0])

    turned = np.flatnonzero(on_grid.imag[:-1] * on_grid.imag[1:] < 0.0)
    met = [brentq(lambda w: returned(1j * w).imag, grid[k], grid[k + 1], xtol=1e-13) for k in turned]
    values = [(returned(1j * omega).real, omega) for omega in met]
    values.append((returned(complex(ZERO_EIGENVALUE)).real, 0.0))  # a real root: growth begins there
    contacts = [
        Contact(1.0 / value, omega / (2.0 * np.pi), point)
        for value, omega in values
        if abs(value) * SEARCHED_SCALE >= 1.0
    ]
    below = _nearest((contact for contact in contacts if contact.value < 1.0), 1.0)
    return below, _nearest((contact for contact in contacts if contact.value > 1.0), 1.0)


def in_words(margins: Sequence[Mapping[str, Any]]) -> list[str]:
    """Return a certificate's margins in two lines, of latency and of scale; the narrowest of many."""
    if not margins:
        return ["no signal margins: the loop is unstable, or does not respond to its signals"]
    late = sorted(
        margins, key=lambda m: (m["signal"] != ALL, m["delay"]["value"] if m["delay"] else SEARCHED_S)
    )
    scaled = sorted((m for m in margins if m["signal"] != ALL), key=_room)
    lines = [
        (f"{m['signal']} {_delay_in_words(m['delay'])}" for m in late),
        (f"{m['signal']} {_scale_in_words(m)}" for m in scaled),
    ]
    first = ("delay margin: ", "gain margin (factors between which it is stable): ")
    return [start + _shortened(list(parts)) for start, parts in zip(first, lines, strict=True)]


def _shortened(parts: list[str]) -> str:
    more = [f"{len(parts) - _SHOWN} more with larger margins"] if len(parts) > _SHOWN else []
    return ", ".join([*parts[:_SHOWN], *more])


def _room(margin: Mapping[str, Any]) -> float:
    """How far from 1 the nearest factor is that a signal may not have."""
    return min(
        (abs(m["value"] - 1.0) for m in (margin["lower"], margin["upper"]) if m), default=SEARCHED_SCALE
    )


def _delay_in_words(contact: Mapping[str, Any] | None) -> str:
    return (
        f"{SEARCHED_S:g} s and over"
        if contact is None
        else f"{1e3 * contact['value']:.0f} ms{_where(contact)}"
    )


def _scale_in_words(margin: Mapping[str, Any]) -> str:
    low, high = margin["lower"], margin["upper"]
    down = f"-{SEARCHED_SCALE:g} or less" if low is None else f"{low['value']:.2f}"
    up = f"{SEARCHED_SCALE:g} or more" if high is None else f"{high['value']:.2f}"
    return f"{down} to {up}{'' if high is None else _where(high)}"


def _where(contact: Mapping[str, Any]) -> str:
    hertz = contact["frequency_hz"]
    return f" ({f'{hertz:.2f} Hz' if hertz else 'real root'}, {contact['point']})"
