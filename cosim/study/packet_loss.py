"""What random packet loss and random latency leave of a study's controllers.

Loss by the second moment of the sampled loop, which is exact for the linear plant (`design.loss`); random
latency together with loss by Monte Carlo on the co-simulated nonlinear plant.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import control
import numpy as np

from interarea.design.controllers.controller import Controller
from interarea.design.delay.packet_loss import LossyChannel, OnLoss, PacketLoop, critical_loss
from interarea.design.synthesis.study_designs import StudySpec
from interarea.fmu_build.write.cache import cached_json, code_hash, content_hash
from interarea.models.case.case import load_case
from interarea.models.threads import one_thread

from ..run.artefacts import plant_fmu, plant_for_controllers
from ..run.controllers import controller_fmu, design_controller
from .runs import Document, document_of, run_all

RULES: tuple[OnLoss, ...] = ("zero", "hold")


def mean_square_record(
    case_name: str,
    names: Sequence[str],
    packets: Mapping[str, Any],
    specs: Mapping[str, StudySpec],
    cache: Path,
) -> list[dict[str, Any]]:
    """Return `mean_square_rows` of the named controllers, from `cache` if they are there.

    specs : of controllers that are not as the study has them. All else is found in `cache`, so that a
    process of its own can make it.
    """
    case = load_case(case_name)
    controllers = {name: design_controller(case, name, cache, specs=specs) for name in names}
    key = content_hash(
        plant_fmu(case, cache).name,
        *(controller_fmu(c, case.omega_b, cache).name for c in controllers.values()),
        dict(packets),
        code_hash(__name__),
    )

    def make() -> list[dict[str, Any]]:
        plant = plant_for_controllers(case, cache)
        return mean_square_rows(plant, controllers, packets)

    with one_thread():
        return list(cached_json(cache, "packets", key, make))


def mean_square_rows(
    plant: control.StateSpace, controllers: Mapping[str, Controller], packets: Mapping[str, Any]
) -> list[dict[str, Any]]:
    """Return one row per controller and rule on loss; both signals travel in packets and lose them equally.

    plant : full plant without reference angle, speeds in rad/s. packets : the study's table of that name.

    Each row: `decay_rate` (1/s, of the root mean square) for each of `loss_rates`, `bursts` the same for the
    Gilbert-Elliott channel of the study, `critical_loss` the least share that is not stable (1: none found).
    """
    interval, latency = packets["interval_s"], packets["latency_s"]
    rows = []
    for name, controller in controllers.items():
        K = controller.system
        for rule in RULES:

            def of(rule: OnLoss = rule, K: control.StateSpace = K, **loss: float) -> float:
                channels = {s: LossyChannel(latency, rule, **loss) for s in K.input_labels}
                return PacketLoop(plant, K, interval, channels).mean_square().decay_rate

            plain = {s: LossyChannel(latency, rule) for s in K.input_labels}
            burst = {s: LossyChannel(latency, rule, **packets["bursts"]) for s in K.input_labels[:1]}
            rows.append(
                {
                    "controller": name,
                    "on_loss": rule,
                    "decay_rate": {f"{rate:g}": of(loss_good=rate) for rate in packets["loss_rates"]},
                    "bursts": PacketLoop(plant, K, interval, plain | burst).mean_square().decay_rate,
                    "mean_loss_in_bursts": next(iter(burst.values())).mean_loss,
                    "critical_loss": critical_loss(plant, K, interval, plain),
                }
            )
    return rows


def monte_carlo_documents(
    spec: Mapping[str, Any], controllers: Mapping[str, Controller]
) -> dict[str, Document]:
    """Return the scenarios of the Monte Carlo runs, `seeds` of each controller, by name."""
    packets = spec["packets"]
    jitter = packets["jitter"]
    path = {
        "reporting_interval_s": packets["interval_s"],
        "latency_s": jitter["least_s"],
        "latency": {"kind": "gamma", "shape": jitter["shape"], "scale_s": jitter["scale_s"]},
        "loss": {"kind": "bernoulli", "rate": jitter["loss_rate"]},
        "on_loss": jitter["on_loss"],
    }
    return {
        f"{name}-jitter-{seed}": document_of(
            spec,
            f"{name.upper()}, random latency and loss, seed {seed}",
            name,
            jitter["disturbance"],
            path | {"seed": 2 * seed},
            path | {"seed": 2 * seed + 1},
        )
        for name in controllers
        for seed in range(1, jitter["seeds"] + 1)
    }


def monte_carlo_rows(
    spec: Mapping[str, Any],
    controllers: Mapping[str, Controller],
    cache: Path,
    progress: Callable[[float], None],
) -> list[dict[str, Any]]:
    """Run the Monte Carlo and return one row per controller: how many stable, settling and damping quantiles.

    Quantiles are the least, the median and the largest; None where no run settled or showed the mode, whose
    damping is that of the ring-down: the linear root is the same in all runs.
    """
    runs = run_all(monte_carlo_documents(spec, controllers), controllers, cache, progress)
    rows = []
    for name in controllers:
        own = [run for key, run in runs.items() if key.startswith(f"{name}-jitter-")]
        rows.append(
            {
                "controller": name,
                "runs": len(own),
                "stable": sum(bool(r.metrics["stable"]) for r in own),
                "settling_time_s": _spread([r.metrics["settling_time_s"] for r in own]),
                "inter_area": _spread([r.metrics["ring_down"].get("inter-area") for r in own]),
            }
        )
    return rows


def mean_latency_s(jitter: Mapping[str, Any]) -> float:
    """Return the mean of the random latency, s."""
    return float(jitter["least_s"] + jitter["shape"] * jitter["scale_s"])


def _spread(values: list[float | None]) -> list[float] | None:
    known = [v for v in values if v is not None]
    return [float(q) for q in np.quantile(known, [0.0, 0.5, 1.0])] if known else None
