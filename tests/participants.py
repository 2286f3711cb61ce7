"""Participants in plain numpy whose steps are exact, to test the master apart from any FMU."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from scipy.linalg import expm

from interarea.fmu_build.open.ports import Description, Port


class _Numpy:
    """Buffers and bookkeeping common to the participants below."""

    def __init__(self, name: str, description: Description) -> None:
        self.name = name
        self.description = description
        self.started = 0

    def bind(self, inputs: Sequence[str], slopes: Sequence[str]) -> None:
        self.bound = [self.description.inputs.index(self.description.input_of[n]) for n in inputs]
        self.slopes = [[p.name for p in self.description.outputs].index(n) for n in slopes]
        self.u = [0.0] * len(inputs)
        self.du = [0.0] * (3 * len(inputs))
        self.y = [0.0] * len(self.description.outputs)
        self.dy = [0.0] * len(slopes)

    def begin(self, start_s: float, stop_s: float) -> None:
        self.time = start_s
        self.poly = np.zeros((len(self.description.inputs), 4))
        for k, port in enumerate(self.description.inputs):
            self.poly[k, 0] = port.start
        self.started += 1

    def ready(self) -> None:
        pass

    def send(self, order: int) -> None:
        for i, k in enumerate(self.bound):
            self.poly[k] = 0.0
            self.poly[k, 0] = self.u[i]
            self.poly[k, 1 : 1 + order] = self.du[3 * i : 3 * i + order]

    def release(self, state: object) -> None:
        pass

    def last_log(self) -> str:
        return ""

    def close(self) -> None:
        pass


class Linear(_Numpy):
    """dx/dt = A x + B u + push(t), y = C x + D u, exact for cubic inputs; push is piecewise constant."""

    def __init__(
        self,
        name: str,
        A: np.ndarray,
        B: np.ndarray,
        C: np.ndarray,
        D: np.ndarray,
        inputs: Sequence[str],
        outputs: Sequence[str],
        *,
        push: Sequence[tuple[float, float, np.ndarray]] = (),
        x0: np.ndarray | None = None,
        input_order: int = 3,
        output_order: int = 1,
        saves_state: bool = True,
    ) -> None:
        direct = {
            y: frozenset(u for j, u in enumerate(inputs) if D[i, j] != 0.0) for i, y in enumerate(outputs)
        }
        super().__init__(
            name,
            Description(
                tuple(Port(n) for n in inputs),
                tuple(Port(n) for n in outputs),
                direct,
                direct,
                input_order=input_order,
                output_order=output_order,
                saves_state=saves_state,
            ),
        )
        self.A, self.B, self.C, self.D, self.push = A, B, C, D, push
        self.x0 = np.zeros(len(A)) if x0 is None else x0
        self._cache: dict[float, np.ndarray] = {}

    def begin(self, start_s: float, stop_s: float) -> None:
        super().begin(start_s, stop_s)
        self.x = self.x0.copy()

    def _pushed(self, t: float) -> np.ndarray:
        total = np.zeros(len(self.A))
        for start, end, vector in self.push:
            if start <= t + 1e-12 < end:
                total = total + vector
        return total

    def advance(self, time_s: float, length_s: float) -> None:
        edges = sorted(
            {e for s in self.push for e in s[:2] if time_s + 1e-12 < e < time_s + length_s - 1e-12}
        )
        now = time_s
        for end in [*edges, time_s + length_s]:
            self._move(now, end - now, now - time_s)
            now = end
        d = self.poly
        h = length_s
        d[:, 0], d[:, 1], d[:, 2] = (
            d[:, 0] + h * (d[:, 1] + h * (d[:, 2] / 2 + h * d[:, 3] / 6)),
            d[:, 1] + h * (d[:, 2] + h * d[:, 3] / 2),
            d[:, 2] + h * d[:, 3],
        )
        self.time = time_s + length_s

    def _move(self, t: float, h: float, at: float) -> None:
        n, m = len(self.A), self.B.shape[1]
        if h not in self._cache:
            # chain: integrators produce 1, s, s^2/2, s^3/6 as inputs to A x + B u
            big = np.zeros((n + 4 * m + n, n + 4 * m + n))
            big[:n, :n] = self.A
            big[:n, n : n + m] = self.B
            for k in range(3):
                big[n + k * m : n + (k + 1) * m, n + (k + 1) * m : n + (k + 2) * m] = np.eye(m)
            big[:n, n + 4 * m :] = np.eye(n)
            self._cache[h] = expm(big * h)[:n]
        d = self.poly
        u = d[:, 0] + at * (d[:, 1] + at * (d[:, 2] / 2 + at * d[:, 3] / 6))
        du = d[:, 1] + at * (d[:, 2] + at * d[:, 3] / 2)
        z = np.concatenate([self.x, u, du, d[:, 2] + at * d[:, 3], d[:, 3], self._pushed(t)])
        self.x = self._cache[h] @ z

    def receive(self, slopes: bool) -> None:
        u, du = self.poly[:, 0], self.poly[:, 1]
        self.y[:] = (self.C @ self.x + self.D @ u).tolist()
        if slopes:
            rate = self.A @ self.x + self.B @ u + self._pushed(self.time)
            dy = self.C @ rate + self.D @ du
            self.dy[:] = [float(dy[k]) for k in self.slopes]

    def save(self) -> object:
        return self.x.copy(), self.poly.copy(), self.time

    def restore(self, state: object) -> None:
        x, poly, self.time = state
        self.x, self.poly = x.copy(), poly.copy()


class Delay(_Numpy):
    """y(t) = u(t - latency), cubic between the values and slopes it was sent at communication points."""

    def __init__(self, name: str, latency: float, *, zero_from: float = np.inf) -> None:
        pass_on = {"y": frozenset({"u"} if latency == 0.0 else ())}
        super().__init__(
            name,
            Description(
                (Port("u"),), (Port("y"),), pass_on, {"y": frozenset({"u"})},
                input_order=3, output_order=1, saves_state=True,
            ),
        )  # fmt: skip
        self.latency, self.zero_from = latency, zero_from

    def begin(self, start_s: float, stop_s: float) -> None:
        super().begin(start_s, stop_s)
        self.points: list[tuple[float, float, float]] = []
        self.first = start_s
        self.end = self.poly[0].copy()

    def advance(self, time_s: float, length_s: float) -> None:
        d = self.poly[0]
        self.points = [*self.points, (time_s, float(d[0]), float(d[1]))]
        h = length_s
        end = (d[0] + h * (d[1] + h * (d[2] / 2 + h * d[3] / 6)), d[1] + h * (d[2] + h * d[3] / 2))
        self.poly[0, 0], self.poly[0, 1] = end
        self.poly[0, 2:] = 0.0
        self.time = time_s + h

    def _at(self, t: float) -> tuple[float, float]:
        points = [*self.points, (self.time, *self.poly[0, :2])]
        if t <= points[0][0]:
            return points[0][1], 0.0
        times = [p[0] for p in points]
        k = min(int(np.searchsorted(times, t, side="right")) - 1, len(points) - 2)
        (t0, v0, s0), (t1, v1, s1) = points[k], points[k + 1]
        h = t1 - t0
        s = (t - t0) / h
        v = (
            (1 + 2 * s) * (1 - s) ** 2 * v0
            + s * (1 - s) ** 2 * h * s0
            + s * s * (3 - 2 * s) * v1
            - s * s * (1 - s) * h * s1
        )
        w = 6 * s * (s - 1) * (v0 - v1) / h + (1 - 4 * s + 3 * s * s) * s0 + (3 * s * s - 2 * s) * s1
        return v, w

    def receive(self, slopes: bool) -> None:
        v, w = self._at(self.time - self.latency)
        if self.time >= self.zero_from:
            v = w = 0.0
        self.y[0] = float(v)
        if slopes and self.dy:
            self.dy[0] = float(w)

    def save(self) -> object:
        return list(self.points), self.poly.copy(), self.time

    def restore(self, state: object) -> None:
        points, poly, self.time = state
        self.points, self.poly = list(points), poly.copy()


def delayed_reference(
    rate: Callable[[float, np.ndarray, Callable[[float], np.ndarray]], np.ndarray],
    x0: np.ndarray,
    latency: float,
    breaks: Sequence[float],
    stop: float,
    **solver: object,
) -> Callable[[np.ndarray], np.ndarray]:
    """Solve dx/dt = rate(t, x, past) with past(t - latency) by the method of steps (DOP853 at 1e-12)."""
    from scipy.integrate import solve_ivp

    pieces: list[tuple[float, float, Callable[[float], np.ndarray]]] = []

    def past(t: float) -> np.ndarray:
        if t <= 0.0:
            return x0
        for start, end, dense in pieces:
            if start <= t <= end:
                return dense(t)
        return pieces[-1][2](t)

    late = {b + k * latency for b in breaks for k in range(4)} if latency else set(breaks)
    ends = (
        sorted(
            {min(stop, e) for e in late | {k * latency for k in range(1, int(stop / latency) + 2)}} - {0.0}
        )
        if latency
        else sorted({*breaks, stop})
    )
    now, x = 0.0, x0
    for end in ends:
        if end - now < 1e-9:
            continue
        options = {"method": "DOP853", "rtol": 1e-12, "atol": 1e-16, **solver}
        # events at a break belong to the piece after it: ask at times inside the piece only
        solution = solve_ivp(
            lambda t, x, a=now, b=end: rate(min(max(t, a + 1e-12), b - 1e-12), x, past),
            (now, end),
            x,
            dense_output=True,
            **options,
        )
        pieces.append((now, end, solution.sol))
        now, x = end, solution.y[:, -1]

    def at(times: np.ndarray) -> np.ndarray:
        return np.array([past(float(t)) for t in times])

    return at
