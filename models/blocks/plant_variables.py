"""Variables of the plant: states, inputs, parameters and event slots."""

from __future__ import annotations

from collections.abc import Mapping

from ..devices.language.device import NO_LIMIT
from ..grid.control_tables import Parameter
from ..grid.equilibrium import OperatingPoint
from ..grid.machine_tables import NETWORK, network_states
from .variables import Enumeration, Variable

#: Value of each kind in the FMI enumeration; plant/events/event.h counts in the same order.
EVENT_CODES = {
    "none": 0,
    "bus_fault": 1,
    "branch_trip": 2,
    "branch_reclose": 3,
    "vref_pulse": 4,
    "load_step": 5,
    "pm_pulse": 6,
    "machine_trip": 7,
    "shunt_switch": 8,
    "frequency_shed": 9,
    "frequency_trip": 10,
    "device_trip": 11,
    "hvdc_block": 12,
}
WAVE_CODES = {"steady": 0, "sine": 1, "square": 2, "noise": 3}
_WAVE_WORDS = {
    "steady": "size, after a rise where there is one",
    "sine": "size sin(2 pi frequency (t - start)), in equal stairs of at most 20 ms",
    "square": "size in the first half of each period, -size in the second",
    "noise": "normal with standard deviation size every 20 ms; load_step of target 0: a share of each load",
}
_EVENT_WORDS = {
    "none": "slot not in use",
    "bus_fault": "three-phase fault at a bus through r + jx",
    "branch_trip": "branch opens at start, closes at end",
    "branch_reclose": "branch closes at start",
    "vref_pulse": "voltage set-point of a machine raised by size",
    "load_step": "size + j size_q added to a load at its operating voltage, of its characteristic",
    "pm_pulse": "mechanical power of a machine raised by size (machine base)",
    "machine_trip": "machine disconnected at start",
    "shunt_switch": "shunt switched in (size = 1) or out (size = 0), back at end",
    "frequency_shed": "a frequency relay adds size + j size_q (below 0) to a load, in use from start to end",
    "frequency_trip": "a frequency relay disconnects a machine, in use from start to end",
    "device_trip": "SVC, STATCOM or dc link disconnected, series capacitor bypassed at start",
    "hvdc_block": "dc link blocked from start to end: no current, its control stands still",
}
#: names of states that derivatives list altogether; beyond, those that see the network list nothing, which in
#: FMI says that they may depend on everything
MOST_DEPENDENCIES = 400_000


def state_variables(point: OperatingPoint) -> list[Variable]:
    """Return the states and then their derivatives."""
    network = network_states(point.case)
    listed = len(network) * sum(NETWORK in s.depends_on for s in point.states)

    def reached(names: frozenset[str]) -> tuple[str, ...] | None:
        if NETWORK in names:
            if listed > MOST_DEPENDENCIES:
                return None
            names = names - {NETWORK} | network
        return tuple(sorted(names, key=order.__getitem__))

    states = [
        Variable(s.name, "state", s.description, unit=s.unit, start=s.start, nominal=1.0)
        for s in point.states
    ]
    order = {name: k for k, name in enumerate((*point.state_names, *point.input_names))}
    rate = {"rad": "rad/s", "pu": "pu/s"}
    derivatives = [
        Variable(
            f"der({s.name})",
            "derivative",
            f"rate of {s.name}",
            unit=rate[s.unit],
            derivative_of=s.name,
            depends_on=reached(s.depends_on),
        )
        for s in point.states
    ]
    return states + derivatives


_ADDED_TO = {
    "v_mod": "the voltage set-point",
    "x_mod": "the reactance",
    "p_mod": "the active power",
    "q_mod": "the reactive reference",
    **{f"q_mod_{end}": f"the reactive power at {end}_bus" for end in ("from", "to")},
    **{f"v_mod_{end}": f"the voltage set-point at {end}_bus" for end in ("from", "to")},
}


def input_variables(point: OperatingPoint) -> list[Variable]:
    """Return the inputs, one for each exciter, SVC, STATCOM and LCC link, two for each converter,
    three for each VSC link."""
    return [
        Variable(
            named_input.name,
            "input",
            "added at the exciter's summing point"
            if named_input.word == "vs"
            else f"added to {_ADDED_TO[named_input.word]} of {named_input.row}, pu of its base",
            unit="pu",
            start=0.0,
        )
        for named_input in point.controls.inputs
    ]


def parameter_variable(parameter: Parameter) -> Variable:
    """Return the FMI parameter of one number of a device."""
    return Variable(
        parameter.name,
        "parameter",
        parameter.description,
        unit=parameter.unit,
        start=parameter.value,
        min=parameter.low,
        max=parameter.high,
    )


def event_variables(slots: int, provided: Mapping[str, float | int]) -> list[Variable]:
    """Return the parameters of the event slots; `provided`: name -> start value in a slot in use."""
    items = tuple((name, code, _EVENT_WORDS[name]) for name, code in EVENT_CODES.items())
    kind = Enumeration("EventKind", items)
    wave = Enumeration("EventWave", tuple((n, code, _WAVE_WORDS[n]) for n, code in WAVE_CODES.items()))
    texts = {
        "start": ("s", "start time", 0.0),
        "end": ("s", "end time; 1e30: no end", NO_LIMIT),
        "size": ("pu", "size of the step", 0.0),
        "size_q": ("pu", "reactive part of a load step", 0.0),
        "r": ("pu", "fault resistance", 0.0),
        "x": ("pu", "fault reactance", 1e-4),
        "rise": ("s", "time over which a step of a load or set-point grows from 0, in stairs of 20 ms", 0.0),
        "threshold": ("Hz", "frequency beyond which a relay acts: below the rated one under it", 0.0),
        "delay": ("s", "how long the frequency must be beyond the threshold", 0.0),
        "breaker": ("s", "from the relay's order until the breaker is open", 0.1),
        "filter": ("s", "time constant with which the relay measures", 0.05),
        "frequency": ("Hz", "of a wave; of noise where its spectrum has fallen to half", 0.0),
    }
    variables = []
    for k in range(1, slots + 1):
        for key, (unit, text, start) in texts.items():
            name = f"event[{k}].{key}"
            value = provided.get(name, start)
            variables.append(Variable(name, "parameter", text, unit=unit, start=value, tunable=True))
        variables.append(_choice(f"event[{k}].kind", "what happens", kind, provided))
        text = (
            "number of the bus, branch, machine, load, shunt or device at a bus in the case, from 1; "
            "classical machines last"
        )
        variables.append(_whole(f"event[{k}].target", text, 1, provided))
        text = "how a step of a load or set-point goes on"
        variables.append(_choice(f"event[{k}].wave", text, wave, provided))
        variables.append(_whole(f"event[{k}].seed", "of the random numbers of noise", 0, provided))
    return variables


def _choice(name: str, text: str, of: Enumeration, provided: Mapping[str, float | int]) -> Variable:
    start = provided.get(name, 0)
    return Variable(name, "parameter", text, type="Enumeration", start=start, enumeration=of, tunable=True)


def _whole(name: str, text: str, start: int, provided: Mapping[str, float | int]) -> Variable:
    start = int(provided.get(name, start))
    return Variable(name, "parameter", text, type="Integer", start=start, tunable=True)
