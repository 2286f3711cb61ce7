"""Devices that carry actuators in a run: their outputs in a fault, and remote signals that move them."""

from __future__ import annotations

from typing import Any

import control
import numpy as np
import pytest

import interarea as ia

FAULT_S, CLEARED_S, LATE_S = 0.5, 0.6, 0.1
DOCUMENT: dict[str, Any] = {
    "case": "two-area-actuators",
    "stop_s": 1.5,
    "show": ["bus7.v"],
    "channels": {
        "flow": {"latency_s": LATE_S},
        "frequency": {"signal": "f9", "pmu": {"bus": 9}, "latency_s": LATE_S},
    },
    "connections": [["plant.branch[8-9 a].p", "flow", "controller.flow"]],
    "event": [{"kind": "bus_fault", "bus": 8, "start_s": FAULT_S, "end_s": CLEARED_S, "x_pu": 0.01}],
}
GAINS = {"svc1_v_mod": 1.0, "stat1_v_mod": -2.0, "tcsc1_x_mod": 0.5, "hvdc1_p_mod": 4.0, "vsc1_q_mod_to": 2.0}
SIGNALS = ["flow", "f9"]


def washouts(outputs: list[str]) -> control.StateSpace:
    """Washouts of both signals, summed, times the gain of each output."""
    gain = np.outer([GAINS.get(name, 1.0) for name in outputs], [0.01, 2.0])
    return control.ss(-np.eye(2), np.eye(2), -gain, gain, inputs=SIGNALS, outputs=outputs, name="remote")


@pytest.mark.slow
def test_remote_signals_move_every_kind_of_device() -> None:
    """A branch's power and a bus frequency at four devices at once, late; their outputs keep their limits."""
    moved, calm = (
        ia.simulate(document, controller=washouts(list(GAINS))).data
        for document in (DOCUMENT, DOCUMENT | {"event": []})
    )
    still = ia.simulate(DOCUMENT | {"channels": {}, "connections": []}, controller="none").data
    t = np.asarray(moved["time_s"])

    def change(name: str, other: Any) -> np.ndarray[Any, Any]:
        return np.abs(np.asarray(moved[name]) - np.interp(t, other["time_s"], other[name]))

    # the fault reaches the controller one latency later, then the devices
    before, after = t < FAULT_S + LATE_S - 1e-9, t > FAULT_S + LATE_S + 0.02
    for name, gain in GAINS.items():
        assert np.max(np.abs(moved[f"controller.{name}"] - gain * moved["controller.svc1_v_mod"])) < 1e-12
        caused = change(f"controller.{name}", calm)
        assert np.max(caused[after]) > 1e-3 > 1e6 * np.max(caused[before]), name
    for name in ("svc1.q", "stat1.q", "tcsc1.i", "hvdc1.p_inverter", "vsc1.q_to"):
        assert np.max(change(f"plant.{name}", still)[after]) > 1e-3, name
    # at the end of the fault both shunt devices are at their limit: an SVC gives v^2, a STATCOM v
    last = np.searchsorted(t, CLEARED_S - 1e-9) - 1
    v = np.asarray(moved["plant.bus7.v"])[last]
    assert v < 0.8
    assert np.asarray(moved["plant.stat1.q"])[last] == pytest.approx(v, abs=2e-2)
    assert np.asarray(moved["plant.svc1.q"])[last] == pytest.approx(v * v, abs=2e-2)


@pytest.mark.parametrize("output", ["hvdc1_v_mod", "svc2_v_mod", "tcsc1_v_mod", "vsc1_v_mod_to"])
def test_a_modulation_that_no_device_has_is_refused_with_those_that_are_there(output: str) -> None:
    with pytest.raises(ia.UserError) as caught:
        ia.simulate(DOCUMENT, controller=washouts([output]))
    text = str(caught.value)
    assert output in text and "_mod" in text.replace(output, "")
    assert "\n" not in text
