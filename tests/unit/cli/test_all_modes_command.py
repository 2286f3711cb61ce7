"""`interarea modes --band --below`: every mode of a region with the independent count."""

import json

import pytest

from interarea.design.controllers.bundled import shipped_controller


def test_all_modes_are_printed_with_their_count(interarea) -> None:  # type: ignore[no-untyped-def]
    code, out, _ = interarea("modes", "two-area-thesis", "--band", "0.1:2.5", "--below", "0.2", "--shapes")
    assert code == 0
    lines = out.splitlines()
    assert lines[0] == "stable: of 56 eigenvalues none grows faster than 1.0e-06 1/s"
    assert lines[1] == (
        "two-area-thesis: 56 states, modes from 0.1 to 2.5 Hz below a damping ratio of 0.2: 1, "
        "counted independently: 1"
    )
    assert lines[3].split()[:3] == ["inter-area", "0.6227", "0.0806"]
    assert "its eigenvalue 0 is not an instability" in out
    assert "speeds of the machines" in out


def test_the_json_holds_what_the_table_has(interarea) -> None:  # type: ignore[no-untyped-def]
    document = json.loads(interarea("modes", "nets-nyps", "--below", "0.2", "--shapes", "--json")[1])
    assert document["counted"] == len(document["modes"]) == 10
    assert document["band_hz"] == [0.1, 2.5]
    assert document["rotation"] is True
    assert document["unstable"] == []
    assert document["residual"] <= 1e-9
    first = document["modes"][0]
    assert first["name"].startswith("inter-area")
    assert max(entry["size"] for entry in first["shape"].values()) == pytest.approx(1.0)


@pytest.mark.slow
def test_modes_with_a_late_controller(interarea) -> None:  # type: ignore[no-untyped-def]
    """The inter-area mode of the certificate's row (band up to 0.747 Hz), 200 ms late, to its digits."""
    arguments = ("new-england", "--band", "0.3:0.74", "--below", "0.3", "--controller", "new_england")
    arguments = (*arguments, "--latency", "0.2")
    document = json.loads(interarea("modes", *arguments, "--json")[1])
    assert (document["controller"], document["latency_s"]) == ("new_england", 0.2)
    rows = shipped_controller("new_england").certificate["rows"]
    row = next(r for r in rows if (r["point"], r["condition"]) == ("base", "s200"))
    assert document["counted"] == len(document["modes"]) >= 2
    least = min(mode["damping_ratio"] for mode in document["modes"])
    assert least == pytest.approx(row["inter_area"], abs=1e-6)
    out = interarea("modes", *arguments)[1]
    assert f"counted independently: {document['counted']}; with new_england, signals 0.2 s late" in out


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (("--band", "low"), "--band 'low', wanted LOW:HIGH in Hz, such as 0.1:2.5"),
        (("--band", "2:1"), "band 2:1 Hz, wanted LOW:HIGH with 0 < LOW < HIGH"),
        (("--below", "20"), "below = 20, wanted a damping ratio over 0 and under 1"),
        (
            ("--below", "0.2", "--margins"),
            "--margins with --band, --below or --controller: cannot be combined",
        ),
        (
            ("--controller", "robust", "--sensitivity", "machines.G1.H"),
            "--sensitivity with --controller: cannot be combined",
        ),
        (
            ("--controller", "robust", "--latency", "-1"),
            "--latency S: got -1, allowed: at least 0 and at most 10, in s",
        ),
        (("--controller", "active"), "--controller active: a bank switches between controllers"),
        (
            ("--below", "0.2", "--load-scale", "4"),
            " pu at bus 9 to ",
        ),
        (("--latency", "0.1"), "--latency 0.1 needs a controller; name one with --controller"),
    ],
)
def test_a_mistake_is_one_line(interarea, arguments, said) -> None:  # type: ignore[no-untyped-def]
    code, _, err = interarea("modes", "two-area-thesis", *arguments)
    assert code == 2
    assert said in err
    assert len(err.strip().splitlines()) == 1


def test_no_inter_area_mode_is_said(interarea) -> None:  # type: ignore[no-untyped-def]
    out = interarea("modes", "two-area-thesis", "--band", "1:2.5", "--below", "0.5")[1]
    assert "no inter-area mode among them" in out


def test_a_mode_on_the_counting_line_moves_it_and_that_is_said(interarea) -> None:  # type: ignore[no-untyped-def]
    document = json.loads(interarea("modes", "two-area-thesis", "--below", "0.2", "--json")[1])
    ratio = document["modes"][0]["damping_ratio"]
    code, out, _ = interarea("modes", "two-area-thesis", "--below", repr(ratio))
    assert code == 0
    assert f"damping ratio {ratio:.6g} moved to " in out
    assert "a mode lies on that line" in out
    assert ": 1, counted independently: 1" in out
