"""Curves of damping over latency and scale: the roots of the loop itself, and their page."""

from pathlib import Path

import numpy as np
import pytest

from interarea.cosim.designs.design_file import load_design
from interarea.cosim.designs.family import family_plants
from interarea.cosim.maps import tolerance
from interarea.cosim.maps.tolerance import LATENCY, SCALE, damping_curves, write_tolerance
from interarea.design.certificates.signal_margins import ALL
from interarea.design.controllers.bundled import shipped_controller
from interarea.design.delay.curves import delayed_loop, rightmost_roots
from interarea.fmu_build.write.cache import default_cache


@pytest.mark.slow
def test_each_point_is_the_least_damped_swing_of_its_loop_and_the_page_shows_the_margins(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(tolerance, "LATENCIES_S", (0.0, 0.2, 0.4))
    monkeypatch.setattr(tolerance, "SCALES", (0.0, 1.0, 3.0))
    table, K = load_design("robust_latency"), shipped_controller("robust_latency").system
    rows, margins = damping_curves(table, K, default_cache())
    assert [(r.over, r.signal) for r in rows[::3]] == [
        *((LATENCY, s) for s in (ALL, "G2_dw", "G4_dw")),
        *((SCALE, s) for s in ("G2_dw", "G4_dw")),
    ]
    table = table.model_copy(update={"point": table.point[:1]})
    plant = family_plants(table, default_cache())[table.point[0].name].judged
    for row in rows:
        late = {ALL: dict.fromkeys(K.input_labels, row.value)}.get(row.signal, {row.signal: row.value})
        over = {"latency_s_of": late} if row.over == LATENCY else {"scale_of": {row.signal: row.value}}
        roots = rightmost_roots(delayed_loop(plant, K, **over), right_of=-2.5)
        roots = roots[(np.abs(roots.imag) > 0.2 * np.pi) & (np.abs(roots.imag) < 5.0 * np.pi)]
        assert row.worst_swing == pytest.approx(float(np.min(-roots.real / np.abs(roots))), abs=1e-9)
    scaled = {r.value: r for r in rows if (r.over, r.signal) == (SCALE, "G2_dw")}
    upper = next(m for m in margins if m["signal"] == "G2_dw")["upper"]
    assert scaled[1.0].stable and not scaled[3.0].stable and 1.0 < upper["value"] < 3.0
    page = write_tolerance(
        tmp_path / "page.html", "robust_latency", table, rows, margins, margins, "the command"
    )
    text = page.read_text(encoding="utf-8")
    assert f"{1000 * margins[0]['delay']['value']:.0f}" in text and "the command" in text
    assert text.count("<figure>") == 2


def test_a_signal_that_the_controller_does_not_answer_has_no_curve(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(tolerance, "LATENCIES_S", (0.0,))
    monkeypatch.setattr(tolerance, "SCALES", (0.0,))
    table, K = load_design("robust"), shipped_controller("robust").system
    B = np.asarray(K.B) * [[0.0, 1.0]]
    deaf = type(K)(
        K.A, B, K.C, np.asarray(K.D) * [[0.0, 1.0]], inputs=K.input_labels, outputs=K.output_labels
    )
    rows, margins = damping_curves(table, deaf, default_cache())
    assert {r.signal for r in rows} == {"G4_dw"} == {m["signal"] for m in margins}
