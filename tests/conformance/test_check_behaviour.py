"""`interarea check` on binaries that crash, hang, share or hide data, or compute wrong derivatives."""

from __future__ import annotations

from pathlib import Path

import pytest
from fmu_mutation import in_description, mutated
from fmu_runner import decay_block

from interarea.fmu_build.check.check import check_file
from interarea.fmu_build.write.package import build_fmu
from interarea.models.blocks.variables import Variable, VariableTable

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


@pytest.mark.slow
def test_the_sound_block_is_clean(tmp_path: Path) -> None:
    report = check_file(faulty(0, tmp_path))
    assert report.clean, [f.line() for f in report.findings]
    assert len(report.facts["topics"]) == 22  # eleven topics for each interface


@pytest.mark.parametrize(
    "fault", ["crashes", *(pytest.param(f, marks=pytest.mark.slow) for f in FAULTS if f != "crashes")]
)
def test_fault_is_found(fault: str, tmp_path: Path) -> None:
    number, rule, words = FAULTS[fault]
    report = check_file(faulty(number, tmp_path), timeout_s=4.0 if fault == "hangs" else 60.0)
    reported = [f.message for f in report.findings if f.rule == rule]
    assert any(words in message for message in reported), [f.line() for f in report.findings]


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


def test_what_a_binary_needs_and_shows(tmp_path: Path) -> None:
    """A library of the system's compiler: newer glibc, names beside FMI's, a library that is nowhere."""
    import shutil
    import subprocess

    from interarea.fmu_build.check.binary import check_binaries
    from interarea.fmu_build.finding import Report
    from interarea.fmu_build.open.description import read_description
    from interarea.fmu_build.open.images import read_image

    if shutil.which("gcc") is None:
        pytest.skip("no gcc here to make such a library with")
    folder = tmp_path / "binaries" / "linux64"
    folder.mkdir(parents=True)
    (tmp_path / "odd.c").write_text("int odd(int x) { return x; }\nint even(int x) { return odd(x); }\n")
    (tmp_path / "own.c").write_text("int odd(int);\nint fmi2Own(void) { return odd(1); }\nint own;\n")
    gcc = ["gcc", "-shared", "-fPIC"]
    subprocess.run([*gcc, "odd.c", "-o", "libodd.so"], cwd=tmp_path, check=True)
    link = ["-L.", "-lodd", "-Wl,-rpath,/opt/odd", "-Wl,--no-as-needed"]
    subprocess.run([*gcc, "own.c", "-o", str(folder / "m.so"), *link], cwd=tmp_path, check=True)
    image = read_image((folder / "m.so").read_bytes())
    assert {"fmi2Own", "own"} <= set(image.exports) and "odd" not in image.exports
    assert "libodd.so" in image.needed and image.search_path == "/opt/odd"

    from lxml import etree

    text = '<fmiModelDescription fmiVersion="2.0"><CoSimulation modelIdentifier="m"/></fmiModelDescription>'
    report = Report("m.fmu")
    check_binaries(read_description(etree.fromstring(text)), tmp_path, report)
    reported = {f.rule: f.message for f in report.findings}
    assert "libodd.so" in reported["binary libraries"]
    assert "exports 1 names beside FMI's (own)" in reported["binary symbols"]
    assert "/opt/odd" in reported["binary search path"]
    assert "fmi2CancelStep" in reported["FMI2 2.1.1 exported functions"]
    shutil.copy(tmp_path / "libodd.so", folder)
    again = Report("m.fmu")
    check_binaries(read_description(etree.fromstring(text)), tmp_path, again)
    assert "binary libraries" not in {f.rule for f in again.findings}


@pytest.mark.slow
@pytest.mark.timeout(1200)  # zig builds the libraries of each system first: three minutes alone
def test_libraries_of_every_platform_are_read(tmp_path: Path) -> None:
    """ELF, PE and Mach-O of one block: the same functions, nothing but system libraries, old enough glibc."""
    platforms = ["linux64", "win64", "darwin64", "darwin-arm64", "linux-arm64"]
    report = check_file(build_fmu(decay_block(), tmp_path, platforms=platforms), run=False)
    assert report.clean, [f.line() for f in report.findings]
    facts = report.facts["binaries"]
    result = sorted((f["format"], f["machine"]) for f in facts.values())
    both = [("ELF", "arm64"), ("ELF", "x86_64"), ("Mach-O", "arm64")]
    assert result == [*both, ("Mach-O", "x86_64+arm64"), ("PE", "x86_64")]
    assert len({f["exports"] for f in facts.values()}) == 1
