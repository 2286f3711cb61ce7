"""Public functions on a grid: load or import a case, its modes, loops, linear and reduced models."""

from __future__ import annotations

import sys
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import control

from interarea.cosim.designs.ranked_loops import ranked_loops
from interarea.cosim.run.artefacts import growth_at_rest, linear_plant, sparse_linear_plant
from interarea.design.linear.linearise import remove_reference, speeds_in_rad
from interarea.design.linear.systems import SystemLike, state_space
from interarea.design.modes.loop_choice import KINDS
from interarea.design.modes.modes import modes_of
from interarea.design.reduction.balanced import (
    Reduction,
    ReductionError,
    balanced_truncation,
    hankel_reduction,
    singular_perturbation,
)
from interarea.design.reduction.low_rank import low_rank_reduction
from interarea.fmu_build.write.cache import default_cache
from interarea.models.arguments import checked_types, kind_of
from interarea.models.case.case import Case
from interarea.models.case.case import load_case as load_case
from interarea.models.errors import UserError
from interarea.shown import RankedLoops, SwingModes

_METHODS: Mapping[str, Callable[[control.StateSpace, int], Reduction]] = {
    "balanced": balanced_truncation,
    "singular_perturbation": singular_perturbation,
    "hankel": hankel_reduction,
}


def case_like(case: Case | str | Path) -> Case:
    """Return a case, or load the one of that name or file; raise UserError for any other object."""
    if isinstance(case, Case):
        return case
    if isinstance(case, str | Path):
        return load_case(case)
    raise UserError(f"case: is {kind_of(case)}, wanted a Case (load_case), a bundled name or a file")


@checked_types
def import_case(
    grid: str | Path,
    *,
    dyr: str | Path | None = None,
    frequency_hz: float | None = None,
    P_exponent: float | None = None,
    Q_exponent: float | None = None,
    strict: bool = False,
    island: int | str | None = None,
    converters: str = "model",
    dc_lines: str = "model",
    coordinates: str | Path | None = None,
    release_limits: bool = False,
    devices: Sequence[str | Path] = (),
    leave_out: Sequence[str] = (),
    replace: Mapping[str, str] | None = None,
    report: Callable[[str], object] | None = None,
) -> Case:
    """Read a grid of PSS/E (RAW, with dynamic data in a DYR file) or MATPOWER; plain, .gz or .xz.

    Parameters
    ----------
    frequency_hz : for a file that has none; 60 Hz when not given.
    P_exponent, Q_exponent : of RAW loads against voltage; constant impedance (2) when not given.
    strict : reject a file that needs an assumption.
    island : a bus of the island to keep, or "all" with a slack bus; the largest of these when not given.
    converters : "model", or "current" for inverters and units without dynamic data as constant currents.
    dc_lines : "model" for dc links where two-terminal and VSC lines allow it, or "power" for constant powers.
    coordinates : CSV with the columns bus, latitude, longitude.
    release_limits : widen limits that the controls violate at the start; the report lists the changes.
    devices : files of user-defined devices; records of their names (USRMDL or not) become these.
    leave_out, replace : models of DYR records to omit, and to read as another model (old -> new).
    report : called with a text: what was read, assumed and dropped, limits of the controls, and stability.

    Raises
    ------
    UserError : no such file, another format, or an element without a model, by name.

    Examples
    --------
    >>> grid = import_case("grid.raw", dyr="grid.dyr")
    >>> [machine.name for machine in grid.machines]
    ['G1', 'G2', 'G3', 'G4']
    """
    from interarea.models.importers.file import import_grid
    from interarea.models.importers.imported import ImportOptions

    options = ImportOptions(
        frequency_hz=frequency_hz,
        P_exponent=P_exponent,
        Q_exponent=Q_exponent,
        strict=strict,
        island=island,
        converters=converters,
        dc_lines=dc_lines,
        coordinates=coordinates,
        release_limits=release_limits,
        devices=devices,
        leave_out=leave_out,
        replace=replace or {},
    )
    imported = import_grid(grid, dyr, options)
    if report is not None:
        growth = growth_at_rest(imported.case, default_cache())
        report(imported.report.text() + ("" if growth is None else f"\nat the equilibrium: {growth.text}"))
    return imported.case


@checked_types
def linearise(case: Case | str | Path, *, reference: bool = False, speeds: str = "pu") -> control.StateSpace:
    """Return the plant linearised at its operating point; states, inputs and outputs have names.

    Inputs ``G1_vs`` ... in pu; outputs of the plant FMU, speeds ``G1_dw`` ... in pu or rad/s;
    time in s. The name of the system states the unit of speed.
    The matrices are dense, of 3000 states at most; `loops`, `reduce` and ``interarea modes --band`` have no
    such limit.

    Parameters
    ----------
    case : bundled name, file or `Case`.
    reference : keep the reference angle with its zero mode; default: angles relative to the first machine.
    speeds : "pu", or "rad/s" as controllers take them (`certify`, `simulate`).

    Raises
    ------
    UserError : no such case, no operating point, too many states, or another unit.

    Examples
    --------
    >>> linearise("two-area-thesis").nstates
    55
    >>> linearise("two-area-thesis", speeds="rad/s").name
    'two-area-thesis, speeds in rad/s'
    """
    if speeds not in ("pu", "rad/s"):
        raise UserError(f"speeds = {speeds!r}, allowed: 'pu', 'rad/s'")
    loaded = case_like(case)
    system = linear_plant(loaded, default_cache())
    system = system if reference else remove_reference(system)
    system = system if speeds == "pu" else speeds_in_rad(system, loaded.omega_b)
    system.name = f"{system.name}, speeds in {speeds}"
    return system


def modes(case: Case | str | Path) -> SwingModes:
    """Return the swing modes of a case, a Mapping name -> `Mode`, named by shape (``inter-area``).

    Its `growth` is the stability verdict of all eigenvalues; the repr begins with it.

    Raises
    ------
    UserError : no such case, or swing modes that cannot be separated.

    Examples
    --------
    >>> found = modes("two-area-thesis")
    >>> f"{found.inter_area.frequency_hz:.3f} Hz, {found.inter_area.damping_ratio:.3f}"
    '0.623 Hz, 0.081'
    """
    loaded = case_like(case)
    return SwingModes.of(modes_of(linear_plant(loaded, default_cache()), loaded.areas), loaded)


@checked_types
def loops(
    case: Case | str | Path,
    *,
    band_hz: tuple[float, float] = (0.1, 2.5),
    below: float = 0.2,
    targets: Sequence[str] = (),
    signals: Sequence[str] = KINDS,
    actuators: Sequence[str] = (),
    latency_s: float = 0.0,
    together: int | None = None,
    most: int = 10,
    points: Mapping[str, Case] | None = None,
) -> RankedLoops:
    """Rank every loop (actuator and signal) by the residue of a mode, for a grid of any size.

    The index of a loop is its residue over the largest of its kind of signal for that mode. Sets of actuators
    are ranked by the mode with the smallest residue.

    Parameters
    ----------
    band_hz, below : modes are those of this band whose damping ratio is below this.
    targets : modes to be damped, by name; default the inter-area ones.
    signals : kinds of them: speed, frequency, angle, power, current. actuators : default all (``G1_vs``).
    latency_s : of every signal; changes the phase that a controller must compensate.
    together : actuators in a set, default 2. most : rows of each ranking.
    points : name -> the grid at another operating point, where sets are ranked too.

    Raises
    ------
    UserError : no such case, mode, signal or actuator, or no inter-area mode.

    Examples
    --------
    >>> loops("two-area-thesis").selected.actuator
    'G4_vs'
    """
    options: dict[str, Any] = {"targets": targets, "kinds": signals, "actuators": actuators}
    options |= {"latency_s": latency_s, "together": together, "most": most, "points": points}
    choice = ranked_loops(case_like(case), default_cache(), band_hz=band_hz, below=below, **options)
    return RankedLoops(**vars(choice))


@checked_types
def reduce(
    system: SystemLike | Case | str | Path,
    order: int,
    *,
    method: str = "balanced",
    inputs: Sequence[str] = (),
    outputs: Mapping[str, Mapping[str, float]] | None = None,
) -> Reduction:
    """Return a reduced model: `system`, measured `error` (of what: `error_of`) and a-priori `bound`.

    Parameters
    ----------
    system : a `control.StateSpace` or (A, B, C, D) in continuous time, n states; unstable and zero modes are
        not reduced. Or a case of any size (bundled name, file
        or `Case`), which is never linearised as a whole: balanced truncation from low-rank Gramians of its
        sparse blocks, unobservable zero modes removed.
    order : states of the result.
    method : "balanced" (truncation), "singular_perturbation" or "hankel" (optimal Hankel norm); of a case
        "balanced".
    inputs, outputs : of a case: ``["G1_vs"]`` and ``{"dw12": {"G1_dw": 1.0, "G2_dw": -1.0}}``, speeds in pu.

    Raises
    ------
    UserError : an order out of range, an unknown method, unknown signals of a case, or neither a case
        nor a linear system in continuous time.

    Examples
    --------
    >>> plant = linearise("two-area-thesis")
    >>> reduce(plant[["G4_dw"], ["G4_vs"]], 8).system.nstates
    8
    >>> dw24 = {"dw24": {"G2_dw": 1.0, "G4_dw": -1.0}}
    >>> reduce("two-area-thesis", 24, inputs=["G4_vs"], outputs=dw24).error < 1e-3
    True
    """
    if not isinstance(system, Case | str | Path):
        if method not in _METHODS:
            raise ReductionError(f"method = {method!r}, allowed: {', '.join(_METHODS)}")
        return _METHODS[method](state_space(system), order)
    if method != "balanced":
        raise ReductionError(f"method = {method!r}, allowed for a case: balanced")
    plant = sparse_linear_plant(case_like(system), default_cache())
    return low_rank_reduction(plant, order, inputs=inputs, outputs=outputs or {})


_NONE = 1e29  #: limits beyond are none


def margins_at_rest(case: Case) -> list[dict[str, Any]]:
    """Return the limited signals of the controls at the equilibrium, the nearest to a limit first.

    Raises
    ------
    StartError : a control without an equilibrium; stderr lists all of them first.
    """
    from interarea.models.grid.control_tables import StartError
    from interarea.models.grid.start import start_of

    start = start_of(case)
    if start.unrest:
        print(start.text(), file=sys.stderr)
        raise StartError(list(start.unrest))
    return [
        {
            "control": m.control,
            "kind": m.kind,
            "signal": m.margin.signal,
            "value": m.margin.value,
            "low": m.margin.low if m.margin.low > -_NONE else None,
            "high": m.margin.high if m.margin.high < _NONE else None,
            "nearest": m.limit,
            "margin": m.margin.least,
        }
        for m in start.margins
    ]
