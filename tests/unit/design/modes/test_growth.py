"""One verdict on the whole spectrum: what grows is told, what stands at 0 is not taken for growth."""

from types import SimpleNamespace

import numpy as np
import pytest
from grid_text import raw_text

import interarea as ia
from interarea.cosim.run.artefacts import growth_at_rest, sparse_linear_plant
from interarea.design.linear.resolvent import OpenLoop
from interarea.design.modes import growth
from interarea.design.modes.all_modes import all_modes
from interarea.design.modes.growth import Growth, growth_of, growth_of_plant
from interarea.design.modes.modes import modes_of
from interarea.fmu_build.write.cache import default_cache
from interarea.models.case.case import load_case


def swings(real: float, omega_b: float = 377.0) -> np.ndarray:
    """Two machines against each other without damping, all angles together free, and one real eigenvalue."""
    A = np.zeros((5, 5))
    A[0, 2] = A[1, 3] = omega_b
    stiffness = np.array([[-0.11, 0.11], [0.07, -0.07]])
    A[2:4, 0:2] = stiffness
    A[4, 4] = real
    return A


LABELS = ["G1.delta", "G2.delta", "G1.slip", "G2.slip", "G1.exciter.x"]


def test_a_common_angle_and_a_common_speed_are_no_growth() -> None:
    """Their Jordan block of two splits to +-sqrt(eps) under rotations of the states; 40 of them."""
    rng = np.random.default_rng(3)
    for _ in range(40):
        Q = np.linalg.qr(rng.standard_normal((5, 5)))[0]
        A = swings(-1.0)
        A[2, 2] = A[3, 3] = 0.0
        growth = growth_of(Q.T @ A @ Q, LABELS)
        assert growth.stable, growth.text


@pytest.mark.parametrize("real", [1e-4, 0.0213, 3.0])
def test_a_real_eigenvalue_that_grows_is_told(real: float) -> None:
    growth = growth_of(swings(real), LABELS)
    assert (growth.stable, growth.counted) == (False, 1)
    assert growth.growing[0].eigenvalue == pytest.approx(real)
    assert growth.text.startswith("UNSTABLE: 1 of 5 eigenvalues grows: +")
    assert "real, doubles in" in growth.text
    assert "G1.exciter.x 1.000" in growth.text


def test_a_pair_that_grows_is_told_once_and_counted_twice() -> None:
    A = np.array([[0.3, 5.0], [-5.0, 0.3]])
    growth = growth_of(A, ["a", "b"])
    assert (growth.counted, len(growth.growing)) == (2, 1)
    assert growth.growing[0].eigenvalue == pytest.approx(0.3 + 5.0j)
    assert "0.7958 Hz, damping ratio -0.0599" in growth.text
    assert growth.as_dict()["stable"] is False


def test_a_plant_without_states_grows_nowhere() -> None:
    assert growth_of(np.zeros((0, 0)), []) == Growth((), 0, 0, 1e-6)


@pytest.mark.parametrize("name", ["kundur-thyristor-z", "nets-nyps-no-pss", "two-area-thesis"])
def test_the_count_and_all_eigenvalues_agree(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """By the argument principle and a search, as for a grid too large for all eigenvalues, and by QR."""
    plant = sparse_linear_plant(load_case(name), default_cache())
    whole = growth_of_plant(plant)
    monkeypatch.setattr(growth, "WHOLE", 0)
    monkeypatch.setattr(growth, "_DENSE", 0)
    counted = growth_of_plant(plant)
    assert counted.counted == whole.counted
    both = list(zip(counted.growing, whole.growing, strict=True))
    assert all(abs(a.eigenvalue - b.eigenvalue) < 1e-6 for a, b in both)
    shares = [(list(a.states.values()), list(b.states.values())) for a, b in both]
    assert all(a == pytest.approx(b, abs=1e-5) for a, b in shares)


def test_what_no_search_finds_is_counted_all_the_same(monkeypatch: pytest.MonkeyPatch) -> None:
    plant = sparse_linear_plant(load_case("kundur-thyristor-z"), default_cache())
    monkeypatch.setattr(growth, "WHOLE", 0)
    monkeypatch.setattr(growth, "_DENSE", 0)
    monkeypatch.setattr(growth, "_CENTRES", ())
    result = growth_of_plant(plant, OpenLoop(plant))
    assert not result.stable
    assert "2 more were counted but not computed" in result.text


@pytest.mark.parametrize("name", ["two-area-thesis", "new-england", "nets-nyps-no-pss"])
def test_both_forms_name_the_swing_modes_alike(name: str) -> None:
    case = load_case(name)
    plant = sparse_linear_plant(case, default_cache())
    C = np.zeros((len(plant.machines), plant.nstates))
    C[np.arange(len(plant.machines)), plant.speed] = 1.0
    speeds = [f"{m}_dw" for m in plant.machines]
    system = SimpleNamespace(A=plant.state_matrix(), C=C, state_labels=plant.states, output_labels=speeds)
    named = modes_of(system, case.areas)  # type: ignore[arg-type]
    assert named.growth is not None
    assert named.growth.counted == growth_of_plant(plant).counted
    result = {mode.name: mode for mode in all_modes(plant, case.areas, band_hz=(0.05, 4.0), below=0.5).modes}
    assert set(named) <= set(result)
    assert all(abs(result[n].eigenvalue - named[n].eigenvalue) < 1e-6 for n in named)
    others = set(result) - set(named)
    assert all(n.startswith(("control", "common frequency")) for n in others)


@pytest.mark.slow
def test_every_report_of_modes_begins_with_the_verdict(interarea) -> None:  # type: ignore[no-untyped-def]
    case = "kundur-thyristor-z"
    start = "UNSTABLE: 2 of 32 eigenvalues grow: +0.01415 ± 3.8291j 1/s"
    for options in ((), ("--band", "0.1:2.5", "--below", "0.2"), ("--sensitivity", "machines.G1.H")):
        code, out, _ = interarea("modes", case, *options)
        assert code == 0
        assert out.startswith(start)
    shown = ia.modes(case)
    assert not shown.growth.stable
    assert repr(shown).startswith(f"Modes({case}: {start}")
    assert "UNSTABLE" in shown._repr_html_()
    assert repr(ia.modes("two-area-thesis")).startswith(
        "Modes(two-area-thesis: stable: of 56 eigenvalues none"
    )


def test_a_case_without_dynamics_has_no_verdict() -> None:
    case = load_case("two-area-thesis")
    machines = tuple(m.model_copy(update={"model": "power_flow"}) for m in case.machines)
    assert growth_at_rest(case.model_copy(update={"machines": machines}), default_cache()) is None


def test_a_run_of_a_grid_that_grows_tells_it() -> None:
    from interarea.cosim.run.run import run_system

    at_rest = {"case": "kundur-thyristor-z", "controller": "none", "stop_s": 0.1, "title": "at rest"}
    with pytest.warns(UserWarning, match="at the equilibrium and without a controller: UNSTABLE: 2 of 32"):
        result = run_system(at_rest)
    assert any("UNSTABLE" in line for line in result.warnings)


MACHINES = "".join(
    f"{k} 'GENROU' '1' 8.0 0.03 0.4 0.05 {H} 0.0 1.8 1.7 0.3 0.55 0.25 0.2 0.0 0.0 /\n"
    for k, H in ((1, 6.5), (2, 6.5), (3, 6.175), (4, 6.175))
)
EXCITERS = "".join(
    f"{k} 'IEEET1' 1 0.02 400 0.05 20.0 -20.0 1.0 0.9 0.0 1.0 0 2.8 0.0 3.73 0.0 /\n" for k in (1, 2, 3, 4)
)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("dyr", "lines"),
    [
        (
            MACHINES + EXCITERS,
            ("UNSTABLE: 4 of 36", "+1.177 ± 6.0769j 1/s", "+0.9233 ± 5.1060j 1/s", "G3.exciter"),
        ),
        (MACHINES, ("UNSTABLE: 1 of 24 eigenvalues grows", "+0.0213", "real")),
    ],
    ids=["exciters", "a real one"],
)
def test_what_grows_beside_damped_swings_is_told(  # type: ignore[no-untyped-def]
    interarea, tmp_path, dyr, lines
) -> None:
    """Three swing modes are well damped; what grows is of the exciters, or real."""
    raw, file, out = (tmp_path / name for name in ("grid.raw", "grid.dyr", "grid.toml"))
    raw.write_text(raw_text(load_case("kundur-thyristor-z")))
    file.write_text(dyr)
    _, _, err = interarea("import", str(raw), "--dyr", str(file), "--out", str(out))
    verdict = next(line for line in err.splitlines() if line.startswith("at the equilibrium: "))
    assert all(part in verdict for part in lines)
    for options in ((), ("--band", "0.05:4", "--below", "0.5")):
        said = interarea("modes", str(out), *options)[1].splitlines()[0]
        assert f"at the equilibrium: {said}" == verdict


def test_the_verdict_of_a_case_is_computed_once_and_read_to_the_last_bit(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    case = load_case("kundur-thyristor-z")
    computed = growth_of_plant(sparse_linear_plant(case, default_cache()))
    first = growth_at_rest(case, default_cache())
    monkeypatch.setattr(growth, "growth_of_plant", None)  # not called again
    assert computed == first == growth_at_rest(case, default_cache())
    assert not computed.stable and computed.text == first.text
