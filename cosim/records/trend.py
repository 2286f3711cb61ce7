"""Oscillations tracked over the parts of a long record: damping over the day, and forced intervals."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from statistics import median
from typing import TYPE_CHECKING, Any

from .ambient import LIKE, Estimate
from .files.read import Piece
from .forced import FORCED, MODAL
from .meter import NEAR_HZ, Meter, Swing, likeness, meter
from .record import BAND_HZ, Record, RecordError

if TYPE_CHECKING:
    import pandas as pd

    from interarea.design.modes.modes import Mode

EVERY_S = 600.0  #: length of a part: what gives the damping ratios of docs/records.md


@dataclass(frozen=True)
class Part:
    """A part of a record. start_s : since its first sample. meter : its swings, or None and `why`."""

    start_s: float
    meter: Meter | None
    why: str = ""


@dataclass(frozen=True)
class Track:
    """One oscillation through the parts of a record. swings : number of the part -> the oscillation there."""

    swings: Mapping[int, Swing]

    @property
    def frequency_hz(self) -> float:
        """Median over the parts, Hz."""
        return median(s.frequency_hz for s in self.swings.values())

    @property
    def mode(self) -> str:
        """Mode of the case assigned in most parts; "" for none."""
        names = [s.mode for s in self.swings.values()]
        return max(dict.fromkeys(names), key=names.count)

    @property
    def estimates(self) -> dict[int, Estimate]:
        """Number of the part -> estimate of the first method, if there is one."""
        return {k: s.estimates[0] for k, s in self.swings.items() if s.estimates}

    @property
    def forced(self) -> tuple[int, ...]:
        """Return the parts in which it is forced."""
        return tuple(k for k, s in self.swings.items() if s.kind == FORCED)


@dataclass(frozen=True)
class Trend:
    """Damping over the time of a record. tracks : those in most parts first. start : a date, or ""."""

    source: str
    start: str
    every_s: float
    quantity: str
    unit: str
    parts: tuple[Part, ...]
    tracks: tuple[Track, ...]
    notes: tuple[str, ...]

    def table(self) -> pd.DataFrame:
        """Return a row for each swing of each part; `track` is its number in `tracks`."""
        import pandas as pd

        rows = [self._row(k, number, s) for k, t in enumerate(self.tracks) for number, s in t.swings.items()]
        return pd.DataFrame(rows).sort_values(["start_s", "track"], ignore_index=True)

    def _row(self, track: int, part: int, swing: Swing) -> dict[str, Any]:
        row: dict[str, Any] = {
            "start_s": self.parts[part].start_s, "track": track, "frequency_hz": swing.frequency_hz,
            "kind": swing.kind, "amplitude": swing.amplitude, "mode": swing.mode,
        }  # fmt: skip
        for e in swing.estimates[:1]:
            low, high = e.damping_interval
            row |= {"damping_ratio": e.damping_ratio, "damping_low": low, "damping_high": high}
        return row

    def as_dict(self) -> dict[str, Any]:
        """Return plain types, for JSON."""
        tracks = [
            {"frequency_hz": t.frequency_hz, "mode": t.mode, "swings": [
                self._row(k, part, swing) for part, swing in t.swings.items()]}
            for k, t in enumerate(self.tracks)
        ]  # fmt: skip
        refused = [{"start_s": p.start_s, "why": p.why} for p in self.parts if p.meter is None]
        plain = {k: v for k, v in vars(self).items() if k not in ("parts", "tracks", "notes")}
        return {**plain, "parts": len(self.parts), "refused": refused, "tracks": tracks,
                "notes": list(self.notes)}  # fmt: skip


def trend(
    pieces: Iterable[Piece],
    every_s: float = EVERY_S,
    *,
    band_hz: tuple[float, float] = BAND_HZ,
    quantity: str | None = None,
    channels: Sequence[str] = (),
    modes: Sequence[Mode] = (),
) -> Trend:
    """Analyse each part of a record and track its oscillations from part to part.

    pieces : of `read_pieces`, read one after the other. Two oscillations are the same if they are one mode of
    the case, or near in frequency with shapes less than 45 degrees apart; a forced one is never matched to a
    mode. The other arguments are those of `meter`.

    Raises
    ------
    RecordError : no part can be analysed; states the reason of the first one.
    """
    parts: list[Part] = []
    tracks: list[dict[int, Swing]] = []
    first, start = None, ""
    for piece in pieces:
        if first is not None and not channels:
            quantity = first.quantity  # of one part after the other the same
        try:
            record = _record(piece)
            result = meter(record, band_hz=band_hz, quantity=quantity, channels=channels, modes=modes)
        except RecordError as error:
            parts.append(Part(piece.start_s, None, str(error)))
            continue
        if first is None:
            first, start = result, record.start
        parts.append(Part(piece.start_s, result))
        _follow(tracks, len(parts) - 1, result.swings)
    if first is None:
        none = "no part of the file lies in the window, allowed: a window that holds a part of it"
        raise RecordError(parts[0].why if parts else none)
    order = sorted(tracks, key=lambda t: -len(t))
    return Trend(
        first.source, start, every_s, first.quantity, first.unit, tuple(parts), tuple(map(Track, order)),
        _notes(parts),
    )  # fmt: skip


def _record(piece: Piece) -> Record:
    if isinstance(piece.record, RecordError):
        raise piece.record
    return piece.record


def _notes(parts: Sequence[Part]) -> tuple[str, ...]:
    """Return the notes that all parts have, and one on those that only some have."""
    each = [part.meter.notes for part in parts if part.meter]
    common = [n for n in each[0] if all(n in notes for notes in each)]
    own = [[n for n in notes if n not in common] for notes in each]
    if many := sum(map(bool, own)):
        example = next(notes[0] for notes in own if notes)
        common.append(f"{many} of {len(parts)} parts have separate notes, the first: {example}")
    return tuple(common)


def _follow(tracks: list[dict[int, Swing]], part: int, swings: Sequence[Swing]) -> None:
    """Add the swings of a part to the tracks they go on, each to one at most, or begin new ones."""
    for swing in swings:
        same = [t for t in tracks if part not in t and _is_same(t[max(t)], swing)]
        # the longest: where one mode was taken for two, they are one again
        track = max(same, key=len, default=None)
        if track is None:
            tracks.append(track := {})
        track[part] = swing


def _is_same(earlier: Swing, swing: Swing) -> bool:
    if {earlier.kind, swing.kind} == {FORCED, MODAL}:
        return False
    if earlier.mode and earlier.mode == swing.mode:
        return True
    near = abs(earlier.frequency_hz - swing.frequency_hz) <= NEAR_HZ * swing.frequency_hz
    return near and likeness(earlier.shape, swing.shape) >= LIKE
