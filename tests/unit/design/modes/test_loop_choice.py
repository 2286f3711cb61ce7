"""Residues of every signal to every actuator and scores of sets, against closed loops and differences."""

from functools import cache
from itertools import combinations

import numpy as np
import pytest

from interarea.cosim.run.artefacts import linear_matrices, linear_plant, sparse_linear_plant
from interarea.design.linear.sparse_plant import SparsePlant
from interarea.design.modes.all_modes import AllModes, all_modes
from interarea.design.modes.loop_choice import KINDS, LoopChoice, choose_loops, signals_of
from interarea.design.modes.loop_selection import rank_loops
from interarea.design.modes.modes import ModeError, modes_of
from interarea.fmu_build.write.cache import default_cache
from interarea.models.case.case import load_case
from interarea.models.grid.powerflow import solve_powerflow


@cache
def grid(name: str) -> tuple[SparsePlant, AllModes, np.ndarray]:
    case = load_case(name)
    plant = sparse_linear_plant(case, default_cache())
    modes = all_modes(plant, case.areas, band_hz=(0.1, 2.5), below=0.2)
    return plant, modes, solve_powerflow(case).voltages


def chosen(name: str, **options) -> LoopChoice:  # type: ignore[no-untyped-def]
    plant, result, _ = grid(name)
    return choose_loops(plant, result.modes, load_case(name).areas, **options)


def shown(name: str) -> dict[str, np.ndarray]:
    plant, result, _ = grid(name)
    V = np.array([m.right for m in result.modes]).T
    values = np.array([m.eigenvalue for m in result.modes])
    signals = signals_of(plant, V, values, load_case(name).areas, range(len(values)))
    assert {s.kind for s in signals} == set(KINDS)
    return {s.name: s.shows for s in signals}


def test_a_residue_is_how_a_closed_loop_moves_the_mode() -> None:
    """Against eigenvalues of A + k b c by QR, with the FMU's own matrices."""
    m = linear_matrices(load_case("nets-nyps"), default_cache())
    best = chosen("nets-nyps", kinds=["speed"]).loops["inter-area 2"][0]
    b = m.B[:, list(m.input_labels).index(best.actuator)]
    one, other = best.signal.split("_")[1:]
    rows = [m.C[list(m.output_labels).index(f"{g}_dw")] for g in (one, other)]
    result = next(mode for mode in grid("nets-nyps")[1].modes if mode.name == "inter-area 2")
    k = 1e-4 / abs(best.residue)
    ends = []
    for gain in (k, -k):
        values = np.linalg.eigvals(m.A + gain * np.outer(b, rows[0] - rows[1]))
        ends.append(values[np.argmin(np.abs(values - result.eigenvalue))])
    assert (ends[0] - ends[1]) / (2.0 * k) == pytest.approx(best.residue, rel=1e-5)
    # a gain with the phase that is to make up moves it straight to the left
    turned = best.residue * np.exp(1j * np.radians(best.lead_deg))
    assert turned.real == pytest.approx(-abs(best.residue), rel=1e-9)


def test_branch_power_is_the_fmus_tie_power() -> None:
    case = load_case("two-area-thesis")
    m = linear_matrices(case, default_cache())
    C = m.C[list(m.output_labels).index("tie_p")]
    _, result, _ = grid("two-area-thesis")
    ours = sum(shown("two-area-thesis")[f"power_{name}"] for name in case.tie.branches)
    exact = np.array([C @ mode.right for mode in result.modes])
    assert np.max(np.abs(ours - exact) / np.abs(exact)) < 1e-9


def test_angles_frequencies_and_currents_are_differences_of_the_voltages() -> None:
    plant, result, volts = grid("nets-nyps")
    signals, mode, h = shown("nets-nyps"), result.modes[1], 1e-6
    place = {name: k for k, name in enumerate(plant.bus_names)}

    def amplitude(read) -> complex:  # type: ignore[no-untyped-def]
        """Central difference of a quantity of the bus voltages along the mode's real and imaginary part."""
        parts = []
        for v in (mode.right.real, mode.right.imag):
            dV = plant.voltages(v)
            step = h * (dV[:, 0] + 1j * dV[:, 1])
            parts.append((read(volts + step) - read(volts - step)) / (2.0 * h))
        return complex(parts[0], parts[1])

    name = next(n for n in signals if n.startswith("angle_"))
    a, b = (place[x] for x in name.split("_")[1:])
    angle = amplitude(lambda V: np.angle(V[a] / V[b]))
    assert signals[name][1] == pytest.approx(angle, rel=1e-6)
    turning = mode.eigenvalue * angle / (2.0 * np.pi * 60.0)
    assert signals[name.replace("angle", "frequency")][1] == pytest.approx(turning, rel=1e-6)
    k = 7
    (i, j), (own, mutual) = plant.ends[k], plant.stamps[k][:2]
    current = amplitude(lambda V: abs(own * V[i] + mutual * V[j]))
    assert signals[f"current_{plant.branches[k]}"][1] == pytest.approx(current, rel=1e-5)


def test_a_delay_turns_and_scales_as_it_should() -> None:
    now, late = (chosen("nets-nyps", kinds=["speed"], latency_s=t).loops["inter-area 1"] for t in (0.0, 0.15))
    mode = next(m for m in grid("nets-nyps")[1].modes if m.name == "inter-area 1")
    assert [r.signal for r in now] == [r.signal for r in late]
    for a, b in zip(now, late, strict=True):
        assert b.residue == pytest.approx(a.residue * np.exp(-0.15 * mode.eigenvalue), rel=1e-12)
        assert a.index == pytest.approx(b.index)


def test_the_score_of_a_set_is_the_least_over_modes_of_its_largest_index() -> None:
    choice = chosen("nets-nyps", kinds=["speed"], together=2, most=200)
    plant, result, _ = grid("nets-nyps")
    signals = {n: z for n, z in shown("nets-nyps").items() if n.startswith("dw") or n.endswith("_dw")}
    reach = np.array([m.left for m in result.modes]) @ plant.Bu.toarray()
    targets = [k for k, m in enumerate(result.modes) if m.name in choice.targets]
    assert len(targets) == 4
    size = np.abs(np.array([z[targets] for z in signals.values()])).max(axis=0)[:, None] * np.abs(
        reach[targets]
    )
    best = size / size.max(axis=1, keepdims=True)  # (modes, actuators)
    scores = {
        frozenset((plant.inputs[a], plant.inputs[b])): best[:, [a, b]].max(axis=1).min()
        for a, b in combinations(range(len(plant.inputs)), 2)
    }
    assert len(choice.sets) == len(scores)
    for one in choice.sets:
        assert one.score == pytest.approx(scores[frozenset(one.actuators)], rel=1e-9)
        assert one.left <= one.score + 1e-12
    assert [s.score for s in choice.sets] == sorted((s.score for s in choice.sets), reverse=True)


@pytest.mark.parametrize(
    ("options", "said"),
    [
        ({"targets": ["inter-area 9"]}, "no mode 'inter-area 9'"),
        ({"actuators": ["G99_vs"]}, "no actuator 'G99_vs'; the plant has"),
        ({"kinds": ["voltage"]}, "signals 'voltage', allowed: speed, frequency, angle, power, current"),
        ({"latency_s": -1.0}, "latency = -1 s"),
        ({"latency_s": float("nan")}, "latency = nan s"),
        ({"together": 99}, "sets of 99 actuators, wanted: 1 to"),
    ],
)
def test_a_mistake_names_itself(options: dict, said: str) -> None:  # type: ignore[type-arg]
    with pytest.raises(ModeError, match=said):
        chosen("nets-nyps", **options)


def test_no_inter_area_mode_and_an_unreachable_one_are_told() -> None:
    plant, result, _ = grid("nets-nyps")
    local = [m for m in result.modes if m.name.startswith("local")]
    with pytest.raises(ModeError, match=r"no inter-area mode in this band .* there are: local"):
        choose_loops(plant, local, load_case("nets-nyps").areas)
    blind = SparsePlant(
        **{**{f: getattr(plant, f) for f in plant.__dataclass_fields__}, "Bu": 0.0 * plant.Bu}
    )
    with pytest.raises(ModeError, match="no allowed actuator and signal control and observe it"):
        choose_loops(blind, result.modes, load_case("nets-nyps").areas)


@pytest.mark.parametrize("name", ["two-area-thesis", "kundur-dc", "new-england"])
def test_residues_of_speeds_are_those_of_the_dense_plant(name: str) -> None:
    """Every difference at every actuator: as `rank_loops` has them from the FMU's own matrices."""
    case = load_case(name)
    system = linear_plant(case, default_cache())
    mode = modes_of(system, case.areas).inter_area
    dense = rank_loops(system, mode, areas=case.areas, own_machine=False).ranking
    choice = chosen(name, kinds=["speed"], targets=["inter-area"], most=10_000)
    ours = {(loop.actuator, loop.signal): loop.residue for loop in choice.loops["inter-area"]}
    both = [
        (loop, ours[loop.actuator, loop.signal]) for loop in dense if (loop.actuator, loop.signal) in ours
    ]
    assert len(both) >= 0.4 * len(dense)  # differences of the ends that show a mode most
    size = max(abs(loop.residue) for loop in dense)
    for loop, residue in both:
        assert residue == pytest.approx(loop.residue, rel=1e-7, abs=1e-9 * size)
