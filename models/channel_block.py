"""A communication channel for one signal, as a block for the FMU builder (semantics: channel/channel.h)."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np

from .variables import Block, Enumeration, Variable, VariableTable

_FOLDER = Path(__file__).resolve().parent / "channel"

OUTAGES = 8  #: outage windows of a channel; as in channel.h

ON_LOSS = Enumeration(
    "OnLoss",
    (
        ("zero", 0, "The output is zero during an outage"),
        ("hold", 1, "The output keeps the value it had when the outage began"),
        ("hold_then_zero", 2, "As hold for hold_time, then zero"),
    ),
)


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
    window with start = end is off). Outputs ``y`` and the Boolean ``valid``.

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
    variables = [
        Variable("u", "input", "Signal sent", unit=unit, start=0.0),
        Variable("y", "output", "Signal received", unit=unit, depends_on=("u",)),
        Variable("valid", "output", "Whether the signal arrives", type="Boolean", depends_on=()),
        Variable(
            "latency",
            "parameter",
            "Time from sending to receiving",
            unit="s",
            display_unit="ms",
            start=0.0,
            min=0.0,
            tunable=True,
        ),
        Variable(
            "hold_time",
            "parameter",
            "How long hold_then_zero holds",
            unit="s",
            display_unit="ms",
            start=1.0,
            min=0.0,
            tunable=True,
        ),
    ]
    for k in range(1, OUTAGES + 1):
        variables += [
            Variable(f"outage[{k}].start", "parameter", f"Start of outage {k}", unit="s", start=1e30),
            Variable(
                f"outage[{k}].end", "parameter", f"End of outage {k}, itself outside", unit="s", start=1e30
            ),
        ]
    variables.append(
        Variable(
            "on_loss",
            "parameter",
            "What the output is during an outage",
            type="Enumeration",
            enumeration=ON_LOSS,
            start=0,
            tunable=True,
        )
    )
    return Block(
        kind="channel",
        name=name,
        description="Communication channel: exact latency, outages, rule on loss",
        table=VariableTable(variables),
        data={"capacity": np.array([capacity], dtype=np.int32)},
        sources=(_FOLDER / "channel.c", _FOLDER / "history.c"),
        step_s=step_s,
        model_exchange=False,
        documentation={"Behaviour": _BEHAVIOUR, **(documentation or {})},
    )


_BEHAVIOUR = (
    "<p>y(t) = u(t &minus; latency) at every communication point, whatever the step. Between the "
    "communication points at which it was told u and its slope, the input is the cubic Hermite polynomial; "
    "without slopes the straight line; before the start, its first value. During an outage (start included, "
    "end not) <code>valid</code> is false and <code>on_loss</code> decides y.</p>"
)
