"""How cases start: margins of the controls, all that cannot rest at once, limits widened on request."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from interarea.models.case.case import load_case
from interarea.models.devices.library import library
from interarea.models.devices.release import released
from interarea.models.devices.rest import rest_of
from interarea.models.errors import BeyondLimit
from interarea.models.grid.control_tables import StartError
from interarea.models.grid.equilibrium import operating_point
from interarea.models.grid.start import release_limits, start_of
from interarea.models.importers.file import import_grid
from interarea.models.importers.imported import ImportOptions

GRID = load_case("nets-nyps")
FIELD = {d.place: d.rest.output for d in operating_point(GRID).controls.of("exciter")}
#: two machines whose field voltage at rest lies above the limit
TIGHT = GRID.with_changes(
    {"machines": {name: {"exciter": {"Efd_max": 1.5}} for name in ("G3", "G6")}}, name="tight"
)


def test_margins_are_distances_to_the_limits():
    start = start_of(GRID)
    least = [m.margin.least for m in start.margins]
    assert least == sorted(least) and start.text() == "start: every control is within its limits"
    efd = {m.control: m.margin.least for m in start.margins if m.margin.signal == "efd"}
    for k, machine in enumerate(GRID.machines):
        assert efd[f"{machine.name}.exciter"] == pytest.approx(5.0 - FIELD[k], rel=1e-12)


def test_every_control_that_cannot_rest_is_named_with_its_cure():
    with pytest.raises(StartError, match=r"G3\.exciter: efd .* above Efd_max = 1\.5;.*and 1 more") as caught:
        operating_point(TIGHT)
    assert [u.row for u in caught.value.unrest] == ["G3", "G6"]
    third = next(k for k, m in enumerate(GRID.machines) if m.name == "G3")
    assert f"set Efd_max to at least {FIELD[third]:.6g}" in start_of(TIGHT).text()


def test_released_limits_lie_a_tenth_beyond_and_only_where_needed():
    case, changed = release_limits(TIGHT)
    limits = {m.name: m.exciter.parameters["Efd_max"] for m in case.machines}
    for k, machine in enumerate(GRID.machines):
        expected = 1.1 * FIELD[k] if machine.name in ("G3", "G6") else 5.0
        assert limits[machine.name] == pytest.approx(expected, rel=1e-9)
    assert [line.split(":")[0] for line in changed] == ["G3.exciter.Efd_max", "G6.exciter.Efd_max"]
    assert not start_of(case).unrest
    assert release_limits(GRID) == (GRID, ())


def test_a_limit_that_moves_is_widened_by_the_parameter_in_it():
    """ESST1A: Efd <= vt VRMAX - KC ifd, so VRMAX = (1.1 Efd + KC ifd)/vt."""
    model = library()["esst1a"]
    parameters = {"VOS": 1.0, "VIMIN": -9.0, "VIMAX": 9.0, "KA": 200.0, "VAMIN": -8.0, "VAMAX": 8.0}
    parameters |= {"VRMIN": -6.0, "VRMAX": 1.5, "KC": 0.1, "MBASE": 100.0, "FBASE": 60.0}
    values = {p.name: parameters.get(p.name, p.default) for p in model.device.parameters} | {
        "MBASE": 100.0,
        "FBASE": 60.0,
    }
    seen = dict.fromkeys(model.device.inputs, 0.0) | {"vt": 0.95, "vc": 0.95, "ifd": 1.9}
    changed = released(model, values, seen, 1.8, "G1.exciter")
    assert changed == {"VRMAX": pytest.approx((1.1 * 1.8 + 0.1 * 1.9) / 0.95, rel=1e-9)}


def test_a_gate_that_holds_the_output_is_released():
    """GAST above its temperature limit AT + KT (AT - x3): AT is moved, closed form, not the gain KT."""
    model = library()["gast"]
    values = {"R": 0.05, "T1": 0.4, "T2": 0.1, "T3": 3.0, "AT": 0.5, "KT": 2.0, "VMIN": 0.0, "VMAX": 1.1}
    values |= {"Dturb": 0.0, "MBASE": 100.0, "FBASE": 60.0}
    seen = {"slip": 0.0, "pe": 0.8}
    with pytest.raises(
        BeyondLimit,
        match=r"x1 is 0.8 at the equilibrium, but limit = AT \+ KT\*\(AT - x3\) = -0.1 keeps it below",
    ):
        rest_of(model, values, seen, 0.8, "G1.governor")
    changed = released(model, values, seen, 0.8, "G1.governor")
    assert changed == {"AT": pytest.approx((1.1 * 0.8 + 2.0 * 0.8) / 3.0, rel=1e-9)}
    rest_of(model, values | changed, seen, 0.8, "G1.governor")


def test_a_gate_behind_a_loop_is_released():
    """ST6B above its field current limit KLR (KCI ILR - ifd): ILR is moved, closed form."""
    model = library()["st6b"]
    values = {p.name: p.default for p in model.device.parameters} | {"KPA": 50.0, "KIA": 45.0, "KDA": 0.0}
    values |= {"TDA": 0.0, "VAMAX": 5.0, "VAMIN": -4.0, "KFF": 1.0, "KM": 1.0, "KG": 1.0, "TG": 0.02}
    values |= {
        "KCI": 1.06,
        "KLR": 17.0,
        "ILR": 1.5,
        "VRMAX": 5.0,
        "VRMIN": -4.0,
        "MBASE": 100.0,
        "FBASE": 60.0,
    }
    seen = dict.fromkeys(model.device.inputs, 0.0) | {"vt": 1.0, "vc": 1.0, "ifd": 2.0}
    with pytest.raises(
        BeyondLimit, match=r"vr is 2 at the equilibrium, but max\(vl, VRMIN\) = .* keeps it below"
    ):
        rest_of(model, values, seen, 2.0, "G1.exciter")
    changed = released(model, values, seen, 2.0, "G1.exciter")
    assert changed == {"ILR": pytest.approx((1.1 * 2.0 / 17.0 + 2.0) / 1.06, rel=1e-9)}


def test_an_import_says_how_its_controls_start(tmp_path, interarea):
    """SEXS rests at its field voltage: with EMAX below it the import says so, and widens it on request."""
    records = Path(__file__).parents[1] / "devices" / "psse_records"
    text = (records / "ThreeBus_SEXS.dyr").read_text()
    dyr = tmp_path / "grid.dyr"
    dyr.write_text(re.sub(r"(SEXS.*\s)\S+(\s*/)", r"\g<1>1.2\g<2>", text))
    raw = records / "ThreeBusMulti.raw"
    said = import_grid(raw, dyr=dyr).report.text()
    assert "start: 1 controls have no equilibrium" in said and "above EMAX = 1.2" in said
    for command in (
        ("study", raw, "--out", tmp_path / "o"),
        ("new", "study", raw, "--out", tmp_path / "n.toml"),
    ):
        code, _, err = interarea(*command, "--dyr", dyr)
        assert code == 2 and err.count("\n") == 1 and "above EMAX = 1.2" in err
        assert f"`interarea import {raw} --dyr {dyr} --release-limits --out grid.toml`" in err
    imported = import_grid(raw, dyr=dyr, options=ImportOptions(release_limits=True))
    assert "exciter.EMAX: 1.2 -> " in imported.report.text()
    rest = operating_point(imported.case).controls.of("exciter")[0].rest
    assert rest.instance.values["EMAX"] == pytest.approx(1.1 * rest.output, rel=1e-9)


@pytest.mark.parametrize(("beyond", "taken"), [(0.0, "inactive"), (1e-10, "active"), (-1e-9, "inactive")])
def test_a_control_that_rests_at_its_limit_is_told_and_released(beyond, taken):
    limit = FIELD[0] - beyond
    at = GRID.with_changes({"machines": {GRID.machines[0].name: {"exciter": {"Efd_max": limit}}}}, name="at")
    name = GRID.machines[0].name
    head, line = start_of(at).text().splitlines()
    assert head == "start: 1 controls are at a limit (--release-limits widens it)"
    assert line.startswith(f"  {name}.exciter: efd is {FIELD[0]:.6g} at the equilibrium, at Efd_max (")
    assert line.endswith(f"linear models treat the limit as {taken}")
    operating_point(at)
    case, changed = release_limits(at)
    assert case.machines[0].exciter.parameters["Efd_max"] == pytest.approx(1.1 * FIELD[0], rel=1e-6)
    assert len(changed) == 1
    assert start_of(case).text() == "start: every control is within its limits"
