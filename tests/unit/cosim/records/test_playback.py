"""A record in place of a signal: the same loop as a kind of the channel gives, and what is refused."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import interarea as ia
from interarea.cosim.records.record import Channel, Record, RecordError

STEP_S, WRONG_S, STOP_S = 0.02, 1.0, 3.0
PULSE = {"kind": "vref_pulse", "machine": "G1", "size_pu": 0.05, "start_s": 0.5, "end_s": 0.7}


def loop(hand_controller: ia.Controller, wrong: ia.Playback | None, **keys: object) -> ia.System:
    system = (
        ia.System(stop_s=STOP_S, step_s=STEP_S).plant("two-area-thesis").controller(hand_controller.system)
    )
    system.channel("line", reporting_interval_s=STEP_S, latency_s=0.1, **keys)
    if wrong is None:
        system.connect("plant.G2_dw", "line.u")
    else:
        system.add(wrong).connect("plant.G2_dw", "wrong.u").connect("wrong.y", "line.u")
    system.connect("line.y", "controller.G2_dw").connect("plant.G4_dw", "controller.G4_dw")
    return system.connect("controller.G4_vs", "plant.G4_vs").event(**PULSE)


def test_a_record_of_a_biased_signal_does_what_the_bias_does(
    hand_controller: ia.Controller, tmp_path: Path
) -> None:
    bias = {"kind": "bias", "size": 0.002, "start_s": WRONG_S}
    biased = loop(hand_controller, None, signal_faults=(bias,)).run()
    time_s = np.arange(WRONG_S, STOP_S + 1e-9, STEP_S)
    at = np.interp(time_s, biased["time_s"], biased["plant.G2_dw"]) + 0.002
    lines = ["time_s,f"] + [
        f"{t - WRONG_S:.9g},{60.0 * (1.0 + v):.17g}" for t, v in zip(time_s, at, strict=True)
    ]
    (tmp_path / "own.csv").write_text("\n".join(lines) + "\n")
    record = ia.read_record(tmp_path / "own.csv")
    wrong = ia.Playback("wrong", record, record.channels[0].name, start_s=WRONG_S)
    played = loop(hand_controller, wrong).run()
    right = loop(hand_controller, None).run()
    moved = np.abs(biased["plant.G4_dw"] - right["plant.G4_dw"]).max()
    assert moved > 1e-4
    assert np.interp(time_s, played["time_s"], played["plant.G4_dw"]) == pytest.approx(
        np.interp(time_s, biased["time_s"], biased["plant.G4_dw"]), abs=1e-3 * moved
    )
    assert played["line.valid"].min() == 1


def record(values: list[float]) -> Record:
    data = np.array(values)[:, None]
    return Record("own", 0.02 * np.arange(len(values)), data, (Channel("G2_dw", "speed", "pu", "G2"),))


@pytest.mark.parametrize(
    ("channel", "values", "start_s", "says"),
    [
        ("G3_dw", [0.0, 1.0], 1.0, "own: no channel 'G3_dw', allowed: G2_dw"),
        ("G2_dw", [0.0, float("nan")], 1.0, "G2_dw has values that are not numbers"),
        ("G2_dw", [0.0, 1.0], -1.0, "start_s = -1, allowed: 0 or later"),
    ],
)
def test_refused(channel: str, values: list[float], start_s: float, says: str) -> None:
    with pytest.raises(RecordError, match=says):
        ia.Playback("wrong", record(values), channel, start_s=start_s)


def frequency(middle_hz: float) -> Record:
    data = middle_hz + np.array([[0.06], [-0.06]])
    return Record("own", np.array([0.0, 0.02]), data, (Channel("f", "frequency", "Hz", ""),))


@pytest.mark.parametrize("middle_hz", [60.0, 0.0])
def test_a_frequency_and_its_deviation_are_sent_alike(middle_hz: float) -> None:
    wrong = ia.Playback("wrong", frequency(middle_hz), "f", start_s=0.0)
    assert [wrong.sent(t, 0.0) for t in (0.0, 0.02)] == pytest.approx([1e-3, -1e-3], abs=1e-15)


@pytest.mark.parametrize(
    ("nominal_hz", "says"),
    [
        (50.0, "own: f is 60 Hz, allowed: within 5 Hz of the rated 50 Hz, or a deviation"),
        (0.0, "a rated frequency of 0 Hz, allowed: above 0"),
        (float("nan"), "a rated frequency of nan Hz, allowed: above 0"),
    ],
)
def test_another_rated_frequency_is_refused(nominal_hz: float, says: str) -> None:
    with pytest.raises(RecordError, match=says):
        ia.Playback("wrong", frequency(60.0), "f", start_s=0.0, nominal_hz=nominal_hz)
    with pytest.raises(RecordError, match=r"wrong: record is str, wanted: that of read_record"):
        ia.Playback("wrong", "own.csv", "f", start_s=0.0)  # type: ignore[arg-type]
