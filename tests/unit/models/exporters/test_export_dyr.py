"""Dynamic data written as DYR and read back with the RAW file: the same machines and controls."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from grid_text import dyr_text, raw_text
from plant_shim import BlockShim

from interarea.models.blocks.plant import plant_block
from interarea.models.case.case import Case, load_case
from interarea.models.exporters.dyr import dyr_of
from interarea.models.exporters.raw import raw_of
from interarea.models.importers.psse import import_psse

CONTROLS = {
    "ESST4B": "1 1 1 0 5 -5 0.01 1 0 5 -5 0 1 0 6 0.1 0 0",
    "IEEET1": "1 0.02 40 0.05 5 -5 1 0.5 0.03 1 0 3 0.08 4 0.3",
    "HYGOV": "1 0.05 0.3 5 0.05 0.5 0.2 1.1 0 1.5 1.2 0.5 0.05",
    "PSS2B": "1 1 0 3 0 5 1 2 2 2 0 2 1 1 0.5 0.1 10 0.2 0.03 0.3 0.03 0 0 9 -9 9 -9 0.1 -0.1",
}


def imported(folder: Path, extra: str = "") -> Case:
    """Kundur's grid with records of other models at G1."""
    case = load_case("kundur-manual")
    raw, dyr = folder / "first.raw", folder / "first.dyr"
    raw.write_text(raw_text(case))
    dyr.write_text(dyr_text(case) + extra)
    return import_psse(raw, dyr).case


def again(folder: Path, case: Case) -> tuple[Case, tuple[str, ...]]:
    raw, dyr = folder / "second.raw", folder / "second.dyr"
    raw.write_text(raw_of(case).text)
    written = dyr_of(case)
    dyr.write_text(written.text)
    return import_psse(raw, dyr).case, written.losses


def same(one: Case, other: Case) -> None:
    A, B = (BlockShim(plant_block(c)).jacobians()[0] for c in (one, other))
    np.testing.assert_allclose(A, B, rtol=1e-7, atol=1e-7)


@pytest.mark.parametrize("extra", ["IEEET1", "HYGOV", "ESST4B HYGOV"])
def test_controls_come_back_with_every_parameter(tmp_path: Path, extra: str) -> None:
    case = imported(tmp_path, "".join(f"1 '{model}' {CONTROLS[model]} /\n" for model in extra.split()))
    copy, losses = again(tmp_path, case)
    assert losses == ()
    for ours, theirs in zip(case.machines, copy.machines, strict=True):
        for word in ("exciter", "governor", "stabilizer"):
            one, two = getattr(ours, word), getattr(theirs, word)
            assert (one is None) == (two is None)
            if one is not None:
                assert (one.kind, one.parameters) == (two.kind, two.parameters)
    same(case, copy)


def test_machines_of_every_model_come_back(tmp_path: Path) -> None:
    case = load_case("kundur-manual").with_changes(
        {
            "machines": {
                "defaults": {"exciter": {"kind": "constant"}, "governor": {"kind": "none"}},
                "G1": {"model": "classical", "saturation": "none"},
                "G2": {"Xq1": 1.7, "Tq01": "none", "saturation": "none", "torque_by_speed": True},
                "G3": {"model": "infinite_bus", "saturation": "none", "H": "none"},
                "G4": {
                    "saturation": "none",
                    "flux_saturation": {"S10": 0.1, "S12": 0.4},
                    "torque_by_speed": True,
                },
            }
        }
    )
    copy, losses = again(tmp_path, case)
    assert losses == ()
    text = dyr_of(case).text
    assert [line.split()[1] for line in text.splitlines()[1:]] == [
        "'GENCLS'",
        "'GENSAL'",
        "'GENCLS'",
        "'GENROU'",
    ]
    same(case.with_changes({"loads": {"defaults": {"P_exponent": 2.0, "Q_exponent": 2.0}}}), copy)


def test_what_no_record_holds_is_named() -> None:
    losses = dyr_of(load_case("kundur-thyristor")).losses
    assert any("exciter: " in line for line in losses)
    bare = load_case("kundur-manual").with_changes({"machines": {"G1": {"Xq2": 0.3}}})
    assert "G1: X''q = 0.3, which becomes X''d" in dyr_of(bare).losses


def test_what_a_record_cannot_hold_of_a_machine_is_named(tmp_path: Path) -> None:
    losses = dyr_of(load_case("kundur-manual")).losses
    assert any("torque is not power over speed" in line for line in losses)
    assert any("Asat exp" in line for line in losses)


@pytest.mark.parametrize(
    "saturation",
    [
        {"S10": 0.1, "S12": 0.4},
        {"S10": 0.1, "S12": 0.4, "of": "transient_emf", "axes": "d"},
        {"S10": 0.1, "S12": 0.4, "shape": "exponential"},
    ],
)
def test_a_machine_with_one_damper_on_q_keeps_its_own_saturation(
    tmp_path: Path, saturation: dict[str, object]
) -> None:
    """GENROU and GENROE with X'q = Xq keep two windings on the q axis; GENSAL has one."""
    case = imported(tmp_path)
    windings = {"Tq01": "none"} if saturation.get("axes") == "d" else {}
    machine = {"Xq1": case.machines[0].Xq, "flux_saturation": saturation} | windings
    case = case.with_changes({"machines": {case.machines[0].name: machine}})
    copy, losses = again(tmp_path, case)
    assert losses == ()
    assert copy.machines[0].flux_saturation == case.machines[0].flux_saturation
    same(case, copy)
