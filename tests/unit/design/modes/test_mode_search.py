"""The search for eigenpairs on matrices whose eigenvalues are known."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt
import pytest

from interarea.design.modes.mode_count import Region
from interarea.design.modes.mode_search import Pair, Search

TOLERANCE = 1e-9


class Known:
    """A loop of given eigenvalues: of a random matrix similar to their diagonal; T (n, n) its vectors."""

    def __init__(self, values: npt.NDArray[Any], seed: int) -> None:
        n = len(values)
        random = np.random.default_rng(seed)
        self.T = T = np.eye(n) + random.standard_normal((n, n)) / n
        self.A = T @ np.diag(values) @ np.linalg.inv(T)
        self.nstates = n

    def times(self, x: npt.NDArray[Any]) -> npt.NDArray[Any]:
        return np.asarray(self.A @ x)

    def shifted(self, s: complex) -> Known.Shifted:
        return Known.Shifted(s * np.eye(self.nstates) - self.A)

    class Shifted:
        def __init__(self, M: npt.NDArray[Any]) -> None:
            self.M = M

        def solve(self, b: npt.NDArray[Any]) -> npt.NDArray[Any]:
            return np.asarray(np.linalg.solve(self.M, b))

        def solve_left(self, c: npt.NDArray[Any]) -> npt.NDArray[Any]:
            return np.asarray(np.linalg.solve(self.M.T, c))


#: four modes of equal machines, two close ones, three others, controls far away
EQUAL = -1.8742655 + 10.9429488j


def values(apart: float) -> npt.NDArray[Any]:
    """Return eigenvalues, two of them a share `apart` from the equal ones."""
    close = [EQUAL * (1.0 + apart), EQUAL * (1.0 - apart * 1j)]
    far = [-30.0 + 0.7j * k for k in range(40)]
    return np.array([EQUAL] * 4 + close + [-0.23 + 2.3j, -0.55 + 3.3j, -0.8 + 6.7j, *far])


def assert_each_once(pairs: list[Pair], count: int) -> None:
    """`count` modes, four of them equal, whose left vectors are dual to the right ones."""
    assert len(pairs) == count
    V, W = np.array([p.right for p in pairs]).T, np.array([p.left for p in pairs])
    equal = [k for k, p in enumerate(pairs) if abs(p.value - EQUAL) < 1e-8]
    assert len(equal) == 4
    assert np.abs((W @ V)[np.ix_(equal, equal)] - np.eye(4)).max() < 1e-6
    assert all(p.residual <= TOLERANCE for p in pairs)


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("apart", [1e-6, 1e-5, 1.3e-5, 1e-4])
def test_equal_machines_beside_a_close_one_have_each_mode_once(apart: float, seed: int) -> None:
    region = Region((0.6, 16.0), 0.2)
    search = Search(Known(values(apart), seed), region, TOLERANCE)  # type: ignore[arg-type]
    search.everywhere(region)
    assert search.again() is False
    assert_each_once(search.pairs, 9)


@pytest.mark.parametrize("seed", range(4))
def test_a_guess_that_settles_on_the_eigenvalue_of_others_is_made_dual_to_them(seed: int) -> None:
    """Guesses as far from the equal eigenvalues as a close one, with vectors that mix those of the equal."""
    loop = Known(values(1.0), seed)
    search = Search(loop, Region((0.6, 16.0), 0.2), TOLERANCE)  # type: ignore[arg-type]
    random = np.random.default_rng(seed)
    for k in range(12):
        mixed = loop.T[:, :4] @ (random.standard_normal(4) + 1j * random.standard_normal(4))
        search._keep([(EQUAL * (1.0 + 2e-5 * (k % 3)), mixed)])
    assert_each_once(search.pairs, 4)
