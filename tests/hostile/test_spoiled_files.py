"""Each spoiled grid file is refused with file and line, told of, or read without any loss.

A file that is read may differ from the good one in three ways only: its report differs (what was counted,
assumed, dropped, or how far the stored voltages are from a solution); or a number was spoiled into another
number and the case has that one; or the case is the same up to rounding and the order of its parts.
"""

from __future__ import annotations

from collections import Counter
from pathlib import Path
from typing import Any

import pytest
from spoiled_files import GOOD, Spoiled, spoiled_files

from interarea.models.errors import CaseError
from interarea.models.importers.file import import_grid
from interarea.models.importers.imported import Imported

FILES = list(spoiled_files())


def read(folder: Path, **changed: str) -> Imported:
    """Import the small grid of RAW and DYR, or that of MATPOWER, one of the files changed."""
    for suffix in ("m",) if "m" in changed else ("raw", "dyr"):
        (folder / f"grid.{suffix}").write_text(changed.get(suffix, GOOD[suffix]))
    return (
        import_grid(folder / "grid.m")
        if "m" in changed
        else import_grid(folder / "grid.raw", dyr=folder / "grid.dyr")
    )


def content(thing: Any, key: str = "") -> Any:
    """Return a case as values that compare: numbers rounded, parts in the order of their content.

    Solved voltages follow from the rest. Names of buses are content, those of other parts count on.
    """
    if isinstance(thing, dict):
        left_out = {"V_pu", "angle_deg"} if key == "buses" else {"name", "Q_mvar"} if key else set()
        return {k: content(v, k) for k, v in thing.items() if k not in left_out}
    if isinstance(thing, list | tuple):
        return sorted((content(v, key) for v in thing), key=repr)
    return f"{thing:.7g}" if isinstance(thing, float) else thing


def reported(good: Imported, now: Imported) -> bool:
    """Whether the report says so: other counts, assumptions or remarks, a stored solution that is none.

    That the numbers of the solution are others by a little tells nobody anything.
    """
    solution = ("stored voltages", "power flow", "slack bus")
    one, two = (
        (r.read, r.assumed, r.dropped, [line for line in r.lines if not line.startswith(solution)])
        for r in (good.report, now.report)
    )
    return one != two


def judged(folder: Path, one: Spoiled) -> str:
    """Return what becomes of a spoiled file in a word."""
    good = read(folder, **{one.file: GOOD[one.file]})
    try:
        now = read(folder, **{one.file: one.text})
    except CaseError as error:
        return "refused" if f"grid.{one.file}:" in str(error) else f"refused without a line: {error}"
    if reported(good, now):
        return "reported"
    if content(good.case.model_dump(mode="json")) == content(now.case.model_dump(mode="json")):
        return "harmless"
    return "another number" if one.value else "silent"


def test_size() -> None:
    assert len(FILES) >= 150
    assert len({one.text for one in FILES}) >= 0.9 * len(FILES)
    assert all(one.text != GOOD[one.file] for one in FILES)
    assert Counter(one.file for one in FILES).keys() == {"raw", "dyr", "m"}


@pytest.mark.slow
@pytest.mark.filterwarnings("error")
def test_nothing_is_lost_in_silence(tmp_path: Path) -> None:
    result = {one: judged(tmp_path, one) for one in FILES}
    wrong = {o.name: (o.line, o.was, o.is_now, f) for o, f in result.items() if f not in ALLOWED}
    assert not wrong
    counted = Counter(result.values())
    assert counted["refused"] > 0.5 * len(FILES)


ALLOWED = ("refused", "reported", "harmless", "another number")


@pytest.mark.parametrize(
    ("file", "was", "now", "says"),
    [
        ("raw", "4,'1',1,0.0,80.0", "4,''1',1,0.0,80.0", r"raw:12: a quote too many or too few, in '1"),
        ("raw", "3,'WEST',", "3,WEST',", r"raw:6: a quote too many or too few, in WEST'"),
        (
            "raw",
            "0,'1',1,1,1",
            "0,'1,1,1,1",
            r"raw:20: transformer record: CKT \(field 4\) = .*is a quote lost",
        ),
        ("raw", "GENERATOR DATA\n1,'1'", "GENERATOR DATA 1,'1'", r"raw:13: a record follows the /"),
        ("dyr", "1 'SEXS' 1 0.1 10.0", "1 'SEXS' 1 0.1 1_0", r"dyr:4: SEXS field 2 \(TB\) = '1_0', allowed"),
        ("m", "mpc.baseMVA = 100;", "mpc.baseMVA = '100';", r"m: mpc\.baseMVA = '100', allowed: a number"),
        (
            "m",
            "mpc.bus = [",
            "mpc.bus = {",
            r"m:5: mpc\.bus has another form, allowed: .* tables? of numbers",
        ),
        ("raw", "1.0\n3,4,'2'", "1.0,3,4,'2'", r"raw:17: branch record: 36 fields, allowed: 24"),
    ],
)
def test_what_was_silent(tmp_path: Path, file: str, was: str, now: str, says: str) -> None:
    assert GOOD[file].count(was) >= 1
    with pytest.raises(CaseError, match=says):
        read(tmp_path, **{file: GOOD[file].replace(was, now, 1)})


def test_what_stands_behind_the_end_is_told(tmp_path: Path) -> None:
    load = "3,'9',1,1,1,99.0,30.0,0.0,0.0,0.0,0.0,1,1,0\n"
    report = read(tmp_path, raw=GOOD["raw"] + load).report
    assert report.first["1 lines after the Q that ends the data ignored"].endswith("grid.raw:34")


def test_a_unit_whose_exciter_record_is_lost_is_told(tmp_path: Path) -> None:
    lost = "\n".join(line for line in GOOD["dyr"].splitlines() if not line.startswith("2 'SEXS'"))
    report = read(tmp_path, dyr=lost + "\n").report.text()
    assert "no exciter record: 1 of 2 units (G2), field voltage constant" in report


def test_the_judge_tells_silence(tmp_path: Path) -> None:
    """A number that comes out other than it stands in the file, by too little for the solution to tell."""
    good = read(tmp_path, raw=GOOD["raw"])
    moved = GOOD["raw"].replace("4,'2',0.01,0.12,0.21", "4,'2',0.01,0.12,0.210001")
    one = Spoiled("by hand", "raw", 18, "", "", moved, False)
    assert judged(tmp_path, one) == "silent"
    assert good.case.branches[0].b == 0.21
