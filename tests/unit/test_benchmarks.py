"""Benchmarks without the other tool: the rows it gets, and the plain C loop against the FMU."""

from __future__ import annotations

import math
import sys
from pathlib import Path

import numpy as np
import pytest

from interarea.models.blocks.plant import event_parameters
from interarea.models.case.case import load_case
from interarea.models.case.events import events_of

sys.path.extend(str(Path(__file__).parents[2] / "benchmarks" / name) for name in (".", "peers", "plain"))
import andes_rows
import bench_devices
import bench_plant
import compare_andes


def rows_by_model(case, events=()) -> dict[str, list[dict]]:
    result: dict[str, list[dict]] = {}
    for model, row in andes_rows.rows_of(case, events):
        result.setdefault(model, []).append(row)
    return result


def test_every_device_of_a_case_becomes_one_row():
    case = compare_andes.two_area(compare_andes.RUNS["Efd limits + PSS + TGOV1, bus fault + trip"][0])
    result = rows_by_model(case, events_of(compare_andes.FAULT, where="test"))
    counts = {model: len(rows) for model, rows in result.items()}
    assert counts == {
        "Bus": 11,
        "Line": 12,
        "Shunt": 2,
        "PQ": 2,
        "Slack": 1,
        "PV": 3,
        "GENROU": 4,
        "SEXS": 4,
        "IEEEST": 4,
        "TGOV1": 4,
        "Fault": 1,
        "Toggle": 1,
    }
    machine = case.machines[0]
    row = result["GENROU"][0]
    assert (row["M"], row["Td20"], row["xl"]) == (2 * machine.H, machine.Td02, machine.Xl)
    assert result["Slack"][0]["a0"] == pytest.approx(math.radians(-6.8))
    assert result["Fault"][0]["tc"] == pytest.approx(1.0 + 8 / 60)


def test_quadratic_saturation_has_value_and_slope_of_the_exponential_one():
    """E SE(E) = B (E - A)^2 through two points at 1 % on both sides of Efd0."""
    e = load_case("new-england").machines[1].exciter
    row = rows_by_model(load_case("new-england"))["IEEET1"][1]
    (e1, s1), (e2, s2) = ((row[f"E{k}"], row[f"SE{k}"]) for k in (1, 2))
    root = math.sqrt(e1 * s1 / (e2 * s2))
    A = (e1 - root * e2) / (1 - root)
    B = e2 * s2 / (e2 - A) ** 2
    efd = (e1 + e2) / 2
    exponential = e.Aex * math.exp(e.Bex * efd)
    assert B * (efd - A) ** 2 == pytest.approx(efd * exponential, rel=1e-3)
    assert 2 * B * (efd - A) == pytest.approx(exponential * (1 + e.Bex * efd), rel=1e-3)


def test_load_mix_is_that_of_all_loads():
    case = load_case("kundur-manual")
    shares = {"p2z": 0.0, "p2i": 1.0, "p2p": 0.0, "q2z": 1.0, "q2i": 0.0, "q2q": 0.0}
    assert andes_rows.load_mix(case) == shares
    with pytest.raises(ValueError, match="one voltage characteristic for all loads"):
        andes_rows.load_mix(load_case("nets-nyps"))


@pytest.mark.parametrize(
    ("name", "change", "says"),
    [
        ("kundur-manual", {}, "no saturation is GENROU"),
        (
            "kundur-thyristor-z",
            {"machines": {"G1": {"exciter": {"Efd_min": -5.0, "Efd_max": 5.0}}}},
            "limits with TR > 0",
        ),
        (
            "two-area-thesis",
            {"machines": {"G1": {"stabilizer": {"T5": 0.1, "T6": 0.2}}}},
            "third lead-lag",
        ),
    ],
)
def test_what_the_other_tool_does_not_have_is_refused(name, change, says):
    with pytest.raises(ValueError, match=says):
        andes_rows.rows_of(load_case(name).with_changes(change))


def test_a_missing_tool_is_one_line(tmp_path):
    fake = tmp_path / "python"
    fake.write_text("#!/bin/sh\necho 'ModuleNotFoundError: no such tool' >&2\nexit 1\n")
    fake.chmod(0o755)
    with pytest.raises(RuntimeError, match=r"no such tool \(install the extra `bench`"):
        compare_andes.ask(str(fake), {})


@pytest.mark.parametrize(("theirs", "counts"), [(2.6e-6, 0.01), (1e-3, 0.01), (1e-9, 0.004), (1e-15, 0.001)])
def test_the_ratio_that_counts_is_at_the_longest_step_no_less_accurate(capsys, theirs, counts):
    """Accuracy asked for is 1e-5 pu, or that of the other tool where it does better."""
    errors = {0.001: 1e-13, 0.004: 3e-11, 0.01: 1e-6, 0.02: 2e-5}
    ours = {h: {"cpu": 1e-6 / h, "error": e, "ratio": 200.0 * h / 1e-3} for h, e in errors.items()}
    result = {"andes": {"cpu": 0.2, "error": theirs}, "ours": ours}
    assert bench_plant.print_against_andes("a fault", result) == counts
    lines = capsys.readouterr().out.splitlines()
    assert len(lines) == 3 + len(errors)
    for line, error in zip(lines[3:], errors.values(), strict=True):
        assert ("too coarse" in line) == (error > min(1e-5, theirs))
    assert lines[3].endswith("(default)" if theirs > 1e-13 else "(default)  too coarse")


@pytest.mark.slow
def test_the_fmu_gives_the_bits_of_the_plain_loop():
    """Same right-hand side, same steps: what FMI adds is time, not rounding."""
    from fmu_run import PlantSlave
    from plain_loop import PlainPlant

    case = compare_andes.two_area({"exciter": compare_andes.THYRISTOR})
    change = {"G1.exciter.KA": 150.0}
    loop = PlainPlant(case, change)
    plant = PlantSlave(case, (), 0.01, change)
    loop.cpu_s(2.0, 0.01)
    plant.advance(2.0)
    np.testing.assert_array_equal(loop.states(), plant.outputs(loop.state_names))
    plant.close()


@pytest.mark.slow
def test_steps_of_a_sparse_network_with_ports_follow_the_dense_one():
    """Within steps ports start where their last voltages point to and end far below the step's own error."""
    from plain_loop import PlainPlant

    power = {
        "loads": {q.name: {"P_exponent": 0.0, "Q_exponent": 0.0} for q in load_case("new-england").loads}
    }
    case = load_case("new-england").with_changes(power)
    fault = {"kind": "bus_fault", "bus": 16, "start_s": 0.05, "end_s": 0.12, "x_pu": 0.05}
    slots = event_parameters(case, events_of([fault], where="test"))
    result = []
    for form, step_s in (("dense", 0.005), ("sparse", 0.005), ("dense", 0.0025)):
        loop, speeds = PlainPlant(case, slots, form), []
        at = [k for k, name in enumerate(loop.state_names) if name.endswith(".slip")]
        for begin in np.arange(0.0, 0.99, 0.02):
            loop.events(float(begin), float(begin) + 0.02, step_s)
            speeds.append(loop.states()[at])
        result.append(np.array(speeds))
    dense, sparse, fine = result
    assert np.abs(dense).max() > 1e-3
    off = np.abs(sparse - dense).max()
    assert off < 1e-6 * np.abs(dense).max()
    assert off < 0.1 * np.abs(fine - dense).max()


def test_records_for_both_tools_have_no_saturation_and_no_stabilizer_without_an_exciter():
    text = """
    1 'GENROU' 1 8 0.03 0.4 0.05 6 0 1.8 1.7 0.3 0.5 0.25 0.2 0.1 0.4 /
    1, 'EXST1', 1, 0, 9, -9, 0, 0, 200, 0.02, 5, -5, 0, 0, 1 /  1 'ST2CUT' 1 1 0 0 0 9 /
    2 'ESDC2A' 1 0 1 / 2 'ST2CUT' 1 1 0 0 0 9 /"""
    limited = "3 'IEEEX1' 1 0 50 0.06 0 0 1.0 -1.0 -0.02 0.5 0.08 1 0 2 0.1 3 0.2 /"
    (wide,) = compare_andes.reduced_records(limited, compare_andes.FILES["npcc"][1]).splitlines()
    assert wide == "3 'IEEEX1' 1 0 50 0.06 0 0 99 -99 -0.02 0.5 0.08 1 0 0 0 0 0 /"
    remaining = compare_andes.reduced_records(text, compare_andes.FILES["wecc"][1]).splitlines()
    assert [line.split()[:2] for line in remaining] == [
        ["1", "'GENROU'"],
        ["1", "'EXST1'"],
        ["1", "'ST2CUT'"],
    ]
    assert remaining[0].endswith("0.25 0.2 0 0 /") and remaining[1].endswith("0 0 1 /")


@pytest.mark.slow  # compiles every device three times
@pytest.mark.parametrize("which", range(3), ids=[d.name for d in bench_devices.DEVICES])
@pytest.mark.parametrize("together", [False, True])
def test_devices_by_hand_give_what_generated_ones_give(which: int, together: bool) -> None:
    """Nine machines: not a whole number of tiles."""
    pair = bench_devices.Pair(which, 9)
    by_hand = pair.rates(hand=True)
    assert np.abs(by_hand).max() > 0.5
    assert pair.rates(hand=False, together=together) == pytest.approx(by_hand, rel=1e-12, abs=1e-12)
