"""A dc link with voltage-source converters between two sources, written apart from the package.

Averaged converters: currents along and across the voltage of each bus follow their orders with one time
constant; end 1 keeps its power, end 2 the voltage of the dc capacitor; the dc line is a resistance. Each bus
has the closed form u = X iq + sqrt(E^2 - (X ip)^2), of which a short circuit through a reactance makes
another with less E and X. Per unit on the base of the link, times s.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from itertools import pairwise

import numpy as np


@dataclass(frozen=True)
class Side:
    """One end. E, X: source and its reactance. limit: of the current. holds: voltage or reactive power."""

    E: float
    X: float
    limit: float
    holds: str  # "v" or "q"
    first: str  # "p" or "q": which current is kept at the limit

    def short_circuit(self, x: float) -> Side:
        """The same with a reactance at the bus."""
        return Side(self.E * x / (self.X + x), self.X * x / (self.X + x), self.limit, self.holds, self.first)

    def volts(self, ip: float, iq: float) -> float:
        """Size of the voltage of the bus."""
        return self.X * iq + np.sqrt(self.E**2 - (self.X * ip) ** 2)

    def at_rest(self, P: float, Q: float) -> tuple[float, float, float]:
        """Voltage and currents that give P and Q: u^4 - (E^2 + 2 X Q) u^2 + X^2 (P^2 + Q^2) = 0."""
        b = self.E**2 + 2.0 * self.X * Q
        u = np.sqrt(0.5 * (b + np.sqrt(b * b - 4.0 * self.X**2 * (P * P + Q * Q))))
        return u, P / u, Q / u


@dataclass
class Link:
    """P: taken at end 1; R, C: line, capacitor; others as the keys of a row of vscs."""

    ends: tuple[Side, Side]
    P: float
    Q: tuple[float, float]
    R: float
    C: float
    loss: tuple[float, float]
    gains: dict[str, float] = field(default_factory=dict)

    def dc_current(self, taken: float, v: float) -> float:
        """The current i of (v + R i) i = what end 1 puts in."""
        a = taken - self.loss[0]
        return a / v if self.R == 0.0 else (np.sqrt(v * v + 4.0 * self.R * a) - v) / (2.0 * self.R)

    def start(self) -> np.ndarray:
        """Its state at rest, v = 1: currents of both ends, measured voltages, v, three integrals."""
        out = self.dc_current(self.P, 1.0) - self.loss[1]
        one, other = (e.at_rest(p, q) for e, p, q in zip(self.ends, (-self.P, out), self.Q, strict=True))
        self.start_difference = (one[0], other[0])
        return np.array([*one[1:], *other[1:], one[0], other[0], 1.0, other[1], one[2], other[2]])

    def run(self, fault: tuple[int, float, float, float], times: np.ndarray) -> np.ndarray:
        """States at `times`, by four steps of Runge-Kutta's method between two.

        fault : which end, when it begins and ends (at one of the times), its reactance.
        """
        at, begins, ends, x = fault
        faulty = list(self.ends)
        faulty[at] = faulty[at].short_circuit(x)
        y = self.start()
        result = [y]
        for a, b in pairwise(times):
            sides = tuple(faulty) if begins - 1e-9 < a < ends - 1e-9 else self.ends
            h = 0.25 * (b - a)
            for _ in range(4):
                k1 = self.rates(y, sides)
                k2 = self.rates(y + 0.5 * h * k1, sides)
                k3 = self.rates(y + 0.5 * h * k2, sides)
                y = y + h / 6.0 * (k1 + 2.0 * k2 + 2.0 * k3 + self.rates(y + h * k3, sides))
            result.append(y)
        return np.array(result)

    def rates(self, y: np.ndarray, sides: tuple[Side, Side]) -> np.ndarray:
        g = self.gains
        v, (z, *w) = y[6], y[7:]
        u = [s.volts(y[2 * k], y[2 * k + 1]) for k, s in enumerate(sides)]
        ip, iq = y[[0, 2]], y[[1, 3]]
        dy = np.zeros(10)
        # dc side
        surplus = self.dc_current(-u[0] * ip[0], v) - (u[1] * ip[1] + self.loss[1]) / v
        if v > g["chopper"]:
            surplus -= g["chopper_gain"] * (v - g["chopper"])
        dy[6] = surplus / self.C
        # orders: what each end wants, then the limit
        part = min(max((v - g["low"]) / (g["full"] - g["low"]), 0.0), 1.0)
        order = g["dc_gain"] * (v - 1.0) + z
        for k, side in enumerate(sides):
            volts = y[4 + k]
            active = -self.P / volts if k == 0 else order
            off = self.start_difference[k] - volts
            reactive = g["gain"] * off + w[k] if side.holds == "v" else self.Q[k] / volts
            most = [side.limit, side.limit]
            if side.first == "p":
                p = self.within(active, most[0], part if k == 0 else 1.0)
                most[1] = np.sqrt(side.limit**2 - p**2)
                q = self.within(reactive, most[1])
            else:
                q = self.within(reactive, most[1])
                most[0] = np.sqrt(side.limit**2 - q**2)
                p = self.within(active, most[0], part if k == 0 else 1.0)
            dy[2 * k] = (p - ip[k]) / g["current_s"]
            dy[2 * k + 1] = (q - iq[k]) / g["current_s"]
            dy[4 + k] = (u[k] - volts) / g["voltage_s"]
            if k == 1 and not (abs(active) > most[0] and active * (v - 1.0) > 0.0):
                dy[7] = g["dc_integral"] * (v - 1.0)
            if side.holds == "v" and not (abs(reactive) > most[1] and reactive * off > 0.0):
                dy[8 + k] = g["integral"] * off
        return dy

    @staticmethod
    def within(order: float, most: float, upper: float = 1.0) -> float:
        """An order within its limits."""
        return min(max(order, -most), upper * most)
