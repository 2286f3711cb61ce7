"""Build FMI 2.0 FMUs from blocks, and open them as plants."""

from __future__ import annotations

from .errors import BuildError, FmuError
from .open import PlantFmu, open_plant
from .package import build_fmu

__all__ = ["BuildError", "FmuError", "PlantFmu", "build_fmu", "open_plant"]
