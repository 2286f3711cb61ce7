"""The page against the FMU of the scenario it saves: the same bits from WebAssembly as from the binary."""

from __future__ import annotations

import contextlib
import hashlib
import json
import os
import random
import sys
import tomllib
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
from fmu_runner import Runner

from interarea.cli.app import main
from interarea.cosim.export.container import container_block
from interarea.cosim.results.verdict import LOST, SETTLED, STANDING
from interarea.cosim.scenario.scenario import load_scenario
from interarea.fmu_build.write.package import block_fmu

SETTINGS = 50 if os.environ.get("INTERAREA_EVERY_FAULT") else 12  #: random ones; 50 in `make fuzz`


def native_rows(toml: str, columns: Sequence[str], cache: Path) -> np.ndarray[Any, Any]:
    """Return the rows of the container FMU of a saved scenario: every column at every communication step."""
    scenario = load_scenario({"name": "saved", **tomllib.loads(toml)})
    block = container_block(scenario, cache=cache)
    assert scenario.step_s is not None
    count = round(scenario.stop_s / scenario.step_s)
    rows = np.empty((count + 1, len(columns)))
    with Runner(block_fmu(block, cache)) as fmu:
        fmu.start(stopTime=scenario.stop_s)
        reads = []
        for kind, read in (
            ("Real", fmu.fmu.getReal),
            ("Integer", fmu.fmu.getInteger),
            ("Boolean", fmu.fmu.getBoolean),
        ):
            places = [j for j, c in enumerate(columns) if fmu.variables[c].type == kind]
            reads.append((places, read, [fmu.reference(columns[j]) for j in places]))
        assert sum(len(places) for places, *_ in reads) == len(columns)
        for k in range(count + 1):
            if k > 0:
                fmu.step((k - 1) * scenario.step_s, scenario.step_s)
            for places, read, references in reads:
                rows[k, places] = read(references)
    return rows


def settings(known: dict[str, Any], count: int) -> list[dict[str, Any]]:
    """Return random states of the page, every control moved now and then."""
    rng = random.Random(22)
    states = []
    for _ in range(count):
        state: dict[str, Any] = {"k": rng.choice([c["key"] for c in known["controllers"]])}
        state["g"] = rng.choice([1.0, round(rng.uniform(0.2, 2.5), 2)])
        state["l"] = round(rng.uniform(0.03, 0.3), 3)
        for channel in known["channels"]:
            values = {
                "latency": rng.choice([0, rng.randrange(0, 1000, 5)]),
                "loss": rng.choice([0, rng.randint(1, 50)]),
                "burst": rng.choice([1, 2.5, 7]),
                "jitter": rng.choice([0, rng.randint(1, 80)]),
                "interval": rng.choice([0, 20, 33]),
                "seed": rng.randint(0, 99),
                "on_loss": rng.choice(["zero", "hold", "hold_then_zero"]),
                "hold": rng.randrange(0, 2000, 10),
                "lost": rng.choice([known["stop"], round(rng.uniform(0, 15), 1)]),
                "back": rng.choice([known["stop"], round(rng.uniform(10, 19), 1)]),
                "wrong": rng.choice(["none", *known["wrong"]]),
                "since": round(rng.uniform(0, 10), 1),
            }
            state |= {f"{channel['name']}.{key}": value for key, value in values.items()}
        state["ev"] = rng.choice(["nudge", "fault", "load", "trip"])
        for kind in ("nudge", "fault", "load", "trip"):
            state[kind] = rng.choice(known["events"][kind])["name"]
        state["sz"] = rng.randint(-10, 15)
        state["tc"] = rng.randrange(10, 200, 5)
        state["br"] = rng.choice(["", rng.choice(known["events"]["trip"])["name"]])
        state["cl"] = rng.choice([0, round(rng.uniform(4, 12), 2)])
        state["op"] = rng.randrange(len(known["points"]))
        states.append(state)
    return states


def assert_same_bits(node: Any, states: list[dict[str, Any]], cache: Path, folder: Path) -> None:
    jobs: list[dict[str, Any]] = []
    for k, state in enumerate(states):
        jobs += [{"run": state, "file": str(folder / f"{k}.bin")}, {"toml": state}]
    answers = node(jobs)
    for k, (state, result, toml) in enumerate(zip(states, answers[::2], answers[1::2], strict=True)):
        assert "error" not in result, (state, result)
        if result["why"]:
            continue  # a collapse: the container's own refusal to go on
        rows = native_rows(toml, result["columns"], cache)
        assert len(rows) == 2001 == result["rows"]
        assert np.isfinite(rows).all()
        local = np.frombuffer((folder / f"{k}.bin").read_bytes()).reshape(rows.shape)
        worst = np.abs(local - rows).max(axis=0)
        same = hashlib.sha256(rows.tobytes()).hexdigest() == result["hash"]
        assert same, (toml, dict(zip(result["columns"], worst, strict=True)))


@pytest.mark.slow
def test_presets_and_their_saved_scenarios_have_the_bits_of_the_fmu(
    node: Any, data: dict[str, Any], cache: Path, tmp_path: Path
) -> None:
    states = [preset["state"] for preset in data["presets"]]
    assert len(states) == 6
    assert_same_bits(node, [states[2], states[4], states[5]], cache, tmp_path)


@pytest.mark.slow
def test_random_settings_have_the_bits_of_the_fmu(
    node: Any, data: dict[str, Any], cache: Path, tmp_path: Path
) -> None:
    assert_same_bits(node, [p["state"] for p in data["presets"]] + settings(data, SETTINGS), cache, tmp_path)


@pytest.mark.slow
def test_rows_four_times_as_far_apart_are_the_same(node: Any, data: dict[str, Any], tmp_path: Path) -> None:
    state = data["presets"][3]["state"]
    files = [tmp_path / "every.bin", tmp_path / "other.bin"]
    every, other = node(
        [{"run": state, "every": 1 + 3 * k, "file": str(file)} for k, file in enumerate(files)]
    )
    rows = [np.frombuffer(f.read_bytes()).reshape(-1, len(every["columns"])) for f in files]
    assert other["rows"] == 501
    assert np.array_equal(rows[0][::4], rows[1])


@pytest.mark.slow
def test_drawn_step_shows_what_the_exact_one_shows(node: Any, data: dict[str, Any]) -> None:
    """While a slider moves the solver's step is longer: the verdict is the same, the error below .01 mHz and,
    where the field is at its limits and the grid about to lose synchronism, a fifth of a pixel."""
    states = [preset["state"] for preset in data["presets"]]
    exact = node([{"judge": state} for state in states])
    coarse = node([{"judge": state, "coarse": True} for state in states])
    assert [run["kind"] for run in coarse] == [run["kind"] for run in exact]
    assert [run["kind"] for run in exact] == [SETTLED, SETTLED, STANDING, SETTLED, SETTLED, LOST]
    for fine, drawn in zip(exact, coarse, strict=True):
        until = slice(None) if fine["kind"] != LOST else slice(0, int(100 * fine["t"]))
        error = np.max(np.abs(np.subtract(fine["swing"][until], drawn["swing"][until])))
        assert error < (2e-3 * np.max(np.abs(fine["swing"][until])) if fine["kind"] == LOST else 0.01)


@pytest.mark.slow
def test_no_drawn_run_loses_synchronism_falsely(node: Any, data: dict[str, Any]) -> None:
    """Clearing times on both sides of the critical one: field limits of three sizes and none, another place,
    other controllers (CC's fastest pole: 288 1/s)."""
    fault = data["presets"][5]["state"]
    states = [fault | {"tc": tc, "cl": cl} for cl in (4, 5, 7) for tc in range(50, 501, 30)]
    states += [fault | {"tc": tc, "k": k} for k in ("none", "cc") for tc in range(65, 501, 60)]
    states += [fault | {"tc": tc, "cl": 0, "fault": 7} for tc in range(80, 501, 60)]
    exact = [run["kind"] for run in node([{"judge": state} for state in states])]
    assert {LOST, SETTLED} <= set(exact)
    assert [run["kind"] for run in node([{"judge": state, "coarse": True} for state in states])] == exact


@pytest.mark.slow
def test_a_drawn_run_ends_when_synchronism_is_lost(node: Any, data: dict[str, Any], tmp_path: Path) -> None:
    """A second after it at the earliest, three at the latest, with the rows of the whole run."""
    fault = data["presets"][5]["state"]
    drawn, whole = tmp_path / "drawn.bin", tmp_path / "whole.bin"
    short, long, judged = node(
        [
            {"run": fault, "coarse": True, "file": str(drawn)},
            {"run": fault, "coarse": True, "on": True, "file": str(whole)},
            {"judge": fault, "coarse": True},
        ]
    )
    assert judged["kind"] == LOST
    assert judged["t"] + 1.0 < short["rows"] / 100.0 < judged["t"] + 3.0
    assert long["rows"] == 2001
    assert whole.read_bytes().startswith(drawn.read_bytes())
    stays = fault | {"tc": 50}
    short, judged = node([{"run": stays, "coarse": True}, {"judge": stays}])
    assert judged["kind"] == SETTLED
    assert short["rows"] == 2001


@pytest.mark.slow
def test_a_longer_step_of_the_plant_lengthens_the_controllers(node: Any, data: dict[str, Any]) -> None:
    """FTC's own step of 1.06 ms would keep every drawn run as slow as the exact one."""
    state = data["presets"][4]["state"]
    assert state["k"] == "ftc" and data["solver"]["fast"] > 0.0025
    drawn, exact = node([{"run": state, "coarse": True}, {"run": state}])
    assert drawn["hash"] != exact["hash"]


def test_the_module_imports_nothing(node: Any) -> None:
    assert node([{"imports": True}]) == [[]]


@pytest.mark.slow
def test_hundred_runs_leave_the_memory_as_it_was(node: Any, data: dict[str, Any]) -> None:
    runs = [{"run": p["state"], "all": False, "every": 4, "coarse": True} for p in data["presets"]]
    sizes = [
        a for a in node([*runs * 2, {"memory": True}, *runs * 4, {"memory": True}]) if isinstance(a, int)
    ]
    assert sizes[0] == sizes[1] < 16e6


@pytest.mark.slow
def test_interarea_run_repeats_the_page(
    node: Any, data: dict[str, Any], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The saved scenario run by the command line: every column of the page, bit by bit."""
    state = data["presets"][4]["state"] | {"g": 1.2, "l": 0.09, "op": 1}
    file = tmp_path / "rows.bin"
    result, toml = node([{"run": state, "file": str(file)}, {"toml": state, "title": "kept"}])
    (tmp_path / "saved.toml").write_text(toml, encoding="utf-8")
    arguments = ["interarea", "run", str(tmp_path / "saved.toml"), "--out", str(tmp_path / "out")]
    monkeypatch.setattr(sys, "argv", arguments)
    with contextlib.suppress(SystemExit):
        main()
    table = pd.read_parquet(tmp_path / "out" / "trajectory.parquet")
    rows = np.frombuffer(file.read_bytes()).reshape(-1, len(result["columns"]))
    names = {c.replace(".", "_", 1): c for c in table}
    for k, column in enumerate(result["columns"]):
        name = names.get(column) or next(n for n in table if n.partition(".")[2] == column)
        assert np.array_equal(table[name].to_numpy(dtype=float), rows[:, k]), (column, name)
    ledger = json.loads((tmp_path / "out" / "ledger.json").read_text(encoding="utf-8"))
    assert ledger["inputs"] == "joint"
    assert {round(r["total_s"], 9) for r in ledger["delays"]} == {0.0, 0.06}  # 50 ms and half an interval
