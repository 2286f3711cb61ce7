"""`interarea check` on binaries that crash, hang, share or hide data, or compute wrong derivatives."""

from __future__ import annotations

from pathlib import Path

import pytest
from fmu_mutation import in_description, mutated
from fmu_runner import decay_block

from interarea.fmu_build import build_fmu
from interarea.fmu_build.check import check_file
from interarea.models.variables import Variable, VariableTable

FAULTY_C = Path(__file__).resolve().parent / "blocks" / "faulty.c"

#: fault (number in blocks/faulty.c) -> a rule that must be told, words of the message
FAULTS = {
    "crashes": (1, "run: start values", "crashes (SIGABRT)"),
    "hangs": (2, "run: reset", "hangs"),
    "exits": (3, "run: reset", "ended with code 3"),
    "global counter": (4, "FMI2 2.1.5 instances", "differ"),
    "hidden state": (5, "FMI2 2.1.8 FMU state", "differ"),
    "wrong derivative": (6, "FMI2 2.1.9 directional derivative", "differences give -1;"),
    "hidden input": (7, "FMI2 2.2.8 dependencies", "moves with u"),
    "counts steps": (8, "FMI2 4.3.1 variable communication step", "two halves"),
}


def faulty(fault: int, folder: Path) -> Path:
    """Build the lag with one fault; all of them share one binary."""
    table = VariableTable(
        [
            Variable("x", "state", "State", start=1.0),
            Variable("der(x)", "derivative", "Slope", unit="1/s", derivative_of="x", depends_on=("x", "u")),
            Variable("u", "input", "Input", start=0.0),
            Variable("y", "output", "Output", depends_on=("x",)),
            Variable("fault", "parameter", "What is wrong", type="Integer", start=fault),
        ]
    )
    block = decay_block(kind="faulty", name="faulty", table=table, sources=(FAULTY_C,))
    return build_fmu(block, folder)


def test_the_sound_block_is_clean(tmp_path: Path) -> None:
    report = check_file(faulty(0, tmp_path))
    assert report.clean, [f.line() for f in report.findings]
    assert len(report.facts["topics"]) == 18  # nine topics for each interface


@pytest.mark.parametrize(
    "fault", ["crashes", *(pytest.param(f, marks=pytest.mark.slow) for f in FAULTS if f != "crashes")]
)
def test_fault_is_found(fault: str, tmp_path: Path) -> None:
    number, rule, words = FAULTS[fault]
    report = check_file(faulty(number, tmp_path), timeout_s=4.0 if fault == "hangs" else 60.0)
    told = [f.message for f in report.findings if f.rule == rule]
    assert any(words in message for message in told), [f.line() for f in report.findings]


@pytest.mark.slow
def test_capability_that_is_declared_but_fails(built: dict[str, Path], tmp_path: Path) -> None:
    """A channel is no model-exchange FMU: declaring it one is found when it is loaded."""
    lie = in_description("<CoSimulation ", '<ModelExchange modelIdentifier="channel"/><CoSimulation ')
    report = check_file(mutated(built["channel"], tmp_path / "x.fmu", lie))
    assert any("co-simulation only" in f.message for f in report.findings)


def test_a_library_of_another_platform(decay: Path, tmp_path: Path) -> None:
    def swap(entries: dict[str, bytes]) -> None:
        entries["binaries/win64/decay.dll"] = entries["binaries/linux64/decay.so"]
        entries["binaries/linux64/decay.so"] = b"no library at all"

    if "binaries/linux64/decay.so" not in _names(decay):
        pytest.skip("the FMU was built for another platform than linux64")
    rules = [f.rule for f in check_file(mutated(decay, tmp_path / "x.fmu", swap), run=False).findings]
    assert {"FMI2 2.1 platform folder", "binary format"} <= set(rules)


def _names(fmu: Path) -> list[str]:
    import zipfile

    with zipfile.ZipFile(fmu) as archive:
        return archive.namelist()
