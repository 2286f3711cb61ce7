"""Sparse blocks and all modes of a region, held against the dense matrix of the FMU and QR."""

import itertools
from functools import cache

import numpy as np
import pytest

from interarea.cosim.designs.sensitivities import all_mode_sensitivities, parameter_sensitivities
from interarea.cosim.run.artefacts import linear_matrices, sparse_linear_plant
from interarea.design.linear.resolvent import OpenLoop, Shifted, network_logarithm
from interarea.design.linear.sparse_plant import SparsePlant
from interarea.design.modes.all_modes import all_modes
from interarea.design.modes.mode_count import Region, count_modes
from interarea.design.modes.mode_search import Pair, Search
from interarea.design.modes.modes import ModeError, modes_of
from interarea.fmu_build.write.cache import default_cache
from interarea.models.case.case import Case, load_case

#: saturating machines, loads that are not impedances, classical machines, dense and sparse networks
CASES = ("two-area-thesis", "kundur-dc", "new-england", "nets-nyps")


@cache
def case_of(name: str) -> Case:
    case = load_case(name)
    if name == "new-england":  # a load of every kind, so that ports of loads are there as well
        loads = list(case.loads)
        loads[0] = loads[0].model_copy(update={"P_zip": (0.2, 0.5, 0.3), "Q_zip": (0.1, 0.6, 0.3)})
        loads[1] = loads[1].model_copy(update={"P_exponent": 1.3, "Q_exponent": 1.0})
        case = case.model_copy(update={"loads": tuple(loads), "name": "new-england-loads"})
    return case


@cache
def plant_of(name: str) -> SparsePlant:
    return sparse_linear_plant(case_of(name), default_cache())


@cache
def state_matrix(name: str) -> np.ndarray:
    return linear_matrices(case_of(name), default_cache()).A


@pytest.mark.parametrize("name", CASES)
def test_the_blocks_are_the_fmus_linear_model(name: str) -> None:
    plant, dense = plant_of(name), linear_matrices(case_of(name), default_cache())
    assert list(plant.states) == list(dense.state_labels)
    assert list(plant.inputs) == list(dense.input_labels)
    scale = np.abs(dense.A).max(axis=1, keepdims=True) + 1e-9
    assert np.max(np.abs(plant.state_matrix() - dense.A) / scale) < 1e-10
    assert np.max(np.abs(plant.Bu.toarray() - dense.B)) < 1e-9 * max(1.0, np.abs(dense.B).max())


@pytest.mark.parametrize("name", CASES)
def test_resolvent_and_determinant_are_those_of_the_whole(name: str) -> None:
    plant, A, s = plant_of(name), state_matrix(name), 0.3 + 4.0j
    n = plant.nstates
    b = np.random.default_rng(2).standard_normal(n)
    shifted, whole = Shifted(plant, s), s * np.eye(n) - A
    for result, exact in (
        (shifted.solve(b), np.linalg.solve(whole, b)),
        (shifted.solve_left(b), np.linalg.solve(whole.T, b)),
    ):
        assert np.linalg.norm(result - exact) < 1e-10 * np.linalg.norm(exact)
    sign, size = np.linalg.slogdet(whole)
    log = network_logarithm(plant, s) - plant.at_rest.logarithm() + np.sum(np.log(s - plant.device_poles))
    assert log.real == pytest.approx(size, abs=1e-9)
    assert abs(np.exp(1j * log.imag) - sign) < 1e-9


@pytest.mark.parametrize("below", [0.08, 0.2, 0.6])
@pytest.mark.parametrize("name", CASES)
def test_found_counted_and_dense_are_as_many(name: str, below: float) -> None:
    result = all_modes(plant_of(name), case_of(name).areas, band_hz=(0.1, 2.5), below=below)
    values = np.linalg.eigvals(state_matrix(name))
    dense = values[Region((0.2 * np.pi, 5.0 * np.pi), below).holds(values)]
    assert result.counted == len(result.modes) == len(dense)
    for mode in result.modes:
        assert np.min(np.abs(mode.eigenvalue - dense)) < 1e-8
    assert result.residual <= 1e-9
    assert result.rotation


def test_the_count_knows_nothing_of_the_search() -> None:
    """Without a single known mode, and with one left out or named that is none, the number stays."""
    plant, values = plant_of("nets-nyps"), np.linalg.eigvals(state_matrix("nets-nyps"))
    region = Region((0.2 * np.pi, 5.0 * np.pi), 0.2)
    dense = values[region.holds(values)]
    for known in ([], list(dense[1:]), [*dense, -0.3 + 5.0j]):
        assert count_modes(OpenLoop(plant), region, known).modes == len(dense)


def test_a_search_that_misses_looks_again(monkeypatch: pytest.MonkeyPatch) -> None:
    """What the cells do not bring is missed by the count, and brought by deflated cells."""
    whole = Search.everywhere

    def forgetful(self: Search, region: Region) -> None:
        whole(self, region)
        del self.pairs[1:3]

    monkeypatch.setattr(Search, "everywhere", forgetful)
    result = all_modes(plant_of("nets-nyps"), case_of("nets-nyps").areas, band_hz=(0.1, 2.5), below=0.2)
    assert result.counted == len(result.modes) == 10

    monkeypatch.setattr(Search, "again", lambda self: False)
    with pytest.raises(ModeError, match="8 modes computed but 10 counted"):
        all_modes(plant_of("nets-nyps"), case_of("nets-nyps").areas, band_hz=(0.1, 2.5), below=0.2)


def test_two_pairs_of_one_value_are_two() -> None:
    """As units of one kind have them to the last digit: told apart by what they are, not by their value."""
    one, other = (Pair(1j, v, v, 0.0) for v in np.eye(2, dtype=complex))
    assert one in [other, one]
    assert one not in [other]


@pytest.mark.parametrize("units", [3, 4, 6, 8])
def test_twins_give_a_mode_as_often_as_it_is_there(units: int) -> None:
    """So many equal machines at one bus swing against each other once less at the same eigenvalue."""
    case = load_case("kundur-thyristor-z")
    first = case.machines[0]
    parts = tuple(
        first.model_copy(
            update={"name": f"G1{k}", "base_mva": first.base_mva / units, "P_mw": first.P_mw / units}
        )
        for k in range(units)
    )
    case = case.model_copy(
        update={"machines": (*parts, *case.machines[1:]), "swing": None, "name": f"units-{units}"}
    )
    plant = sparse_linear_plant(case, default_cache())
    region = Region((0.2 * np.pi, 5.0 * np.pi), 0.5)
    values = np.linalg.eigvals(plant.state_matrix())
    result = all_modes(plant, case.areas, band_hz=(0.1, 2.5), below=0.5)
    assert result.counted == len(result.modes) == np.sum(region.holds(values)) == 2 + units
    ours = sorted(mode.eigenvalue.imag for mode in result.modes)
    assert min(b - a for a, b in itertools.pairwise(ours)) < 1e-8  # the pair
    V = np.array([mode.right for mode in result.modes]).T
    W = np.array([mode.left for mode in result.modes])
    assert np.linalg.matrix_rank(V, tol=1e-3) == 2 + units
    assert np.max(np.abs(W @ V - np.eye(2 + units))) < 1e-6


def test_a_mode_on_the_line_moves_it_and_says_so() -> None:
    plant, areas = plant_of("two-area-thesis"), case_of("two-area-thesis").areas
    mode = modes_of(linear_matrices(case_of("two-area-thesis"), default_cache()), areas).inter_area
    for band, below in (
        ((0.1, 2.5), mode.damping_ratio),
        ((mode.frequency_hz, 2.5), 0.2),
        ((0.1, mode.frequency_hz), 0.2),
    ):
        result = all_modes(plant, areas, band_hz=band, below=below)
        assert [m.name for m in result.modes] == ["inter-area"]
        assert len(result.moved) == 1
        assert "a mode lies on that line" in result.moved[0]


def test_names_and_shapes_agree_with_the_named_swing_modes() -> None:
    swings = modes_of(linear_matrices(case_of("kundur-dc"), default_cache()), case_of("kundur-dc").areas)
    result = all_modes(plant_of("kundur-dc"), case_of("kundur-dc").areas, band_hz=(0.3, 2.5), below=0.6)
    by_name = {mode.name: mode for mode in result.modes}
    assert set(swings) <= set(by_name)
    for name, mode in swings.items():
        ours = by_name[name]
        assert ours.eigenvalue == pytest.approx(mode.eigenvalue, abs=1e-8)
        for machine, entry in mode.shape.items():
            assert ours.shape[machine] == pytest.approx(entry, abs=1e-6)
        for state, part in mode.participation.items():
            assert ours.participation[state] == pytest.approx(part, abs=1e-7)


@pytest.mark.parametrize(
    ("band", "below", "said"),
    [
        ((0.0, 2.5), 0.2, "LOW:HIGH with 0 < LOW < HIGH"),
        ((2.5, 0.1), 0.2, "LOW:HIGH with 0 < LOW < HIGH"),
        ((float("nan"), 1.0), 0.2, "LOW:HIGH"),
        ((0.1, 2.5), 1.0, "over 0 and under 1"),
        ((0.1, 2.5), float("nan"), "over 0 and under 1"),
    ],
)
def test_a_region_that_is_none_is_refused(band: tuple[float, float], below: float, said: str) -> None:
    with pytest.raises(ModeError, match=said):
        all_modes(plant_of("two-area-thesis"), case_of("two-area-thesis").areas, band_hz=band, below=below)


@pytest.mark.slow
@pytest.mark.parametrize("path", ["machines.G1.exciter.KA", "machines.G2.H"])
def test_sensitivities_are_those_of_the_dense_plant(path: str) -> None:
    case = case_of("two-area-thesis")
    result = all_modes(plant_of("two-area-thesis"), case.areas, band_hz=(0.1, 2.5), below=0.2)
    ours = all_mode_sensitivities(case, result.modes, [path], default_cache())[path]["inter-area"]
    dense = parameter_sensitivities(case, [path], default_cache())[path]["inter-area"]
    assert ours.value == dense.value
    assert ours.derivative == pytest.approx(dense.derivative, rel=1e-6, abs=1e-10)
    assert ours.damping_slope == pytest.approx(dense.damping_slope, rel=1e-6, abs=1e-10)
