"""What the rows of dc links of both kinds share."""

from __future__ import annotations

from typing import TYPE_CHECKING

from .control_schema import Row


class DcLink(Row):
    """A dc link between two buses, with per-unit values on its rated power and dc voltage."""

    if TYPE_CHECKING:  # fields of each kind, which stand where its own order of keys has them
        base_mva: float
        vdc_kv: float

    def _require_two(self, first: str, second: str) -> None:
        """Refuse the same bus at both ends; ValueError."""
        bus = getattr(self, second)
        if getattr(self, first) == bus:
            raise ValueError(f"{first} = {second} = {bus}, allowed: two buses")

    def _require_below(self, *pairs: tuple[str, str]) -> None:
        """Refuse a first key of a pair that is not below the second, where both are set; ValueError."""
        for low, high in pairs:
            a, b = getattr(self, low), getattr(self, high)
            if a is not None and not a < b:
                raise ValueError(f"{low} = {a:g} with {high} = {b:g}, allowed: {low} < {high}")

    @property
    def V_pu(self) -> None:
        """None: the power flow lets the voltages of its buses free."""
        return None

    @property
    def base_ohm(self) -> float:
        """Base of its resistances."""
        return self.vdc_kv**2 / self.base_mva
