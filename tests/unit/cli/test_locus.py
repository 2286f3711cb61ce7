"""`interarea modes --along`: modes over a number of a case or its controller."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from interarea.cosim.designs.sensitivities import all_mode_sensitivities
from interarea.cosim.run.artefacts import plant_for_controllers, sparse_linear_plant
from interarea.design.modes.all_modes import all_modes
from interarea.design.modes.locus import follow
from interarea.fmu_build.write.cache import default_cache
from interarea.locus import LocusError, along_of, draw_locus, locus_of, save_locus
from interarea.models.case.case import load_case
from interarea.synthesis import load_controller

REGION = ((0.1, 1.0), 0.5)
L7 = "loads.L7.P_mw"


def test_modes_that_nearly_meet_keep_their_damping() -> None:
    """Roots of s^2 + 2 d s + w^2 pass each other in frequency between two of the values."""

    def spectrum(p: float) -> dict[str, complex]:
        named = {"slow": (0.05, 4.0 + 2.0 * p), "fast": (0.4, 6.0 - 3.0 * p)}
        roots = [complex(-d, np.sqrt(w * w - d * d)) for d, w in named.values()]
        return dict(
            zip(("a", "b"), sorted(roots, key=lambda z: z.imag), strict=True)
        )  # names are by position

    locus = follow(spectrum, [0.0, 0.35, 0.7])
    for track, damping in zip(locus.modes.values(), (0.05, 0.4), strict=True):
        assert -track.real == pytest.approx(damping, rel=1e-12)


def test_a_mode_that_leaves_ends_and_one_that_comes_begins() -> None:
    locus = follow(lambda p: {"a": 1j} if p < 1.5 else {"a": 1j, "b": 9j}, [0.0, 1.0, 2.0])
    assert (
        list(locus.modes) == ["a", "b"] and np.isnan(locus.modes["b"][:2]).all() and locus.modes["b"][2] == 9j
    )
    assert len(locus.rows()) == 4


@pytest.mark.parametrize(
    "text", ["KA", "KA=1", "KA=1:1", "KA=1:2:1", "KA=a:2", "=1:2", "KA=1:2:3:4", "KA=1:inf"]
)
def test_what_is_no_range_is_refused(text: str) -> None:
    with pytest.raises(LocusError, match="--along"):
        along_of(text)
    assert along_of("branches.8-9 a.x=1:2:3") == ("branches.8-9 a.x", [1.0, 1.5, 2.0])


@pytest.mark.parametrize(
    ("key", "said"),
    [
        ("machines.G9.H", "no row 'G9' in machines; did you mean"),
        ("machines.G1.exciter.KQ", "no field 'KQ'"),
        ("controller.gian", "no such key of a controller; did you mean controller.gain"),
        ("controller.gain", "name the controller with --controller"),
    ],
)
def test_a_key_that_is_not_there_is_one_line(interarea, key: str, said: str) -> None:  # type: ignore[no-untyped-def]
    code, _, err = interarea("modes", "two-area-thesis", "--along", f"{key}=1:2")
    assert code == 2 and said in err and len(err.strip().splitlines()) == 1


@pytest.mark.slow
def test_the_locus_has_the_slope_of_the_sensitivity_and_saves_its_matrices(tmp_path: Path) -> None:
    case, cache = load_case("two-area-thesis"), default_cache()
    value = case.load("L7").P_mw
    locus = locus_of(case, L7, [value - 2.0, value, value + 2.0], REGION)
    modes = all_modes(sparse_linear_plant(case, cache), case.areas, band_hz=REGION[0], below=REGION[1]).modes
    known = all_mode_sensitivities(case, modes, [L7], cache)[L7]
    assert set(locus.modes) == {mode.name for mode in modes}
    for name, track in locus.modes.items():
        assert (track[2] - track[0]) / 4.0 == pytest.approx(known[name].derivative, rel=1e-4)
    files = save_locus(locus, case, tmp_path / "out")
    with np.load(files[3]) as saved:
        assert saved["value"] == value
        nearest = min(np.linalg.eigvals(saved["A"]), key=lambda z: abs(z - locus.modes["inter-area"][1]))
    assert abs(nearest - locus.modes["inter-area"][1]) < 1e-8
    assert draw_locus(locus, tmp_path / "out").is_file() and len((tmp_path / "out" / "locus.csv").read_text())


@pytest.mark.slow
def test_the_gain_of_a_controller_goes_from_the_grid_alone_to_the_loop() -> None:
    """At 0 a root of the plant's matrix, at 1 one of the plant and the controller put together."""
    case, controller = load_case("two-area-thesis"), load_controller("robust_linear")
    locus = locus_of(case, "controller.gain", [0.0, 0.5, 1.0], REGION, controller=controller)
    plant = plant_for_controllers(case, default_cache())
    system = controller.system
    rows = [plant.output_labels.index(name) for name in system.input_labels]
    columns = [plant.input_labels.index(name) for name in system.output_labels]
    B, C = plant.B[:, columns], plant.C[rows]
    closed = np.block([[plant.A + B @ system.D @ C, B @ system.C], [system.B @ C, system.A]])
    for k, A in ((0, plant.A), (2, closed)):
        roots = np.linalg.eigvals(A)
        there = [track[k] for track in locus.modes.values() if np.isfinite(track[k])]
        assert there and max(np.abs(roots - z).min() for z in there) < 1e-6
