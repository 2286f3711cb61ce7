"""Worth of a signal: masks against transfer functions, and sentences that say what the numbers say."""

from __future__ import annotations

import control
import numpy as np
import pytest

from interarea.design.controllers.bundled import shipped_controller
from interarea.design.delay.signal_conditions import Condition
from interarea.design.linear.norms import response
from interarea.design.robust.signal_worth import (
    OWN_MASKED,
    SignalWorth,
    WorthRow,
    masked,
    own_signals,
    seen_by,
    signal_worth,
)

OMEGA = np.geomspace(0.1, 50.0, 30)


def _oscillator(damping: float, shown: tuple[float, float]) -> control.StateSpace:
    """One mode at 4 rad/s that u drives; its speed is seen with these gains by `A_dw` and `B_dw`."""
    A = np.array([[0.0, 1.0], [-16.0, -8.0 * damping]])
    C = np.array([[0.0, shown[0]], [0.0, shown[1]]])
    return control.ss(A, [[0.0], [1.0]], C, 0.0, inputs=["A_vs"], outputs=["A_dw", "B_dw"])


def _gain(own: float, afar: float) -> control.StateSpace:
    return control.ss([], [], [], [[-own, -afar]], inputs=["A_dw", "B_dw"], outputs=["A_vs"])


def test_a_masked_controller_has_the_columns_that_are_left_and_no_others() -> None:
    K = shipped_controller("two_actuators").system
    sees = seen_by(K)
    assert sees == {"G2_vs": ("G1_dw", "G2_dw"), "G4_vs": ("G3_dw", "G4_dw")}
    alone = masked(K, own_signals(K.output_labels, K.input_labels))
    expected = response(K, OMEGA)
    for row, column in ((0, 0), (1, 2)):  # each actuator's signal of the other machine
        assert abs(expected[:, row, column]).max() > 1e-3
        expected[:, row, column] = 0.0
    np.testing.assert_allclose(response(alone, OMEGA), expected, atol=1e-12)


def test_a_part_without_signals_leaves_nothing_behind() -> None:
    K = shipped_controller("two_actuators").system
    one = masked(K, {"G4_vs": ("G3_dw", "G4_dw")})
    assert one.nstates == K.nstates // 2
    assert not response(one, OMEGA)[:, 0].any()


def test_outputs_that_share_states_are_masked_apart() -> None:
    K = control.ss(
        [[-1.0]], [[1.0, 2.0]], [[1.0], [1.0]], 0.0, inputs=["A_dw", "B_dw"], outputs=["A_vs", "B_vs"]
    )
    alone = masked(K, own_signals(K.output_labels, K.input_labels))
    np.testing.assert_allclose(
        response(alone, OMEGA), response(K, OMEGA) * np.array([[[1.0, 0.0], [0.0, 1.0]]]), atol=1e-14
    )


@pytest.mark.parametrize(
    ("own", "afar", "rival", "said"),
    [
        (
            0.0,
            1.6,
            0.4,
            "the link from B adds 0.150 of inter-area damping: inter-area damping 0.250, without",
        ),
        (0.4, 1.2, 1.6, "a local stabilizer performs as well: do not build the link from B"),
        (1.6, 0.0, None, "no signal of another machine: the controller changes inter-area damping by +0.200"),
    ],
)
def test_the_sentence_says_what_the_closed_form_says(
    own: float, afar: float, rival: float | None, said: str
) -> None:
    """A speed fed back with gain g adds g / 8 to the damping of this mode: 2 zeta omega = .4 + g."""
    result = signal_worth(
        {"base": _oscillator(0.05, (1.0, 1.0))},
        _gain(own, afar),
        [Condition("N"), Condition("L", ("B_dw",))],
        None if rival is None else _gain(rival, 0.0),
    )
    assert result.open_loop.inter_area == pytest.approx(0.05)
    assert result.whole.inter_area == pytest.approx(0.05 + (own + afar) / 8.0)
    assert result.sentence.startswith(said)
    if rival is not None:
        assert result.adds == pytest.approx((own + afar - max(rival, own)) / 8.0)
        (alone,) = (row for row in result.masked if row.name == OWN_MASKED)
        assert alone.inter_area == pytest.approx(0.05 + own / 8.0)


@pytest.mark.parametrize(
    ("own", "afar", "rival", "cycles", "said", "pays"),
    [
        (
            0.0,
            1.6,
            0.4,
            (1.9, 0.6),
            "0.150 of inter-area damping and 1.3 cycles of clearing time: ",
            True,
        ),
        (0.4, 1.2, 1.6, (1.9, 0.6), "the link from B adds 1.3 cycles of clearing time: ", True),
        (
            0.4,
            1.2,
            1.6,
            (0.9, 0.6),
            "do not build the link from B; inter-area damping 0.250, without it 0.250",
            False,
        ),
        (0.0, 1.6, 0.4, (0.2, 0.6), "adds 0.150 of inter-area damping: ", True),
    ],
)
def test_clearing_times_count(
    own: float, afar: float, rival: float, cycles: tuple[float, float], said: str, pays: bool
) -> None:
    plant = {"base": _oscillator(0.05, (1.0, 1.0))}
    linear = signal_worth(plant, _gain(own, afar), [Condition("N")], _gain(rival, 0.0))
    assert "clearing times not searched" in linear.sentence
    result = linear.with_clearing(*cycles)
    assert said in result.sentence
    assert f"clearing times {cycles[0]:+.1f} and {cycles[1]:+.1f} cycles" in result.sentence
    assert result.pays is pays
    assert result.as_dict()["adds_cycles"] == pytest.approx(cycles[0] - cycles[1])


def test_a_rival_that_is_unstable_is_no_rival() -> None:
    K, rival = _gain(0.0, 1.6), _gain(-2.0, 0.0)
    result = signal_worth({"base": _oscillator(0.05, (1.0, 1.0))}, K, [Condition("N")], rival)
    assert result.rival is not None
    assert not result.rival.stable
    assert result.best_own is not None
    assert result.best_own.name == OWN_MASKED


def test_a_link_without_which_nothing_is_stable_is_called_necessary() -> None:
    plant = _oscillator(-0.05, (0.0, 1.0))  # the own signal does not show the growing mode
    result = signal_worth({"base": plant}, _gain(1.0, 1.6), [Condition("N")], _gain(3.0, 0.0))
    assert result.best_own is None
    assert "is necessary" in result.sentence


@pytest.mark.parametrize("name", ["robust", "robust_latency", "robust_linear", "two_actuators", "wide_area"])
def test_a_record_says_what_follows_from_its_numbers(name: str) -> None:
    record = shipped_controller(name).certificate["worth"]
    of = {key: WorthRow(**record[key]) for key in ("open_loop", "whole", "rival")}
    masks = tuple(WorthRow(**row) for row in record["masked"])
    worth = SignalWorth(afar=tuple(record["afar"]), masked=masks, remark=record["remark"], **of)
    assert {key: worth.as_dict()[key] for key in ("adds", "adds_cycles", "pays", "sentence")} == {
        key: record[key] for key in ("adds", "adds_cycles", "pays", "sentence")
    }
