"""Acceptance by the non-linear fault: the harm that a guard takes away, and the edge of clearing times."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import control
import numpy as np
import pytest

import interarea as ia
from interarea.cosim.designs.acceptance import (
    Acceptance,
    Setting,
    Trial,
    judge_acceptance,
    settings_of,
    with_ceilings,
    with_loads,
)
from interarea.cosim.designs.certificate_words import bundled_certificate, first_failures, not_covered
from interarea.cosim.designs.design_file import design_of, load_design
from interarea.cosim.designs.design_tables import AcceptanceTable
from interarea.cosim.designs.fault_loops import LONG_S, LONGEST_S, SLOW, FaultLoops, LoopEnd
from interarea.cosim.designs.fault_runs import FaultRun, FaultRuns, Outcome
from interarea.cosim.designs.first_swing import after_clearing
from interarea.cosim.errors import ScenarioError
from interarea.cosim.results.ringdown import Swing
from interarea.cosim.results.verdict import Verdict
from interarea.cosim.run.artefacts import linear_plant
from interarea.cosim.run.controllers import design_controller
from interarea.cosim.run.run import system_of
from interarea.cosim.scenario.scenario import load_scenario
from interarea.design.certificates.closed_loop import closed_loop_matrix
from interarea.design.controllers.bank import ControllerBank
from interarea.design.controllers.bundled import shipped_bank, shipped_controller
from interarea.design.controllers.controller import Controller
from interarea.design.delay.signal_conditions import Condition
from interarea.design.linear.linearise import remove_reference, speeds_in_rad
from interarea.design.robust.operating_points import judge_family
from interarea.models.case.case import load_case
from interarea.models.case.variants import operating_variant

TABLE = AcceptanceTable(fault=({"bus": 8, "trip": "8-9 a"},), ceilings=((-5.0, 5.0),))  # type: ignore[arg-type]
CASES = {"tie +100": operating_variant(load_case("two-area-thesis"), tie_flow_mw=100.0)}


#: the `robust_latency` of version 0.4: its linear loop is unstable while G4_dw is lost
WITHOUT_LOCAL = Path(__file__).parent / "unstable_without_local.json"


def _bare() -> Controller:
    return replace(shipped_controller("robust"), guard=None)


def test_ceilings_reach_every_exciter_that_has_limits() -> None:
    case = with_ceilings(load_case("two-area-thesis"), -5.0, 5.0)
    assert {(m.exciter.Efd_min, m.exciter.Efd_max) for m in case.machines} == {(-5.0, 5.0)}
    untouched = load_case("two-area-thesis").machine("G1").exciter
    assert untouched.Efd_max != 5.0


def test_loads_reach_every_load_and_replace_its_mix() -> None:
    case = load_case("two-area-thesis")
    first = case.loads[0].name
    mixed = case.with_changes({"loads": {first: {"P_zip": [0.2, 0.3, 0.5]}}})
    for grid in (case, mixed):
        changed = with_loads(grid, 1.0, 2.0)
        assert {(load.P_exponent, load.Q_exponent) for load in changed.loads} == {(1.0, 2.0)}
        assert all(load.P_zip is None for load in changed.loads)
    long = case.with_changes({}, name="n" * 64)
    assert with_loads(long, 1.0, 2.0).hash != long.hash  # there is no room for more in its name
    table = AcceptanceTable(fault=({"bus": 8},), loads=((1.0, 2.0),))  # type: ignore[arg-type]
    ((alone, settings),) = settings_of(table, "base", None, ["G2_dw"], (1.0, 2.0))
    assert {setting.loads for setting in (alone, *settings)} == {(1.0, 2.0)}
    assert str(settings[0]) == "base, loads P ~ V^1, Q ~ V^2, fault at bus 8, 100 ms"


@pytest.mark.slow
@pytest.mark.parametrize("ports", [(["G4_dw"], ["G4_vs"]), (["G4_dw", "tcsc1_i"], ["G4_vs", "tcsc1_x_mod"])])
def test_a_line_that_is_tripped_takes_its_series_capacitor_along(
    ports: tuple[list[str], list[str]], cache: Path
) -> None:
    case = load_case("two-area-actuators")
    inputs, outputs = ports
    gains = 0.02 * np.eye(len(outputs), len(inputs))
    K = control.ss([], [], [], gains, inputs=inputs, outputs=outputs)
    root = FaultLoops(case, Controller("k", K), cache).end("7-8 a").root
    document = {"branches": {"7-8 a": {"in_service": False}}, "tcscs": {"tcsc1": "none"}}
    plant = ia.linearise(case.with_changes(document), speeds="rad/s")
    sees, moves = plant.output_labels.index("G4_dw"), plant.input_labels.index("G4_vs")
    closed = plant.A + 0.02 * np.outer(plant.B[:, moves], plant.C[sees])
    roots = np.linalg.eigvals(closed)
    assert root == pytest.approx(complex(roots[np.abs(roots) > 1e-6].real.max()), abs=1e-6)


def test_a_trip_that_parts_the_grid_is_named_and_takes_the_loop_with_the_branch(cache: Path) -> None:
    case = operating_variant(load_case("two-area-thesis"), out=["8-9 a"])
    loops = FaultLoops(case, shipped_controller("robust"), cache)
    assert loops.end("8-9 b") == loops.end(None)
    assert loops.unsolved == ["8-9 b"]


def test_each_signal_is_wrong_in_turn_in_each_way() -> None:
    table = AcceptanceTable(fault=({"bus": 8},), wrong=("x-1", "s300"), never_lost=("G2_dw",))  # type: ignore[arg-type]
    ((_, settings),) = settings_of(table, "base", None, ["G2_dw", "G4_dw"])
    assert [str(s).removeprefix("base, fault at bus 8, ") for s in settings] == [
        "100 ms",
        "G4_dw lost, 100 ms",
        "G4_dw times -1, 100 ms",
        "G4_dw 300 ms late, 100 ms",
    ]
    assert settings[-1].in_all(["G2_dw", "G4_dw"]).latency_s_of == {"G2_dw": 0.1, "G4_dw": 0.4}
    for code in ("L", "N", "x", "s300:G2_dw", "s300+x2", "s-3", "xnan"):
        with pytest.raises(ValueError, match=r"wrong has .* allowed: x<factor> such as x-1 or s<ms>"):
            AcceptanceTable(fault=({"bus": 8},), wrong=(code,))  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("values", "says"),
    [
        ({"wrong": ("x1",)}, "'x1', which leaves a signal as it is"),
        ({"wrong": ("s0",)}, "'s0', which leaves a signal as it is"),
        ({"wrong": ("x-1", "s300", "x-1.0")}, "'times -1' twice"),
        ({"start_s": 10.0}, "start_s = 10, allowed: before stop_s = 10"),
        ({"lost_s": 20.0}, "lost_s = 20, allowed: before stop_s = 10"),
        ({"ceilings": ((5.0, -5.0),)}, r"ceilings has \[5, -5\], allowed: the first below the second"),
    ],
)
def test_an_acceptance_that_tries_nothing_is_refused(values: dict, says: str) -> None:
    with pytest.raises(ValueError, match=says):
        AcceptanceTable(fault=({"bus": 8},), **values)  # type: ignore[arg-type]


def test_a_wrong_signal_ends_in_the_loop_of_another_gain_or_latency(cache: Path) -> None:
    case = load_case("two-area-thesis")

    def loops(gain: float) -> FaultLoops:
        K = control.ss([], [], [], [[0.01, gain]], inputs=["G2_dw", "G4_dw"], outputs=["G4_vs"])
        return FaultLoops(case, Controller("k", K), cache)

    late = Condition("late", (), {"G2_dw": 0.05, "G4_dw": 0.05})
    wrong = loops(0.02).end("7-8 a", replace(late, scale_of={"G4_dw": -1.0}))
    assert wrong.root == pytest.approx(loops(-0.02).end("7-8 a", late).root, abs=1e-9)
    assert abs(wrong.root - loops(0.02).end("7-8 a", late).root) > 0.01


@pytest.mark.slow
def test_a_wrong_polarity_after_the_fault_fails_a_loop_that_survives_losses(cache: Path) -> None:
    few = TABLE.model_copy(update={"ceilings": (), "latency_s": (0.1,)})
    K = shipped_controller("robust")
    assert judge_acceptance(K, CASES, few, cache, clearing=False).violations == ()
    wrong = judge_acceptance(K, CASES, few.model_copy(update={"wrong": ("x-1",)}), cache, clearing=False)
    assert wrong.cases == 5
    assert wrong.violations and all("G4_dw times -1" in line for line in wrong.violations)


@pytest.mark.slow
def test_an_acceptance_runs_every_kind_of_loads(cache: Path) -> None:
    few = TABLE.model_copy(update={"ceilings": (), "latency_s": (0.1,), "loads": ((1.0, 2.0),)})
    K = shipped_controller("robust")
    acceptance = judge_acceptance(K, CASES, few, cache, clearing=False)
    assert (acceptance.cases, acceptance.lost) == (6, ())
    case = CASES["tie +100"]
    exponents = {load.name: {"P_exponent": 1.0} for load in case.loads}
    grids = (case, None), (case, (1.0, 2.0)), (case.with_changes({"loads": exponents}), None)
    angles = []
    for grid, loads in grids:
        alone = Setting("tie +100", None, TABLE.fault[0], loads=loads), False
        with Trial(grid, K, few, cache, loads=loads) as trial:
            angles.append(np.degrees(trial.angles({alone: 8.0})[alone]))
    assert angles[1] == pytest.approx(angles[2], abs=1e-9)
    assert abs(angles[1] - angles[0]) > 1.0


@pytest.mark.slow
def test_without_a_guard_the_grid_is_lost_where_it_holds_alone(cache: Path) -> None:
    """The local channel answers the common speed rise with the harmful sign; the guard takes that side."""
    bare = judge_acceptance(_bare(), CASES, TABLE, cache, clearing=False)
    assert bare.cases == 6
    assert [s for s in bare.lost if "ceilings" in s and "G4_dw lost" not in s] == list(bare.lost)
    assert len(bare.lost) == 1
    guarded = judge_acceptance(shipped_controller("robust"), CASES, TABLE, cache, clearing=False)
    assert guarded.lost == ()
    assert guarded.largest_angle_deg < 100.0


@pytest.mark.slow
def test_a_limit_cycle_after_a_loss_is_no_success(cache: Path) -> None:
    """A controller without its local signal keeps synchronism; a minute shows that nothing decays."""
    K, grid = Controller.load(WITHOUT_LOCAL), {"base": load_case("two-area-thesis")}
    bus_8 = AcceptanceTable(fault=({"bus": 8},), latency_s=(0.05, 0.1))  # type: ignore[arg-type]
    acceptance = judge_acceptance(K, grid, bus_8, cache, clearing=False)
    assert (acceptance.cases, acceptance.loops, acceptance.lost, acceptance.longest_s) == (6, 6, (), 60.0)
    places = [f"base, fault at bus 8, G4_dw lost, {ms} ms" for ms in (50, 100)]
    assert [s.partition(":")[0] for s in acceptance.standing] == places
    assert all(
        "standing swing: controller.G4_vs is at its limit of 0.05 pu" in s for s in acceptance.standing
    )
    assert [s.partition(":")[0] for s in acceptance.unstable] == [f"after {place}" for place in places]
    assert len(acceptance.violations) == 4

    exempt = bus_8.model_copy(update={"never_lost": ("G4_dw",)})
    held = judge_acceptance(K, grid, exempt, cache, clearing=False)
    assert (held.cases, held.violations) == (4, ())
    for name in ("robust", "robust_latency"):
        better = judge_acceptance(shipped_controller(name), grid, bus_8, cache, clearing=False)
        assert (better.violations, better.longest_s) == ((), 10.0)


@pytest.mark.slow
def test_a_bank_that_loses_the_grid_when_a_flag_falls_fails(cache: Path) -> None:
    """Without a guard, as `active` was in version 0.4; with it nothing is lost."""
    few = AcceptanceTable(fault=({"bus": 8, "trip": "8-9 a"},))  # type: ignore[arg-type]
    bank = ControllerBank.load(Path(__file__).parent / "bank_without_guard.json")
    acceptance = judge_acceptance(bank, CASES, few, cache, clearing=False)
    assert acceptance.lost == ("tie +100, fault at bus 8, 8-9 a tripped, G2_dw lost, 100 ms",)
    # with loads of constant power there is no power flow without the circuit
    assert acceptance.unsolved == ("tie +100 without 8-9 a",)
    held = judge_acceptance(shipped_bank("active"), CASES, few, cache, clearing=False)
    assert (held.cases, held.violations) == (3, ())


def test_a_loop_that_grows_slowly_is_run_for_longer(cache: Path) -> None:
    """The law of the length of a run, and roots against those of a loop closed by hand."""
    assert LoopEnd(True, complex(-SLOW)).run_s(10.0, 1.5) == 10.0
    assert LoopEnd(True, complex(-0.049)).run_s(10.0, 1.5) == LONG_S
    assert LoopEnd(True, complex(-1e-9)).run_s(10.0, 1.5) == LONGEST_S
    assert LoopEnd(True, complex(np.nan)).run_s(10.0, 1.5) >= LONG_S
    case, K = load_case("two-area-thesis"), Controller.load(WITHOUT_LOCAL)
    loops = FaultLoops(case, K, cache)
    lost = Condition("lost", ("G4_dw",))
    end = loops.end(None, lost)
    plant = speeds_in_rad(remove_reference(linear_plant(case, cache)), case.omega_b)
    poles = np.linalg.eigvals(closed_loop_matrix(plant, K.system, lost=("G4_dw",)))
    assert end.root.real == pytest.approx(poles.real.max(), abs=1e-8)
    assert not end.stable
    assert loops.end(None, lost, controlled=False).stable
    assert loops.end("8-9 a", lost).stable  # another grid, another loop


@pytest.mark.parametrize(
    ("stable", "ends_by", "came_to", "longest_s"),
    [
        (True, 100.0, "settled", 240.0),
        (True, 300.0, "standing swing", 240.0),
        (False, 100.0, "growing", 60.0),
    ],
)
def test_what_does_not_decay_is_run_on_to_its_end(
    stable: bool, ends_by: float, came_to: str, longest_s: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A motion that is over at `ends_by`: it is settled in a run that lasts longer, if its loop is stable."""
    runs = FaultRuns.__new__(FaultRuns)

    def outcomes(those: Sequence[FaultRun], roots: Sequence[complex]) -> list[Outcome]:
        names = [
            "settled" if run.stop_s > ends_by else "standing swing" if root.real < 0.0 else "growing"
            for run, root in zip(those, roots, strict=True)
        ]
        return [Outcome(1.0, Verdict(n, "", (2.0, 60.0), 1.0, 0.5, 0.5, 60.0, None, None)) for n in names]

    monkeypatch.setattr(runs, "outcomes", outcomes)
    end = LoopEnd(stable, complex(-0.1 if stable else 0.1, 3.0))
    results, longest = runs.outcomes_to_end([FaultRun((), 10.0)], [end], 1.5)
    assert results[0].verdict is not None
    assert (results[0].verdict.name, longest) == (came_to, longest_s)


def test_what_a_certificate_leaves_out_is_said() -> None:
    table = load_design("robust")
    text = not_covered(table, table.signals, None)
    assert text == (
        "non-linear faults (--acceptance runs them); the loss of G4_dw; two signals lost at once; a signal "
        "that is wrong while marked as valid"
    )
    record = Acceptance(0, (), (), 0.0, ()).as_dict()
    assert "G4_dw" not in not_covered(table, table.signals, record)  # every signal is lost in turn there
    assert table.acceptance is not None
    exempt = table.acceptance.model_copy(update={"never_lost": ("G4_dw",)})
    own = table.model_copy(update={"acceptance": exempt})
    assert "the loss of G4_dw;" in not_covered(own, own.signals, record)
    assert "the design defines none" in not_covered(load_design("robust_linear"), ("G2_dw", "G4_dw"), None)
    somewhere = table.acceptance.model_copy(update={"points": ("base",)})
    part = table.model_copy(update={"acceptance": somewhere})
    others = ", ".join(point.name for point in table.point if point.name != "base")
    assert not_covered(part, part.signals, record).startswith(f"non-linear faults at {others}; ")
    assert list(somewhere.looked_at(dict.fromkeys(("base", "tie +100"), CASES["tie +100"]))) == ["base"]
    keys = table.model_dump(mode="json", exclude_unset=True)
    keys["acceptance"]["points"] = ["bsae"]
    with pytest.raises(ScenarioError, match=r"acceptance\.points has \['bsae'\]; the design's are base, "):
        design_of(keys)


@pytest.mark.slow
def test_faults_are_run_at_the_points_that_are_named(cache: Path) -> None:
    update = {"ceilings": (), "latency_s": (0.1,), "points": ("tie +100",)}
    K, cases = shipped_controller("robust"), {"base": load_case("two-area-thesis"), **CASES}
    acceptance = judge_acceptance(K, cases, TABLE.model_copy(update=update), cache, clearing=False)
    assert (acceptance.cases, acceptance.violations) == (3, ())


def test_a_signal_that_the_controller_lacks_cannot_be_exempt() -> None:
    table = TABLE.model_copy(update={"never_lost": ("G9_dw",)})
    with pytest.raises(ScenarioError, match="never_lost names G9_dw; the controller's signals are G2_dw"):
        list(settings_of(table, "base", None, ["G2_dw", "G4_dw"]))


@pytest.mark.slow
def test_the_clearing_time_is_the_edge_of_synchronism(cache: Path) -> None:
    alone = Setting("tie +100", None, TABLE.fault[0]), False
    with Trial(CASES["tie +100"], _bare(), TABLE, cache) as trial:
        edge = trial.clearing_cycles([alone])[alone]
        assert edge is not None
        assert trial.stable_at({alone: edge})[alone]
        assert not trial.stable_at({alone: edge + TABLE.resolution_cycles})[alone]
        assert trial.angles({alone: 8.0})[alone] < np.pi


@pytest.mark.slow
def test_side_by_side_each_fault_runs_as_it_would_alone(cache: Path) -> None:
    """Other latencies, losses, clearing times and no controller at all, against single runs by the master."""
    case, fault = CASES["tie +100"], TABLE.fault[0]
    tries = {
        (Setting("tie +100", None, fault), False): 8.0,
        (Setting("tie +100", None, fault, ("G2_dw",), 0.1), True): 8.0,
        (Setting("tie +100", None, fault, (), 0.05), True): 6.0,
        (Setting("tie +100", None, fault, (), 0.1, wrong=("s300", "G2_dw")), True): 6.0,
    }
    with Trial(case, _bare(), TABLE, cache) as trial:
        together = trial.angles(tries)
    for (setting, controlled), cycles in tries.items():
        clear_s = 1.0 + cycles / 60.0
        events = after_clearing(case, 8, "8-9 a", 1.0, clear_s)
        lost = dict.fromkeys(setting.lost, 1.5)
        run = FaultRun(events, 10.0, _bare() if controlled else None, setting.latency_s, lost)
        document = run.document()
        if setting.wrong:
            late = {"kind": "time_error", "offset_s": 0.3, "start_s": 1.5}
            document["channels"]["from_G2_dw"]["signal_faults"] = [late]
        system = system_of(
            load_scenario(document),
            case=case,
            controller=run.controller or "none",
            swing=Swing("G1", "G4", "test"),
            cache=cache,
        )
        with system.master() as master:
            data = master.run()
        angles = np.array([data[f"plant.{m.name}_delta"] for m in case.machines])
        assert together[setting, controlled] == pytest.approx(float(np.ptp(angles, axis=0).max()), rel=1e-9)


def test_the_first_condition_that_fails_is_said() -> None:
    row = {"point": "tie +100", "condition": "s200", "stable": False}
    faults = Acceptance(6, ("tie +100, fault at bus 8, 100 ms",), (), 90.0, ()).as_dict()
    certificate = {"rows": [{**row, "stable": True}, row, row], "acceptance": faults}
    assert first_failures(certificate) == (
        "unstable in 2 of 3 linear conditions (first: tie +100, s200); non-linear faults: 1 of 6 lose "
        "synchronism only with the controller (first: tie +100, fault at bus 8, 100 ms), 0 only without it"
    )
    assert first_failures(None) == "non-linear faults: not computed"
    assert first_failures({"rows": [{**row, "stable": True}]}) == "non-linear faults: not computed"


@pytest.mark.parametrize("name", ["wdc", "cc", "ftc"])
def test_what_a_controller_of_the_study_does_not_survive_is_kept(name: str) -> None:
    case = load_case("two-area-thesis")
    known = bundled_certificate(name, case.hash)
    assert known is not None
    assert known["acceptance"]["cases"] == 576
    assert len(known["rows"]) == 18
    assert "of 576 lose synchronism only with the controller (first: " in first_failures(known)
    assert bundled_certificate(name, CASES["tie +100"].hash) is None  # another case
    assert bundled_certificate("robust", case.hash) is None  # has a record of its own


@pytest.mark.slow
def test_the_kept_certificates_are_those_of_the_controllers(cache: Path) -> None:
    """One linear row and the first lost fault of FTC, found again."""
    case = load_case("two-area-thesis")
    known = bundled_certificate("ftc", case.hash)
    assert known is not None
    controller = design_controller(case, "ftc", cache)
    table = load_design("robust_latency")
    row = known["rows"][0]
    plant = speeds_in_rad(remove_reference(linear_plant(case, cache)), case.omega_b)
    certificate = judge_family({"base": plant}, controller.system, table.family()[:1])
    assert certificate.rows[0].worst_swing == pytest.approx(row["worst_swing"], abs=1e-4)
    assert table.acceptance is not None
    lost = next(each for each in known["acceptance"]["lost"] if each.startswith("tie +100, fault"))
    for setting in (
        s
        for _, settings in settings_of(table.acceptance, "tie +100", None, controller.inputs)
        for s in settings
    ):
        if str(setting) == lost:
            with Trial(CASES["tie +100"], controller, table.acceptance, cache) as trial:
                stored = trial.stable_at({(setting, False): 8.0, (setting, True): 8.0})
            assert stored == {(setting, False): True, (setting, True): False}
            break
    else:
        pytest.fail(f"no setting is {lost!r}")
