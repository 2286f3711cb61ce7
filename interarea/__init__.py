"""Wide-area damping of inter-area oscillations: the public names.

    import interarea as ia

loads a module when one of its names is used. The names in `__all__` are public; all others may change.
"""

from __future__ import annotations

import os
from importlib import import_module

__version__ = "0.2.0"

# In a checkout the floors lie beside this folder, in an installed wheel below it: without this line a
# Python started in the checkout's root finds this folder and none of the floors.
_ROOT = os.path.dirname(os.path.dirname(os.path.realpath(__file__)))  # noqa: PTH120  pathlib takes 10 ms
if all(os.path.isfile(os.path.join(_ROOT, *f)) for f in (("pyproject.toml",), ("models", "py.typed"))):  # noqa: PTH113, PTH118
    __path__.append(_ROOT)

TYPE_CHECKING = False  # as that of typing, whose load a signal at the start of a command would meet
if TYPE_CHECKING:  # what the table below says, for type checkers and editors
    from typing import Any

    from interarea.control_systems import delay_margin as delay_margin
    from interarea.control_systems import delayed_poles as delayed_poles
    from interarea.control_systems import h2syn as h2syn
    from interarea.control_systems import hinfsyn as hinfsyn
    from interarea.cosim.errors import StepError as StepError
    from interarea.cosim.records.files.read import read_record as read_record
    from interarea.cosim.records.playback import Playback as Playback
    from interarea.cosim.run.system import System as System
    from interarea.design.controllers.controller import Controller as Controller
    from interarea.design.errors import InfeasibleDesign as InfeasibleDesign
    from interarea.design.errors import UncertifiedDesign as UncertifiedDesign
    from interarea.exchange import build_fmu as build_fmu
    from interarea.exchange import check as check
    from interarea.exchange import write_container as write_container
    from interarea.exchange import write_ssp as write_ssp
    from interarea.grids import import_case as import_case
    from interarea.grids import linearise as linearise
    from interarea.grids import load_case as load_case
    from interarea.grids import loops as loops
    from interarea.grids import modes as modes
    from interarea.grids import reduce as reduce
    from interarea.models.errors import InterareaError as InterareaError
    from interarea.models.errors import UserError as UserError
    from interarea.records import damping_trend as damping_trend
    from interarea.records import fit as fit
    from interarea.records import meter as meter
    from interarea.simulation import Channel as Channel
    from interarea.simulation import compare as compare
    from interarea.simulation import read_sweep as read_sweep
    from interarea.simulation import simulate as simulate
    from interarea.simulation import sweep as sweep
    from interarea.synthesis import certify as certify
    from interarea.synthesis import design_controller as design_controller
    from interarea.synthesis import load_controller as load_controller

#: module -> the public names it gives
_PUBLIC = {
    "grids": "load_case import_case modes loops linearise reduce",
    "synthesis": "design_controller load_controller certify",
    "simulation": "simulate compare Channel sweep read_sweep",
    "control_systems": "delay_margin delayed_poles hinfsyn h2syn",
    "records": "meter damping_trend fit",
    "exchange": "build_fmu write_ssp write_container check",
    "design.controllers.controller": "Controller",
    "cosim.run.system": "System",
    "cosim.records.files.read": "read_record",
    "cosim.records.playback": "Playback",
    "models.errors": "InterareaError UserError",
    "design.errors": "InfeasibleDesign UncertifiedDesign",
    "cosim.errors": "StepError",
}
_PLACE = {name: module for module, names in _PUBLIC.items() for name in names.split()}
__all__ = ["__version__", *_PLACE]


def __getattr__(name: str) -> Any:
    if name not in _PLACE:
        raise AttributeError(f"module 'interarea' has no {name!r}; public are {', '.join(_PLACE)}")
    value = getattr(import_module(f"{__name__}.{_PLACE[name]}"), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted({*globals(), *_PLACE})
