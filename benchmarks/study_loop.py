"""The closed loop that the benchmarks run: the study's plant, two channels and controller, 20 s."""

from __future__ import annotations

from typing import Any

SCENARIO: dict[str, Any] = {
    "case": "two-area-thesis",
    "controller": "wdc",
    "stop_s": 20.0,
    "step_s": 0.01,
    "channels": {
        "remote": {"signal": "G2_dw", "latency_s": 0.1},
        "local": {"signal": "G4_dw", "latency_s": 0.1},
    },
    "event": [{"kind": "vref_pulse", "machine": "G1", "size_pu": 0.05, "start_s": 1.0, "end_s": 1.2}],
}
