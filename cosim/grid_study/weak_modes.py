"""Modes to be damped in a grid: its inter-area modes, and the weak modes that a design does not target."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

from interarea.design.linear.sparse_plant import SparsePlant
from interarea.design.modes.all_modes import AllModes, all_modes
from interarea.design.modes.growth import Growth, growth_of_plant
from interarea.design.modes.loop_choice import choose_loops
from interarea.design.modes.loop_points import LoopSet
from interarea.design.modes.loop_selection import actuators_of, require_actuator
from interarea.design.modes.modes import Mode
from interarea.models.case.case import Case

from ..designs.short_designs import LATENCY_S
from ..errors import ScenarioError
from ..run.artefacts import sparse_linear_plant
from .choices import WEAK, Choices

#: Hz; electromechanical modes of large and small grids [Kundur1994, sec. 12.8]
BAND_HZ = (0.1, 2.5)
BELOW = 0.4  #: damping ratio up to which modes are looked for
SETS = 2  #: of loops that are designed shortly for each number of actuators


@dataclass(frozen=True)
class GridModes:
    """A grid without control: its modes in `BAND_HZ`, and whether any eigenvalue grows."""

    case: Case
    plant: SparsePlant
    all_modes: AllModes
    growth: Growth

    @property
    def inter_area(self) -> tuple[Mode, ...]:
        """The inter-area modes."""
        return tuple(m for m in self.all_modes.modes if m.name.startswith("inter-area"))

    @property
    def weak_others(self) -> tuple[Mode, ...]:
        """Other modes that are damped by less than `WEAK`."""
        inter_area = self.inter_area
        return tuple(m for m in self.all_modes.modes if m not in inter_area and m.damping_ratio < WEAK)

    @property
    def shown(self) -> tuple[Mode, ...]:
        """Inter-area modes, then other weak modes, each by damping."""
        groups = (self.inter_area, self.weak_others)
        return tuple(m for group in groups for m in sorted(group, key=lambda m: m.damping_ratio))

    @property
    def growing(self) -> list[str]:
        """Growing eigenvalues, in words; empty if there are none."""
        if self.growth.stable:
            return []
        return [one.text for one in self.growth.growing] or [self.growth.text]

    def as_dict(self) -> dict[str, Any]:
        """Return the record as JSON values."""
        return {"growing": self.growing, "weak": WEAK, **self.all_modes.as_dict(4, shapes=True)}


def modes_of_grid(case: Case, cache: Path) -> GridModes:
    """Return the modes of a grid without control. Raises CaseError if it has no operating point."""
    plant = sparse_linear_plant(case, cache)
    modes = all_modes(plant, case.areas, band_hz=BAND_HZ, below=BELOW)
    return GridModes(case, plant, modes, growth_of_plant(plant, known=[m.eigenvalue for m in modes.modes]))


@dataclass(frozen=True)
class WeakModes:
    """Modes to be damped in a grid, and the choices for it.

    targets : inter-area modes. others : weak modes that are not among them. stabilized : machines that got a
    local stabilizer before (`beside_local`); each may be out of service.
    """

    case: Case
    plant: SparsePlant
    all_modes: AllModes
    targets: tuple[Mode, ...]
    others: tuple[Mode, ...]
    choices: Choices
    stabilized: tuple[str, ...] = ()

    @property
    def weakest(self) -> Mode:
        """The least damped target."""
        return min(self.targets, key=lambda mode: mode.damping_ratio)

    @property
    def required_damping(self) -> float:
        """Required inter-area damping ratio of a design."""
        return self.choices.required_damping(self.weakest.damping_ratio)

    @cached_property
    def sets(self) -> tuple[LoopSet, ...]:
        """The best sets of loops for each number of actuators, by residues alone (takes seconds).

        Raises ModeError if no actuator reaches the weak modes.
        """
        sets: list[LoopSet] = []
        there = self.choices.actuators or actuators_of(self.plant.inputs)
        require_actuator(there)
        for together in range(1, min(self.choices.most_actuators, len(there)) + 1):
            choice = choose_loops(
                self.plant,
                self.all_modes.modes,
                self.case.areas,
                targets=[m.name for m in self.targets],
                kinds=("speed",),
                actuators=self.choices.actuators,
                latency_s=LATENCY_S,
                together=together,
                most=SETS,
            )
            sets += choice.sets
        return tuple(sets)


def weak_modes(grid: GridModes, choices: Choices | None = None) -> WeakModes:
    """Return the modes of a grid that are to be damped.

    choices : of the user; default only the grid.

    Raises
    ------
    ScenarioError : an unstable grid, with the participating states; no inter-area mode; none that is weak.
    """
    case, targets = grid.case, grid.inter_area
    choices = choices or Choices(grid=case.name)
    if grid.growing:
        raise ScenarioError(
            f"{case.name}: the grid is unstable without control: {'; '.join(grid.growing)}; make it stable "
            "first (dispatch, exciter gains, stabilizers), then design"
        )
    if not targets:
        raise ScenarioError(
            f"{case.name}: no inter-area mode between {BAND_HZ[0]:g} and {BAND_HZ[1]:g} Hz below a damping "
            f"ratio of {BELOW:g}; nothing to design (areas of the buses decide the names)"
        )
    least = min(m.damping_ratio for m in targets)
    if not least < WEAK and not choices.required_damping(least) > least:
        listed = ", ".join(in_words(m) for m in targets)
        raise ScenarioError(
            f"{case.name}: no weak inter-area mode, all have a damping ratio of {WEAK:g} or more: {listed}; "
            "nothing to design"
        )
    return WeakModes(case, grid.plant, grid.all_modes, targets, grid.weak_others, choices)


def in_words(mode: Mode) -> str:
    """Return name, frequency and damping ratio of a mode."""
    return f"{mode.name} ({mode.frequency_hz:.2f} Hz, damping {mode.damping_ratio:.3f})"
