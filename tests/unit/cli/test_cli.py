"""The command line: JSON on stdout, one line and exit code 2 for a user's mistake."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from interarea.cli.terminal import DEBUG_VARIABLE, complain
from interarea.fmu_build.open.real_code import RealCodeLibrary

SCENARIO = """
case = "two-area-thesis"
stop_s = 2.0
step_s = 0.02
[[event]]
kind = "vref_pulse"
machine = "G1"
size_pu = 0.05
start_s = 0.5
end_s = 0.7
"""


def test_cases_lists_the_bundled_cases(interarea) -> None:  # type: ignore[no-untyped-def]
    code, out, _ = interarea("cases", "--json")
    assert code == 0
    assert json.loads(out)["two-area-thesis"]["machines"] == 4
    assert "kundur-thyristor-z" in interarea("cases")[1]


def test_modes_prints_what_an_independent_code_has(interarea) -> None:  # type: ignore[no-untyped-def]
    """Eigenvalues of kundur-thyristor-z by another program, to 3 digits."""
    code, out, _ = interarea("modes", "kundur-thyristor-z", "--json")
    document = json.loads(out)
    assert code == 0 and document["case"] == "kundur-thyristor-z"
    assert document["states"] == len(document["eigenvalues"])
    for name, (real, imaginary) in {
        "inter-area": (0.0141, 3.829),
        "local area 1": (-0.6604, 7.180),
        "local area 2": (-0.6586, 7.403),
    }.items():
        assert document["modes"][name]["eigenvalue"] == [
            pytest.approx(real, abs=5e-5),
            pytest.approx(imaginary, abs=5e-4),
        ]


def test_margins_say_how_far_controls_start_from_limits(interarea, tmp_path: Path) -> None:  # type: ignore[no-untyped-def]
    rows = json.loads(interarea("modes", "nets-nyps", "--margins", "--json")[1])["margins"]
    assert [row["margin"] for row in rows] == sorted(row["margin"] for row in rows)
    near = next(row for row in rows if row["control"] == "G3.exciter")
    assert near["nearest"] == "Efd_max" and near["margin"] == pytest.approx(5.0 - near["value"])
    tight = tmp_path / "tight.toml"
    tight.write_text(
        'base = "nets-nyps"\n[change.machines]\nG3 = { exciter = { Efd_max = 1.5 } }\n'
        "G6 = { exciter = { Efd_max = 1.5 } }\n"
    )
    code, out, err = interarea("modes", tight, "--margins")
    assert code == 2 and not out
    assert err.count("set Efd_max to at least") == 3  # both in the list, the first in the error


def test_loops_puts_g4_with_dw24_first(interarea) -> None:  # type: ignore[no-untyped-def]
    document = json.loads(interarea("loops", "two-area-thesis", "--signals", "speed", "--json")[1])
    ranking = document["loops"]["inter-area"]
    assert (ranking[0]["actuator"], ranking[0]["signal"]) == ("G4_vs", "dw24")
    indices = [row["index"] for row in ranking]
    assert indices == sorted(indices, reverse=True)


@pytest.mark.slow
def test_build_writes_the_plant(interarea, tmp_path: Path) -> None:  # type: ignore[no-untyped-def]
    code, out, _ = interarea("build", "two-area-thesis", "--out", tmp_path)
    assert code == 0
    assert Path(out.strip()) == tmp_path / "two-area-thesis.fmu"
    assert Path(out.strip()).read_bytes()[:2] == b"PK"


@pytest.mark.slow
def test_run_writes_its_files(interarea, tmp_path: Path) -> None:  # type: ignore[no-untyped-def]
    file = tmp_path / "pulse.toml"
    file.write_text(SCENARIO, encoding="utf-8")
    code, out, _ = interarea("run", file, "--out", tmp_path / "out", "--explain")
    assert code == 0
    names = {"trajectory.csv", "trajectory.parquet", "ledger.json", "metrics.json", "run.svg"}
    names |= {"scenario.toml", "run.json", "report.html"}
    assert {p.name for p in (tmp_path / "out").iterdir()} == names
    assert (tmp_path / "out" / "trajectory.csv").read_text().startswith("time_s,plant.G1_dw")
    assert json.loads((tmp_path / "out" / "metrics.json").read_text())["stable"] in (True, False)
    assert "step 20 ms (given)" in out
    code, out, err = interarea("run", file, "--out", tmp_path / "out", "--json")
    assert code == 0 and "trajectory.csv" in err
    assert json.loads(out) == json.loads((tmp_path / "out" / "metrics.json").read_text())
    assert json.loads((tmp_path / "out" / "ledger.json").read_text())["step_s"] == 0.02


CHANNELS = """
[channels.remote]
signal = "G2_dw"
latency_s = 0.1
reporting_interval_s = 0.02
jitter_s = 0.01
[channels.remote.loss]
kind = "bernoulli"
rate = 0.1
"""


@pytest.mark.slow
def test_run_explains_delays_and_packets_and_tests_itself(interarea, tmp_path: Path) -> None:  # type: ignore[no-untyped-def]
    file = tmp_path / "packets.toml"
    text = 'controller = "ftc"' + SCENARIO.replace("step_s = 0.02", "") + CHANNELS
    file.write_text(text, encoding="utf-8")
    code, out, _ = interarea("run", file, "--out", tmp_path / "out", "--explain", "--self-test")
    assert code == 0
    assert "every connection has the latency stated" in out
    assert "step 10 ms (chosen: the longest step; divides all latencies and instants)" in out
    assert "order of a step: remote | controller <-> plant" in out
    row = next(
        line for line in out.splitlines() if line.startswith("plant.G2_dw -> remote.u  ") and "first" in line
    )
    assert [float(x) for x in row.split()[3:11]] == [100.0, 0.0, 100.0, 0.0, 10.0, 5.0, 0.0, 115.0]
    sent = 2.0 / 0.02 + 1
    assert f"remote: sent {sent:g}, delivered" in out and "age max" in out
    ledger = json.loads((tmp_path / "out" / "ledger.json").read_text())
    counts = ledger["packets"]["remote"]
    assert counts["sent"] == sum(counts[k] for k in ("delivered", "dropped", "late", "in transit"))
    assert counts["dropped"] > 0
    code, out, _ = interarea("run", file, "--self-test")
    assert code == 0 and "trajectory.csv" not in out
    code, out, _ = interarea("run", file)  # without --out: its result, and no file
    assert code == 0 and "remote: sent" in out
    assert sorted(path.name for path in tmp_path.iterdir()) == ["out", "packets.toml"]


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (('"two-area-thesis"', '"two-area-thesys"'), ("two-area-thesys", "two-area-thesis")),
        (("vref_pulse", "vref_pulses"), ("vref_pulses", "vref_pulse")),
        (('"G1"', '"G9"'), ("G9",)),
        (("start_s = 0.5", "start_s = 5.0"), ("start_s",)),
        (("stop_s", "stop"), ("stop",)),
        (("stop_s = 2.0", "stop_s = "), ("TOML",)),
    ],
)
def test_a_mistake_in_a_scenario_is_one_line(  # type: ignore[no-untyped-def]
    interarea, tmp_path: Path, change: tuple[str, str], words: tuple[str, ...]
) -> None:
    file = tmp_path / "wrong.toml"
    file.write_text(SCENARIO.replace(*change), encoding="utf-8")
    code, out, err = interarea("run", file, "--out", tmp_path / "out")
    assert code == 2 and out == ""
    assert all(line.startswith("interarea: ") for line in err.splitlines()) and "Traceback" not in err
    assert err.count("\n") == (2 if change == ("stop_s", "stop") else 1)  # one is missing, one unknown
    assert all(word in err for word in words)
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize(
    "arguments",
    [
        ("modes", "nowhere"),
        ("modes", "missing.toml"),
        ("study", "nothing", "--out", "x"),
        ("run", "missing.toml", "--out", "x"),
    ],
)
def test_what_does_not_exist_is_one_line(interarea, tmp_path: Path, monkeypatch, arguments) -> None:  # type: ignore[no-untyped-def]
    monkeypatch.chdir(tmp_path)
    code, out, err = interarea(*arguments)
    assert code == 2 and out == "" and err.count("\n") == 1
    assert arguments[1] in err and not (tmp_path / "x").exists()


def test_a_missing_compiler_is_one_line(interarea, tmp_path: Path, monkeypatch) -> None:  # type: ignore[no-untyped-def]
    monkeypatch.setenv("INTERAREA_CACHE", str(tmp_path / "cache"))
    monkeypatch.setenv("CC", str(tmp_path / "no-such-compiler"))
    code, _, err = interarea("build", "two-area-thesis", "--out", tmp_path / "out")
    assert code == 2 and err.count("\n") == 1 and "no-such-compiler" in err


def test_an_unknown_command_or_option_ends_with_2(interarea) -> None:  # type: ignore[no-untyped-def]
    assert interarea("nonsense")[0] == 2
    assert interarea("modes", "two-area-thesis", "--nonsense")[0] == 2


def test_a_fault_of_ours_says_so_and_ends_with_1(capsys: pytest.CaptureFixture[str], monkeypatch) -> None:  # type: ignore[no-untyped-def]
    monkeypatch.delenv(DEBUG_VARIABLE, raising=False)
    assert complain(ZeroDivisionError("division by zero")) == 1
    assert DEBUG_VARIABLE in capsys.readouterr().err
    monkeypatch.setenv(DEBUG_VARIABLE, "1")
    complain(ZeroDivisionError("division by zero"))
    assert "ZeroDivisionError" in capsys.readouterr().err


def test_what_a_sweep_can_do_again_is_said(interarea, tmp_path: Path) -> None:  # type: ignore[no-untyped-def]
    code, _, said = interarea("sweep", "x.toml", "--out", tmp_path / "o", "--retry", "all")
    assert code == 2 and "--retry = all, allowed: failed" in said


@pytest.mark.slow
def test_screen_writes_its_page_and_says_how_many_slip(interarea, tmp_path: Path) -> None:  # type: ignore[no-untyped-def]
    out = tmp_path / "screen"
    words = ("--bus", "8", "--clearing", "700 ms", "--stop", "3", "--workers", "1", "--out", str(out))
    code, said, _ = interarea("screen", "two-area-thesis", *words)
    assert code == 0
    assert said.splitlines() == ["controller none: 1 of 1 lose synchronism", str(out / "screen.html")]
    assert json.loads((out / "screen.json").read_text())["rows"][0]["verdict"] == "lost"


def test_screen_counts_no_failed_run_of_a_controller_that_does_not_fit(interarea, tmp_path: Path) -> None:  # type: ignore[no-untyped-def]
    words = (
        "--bus",
        "8",
        "--stop",
        "2",
        "--workers",
        "1",
        "--controller",
        "nets_nyps",
        "--out",
        tmp_path / "s",
    )
    code, said, _ = interarea("screen", "two-area-thesis", *map(str, words))
    assert code == 1
    assert said.splitlines()[1].startswith(
        "controller nets_nyps: 0 of 0 lose synchronism, 1 failed, first reason: controller nets_nyps: none of"
    )


@pytest.mark.parametrize(
    "words, why",
    [
        (("--bus", "80"), "no bus 80"),
        (("--bus", "8", "--trips"), "--bus belongs to faults"),
        (("--branch", "7-8 a"), "--branch to --trips"),
        (("--clearing", "soon"), "--clearing = soon, allowed"),
        (("--clearing", "0 cycles"), "--clearing = 0 cycles, allowed"),
        (("--workers", "0"), "--workers N: got 0, allowed: at least 1"),
        (("--controller", "rubost"), "rubost"),
        (("--outage", "7-80"), "7-80"),
    ],
)
def test_screen_refuses_in_one_line(interarea, tmp_path: Path, words, why: str) -> None:  # type: ignore[no-untyped-def]
    code, _, said = interarea("screen", "two-area-thesis", *words, "--out", str(tmp_path / "screen"))
    assert code == 2 and why in said and len(said.splitlines()) == 1


@pytest.mark.slow
def test_build_writes_the_controller_as_a_dll(interarea, tmp_path: Path) -> None:  # type: ignore[no-untyped-def]
    code, out, err = interarea(
        *("build", "two-area-thesis", "--controller", "robust", "--dll", "linux64", "--sample-time", "0.002"),
        *("--out", tmp_path),
    )
    assert code == 0, err
    assert {line.split("/")[-1] for line in out.splitlines()} >= {
        *("robust.so", "channel.so", "pmu.so", "robust.fmu")
    }
    assert RealCodeLibrary(tmp_path / "linux64" / "robust.so").info.sample_time == 0.002
    code, out, err = interarea("container", "lost-signal", "--dll", "linux64", "--out", tmp_path / "chain.so")
    assert code == 0 and (tmp_path / "chain.so").is_file(), err
    code, _, err = interarea("container", "lost-signal", "--dll", "vax", "--out", tmp_path / "chain.so")
    assert code == 2 and "unknown platform 'vax'; allowed: linux64, win64, win32" in err
    code, _, err = interarea("build", "two-area-thesis", "--dll", "linux64", "--out", tmp_path)
    assert code == 2 and "--dll: no controller was named" in err
