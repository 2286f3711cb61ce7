"""The plant's equations integrated as PSS/E does it, at the step h of a record; found from the records.

    machines, governors, stabilizers,    x(t + h) = x(t) + h (3 f(t) - f(t - h))/2; at an event f is the mean
    exciters that see V at once          of the rates before and after it
    exciters with a voltage transducer   the trapezoidal rule, what they see of the network standing still:
                                         (1 - h J/2) [x(t + h) - x(t)] = h f(t), then the limits of the states
    exciters with one shorter than h     have none; as machines, but the network stands still for the step:
                                         x(t + h) = x(t) + h (3 f(x(t)) - f(x(t - h)))/2, both at V(t)
    a field voltage that follows the     is made before the network is solved: from the exciter's states of t
    network at once                      and the network of t - h (behind a last lag with T = 0 all of t - h)
    HYGOV                                sees the speed of t - h
    states                               in single precision

Exciters without a transducer need time constants above h.
"""

from __future__ import annotations

import ctypes
from typing import Any

import numpy as np
import numpy.typing as npt
from fmpy.fmi2 import FMU2Model
from fmu_run import PlantSlave

from interarea.models.blocks.plant import event_parameters
from interarea.models.case.case import Case
from interarea.models.case.schema import Machine
from interarea.models.devices.instance import Instance
from interarea.models.grid.equilibrium import operating_point

Array = npt.NDArray[np.float64]


class Rates:
    """The plant in model exchange: rates and variables at any states."""

    def __init__(self, plant: PlantSlave, case: Case, events: list[Any]) -> None:
        self.references = plant.references
        self.model = FMU2Model(
            guid=plant.slave.guid, modelIdentifier=plant.slave.modelIdentifier,
            unzipDirectory=plant.slave.unzipDirectory, instanceName="psse-steps",
        )  # fmt: skip
        self.model.instantiate()
        for name, value in event_parameters(case, events).items():
            setter = self.model.setReal if isinstance(value, float) else self.model.setInteger
            setter([self.references[name]], [value])
        self.model.setupExperiment(startTime=0.0)
        self.model.enterInitializationMode()
        self.model.exitInitializationMode()
        self.model.newDiscreteStates()
        self.model.enterContinuousTimeMode()
        self.size = len(operating_point(case).state_names)

    def start(self) -> Array:
        """Return the states at rest."""
        x = np.zeros(self.size)
        self.model.getContinuousStates(_pointer(x), x.size)
        return x

    def at(self, x: Array) -> Array:
        """Return the rates at states `x`; `shown` is about them from then on."""
        dx = np.zeros_like(x)
        self.model.setContinuousStates(_pointer(x), x.size)
        self.model.getDerivatives(_pointer(dx), dx.size)
        return dx

    def shown(self, names: list[str]) -> Array:
        """Return variables."""
        return np.array(self.model.getReal([self.references[name] for name in names]) if names else [])

    def choose_modes(self) -> None:
        """Let events happen and limiters switch."""
        self.model.enterEventMode()
        self.model.newDiscreteStates()
        self.model.enterContinuousTimeMode()

    def close(self) -> None:
        """End it."""
        self.model.terminate()
        self.model.freeInstance()


class FieldVoltages:
    """Field voltages as the machines of PSS/E have them: made before the network is solved."""

    def __init__(self, rates: Rates, case: Case, states: list[str]) -> None:
        of = [m for m in case.machines if f"{m.name}.eq1" in states]
        self.rates, self.names = rates, [f"{m.name}.Efd" for m in of]
        self.at = [(states.index(f"{m.name}.eq1"), states.index(f"{m.name}.eq2")) for m in of]
        self.share = [((m.Xd2 - m.Xl) / (m.Xd1 - m.Xl), m.Td01) for m in of]
        controls = {case.machines[d.machine].name: d for d in operating_point(case).controls.of("exciter")}
        self.whole = np.array(
            [_ends_at_once(controls[m.name].rest.instance) for m in of if m.name in controls]
        )
        if self.whole.size != len(of):
            self.whole = np.zeros(len(of), dtype=bool)
        self.of_machines = np.array([name.count(".") == 1 for name in states])

    def now(self) -> Array:
        """Return those of the states that `rates` was asked about last."""
        return self.rates.shown(self.names)

    def earlier(self, x: Array, before: Array, last: Array) -> Array:
        """Return those at `x` with the network of states `before`, whose own are `last`."""
        self.rates.at(np.where(self.of_machines, before, x))
        return np.where(self.whole, last, self.now())

    def put(self, dx: Array, voltages: Array, now: Array) -> None:
        """Change rates `dx`, found with `now`, to those with `voltages`."""
        for change, (eq1, eq2), (share, Td01) in zip(voltages - now, self.at, self.share, strict=True):
            dx[eq1] += change / Td01
            dx[eq2] += share * change / Td01


def without_short_transducers(case: Case, h: float) -> Case:
    """Return `case` with no voltage transducer of an exciter that is shorter than a step of `h` s."""
    changes = {}
    for device in operating_point(case).controls.of("exciter"):
        if 0.0 < device.rest.instance.values.get("TR", 0.0) < h:
            changes[case.machines[device.machine].name] = {"exciter": {"TR": 0.0}}
    return case.with_changes({"machines": changes}) if changes else case


class Standing:
    """An exciter without its transducer: the two-step rule, what it sees of the network standing still."""

    def __init__(self, instance: Instance, states: list[str], machine: Machine) -> None:
        self.at = [states.index(f"{machine.name}.exciter.{name}") for name in instance.state_names]
        self.before: Array | None = None

    def step(self, rates: Rates, x: Array, dx: Array, h: float) -> Array:
        """Return its states a step on; its rates at `x` are in `dx`."""
        y = x.copy()
        if self.before is not None:
            y[self.at] = self.before
        self.before = x[self.at].copy()
        return x[self.at] + h * (1.5 * dx[self.at] - 0.5 * rates.at(y)[self.at])


class Trapezoid:
    """An exciter behind a voltage transducer."""

    def __init__(self, instance: Instance, margins: Any, states: list[str], machine: Machine) -> None:
        names = [f"{machine.name}.exciter.{name}" for name in instance.state_names]
        self.at = [states.index(name) for name in names]
        self.low, self.high = np.full(len(names), -np.inf), np.full(len(names), np.inf)
        for margin in margins:
            if margin.signal in instance.state_names:
                k = instance.state_names.index(margin.signal)
                self.low[k], self.high[k] = margin.low, margin.high

    def step(self, rates: Rates, x: Array, dx: Array, h: float) -> Array:
        """Return its states a step on; its rates at `x` are in `dx`."""
        n = len(self.at)
        jacobian = np.zeros((n, n))
        y = x.copy()
        for column, i in enumerate(self.at):
            small = 1e-5 * max(1.0, abs(x[i]))
            y[i] = x[i] + small
            up = rates.at(y)[self.at]
            y[i] = x[i] - small
            jacobian[:, column] = (up - rates.at(y)[self.at]) / (2.0 * small)
            y[i] = x[i]
        change = np.linalg.solve(np.eye(n) - 0.5 * h * jacobian, h * dx[self.at])
        return np.clip(x[self.at] + change, self.low, self.high)


def psse_steps(
    plant: PlantSlave, case: Case, events: list[Any], stop: float, h: float, names: list[str]
) -> Array:
    """Return variables `names` at 0, h, 2 h, ..., shape (steps, names)."""
    rates = Rates(plant, case, events)
    states = list(operating_point(case).state_names)
    fields = FieldVoltages(rates, case, states)
    exciters: list[Trapezoid | Standing] = []
    for d in operating_point(case).controls.of("exciter"):
        instance, machine = d.rest.instance, case.machines[d.machine]
        if instance.values.get("TR", 0.0) > 0.0:
            exciters.append(Trapezoid(instance, d.rest.margins, states, machine))
        elif "TR" in instance.values:
            exciters.append(Standing(instance, states, machine))
    hydro = [m.name for m in case.machines if m.governor.kind == "hygov"]
    governed = np.array([name.split(".")[0] in hydro and ".governor." in name for name in states])
    slips = np.array([name.endswith(".slip") for name in states])
    x = rates.start()
    before, dx_before, voltages_before = x.copy(), np.zeros_like(x), np.zeros(0)
    switches = {round(t / h) for e in events for t in (e.start_s, getattr(e, "end_s", None)) if t is not None}
    rows = []

    for k in range(round(stop / h) + 1):
        rates.model.setTime(k * h)
        rates.model.setContinuousStates(_pointer(x), x.size)
        if k not in switches:
            rates.choose_modes()
        late = rates.at(np.where(slips, before, x)) if hydro else x
        dx = rates.at(x)
        rows.append(rates.shown(names))
        now = fields.now()
        voltages = fields.earlier(x, before, voltages_before if k else now)
        mean = np.where(governed, late, dx)
        fields.put(mean, voltages, now)
        if k in switches:
            rates.at(x)
            rates.choose_modes()
            dx = rates.at(x)
            rows[-1] = rates.shown(names)
            after, now, voltages = dx.copy(), fields.now(), now
            fields.put(after, voltages, now)
            mean = np.where(governed, late, 0.5 * (mean + after))
        voltages_before = now
        new = x + h * (1.5 * mean - 0.5 * dx_before)
        for exciter in exciters:
            new[exciter.at] = exciter.step(rates, x, dx, h)
        before, dx_before, x = x, mean, new.astype(np.float32).astype(float)
    rates.close()
    return np.array(rows)


def heun_steps(
    plant: PlantSlave, case: Case, events: list[Any], stop: float, h: float, names: list[str]
) -> Array:
    """Return variables `names` at 0, h, 2 h, ... by Heun's rule, as PowerWorld integrates; (steps, names)."""
    rates = Rates(plant, case, events)
    x = rates.start()
    rows = []
    for k in range(round(stop / h) + 1):
        rates.model.setTime(k * h)
        rates.model.setContinuousStates(_pointer(x), x.size)
        rates.choose_modes()
        dx = rates.at(x)
        rows.append(rates.shown(names))
        x = x + 0.5 * h * (dx + rates.at(x + h * dx))
    rates.close()
    return np.array(rows)


def held_field_steps(
    plant: PlantSlave,
    case: Case,
    events: list[Any],
    times: Array,
    names: list[str],
    held: tuple[Array, Array],
    h: float = 0.001,
) -> Array:
    """Return variables `names` at `times` (rising from 0), shape (times, names), by Runge-Kutta of order 4.

    held : times and values (pu) between which the field voltage of all machines is that, not the exciter's.
    """
    rates = Rates(plant, case, events)
    fields = FieldVoltages(rates, case, list(operating_point(case).state_names))
    x = rates.start()
    ends = [t for e in events for t in (e.start_s, getattr(e, "end_s", None)) if t is not None]
    grid = np.unique(np.round(np.concatenate([np.arange(0.0, times[-1] + h, h), times, ends, held[0]]), 9))
    rows = []
    for a, b in zip(grid, np.append(grid[1:], grid[-1] + h), strict=True):
        rates.model.setTime(a)
        rates.model.setContinuousStates(_pointer(x), x.size)
        rates.choose_modes()
        holds = held[0][0] <= a + 1e-9 and b <= held[0][-1] + 1e-9

        def at(t: float, x: Array, holds: bool = holds) -> Array:
            rates.model.setTime(t)
            dx = rates.at(x)
            if holds:
                now = fields.now()
                fields.put(dx, np.full(now.shape, np.interp(t, *held)), now)
            return dx

        k1 = at(a, x)
        rows.append(rates.shown(names))
        k2 = at(0.5 * (a + b), x + 0.5 * (b - a) * k1)
        k3 = at(0.5 * (a + b), x + 0.5 * (b - a) * k2)
        x = x + (b - a) / 6.0 * (k1 + 2.0 * (k2 + k3) + at(b, x + (b - a) * k3))
    rates.close()
    return np.array(rows)[np.searchsorted(grid, np.round(times, 9))]


def _ends_at_once(instance: Instance) -> bool:
    """Whether the last element would have a state but for its time constant of 0."""
    element = instance.model.elements[instance.model.device.output]
    return bool(element.states()) and not any(instance.on(s.present) for s in element.states())


def _pointer(a: Array) -> Any:
    """Return where `a` lies."""
    return a.ctypes.data_as(ctypes.POINTER(ctypes.c_double))
