"""What a detector of wrong signals makes of right ones (docs/wrong_signals.md): disturbances, ambient noise.

python benchmarks/control/wrong_signals.py --design FILE [--most RUNS | --drawn RUNS] [CONTROLLER ...]
python benchmarks/control/wrong_signals.py --design FILE --ambient-hours 24 [CONTROLLER]

FILE: of `design_detector`, made for the first controller where it is not there yet; for ambient noise one for
the four machines of two areas.
Disturbances: packets every 20 ms, remote signals 100 ms late, witnesses 50 ms; none must alarm. Faults at
buses without machines, pulses and steps of machines, steps of the largest loads, trips of the controller's
design; on a grid with a tie at three flows of it, else at three loads. None of these points is in a design.
--drawn: so many random ones instead, at POINTS random points: faults of 2 to 9 cycles with or without a trip,
steps, pulses, trips, in a third of the runs a second event 1 to 4 s later, at any of 20 phases of a sample.
They begin after 6 s, when the detector has all the frames that it compares.
Ambient noise: the linear loop, driven by independent random torques at each machine that give 3 mHz rms
between G2 and G4, and 1 mHz of each PMU, in many records side by side; every test that compares signals.
What wrong signals do: `interarea certify NAME --wrong-signals`.
"""

import argparse
import itertools
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import control
import numpy as np
from scipy.linalg import expm, solve_continuous_lyapunov

import interarea as ia
from interarea.cosim.designs.fault_runs import FaultRuns
from interarea.cosim.run.artefacts import plant_for_controllers
from interarea.cosim.screen.detector_design import MOST_BUSES, design_detector
from interarea.cosim.screen.wrong_runs import STOP_S, WrongRun, signals_of
from interarea.design.controllers.detector_record import (
    FRAMES,
    HELD,
    lasting,
    load_detector,
    scores_and_suspects,
    shares,
    swings,
)
from interarea.fmu_build.write.cache import default_cache
from interarea.models import detector_defaults as default
from interarea.models.case.case import Case
from interarea.models.case.variants import operating_variant
from interarea.models.detector_defaults import INTERVAL_S
from interarea.synthesis import judged_and_design

CASE = "two-area-thesis"
LATENCY_S = {"G2_dw": 0.1, "G4_dw": 0.0, "G1_dw": 0.05, "G3_dw": 0.05}
RATED_HZ = 60.0
SWING_HZ, PMU_HZ = 3e-3, 1e-3  # rms between G2 and G4; of each frame
RECORDS, PART = 400, 5000  # side by side; stamps kept at once
POINTS, BESIDE = 10, 100  # random operating points; runs kept at once
DRAWN_S = 6.0  # when a random disturbance begins: the detector's memory, 5.1 s, is full, as it is in service
TESTS = ("pattern", "lasting", "apart", "alone", "rough", "standing", "growing")


def points(case: Case) -> Iterator[tuple[str, Case]]:
    """Yield operating points that no detector is designed at."""
    if case.tie is None:
        for scale in (0.98, 1.0, 1.02):
            yield f"load {scale:g}", operating_variant(case, load_scale=scale)
    else:
        for tie_mw in (-100.0, 0.0, 100.0):
            yield f"tie {tie_mw:+g} MW", operating_variant(case, tie_flow_mw=tie_mw)


def drawn_points(case: Case, random: np.random.Generator) -> Iterator[tuple[str, Case]]:
    """Yield random operating points: flows of the tie within 120 MW of its own, or loads within 3 %."""
    for _ in range(POINTS):
        share = random.uniform(-1.0, 1.0)
        if case.tie is None:
            yield f"load {1.0 + 0.03 * share:.4f}", operating_variant(case, load_scale=1.0 + 0.03 * share)
        else:
            yield f"tie {120.0 * share:+.1f} MW", operating_variant(case, tie_flow_mw=120.0 * share)


def drawn(case: Case, trips: Sequence[str], random: np.random.Generator) -> list[dict[str, Any]]:
    """Return one random disturbance: an event and what follows from it or comes later."""
    events = one_drawn(case, trips, round(DRAWN_S + random.uniform(0.0, INTERVAL_S), 3), random)
    if random.uniform() < 1.0 / 3.0:
        later = round(events[0]["start_s"] + random.uniform(1.0, 4.0), 3)
        events += [
            e for e in one_drawn(case, trips, later, random) if e.get("branch") not in branches(events)
        ]
    return events


def branches(events: Sequence[Mapping[str, Any]]) -> set[Any]:
    """Return the branches that events trip, and None."""
    return {event.get("branch") for event in events if event["kind"] == "branch_trip"} - {None}


def one_drawn(
    case: Case, trips: Sequence[str], start_s: float, random: np.random.Generator
) -> list[dict[str, Any]]:
    """Return a fault, a fault and a trip of a branch that ends there, a trip, a pulse or a step."""
    bare = [b.number for b in case.buses if b.number not in {m.bus for m in case.machines}]
    kinds = [
        "bus_fault",
        "pm_step",
        "load_step",
        "pulse",
        *(["fault_and_trip", "branch_trip"] if trips else []),
    ]
    kind = str(random.choice(kinds))
    cleared_s = round(start_s + random.uniform(2.0, 9.0) / case.frequency_hz, 3)
    machine = case.machines[random.integers(len(case.machines))]
    if kind in ("bus_fault", "fault_and_trip", "branch_trip"):
        branch = str(random.choice(trips)) if trips else ""
        bus = int(random.choice(bare)) if kind == "bus_fault" else case.branch(branch).from_bus
        fault = {"kind": "bus_fault", "bus": bus, "start_s": start_s, "end_s": cleared_s}
        trip_s = start_s if kind == "branch_trip" else cleared_s
        trip = {"kind": "branch_trip", "branch": branch, "start_s": trip_s}
        return {"bus_fault": [fault], "branch_trip": [trip], "fault_and_trip": [fault, trip]}[kind]
    if kind == "load_step":
        load = case.loads[random.integers(len(case.loads))]
        p, q = (float(random.uniform(-most, most)) for most in (1.0, 0.2))
        return [{"kind": "load_step", "bus": load.bus, "p_pu": p, "q_pu": q, "start_s": start_s}]
    size = float(random.choice((-1.0, 1.0)) * random.uniform(0.01, 0.1))
    step = {"machine": machine.name, "size_pu": size, "start_s": start_s}
    if kind == "pm_step":
        return [{"kind": "pm_step", **step}]
    pulse = "vref_pulse" if machine.exciter.kind != "constant" and random.uniform() < 0.5 else "pm_pulse"
    return [{"kind": pulse, **step, "end_s": round(start_s + random.uniform(0.1, 0.5), 3)}]


def spread(items: Sequence[Any], most: int) -> Sequence[Any]:
    """Return at most so many, from the middle of equal parts."""
    step = max(1, -(-len(items) // most))
    return items[step // 2 :: step]


def disturbances(case: Case, signals: Sequence[str], trips: Sequence[str]) -> Iterator[dict[str, Any]]:
    """Yield disturbances of a grid; signals : speeds that are compared."""
    bare = [b.number for b in case.buses if b.number not in {m.bus for m in case.machines}]
    for bus, cycles in itertools.product(spread(bare, MOST_BUSES), (4, 6, 8)):
        end_s = 1.0 + cycles / case.frequency_hz
        yield {"kind": "bus_fault", "bus": bus, "start_s": 1.0, "end_s": round(end_s, 9)}
    compared = [m for m in case.machines if f"{m.name}_dw" in signals]
    for m in (*compared, *spread([m for m in case.machines if m not in compared], 8)):
        pulses = ["pm_pulse"] if m.exciter.kind == "constant" else ["vref_pulse", "pm_pulse"]
        for kind in pulses:
            yield {"kind": kind, "machine": m.name, "size_pu": 0.05, "start_s": 1.0, "end_s": 1.3}
        for size in (-0.05, 0.05):
            yield {"kind": "pm_step", "machine": m.name, "size_pu": size, "start_s": 1.0}
    largest = sorted({load.bus: load.P_mw for load in case.loads}.items(), key=lambda item: -item[1])[:4]
    for (bus, _), size in itertools.product(largest, (-0.5, 0.5)):
        yield {"kind": "load_step", "bus": bus, "p_pu": size, "q_pu": 0.1, "start_s": 1.0}
    for branch in trips:
        yield {"kind": "branch_trip", "branch": branch, "start_s": 1.0}


def chosen_runs(
    case: Case, signals: Sequence[str], trips: Sequence[str], most: int
) -> Iterator[tuple[str, Case, list[list[dict[str, Any]]]]]:
    """Yield points with the disturbances there, `most` of all; signals : speeds that are compared."""
    events = list(disturbances(case, signals, trips))
    for k, (point, there) in enumerate(points(case)):
        chosen = events[k::3] if 3 * len(events) > most else events  # no disturbance twice, then
        yield point, there, [[event] for event in spread(chosen, -(-most // 3))]


def drawn_runs(
    case: Case, trips: Sequence[str], count: int, seed: int
) -> Iterator[tuple[str, Case, list[list[dict[str, Any]]]]]:
    """Yield points with random disturbances there, `count` of all."""
    random = np.random.default_rng(seed)
    for point, there in drawn_points(case, random):
        for part in range(0, count // POINTS, BESIDE):
            size = min(BESIDE, count // POINTS - part)
            yield point, there, [drawn(there, trips, random) for _ in range(size)]


def genuine(controllers: list[str], design: Path, most: int, count: int, seed: int) -> None:
    """Print how many disturbances with right signals made the detector isolate one.

    count : random ones with that seed; 0: at most `most` of the listed ones.
    """
    compared = load_detector(design).signals
    print("| controller | runs | that keep synchronism | of these with an isolation |")
    print("|---|---|---|---|")
    for name in controllers:
        controller, table = judged_and_design(name, None, None)
        places = () if table.acceptance is None else table.acceptance.fault
        trips = list(dict.fromkeys(place.trip for place in places if place.trip is not None))
        latency_s_of = signals_of(table.grid, controller, compared).all
        every = (
            drawn_runs(table.grid, trips, count, seed)
            if count
            else chosen_runs(table.grid, compared, trips, most)
        )
        number, survived, alarms = 0, 0, []
        stop_s = STOP_S + (DRAWN_S if count else 0.0)
        for point, case, disturbed in every:
            detector = {"file": str(design.absolute())}
            runs = [
                WrongRun(table.grid.name, controller, latency_s_of, events, detector=detector, stop_s=stop_s)
                for events in disturbed
            ]
            with FaultRuns(case, default_cache()) as there:
                for run, (outcome, data) in zip(runs, there.judged(runs, [None] * len(runs)), strict=True):
                    number += 1
                    survived += outcome.synchronous  # else a machine slips: its signal is not as the others
                    result = {s: int(data[f"detector.{s}_reason"].max()) for s in latency_s_of}
                    if outcome.synchronous and any(result.values()):
                        verdict = "" if outcome.verdict is None else outcome.verdict.name
                        alarms.append(f"{list(run.events)} at {point}: {result}, {verdict}")
        print(f"| `{name}` | {number} | {survived} | {len(alarms)} |", flush=True)
        for line in alarms:
            print(f"  {line}", flush=True)


def ambient_loop(controller: str) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return state matrix of a frame, square root of the noise of a frame, and the outputs in pu.

    No latency: it moves the damping of the loop by little, and what is compared is aligned by stamps.
    """
    case = ia.load_case(CASE)
    plant = plant_for_controllers(case, default_cache())
    loaded = ia.load_controller(controller)
    K = loaded.system if isinstance(loaded, ia.Controller) else loaded.acting(()).system
    chosen = plant[list(K.input_labels), list(K.output_labels)]
    loop = control.feedback(chosen, K, sign=1)
    n = plant.nstates
    A = np.asarray(loop.A)
    C = np.zeros((len(LATENCY_S), len(A)))
    rows = [list(plant.output_labels).index(s) for s in LATENCY_S]
    C[:, :n] = np.asarray(plant.C)[rows] / case.omega_b
    # a torque moves a speed: its direction among the states is that of the speed's row
    torque = (C / np.linalg.norm(C, axis=1)[:, None]).T
    inertia = {f"{m.name}_dw": m.H * m.base_mva for m in case.machines}
    torque /= np.array([inertia[s] for s in LATENCY_S]) / max(inertia.values())
    step = expm(A * INTERVAL_S)
    P = solve_continuous_lyapunov(A, -torque @ torque.T)
    covariance = P - step @ P @ step.T  # of the noise that a frame adds
    between = C[0] - C[1]
    scale = SWING_HZ / RATED_HZ / np.sqrt(between @ P @ between)
    values, vectors = np.linalg.eigh(0.5 * (covariance + covariance.T))
    return step, scale * vectors * np.sqrt(np.maximum(values, 0.0)), C


def ambient(controller: str, design: Path, hours: float) -> None:
    """Print the largest of what each test compares, over its limit, and what the tail says of a month."""
    detector = load_detector(design)
    patterns = detector.patterns.of([detector.signals.index(s) for s in LATENCY_S])
    step, noise, C = ambient_loop(controller)
    random = np.random.default_rng(1)
    x = np.zeros((len(step), RECORDS))
    stamps = int(hours * 3600.0 / INTERVAL_S / RECORDS)
    before = int(60.0 / INTERVAL_S)  # from rest to stationary
    most: dict[str, list[float]] = {k: [] for k in TESTS}
    done, swing = -before, []
    while done < stamps:
        length = before if done < 0 else min(PART, stamps - done)
        y = np.empty((length, len(C), RECORDS))
        for k in range(length):
            x = step @ x + noise @ random.standard_normal(x.shape)
            y[k] = C @ x
        done += length
        if done <= 0:
            continue
        swing.append(float(np.std(y[:, 0] - y[:, 1])))
        y += PMU_HZ / RATED_HZ * random.standard_normal(y.shape)
        for record in np.moveaxis(y, 2, 0):
            for name, value in compared(record.T, patterns).items():
                most[name].append(value)
    print(f"{controller}, {hours:g} h, {RATED_HZ * np.mean(swing) * 1e3:.2f} mHz rms between G2 and G4")
    print("| test | largest over its limit | blocks | times in 30 days by the tail |")
    print("|---|---|---|---|")
    for name, values in most.items():
        # largest of blocks: Gumbel's law, by its moments
        beta = np.std(values) * np.sqrt(6.0) / np.pi
        mode = np.mean(values) - 0.5772 * beta
        rate = -np.expm1(-np.exp(-(1.0 - mode) / beta)) * len(values) * 720.0 / hours
        print(f"| {name} | {max(values):.3f} | {len(values)} | {rate:.1e} |")


def compared(y: np.ndarray, patterns: Any) -> dict[str, float]:
    """Return the largest of what each test compares over its limit, of signals (signals, stamps)."""
    span = int(default.AVERAGE_S / INTERVAL_S)
    windows = np.lib.stride_tricks.sliding_window_view(y[:, :: FRAMES // 2], span * 2 // FRAMES, axis=1)
    mean, spans = windows.mean(axis=2), np.ptp(windows, axis=2)
    bends = np.abs(np.diff(y, n=2, axis=1))[:, : y.shape[1] // 50 * 50 - 50].reshape(len(y), -1, 50)
    bent, of_half = bends.mean(axis=2), np.median(bends, axis=2)
    score, suspect = scores_and_suspects(y, patterns)
    result = {
        "pattern": float(score.max()) / patterns.threshold,
        "lasting": float(lasting(score, suspect).max()) / patterns.lasting,
        "alone": float(shares(y, patterns.floor).max()) / patterns.alone,
    }
    whole = -(-(HELD - span) * 2 // FRAMES)  # spans before the first with all stamps of its trend
    level = np.sort(swings(y, FRAMES // 2)[:, whole:], axis=0)[-2]
    long = int(default.STANDING_S / INTERVAL_S) * 2 // FRAMES
    if len(level) >= long:  # the last part of a record may be shorter than what it stands for
        lasts = np.lib.stride_tricks.sliding_window_view(level, long)
        result["standing"] = float(lasts.min(axis=1).max()) / default.STANDING_PU
    back = span * 2 // FRAMES
    grows = np.minimum(level[: -2 * back], np.minimum(level[back:-back] / 2.0, level[2 * back :] / 4.0))
    result["growing"] = float(grows.max()) / default.STANDING_PU
    each: dict[str, list[float]] = {"apart": [], "rough": []}
    for i in range(len(y)):
        others = [j for j in range(len(y)) if j != i]
        most = spans[others].max(axis=0)
        away = np.abs(mean[i] - np.median(mean[others], axis=0))
        each["apart"].append(float((away / (default.APART_PU + default.APART_SHARE * most)).max()))
        each["rough"].append(float((of_half[i] / (default.ROUGH_PU + 2.0 * bent[others].max(axis=0))).max()))
    return result | {name: max(values) for name, values in each.items()}


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("controllers", nargs="*", default=["robust"])
    parser.add_argument("--design", type=Path, required=True, help="file of the detector's patterns")
    parser.add_argument("--ambient-hours", type=float, default=0.0, help="ambient noise in place of them")
    parser.add_argument("--most", type=int, default=1000, help="disturbances, evenly chosen (default 1000)")
    parser.add_argument("--drawn", type=int, default=0, help="so many random disturbances instead")
    parser.add_argument("--seed", type=int, default=1, help="of the random disturbances (default 1)")
    options = parser.parse_args()
    if options.drawn % POINTS:
        parser.error(
            f"--drawn {options.drawn}: must be a multiple of {POINTS}, as many at each operating point"
        )
    if not options.design.exists():
        first, of_first = judged_and_design(options.controllers[0], None, None)
        signals = list(signals_of(of_first.grid, first).all)
        design_detector(of_first.grid, options.controllers[0], signals).save(options.design)
    if options.ambient_hours:
        ambient(options.controllers[0], options.design, options.ambient_hours)
    else:
        genuine(options.controllers, options.design, options.most, options.drawn, options.seed)
