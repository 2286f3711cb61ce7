"""An expression whose known parts are numbers already: the same value to the bit for every other name."""

from __future__ import annotations

import numpy as np
import pytest

from interarea.models.devices.language.elements import Plain
from interarea.models.devices.language.expression import Node, evaluate, folded
from interarea.models.devices.library import library


def sides() -> list[Node]:
    """Return every right side of every device that stands for a plain value."""
    elements = (element for model in library().values() for element in model.elements.values())
    return list(dict.fromkeys(element.u for element in elements if isinstance(element, Plain)))


def test_a_folded_expression_has_the_same_bits() -> None:
    rng, compared = np.random.default_rng(1), 0
    for node in sides():
        names = sorted(set(node.names))
        for name in names:
            values = {n: float(rng.choice([0.0, 1.0, rng.normal(), -2.5])) for n in names}
            others = {n: value for n, value in values.items() if n != name}
            try:
                expected = evaluate(node, values)
            except (ArithmeticError, ValueError, KeyError, TypeError):
                continue
            got = evaluate(folded(node, others), {name: values[name]})
            assert got == expected or (got != got and expected != expected), (str(node), values)
            compared += 1
    assert compared > 500


def test_a_branch_that_is_not_taken_may_have_no_value() -> None:
    broken = Node("**", (Node("number", value=0.0), Node("number", value=-1.0)))
    with pytest.raises(ZeroDivisionError):
        evaluate(broken, {})
    name = Node("name", name="x")
    pick = Node("pick", (Node("name", name="flag"), name, broken))
    assert folded(pick, {"flag": 1.0}) == name
    waits = folded(pick, {"x": 2.0})
    assert evaluate(waits, {"flag": 1.0}) == 2.0
    with pytest.raises(ZeroDivisionError):
        evaluate(waits, {"flag": 0.0})
