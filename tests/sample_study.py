"""A study with made-up numbers in the form of `study.json`, to test what reads it."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

from interarea.cosim.study import verdicts
from interarea.cosim.study.printed import printed_rows

NAMES = ("inter-area", "local area 1", "local area 2")
COORDINATES = (
    "pole vectors (free of coordinates)",
    "states as modelled (rad, pu)",
    *(f"balanced reduction to {k} states" for k in (6, 8, 16)),
    "balanced, every state",
)
CLAIMS = Path(verdicts.__file__).parent / "thesis" / "published.toml"
CONDITIONS = ("normal", "remote lost", "synchronous 100 ms", "non-synchronous 100 ms")


def sample_study() -> dict[str, Any]:
    """Return a complete study: every key the report and the judgements read."""
    study = {
        "schema": 1,
        "case": "two-area-thesis",
        "title": "The two-area study",
        "plant": {"states": 56, "relative_states": 55},
        "modes": {
            "inter-area": _mode(0.62272, 0.08059),
            "local area 1": _mode(1.1393, 0.2466),
            "local area 2": _mode(1.2109, 0.2041),
        },
        "participation": {
            "inter-area": {"G1": 0.3, "G2": 0.2, "G3": 0.3, "G4": 0.2},
            "local area 1": {"G1": 0.48, "G2": 0.48, "G3": 0.02, "G4": 0.02},
            "local area 2": {"G1": 0.02, "G2": 0.02, "G3": 0.48, "G4": 0.48},
        },
        "modes_without_stabilizers": {
            "inter-area": _mode(0.62, 0.02),
            "local area 1": _mode(1.15, 0.07),
            "local area 2": _mode(1.2, 0.07),
        },
        "loops": {
            "ranking": [
                {"actuator": "G4", "signal": "dw24", "index": 0.19, "geometric": 0.17},
                {"actuator": "G4", "signal": "dw14", "index": 0.18, "geometric": 0.16},
                {"actuator": "G2", "signal": "dw24", "index": 0.15, "geometric": 0.14},
            ],
            "selected": {"actuator": "G4", "signal": "dw24"},
            "coordinates": "balanced coordinates of a 6-state reduction",
            "coordinate_table": [
                {"coordinates": name, "best": ["G4", "dw24"], "indices": [0.19, 0.18, 0.15], "lead": 0.05}
                for name in COORDINATES
            ],
        },
        "reduction": {
            order: {
                "plant": "dw24 from G4",
                "method": "balanced truncation",
                "relative_error": 0.11 / int(order),
                "relative_bound": 0.4 / int(order),
                "relative_next_hankel": 0.05 / int(order),
                "mode_errors": {name: 0.06 / int(order) for name in NAMES},
                "optimal_hankel": {
                    "relative_error": 0.1 / int(order),
                    "relative_bound": 0.4 / int(order),
                    "relative_hankel_error": 0.05 / int(order),
                },
            }
            for order in ("6", "8")
        },
        "controllers": {
            "wdc": _controller(8, 4, 0.296, 0.21, 0.22),
            "cc": _controller(8, 8, 0.311, 0.223, 0.083),
            "ftc": _controller(8, 5, 0.344, 0.344, 0.11),
        },
        "sensitivity": {
            "controller": "wdc",
            "s_at_zero": 1.0,
            "w1_s": 1.31,
            "w2_ks": 0.21,
            "w2_ks_at_rad_s": 38.6,
            "w2_ks_at_100_rad_s": 0.1,
        },
        "latency_comparison": {"synchronous_worse_from_s": 0.12},
        "delay": {
            "synchronous": {
                **_delay(0.6, 0.4301),
                "redesigned": [
                    {
                        "latency_s": 0.2,
                        "on": "both",
                        "plant_order": 6,
                        "order": 8,
                        "failed": None,
                        "margin_s": None,
                        "least_damping": 0.2267,
                        "least_damping_pade": 0.2266,
                        "least_damping_without": 0.0631,
                        "least_damping_undelayed": 0.1632,
                        "least_damping_remote_lost": 0.1311,
                        "effort": 0.441,
                    },
                    {
                        "latency_s": 0.2,
                        "on": "both",
                        "plant_order": 6,
                        "order": 4,
                        "failed": "the closed loop is not stable",
                        "least_damping_without": 0.0631,
                    },
                ],
            },
            "non_synchronous": _delay(0.2, None),
        },
        "delay_table": [
            {
                "latency_s": d,
                "synchronous": _cell(0.2 - 0.6 * d, stable=d < 0.4),
                "non_synchronous": _cell(0.2 - 0.2 * d, stable=True),
            }
            for d in (0.05, 0.1, 0.2, 0.5)
        ],
        "packets": {
            "interval_s": 0.02,
            "latency_s": 0.1,
            "loss_rates": [0.1, 0.7],
            "bursts": {"loss_bad": 1.0},
            "jitter": {"least_s": 0.05, "loss_rate": 0.1, "on_loss": "hold"},
            "mean_latency_s": 0.1,
            "mean_square": [
                {
                    "controller": "ftc",
                    "on_loss": "hold",
                    "decay_rate": {"0.1": 0.0995, "0.7": -0.2471},
                    "bursts": 0.0994,
                    "mean_loss_in_bursts": 1.0 / 6.0,
                    "critical_loss": 0.427,
                }
            ],
            "monte_carlo": [
                {
                    "controller": name,
                    "runs": 12,
                    "stable": 11,
                    "settling_time_s": [5.2, median, 7.9],
                    "inter_area": None,
                }
                for name, median in (("ftc", 6.3), ("cc", 6.4))
            ],
        },
        "survival": {
            "clearing_cycles": 8.0,
            "lost_at_s": 1.0,
            "watch_s": 9.0,
            "cycles": {"from": 1.0, "to": 30.0, "tolerance": 0.15},
            "stabilizers": [
                {
                    "name": "local_stabilizer",
                    "machine": "G4",
                    "K": 40.0,
                    "T1": 0.2,
                    "T2": 0.03,
                    "stages": 1,
                    "limit_pu": 0.15,
                }
            ],
            "rows": [
                {
                    "point": point,
                    "ceiling": "none",
                    "controller": name,
                    "signals": signals,
                    "stable": True,
                    "least_damping": 0.2,
                    "verdict": "settled" if signals != "remote lost" else "synchronism lost",
                    "synchronism": signals != "remote lost",
                    "largest_angle_rad": 1.3 if signals != "remote lost" else None,
                    "critical_cycles": 12.3 if signals != "remote lost" else 0.0,
                }
                for point in ("base", "circuit out", "tie +100 MW", "tie -200 MW", "tie reversed")
                for name in ("none", "wdc", "cc", "ftc", "robust", "active", "local_stabilizer")
                for signals in (
                    ("nothing lost",)
                    if name in ("none", "local_stabilizer")
                    else ("nothing lost", "remote lost", "local lost")
                )
            ],
        },
        "pade": {
            "order": 2,
            "synchronous": {"margin_s": 0.44, "margin_exact_s": 0.43, "largest_error": 0.014},
            "non_synchronous": {"margin_s": None, "margin_exact_s": None, "largest_error": 0.004},
        },
        "second_solver": {
            "tolerance": 1e-3,
            "time_limit_s": 120.0,
            "rows": [
                {
                    "controller": "wdc",
                    "problem": 1,
                    "unknowns": 145,
                    "objective": [1.0562, value],
                    "difference": difference,
                    "violation": [-1e-9, difference],
                    "seconds": [0.3, 4.0],
                    "status": status,
                }
                for value, difference, status in ((1.0563, 5e-5, "optimal"), (None, None, "no answer: limit"))
            ],
        },
        "methods": {
            "orders": {
                "wdc": [
                    {
                        "order": 4,
                        "failed": None,
                        "norm": 1.469,
                        "effort": 0.502,
                        "inter_area": 0.337,
                        "least_damping": 0.249,
                    },
                    {"order": 3, "failed": "the closed loop is not stable"},
                ]
            },
            "inter_area_roots": {"wdc": {"normal": [[0.572, 0.337], [0.759, 0.304]], "remote_lost": []}},
            "printed_ftc": {
                "theta_rad": [1.49, 0.26],
                "damping_ratio_asked": [0.08, 0.97],
                "lmi_problems": 88,
                "rows": [
                    {
                        "method": "printed",
                        "order": 8,
                        "fastest_pole": 3.3e6,
                        "design_plant_effort": 4.3e5,
                        **{
                            f"{plant}_{pattern}": {"rightmost": 23.1, "damping_ratio": 1.0, "stable": False}
                            for plant in ("design_plant", "full_plant")
                            for pattern in ("normal", "remote_lost")
                        },
                    }
                ],
            },
        },
        "scenarios": {
            "none-pulse": _scenario(0.081, 13.1),
            "wdc-pulse": _scenario(0.296, 4.2),
            "cc-pulse": _scenario(0.31, 4.1),
            "ftc-pulse": _scenario(0.344, 3.9),
            "cc-lost-1s": _scenario(0.223, 5.9),
            "ftc-lost-1s": _scenario(0.343, 3.8),
            "wdc-synchronous-100ms": _scenario(0.24, 5.0),
            "wdc-non-synchronous-100ms": _scenario(0.28, 4.4),
            "wdc-synchronous-200ms": _scenario(0.06, 7.0),
            "wdc-synchronous-300ms": _scenario(0.04, 14.0),
            "wdc-non-synchronous-300ms": _scenario(0.25, 3.0),
            "none-fault": _scenario(0.083, 14.0),
            "wdc-fault": _scenario(0.3, 3.7),
            "cc-fault": _scenario(0.4, 4.0),
            "ftc-fault": _scenario(0.5, 3.7),
            "cc-fault-lost": _scenario(0.3, 4.6),
            "ftc-fault-lost": _scenario(0.4, 4.5),
            "wdc-margin-below": _scenario(0.004, None),
            "wdc-margin-above": _scenario(-0.004, None),
        },
        "figures": {},
        "figure_list": [
            {
                "key": "5.10",
                "section": "wdc",
                "title": "without and with the controller",
                "data": ["results/wdc-pulse.parquet"],
            },
            {
                "key": "5.15",
                "section": "delay_runs",
                "title": "at 100 ms",
                "data": ["results/wdc-synchronous-100ms.parquet"],
            },
            {"key": "delay", "section": "delay", "title": "Damping against latency", "data": ["study.json"]},
        ],
        "provenance": {
            "command": "interarea study thesis --out out",
            "case_hash": "0123456789abcdef",
            "case_source": "Kundur1994",
            "published": "Sundaria2016",
            "fmus": {"plant.fmu": "00ff"},
            "versions": {"interarea": "0.1.0", "numpy": "2.0"},
        },
    }
    return study | {"printed": printed_rows(CLAIMS, study)}


def _mode(frequency_hz: float, damping_ratio: float) -> dict[str, Any]:
    w = 2.0 * math.pi * frequency_hz
    real = -w * damping_ratio / math.sqrt(1.0 - damping_ratio**2)
    return {"frequency_hz": frequency_hz, "damping_ratio": damping_ratio, "eigenvalue": [real, w]}


def _controller(full: int, order: int, normal: float, lost: float, effort: float) -> dict[str, Any]:
    return {
        "order": order,
        "order_full": full,
        "damping_ratio": {
            "normal": dict(zip(NAMES, (normal, 0.247, 0.23), strict=True)),
            "remote_lost": dict(zip(NAMES, (lost, 0.247, 0.22), strict=True)),
        },
        "stable": {"normal": True, "remote_lost": lost > 0},
        "slowest_pole": -0.05,
        "fastest_pole": 1000.0,
        "controller_fastest_pole": 45.0,
        "method": "made up",
        "region": {"normal": "damping ratio >= 0.3"},
        "effort": effort,
        "remote_utilisation": 0.4,
        "reduction_price": {"norm": [1.0, 1.4], "effort": [0.25, effort]},
        "conditions": [
            {
                "condition": c,
                "stable": True,
                "damping_ratio": dict(zip(NAMES, (normal, 0.247, 0.23), strict=True)),
                "rightmost": [-0.05, 0.0],
            }
            for c in CONDITIONS
        ],
    }


def _delay(slope: float, margin_s: float | None) -> dict[str, Any]:
    rows = [[k / 50.0, 0.23 - slope * k / 50.0] for k in range(26)]
    inter = [[d, z + 0.05] for d, z in rows]
    return {
        "margin_s": margin_s,
        "margin_searched_s": 10.0,
        "damping": rows,
        "inter_area": inter,
        "modes": {"inter-area": inter, "local area 2": rows},
    }


def _cell(zeta: float, *, stable: bool) -> dict[str, Any]:
    return {
        "least": zeta,
        "inter_area": zeta + 0.05,
        "measured": zeta + 0.051,
        "settling_time_s": 5.0 if stable else None,
    }


def _scenario(zeta: float, settling_time_s: float | None) -> dict[str, Any]:
    return {
        "title": "a run",
        "stable": zeta > 0,
        "damping_ratio": zeta,
        "ring_down": zeta + 0.001,
        "settling_time_s": settling_time_s,
        "peak_dw24": 8.1e-4,
        "energy": 3.2e-7,
        "effort": 1e-5 / (0.1 + abs(zeta)),
    }
