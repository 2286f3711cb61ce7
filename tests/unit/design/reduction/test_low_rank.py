"""Reduction from low-rank Gramians on sparse blocks, held against dense responses and dense truncation."""

import control
import numpy as np
import pytest

from interarea.cosim.run.artefacts import linear_matrices, linear_plant, sparse_linear_plant
from interarea.design.linear.linearise import remove_reference, select
from interarea.design.reduction.balanced import balanced_truncation
from interarea.design.reduction.gramians import Reduction, ReductionError
from interarea.design.reduction.low_rank import checked_frequencies, low_rank_reduction
from interarea.fmu_build.write.cache import default_cache
from interarea.models.case.case import load_case

SIGNALS = {
    "two-area-thesis": (["G4_vs", "G2_vs"], {"dw24": {"G2_dw": 1.0, "G4_dw": -1.0}}),
    "nets-nyps": (
        ["G9_vs", "G13_vs", "G16_vs"],
        {"a": {"G9_dw": 1.0, "G13_dw": -1.0}, "b": {"G16_dw": 1.0, "G14_dw": -1.0}},
    ),
    "new-england": (["G9_vs", "G4_vs"], {"a": {"G9_dw": 1.0, "G10_dw": -1.0}, "b": {"G4_dw": 1.0}}),
}


def reduced(name: str, order: int) -> Reduction:
    inputs, outputs = SIGNALS[name]
    plant = sparse_linear_plant(load_case(name), default_cache())
    return low_rank_reduction(plant, order, inputs=inputs, outputs=outputs)


def exact(name: str, s: complex) -> np.ndarray:
    m, (inputs, outputs) = linear_matrices(load_case(name), default_cache()), SIGNALS[name]
    B = m.B[:, [list(m.input_labels).index(u) for u in inputs]]
    C = np.array(
        [sum(w * m.C[list(m.output_labels).index(y)] for y, w in row.items()) for row in outputs.values()]
    )
    return C @ np.linalg.solve(s * np.eye(len(m.A)) - m.A, B)


@pytest.mark.slow
@pytest.mark.parametrize(("name", "order", "least"), [("two-area-thesis", 20, 1e-6), ("nets-nyps", 50, 1e-8)])
def test_the_error_is_that_of_the_dense_response(name: str, order: int, least: float) -> None:
    model = reduced(name, order)
    assert model.order == order
    assert np.all(np.linalg.eigvals(model.system.A).real < 0.0)
    poles = np.linalg.eigvals(model.system.A)
    hz = checked_frequencies(poles[(poles.imag > 0.0) & (-poles.real < 0.2 * np.abs(poles))])
    sizes = np.array([np.linalg.norm(exact(name, 2j * np.pi * f), 2) for f in hz])
    errors = [np.linalg.norm(exact(name, 2j * np.pi * f) - model.system(2j * np.pi * f), 2) for f in hz]
    assert model.error == pytest.approx(max(errors) / sizes.max(), rel=1e-3)
    assert model.error < least


@pytest.mark.slow
def test_hankel_values_are_those_of_dense_gramians() -> None:
    inputs, outputs = SIGNALS["nets-nyps"]
    system = select(remove_reference(linear_plant(load_case("nets-nyps"), default_cache())), inputs, outputs)
    dense = balanced_truncation(system, 40).hankel_values
    assert reduced("nets-nyps", 40).hankel_values[:12] == pytest.approx(dense[:12], rel=1e-5)


@pytest.mark.slow
def test_no_model_of_so_many_states_is_nearer_than_the_first_value_cut() -> None:
    """Bounds of Glover and Enns over all frequencies: value k + 1, and twice the sum of all values cut."""
    model = reduced("nets-nyps", 16)
    hz = np.geomspace(0.02, 20.0, 400)
    errors = [
        np.linalg.norm(exact("nets-nyps", 2j * np.pi * f) - model.system(2j * np.pi * f), 2) for f in hz
    ]
    assert model.hankel_values[16] < max(errors) < 2.0 * np.sum(model.hankel_values[16:])


@pytest.mark.slow
def test_zero_modes_that_are_seen_stay_and_the_rotation_goes() -> None:
    assert reduced("nets-nyps", 30).removed == ("zero mode",)
    model = reduced("new-england", 44)  # constant torque: the common speed is a zero mode too
    assert model.kept == ("zero mode", "zero mode")
    s = 2j * np.pi * 1e-3  # where the integrator is nearly all there is
    assert np.linalg.norm(model.system(s) - exact("new-england", s)) < 1e-2 * np.linalg.norm(
        exact("new-england", s)
    )
    assert model.error < 1e-3


@pytest.mark.parametrize(
    ("order", "inputs", "outputs", "said"),
    [
        (0, ["G4_vs"], {"y": {"G4_dw": 1.0}}, "order = 0: must be a whole number from 1 to 56"),
        (99, ["G4_vs"], {"y": {"G4_dw": 1.0}}, "from 1 to 56"),
        (8, ["G9_vs"], {"y": {"G4_dw": 1.0}}, "input G9_vs: the plant has G1_vs"),
        (8, [], {"y": {"G4_dw": 1.0}}, r"input \(none\)"),
        (8, ["G4_vs"], {"y": {"G9_dw": 1.0}}, "output y: 'G9_dw' is no speed of a machine, such as G1_dw"),
        (8, ["G4_vs"], {}, "no outputs"),
    ],
)
def test_what_cannot_be_is_refused(order: int, inputs: list, outputs: dict, said: str) -> None:  # type: ignore[type-arg]
    plant = sparse_linear_plant(load_case("two-area-thesis"), default_cache())
    with pytest.raises(ReductionError, match=said):
        low_rank_reduction(plant, order, inputs=inputs, outputs=outputs)


def test_an_unstable_grid_is_told() -> None:
    plant = sparse_linear_plant(load_case("nets-nyps-no-pss"), default_cache())
    with pytest.raises(ReductionError, match="is the plant unstable"):
        low_rank_reduction(plant, 30, inputs=["G9_vs"], outputs={"y": {"G9_dw": 1.0, "G13_dw": -1.0}})


def test_the_door_takes_a_case_or_a_system() -> None:
    import interarea as ia

    result = ia.reduce("two-area-thesis", 20, inputs=["G4_vs"], outputs={"y": {"G2_dw": 1.0, "G4_dw": -1.0}})
    assert isinstance(result.system, control.StateSpace)
    assert result.system.nstates == 20
    with pytest.raises(ReductionError, match="method = 'hankel', allowed for a case: balanced"):
        ia.reduce("two-area-thesis", 20, method="hankel")
