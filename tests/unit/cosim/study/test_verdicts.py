"""Verdicts on printed statements follow the numbers of study.json by the rule that stands beside them."""

from __future__ import annotations

import tomllib
from typing import Any

import pytest
from recomputed import recomputed
from sample_study import CLAIMS, sample_study

from interarea.cosim.errors import ScenarioError
from interarea.cosim.study.printed import printed_rows
from interarea.cosim.study.verdicts import holds, judge, number_at

STATEMENTS = tomllib.loads(CLAIMS.read_text(encoding="utf-8"))["statement"]


def verdict_of(study: dict[str, Any], check: str) -> str:
    return judge(next(row for row in STATEMENTS if row["check"] == check), study).verdict


def test_every_verdict_comes_out_again_from_its_evidence() -> None:
    study = sample_study()
    result = {row["says"]: row["verdict"] for row in study["printed"]["verdicts"]}
    assert result == recomputed(STATEMENTS, study)
    assert set(result.values()) == {"agrees", "partly", "differs"}


@pytest.mark.parametrize(
    ("check", "path", "value", "before", "after"),
    [
        ("plant_order", "plant/states", 58, "differs", "agrees"),
        ("cc_damping", "controllers/cc/damping_ratio/normal/inter-area", 0.1, "agrees", "partly"),
        ("effort", "controllers/ftc/effort", 0.01, "partly", "differs"),
        ("non_synchronous_delay", "delay/non_synchronous/margin_s", 0.9, "differs", "agrees"),
        ("synchronous_delay", "scenarios/wdc-margin-above/stable", True, "agrees", "partly"),
        ("wdc_damping", "controllers/wdc/damping_ratio/normal/inter-area", 0.2, "partly", "partly"),
        ("ftc_faster", "scenarios/ftc-fault/settling_time_s", None, "agrees", "partly"),
        ("control_sensitivity", "sensitivity/w2_ks", 1.2, "agrees", "partly"),
        ("best_loop", "loops/coordinate_table/2/lead", -0.1, "agrees", "partly"),
    ],
)
def test_verdicts_follow_the_numbers(check: str, path: str, value: Any, before: str, after: str) -> None:
    study = sample_study()
    assert verdict_of(study, check) == before
    *folders, last = path.split("/")
    place: Any = study
    for word in folders:
        place = place[int(word)] if isinstance(place, list) else place[word]
    place[last] = value
    assert verdict_of(study, check) == after


def test_what_is_told_holds_the_numbers_of_the_evidence() -> None:
    for row in sample_study()["printed"]["verdicts"]:
        assert row["evidence"] and row["parts"], row["says"]
        assert "{" not in row["ours"] + row["why"] and row["ours"]


@pytest.mark.parametrize(
    ("part", "expected"),
    [
        ("a < b", True),
        ("2 * a >= b", True),
        ("abs(a - b) > 1 + 1", False),
        ("a < b < c", True),
        ("-a < 0", True),
    ],
)
def test_parts_are_comparisons(part: str, expected: bool) -> None:
    assert holds(part, {"a": 1.0, "b": 2.0, "c": None}, "x") is expected  # null: never, later than any time


@pytest.mark.parametrize(
    "part", ["__import__('os')", "a.real > 0", "a if a else b", "d > 1", "a <", "max(a, b) > 0"]
)
def test_parts_that_are_anything_else_are_refused(part: str) -> None:
    with pytest.raises(ScenarioError, match="allowed"):
        holds(part, {"a": 1.0, "b": 2.0}, "x")


def test_paths_lead_to_numbers_and_say_where_they_end() -> None:
    study = {"rows": [{"name": "a", "x": 1.5}, {"name": "b", "x": None}], "curve": [[0.0, 3.0], [0.1, 4.0]]}
    assert number_at(study, "rows/name=a/x", "s") == 1.5 and number_at(study, "rows/name=b/x", "s") is None
    assert number_at(study, "curve/@0.09", "s") == 4.0 and number_at(study, "curve/0/1", "s") == 3.0
    for path, said in (("rows/name=c/x", "a list of 2"), ("row", "rows, curve"), ("rows/name=a", "a number")):
        with pytest.raises(ScenarioError, match=said):
            number_at(study, path, "s")


def test_a_statement_whose_evidence_is_missing_is_an_error_not_a_verdict() -> None:
    study = sample_study()
    del study["scenarios"]["cc-fault"]
    with pytest.raises(ScenarioError, match="cc-fault"):
        printed_rows(CLAIMS, study)
