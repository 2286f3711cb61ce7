"""Source of a forced oscillation by the linear model of the grid.

At its frequency f every place where an oscillation may enter (mechanical power and voltage reference of each
machine, modulation inputs, loads) has its own pattern of phasors over all channels,

    y = H(j 2 pi f) d + e,

with H of the full plant. Each single place is tried, then each pair: the amplitude is fitted by weighted
least squares, and the residual compared. The errors e are the motion of each channel beside the line, and
phasor errors of `PHASOR_ERROR`. The model must be at the operating point of the record; the residual shows
whether it is. The method also holds where the energy flow of `energy.py` does not: in networks with losses,
with any control and load.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from math import pi
from typing import Any

import numpy as np
import numpy.typing as npt
from scipy.optimize import minimize_scalar

from interarea.design.linear.sparse_plant import SparsePlant
from interarea.models.case.case import Case

from .energy import strongest_line
from .forced import sines
from .record import BAND_HZ, Array, Record, RecordError

ComplexArray = npt.NDArray[np.complex128]

MECHANICAL, REFERENCE, LOAD, INPUT = "mechanical power", "voltage reference", "load", "input"
#: of the phasors of a quantity: total vector error that IEEE C37.118.1 allows a PMU
PHASOR_ERROR = 0.01
#: share of what was measured that a source may leave unexplained: an error of 20 % of the phasors
EXPLAINED = 0.04
#: what the next source leaves over what the first does: less, and the data do not tell them apart
CLEAR = 2.0
_LEAST_CHANNELS = 4
_LEAST_PERIODS = 5.0
_WORTH_TWO = 10.0  #: what one source leaves over what two do: two of hundreds explain noise better than one
_SAME = 1e-6  #: 1 - squared cosine of two patterns that no record tells apart
_EXACT = 1e-6  #: share that is left by rounding and the curvature of the plant alone
_PAIRS = 40  #: that are looked at closely
_OF_BRANCH = ("active power", "reactive power", "current")


@dataclass(frozen=True)
class Candidate:
    """One or two places where an oscillation may enter.

    amplitude : of each place, in `units`: torque at the shaft in pu of the machine, pu of the reference or
    input, or a share of the load. unexplained : share of the measured phasors' squares that is left.
    """

    places: tuple[str, ...]
    kinds: tuple[str, ...]
    at: tuple[str, ...]
    amplitude: tuple[float, ...]
    units: tuple[str, ...]
    unexplained: float

    @property
    def text(self) -> str:
        """The places with their kinds, as a message has them."""
        each = zip(self.places, self.kinds, strict=True)
        return " and ".join(f"{place} ({kind})" for place, kind in each)


@dataclass(frozen=True)
class ModelSource:
    """Result of the model. candidates : the best, single places first, by their residual.

    source : the best if it explains the record and no place elsewhere does nearly as well, else None. others
    : units at the same bus that the measurements do not distinguish. why : in words. likelihood : twice the
    logarithm of the ratio of the first two. channels : number used.
    """

    case: str
    frequency_hz: float
    candidates: tuple[Candidate, ...]
    source: Candidate | None
    others: tuple[Candidate, ...]
    why: str
    likelihood: float
    channels: int
    notes: tuple[str, ...]

    def as_dict(self) -> dict[str, Any]:
        """Return plain types, for JSON."""
        plain = {k: v for k, v in vars(self).items() if k not in ("candidates", "others", "source", "notes")}
        plain |= {k: [vars(c) for c in getattr(self, k)] for k in ("candidates", "others")}
        plain["source"] = None if self.source is None else vars(self.source)
        return {**plain, "notes": list(self.notes)}


@dataclass(frozen=True, eq=False)
class _Entry:
    """A place where an oscillation may enter.

    moved : (n,) dx/dt, injected : (buses, 2) currents, for 1 `unit`. at : the bus, or what acts by itself.
    """

    name: str
    kind: str
    at: str
    unit: str
    moved: Array
    injected: Array


def source_by_model(
    record: Record,
    case: Case,
    plant: SparsePlant,
    *,
    frequency_hz: float | None = None,
    band_hz: tuple[float, float] = BAND_HZ,
    most: int = 8,
) -> ModelSource:
    """Return the place of a grid where an oscillation enters.

    plant : of the case, linear. frequency_hz : near that of the oscillation, which is then fitted within half
    a line of the spectrum; default the largest peak of the band. most : candidates that are returned.

    Raises
    ------
    RecordError : too few periods, no clear peak, or fewer than `_LEAST_CHANNELS` channels of places in the
    case.
    """
    keys, values, notes = _channels(record, case, plant)
    if len(keys) < _LEAST_CHANNELS:
        raise RecordError(
            f"{record.source}: {len(keys)} channels are at places of {case.name}, wanted: "
            f"{_LEAST_CHANNELS} at least, named bus7, branch[7-8] or as a machine of the case"
        )
    if frequency_hz is None:
        moving = [x / x.std() for x in values.T if x.std() > 0.0]
        frequency_hz = strongest_line(record, moving, band_hz)
    if not record.length_s * frequency_hz >= _LEAST_PERIODS:
        raise RecordError(
            f"{record.source}: {record.length_s:.4g} s are {record.length_s * frequency_hz:.3g} periods of "
            f"{frequency_hz:.3g} Hz, wanted: {_LEAST_PERIODS:g} at least"
        )
    f = _fitted(values, record.step_s, frequency_hz)
    entries = _entries(case, plant)
    rows = _rows(plant, entries, f)
    y, noise = _phasors(values, record.step_s, f)
    H: ComplexArray = np.array([rows[key] for key in keys], dtype=complex)
    weights = 1.0 / np.hypot(noise, PHASOR_ERROR * _sizes(y, [quantity for _, quantity in keys]))
    angles = np.array(["angle" in quantity for _, quantity in keys])
    H, y = _without_reference(H * weights[:, None], y * weights, np.where(angles, weights, 0.0))
    one = _singles(H, y, entries)
    by_chance = len(keys) / max(float(np.sum(np.abs(y) ** 2)), 1e-300)
    two = _pairs(H, y, entries) if one[0].unexplained > by_chance else []
    if two and not two[0].unexplained * _WORTH_TWO <= one[0].unexplained:
        two = []
    source, others, why = _verdict(two or one, max(EXPLAINED, CLEAR * by_chance))
    left = [each.unexplained for each in (two or one)[:2]]
    ratio = left[-1] / max(left[0], by_chance, _EXACT)  # of a single place 1 at most: nothing is beside it
    best = sorted([*one[:most], *two[:most]], key=lambda c: (len(c.places), c.unexplained))
    likelihood = float(2 * len(keys) * np.log(max(ratio, 1.0)))
    return ModelSource(case.name, f, tuple(best), source, others, why, likelihood, len(keys), tuple(notes))


def _entries(case: Case, plant: SparsePlant) -> list[_Entry]:
    """Return every place where an oscillation may enter: torques, inputs, loads."""
    none_x, none_v = np.zeros(plant.nstates), np.zeros((len(plant.bus_names), 2))
    of_machine = {m.name: m for m in case.machines}
    entries = []
    for name, speed in zip(plant.machines, plant.speed, strict=True):
        machine, torque = of_machine[name], none_x.copy()
        if machine.H is not None:
            torque[speed] = 0.5 / machine.H
            entries.append(_Entry(name, MECHANICAL, f"bus{machine.bus}", "pu torque", torque, none_v))
    for k, name in enumerate(plant.inputs):
        column = plant.Bu[:, [k]].toarray()[:, 0]
        exciter = of_machine.get(name.removesuffix("_vs"))
        if exciter is None:
            entries.append(_Entry(name, INPUT, name, "pu", column, none_v))
        else:
            entries.append(_Entry(exciter.name, REFERENCE, f"bus{exciter.bus}", "pu", column, none_v))
    at = {name: k for k, name in enumerate(plant.bus_names)}
    for load in (load for load in case.loads if load.in_service and str(load.bus) in at):
        k, current = at[str(load.bus)], none_v.copy()
        drawn = np.conj(complex(load.P_mw, load.Q_mvar) / case.base_mva / plant.at_bus[k])
        current[k] = -drawn.real, -drawn.imag
        entries.append(_Entry(load.name, LOAD, f"bus{load.bus}", "of the load", none_x, current))
    return entries


def _rows(plant: SparsePlant, entries: Sequence[_Entry], f: float) -> dict[tuple[str, str], ComplexArray]:
    """Return for each terminal and quantity its phasors (entries,) for 1 at each entry, of one solution."""
    moved = np.array([entry.moved for entry in entries]).T
    injected = np.moveaxis(np.array([entry.injected for entry in entries]), 0, -1)
    swing = plant.forced(2j * pi * f, moved, injected)
    size, angle = plant.size_and_angle(swing.voltages)
    at_bus = {"voltage": size, "voltage angle": angle, "frequency": f * 1j * angle}
    of_shaft = {"speed": swing.states[plant.speed], "rotor angle": swing.states[plant.angle]}
    of_shaft |= {q: row[plant.bus[: len(plant.machines), 0]] for q, row in at_bus.items()}
    flows = dict(zip(_OF_BRANCH, plant.branch_flows(swing.voltages), strict=True))
    rows: dict[tuple[str, str], ComplexArray] = {}
    for terminals, of in zip(_terminals(plant), (at_bus, of_shaft, flows), strict=True):
        rows |= {(terminal, q): row[k] for q, row in of.items() for k, terminal in enumerate(terminals)}
    return rows


def _terminals(plant: SparsePlant) -> tuple[list[str], list[str], list[str]]:
    """Return the names of buses, machines and branches as terminals of a record."""
    buses = [f"bus{name}" for name in plant.bus_names]
    return buses, list(plant.machines), [f"branch[{name}]" for name in plant.branches]


def _at_rest(plant: SparsePlant) -> dict[tuple[str, str], float]:
    """Return what every terminal has at rest, pu; of a quantity that is 0 on average, 0."""
    buses, machines, branches = _terminals(plant)
    size = np.abs(plant.at_bus)
    a, b = plant.ends.T
    current = np.abs(plant.stamps[:, 0] * plant.at_bus[a] + plant.stamps[:, 1] * plant.at_bus[b])
    rest = dict.fromkeys([(t, q) for t in (*buses, *machines) for q in ("voltage angle", "frequency")], 0.0)
    rest |= dict.fromkeys([(t, q) for t in machines for q in ("speed", "rotor angle")], 0.0)
    rest |= dict.fromkeys([(t, q) for t in branches for q in ("active power", "reactive power")], 0.0)
    rest |= {(t, "voltage"): float(v) for t, v in zip(buses, size, strict=True)}
    rest |= {(m, "voltage"): float(size[k]) for m, k in zip(machines, plant.bus[:, 0], strict=False)}
    return rest | {(t, "current"): float(v) for t, v in zip(branches, current, strict=True)}


def _channels(
    record: Record, case: Case, plant: SparsePlant
) -> tuple[list[tuple[str, str]], Array, list[str]]:
    """Return the channels that the model has, their values in its units, and notes on the others."""
    rest = _at_rest(plant)
    terminals = {terminal for terminal, _ in rest}
    keys: list[tuple[str, str]] = []
    columns, unknown, without = [], [], []
    for channel in record.channels:
        terminal = _terminal(channel.terminal, case, terminals)
        if terminal is None:
            unknown.append(channel.terminal or channel.name)
            continue
        key, values = (terminal, channel.quantity), record[channel.name]
        if key not in rest or key in keys:
            without.append(f"{channel.quantity} of {channel.terminal}")
            continue
        if channel.unit in ("MW", "Mvar"):
            values = values / case.base_mva
        elif channel.unit in ("kV", "A"):  # of a phase or a line: so that the mean is that of the model
            values = values * (rest[key] / float(np.mean(values)))
        keys.append(key)
        columns.append(values)
    notes = [_listed(unknown, f"{case.name} has no such place")] if unknown else []
    notes += [_listed(without, "not used, the model has none")] if without else []
    return keys, np.array(columns).T if columns else np.zeros((len(record.time_s), 0)), notes


def _listed(what: Sequence[str], why: str) -> str:
    names = list(dict.fromkeys(what))
    more = f" and {len(names) - 4} more" if len(names) > 4 else ""
    return f"{', '.join(names[:4])}{more}: {why}"


def _terminal(name: str, case: Case, known: set[str]) -> str | None:
    """Return the place of a case that a terminal is; of PSS/E ``7 1`` and ``7-8 1`` where only one fits."""
    if name in known:
        return name
    if f"branch[{name}]" in known:
        return f"branch[{name}]"
    if match := re.fullmatch(r"(\d+)-(\d+) \S+", name):
        ends = int(match[1]), int(match[2])
        fits = [f"branch[{b.name}]" for b in case.branches if (b.from_bus, b.to_bus) == ends]
    elif match := re.fullmatch(r"(\d+) \S+", name):
        fits = [m.name for m in case.machines if m.bus == int(match[1])]
    else:
        return None
    fits = [fit for fit in fits if fit in known]
    return fits[0] if len(fits) == 1 else None


def _fitted(values: Array, step_s: float, near_hz: float) -> float:
    """Return the frequency of the sine with the least residual in the normalised signals."""
    half = 0.5 / (len(values) * step_s)
    scaled = values - values.mean(axis=0)
    scaled = scaled / np.maximum(scaled.std(axis=0), 1e-12)

    def left(f: float) -> float:
        basis = _basis(len(values), step_s, f)
        return float(np.sum((scaled - basis @ np.linalg.lstsq(basis, scaled, rcond=None)[0]) ** 2))

    span = (max(near_hz - half, 0.5 * near_hz), near_hz + half)
    return float(minimize_scalar(left, bounds=span, method="bounded", options={"xatol": 1e-3 * half}).x)


def _basis(points: int, step_s: float, f: float) -> Array:
    """Return a line and a sine of a record: (points, 4)."""
    t = np.arange(points) * step_s
    return np.column_stack([np.ones(points), t - t.mean(), sines(points, step_s, [f])])


def _phasors(values: Array, step_s: float, f: float) -> tuple[ComplexArray, Array]:
    """Return the phasor of each signal at f, and its standard deviation by what moves beside the line."""
    basis = _basis(len(values), step_s, f)
    fit = np.linalg.lstsq(basis, values, rcond=None)[0]
    y = fit[2] - 1j * fit[3]
    rest = values - basis @ fit
    T = len(values) * step_s
    # the noise that counts is that near f: of lines 2 to 6 widths beside it
    beside = [f + k / T for k in (-6, -5, -4, -3, -2, 2, 3, 4, 5, 6) if f + k / T > 1.0 / T]
    around = [
        np.abs(np.exp(-2j * pi * g * step_s * np.arange(len(values))) @ rest) * 2.0 / len(values)
        for g in beside
    ]
    return y, np.sqrt(np.mean(np.square(around), axis=0) / 2.0)


def _sizes(y: ComplexArray, quantities: Sequence[str]) -> Array:
    """Return for each channel the rms phasor of its quantity; never 0."""
    size = np.abs(y)
    rms = {q: float(np.sqrt(np.mean(size[[k == q for k in quantities]] ** 2))) for q in set(quantities)}
    return np.maximum([rms[q] for q in quantities], 1e-12)


def _without_reference(H: ComplexArray, y: ComplexArray, angles: Array) -> tuple[ComplexArray, ComplexArray]:
    """Take out what all angles have in common: a record's reference may be that of any bus."""
    if not angles.any():
        return H, y
    unit = angles / np.linalg.norm(angles)
    return H - np.outer(unit, unit @ H), y - unit * (unit @ y)


def _singles(H: ComplexArray, y: ComplexArray, entries: Sequence[_Entry]) -> list[Candidate]:
    """Return every place with the amplitude that explains most, the best first."""
    own = np.sum(np.abs(H) ** 2, axis=0)
    d = H.conj().T @ y / np.maximum(own, 1e-300)
    total = float(np.sum(np.abs(y) ** 2))
    left = 1.0 - np.abs(d) ** 2 * own / max(total, 1e-300)
    return [_candidate([k], [d[k]], left[k], entries) for k in np.argsort(left)]


def _pairs(H: ComplexArray, y: ComplexArray, entries: Sequence[_Entry]) -> list[Candidate]:
    """Return the pairs of places that explain most, the best first."""
    keep = np.flatnonzero(np.sum(np.abs(H) ** 2, axis=0) > 0.0)
    Q = H[:, keep] / np.linalg.norm(H[:, keep], axis=0)
    gram, b = Q.conj().T @ Q, Q.conj().T @ y
    apart = 1.0 - np.abs(gram) ** 2
    np.fill_diagonal(apart, np.inf)
    apart[apart < _SAME] = np.inf  # two places with one pattern are no pair
    size = np.abs(b) ** 2
    cross = 2.0 * np.real(b.conj()[:, None] * gram * b[None, :])
    explained = (size[:, None] + size[None, :] - cross) / apart
    upper = np.triu_indices(len(keep), 1)
    best = np.argsort(-explained[upper])[:_PAIRS]
    total = float(np.sum(np.abs(y) ** 2))
    pairs = []
    for i, k in zip(upper[0][best], upper[1][best], strict=True):
        chosen = keep[[i, k]]
        d = np.linalg.lstsq(H[:, chosen], y, rcond=None)[0]
        rest = float(np.sum(np.abs(y - H[:, chosen] @ d) ** 2))
        pairs.append(_candidate(list(chosen), list(d), rest / max(total, 1e-300), entries))
    return sorted(pairs, key=lambda pair: pair.unexplained)


def _candidate(at: Sequence[int], d: Sequence[complex], left: float, entries: Sequence[_Entry]) -> Candidate:
    places = [entries[k] for k in at]
    return Candidate(
        tuple(place.name for place in places),
        tuple(place.kind for place in places),
        tuple(place.at for place in places),
        tuple(float(abs(x)) for x in d),
        tuple(place.unit for place in places),
        float(max(left, 0.0)),
    )


def _verdict(
    ranked: Sequence[Candidate], allowed: float
) -> tuple[Candidate | None, tuple[Candidate, ...], str]:
    """Return the candidate that explains the record alone, or None, units like it, and why."""
    best = ranked[0]
    if not best.unexplained <= allowed:
        return (
            None,
            (),
            f"no place of the model explains it: unexplained share {best.unexplained:.1%} at best, by "
            f"{best.text}, "
            f"allowed: {allowed:.1%}; the source is outside the model, or this is not its operating point",
        )
    near = max(best.unexplained, _EXACT) * CLEAR
    close = [c for c in ranked[1:] if not c.unexplained >= near]
    same = sorted(best.at), sorted(best.kinds)
    elsewhere = [c for c in close if (sorted(c.at), sorted(c.kinds)) != same]
    if elsewhere:
        return (
            None,
            (),
            f"{best.text} and {elsewhere[0].text} explain it almost equally: {best.unexplained:.2%} and "
            f"{elsewhere[0].unexplained:.2%} are unexplained",
        )
    what = "one source" if len(best.places) == 1 else "two sources"
    units = f" (or {', '.join(c.text for c in close)}, at the same bus)" if close else ""
    rest = [c for c in ranked[1:] if c not in close]
    after = f"; next: {rest[0].text}, {rest[0].unexplained:.1%}" if rest else ""
    return best, tuple(close), f"{what}: {best.text}{units}; unexplained {best.unexplained:.2%}{after}"
