"""A test of a controller: pytest FILE; the fixture `scenario` comes with interarea."""

PULSE = {"kind": "vref_pulse", "machine": "G1", "size_pu": 0.05, "start_s": 1.0, "end_s": 1.2}


def test_the_controller_damps_the_tie(scenario):
    run = scenario({"case": "two-area-thesis", "controller": "robust", "stop_s": 20.0, "event": [PULSE]})
    assert run.stable
    assert run.damping_ratio("inter-area") > 0.25
