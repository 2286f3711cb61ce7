"""The supervisor's FMU against an independent integration of the bank it states, flag by flag."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import control
import numpy as np
import pytest
from fmu_runner import Runner
from scipy.integrate import solve_ivp

from interarea.cosim.run.controller_fmu import controller_from_fmu
from interarea.cosim.run.run import run_scenario
from interarea.cosim.scenario.scenario import load_scenario
from interarea.design.controllers.bank import OFF, ControllerBank, load_controller
from interarea.design.controllers.controller import Controller, ControllerError
from interarea.fmu_build.write.package import build_fmu
from interarea.models.blocks.channel import channel_block
from interarea.models.blocks.controller import Guard

OMEGA_B = 2.0 * np.pi * 60.0
SIGNALS = ("G2_dw", "G4_dw")


def member(name: str, signals: tuple[str, ...], seed: int, order: int = 2) -> Controller:
    rng = np.random.default_rng(seed)
    A = rng.normal(size=(order, order)) - 3.0 * np.eye(order)
    B, C = rng.normal(size=(order, len(signals))), 0.01 * rng.normal(size=(1, order))
    D = 0.01 * rng.normal(size=(1, len(signals)))
    return Controller(name, control.ss(A, B, C, D, inputs=list(signals), outputs=["G4_vs"]))


def bank(**changes: object) -> ControllerBank:
    members = (member("both", SIGNALS, 1), member("local", ("G4_dw",), 2, order=3))
    return ControllerBank("bank", members, **{"fade_s": 0.1, **changes})  # type: ignore[arg-type]


@pytest.fixture(scope="module")
def fmu(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("supervisor")
    return build_fmu(bank(return_s=0.3).block(OMEGA_B), folder / "bank.fmu")


U = (0.002, -0.001)  # pu


def run(path: Path, flags: dict[float, tuple[bool, bool]], stop_s: float, **start: float) -> np.ndarray:
    """Step the FMU, signals constant, flags from their times on; rows of t, G4_vs, active, switches."""
    rows = []
    with Runner(path) as it:
        it.start(dict(zip(SIGNALS, U, strict=True)) | start)
        for k in range(round(stop_s / 0.01)):
            if k in {round(when / 0.01) for when in flags}:
                values = flags[min(flags, key=lambda when: abs(when - k * 0.01))]
                it.set(G2_dw_valid=values[0], G4_dw_valid=values[1])
            it.step(k * 0.01, 0.01)
            rows.append((k * 0.01 + 0.01, it.get("G4_vs"), it.get("active"), it.get("switches")))
    return np.array(rows)


def reference(changes: list[tuple[float, str, tuple[float, float]]], times: np.ndarray) -> np.ndarray:
    """The bank's output integrated by scipy; `changes`: from time on, active member, trusted signals."""
    K = bank().matrices()
    names, orders = list(K), [len(M[0]) for M in K.values()]
    y = np.array(U) * OMEGA_B
    n = sum(orders)
    x = np.concatenate([np.zeros(n), [1.0, 0.0, 0.0][: len(names)], [1.0, 1.0]])

    def slope(t: float, x: np.ndarray, active: str, trusted: tuple[float, float]) -> np.ndarray:
        w, m = x[n : n + len(names)], x[n + len(names) :]
        dx, first = [], 0
        for (A, B, _, _), order in zip(K.values(), orders, strict=True):
            dx.append(A @ x[first : first + order] + B @ (m * y))
            first += order
        target = np.array([1.0 if name == active else 0.0 for name in names])
        return np.concatenate([*dx, (target - w) / 0.1, (np.array(trusted) - m) / 0.1])

    def output(x: np.ndarray) -> float:
        w, m = x[n : n + len(names)], x[n + len(names) :]
        u, first = 0.0, 0
        for weight, (_, _, C, D), order in zip(w, K.values(), orders, strict=True):
            u += weight * float((C @ x[first : first + order] + D @ (m * y))[0])
            first += order
        return float(np.clip(u, -0.15, 0.15))

    values = []
    for (start, active, trusted), end in zip(
        changes, [*(c[0] for c in changes[1:]), times[-1] + 1.0], strict=True
    ):
        inside = times[(times > start + 1e-9) & (times <= end + 1e-9)]
        grid = np.unique(np.concatenate([inside, [end]]))
        solution = solve_ivp(
            slope, (start, end), x, args=(active, trusted), t_eval=grid, rtol=1e-11, atol=1e-14
        )
        values += [output(solution.y[:, k]) for k in range(len(inside))]
        x = solution.y[:, -1]
    return np.array(values)


def test_bank_as_stated(fmu: Path) -> None:
    """Loss at 0.5 s, believed at once; the flag returns at 1.0 s and is believed 0.3 s later."""
    rows = run(fmu, {0.5: (False, True), 1.0: (True, True)}, 2.0)
    changes = [(0.0, "both", (1.0, 1.0)), (0.5, "local", (0.0, 1.0)), (1.3, "both", (1.0, 1.0))]
    expected = reference(changes, rows[:, 0])
    assert np.abs(rows[:, 1] - expected).max() <= 1e-8 * np.abs(expected).max()
    assert rows[49, 2:].tolist() == [1, 0] and rows[50, 2:].tolist() == [2, 1]
    # the return is an event inside the FMU, at 1.3 s
    assert rows[128, 2] == 2 and rows[131, 2:].tolist() == [1, 2]


def test_no_jump_at_a_switch(fmu: Path) -> None:
    rows = run(fmu, {0.5: (False, True)}, 1.0)
    steps = np.abs(np.diff(rows[:, 1]))
    largest = np.abs(rows[:, 1]).max()
    # one time constant is 0.1 s: in 0.01 s at most a tenth of the difference of two outputs is faded
    assert steps[48:52].max() <= 0.1 * 2.0 * largest


def test_everything_lost_is_off(fmu: Path) -> None:
    rows = run(fmu, {0.2: (False, False)}, 3.0)
    assert rows[-1, 2] == 3
    assert abs(rows[-1, 1]) <= 1e-10 * np.abs(rows[:, 1]).max()


def test_short_loss_is_not_believed(fmu: Path) -> None:
    rows = run(fmu, {0.5: (False, True), 0.52: (True, True)}, 1.0, loss_time=0.05)
    assert rows[:, 3].max() == 0


def test_dwell_time_between_switches(fmu: Path) -> None:
    """The second switch waits until 0.4 s after the first."""
    rows = run(fmu, {0.5: (False, True), 0.6: (True, True)}, 1.5, dwell_time=0.4, return_time=0.0)
    assert rows[88, 2] == 2 and rows[91, 2:].tolist() == [1, 2]


def test_limit_and_refusals(fmu: Path) -> None:
    rows = run(fmu, {}, 1.0, limit=1e-5)
    assert np.abs(rows[:, 1]).max() == 1e-5
    with Runner(fmu) as it, pytest.raises(Exception, match="fmi2SetReal failed"):
        it.start({"fade_time": -1.0})
    assert any("fade_time" in line for line in it.log)


def test_file_and_fmu_hold_the_same_bank(fmu: Path, tmp_path: Path) -> None:
    expected = bank(return_s=0.3)
    for result in (load_controller(expected.save(tmp_path / "bank.json")), controller_from_fmu(fmu, OMEGA_B)):
        assert isinstance(result, ControllerBank)
        assert result.return_s == 0.3 and [m.name for m in result.members] == ["both", "local"]
        for own, theirs in zip(expected.matrices().values(), result.matrices().values(), strict=True):
            for a, b in zip(own, theirs, strict=True):
                np.testing.assert_allclose(b, a, rtol=1e-15)


def test_file_and_fmu_hold_the_same_guard(tmp_path: Path) -> None:
    guard = Guard({"G4_vs": SIGNALS}, {"G4_vs": -0.5}, 0.25, 8.0, 2.0)
    expected = bank(guard=guard)
    fmu = build_fmu(expected.block(OMEGA_B), tmp_path / "bank.fmu")
    for result in (load_controller(expected.save(tmp_path / "bank.json")), controller_from_fmu(fmu, OMEGA_B)):
        assert isinstance(result, ControllerBank) and result.guard is not None
        assert replace(result.guard, threshold=round(result.guard.threshold, 12)) == guard
    with pytest.raises(ControllerError, match="guard watches"):
        bank(guard=Guard({"G4_vs": "G9_dw"}, {"G4_vs": 1.0}, 0.25))


def test_choice_of_member() -> None:
    it = bank()
    assert [it.active(s) for s in it.signal_sets()] == ["both", OFF, "local", OFF]


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"fade_s": -0.1}, "fade_s is -0.1"),
        ({"limit_pu": 0.0}, "limit_pu is 0"),
        ({"name": "a bank"}, "name is 'a bank'"),
        ({"members": (member("both", SIGNALS, 1),) * 2}, "different names"),
        ({"members": (member("off", SIGNALS, 1),)}, "different names"),
    ],
)
def test_bad_bank(change: dict[str, object], message: str) -> None:
    fields = {"name": "bank", "members": bank().members} | change
    with pytest.raises(ControllerError, match=message):
        ControllerBank(**fields)  # type: ignore[arg-type]


def test_an_fmu_without_a_bank_is_one_controller_or_none(tmp_path: Path) -> None:
    one = build_fmu(member("one", SIGNALS, 1).block(OMEGA_B), tmp_path / "one.fmu")
    assert isinstance(controller_from_fmu(one, OMEGA_B), Controller)
    other = build_fmu(channel_block(), tmp_path / "channel.fmu")
    with pytest.raises(ControllerError, match=r"channel.fmu: has no parameter A\[1,1\]: not a linear"):
        controller_from_fmu(other, OMEGA_B)


def test_scenario_with_a_bank(tmp_path: Path, cache: Path) -> None:
    """The channel's flag reaches the supervisor; effort counts what goes to the plant and nothing else."""
    file = bank(return_s=0.3).save(tmp_path / "bank.json")
    scenario = {
        "case": "two-area-thesis",
        "controller": str(file),
        "stop_s": 2.0,
        "step_s": 0.01,
        "channels": {"remote": {"signal": "G2_dw", "outages_s": [[0.5, 1.0]]}, "local": {"signal": "G4_dw"}},
        "event": [{"kind": "vref_pulse", "machine": "G1", "size_pu": 0.02, "start_s": 0.1, "end_s": 0.2}],
    }
    run = run_scenario(load_scenario(scenario), cache=cache)
    curves = run.trajectory
    active = dict(zip(np.round(curves.time_s, 9), curves["controller.active"], strict=True))
    assert (active[0.4], active[0.6], active[1.2], active[1.4]) == (1, 2, 2, 1)
    assert curves.reals_of("controller") == ["controller.G4_vs"]
    assert run.metrics.effort_pu2s == pytest.approx(
        np.trapezoid(curves["controller.G4_vs"] ** 2, curves.time_s)
    )
