"""Eigenvalues 0 by the way a plant is built, against dense ones and the count of what does not decay."""

from functools import cache
from pathlib import Path

import numpy as np
import pytest

from interarea.cosim.run.artefacts import sparse_linear_plant
from interarea.design.linear.matrices import ZERO_EIGENVALUE
from interarea.design.linear.sparse_plant import SparsePlant
from interarea.design.linear.zero_eigenvalues import ZeroEigenvalues, zero_eigenvalues_of
from interarea.design.modes.all_modes import AllModes, all_modes
from interarea.fmu_build.write.cache import default_cache
from interarea.models.case.case import Case, load_case

INTEGRAL = """\
base = "kundur-thyristor-z"
name = "integral"
[change.machines.G1.exciter]
kind = "esst4b"
source = "made up: a regulator with integral action"
TR = 0.02
KPR = 5.0
KIR = 5.0
VRMAX = 10.0
VRMIN = -8.7
TA = 0.02
KPM = 1.0
KIM = 0.2
VMMAX = 10.0
VMMIN = -8.7
KG = 0.1
KP = 6.7
KI = 0.1
VBMAX = 8.4
KC = 0.1
XL = 0.1
THETAP = 10.0
"""


def units(folder: Path, names: str, **change: dict[str, float]) -> Case:
    """Kundur's grid with G1 as so many equal units at bus 1, their exciters with integral action.

    change : of the exciter, by unit.
    """
    file = folder / "integral.toml"
    file.write_text(INTEGRAL)
    case = load_case(file)
    first, n = case.machines[0], len(names)
    parts = tuple(
        first.model_copy(
            update={
                "name": f"G1{k}",
                "base_mva": first.base_mva / n,
                "P_mw": first.P_mw / n,
                "exciter": first.exciter.model_copy(update=change.get(k, {})),
            }
        )
        for k in names
    )
    return case.model_copy(
        update={"machines": (*parts, *case.machines[1:]), "swing": None, "name": f"integral-{n}"}
    )


def seen(case: Case) -> tuple[SparsePlant, ZeroEigenvalues, AllModes, np.ndarray]:
    plant = sparse_linear_plant(case, default_cache())
    modes = all_modes(plant, case.areas, band_hz=(0.1, 2.5), below=0.2)
    return plant, zero_eigenvalues_of(plant), modes, np.linalg.eigvals(plant.state_matrix())


@cache
def bundled(name: str) -> tuple[SparsePlant, ZeroEigenvalues, AllModes, np.ndarray]:
    return seen(load_case(name))


@pytest.mark.parametrize(
    ("name", "common"),
    [("two-area-thesis", False), ("nets-nyps", False), ("new-england", True), ("kundur-pss", True)],
)
def test_rotation_and_common_speed_are_the_dense_zeros(name: str, common: bool) -> None:
    """NETS-NYPS brings a common speed back at 1e-3 1/s: that is no zero."""
    _, zero_eigenvalues, result, values = bundled(name)
    assert zero_eigenvalues.rotation
    assert zero_eigenvalues.common_speed is common
    near = np.sum((values.real > -1e-4) & (np.abs(values.imag) < 0.2 * np.pi))
    assert zero_eigenvalues.count == result.near_zero == near == 1 + common
    assert result.growing_slowly == 0


@pytest.mark.parametrize("names", ["ab", "abc"])
def test_integral_exciters_that_share_a_bus_trade_output(tmp_path: Path, names: str) -> None:
    """As many ways as there are units, less one; gains need not be equal."""
    case = units(tmp_path, names, b={"KIR": 2.0, "KPR": 8.0})
    plant, zero_eigenvalues, result, values = seen(case)
    machines = tuple(f"G1{k}" for k in names)
    assert zero_eigenvalues.shared_bus == {"1": (machines, len(names) - 1)}
    assert np.max(np.abs(zero_eigenvalues.rows.toarray() @ plant.state_matrix())) < 1e-12
    near = (values.real > -1e-4) & (np.abs(values.imag) < 0.2 * np.pi)
    assert zero_eigenvalues.count == result.near_zero == np.sum(near) == 2 + len(names) - 1
    assert np.sum(np.abs(values[near]) < ZERO_EIGENVALUE) >= len(names) - 1
    assert np.all(
        np.abs(values[near]) < 1e-5
    )  # QR has the double zero of a common speed to a root of its rounding
    assert result.growing_slowly == 0
    (said,) = (line for line in result.remarks if line.startswith("shared buses"))
    assert f"{len(names) - 1} at bus 1 (G1a, G1b" in said
    assert "not an instability" in said


def test_one_of_two_with_proportional_action_leaves_none(tmp_path: Path) -> None:
    _, zero_eigenvalues, result, values = seen(
        units(tmp_path, "ab", b={"KIR": 0.0, "KPR": 200.0, "KIM": 0.0})
    )
    assert zero_eigenvalues.shared_bus == {}
    assert result.near_zero == zero_eigenvalues.count
    assert zero_eigenvalues.count - len(zero_eigenvalues.resting) == 2
    assert np.sum(np.abs(values) < 1e-5) == zero_eigenvalues.count


def test_an_instability_beside_them_is_not_hidden(tmp_path: Path) -> None:
    """A regulator whose integral acts the wrong way runs away: one eigenvalue more than stand at 0."""
    _, zero_eigenvalues, result, values = seen(units(tmp_path, "abc", c={"KIR": -20.0}))
    grows = np.sum((values.real > 1e-4) & (np.abs(values.imag) < 0.2 * np.pi))
    assert grows > 0
    assert result.near_zero == zero_eigenvalues.count + grows
    assert result.growing_slowly == grows
    assert any("and 1 grow: unstable" in line for line in result.remarks)
