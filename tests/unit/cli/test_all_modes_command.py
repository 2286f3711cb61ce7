"""`interarea modes --band --below`: every mode of a region with the independent count."""

import json

import pytest


def test_all_modes_are_printed_with_their_count(interarea) -> None:  # type: ignore[no-untyped-def]
    code, out, _ = interarea("modes", "two-area-thesis", "--band", "0.1:2.5", "--below", "0.2", "--shapes")
    assert code == 0
    lines = out.splitlines()
    assert lines[0] == (
        "two-area-thesis: 56 states, modes from 0.1 to 2.5 Hz below a damping ratio of 0.2: 1, "
        "counted independently: 1"
    )
    assert lines[2].split()[:3] == ["inter-area", "0.6227", "0.0806"]
    assert "its eigenvalue 0 is no instability" in out
    assert "speeds of the machines" in out


def test_the_json_holds_what_the_table_has(interarea) -> None:  # type: ignore[no-untyped-def]
    found = json.loads(interarea("modes", "nets-nyps", "--below", "0.2", "--shapes", "--json")[1])
    assert found["counted"] == len(found["modes"]) == 10
    assert found["band_hz"] == [0.1, 2.5]
    assert found["rotation"] is True
    assert found["unstable"] == []
    assert found["residual"] <= 1e-9
    first = found["modes"][0]
    assert first["name"].startswith("inter-area")
    assert max(entry["size"] for entry in first["shape"].values()) == pytest.approx(1.0)


@pytest.mark.parametrize(
    ("given", "said"),
    [
        (("--band", "low"), "--band 'low', wanted LOW:HIGH in Hz, such as 0.1:2.5"),
        (("--band", "2:1"), "band 2:1 Hz, wanted LOW:HIGH with 0 < LOW < HIGH"),
        (("--below", "20"), "below = 20, wanted a damping ratio over 0 and under 1"),
        (("--below", "0.2", "--margins"), "--margins with --band or --below: not together"),
    ],
)
def test_a_mistake_is_one_line(interarea, given, said) -> None:  # type: ignore[no-untyped-def]
    code, _, err = interarea("modes", "two-area-thesis", *given)
    assert code == 2
    assert said in err
    assert len(err.strip().splitlines()) == 1


def test_no_inter_area_mode_is_said(interarea) -> None:  # type: ignore[no-untyped-def]
    out = interarea("modes", "two-area-thesis", "--band", "1:2.5", "--below", "0.5")[1]
    assert "no inter-area mode among them" in out
