"""Public functions that export models: FMUs, SSP archives, and the check of both."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from interarea.design.controllers.bank import ControllerBank
from interarea.design.controllers.controller import Controller
from interarea.design.linear.systems import SystemLike, is_system
from interarea.fmu_build.check.check import check_file
from interarea.fmu_build.finding import Report
from interarea.fmu_build.open.cross_check import complete_fmu
from interarea.fmu_build.write.cache import default_cache, place
from interarea.fmu_build.write.package import block_fmu
from interarea.grids import case_like
from interarea.models.blocks.plant import plant_block
from interarea.models.case.case import Case
from interarea.synthesis import controller_like

if TYPE_CHECKING:
    from interarea.models.blocks.variables import Block


def build_fmu(
    thing: Case | Controller | ControllerBank | SystemLike | str,
    path: str | Path,
    *,
    case: Case | str | Path = "two-area-thesis",
    platforms: Sequence[str] | None = None,
) -> Path:
    """Write the FMU of a case's plant, a controller or a channel, with documentation and sources.

    Parameters
    ----------
    thing : `Case`, controller object, `control.StateSpace` (u = +K y, speeds in rad/s), or ``"channel"``.
    path : the file to write.
    case : defines the base speed of a controller.
    platforms : of the binaries (linux64, win64, darwin64, linux-arm64, ...); default: of this computer.

    Raises
    ------
    UserError : not a model. InterareaError : no compiler for a platform.

    Examples
    --------
    >>> build_fmu("channel", "channel.fmu").name
    'channel.fmu'
    """
    cache = default_cache()
    fmu = block_fmu(_block(thing, case), cache, platforms=platforms)
    return place(complete_fmu(fmu, cache), Path(path))


def _block(thing: Case | Controller | ControllerBank | SystemLike | str, case: Any) -> Block:
    if isinstance(thing, str) and thing == "channel":
        from interarea.models.blocks.channel import channel_block

        return channel_block()
    if isinstance(thing, Case):
        return plant_block(thing)
    if isinstance(thing, Controller | ControllerBank) or is_system(thing):
        return controller_like(thing).block(case_like(case).omega_b)
    from interarea.models.arguments import kind_of
    from interarea.models.errors import UserError

    raise UserError(
        f"build_fmu: {repr(thing) if isinstance(thing, str) else kind_of(thing)}, allowed: a Case "
        "(load_case), a controller (load_controller, control.StateSpace) or 'channel'"
    )


def write_ssp(
    scenario: str | Path | Mapping[str, Any], path: str | Path, *, platforms: Sequence[str] | None = None
) -> Path:
    """Write plant, channels and controller of a scenario, connected, as one SSP 1.0 archive.

    Parameters
    ----------
    scenario : TOML file, bundled name, or a dict of the same keys.
    platforms : of the binaries inside; default: of this computer.

    Raises
    ------
    UserError : an error in the scenario.

    Examples
    --------
    >>> write_ssp("lost-signal", "loop.ssp").name
    'loop.ssp'
    """
    from interarea.cosim.export.ssp import write_ssp as write
    from interarea.cosim.scenario.scenario import load_scenario

    return write(load_scenario(scenario), path, cache=default_cache(), platforms=platforms)


def write_container(
    scenario: str | Path | Mapping[str, Any], path: str | Path, *, platforms: Sequence[str] | None = None
) -> Path:
    """Write plant, channels and controller of a scenario as one FMU that simulates by itself.

    Parameters and errors as `write_ssp`.

    Examples
    --------
    >>> write_container("lost-signal", "loop.fmu").name
    'loop.fmu'
    """
    from interarea.cosim.export.container import write_container as write
    from interarea.cosim.scenario.scenario import load_scenario

    return write(load_scenario(scenario), path, cache=default_cache(), platforms=platforms)


def check(path: str | Path, *, run: bool = True) -> Report:
    """Check an FMU or SSP of any origin: `clean`, and `findings` with rule, place and fix.

    Parameters
    ----------
    run : also load the FMU's binary and test its behaviour.

    Raises
    ------
    UserError : no such file, or neither an FMU nor an SSP.

    Examples
    --------
    >>> check("channel.fmu", run=False).clean  # the one made by `build_fmu`
    True
    """
    return check_file(Path(path), run=run)
