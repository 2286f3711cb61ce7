"""The study `worth`: equal terms, more signals never worse, numbers that other paths give too, refusals."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import control
import pyarrow.parquet as pq
import pytest
from command_line import invoke

from interarea.cosim.designs.family import FamilyPlant
from interarea.cosim.grid_study import link_worth
from interarea.cosim.grid_study.link_sets import LinkSet, conclusion
from interarea.cosim.grid_study.link_study import FILES, link_rows
from interarea.cosim.grid_study.link_worth import AFAR, AREA, OWN, LinkDesigns, LinkRow
from interarea.cosim.grid_study.weak_modes import WeakModes, modes_of_grid, weak_modes
from interarea.design.controllers.bundled import shipped_controller
from interarea.design.controllers.controller import Controller
from interarea.design.delay.signal_conditions import Condition
from interarea.design.modes.loop_points import LoopSet
from interarea.design.robust.operating_points import inter_area_band
from interarea.design.robust.signal_worth import OWN_MASKED, signal_worth
from interarea.design.robust.smoothed_objective import BandOffsets
from interarea.fmu_build.write.cache import default_cache
from interarea.models.case.case import load_case


@pytest.fixture(scope="module")
def weak() -> WeakModes:
    return weak_modes(modes_of_grid(load_case("two-area-thesis"), default_cache()))


def _set(weak: WeakModes, *actuators: str) -> LoopSet:
    return next(one for one in weak.sets if one.actuators == actuators)


def test_each_actuator_sees_one_machine_more_that_has_no_loop(weak: WeakModes) -> None:
    sees, missing = link_worth.signals_of_set(weak, _set(weak, "G2_vs", "G4_vs"))
    assert not missing
    assert sees[OWN] == {"G2_vs": ("G2_dw",), "G4_vs": ("G4_dw",)}
    assert sees[AREA] == {"G2_vs": ("G2_dw", "G1_dw"), "G4_vs": ("G4_dw", "G3_dw")}
    assert sees[AFAR] == {"G2_vs": ("G2_dw", "G3_dw"), "G4_vs": ("G4_dw", "G1_dw")}
    _, missing = link_worth.signals_of_set(weak, _set(weak, "G3_vs", "G4_vs"))
    assert missing == {AREA: "no machine of the area of G3 that has no loop of the set"}


def test_a_device_at_a_bus_has_no_signal_of_its_own() -> None:
    weak = weak_modes(modes_of_grid(load_case("two-area-svc"), default_cache()))
    (device,) = (name for name in weak.plant.inputs if not name.endswith("_vs"))
    sees, missing = link_worth.signals_of_set(weak, LoopSet((device,), 1.0, 0.0, "inter-area", {}))
    assert set(missing) == {OWN, AREA} and "without a signal of its own machine" in missing[OWN]
    (pair,) = sees[AFAR].values()
    areas = {weak.case.areas[name.removesuffix("_dw")] for name in pair}
    assert len(areas) == 2
    # both signals come over the link: each is late, and each is lost in turn
    assert [c.lost for c in link_worth._losses(sees[AFAR], 200)] == [(pair[0],), (pair[1],)]


def test_a_search_that_finds_nothing_costs_nothing(
    weak: WeakModes, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(link_worth, "short_controller", lambda *_, **__: None)
    designs = LinkDesigns(weak, {"base": weak.case}, BandOffsets(), (), default_cache())
    designs.cache = tmp_path  # what is made here is no design
    sees, _ = link_worth.signals_of_set(weak, _set(weak, "G4_vs"))
    own = designs.designed(sees[OWN])
    none = designs.row(OWN, sees[OWN], 0, own)
    # without control: the damping of the mode itself, which another routine computed
    assert none.there == pytest.approx(weak.weakest.damping_ratio, abs=1e-9)
    assert none.effort == 0.0 and none.lost is None
    nothing = designs.designed(sees[AFAR], 200, own)
    more = designs.row(AFAR, sees[AFAR], 200, nothing, own)
    assert (more.there, more.late, more.lost) == pytest.approx((none.there,) * 3, abs=1e-9)

    # an own-signal controller: what `signal_worth` says of `robust` with the remote signal masked
    robust = shipped_controller("robust").system
    place = robust.input_labels.index("G4_dw")
    alone = control.ss(
        robust.A, robust.B[:, [place]], robust.C, robust.D[:, [place]], inputs=["G4_dw"], outputs=["G4_vs"]
    )
    row = designs.row(AFAR, sees[AFAR], 200, nothing, Controller("own", alone))
    plant = FamilyPlant.of(weak.case, sees[AFAR]["G4_vs"], ("G4_vs",), default_cache())
    bands = {"base": inter_area_band(plant.modes)}
    said = signal_worth({"base": plant.judged}, robust, [Condition("N")], bands_hz=bands).masked[-1]
    assert (row.there, row.late, row.lost) == pytest.approx((said.inter_area,) * 3, abs=1e-9)
    assert row.effort == pytest.approx(said.effort, rel=1e-9)
    assert row.there > none.there + 0.1


@pytest.mark.slow
def test_rows_are_what_signal_worth_says_and_more_signals_are_never_worse(weak: WeakModes) -> None:
    designs = LinkDesigns(weak, {"base": weak.case}, BandOffsets(), (), default_cache())
    sees, _ = link_worth.signals_of_set(weak, _set(weak, "G4_vs"))
    searched = designs.designed(sees[OWN])
    controllers = {ms: designs.designed(sees[AFAR], ms, searched) for ms in (0, 500)}
    rival = designs.best_own(sees[OWN], [searched, *controllers.values()])
    own = designs.row(OWN, sees[OWN], 0, rival)
    assert own.least > weak.weakest.damping_ratio
    plant = FamilyPlant.of(weak.case, sees[AFAR]["G4_vs"], ("G4_vs",), default_cache())
    for latency_ms, controller in controllers.items():
        assert designs.row(AFAR, sees[AFAR], latency_ms, controller, rival).least >= own.least - 1e-9
        row = designs.row(AFAR, sees[AFAR], latency_ms, controller)
        late = Condition("late", (), {"G2_dw": 1e-3 * latency_ms})
        conditions = [Condition("N"), *([late] if latency_ms else [])]
        said = signal_worth(
            {"base": plant.judged},
            controller.system,
            conditions,
            rival.system,
            bands_hz={"base": inter_area_band(plant.modes)},
        )
        assert said.rival is not None
        assert said.whole.inter_area == pytest.approx(min(row.there, row.late), abs=1e-8)
        assert said.whole.effort == pytest.approx(row.effort, rel=1e-6)
        assert said.rival.inter_area == pytest.approx(own.there, abs=1e-8)
        # the rival is no worse than any of these controllers with the link masked
        assert all(own.there >= m.inter_area - 1e-8 for m in said.masked if m.name == OWN_MASKED and m.stable)


def test_a_second_search_leaves_no_slow_root_unstable(weak: WeakModes) -> None:
    loose = BandOffsets((0.0, 0.5, 4.5, 30.0), (-0.3, -0.3, 0.0, -0.4))
    steady = LinkDesigns(weak, {"base": weak.case}, loose, (), default_cache())._steady()
    # what reaches the damping that the mode has anyway asks no less than stability of slower ones
    least = weak.weakest.damping_ratio
    assert steady.offset == (-least, -least, 0.0, -0.4)


def _rows(values: Sequence[tuple[str, int, float, float | None]]) -> LinkSet:
    rows = tuple(
        LinkRow(("G4_vs",), name, {}, ms, least, least, None, True, 0.1, 0.2, None, cycles)
        for name, ms, least, cycles in values
    )
    return LinkSet(LoopSet(("G4_vs",), 1.0, 0.0, "inter-area", {}), rows, {})


def test_conclusions_follow_from_the_numbers() -> None:
    local = _rows([(OWN, 0, 0.30, 0.5), (AFAR, 0, 0.319, 0.9), (AFAR, 200, 0.31, None)])
    assert "at G4 a local stabilizer performs as well: do not build this link" in conclusion([local])
    link = _rows([(OWN, 0, 0.20, 0.5), (AREA, 0, 0.29, 0.5), (AFAR, 0, 0.30, 0.9), (AFAR, 200, 0.21, None)])
    assert conclusion([link]) == (
        "at G4 the link adds 0.100 of inter-area damping at 0 ms; inter-area damping without it 0.200 "
        "(a signal of the own area performs as well at 0 ms); at 200 ms a local stabilizer performs as well: "
        "do not build the link"
    )
    faults = _rows([(OWN, 0, 0.30, -2.0), (AFAR, 0, 0.30, 1.0), (AFAR, 200, 0.30, 0.5)])
    assert conclusion([faults]) == (
        "at G4 the link adds 2.5 to 3.0 cycles of clearing time at 0, 200 ms; inter-area damping "
        "without it 0.300"
    )


def test_a_grid_without_a_weak_mode_has_its_reason(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    out = tmp_path / "out"
    code, shown, err = invoke(["study", "worth", "--grid", "kundur-pss", "--out", str(out)], monkeypatch)
    assert code == 0, err
    assert [Path(line).name for line in shown.split()] == list(FILES)
    study: dict[str, Any] = json.loads((out / "worth.json").read_text(encoding="utf-8"))
    assert study["grids"][0]["problem"].startswith("kundur-pss: no weak inter-area mode")
    assert "no weak inter-area mode" in (out / "worth.html").read_text(encoding="utf-8")
    assert pq.read_table(out / "worth.parquet").num_rows == len(link_rows(study)) == 0


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["worth", "--grid", "nowhere"], "--grid nowhere: not a grid"),
        (["worth", "--dyr", "a.dyr"], "--dyr a.dyr: not with the study worth"),
        (["thesis", "--grid", "two-area-thesis"], "--grid two-area-thesis: belongs to the study worth"),
    ],
)
def test_bad_input_is_refused_in_a_line(
    words: list[str], said: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("a.dyr").touch()
    code, _, err = invoke(["study", *words, "--out", str(tmp_path / "out")], monkeypatch)
    assert code == 2 and said in err and len(err.splitlines()) == 1, err
    assert not (tmp_path / "out").exists()
