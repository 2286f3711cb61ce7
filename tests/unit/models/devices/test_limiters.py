"""Limiters of the excitation: their block diagram in closed form, and what they do to a machine."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from grid_text import raw_text
from plant_shim import BlockShim
from scipy.integrate import solve_ivp

from interarea.cosim.designs.sensitivities import state_matrix
from interarea.fmu_build.write.cache import default_cache
from interarea.models.blocks.plant import event_parameters, plant_block
from interarea.models.case.case import Case, load_case
from interarea.models.case.events import events_of
from interarea.models.devices.library import library
from interarea.models.devices.rest import rest_of
from interarea.models.devices.rows import numbers_of, row_of
from interarea.models.errors import CaseError
from interarea.models.exporters.dyr import dyr_of
from interarea.models.grid.control_tables import StartError
from interarea.models.grid.equilibrium import operating_point
from interarea.models.grid.start import release_limits, start_of
from interarea.models.importers.psse import import_psse

RATED, GAIN, LOW = 2.0, 0.02, 0.05
MAXEX2 = {
    "EFDRATED": RATED,
    "EFD1": 1.1,
    "TIME1": 60.0,
    "EFD2": 1.2,
    "TIME2": 30.0,
    "EFD3": 1.5,
    "TIME3": 15.0,
}
MAXEX2 |= {"EFD3": 1.5, "TIME3": 15.0, "EFDDES": 1.0, "KMX": GAIN, "VLOW": -LOW}
MACHINES = "".join(
    f"{k} 'GENROU' '1' 8.0 0.03 0.4 0.05 {H} 0.0 1.8 1.7 0.3 0.55 0.25 0.2 0.0 0.0 /\n"
    for k, H in ((1, 6.5), (2, 6.5), (3, 6.175), (4, 6.175))
)
CONTROLS = "".join(
    f"{k} 'SEXS' 1 0.1 10 100 0.1 -5 5 /\n{k} 'TGOV1' 1 0.05 0.5 1.2 0 3 10 0 /\n" for k in (1, 2, 3, 4)
)


def output(field: Callable[[float], float], times: np.ndarray, **changed: float) -> np.ndarray:
    """The output of the limiter at `times` under a field current, pu of the rated one."""
    model = library()["maxex2"]
    values = numbers_of(model.device, row_of(model.device, MAXEX2 | changed), 100.0, 60.0)
    seen = dict.fromkeys(model.device.inputs, 0.0) | {"vt": 1.0}
    point = rest_of(model, values, seen | {"ifd": 0.9 * RATED}, None, "test")
    run = solve_ivp(
        lambda t, x: point.instance.run(x, seen | {"ifd": field(t) * RATED})[1],
        (0.0, times[-1]),
        point.states,
        t_eval=times,
        max_step=0.02,
    )
    low, high = -LOW, 0.0  # the integrator stays on its limit, which the solver here oversteps a little
    return np.clip(run.y[point.instance.state_names.index("vl")], low, high)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("size", "acts_s"), [(1.1001, 59.97), (1.15, 45.0), (1.2, 30.0), (1.35, 22.5), (1.5, 15.0), (3.0, 15.0)]
)
def test_the_time_allowed_falls_along_the_points(size: float, acts_s: float) -> None:
    """Straight lines between the points, the last one beyond; then K (EFDDES - x) EFDRATED a second."""
    times = acts_s + np.array([-0.1, 0.1, 0.3])
    slope = GAIN * (1.0 - size) * RATED
    expected = np.array([0.0, 0.1 * slope, 0.3 * slope])
    assert output(lambda t: size, times) == pytest.approx(np.maximum(expected, -LOW), abs=0.03 * abs(slope))


@pytest.mark.slow
def test_it_ends_where_less_is_asked_for_and_begins_anew() -> None:
    """Down to VLOW by 1.2, up again from 35 s on by 0.9 (0.004 a second), and a clock that begins at 0."""

    def field(t: float) -> float:
        return 1.2 if t < 35.0 or t > 55.0 else 0.9

    times = np.array([29.0, 35.0, 40.0, 48.0, 60.0, 84.0, 90.0])
    seen = output(field, times)
    assert seen[[0, 3, 4, 5]] == pytest.approx(0.0, abs=2e-5)
    assert seen[[1, 2]] == pytest.approx([-0.04, -0.02], abs=4e-4)
    assert seen[6] < -0.035


@pytest.mark.slow
def test_below_its_first_point_it_never_acts() -> None:
    assert np.abs(output(lambda t: 1.09, np.linspace(1.0, 200.0, 5))).max() == 0.0


def case_of(folder: Path, *fields: float) -> Case:
    (folder / "grid.raw").write_text(raw_text(load_case("kundur-thyristor-z")))
    record = f"1 'MAXEX2' 1 {' '.join(map(str, fields))} /\n" if fields else ""
    (folder / "grid.dyr").write_text(MACHINES + CONTROLS + record)
    return import_psse(folder / "grid.raw", folder / "grid.dyr").case


RECORD = (1, 1.9, 1.03, 4, 1.1, 3, 1.25, 2, 1.025, 0.05, -0.1)


@pytest.mark.slow
def test_in_a_machine_it_takes_the_field_back_to_what_it_holds(tmp_path: Path) -> None:
    """A reference raised by 0.03 pu; without the record the field does not come back."""
    ends = []
    for case in (case_of(tmp_path), case_of(tmp_path, *RECORD)):
        event = {"kind": "vref_step", "machine": "G1", "size_pu": 0.03, "start_s": 1.0}
        plant = BlockShim(plant_block(case), event_parameters(case, events_of([event], where="test")))
        _, states, _ = plant.run(90.0, 0.01)
        ends.append(states[[200, -1], plant.state_names.index("G1.exciter.efd")])
    bare, limited = ends
    assert limited[0] == pytest.approx(bare[0], abs=1e-9)  # until it acts
    assert bare[1] > 1.05 * 1.9 and limited[1] == pytest.approx(1.025 * 1.9, abs=1e-3)


def test_at_rest_it_moves_no_mode_and_waits(tmp_path: Path) -> None:
    bare, case = case_of(tmp_path), case_of(tmp_path, *RECORD)
    plain, with_it = (np.linalg.eigvals(state_matrix(c, default_cache())) for c in (bare, case))
    swings = plain[plain.imag > 1.0]
    assert len(swings) >= 3 and all(np.abs(with_it - mode).min() < 1e-8 for mode in swings)
    first, second = start_of(case).text().splitlines()
    assert first == "start: every control is within its limits"
    assert second == "start: 2 signals are at a limit by design (maxex2 c, maxex2 vl)"


def test_its_record_goes_in_and_out(tmp_path: Path) -> None:
    case = case_of(tmp_path, *RECORD)
    assert "1 'MAXEX2' '1' 0.0 1.9 1.03 4.0 1.1 3.0 1.25 2.0 1.025 0.05 -0.1 /" in dyr_of(case).text


def test_a_field_above_its_first_point_at_rest_is_refused_or_its_rating_raised(tmp_path: Path) -> None:
    """The rating for which the first point, 1.03 of it, lies a tenth above the field at rest."""
    bare, case = case_of(tmp_path), case_of(tmp_path, 1, 1.0, *RECORD[2:])
    (rest,) = [c.rest for c in operating_point(bare).controls.of("exciter") if c.prefix == "G1.exciter"]
    field = rest.signals["efd"]
    with pytest.raises(
        StartError, match=rf"limiter: c is not .* {field:.5g}\d* is above EFD1\*EFDRATED = 1\.03"
    ):
        operating_point(case)
    released, said = release_limits(case)
    rating = next(m for m in released.machines if m.name == "G1").limiter.EFDRATED
    assert rating == pytest.approx(1.1 * field / 1.03, rel=1e-9)
    assert said == (f"G1.limiter.EFDRATED: 1 -> {rating:.6g}",)
    assert start_of(released).text().startswith("start: every control is within its limits")


def test_points_out_of_order_are_refused(tmp_path: Path) -> None:
    with pytest.raises(CaseError, match=r"EFD1 = 1\.03.* in rising order"):
        case_of(tmp_path, 1, 1.9, 1.03, 4, 1.02, *RECORD[5:])


#: each does nothing: limits of the output, of the integrator, of the rate
SWITCHED_OFF = {
    "stabilizer": "1 'IEEEST' 1 1 0 0 0 0 0 0 0 0 0 0 0 5 10 3 0 0 0 0 /\n",
    "limiter": f"1 'MAXEX2' 1 {' '.join(map(str, RECORD[:-1]))} 0 /\n",
    "governor": "1 'IEEEG1' 1 0 0 20 0.1 0 0.2 0 0 1 0 0.3 0.3 0 5 0.3 0 0.4 0.4 0 0 0 0 /\n",
}


@pytest.mark.slow
@pytest.mark.parametrize("kind", SWITCHED_OFF)
def test_a_control_whose_limits_coincide_moves_no_mode(kind: str, tmp_path: Path) -> None:
    """The exact derivatives are those of a signal that stands still, as differences see it."""
    (tmp_path / "grid.raw").write_text(raw_text(load_case("kundur-thyristor-z")))
    cases = []
    for record in ("", SWITCHED_OFF[kind]):
        (tmp_path / "grid.dyr").write_text(
            MACHINES
            + "\n".join(x for x in CONTROLS.splitlines() if not x.startswith("1 'TGOV1'"))
            + "\n"
            + record
        )
        cases.append(import_psse(tmp_path / "grid.raw", tmp_path / "grid.dyr").case)
    plain, with_it = (np.linalg.eigvals(state_matrix(c, default_cache())) for c in cases)
    assert all(np.abs(with_it - mode).min() < 1e-8 * max(1.0, abs(mode)) for mode in plain if mode.imag > 1.0)
    assert release_limits(cases[1])[1] == ()
    text = start_of(cases[1]).text()
    assert kind == "governor" or f"coincide, so the signal is constant: G1.{kind} " in text
