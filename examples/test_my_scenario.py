"""A whole user-defined test: the fixture `scenario` comes with interarea's pytest plugin."""

PULSE = {"kind": "vref_pulse", "machine": "G1", "size_pu": 0.05, "start_s": 1.0, "end_s": 1.2}


def test_the_open_loop_is_poorly_damped(scenario):
    run = scenario({"case": "two-area-thesis", "stop_s": 20.0, "event": [PULSE]})
    assert run.stable
    assert 0.05 < run.damping_ratio("inter-area") < 0.10
