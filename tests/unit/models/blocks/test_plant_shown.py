"""What the plant shows: by pattern, read off the same solution, against the power flow."""

from __future__ import annotations

import numpy as np
import pytest
from plant_shim import BlockShim

from interarea.models.blocks import plant_shown
from interarea.models.blocks.plant import plant_block
from interarea.models.blocks.plant_shown import MOST_MACHINES, shown_of
from interarea.models.case.case import Case, CaseError, load_case
from interarea.models.grid.machine_tables import in_plant_order, network_states
from interarea.models.grid.powerflow import solve_powerflow


def names(case: Case, *patterns: str) -> list[str]:
    return [s.variable.name for s in shown_of(case, patterns or None)]


@pytest.mark.parametrize("form", ["dense", "sparse"])
def test_buses_and_branches_show_the_power_flow(form: str) -> None:
    case = load_case("new-england")
    patterns = ["bus*", "branch[*", "G1_*"]
    plant = BlockShim(plant_block(case, show=patterns, network=form))
    flow = solve_powerflow(case)
    shown = dict(zip(plant.output_names, plant.derivatives(plant.x)[1], strict=True))
    assert len(shown) == 4 + 4 * len(case.buses) + 3 * len(case.branches) and len(plant.w) == 0
    centre = machine_centre(case, plant)
    for bus, voltage in zip(case.buses, flow.voltages, strict=True):
        assert shown[f"bus{bus.number}.v"] == pytest.approx(abs(voltage), abs=1e-8)
        phasor = complex(shown[f"bus{bus.number}.re"], shown[f"bus{bus.number}.im"])
        assert abs(phasor - voltage) < 1e-8
        assert shown[f"bus{bus.number}.angle"] == pytest.approx(np.angle(voltage) - centre, abs=1e-8)
    volts = {bus.number: abs(v) for bus, v in zip(case.buses, flow.voltages, strict=True)}
    for branch in case.branches:
        power = flow.flow(branch.name, branch.from_bus)
        got = complex(shown[f"branch[{branch.name}].p"], shown[f"branch[{branch.name}].q"])
        assert abs(got - power) < 1e-6
        current = abs(power) / volts[branch.from_bus]
        assert shown[f"branch[{branch.name}].i"] == pytest.approx(current, abs=1e-6)
    assert shown["G1_dw"] == 0.0


def machine_centre(case: Case, plant: BlockShim) -> float:
    """Angle of the centre of inertia, from the rotor angles among the states."""
    machines = in_plant_order(case).machines
    angles = [plant.x[plant.state_names.index(f"{m.name}.delta")] for m in machines]
    return float(np.average(angles, weights=[m.H * m.base_mva for m in machines]))


def test_slopes_of_what_is_shown_are_exact() -> None:
    """Against central differences, both forms."""
    case = load_case("two-area-thesis")
    name = f"branch[{case.branches[5].name}].*"
    plants = [
        BlockShim(plant_block(case, show=[name, "bus8.*"], network=form)) for form in ("dense", "sparse")
    ]
    x, v, h = plants[0].x, np.random.default_rng(2).standard_normal(len(plants[0].x)), 1e-6
    for plant in plants:
        exact = plant.directional(v, np.zeros(len(plant.u)))[1]
        numeric = (plant.derivatives(x + h * v)[1] - plant.derivatives(x - h * v)[1]) / (2 * h)
        np.testing.assert_allclose(exact, numeric, rtol=1e-6, atol=1e-8)


def test_a_pattern_takes_what_it_matches() -> None:
    case = load_case("two-area-thesis")
    assert names(case, "G?_dw") == [f"G{k}_dw" for k in (1, 2, 3, 4)]
    assert names(case, "tie_p", "bus7.v", "bus7.v") == ["tie_p", "bus7.v"]
    assert names(case, "branch[8-9 a].p") == ["branch[8-9 a].p"]
    with pytest.raises(CaseError, match=r"nothing to show matches 'G9_dw'; nearest: G\d_dw"):
        names(case, "G1_dw", "G9_dw")


def test_a_large_grid_shows_speed_power_and_tie() -> None:
    case = load_case("two-area-thesis")
    assert len(names(case)) == 4 * 4 + 1 + len(case.buses) + 2 * 4
    row = case.machines[1]
    more = tuple(row.model_copy(update={"name": f"X{k}"}) for k in range(MOST_MACHINES))
    large = case.model_copy(update={"machines": (*case.machines, *more)})
    assert {n.split("_")[1] for n in names(large)} == {"dw", "pe", "p"}
    assert len(names(large)) == 2 * (MOST_MACHINES + 4) + 1


def test_a_huge_grid_shows_no_powers_unasked_and_refuses_too_many(monkeypatch: pytest.MonkeyPatch) -> None:
    """An output that sees the network lists its states: with powers a description grows with the square."""
    case = load_case("nets-nyps")
    monkeypatch.setattr(plant_shown, "MOST_MACHINES", 10)
    listed = len(case.machines) * len(network_states(case))
    monkeypatch.setattr(plant_shown, "UNASKED_NAMES", listed)
    assert {n.split("_")[1] for n in names(case)} >= {"dw", "pe"}
    monkeypatch.setattr(plant_shown, "UNASKED_NAMES", listed - 1)
    assert {n.split("_")[1] for n in names(case)} - {"p"} == {"dw"}
    assert "G1_pe" in names(case, "*_pe")
    monkeypatch.setattr(plant_shown, "MOST_NAMES", listed - 1)
    assert names(case)
    with pytest.raises(CaseError, match=r"nets-nyps: the 16 outputs asked for .* show fewer of them"):
        names(case, "*_pe")
