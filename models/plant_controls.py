"""The controls of a case as the C plant takes them: table rows, states with their start values, parameters.

Row orders are those of the enumerations in plant/plan.h; the states of a device follow each other in
the order in which its C function meets them.
"""

from __future__ import annotations

from .case import Case, CaseError
from .case_schema import Machine
from .plant_tables import NO_LIMIT, Device, MachinePoint, Parameter, State, network_states

SHORTEST_S = 1e-6  #: least value a time constant may be set to


class _Chain:
    """A chain of first-order blocks: collects states and follows what the signal depends on."""

    def __init__(self, device: Device, prefix: str, signal: frozenset[str]) -> None:
        self.device, self.prefix, self.signal = device, prefix, signal

    def lag(self, name: str, T: float, start: float, description: str, unit: str = "pu") -> None:
        """1/(1 + sT): the output is the state; without T the signal passes."""
        if T > 0.0:
            self.signal = self._state(name, start, description, unit)

    def lead_lag(self, name: str, T2: float, start: float, description: str, unit: str = "pu") -> None:
        """(1 + sT1)/(1 + sT2): the output is a mix of the input and the state."""
        if T2 > 0.0:
            self.signal |= self._state(name, start, description, unit)

    def _state(self, name: str, start: float, description: str, unit: str) -> frozenset[str]:
        own = frozenset({f"{self.prefix}.{name}"})
        entry = State(f"{self.prefix}.{name}", start, unit, description, self.signal | own)
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


def exciter(case: Case, k: int, point: MachinePoint, vs: frozenset[str]) -> Device | None:
    """Return the exciter of machine `k`, None when its field voltage is constant.

    `vs`: what the stabilizer's signal depends on.

    Raises
    ------
    CaseError : an exciter the C plant does not have.
    """
    m = case.machines[k]
    e = m.exciter
    if e.kind == "constant":
        return None
    if e.kind not in ("static", "static_tgr"):
        raise CaseError(_missing(case, m, "exciter", e.kind, "constant, static, static_tgr"))
    TB, TC = (e.TB, e.TC) if e.kind == "static_tgr" else (0.0, 0.0)
    low, high = _limits(e.Efd_min, e.Efd_max)
    if not low <= point.efd <= high:
        raise CaseError(
            f"{case.name}: machines.{m.name}.exciter: Efd = {point.efd:.6g} at the operating point lies "
            f"outside Efd_min = {low:g} .. Efd_max = {high:g}; widen the limits or change the dispatch"
        )
    device = Device(1, k, [e.KA, e.TA, e.TR, TB, TC, low, high, point.vt + point.efd / e.KA])
    prefix = f"{m.name}.exciter"
    chain = _Chain(device, prefix, network_states(case))
    chain.lag("v", e.TR, point.vt, "sensed terminal voltage")
    chain.signal |= vs | {f"{m.name}_vs"}
    chain.lead_lag("lead_lag", TB, point.efd / e.KA, "transient gain reduction")
    chain.lag("efd", e.TA, point.efd, "field voltage")
    device.output = chain.signal
    device.parameters = [Parameter(f"{prefix}.KA", 0, "1", "regulator gain (Vref follows)", 1e-3, 1e6)]
    for row, key, value in ((1, "TA", e.TA), (2, "TR", e.TR), (3, "TB", TB), (4, "TC", TC)):
        if value > 0.0 or (key == "TC" and TB > 0.0):
            device.parameters.append(_time(prefix, key, row, zero=key == "TC"))
    device.parameters.append(
        Parameter(f"{prefix}.Efd_min", 5, "pu", "least field voltage", -NO_LIMIT, NO_LIMIT)
    )
    device.parameters.append(
        Parameter(f"{prefix}.Efd_max", 6, "pu", "largest field voltage", -NO_LIMIT, NO_LIMIT)
    )
    return device


def governor(case: Case, k: int, point: MachinePoint) -> Device | None:
    """Return the governor and turbine of machine `k`, None when its mechanical power is constant.

    Raises
    ------
    CaseError : a governor the C plant does not have, or gate limits that exclude the operating point.
    """
    m = case.machines[k]
    g = m.governor
    if g.kind == "none":
        return None
    if g.kind != "steam":
        raise CaseError(_missing(case, m, "governor", g.kind, "none, steam"))
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


_TEXT = {"Kp": "regulator gain", "Rp": "permanent droop, pu speed per pu power"}


def _limits(low: float | None, high: float | None) -> tuple[float, float]:
    return (-NO_LIMIT if low is None else low, NO_LIMIT if high is None else high)


def _time(prefix: str, key: str, row: int, *, zero: bool) -> Parameter:
    return Parameter(f"{prefix}.{key}", row, "s", f"time constant {key}", 0.0 if zero else SHORTEST_S, 1e6)


def _missing(case: Case, machine: Machine, device: str, kind: str, known: str) -> str:
    where = f"{case.name}: machines.{machine.name}.{device}"
    return f"{where}.kind = {kind!r} is not modelled by the plant, allowed: {known}"
