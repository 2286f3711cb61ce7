"""`interarea design`: the alternatives side by side, in a table and in figures that show what they say."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import control
import matplotlib.image
import numpy as np
import pytest
from typer.testing import CliRunner

from interarea.cli.app import app
from interarea.cosim.designs.comparison import Alternative, compare, effort_figure, sensitivity_figure
from interarea.cosim.designs.design_file import load_design, specification_of
from interarea.cosim.run.controllers import controller_of
from interarea.design.controllers.bundled import shipped_controller
from interarea.fmu_build.write.cache import default_cache
from interarea.models.case.case import load_case
from interarea.models.case.write_toml import export_toml, toml_text

SMALL = """
name = "small"
case = "two-area-thesis"
remote = "G2_dw"
local = "G4_dw"
actuator = "G4_vs"
conditions = ["N", "L"]
order = 4
starts = 2
evaluations = 300
polishes = 0
[ask]
worst_swing = WANTED
[[point]]
name = "base"
"""


def spec_file(folder: Path, worst_swing: float) -> Path:
    path = folder / "small.toml"
    path.write_text(SMALL.replace("WANTED", str(worst_swing)), encoding="utf-8")
    return path


@pytest.mark.slow
def test_design_shows_what_was_tried_and_draws_it(tmp_path: Path, cache: Path) -> None:
    out, plots = tmp_path / "small.json", tmp_path / "plots"
    arguments = ["design", str(spec_file(tmp_path, 0.1)), "--out", str(out), "--against", "robust"]
    done = CliRunner().invoke(app, [*arguments, "--plots", str(plots)], env={"COLUMNS": "140"})
    assert done.exit_code == 0, done.output
    for name in ("small", "start 1", "start 2", "robust"):
        assert name in done.output
    design = json.loads(out.read_text())
    assert len(design["A"]) == 4
    assert design["certificate"]["passed"] is True
    assert design["certificate"]["worst_swing"] >= 0.1
    drawn = sorted(p.name for p in plots.iterdir())
    assert drawn == ["controller-gain.png", "effort-damping.png", "root-loci.png", "sensitivity.png"]
    for name in drawn:
        picture = matplotlib.image.imread(plots / name)
        assert picture.shape[0] > 300 and picture.std() > 0.02  # something is on it


@pytest.mark.slow
def test_a_design_that_misses_what_was_asked_says_so_and_fails(tmp_path: Path, cache: Path) -> None:
    out = tmp_path / "small.json"
    done = CliRunner().invoke(app, ["design", str(spec_file(tmp_path, 0.6)), "--out", str(out)])
    assert done.exit_code == 1
    assert "worst swing damping is" in done.output and "required >= 0.6" in done.output
    assert json.loads(out.read_text())["certificate"]["passed"] is False  # kept, and marked


def test_the_figures_draw_the_numbers_of_the_verdict(tmp_path: Path, cache: Path) -> None:
    table = load_design(spec_file(tmp_path, 0.1))
    K = shipped_controller("robust").system
    still = control.ss(K.A, K.B, 0.0 * K.C, 0.0 * K.D, inputs=K.input_labels, outputs=K.output_labels)
    result = compare(table, {"robust": K, "none": still}, cache)
    assert [a.name for a in result] == ["robust", "none"]
    assert result[1].verdict.effort == pytest.approx(0.0, abs=1e-12)
    assert result[1].verdict.inter_area == pytest.approx(0.081, abs=2e-3)  # the open loop's
    assert result[0].cells()[1:4] == (
        "6",
        f"{result[0].verdict.worst_swing:.4f}",
        f"{result[0].verdict.inter_area:.4f}",
    )
    dots = [tuple(line.get_xydata()[0]) for line in effort_figure(result, 0.16, 0.1).axes[0].lines]
    assert dots[0] == pytest.approx((result[0].verdict.effort, result[0].verdict.worst_swing))
    assert dots[1] == pytest.approx((result[0].verdict.effort, result[0].verdict.inter_area))


def test_sensitivity_of_a_loop_in_closed_form() -> None:
    # K = -1, G = 1/(s+1): S = (s+1)/(s+2)
    G = control.ss([[-1.0]], [[1.0]], [[1.0]], [[0.0]], inputs=["G4_vs"], outputs=["G4_dw"])
    K = control.ss([[-1e6]], [[-1e3]], [[1e3]], [[0.0]], inputs=["G4_dw"], outputs=["G4_vs"])
    from interarea.design.robust.operating_points import FamilyCertificate

    verdict = FamilyCertificate((), 1.0, 1.0, 1.0, 1e6, ())
    line = sensitivity_figure(G, (Alternative("lag", K, verdict),), "base").axes[0].lines[0]
    s = 1j * np.asarray(line.get_xdata())
    assert np.asarray(line.get_ydata()) == pytest.approx(np.abs((s + 1) / (s + 2)), rel=1e-3)


def test_a_design_and_its_controller_name_a_case_beside_them(
    interarea: Any, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    """As a study of an imported grid writes them; used from another folder."""
    folder, elsewhere = tmp_path / "study", tmp_path / "elsewhere"
    folder.mkdir()
    elsewhere.mkdir()
    export_toml(load_case("two-area-thesis"), folder / "case.toml")
    robust = shipped_controller("robust")
    specification = {**robust.design["specification"], "case": "case.toml"}
    replace(robust, design={**robust.design, "specification": specification}).save(folder / "k.json")
    keys = load_design("robust").model_dump(mode="json", exclude_none=True, exclude_unset=True)
    text = toml_text({**keys, "case": "case.toml"})
    (folder / "k.design.toml").write_text(text, encoding="utf-8")
    monkeypatch.chdir(elsewhere)
    assert load_design(folder / "k.design.toml").grid.name == "two-area-thesis"
    controller = controller_of(str(folder / "k.json"), load_case("two-area-thesis"), default_cache())
    assert controller is not None
    table = specification_of(controller)
    assert table is not None and table.grid.hash == load_case("two-area-thesis").hash
