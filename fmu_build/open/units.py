"""Units and their dimensions, as FMI 2.0 and SSP write them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

BASE = ("kg", "m", "s", "A", "K", "mol", "cd", "rad")
Dimension = tuple[int, ...]


@dataclass(frozen=True)
class Units:
    """Defined units with the exponents of their base units; None = a unit without a BaseUnit."""

    names: dict[str, Dimension | None]

    def dimension(self, unit: str) -> Dimension | None:
        """Return the exponents of a unit, None if they are not known."""
        return self.names.get(unit)


@dataclass(frozen=True)
class UnitOf:
    """A unit by FMI 2.0: exponents of kg, m, s, A, K, mol, cd, rad, and base = factor value + offset."""

    name: str
    exponents: Dimension | None = None  #: None: the FMU names the unit without defining it
    factor: float = 1.0
    offset: float = 0.0


def unit_of(unit: Any) -> UnitOf:
    """Return what a Unit element of FMI 2.0 defines."""
    base, name = unit.find("BaseUnit"), unit.get("name", "")
    try:
        factor, offset = (float(base.get(k, d)) for k, d in (("factor", "1"), ("offset", "0")))
    except (AttributeError, ValueError):  # no base unit, or none that can be read
        return UnitOf(name)
    return UnitOf(name, dimension_of(unit), factor, offset)


def dimension_of(unit: Any, namespace: str = "") -> Dimension | None:
    """Return the exponents in the BaseUnit of a Unit element."""
    base = unit.find(f"{namespace}BaseUnit")
    if base is None:
        return None
    try:
        return tuple(int(base.get(name, "0")) for name in BASE)
    except ValueError:
        return None


def unit_definitions(root: Any, container: str, namespace: str) -> Units:
    """Return the units defined below `container` of `root`."""
    elements = root.findall(f"{container}/{namespace}Unit")
    return Units({u.get("name", ""): dimension_of(u, namespace) for u in elements})
