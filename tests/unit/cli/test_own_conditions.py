"""`certify` of a controller without a design: plain conditions, or those of one's own."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import control
import numpy as np
import pytest
from command_line import invoke

import interarea as ia
from interarea.cosim.designs.certificate_words import drive_in_words
from interarea.synthesis import judged_and_design


def own(gain: float = 0.02) -> ia.Controller:
    """Return lead compensators on two speeds, as docs/own_controller.md has them."""
    s = control.tf("s")
    K = control.ss(gain * 10 * s / (1 + 10 * s) * ((1 + 0.2 * s) / (1 + 0.05 * s)) ** 2)
    names: dict[str, Any] = {"inputs": ["G2_dw", "G4_dw"], "outputs": ["G4_vs"]}
    return ia.Controller.of(control.ss(K.A, K.B @ [[-1, 1]], K.C, K.D @ [[-1, 1]], **names))


@pytest.mark.slow
def test_it_is_judged_under_plain_conditions_and_by_stability_alone() -> None:
    _, judge = judged_and_design(own(), None, None)
    late, lost = ("N", "s50", "s100", "s150", "s200"), ("L:G2_dw", "L:G4_dw")
    assert judge.conditions == (*late, *lost, "s200+L:G2_dw", "s200+L:G4_dw")
    assert (judge.case, [point.name for point in judge.point]) == ("two-area-thesis", ["as it is"])
    certificate = ia.certify(own(), conditions=["N", "s200"])
    table = certificate.to_frame().set_index("condition")
    # the loop without delay, closed by hand: one path that shares no delay code
    plant = ia.linearise("two-area-thesis")[["G2_dw", "G4_dw"], ["G4_vs"]]
    assert "speeds in pu" in str(ia.linearise("two-area-thesis").name)
    in_rad = control.ss(plant.A, plant.B, 2 * np.pi * 60 * plant.C, 2 * np.pi * 60 * plant.D)
    model = ia.linearise("two-area-thesis", speeds="rad/s")[["G2_dw", "G4_dw"], ["G4_vs"]]
    assert np.allclose(model.C, in_rad.C, rtol=1e-12)
    with pytest.raises(ia.UserError, match="speeds = 'Hz', allowed: 'pu', 'rad/s'"):
        ia.linearise("two-area-thesis", speeds="Hz")
    closed = control.feedback(in_rad, own().system, sign=1)
    rightmost = max(z.real for z in closed.poles() if abs(z) > 1e-6)
    assert table.rightmost["N"] == pytest.approx(rightmost, rel=1e-5)
    assert not certificate.ok
    assert certificate.violations[0] == "as it is, s200: unstable"


@pytest.mark.slow
def test_own_conditions_alone_decide() -> None:
    assert ia.certify(own(), conditions=["N", "s100", "L:G2_dw"]).ok
    wrong_sign = ia.certify(own(-0.02), conditions=["N"])  # it was stable without control
    assert not wrong_sign.ok
    with pytest.raises(
        ia.UserError, match=r"condition 'L:G7_dw': parts are N, s<ms>, L:<one of G2_dw, G4_dw>"
    ):
        ia.certify(own(), conditions=["L:G7_dw"])
    with pytest.raises(ia.UserError, match="conditions and the design robust, allowed: one of them"):
        ia.certify(own(), spec="robust", conditions=["N"])


@pytest.mark.slow
def test_the_command_exits_with_what_was_found(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    own().save("mine.json")
    code, out, _ = invoke(("certify", "mine.json", "--conditions", "N,s100"), monkeypatch)
    assert code == 0
    assert "other operating points" in out.splitlines()[0]
    assert out.splitlines()[-2] == "passed"
    assert invoke(("certify", "mine.json", "--conditions", "N,s300"), monkeypatch)[0] == 1
    code, _, complaint = invoke(("certify", "mine.json", "--acceptance"), monkeypatch)
    assert code == 2
    assert "has no faults; give a design with faults (--spec)" in complaint


@pytest.mark.parametrize(
    ("predicted", "synchronous", "shown"),
    [("kept", True, True), ("kept", False, False), ("lost", True, False), ("uncertain", False, True)],
)
def test_no_prediction_stands_beside_its_refutation(predicted: str, synchronous: bool, shown: bool) -> None:
    line = drive_in_words(0.01, predicted, [{"synchronism": True}, {"synchronism": synchronous}])
    assert line.startswith("drive after the fault 0.010 pu")
    assert ("(predicted)" in line) == shown
