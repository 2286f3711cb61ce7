"""Keys of concentrators and start values of own FMUs as parameters of a sweep."""

from __future__ import annotations

import copy
from pathlib import Path
from typing import Any

import pytest
from misbehaving import misbehaving_fmu

from interarea.cosim.errors import SweepError
from interarea.cosim.run.run import run_scenario
from interarea.cosim.sweep.plan import plan_sweep
from interarea.cosim.sweep.runner import Runner
from interarea.cosim.sweep.spec import load_sweep

SIGNALS = [{"signal": "G2_dw", "latency_s": 0.04}, {"signal": "G4_dw", "latency_s": 0.09, "loss": 0.2}]
PDC = {"pdc": {"wait_s": 0.1, "seed": 5, "signals": SIGNALS}}
ALIGNED = {"channels": {}, "concentrators": PDC, "stop_s": 2.0}


def rows_of(table: dict[str, Any], cache: Path, scratch: Path) -> list[dict[str, Any]]:
    plan = plan_sweep(load_sweep(table), cache)
    with Runner(plan, cache, scratch) as runner:
        return [outcome.row for outcome in runner.outcomes(range(plan.sweep.size))]


@pytest.mark.slow
def test_keys_of_a_concentrator_do_what_the_same_keys_of_a_scenario_do(
    document: Any, cache: Path, tmp_path: Path
) -> None:
    """Each run of the sweep is, to the bit, the scenario with these values written into it."""
    wait = {"path": "concentrators.*.wait_s", "values": [0.03, 0.12]}
    late = {"path": "concentrators.pdc.signals.2.latency_s", "values": [0.02, 0.09]}
    table = document(ALIGNED, parameters={"wait": wait, "late": late})
    rows = rows_of(table, cache, tmp_path)
    assert len(rows) == 4 and len({row["energy_pu2s"] for row in rows}) == 4
    for row in rows[1:3]:
        scenario = copy.deepcopy(table["scenario"])
        scenario["concentrators"]["pdc"]["wait_s"] = row["wait"]
        scenario["concentrators"]["pdc"]["signals"][1]["latency_s"] = row["late"]
        assert row["energy_pu2s"] == run_scenario(scenario, cache=cache).metrics.energy_pu2s


@pytest.mark.slow
def test_keys_of_a_wrong_signal_do_what_the_same_keys_of_a_scenario_do(
    document: Any, cache: Path, tmp_path: Path
) -> None:
    wrong = [{"kind": "scale", "factor": 1.0, "start_s": 0.5}]
    pdc = copy.deepcopy(PDC)
    pdc["pdc"]["signals"][0]["signal_faults"] = wrong
    factor = {"path": "concentrators.pdc.signals.1.signal_faults.1.factor", "values": [1.0, -3.0]}
    start = {"path": "concentrators.pdc.signals.1.signal_faults.1.start_s", "values": [0.5, 1.0]}
    table = document(ALIGNED | {"concentrators": pdc}, parameters={"factor": factor, "start": start})
    rows = rows_of(table, cache, tmp_path)
    assert len(rows) == 4 and len({row["energy_pu2s"] for row in rows}) == 3  # factor 1: right at any time
    for row in rows[2:]:
        scenario = copy.deepcopy(table["scenario"])
        (fault,) = scenario["concentrators"]["pdc"]["signals"][0]["signal_faults"]
        fault |= {"factor": row["factor"], "start_s": row["start"]}
        assert row["energy_pu2s"] == run_scenario(scenario, cache=cache).metrics.energy_pu2s


@pytest.mark.parametrize(
    ("path", "said"),
    [
        ("channels.line.signal_faults.2.size", r"channels\.line\.signal_faults\.K\.KEY with K from 1 to 1"),
        ("channels.line.signal_faults.1.factor", "'factor' is no key of bias"),
        ("channels.line.signal_faults.1.kind", "'kind' is no key of bias"),
        ("channels.right.signal_faults.1.size", "no fault there; write one with its kind"),
    ],
)
def test_paths_to_a_fault_that_is_not_there(document: Any, cache: Path, path: str, said: str) -> None:
    bias = [{"kind": "bias", "size": 0.001, "start_s": 0.5}]
    channels = {"line": {"signal": "G2_dw", "signal_faults": bias}, "right": {"signal": "G4_dw"}}
    table = document({"channels": channels}, parameters={"p": {"path": path, "values": [0.001]}})
    with pytest.raises(SweepError, match=said):
        plan_sweep(load_sweep(table), cache)


@pytest.mark.slow
def test_start_values_of_an_own_fmu_reach_it(document: Any, cache: Path, tmp_path: Path) -> None:
    """An FMU that ends its process at 0.3 s is told so by the sweep: only the run that asks for it fails."""
    own = {"file": str(misbehaving_fmu(tmp_path)), "isolate": True}
    scenario = {
        "fmus": {"mine": own},
        "connections": [["plant.G1_dw", "mine.u"]],
        "event": [],
        "stop_s": 0.6,
    }
    ends = {"path": "fmus.mine.start.abort_at", "values": [0.3, 9.0]}
    rows = rows_of(document(scenario, parameters={"ends": ends}), cache, tmp_path)
    assert [row["status"] for row in rows] == ["failed", "ok"]


@pytest.mark.parametrize(
    ("path", "said"),
    [
        ("concentrators.pdk.wait_s", "'pdk' is no concentrator; did you mean 'pdc'"),
        ("concentrators.pdc.wait", "'wait' is no key of a concentrator; did you mean 'wait_s'"),
        ("concentrators.pdc.signals.3.loss", r"concentrators\.pdc\.signals\.K\.KEY with K from 1 to 2"),
        ("concentrators.pdc.signals.1.lost", "'lost' is no key of a concentrator's signal"),
        ("concentrators.pdc.wait_s.more", "wait_s has no entries"),
        ("fmus.mine.abort_at", r"allowed: fmus\.NAME\.start\.VARIABLE"),
        ("fmus.mine.start.abort", "'abort' is no variable of .*fmu; did you mean 'abort_at'"),
        ("fmus.yours.start.x0", "'yours' is no FMU of the scenario"),
    ],
)
def test_paths_that_lead_nowhere(document: Any, cache: Path, tmp_path: Path, path: str, said: str) -> None:
    fmus = {"mine": {"file": str(misbehaving_fmu(tmp_path))}}
    scenario = ALIGNED | {"fmus": fmus, "connections": [["plant.G1_dw", "mine.u"]]}
    with pytest.raises(SweepError, match=said):
        plan_sweep(load_sweep(document(scenario, parameters={"p": {"path": path, "values": [1.0]}})), cache)


def test_one_seed_for_all_and_a_seed_of_a_concentrator_contradict(document: Any, cache: Path) -> None:
    both = {"a": {"path": "seed", "values": [1]}, "b": {"path": "concentrators.pdc.seed", "values": [1]}}
    with pytest.raises(SweepError, match="both set the seed"):
        plan_sweep(load_sweep(document(ALIGNED, parameters=both)), cache)
