"""The study `inverters`: power flows that stay, closed forms, modes by another path, words."""

from __future__ import annotations

import json
from types import SimpleNamespace

import numpy as np
import pyarrow.parquet as pq
import pytest
from command_line import invoke

import interarea as ia
from interarea.cosim.inverter_study import study as study_module
from interarea.cosim.inverter_study.replaced import (
    FOLLOWING,
    FORMING,
    FORMS,
    KINDS,
    LOADED,
    _smaller,
    replaced,
)
from interarea.cosim.inverter_study.steps import BAND_HZ, BELOW, GridSteps, StepModes, Swing, fault_of, traced
from interarea.cosim.inverter_study.study import FILES, inverter_rows, study_inverters
from interarea.cosim.inverter_study.words import conclusion
from interarea.fmu_build.write.cache import default_cache
from interarea.models.case.case import case_of, load_case
from interarea.models.devices.library import library
from interarea.models.grid.powerflow import solve_powerflow


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("grid", ["two-area-thesis", "nets-nyps"])
def test_every_step_has_the_power_flow_of_the_grid_without_inverters(grid, kind):
    case = load_case(grid)
    before = solve_powerflow(case)
    for share in (0.1, 0.8):
        step = replaced(case, kind, share)
        after = solve_powerflow(step)
        assert np.max(np.abs(after.voltages - before.voltages)) < 1e-9
        dispatch = dict(zip([m.name for m in step.machines], after.generation, strict=True))
        for machine, power in zip(case.machines, before.generation, strict=True):
            assert dispatch[machine.name] == pytest.approx((1.0 - share) * power, abs=1e-7)
            one = next(row for row in step.converters if row.name == f"{machine.name}_inverter")
            rated = max(share * machine.base_mva, share * abs(power) * case.base_mva / LOADED)
            assert one.base_mva == pytest.approx(rated)
    assert replaced(case, kind, 0.0) is case


def test_a_rating_of_a_governor_follows_its_machine():
    rated = SimpleNamespace(base_mva=900.0, governor=SimpleNamespace(Trate=800.0))
    assert _smaller(rated, 700 + 100j, 0.75)["governor"] == {"Trate": pytest.approx(600.0)}
    by_machine = SimpleNamespace(base_mva=900.0, governor=SimpleNamespace(Trate=0.0))
    assert "governor" not in _smaller(by_machine, 700 + 100j, 0.75)


def test_a_grid_forming_inverter_swings_as_its_droop_says():
    """On an infinite bus: delta' = w0 mp (P0 - Pf), Tpf Pf' = K delta - Pf, K = E V cos(delta0)/X.

    Its voltage E is constant with its control of the voltage and of Q left out (Vflag and mq of 0).
    """
    control = FORMS | {"Vflag": 0.0, "mq": 0.0, "kppmax": 0.0, "kipmax": 0.0, "kpqmax": 0.0, "kiqmax": 0.0}
    bus = {"area": 1}
    far = {"area": 1, "model": "infinite_bus", "Xd1": 1e-4}
    document = {
        "name": "droop",
        "title": "a grid-forming inverter on an infinite bus",
        "source": "ours",
        "frequency_hz": 60.0,
        "base_mva": 100.0,
        "buses": {"1": bus, "2": bus},
        "branches": {"line": {"from": 1, "to": 2, "x": 0.25}},
        "machines": {"G2": far | {"bus": 2, "base_mva": 1e6, "P_mw": 0.0, "V_pu": 1.0, "slack": True}},
        "converters": {
            "gfm1": {"bus": 1, "base_mva": 100.0, "P_mw": 50.0, "Q_mvar": 0.0, "control": control}
        },
    }
    case = case_of(document, where="droop")
    values = {p.name: p.default for p in library()["regfm_a1"].device.parameters} | control
    X, T, droop = values["Xe"], values["Tpf"], values["mp"]
    flow = solve_powerflow(case)
    V, S = flow.voltage(1), 0.5
    E = V + 1j * X * np.conj(S / V)
    away = flow.voltage(2) + 1j * 1e-8 * np.conj(flow.generation[0] / flow.voltage(2))
    K = abs(E) * abs(away) * np.cos(np.angle(E / away)) / (X + 0.25 + 1e-8)
    expected = np.roots([T, 1.0, case.omega_b * droop * K])
    A = np.asarray(ia.linearise(case).A)
    for value in expected:
        assert np.min(np.abs(np.linalg.eigvals(A) - value)) < 1e-5 * abs(value)


@pytest.mark.parametrize("kind", KINDS)
def test_the_modes_of_a_step_are_those_of_its_whole_spectrum(kind):
    steps = GridSteps(load_case("two-area-thesis"), default_cache())
    case = steps.at(kind, 0.5)
    modes = steps.modes(case)
    assert modes.complete
    assert not modes.growing
    values = np.linalg.eigvals(np.asarray(ia.linearise(case).A))
    values = values[(values.imag > 2 * np.pi * BAND_HZ[0]) & (values.imag < 2 * np.pi * BAND_HZ[1])]
    damping = -values.real / np.abs(values)
    assert modes.counted == np.sum(damping < BELOW)
    for one in modes.swings:
        near = np.argmin(
            np.abs(values.imag / (2 * np.pi) - one.frequency_hz) + np.abs(damping - one.damping_ratio)
        )
        assert values[near].imag / (2 * np.pi) == pytest.approx(one.frequency_hz, rel=1e-6)
        assert damping[near] == pytest.approx(one.damping_ratio, abs=1e-6)


def test_a_grid_without_a_bundled_design_has_a_fault_at_its_most_loaded_branch():
    case = load_case("kundur-pss")
    fault = fault_of(case, solve_powerflow(case))
    flow = solve_powerflow(case)
    assert GridSteps(case, default_cache()).fault == fault
    carried = {b.name: abs(flow.flow(b.name, b.from_bus)) for b in case.branches}
    parallel = [name for name in carried if name[:3] in ("7-8", "8-9", "6-7", "9-1")]
    assert carried[fault.trip] <= max(carried.values())
    assert fault.trip in carried
    assert fault.trip in parallel or carried[fault.trip] == max(carried.values())


def _swing(damping, **shape):
    return Swing("inter-area", 0.5, damping, {m: complex(z) for m, z in shape.items()})


def _step(*swings):
    return StepModes(10, swings, 0, len(swings), "")


def test_a_mode_is_followed_by_its_shape_not_by_its_damping():
    first = _step(_swing(0.05, G1=1, G2=-1), _swing(0.2, G1=1, G2=0.9))
    second = _step(_swing(0.01, G1=1, G2=1), _swing(0.3, G1=-0.9, G2=1))
    third = _step(_swing(0.01, G1=1, G2=1))
    fourth = _step(_swing(0.4, G1=1j, G2=-1j))
    assert [one and one.damping_ratio for one in traced([first, second, third, fourth])] == [
        *(0.05, 0.3, None, 0.4),
    ]
    assert _swing(0, G1=1, G2=-1).likeness(_swing(0, G1=-2j, G2=2j)) == pytest.approx(1.0)


def _row(kind, share, **more):
    keys = ("inter_area_hz", "inter_area_damping", "worst_name", "worst_hz", "worst_damping")
    keys += ("controlled_complete", "controlled_stable", "controlled_damping", "controlled_worst_damping")
    keys += ("clearing_cycles", "clearing_controlled", "link_own", "link_afar")
    row = {"kind": kind, "share": share, "complete": True, "stable": True, "growing": ""}
    return row | dict.fromkeys(keys) | more


def test_the_words_follow_from_the_numbers():
    worst = {"worst_name": "inter-area", "worst_hz": 0.6}
    last = {"inter_area_hz": 1.1, "inter_area_damping": 0.05, "worst_damping": 0.05, **worst}
    last |= {"stable": False, "growing": "UNSTABLE: 2", "complete": False, "controlled_stable": False}
    last |= {"link_own": 0.1, "link_afar": 0.2, "clearing_cycles": 4.0}
    rows = [
        _row(FOLLOWING, 0.0, inter_area_hz=0.6, inter_area_damping=0.08, worst_damping=0.08, **worst),
        _row(FOLLOWING, 0.4, inter_area_hz=0.8, inter_area_damping=0.02, worst_damping=0.02, **worst),
        _row(FOLLOWING, 0.8, **last),
        _row(FORMING, 0.8, worst_damping=0.2, worst_name="local area 1", worst_hz=1.5),
    ]
    text = "\n".join(conclusion(rows))
    assert "from 0.60 to 1.10 Hz and its damping ratio from 0.080 to 0.050, minimum 0.020 at 40 %" in text
    assert "unstable at 80 % (UNSTABLE: 2); the least damped swing mode is inter-area at 40 %" in text
    assert "the damping of the worst swing mode is lower at every share" in text
    assert "a signal of another area pays at 80 % (0.100 to 0.200)" in text
    assert "damping ratio of the worst swing mode at 80 %: grid-following 0.050, grid-forming 0.200" in text
    assert "confirms that 3 of 4 lists of modes are complete" in text
    loops = {"controlled_stable": True, "worst_damping": 0.1, **worst}
    gains = {0.0: 0.02, 0.1: 1e-8, 0.2: -1e-8, 0.3: -0.02}  # what rounding moves is no gain
    rows = [_row(FORMING, s, controlled_worst_damping=0.1 + gain, **loops) for s, gain in gains.items()]
    rows.append(_row(FORMING, 0.4, **loops | {"controlled_stable": False}))
    text = "\n".join(conclusion(rows))
    assert "is higher at 0 %; equal at 10 %, 20 %; lower at 30 %, 40 %; the loop is unstable at 40 %" in text


@pytest.mark.slow
def test_a_stopped_study_goes_on_and_writes_page_and_tables(tmp_path, monkeypatch):
    monkeypatch.setattr(study_module, "SHARES", (0.0, 0.5))
    monkeypatch.setattr(study_module, "LINK_SHARES", (0.5,))
    grids = {"two-area-thesis": load_case("two-area-thesis")}
    none = study_inverters(grids, tmp_path, default_cache(), minutes=1e-9)
    assert none["no_time_for"]
    whole = study_inverters(grids, tmp_path, default_cache(), minutes=60.0)
    assert whole["no_time_for"] == []
    rows = whole["grids"][0]["rows"]
    assert [(row["kind"], row["share"]) for row in rows] == [(k, s) for k in KINDS for s in (0.0, 0.5)]
    assert all(row["complete"] and row["controlled_complete"] and not row["problem"] for row in rows)
    assert rows[1]["inter_area_hz"] > rows[0]["inter_area_hz"]
    assert json.loads((tmp_path / FILES[0]).read_text())["grids"][0]["rows"] == rows
    table = pq.read_table(tmp_path / FILES[2]).to_pylist()
    assert table == inverter_rows(whole)
    assert "grid-forming" in (tmp_path / FILES[1]).read_text()


def test_refusals_name_the_option(tmp_path, monkeypatch):
    for words, says in (
        (["--mva", "5"], "--mva: belongs to the study actuators, not to inverters"),
        (["--grid", "no-grid"], "--grid no-grid: not a grid"),
    ):
        code, _, err = invoke(["study", "inverters", *words, "--out", str(tmp_path / "out")], monkeypatch)
        assert code == 2
        assert says in err
