"""A communication channel for one signal, as a block for the FMU builder (c/channel/channel.c)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from .sizes import OUTAGES, QUANTILES, SIGNAL_FAULTS
from .variables import Block, Enumeration, Variable, VariableTable

_FOLDER = Path(__file__).resolve().parents[1] / "c" / "channel"
_PARTS = ("channel", "history", "outage", "packets", "signal_fault")

ON_LOSS = Enumeration(
    "OnLoss",
    (
        ("zero", 0, "The output is zero during an outage"),
        ("hold", 1, "The output keeps the value it had when the outage began"),
        ("hold_then_zero", 2, "As hold for hold_time, then zero"),
    ),
)

SIGNAL_FAULT = Enumeration(
    "SignalFault",
    (
        ("none", 0, "The signal is right"),
        ("stuck", 1, "Frozen at its value at the start of the fault"),
        ("bias", 2, "size is added"),
        ("ramp", 3, "A ramp of size per second is added"),
        ("drift", 4, "A bias that approaches size with the time constant detail (s) is added"),
        ("scale", 5, "It is multiplied by size"),
        ("polarity", 6, "It has the wrong sign"),
        ("noise", 7, "Noise of standard deviation size is added to each packet"),
        ("spike", 8, "Plus or minus size is added to a packet with probability detail"),
        ("replay", 9, "The last size seconds before the start are repeated"),
        ("time_error", 10, "The value is size + detail (t - start) seconds older than its stamp"),
        ("oscillating", 11, "A sine of amplitude size and frequency detail (Hz) is added"),
        ("swap", 12, "Replaced by signal number size of the same concentrator"),
    ),
)


def signal_fault_variables(fault: str) -> list[Variable]:
    """Return the parameters of one fault of a signal: ``.start`` and so on after the name `fault`."""
    return [
        Variable(f"{fault}.start", "parameter", "Start of the fault", unit="s", start=1e30),
        Variable(f"{fault}.end", "parameter", "End of the fault, itself outside", unit="s", start=1e30),
        Variable(f"{fault}.size", "parameter", "Size, see kind", start=0.0),
        Variable(f"{fault}.detail", "parameter", "Second number, see kind", start=0.0),
        Variable(
            f"{fault}.kind",
            "parameter",
            "Fault of the signal; its flag stays valid",
            type="Enumeration",
            enumeration=SIGNAL_FAULT,
            start=0,
        ),
    ]


def _variables(unit: str) -> list[Variable]:
    """Return the variables in the order of their value references."""
    variables = [
        Variable("u", "input", "Signal sent", unit=unit, start=0.0),
        Variable("y", "output", "Signal received", unit=unit, depends_on=("u",)),
        Variable(
            "age", "output", "Time since the newest received value was sampled", unit="s", depends_on=()
        ),
        Variable("valid", "output", "Whether the signal arrives", type="Boolean", depends_on=()),
        *(
            Variable(name, "output", f"Packets {what} so far", type="Integer", depends_on=())
            for name, what in (
                ("sent", "sent"),
                ("delivered", "delivered with the newest time stamp"),
                ("dropped", "lost in transit or in an outage"),
                ("late", "that arrived after a newer one or after the wait time of the concentrator"),
            )
        ),
        Variable(
            "latency",
            "parameter",
            "Latency from sending to receiving",
            unit="s",
            display_unit="ms",
            start=0.0,
            min=0.0,
            tunable=True,
        ),
        Variable(
            "hold_time",
            "parameter",
            "Hold time of hold_then_zero",
            unit="s",
            display_unit="ms",
            start=0.5,
            min=0.0,
            tunable=True,
        ),
    ]
    for k in range(1, OUTAGES + 1):
        for key, text in (("start", f"Start of outage {k}"), ("end", f"End of outage {k}, itself outside")):
            variables.append(
                Variable(f"outage[{k}].{key}", "parameter", text, unit="s", start=1e30, tunable=True)
            )
    variables += [
        Variable(name, "parameter", text, unit=in_unit, start=0.0, min=0.0, max=most)
        for name, text, in_unit, most in (
            ("reporting_interval", "Interval between packets; 0: continuous", "s", 1e6),
            ("jitter", "Width of a uniform random part of the latency", "s", 1e6),
            ("quantum", "Quantisation step of the value sent; 0: none", unit, 1e6),
            ("pdc_wait", "Wait time of the concentrator after the time stamp; 0: none", "s", 1e6),
            ("loss_good", "Probability of loss in the good state", "1", 1.0),
            ("loss_bad", "Probability of loss in the bad state", "1", 1.0),
            ("good_to_bad", "Probability of transition from good to bad, per packet", "1", 1.0),
            ("bad_to_good", "Probability of transition from bad to good, per packet", "1", 1.0),
            *(
                (f"quantile[{j + 1}]", f"Random part of the latency at probability {j}/32", "s", 1e6)
                for j in range(QUANTILES)
            ),
        )
    ]
    variables.append(
        Variable(
            "on_loss",
            "parameter",
            "Output during an outage",
            type="Enumeration",
            enumeration=ON_LOSS,
            start=2,
            tunable=True,
        )
    )
    variables.append(
        Variable("seed", "parameter", "Which random packets", type="Integer", start=0, min=0, max=2147483647)
    )
    for k in range(1, SIGNAL_FAULTS + 1):
        variables += signal_fault_variables(f"fault[{k}]")
    return variables


def channel_block(
    name: str = "channel",
    *,
    capacity: int = 4096,
    unit: str = "pu",
    step_s: float = 0.01,
    documentation: Mapping[str, str] | None = None,
) -> Block:
    r"""Return the block of a channel: :math:`y(t) = u(t - \mathrm{latency})` unless the signal is lost.

    Everything else is an FMI parameter: ``latency`` (s), ``on_loss`` (`ON_LOSS`),
    ``hold_time`` (s), ``outage[k].start`` and ``outage[k].end`` (s, k = 1..8; a
    window with start = end is off), ``reporting_interval`` (s; 0: continuous),
    ``jitter`` (s, uniform), ``quantile[j]`` (s, j = 1..33, see `quantiles_of`),
    ``quantum``, ``pdc_wait`` (s), ``loss_good``, ``loss_bad``, ``good_to_bad``,
    ``bad_to_good`` (probabilities per packet), ``seed`` and, k = 1..4, ``fault[k].kind`` (`SIGNAL_FAULT`),
    ``.start``, ``.end`` (s), ``.size``, ``.detail``. Outputs ``y``, the age
    of its information ``age`` (s), the Boolean ``valid`` and the packet counts
    ``sent``, ``delivered``, ``dropped``, ``late``.

    Parameters
    ----------
    name : model name, a C identifier.
    capacity : communication points that are remembered; latency / step must stay below it.
    unit : unit of input and output.
    step_s : communication step of the DefaultExperiment, s.

    Raises
    ------
    ValueError : capacity below 2 or above 1 000 000.
    """
    if not 2 <= capacity <= 1_000_000:
        raise ValueError(
            f"channel {name}: capacity is {capacity}, allowed are 2 to 1000000 communication points"
        )
    return Block(
        kind="channel",
        name=name,
        description="Communication channel: exact latency, packets, loss, outages, rule on loss",
        table=VariableTable(_variables(unit)),
        data={"capacity": np.array([capacity], dtype=np.int32)},
        sources=(*(_FOLDER / f"{part}.c" for part in _PARTS), _FOLDER.parent / "block" / "random.c"),
        step_s=step_s,
        model_exchange=False,
        documentation={"Behaviour": _BEHAVIOUR, **(documentation or {})},
    )


def quantiles_of(points_s: Sequence[float]) -> dict[str, float]:
    """Return ``quantile[j]`` parameters from quantiles at equally spaced probabilities 0 to 1, s.

    Raises
    ------
    ValueError : fewer than two points, a negative one, or a descending one.
    """
    points = np.asarray(points_s, dtype=float)
    if not (points.size >= 2 and points[0] >= 0.0 and np.all(np.diff(points) >= 0.0)):
        raise ValueError("quantiles of a latency: allowed are two or more, not negative, not descending")
    at = np.linspace(0.0, 1.0, QUANTILES)
    table = np.interp(at, np.linspace(0.0, 1.0, points.size), points)
    return {f"quantile[{j}]": float(q) for j, q in enumerate(table, start=1)}


def gamma_quantiles(shape: float, scale_s: float) -> dict[str, float]:
    """Return ``quantile[j]`` parameters of a gamma distribution (mean shape * scale_s, s).

    Between its quantiles the table is linear; its last point stands for the tail
    beyond probability 31/32 and is placed so that the tail's mean is right.
    """
    if not (shape > 0.0 and scale_s > 0.0):
        raise ValueError(f"gamma latency: shape {shape:g} and scale {scale_s:g} s, allowed: positive")
    at = np.linspace(0.0, 1.0, QUANTILES)[:-1]
    from scipy.special import gammaincc, gammaincinv  # takes 0.1 s; most scenarios have no such latency

    inner = gammaincinv(shape, at) * scale_s
    tail_mean = shape * scale_s * gammaincc(shape + 1.0, inner[-1] / scale_s) * (QUANTILES - 1)
    return quantiles_of([*inner, 2.0 * tail_mean - inner[-1]])


_BEHAVIOUR = (
    "<p>y(t) = u(t &minus; latency) at every communication point, whatever the step. Between the "
    "communication points at which u and its slope were set, the input is the cubic Hermite polynomial; "
    "without slopes the straight line; before the start, its first value. During an outage (start included, "
    "end not) <code>valid</code> is false and <code>on_loss</code> decides y.</p>"
    "<p>With <code>reporting_interval</code> T &gt; 0 the signal travels in packets stamped k T, with random "
    "latency and loss from <code>seed</code>; y is the value with the newest stamp that has arrived. "
    "sent = delivered + dropped + late + in transit.</p>"
    "<p><code>fault[k]</code> makes values measured in [start, end) wrong; <code>valid</code> stays true.</p>"
)
