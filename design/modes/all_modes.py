"""All modes of a grid of any size within a band and below a damping ratio, counted independently."""

from __future__ import annotations

from cmath import phase
from collections.abc import Mapping
from dataclasses import dataclass
from math import degrees
from typing import Any

import numpy as np

from ..linear.matrices import LinearMatrices
from ..linear.resolvent import Loop, OpenLoop
from ..linear.sparse_plant import SparsePlant
from ..linear.zero_eigenvalues import ZeroEigenvalues, zero_eigenvalues_of
from .growth import WHOLE
from .mode_count import RIGHT, SLOWEST, Count, OnTheLine, Rectangle, Region, count_modes
from .mode_search import Pair, Search
from .modes import Mode, ModeError, Participation, modes_of
from .patterns import pattern_parts

RESIDUAL = 1e-9  #: largest |A v - lambda v| / (|lambda| |v|)
COMMON = "common frequency"  #: all machines together, what governors hold
_MECHANICAL = 0.1  # share of angles and speeds below which a mode is of the controls
_SAME = 1e-5  # relative: one mode computed in two ways
_ROUNDS = 8
_LEFT = (-SLOWEST, -3.0 * SLOWEST, -0.3 * SLOWEST)  # 1/s: where the count below the band starts


@dataclass(frozen=True)
class AllModes:
    """Modes of a region, by frequency, and how many there are by an independent count.

    Attributes
    ----------
    modes : names by shape (`inter-area 2`, `local area 1.3`, `common frequency`, `control 4`), numbered by
        frequency. Of a plant of at most `growth.WHOLE` states the swing modes have the names of `modes_of`.
    counted : modes in the region by the argument principle; equals the number of `modes`.
    band_hz, below : the counted region. moved : boundaries that were moved away from a mode, in words.
    residual : the largest of any mode.
    standing : structural zero eigenvalues, no instability: the rotation of all rotors, exciters that share a
        bus, inactive controls.
    near_zero : eigenvalues slower than the band that do not decay, by a separate count; the excess over
        `standing` grows.
    searched, factorisations : factorisations of shifted plants by the search, and of N(s) by the counts.
    """

    modes: tuple[Mode, ...]
    counted: int
    band_hz: tuple[float, float]
    below: float
    moved: tuple[str, ...]
    residual: float
    zero_eigenvalues: ZeroEigenvalues
    near_zero: int
    searched: int
    factorisations: int

    @property
    def rotation(self) -> bool:
        """Whether a common rotation of all rotors has no effect (no infinite bus)."""
        return self.zero_eigenvalues.rotation

    @property
    def growing_slowly(self) -> int:
        """Eigenvalues slower than the band that grow, or decay within hours, without structural zeros."""
        return self.near_zero - self.zero_eigenvalues.count

    @property
    def unstable(self) -> tuple[Mode, ...]:
        """Modes that grow."""
        return tuple(m for m in self.modes if m.eigenvalue.real > 0.0)

    @property
    def remarks(self) -> tuple[str, ...]:
        """Remarks on the modes, as sentences: residual, zero and growing eigenvalues."""
        message = [f"largest residual {self.residual:.1e}", *self.zero_eigenvalues.remarks]
        slow = (
            f"below {self.band_hz[0]:g} Hz, {self.near_zero} eigenvalues do not decay (independent count); "
        )
        if self.growing_slowly:
            message.append(
                f"{slow}{self.zero_eigenvalues.count} of them are zero and {self.growing_slowly} grow: "
                "unstable; a lower --band shows the oscillatory ones, a real one is an instability of a "
                "voltage or a control"
            )
        elif self.near_zero > 1:
            message.append(f"{slow}all of them are zero for the reasons above, none grows")
        if not any(mode.name.startswith("inter-area") for mode in self.modes):
            message.append("no inter-area mode among them; use a wider --band, or assign machines to areas")
        if self.unstable:
            message.append(f"unstable: {', '.join(mode.name for mode in self.unstable)}")
        return tuple(message)

    def as_dict(self, count: int, *, shapes: bool) -> dict[str, Any]:
        """Return the record as JSON values, with the `count` dominant states of each mode."""
        rows = [
            {
                "name": mode.name,
                "eigenvalue": [mode.eigenvalue.real, mode.eigenvalue.imag],
                "frequency_hz": mode.frequency_hz,
                "damping_ratio": mode.damping_ratio,
                "share": mode.share,
                "participation": mode.most(count),
                "shape": {
                    machine: {"size": abs(z), "angle_deg": degrees(phase(z))}
                    for machine, z in (mode.shape.items() if shapes else ())
                },
            }
            for mode in self.modes
        ]
        return {
            "band_hz": list(self.band_hz),
            "below": self.below,
            "counted": self.counted,
            "moved": list(self.moved),
            "residual": self.residual,
            "rotation": self.rotation,
            "standing": self.zero_eigenvalues.as_dict(),
            "near_zero": self.near_zero,
            "unstable": [mode.name for mode in self.unstable],
            "modes": rows,
        }


def all_modes(
    plant: SparsePlant,
    areas: Mapping[str, int],
    *,
    band_hz: tuple[float, float],
    below: float,
    loop: Loop | None = None,
) -> AllModes:
    """Compute every mode of `plant` in a band below a damping ratio; verify by a count that these are all.

    Parameters
    ----------
    loop : the plant with a controller around it (`design.delay.late_plant`); default none.
    areas : machine name -> area number, for names.
    band_hz : frequencies, Hz. below : damping ratio, over 0 and under 1.

    Raises
    ------
    ModeError : an invalid band or limit, or different numbers of computed and counted modes.
    """
    low, high = band_hz
    if not 0.0 < low < high < np.inf:
        raise ModeError(f"band {low:g}:{high:g} Hz, wanted LOW:HIGH with 0 < LOW < HIGH, such as 0.1:2.5")
    if not 0.0 < below < 1.0:
        raise ModeError(f"below = {below:g}, wanted a damping ratio over 0 and under 1, such as 0.2")
    requested = Region((2.0 * np.pi * low, 2.0 * np.pi * high), float(below))
    search = Search(loop or OpenLoop(plant), requested, RESIDUAL)
    search.everywhere(requested)
    exact = _Exact(search)
    region, count = _counted(exact, requested)
    for _ in range(_ROUNDS):
        if count.modes == len(exact.within(region)) or not search.again():
            break
        region, count = _counted(exact, requested)
    pairs = exact.within(region)
    if len(pairs) != count.modes:
        raise ModeError(
            f"{len(pairs)} modes computed but {count.modes} counted between {low:g} and {high:g} Hz below a "
            f"damping ratio of {below:g}; use a narrower band or another limit to locate the difference"
        )
    zero_eigenvalues = zero_eigenvalues_of(plant, loop)
    slow = _near_zero(exact, region, zero_eigenvalues)
    hz = (region.band[0] / (2.0 * np.pi), region.band[1] / (2.0 * np.pi))
    return AllModes(
        modes=_named(plant, pairs, areas, _swings(plant, areas) if loop is None else {}),
        counted=count.modes,
        band_hz=hz,
        below=region.below,
        moved=region.moved,
        residual=max((p.residual for p in pairs), default=0.0),
        zero_eigenvalues=zero_eigenvalues,
        near_zero=slow.modes,
        searched=search.factorisations,
        factorisations=count.factorisations + slow.factorisations,
    )


class _Exact:
    """The pairs of a search as modes of the loop itself: its matrix may stand for delays."""

    def __init__(self, search: Search) -> None:
        self.search = search
        self._pairs: list[Pair] = []

    @property
    def pairs(self) -> list[Pair]:
        """All pairs; one that does not converge keeps its residual, and the count reveals it."""
        for p in self.search.pairs[len(self._pairs) :]:
            self._pairs.append(Pair(*self.search.loop.exact(p.value, p.right, p.left)))
        return self._pairs

    def within(self, region: Region) -> list[Pair]:
        """Modes of a region by frequency."""
        settled = (p for p in self.pairs if p.residual <= RESIDUAL and region.holds(p.value))
        return sorted(settled, key=lambda p: p.value.imag)


def _counted(exact: _Exact, whole: Region) -> tuple[Region, Count]:
    """Count within the region, with its sides moved off the modes that lie on them."""
    known = [*(p.value for p in exact.pairs), *exact.search.beside]
    region = whole.clear_of(known)
    for _ in range(_ROUNDS):
        try:
            return region, count_modes(exact.search.loop, region, known)
        except OnTheLine as error:
            region = region.aside(error.side)
    raise ModeError(
        f"modes lie on every boundary tried: {'; '.join(region.moved)}; choose another band or limit"
    )


def _near_zero(exact: _Exact, region: Region, zero_eigenvalues: ZeroEigenvalues) -> Count:
    """Count what is slower than the band and does not decay."""
    known = [*(p.value for p in exact.pairs), *([0j] * zero_eigenvalues.count)]
    for k, left in enumerate(_LEFT):
        slow = Rectangle(left, RIGHT, region.band[0] * (1.0 - 0.01 * k))
        try:
            result = count_modes(exact.search.loop, slow, known)
        except OnTheLine:
            continue
        if result.modes >= zero_eigenvalues.count:
            return result
    raise ModeError(
        f"{zero_eigenvalues.count} structural zero eigenvalues could not be counted below "
        f"{region.band[0] / (2.0 * np.pi):g} Hz; choose another lower end of the band"
    )


def _swings(plant: SparsePlant, areas: Mapping[str, int]) -> Mapping[str, Mode]:
    """The swing modes by the names that `modes_of` gives them; none where it is large or has others."""
    if plant.nstates > WHOLE:
        return {}
    C = np.zeros((len(plant.machines), plant.nstates))
    C[np.arange(len(plant.machines)), plant.speed] = 1.0
    speeds = [f"{machine}_dw" for machine in plant.machines]
    A, none = plant.state_matrix(), np.zeros((plant.nstates, 0))
    try:
        return modes_of(LinearMatrices(A, none, C, C[:, :0], plant.states, [], speeds), areas)
    except ModeError:
        return {}


def _named(
    plant: SparsePlant, pairs: list[Pair], areas: Mapping[str, int], swings: Mapping[str, Mode]
) -> tuple[Mode, ...]:
    """Name modes by shape; where all swing modes are known, what is none of them is a control's."""
    area_of = [areas[m] for m in plant.machines]
    kinds = []
    known: list[Mode | None] = []
    for pair in pairs:
        kind, share = _kind(plant, pair, area_of)
        near = [m for m in swings.values() if abs(m.eigenvalue - pair.value) <= _SAME * abs(pair.value)]
        known.append(near[0] if near else None)
        if near:
            kind, share = near[0].name, near[0].share
        elif swings and kind != COMMON:
            kind = "control"
        kinds.append((kind, share))
    of_kind = [kind for kind, _ in kinds]
    modes = []
    for k, (pair, (kind, share)) in enumerate(zip(pairs, kinds, strict=True)):
        separator = "." if kind.startswith("local") else " "
        number = of_kind[: k + 1].count(kind)
        swing = known[k]
        name = kind if of_kind.count(kind) == 1 or swing is not None else f"{kind}{separator}{number}"
        speeds = pair.right[plant.speed]
        speeds = speeds / speeds[np.argmax(np.abs(speeds))]
        weight = np.abs(pair.left * pair.right)
        modes.append(
            Mode(
                name=name,
                eigenvalue=pair.value,
                shape=dict(zip(plant.machines, speeds.tolist(), strict=True)),
                participation=Participation(plant.states, weight / weight.sum()),
                share=share,
                right=pair.right,
                left=pair.left,
                rivals=() if swing is None else swing.rivals,
            )
        )
    return tuple(modes)


def _kind(plant: SparsePlant, pair: Pair, area_of: list[int]) -> tuple[str, float]:
    """The pattern that takes most part in a mode, and its share."""
    weight = np.abs(pair.left * pair.right)
    mechanical = float((weight[plant.speed].sum() + weight[plant.angle].sum()) / weight.sum())
    if mechanical < _MECHANICAL:
        return "control", 1.0 - mechanical
    w, v = pair.left[plant.speed], pair.right[plant.speed]
    parts: dict[str, float] = {COMMON: float(len(v) * abs(w.mean() * v.mean()))}
    parts |= pattern_parts(w, v, area_of)
    if len(set(area_of)) == 1:
        del parts["inter-area"]
    kind = max(parts, key=lambda name: parts[name])
    return kind, parts[kind] / max(sum(parts.values()), 1e-300)
