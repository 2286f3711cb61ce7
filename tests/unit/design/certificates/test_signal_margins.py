"""Margins of each signal: against a closed form, against the state-space method, and at the edge itself."""

import control
import numpy as np
import pytest

from interarea.cosim.designs.design_file import load_design
from interarea.cosim.designs.family import at_point, family_plants
from interarea.cosim.run.artefacts import sparse_linear_plant
from interarea.design.certificates.large_loop import LargePlant
from interarea.design.certificates.signal_margins import ALL, SEARCHED_S, in_words, signal_margins
from interarea.design.controllers.bundled import shipped_controller
from interarea.design.delay.curves import delay_margin, delayed_loop, rightmost_roots
from interarea.fmu_build.write.cache import default_cache


def loop(a: float, g: float) -> tuple[control.StateSpace, control.StateSpace]:
    """x' = -a x + u, u = -g x(t - tau)."""
    plant = control.ss([[-a]], [[1.0]], [[1.0]], [[0.0]], inputs=["u"], outputs=["y"])
    return plant, control.ss([], [], [], [[-g]], inputs=["y"], outputs=["u"])


def test_a_first_order_loop_has_the_margins_of_its_closed_form() -> None:
    a, g = 1.0, 3.0
    plant, K = loop(a, g)
    (margin,) = signal_margins({"here": plant}, K)
    omega = np.sqrt(g**2 - a**2)
    assert margin.delay.value == pytest.approx(np.arccos(-a / g) / omega, abs=1e-12)
    assert margin.delay.frequency_hz == pytest.approx(omega / (2.0 * np.pi), abs=1e-12)
    assert margin.lower.value == pytest.approx(-a / g, rel=1e-5)  # s + a + k g = 0 at s = 0
    assert margin.lower.frequency_hz == 0.0
    assert margin.upper is None


def test_of_two_points_the_narrower_counts_and_is_named() -> None:
    plants = {f"a = {a:g}": loop(a, 3.0)[0] for a in (2.0, 1.0)}
    (margin,) = signal_margins(plants, loop(1.0, 3.0)[1])
    assert (margin.delay.point, margin.lower.point) == ("a = 1", "a = 1")


def test_an_unstable_loop_has_none_and_says_so() -> None:
    plant, K = loop(1.0, -2.0)
    assert signal_margins({"here": plant}, K) == ()
    assert "unstable" in in_words(())[0]


@pytest.mark.parametrize("name", ["robust", "robust_latency"])
def test_latencies_are_those_of_the_state_space_method_and_scales_divide_stable_from_unstable(
    name: str,
) -> None:
    table, K = load_design(name), shipped_controller(name).system
    table = table.model_copy(update={"point": table.point[:1]})
    plant = family_plants(table, default_cache())[table.point[0].name].judged
    result = {margin.signal: margin for margin in signal_margins({"here": plant}, K)}
    assert set(result) == {ALL, "G2_dw", "G4_dw"}
    for signal, margin in result.items():
        expected = delay_margin(plant, K, None if signal == ALL else [signal]).margin_s
        assert (margin.delay.value if margin.delay else np.inf) == pytest.approx(expected, abs=1e-9)

    def rightmost(signal: str, factor: float) -> float:
        return float(rightmost_roots(delayed_loop(plant, K, scale_of={signal: factor}))[0].real)

    for signal in K.input_labels:
        for contact in (result[signal].lower, result[signal].upper):
            assert contact is not None
            inside, outside = (1.0 + share * (contact.value - 1.0) for share in (0.999, 1.001))
            assert rightmost(signal, inside) < 0.0 < rightmost(signal, outside)


@pytest.mark.slow
def test_sparse_blocks_give_the_margins_of_the_dense_plant() -> None:
    table, K = load_design("robust_latency"), shipped_controller("robust_latency").system
    case = at_point(table.grid, table.point[0])
    table = table.model_copy(update={"point": table.point[:1]})
    dense = family_plants(table, default_cache())[table.point[0].name].judged
    large = LargePlant(sparse_linear_plant(case, default_cache()), case.areas, case.omega_b)
    for one, two in zip(signal_margins({"here": dense}, K), signal_margins({"here": large}, K), strict=True):
        for kind in ("delay", "lower", "upper"):
            contact, other = getattr(one, kind), getattr(two, kind)
            assert (contact is None) == (other is None)
            assert contact is None or contact.value == pytest.approx(other.value, rel=1e-6)


def test_words_name_the_narrowest_first_and_count_the_others() -> None:
    margin = {"value": 0.2, "frequency_hz": 0.9, "point": "base"}
    many = [{"signal": ALL, "delay": margin, "lower": None, "upper": None}]
    for k in range(6):
        upper = {"value": 3.0 - 0.3 * k, "frequency_hz": 0.0, "point": "load +5 %"}
        many.append({"signal": f"G{k}_dw", "delay": None, "lower": None, "upper": upper})
    late, scaled = in_words(many)
    assert f"all signals 200 ms (0.90 Hz, base), G0_dw {SEARCHED_S:g} s and over" in late
    assert scaled.index("G5_dw") < scaled.index("G4_dw")
    assert "G5_dw -100 or less to 1.50 (real root, load +5 %)" in scaled
    assert scaled.endswith("2 more with larger margins")
