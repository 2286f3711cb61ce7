"""Seeds of `interarea check` that only the binary, or arithmetic, gives away; and what was not run."""

from __future__ import annotations

import json
import re
from collections.abc import Callable
from pathlib import Path

import pytest
from fmu_mutation import Entries, mutated
from fmu_runner import decay_block

from interarea.fmu_build.check.check import check_file
from interarea.fmu_build.write import package

Edit = Callable[[Entries], None]


def attribute(pattern: str, new: str) -> Edit:
    """Return an edit of the first place in the description where `pattern` matches."""

    def edit(entries: Entries) -> None:
        text, count = re.subn(pattern, new, entries["modelDescription.xml"].decode(), count=1)
        assert count == 1, pattern
        entries["modelDescription.xml"] = text.encode()

    return edit


#: seed -> (edit of the first-order lag, rule, words)
SEEDS: dict[str, tuple[Edit, str, str]] = {
    "three event indicators": (
        attribute(r'numberOfEventIndicators="0"', 'numberOfEventIndicators="3"'),
        "FMI2 2.2.1 numberOfEventIndicators",
        "3 are declared",
    ),
    "output derivatives of order 2": (
        attribute(r'maxOutputDerivativeOrder="1"', 'maxOutputDerivativeOrder="2"'),
        "FMI2 4.3.1 maxOutputDerivativeOrder",
        "order 2 is refused",
    ),
    "tunable that is fixed": (
        attribute(r'(name="kick.size"[^>]*variability=)"fixed"', r'\1"tunable"'),
        "FMI2 2.2.7 tunable",
        "cannot be set after initialization",
    ),
    "discrete input that is none": (
        attribute(r'(name="u"[^>]*?)( variability="continuous")?(>)', r'\1 variability="discrete"\3'),
        "FMI2 4.2.1 input derivatives",
        "declared discrete",
    ),
    "unit with factor 0": (
        attribute(r'<Unit name="1/s">\s*<BaseUnit ', '<Unit name="1/s"><BaseUnit factor="0" '),
        "FMI2 2.2.2 units",
        "factor = 0",
    ),
}


@pytest.mark.slow
@pytest.mark.parametrize("seed", SEEDS)
def test_seed_is_found(seed: str, decay: Path, tmp_path: Path) -> None:
    edit, rule, words = SEEDS[seed]
    report = check_file(mutated(decay, tmp_path / "x.fmu", edit), run=seed != "unit with factor 0")
    reported = [f for f in report.findings if f.rule == rule]
    assert reported and any(words in f.message for f in reported), [f.line() for f in report.findings]


@pytest.mark.slow
def test_a_state_that_shrinks_by_a_thousandth_a_step(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """fmi2DoStep multiplies the state by 0.999: no longer the equations of model exchange."""
    original = package.source_files
    line = b"step_consume_inputs(c, step);"

    def changed(sources: tuple[Path, ...]) -> dict[str, bytes]:
        files = original(sources)
        assert files["fmi2_cs.c"].count(line) == 1
        files["fmi2_cs.c"] = files["fmi2_cs.c"].replace(line, line + b" if (b->layout.n_x) b->x[0] *= 0.999;")
        return files

    monkeypatch.setattr(package, "source_files", changed)
    report = check_file(package.build_fmu(decay_block(name="shrinks"), tmp_path))
    reported = [f for f in report.findings if f.rule == "FMI2 4.3.1 one model"]
    assert len(reported) == 1 and reported[0].where.endswith("x"), [f.line() for f in report.findings]


def test_what_was_not_run_is_not_clean(decay: Path, tmp_path: Path) -> None:
    from click.testing import CliRunner

    from interarea.cli.app import load

    report = check_file(decay, run=False)
    assert report.clean and report.verdict.startswith("not run (as was asked for)")
    assert report.as_dict()["clean"] is False and report.as_dict()["verdict"] == "not run"

    def no_binary(entries: Entries) -> None:
        for name in [n for n in entries if n.startswith("binaries/")]:
            entries["binaries/win32/decay.dll"] = entries.pop(name)

    moved = check_file(mutated(decay, tmp_path / "x.fmu", no_binary))
    assert moved.verdict != "clean"
    said = CliRunner().invoke(load("check"), [str(decay), "--no-run"])
    assert said.exit_code == 0 and "not run" in said.stdout and "clean" not in said.stdout
    shown = CliRunner().invoke(load("check"), [str(decay), "--no-run", "--json"])
    assert json.loads(shown.stdout)["not_run"] == ["as was asked for"]
