"""Another reading of the rules of a claims file: Python's own `eval` on evidence found by a plain walk."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any


def walk(study: Any, path: str) -> float:
    """Return the number at a path of study.json; null as infinity."""
    for word in path.split("/"):
        if isinstance(study, dict):
            study = study[word]
        elif word[0] == "@":
            study = sorted((abs(x - float(word[1:])), y) for x, y in study)[0][1]
        elif "=" in word:
            entries = dict(entry.split("=") for entry in word.split("&"))
            (study,) = [
                row for row in study if entries.items() <= {k: str(v) for k, v in row.items()}.items()
            ]
        else:
            study = study[int(word)]
    return math.inf if study is None else study


def recomputed(statements: Sequence[Mapping[str, Any]], study: Mapping[str, Any]) -> dict[str, str]:
    """Return what each statement says -> its verdict: all parts hold, some, none."""
    verdicts = {}
    for row in statements:
        evidence = {name: walk(study, path) for name, path in row["evidence"].items()}
        held = [bool(eval(part, {"__builtins__": {"abs": abs}}, evidence)) for part in row["parts"]]
        verdicts[row["says"]] = "agrees" if all(held) else "partly" if any(held) else "differs"
    return verdicts
