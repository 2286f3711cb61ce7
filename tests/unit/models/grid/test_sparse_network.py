"""The sparse network: its order and places against plain elimination, its solution against the dense one."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from plant_shim import BlockFailure, BlockShim

from interarea.cosim.explorer.wasm import page_sources
from interarea.models.blocks.plant import event_parameters, plant_block
from interarea.models.case.case import Case, case_of, load_case
from interarea.models.case.events import events_of
from interarea.models.grid.network_tables import network_pattern
from interarea.models.grid.sparse_pattern import SPARSE_PRICE, sparse_pattern


def mesh(columns: int, rows: int, every: int = 1) -> Case:
    """A grid of streets with a classical machine at each `every`-th crossing and two phase shifters."""
    number = {(i, j): 1 + i * rows + j for i in range(columns) for j in range(rows)}
    lines = [((i, j), (i + 1, j)) for i, j in number if i + 1 < columns]
    lines += [((i, j), (i, j + 1)) for i, j in number if j + 1 < rows]
    branches = {
        f"{number[a]}-{number[b]}": {
            "from": number[a],
            "to": number[b],
            "r": 0.004,
            "x": 0.04 + 0.003 * k % 7,
        }
        for k, (a, b) in enumerate(lines)
    }
    for k, name in enumerate(list(branches)[1:8:5]):
        branches[name] |= {"tap": 0.97 + 0.05 * k, "shift_deg": 6.0}
    at = [n for n in number.values() if n % every == 1 % every]
    machines = {
        f"G{n}": {
            "bus": n,
            "base_mva": 100.0,
            "model": "classical",
            "H": 3.0 + n % 3,
            "D": 1.0,
            "Xd1": 0.25,
            "Ra": 0.003,
            "P_mw": 0.0 if k == 0 else 10.0 + n % 4,
            "V_pu": 1.0,
            "slack": k == 0,
        }
        for k, n in enumerate(at)
    }
    return case_of(
        {
            "name": f"mesh-{columns}-{rows}",
            "source": "made up",
            "frequency_hz": 60.0,
            "base_mva": 100.0,
            "buses": {str(n): {} for n in number.values()},
            "branches": branches,
            "loads": {f"L{n}": {"bus": n, "P_mw": 9.0, "Q_mvar": 2.0} for n in number.values() if n % 2},
            "machines": machines,
            "tie": {"branches": [next(iter(branches))], "from": 1},
        },
        where="test",
    )


def shims(case: Case, *events: dict) -> list[BlockShim]:
    """The plant with the dense, the sparse and the reduced network."""
    slots = event_parameters(case, events_of(list(events), where="test"))
    return [BlockShim(plant_block(case, network=form), slots) for form in ("dense", "sparse", "reduced")]


def check_agreement(case: Case, *events: dict, iterated: float = 1e-12) -> None:
    dense, *others = shims(case, *events)
    x = dense.x + 0.02 * np.random.default_rng(3).standard_normal(len(dense.x))
    v = np.random.default_rng(4).standard_normal(len(dense.x) + len(dense.u))
    expected, slopes = dense.derivatives(x), dense.directional(v[: len(x)], v[len(x) :], x)
    for plant in others:
        for one, other in zip(expected, plant.derivatives(x), strict=True):
            np.testing.assert_allclose(other, one, rtol=0, atol=iterated * (1.0 + np.abs(one).max()))
        np.testing.assert_allclose(plant.w, dense.w, rtol=0, atol=iterated * dense.w.max())
        for a, b in zip(slopes, plant.directional(v[: len(x)], v[len(x) :], x), strict=True):
            np.testing.assert_allclose(b, a, rtol=0, atol=1e-12 * (1.0 + np.abs(a).max()))


@pytest.mark.parametrize("name", ["two-area-thesis", "kundur-thyristor-z", "new-england"])
def test_both_forms_agree(name: str) -> None:
    check_agreement(load_case(name))


def test_both_forms_agree_in_every_switching_state() -> None:
    case = load_case("new-england")
    check_agreement(
        case,
        {"kind": "bus_fault", "bus": 16, "start_s": 0.0, "end_s": 1.0, "x_pu": 0.001},
        {"kind": "branch_trip", "branch": case.branches[3].name, "start_s": 0.0},
        {"kind": "machine_trip", "machine": case.machines[2].name, "start_s": 0.0},
        {"kind": "load_step", "load": case.loads[4].name, "start_s": 0.0, "size_pu": 0.3},
    )


@pytest.mark.parametrize("name", ["kundur-manual", "nets-nyps", "tr18-tgr"])
@pytest.mark.parametrize("machine", [None, "G2"])
def test_both_forms_agree_with_ports(name: str, machine: str | None) -> None:
    """Loads of constant current and power, saturation: each form iterates, the tangents are exact."""
    case = load_case(name)
    trip = {"kind": "machine_trip", "machine": machine, "start_s": 0.0}
    fault = {"kind": "bus_fault", "bus": case.buses[6].number, "start_s": 0.0, "end_s": 1.0, "x_pu": 0.02}
    check_agreement(case, *([trip, fault] if machine else []), iterated=1e-10)


def test_runs_with_ports_agree_through_a_fault() -> None:
    """Slopes are renewed at events and on the way; constant power among the loads."""
    case = load_case("nets-nyps")
    power = {"loads": {q.name: {"P_zip": [0.0, 0.0, 1.0], "Q_zip": [0.0, 0.0, 1.0]} for q in case.loads[:12]}}
    fault = {"kind": "bus_fault", "bus": 28, "start_s": 0.02, "end_s": 0.12, "x_pu": 0.002}
    dense, sparse, _ = (p.run(0.5, 0.005) for p in shims(case.with_changes(power), fault))
    swing = np.ptp(dense[2], axis=0).max()
    assert swing > 0.1
    np.testing.assert_allclose(sparse[2], dense[2], rtol=0, atol=1e-7 * swing)


def few_ports() -> Case:
    """New England with one load of constant power and one saturating machine."""
    power = {"P_exponent": 0.0, "Q_exponent": 0.0}
    saturates = {"saturation": {"Asat": 0.015, "Bsat": 9.6, "psiT1": 0.9, "use": "total"}}
    case = load_case("new-england")
    change = {"loads": {case.loads[3].name: power}, "machines": {case.machines[1].name: saturates}}
    return case.with_changes(change)


def test_few_ports_leave_the_factors_complex() -> None:
    none, few = (BlockShim(plant_block(c, network="sparse")) for c in (load_case("new-england"), few_ports()))
    assert len(few.memory) < 1.15 * len(none.memory)
    assert len(BlockShim(plant_block(many_ports(), network="sparse")).memory) > 1.3 * len(none.memory)


def many_ports() -> Case:
    """New England with loads of constant current, one of constant power and one saturating machine."""
    return few_ports().with_changes(
        {"loads": {q.name: {"P_exponent": 1.0} for k, q in enumerate(few_ports().loads) if k != 3}}
    )


@pytest.mark.parametrize("case", [load_case("new-england"), few_ports(), many_ports()])
def test_four_numbers_in_one_operation_give_the_bits_of_one_at_a_time(case: Case) -> None:
    """Factors and solutions, of complex entries and of blocks of 2 x 2."""
    fault = {"kind": "bus_fault", "bus": 16, "start_s": 0.0, "end_s": 1.0, "x_pu": 0.05}
    slots = event_parameters(case, events_of([fault], where="test"))
    one, _ = plants = [BlockShim(plant_block(case, network="sparse"), slots) for _ in range(2)]
    one._block.lanes = 0
    x = one.x + 0.02 * np.random.default_rng(3).standard_normal(len(one.x))
    results = []
    for plant in plants:
        plant.event(0.0, plant.x)
        results.append(np.concatenate([*plant.derivatives(x), plant.memory]))
    np.testing.assert_array_equal(results[1], results[0])


def test_an_undone_step_leaves_the_bits_of_the_next_unchanged() -> None:
    """Only the end of memory is restored; factors with other slopes are made again from the slopes in it."""
    plant = BlockShim(plant_block(many_ports(), network="sparse"))
    normal = np.random.default_rng(3).standard_normal(len(plant.x))
    near, far = plant.x + 0.001 * normal, plant.x + 0.2 * normal
    plant.derivatives(near)
    whole, n_warm = plant.memory.copy(), plant.n_warm
    assert 0 < n_warm < 0.2 * len(whole)
    plant.derivatives(far)
    assert np.any(plant.memory[: len(whole) - n_warm] != whole[: len(whole) - n_warm])  # other factors
    plant.memory[len(whole) - n_warm :] = whole[len(whole) - n_warm :]
    undone = plant.derivatives(near + 1e-4)
    plant.memory[:] = whole
    for one, other in zip(plant.derivatives(near + 1e-4), undone, strict=True):
        np.testing.assert_array_equal(other, one)


@pytest.mark.parametrize("machine", [None, "other", "saturating"])
def test_both_forms_agree_with_few_ports(machine: str | None) -> None:
    """They are solved by themselves, over the rows between them; tangents too."""
    case = few_ports()
    trip = {"kind": "machine_trip", "machine": case.machines[machine == "saturating"].name, "start_s": 0.0}
    fault = {"kind": "bus_fault", "bus": case.loads[3].bus, "start_s": 0.0, "end_s": 1.0, "x_pu": 0.05}
    check_agreement(case, *([trip, fault] if machine else []), iterated=1e-11)


def test_runs_with_few_ports_agree_through_a_fault() -> None:
    fault = {"kind": "bus_fault", "bus": 16, "start_s": 0.02, "end_s": 0.12, "x_pu": 0.002}
    dense, sparse, _ = (p.run(0.5, 0.005) for p in shims(few_ports(), fault))
    swing = np.ptp(dense[2], axis=0).max()
    assert swing > 0.1
    np.testing.assert_allclose(sparse[2], dense[2], rtol=0, atol=1e-10 * swing)


def test_both_forms_agree_beside_phase_shifters_and_buses_without_machine() -> None:
    check_agreement(mesh(6, 5, every=4))


def test_an_event_is_felt_when_it_comes() -> None:
    """The factors are renewed: during a fault the voltage there is low, afterwards it is back."""
    fault = {"kind": "bus_fault", "bus": 16, "start_s": 0.02, "end_s": 0.04, "x_pu": 0.001}
    dense, sparse, _ = (p.run(0.06, 0.01) for p in shims(load_case("new-england"), fault))
    np.testing.assert_allclose(sparse[1], dense[1], rtol=0, atol=1e-11)
    assert np.abs(sparse[2][:, 3::4] - sparse[2][0, 3::4])[2:4].max() > 0.05


def test_pattern_holds_all_that_elimination_fills() -> None:
    """Against elimination of a full matrix in that order, and the promises on which the C relies."""
    random = np.random.default_rng(5)
    n = 40
    ends = np.array(
        [(k, random.integers(k)) for k in range(1, n)]
        + [tuple(random.choice(n, 2, False)) for _ in range(25)]
    )
    active = [3, 11, 30]
    pattern = sparse_pattern(n, ends, active)
    filled = np.eye(n, dtype=bool)
    at = pattern.row[ends]
    filled[at[:, 0], at[:, 1]] = filled[at[:, 1], at[:, 0]] = True
    original = filled.copy()
    for k in range(n):
        below = np.flatnonzero(filled[:, k] & (np.arange(n) > k))
        filled[np.ix_(below, below)] = True
    for start, column, want in (
        (pattern.lower, pattern.lower_column, np.tril(filled, -1)),
        (pattern.upper, pattern.upper_column, np.triu(filled, 1)),
    ):
        rows = np.repeat(np.arange(n), np.diff(start))
        assert sorted(zip(rows, column, strict=True)) == list(zip(*np.nonzero(want), strict=True))
    assert pattern.row[active].min() >= pattern.first > 0
    places = pattern.places(ends)
    rows = np.repeat(np.arange(n), np.diff(pattern.lower)), np.repeat(np.arange(n), np.diff(pattern.upper))
    for (a, b), (one, other) in zip(at, places, strict=True):
        for i, j, place in ((a, b, one), (b, a, other)):
            part, k = divmod(int(place), pattern.fill)
            column = (pattern.lower_column, pattern.upper_column)[part][k]
            assert (rows[part][k], column) == (i, j) and original[i, j]


def test_rows_that_wait_for_as_many_others_lie_together() -> None:
    """Of the rows of a solution each comes after those that wait for fewer: neighbours seldom wait."""
    pattern = network_pattern(mesh(20, 6), np.zeros((0, 18)))
    assert pattern is not None
    wait = np.zeros(len(pattern.row), dtype=int)
    for k in range(pattern.first, len(wait)):
        before = pattern.lower_column[pattern.needed[k] : pattern.lower[k + 1]]
        wait[k] = 1 + max(wait[before], default=0)
    assert np.all(np.diff(wait[pattern.first :]) >= 0) and wait[-1] < len(wait) // 2


def test_the_cheaper_form_is_taken() -> None:
    """Few machines: dense; more: reduced; many on a wide grid: sparse; what is counted is done."""
    assert network_pattern(load_case("nets-nyps"), np.zeros((0, 18))) is None
    wide = mesh(20, 6)
    pattern = network_pattern(wide, np.zeros((0, 18)))
    assert pattern is not None and len(wide.machines) ** 2 > SPARSE_PRICE * pattern.multiplications
    assert pattern.multiplications == 2 * pattern.fill + 120  # a machine at every bus: no row is left out
    assert plant_block(wide).data["plant.counts"][-6] == 120
    assert network_pattern(wide, np.zeros((0, 18)), "dense") is None
    between = mesh(12, 6, every=2)
    counts = [plant_block(between, network=form).data["plant.counts"] for form in (None, "sparse", "dense")]
    assert [c[-3] for c in counts] == [1, 0, 0] and [c[-6] for c in counts] == [72, 72, 0]


@pytest.mark.parametrize("k", [0, 45, -1])
def test_a_damaged_pattern_is_refused(k: int) -> None:
    block = plant_block(load_case("new-england"), network="sparse")
    pattern = np.array(block.data["network.pattern"])
    pattern[k] = 10_000
    with pytest.raises(BlockFailure, match=r"network\.pattern"):
        BlockShim(dataclasses.replace(block, data={**block.data, "network.pattern": pattern}))


def test_a_pivot_that_vanishes_names_the_bus() -> None:
    """A shunt that cancels the admittance of a bus on a spur: the sparse form does not pivot and says so."""
    case = mesh(4, 3, every=12)
    line = {"from": 12, "to": 13, "x": 0.1}
    shunt = {"bus": 13, "Q_mvar": 1000.0, "in_service": False}
    case = case.with_changes({"buses": {"13": {}}, "branches": {"12-13": line}, "shunts": {"S": shunt}})
    switch = {"kind": "shunt_switch", "shunt": "S", "to": "in", "start_s": 0.0}
    slots = event_parameters(case, events_of([switch], where="test"))
    with pytest.raises(BlockFailure, match="singular at bus 13"):
        BlockShim(plant_block(case, network="sparse"), slots)


@pytest.mark.parametrize("form", ["dense", "sparse"])
def test_constant_power_starts_at_the_voltages_of_the_case(form: str) -> None:
    """A load of constant power has a second voltage, near zero, from which Newton would not return."""
    case = mesh(5, 4, every=10)
    constant = {"P_zip": [0, 0, 1], "Q_zip": [0, 0, 1]}
    powers = [-14.0 if k % 2 else 16.0 for k in range(len(case.loads))]
    loads = {q.name: {"P_mw": p, **constant} for q, p in zip(case.loads, powers, strict=True)}
    plant = BlockShim(plant_block(case.with_changes({"loads": loads}), network=form))
    assert np.abs(plant.derivatives(plant.x)[0]).max() < 1e-9
    assert plant.w[: len(case.buses)].min() > 0.9


@pytest.mark.slow
def test_a_page_of_a_dense_network_has_no_other() -> None:
    """PLANT_DENSE leaves the code of sparse networks out: a dense one keeps its bits, others are refused."""
    case, alone = mesh(4, 3), ("-DPLANT_DENSE", "-O0")
    whole, dense = (BlockShim(plant_block(case, network="dense"), flags=flags) for flags in ((), alone))
    x = whole.x + 1e-3
    for one, other in zip(whole.derivatives(x), dense.derivatives(x), strict=True):
        assert np.array_equal(one, other)
    with pytest.raises(BlockFailure, match=r"plant\.counts"):
        BlockShim(plant_block(case, network="sparse"), flags=alone)

    lines = {
        name: page_sources(load_case(name))["layout.h"].startswith(b"#define PLANT_DENSE\n")
        for name in ("two-area-thesis", "new-england")
    }
    large = page_sources(mesh(12, 12))["layout.h"]
    assert all(lines.values()) and not large.startswith(b"#define PLANT_DENSE\n")
