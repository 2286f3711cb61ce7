"""The controls of a case as the C plant takes them: table rows, states with their start values, parameters.

Row orders are those of the enumerations in plant/plan.h; the states of a device follow each other in
the order in which its C function meets them.
"""

from __future__ import annotations

import numpy as np

from ..case.case import Case, CaseError
from ..case.control_schema import Tgov1Governor
from .machine_tables import NO_LIMIT, Device, MachinePoint, Parameter, State, network_states

SHORTEST_S = 1e-6  #: least value a time constant may be set to


class _Chain:
    """A chain of first-order blocks: collects states and follows what the signal depends on."""

    def __init__(self, device: Device, prefix: str, signal: frozenset[str]) -> None:
        self.device, self.prefix, self.signal = device, prefix, signal

    def lag(self, name: str, T: float, start: float, description: str, unit: str = "pu") -> None:
        """1/(1 + sT): the output is the state; without T the signal passes."""
        if T > 0.0:
            self.signal = self._state(name, T, start, description, unit)

    def lead_lag(self, name: str, T2: float, start: float, description: str, unit: str = "pu") -> None:
        """(1 + sT1)/(1 + sT2): the output is a mix of the input and the state."""
        if T2 > 0.0:
            self.signal |= self._state(name, T2, start, description, unit)

    def _state(self, name: str, T: float, start: float, description: str, unit: str) -> frozenset[str]:
        own = frozenset({f"{self.prefix}.{name}"})
        entry = State(f"{self.prefix}.{name}", start, unit, description, self.signal | own, T)
        self.device.states.append(entry)
        return own


def stabilizer(case: Case, k: int) -> Device | None:
    """Return the stabilizer of machine `k`, None when it has none."""
    m = case.machines[k]
    s = m.stabilizer
    if s is None:
        return None
    low, high = _limits(s.Vs_min, s.Vs_max)
    device = Device(1, k, [s.K, s.TR, s.Tw, s.T1, s.T2, s.T3, s.T4, s.T5, s.T6, low, high])
    prefix = f"{m.name}.stabilizer"
    chain = _Chain(device, prefix, frozenset({f"{m.name}.slip"}))
    chain.lag("sensor", s.TR, 0.0, "sensed speed deviation")
    chain.lead_lag("washout", s.Tw, 0.0, "slow part of the speed deviation")
    for stage, (_, lag) in enumerate(((s.T1, s.T2), (s.T3, s.T4), (s.T5, s.T6)), start=1):
        chain.lead_lag(f"stage{stage}", lag, 0.0, f"lead-lag {stage}")
    device.output = chain.signal
    rows = ("K", "TR", "Tw", "T1", "T2", "T3", "T4", "T5", "T6", "Vs_min", "Vs_max")
    device.parameters = [Parameter(f"{prefix}.K", 0, "1", "stabilizer gain, pu per pu speed", -1e6, 1e6)]
    for row, key in enumerate(rows):
        if key == "Tw" or (key.startswith("T") and getattr(s, key) > 0.0):
            device.parameters.append(_time(prefix, key, row, zero=key in ("T1", "T3", "T5")))
    device.parameters.append(Parameter(f"{prefix}.Vs_min", 9, "pu", "least output", -NO_LIMIT, 0.0))
    device.parameters.append(Parameter(f"{prefix}.Vs_max", 10, "pu", "largest output", 0.0, NO_LIMIT))
    return device


EXCITER_ROWS = (
    "KA",
    "TA",
    "TR",
    "TB",
    "TC",
    "low",
    "high",
    "Vref",
    "KE",
    "TE",
    "KF",
    "TF",
    "Aex",
    "Bex",
    "KC",
)
EXCITER_KINDS = {"static": 1, "static_tgr": 1, "st1a": 2, "dc1": 3}
#: keys of the limits in the case: rows "low" and "high"
_LIMIT_KEYS = {"static": ("Efd_min", "Efd_max"), "static_tgr": ("Efd_min", "Efd_max")}


def exciter(case: Case, k: int, point: MachinePoint, vs: frozenset[str]) -> Device | None:
    """Return the exciter of machine `k`, None when its field voltage is constant.

    `vs`: what the stabilizer's signal depends on.

    Raises
    ------
    CaseError : limits that exclude the operating point.
    """
    m = case.machines[k]
    e = m.exciter
    if e.kind == "constant":
        return None
    low_key, high_key = _LIMIT_KEYS.get(e.kind, ("VRmin", "VRmax"))
    low, high = _limits(getattr(e, low_key), getattr(e, high_key))
    loss = 1.0
    value = dict.fromkeys(EXCITER_ROWS, 0.0) | {"KA": e.KA, "TA": e.TA, "TR": e.TR, "low": low, "high": high}
    if e.kind != "static":
        value |= {"TB": e.TB, "TC": e.TC}
    if e.kind == "st1a":
        value["KC"] = e.KC
    if e.kind == "dc1":
        saturation = e.Aex * np.exp(e.Bex * point.efd)
        KE = -saturation if e.KE == "self-excited" else e.KE
        loss = 0.0 if e.KE == "self-excited" else KE + saturation
        value |= {"KE": KE, "TE": e.TE, "KF": e.KF, "TF": e.TF, "Aex": e.Aex, "Bex": e.Bex}
    regulator = loss * point.efd  #: what stands behind the gain: the field voltage itself unless it is dc1
    value["Vref"] = point.vt + regulator / e.KA
    least = low * point.vt if e.kind == "st1a" else low
    most = high * point.vt - e.KC * point.efd if e.kind == "st1a" else high
    if not least <= regulator <= most:
        what = f"regulator output {regulator:.6g}" if e.kind == "dc1" else f"Efd = {regulator:.6g}"
        raise CaseError(
            f"{case.name}: machines.{m.name}.exciter: {what} at the operating point lies outside "
            f"{low_key} = {least:g} .. {high_key} = {most:g}; widen the limits or change the dispatch"
        )
    device = Device(EXCITER_KINDS[e.kind], k, [float(value[row]) for row in EXCITER_ROWS])
    prefix = f"{m.name}.exciter"
    chain = _Chain(device, prefix, network_states(case))
    chain.lag("v", e.TR, point.vt, "sensed terminal voltage")
    chain.signal |= vs | {f"{m.name}_vs"}
    if e.kind == "dc1" and e.KF > 0.0:
        chain.signal |= {f"{prefix}.efd", f"{prefix}.feedback"}
    chain.lead_lag("lead_lag", value["TB"], regulator / e.KA, "slow part of the error signal")
    if e.kind == "dc1":
        chain.lag("regulator", e.TA, regulator, "regulator output")
        chain.lag("efd", e.TE, point.efd, "field voltage")
        chain.lag("feedback", e.TF, point.efd, "slow part of the rate feedback")
        chain.signal = frozenset({f"{prefix}.efd"})
    else:
        limits = _st1a_limits(case, k, value["KC"]) if e.kind == "st1a" else frozenset()
        chain.signal |= limits
        chain.lag("efd", e.TA, point.efd, "field voltage")
        chain.signal |= limits
    device.output = chain.signal
    device.parameters = _exciter_parameters(prefix, value, low_key, high_key, rotating=e.kind == "dc1")
    return device


def _st1a_limits(case: Case, k: int, KC: float) -> frozenset[str]:
    """States that the limits of an st1a exciter follow: terminal voltage and field current."""
    name = case.machines[k].name
    return network_states(case) | ({f"{name}.eq1"} if KC > 0.0 else frozenset())


def _exciter_parameters(
    prefix: str, value: dict[str, float], low_key: str, high_key: str, *, rotating: bool
) -> list[Parameter]:
    row = {key: k for k, key in enumerate(EXCITER_ROWS)}
    found = [Parameter(f"{prefix}.KA", row["KA"], "1", "regulator gain (Vref follows)", 1e-3, 1e6)]
    for key in ("TA", "TR", "TB", "TC", "TE", "TF"):
        if value[key] > 0.0 or (key == "TC" and value["TB"] > 0.0):
            found.append(_time(prefix, key, row[key], zero=key == "TC"))
    limited = "regulator output" if rotating else "field voltage"
    found.append(Parameter(f"{prefix}.{low_key}", row["low"], "pu", f"least {limited}", -NO_LIMIT, NO_LIMIT))
    found.append(
        Parameter(f"{prefix}.{high_key}", row["high"], "pu", f"largest {limited}", -NO_LIMIT, NO_LIMIT)
    )
    if rotating:
        for key, text in _ROTATING.items():
            low = -1e6 if key == "KE" else 0.0
            found.append(Parameter(f"{prefix}.{key}", row[key], "1", text, low, 1e6))
    return found


_ROTATING = {
    "KE": "loss of the exciter per pu field voltage",
    "KF": "gain of the rate feedback",
    "Aex": "saturation SE = Aex exp(Bex Efd), factor",
    "Bex": "saturation SE = Aex exp(Bex Efd), exponent",
}


def governor(case: Case, k: int, point: MachinePoint) -> Device | None:
    """Return the governor and turbine of machine `k`, None when its mechanical power is constant.

    Raises
    ------
    CaseError : limits that exclude the operating point.
    """
    m = case.machines[k]
    g = m.governor
    if g.kind == "none":
        return None
    if g.kind == "tgov1":
        return _tgov1(case, k, g, point)
    slowest, fastest = _limits(g.vg_min, g.vg_max)
    low, high = _limits(g.gate_min, g.gate_max)
    if not (low <= point.pm <= high and slowest <= 0.0 <= fastest):
        raise CaseError(
            f"{case.name}: machines.{m.name}.governor: the gate is {point.pm:.6g} at the operating point and "
            f"must lie within gate_min = {low:g} .. gate_max = {high:g}, with vg_min <= 0 <= vg_max"
        )
    column = [g.Kp, g.Rp, g.Tsr, g.Tsm, slowest, fastest, low, high]
    device = Device(1, k, [*column, g.T2, g.T3, g.T4, g.T5, g.F2, g.F3, g.F4, g.F5, 0.0])
    prefix = f"{m.name}.governor"
    chain = _Chain(device, prefix, frozenset({f"{m.name}.slip"}))
    chain.lag("relay", g.Tsr, point.pm, "speed relay")
    chain.lag("gate", g.Tsm, point.pm, "gate position")
    power: frozenset[str] = frozenset()
    volumes = (
        ("T5", "F5", "steam chest"),
        ("T4", "F4", "volume 4"),
        ("T3", "F3", "volume 3"),
        ("T2", "F2", "volume 2"),
    )
    for time, share, description in volumes:
        chain.lag(f"p{time[1]}", getattr(g, time), point.pm, description)
        if getattr(g, share) > 0.0:
            power |= chain.signal
    device.output = power
    for row, key, low_value in ((0, "Kp", 0.0), (1, "Rp", 1e-6)):
        device.parameters.append(Parameter(f"{prefix}.{key}", row, "1", _TEXT[key], low_value, 1e6))
    for row, key in ((2, "Tsr"), (3, "Tsm"), (8, "T2"), (9, "T3"), (10, "T4"), (11, "T5")):
        if getattr(g, key) > 0.0:
            device.parameters.append(_time(prefix, key, row, zero=False))
    return device


def _tgov1(case: Case, k: int, g: Tgov1Governor, point: MachinePoint) -> Device:
    name = case.machines[k].name
    low, high = _limits(g.Vmin, g.Vmax)
    if not low <= point.pm <= high:
        raise CaseError(
            f"{case.name}: machines.{name}.governor: the valve is {point.pm:.6g} at the operating point, "
            f"outside Vmin = {low:g} .. Vmax = {high:g}; widen the limits or change the dispatch"
        )
    column = [1.0, g.R, 0.0, g.T1, -NO_LIMIT, NO_LIMIT, low, high, g.T2, g.T3, *[0.0] * 6, g.Dt]
    device = Device(2, k, column)
    prefix = f"{name}.governor"
    slip = frozenset({f"{name}.slip"})
    chain = _Chain(device, prefix, slip)
    chain.lag("valve", g.T1, point.pm, "valve position")
    chain.lead_lag("reheat", g.T3, point.pm, "slow part of the power")
    device.output = chain.signal | (slip if g.Dt > 0.0 else frozenset())
    device.parameters = [Parameter(f"{prefix}.R", 1, "1", "droop, pu speed per pu power", 1e-6, 1e6)]
    for row, key in ((3, "T1"), (8, "T2"), (9, "T3")):
        device.parameters.append(_time(prefix, key, row, zero=key == "T2"))
    return device


_TEXT = {"Kp": "regulator gain", "Rp": "permanent droop, pu speed per pu power"}


def _limits(low: float | None, high: float | None) -> tuple[float, float]:
    return (-NO_LIMIT if low is None else low, NO_LIMIT if high is None else high)


def _time(prefix: str, key: str, row: int, *, zero: bool) -> Parameter:
    return Parameter(f"{prefix}.{key}", row, "s", f"time constant {key}", 0.0 if zero else SHORTEST_S, 1e6)
