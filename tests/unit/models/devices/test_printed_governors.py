"""Governors and exciters against numbers printed by others [Lara2023], and against an exact delay."""

from __future__ import annotations

import math
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from interarea.cosim.designs.sensitivities import state_matrix
from interarea.fmu_build.write.cache import default_cache
from interarea.models.case.case import Case, load_case
from interarea.models.devices.language.device import FBASE, MBASE
from interarea.models.devices.library import library
from interarea.models.devices.rest import RestPoint, rest_of
from interarea.models.devices.rows import numbers_of, row_of
from interarea.models.errors import CaseError, DeviceError
from interarea.models.exporters.dyr import dyr_of
from interarea.models.grid.control_tables import StartError
from interarea.models.grid.equilibrium import operating_point
from interarea.models.importers.imported import ImportOptions
from interarea.models.importers.psse import import_psse

RAW = Path(__file__).parent / "psse_records" / "ThreeBusMulti.raw"
MACHINE = "8 0.03 0.4 0.05 6.175 0.05 1.8 1.7 0.3 0.55 0.25 0.2"
SEXS = "102 'SEXS' 1 0.4 5 20 1 -50 50 /\n"
PIDGOV = "0.05 0.01 5 1 0.1 0.5 0.99 0.001 0.1 0.7 0.3 0.9 0.5 0.9 1 0.05 1 0.6 0.04 -0.04"
WPIDHY = "0.01 -0.05 3 0.5 3 0.02 0.01 0.025 -0.025 1 0.2 3.25 52001 0 0 0.12 0.545 0.4 0.827 0.83 1"
ST8C = "0.01 5 5 99.99 0 4 0.1 99.9962 -99.866 1.35 0.003 99.3449 -99.1691 0.5 0.005 0.1 4 0 0 0 99 0 0 99"

#: test/results/results_eigenvalues.jl at d94d74e: test58 (gate, power), test60; the upper half, 1/s
PRINTED = {
    f"102 'PIDGOV' 1 1 {PIDGOV} /": (
        "-100.00010646 -41.17482850 -38.78987098 -5.71823817 -3.79356589 -2.04541569 "
        "-2.00000000 -1.22285558+0.72000477j -0.96552066 -0.90013340+8.44783636j "
        "-0.19849914+0.17939599j -0.04238523"
    ),
    f"102 'PIDGOV' 1 0 {PIDGOV} /": (
        "-99.99999037 -41.17481962 -38.78985513 -5.64742744 -3.89829432+1.57542841j "
        "-2.00000000 -0.94925537 -0.86866757+8.49611151j -0.28282149+1.10977593j "
        "-0.19750676+0.17956822j -0.11697960"
    ),
    f"102 'WPIDHY' 1 {WPIDHY} /": (
        "-106.13231871 -91.13024820 -63.86880813 -40.03565107 -38.75323547+8.12581882j "
        "-6.10482678 -1.39512724+5.96660797j -0.94495311 -0.48179150 -0.19415050+0.18213498j "
        "-0.03057660+0.30118043j"
    ),
}


def case_with(records: str, folder: Path, machine: str = f"{MACHINE} 0 1") -> Case:
    """Three buses, an infinite one; 70 MW at bus 102 and a load of 200 MW, as in the tests of the source."""
    dyr = folder / "grid.dyr"
    dyr.write_text(f"101 'GENCLS' 1 0 0 /\n102 'GENROU' 1 {machine} /\n{records}\n")
    raw = folder / "grid.raw"
    text = RAW.read_text().replace("1,   250.000,    30.000", "1,   200.000,    30.000")
    raw.write_text(text.replace("102,'1 ',   100.000", "102,'1 ',    70.000").replace("153.335", "133.335"))
    return import_psse(raw, dyr).case


@pytest.mark.slow
@pytest.mark.parametrize("record", PRINTED, ids=("gate", "power", "WPIDHY"))
def test_the_eigenvalues_are_those_printed(record: str, tmp_path: Path) -> None:
    rows = np.linalg.eigvals(state_matrix(case_with(SEXS + record, tmp_path), default_cache()))
    for printed in map(complex, PRINTED[record].split()):
        assert np.abs(rows - printed).min() < 2e-8 * max(1.0, abs(printed))


def test_the_exciter_with_field_current_regulator_rests_as_printed(tmp_path: Path) -> None:
    """test61_x0_init: measured field current and bridge; the source's 0.577 stands for 1/sqrt(3)."""
    case = case_with(f"102 'ST8C' 1 0 0 0 2 {ST8C} /", tmp_path, f"{MACHINE} 0.1 0.8")
    signals = operating_point(case).controls.of("exciter")[0].rest.signals
    assert signals["fi"] == signals["vp"] == pytest.approx(0.7941264727636811, abs=2e-8)
    assert signals["vr"] == pytest.approx(0.4063734757053926, rel=2e-5)
    assert signals["va"] == pytest.approx(3.0101738941140193 * 0.1, rel=2e-5)


def response(TD: float, omega: float) -> complex:
    """Gain from speed to power of DEGOV at a frequency, by complex steps of its equations."""
    values = DEGOV | {"TD": TD, "TMIN": 0.0, "TMAX": 1.1, MBASE: 100.0, FBASE: 60.0}
    point = rest_of(library()["degov"], values, {"slip": 0.0, "pe": 0.7}, 0.7, "test")
    n, h = len(point.states), 1e-30
    steps = 1j * h * np.eye(n + 1)
    runs = [point.instance.run(point.states + step[:n], {"slip": step[n], "pe": 0.7}) for step in steps]
    slopes = np.array([[np.imag(v) / h for v in (*rates, signals["pm"])] for signals, rates in runs]).T
    A, B, C, D = slopes[:n, :n], slopes[:n, n], slopes[n, :n], slopes[n, n]
    return complex(C @ np.linalg.solve(1j * omega * np.eye(n) - A, B) + D)


DEGOV = {"T1": 0.01, "T2": 0.02, "T3": 0.2, "K": 10.0, "T4": 0.25, "T5": 0.01, "T6": 0.04}


@pytest.mark.parametrize("delay_s", [0.05, 1.0])
def test_the_engine_delay_is_that_of_the_exponential(delay_s: float) -> None:
    """Up to 0.5/TD Hz within 0.1 degree of exp(-s TD) and of the same size."""
    omegas = 2.0 * np.pi * np.array([0.05, 0.2, 0.5]) / delay_s
    late, prompt = ([response(TD, omega) - 0.7 for omega in omegas] for TD in (delay_s, 0.0))  # pm (1 + slip)
    turn = np.array(late) / prompt * np.exp(1j * omegas * delay_s)
    assert np.abs(np.degrees(np.angle(turn))).max() < 0.1
    assert np.abs(turn) == pytest.approx(1.0, abs=1e-12)


def test_the_valve_curve_of_wsieg1_gives_the_flow(tmp_path: Path) -> None:
    """IEEEG1 where the curve is a straight line of slope 1, and the valve read off the curve at rest."""
    head = "0 0 20 0 0 0.1 0.3 -0.5 1 0 0.25 1 0 0 0 0 0 0 0 0 0 0"
    case = {
        curve: case_with(f"102 'WSIEG1' 1 {head} 0 0 0 {curve} 0 /", tmp_path)
        for curve in (
            "0 0 0 0 0 0 0 0 0 0",
            "0 0 0.3 0.3 0.5 0.5 0.7 0.7 1 1",
            "0 0 0.2 0.5 0.4 0.6 0.8 0.8 1 1",
        )
    }
    plain, straight, bent = (
        operating_point(c).controls.of("governor")[0].rest.signals for c in case.values()
    )
    assert plain["s"] == straight["s"] == pytest.approx(plain["pm"], rel=1e-12)
    assert bent["v"] == pytest.approx(0.7, rel=1e-12) and bent["s"] == pytest.approx(0.6, rel=1e-12)


def test_the_stabilizer_of_gridpack_is_its_block_diagram() -> None:
    """K s/(1 + s TW) (1 + s T1)/(1 + s T2) (1 + s T3)/(1 + s T4) of the speed, MAXOUT to both sides."""
    model, values = (
        library()["psssim"],
        dict(zip(PSSSIM_KEYS, (100.0, 20.0, 0.06, 0.04, 0.08, 0.05), strict=True)),
    )
    numbers = numbers_of(model.device, row_of(model.device, values | {"MAXOUT": 1.0}), 100.0, 60.0)
    seen = dict.fromkeys(model.device.inputs, 0.0) | {"vt": 1.0}
    point, omega, h = rest_of(model, numbers, seen, None, "test"), 7.0, 1e-30
    n = len(point.states)
    steps = 1j * h * np.eye(n + 1)
    runs = [point.instance.run(point.states + row[:n], seen | {"slip": row[n]}) for row in steps]
    slopes = np.array([[np.imag(v) / h for v in (*rates, signals["vs"])] for signals, rates in runs]).T
    ours = (
        slopes[n, :n] @ np.linalg.solve(1j * omega * np.eye(n) - slopes[:n, :n], slopes[:n, n]) + slopes[n, n]
    )
    s = 1j * omega
    expected = 100 * s / (1 + 20 * s) * (1 + 0.06 * s) / (1 + 0.04 * s) * (1 + 0.08 * s) / (1 + 0.05 * s)
    assert ours == pytest.approx(expected, rel=1e-12)
    for slip in (1.0, -1.0):
        assert point.instance.run(point.states, seen | {"slip": slip})[0]["vs"] == math.copysign(1.0, slip)


def test_the_signal_of_another_program_is_taken_as_none(tmp_path: Path) -> None:
    """INPUTTYPE = 1 adds 7/60 of what another program hands GridPACK while it runs: 0 where none does."""
    cases, said = [], []
    for k in (0, 1):
        record = f"102 'PSSSIM' 1 {k} 34 30 5 6 7 8 100 20 0.06 0.04 0.08 0.04 1 -1 /"
        cases.append(case_with(SEXS + record, tmp_path))
        report = import_psse(tmp_path / "grid.raw", tmp_path / "grid.dyr").report
        said.append([line for line in report.assumed if "which another program supplies" in line])
        with pytest.raises(CaseError, match="--strict"):
            import_psse(tmp_path / "grid.raw", tmp_path / "grid.dyr", options=ImportOptions(strict=True))
    assert cases[0] == cases[1]
    assert not said[0] and len(said[1]) == 1


REFUSED = {
    f"102 'WSIEG1' 1 7 {'0 ' * 4}0.1 0.3 -0.5 1 0 0.25 1{' 0' * 10} 0.01{' 0' * 13} /": r"\(JBUS\) = 7",
    f"102 'WSIEG1' 1 {'0 ' * 5}0.1 0.3 -0.5 1 0 0.25 1{' 0' * 10} 0.01 0.02{' 0' * 12} /": (
        r"ERR = 0\.02, DB1 = 0\.01, allowed: ERR <= DB1; outside its deadband"
    ),
    "102 'IEEEST' 1 1 7 0 0 0 0 0 0 0 0 0 0 5 10 3 0.1 -0.1 0 0 /": r"IEEEST field 2 \(BUS\) = 7, allowed: 0",
    "102 'MAXEX1' 1 0 /": "'MAXEX1' .* over-excitation limiter; .*--leave-out MAXEX1 omits it",
}


@pytest.mark.parametrize("record", REFUSED)
def test_what_is_not_modelled_is_refused_for_its_reason(record: str, tmp_path: Path) -> None:
    with pytest.raises((CaseError, DeviceError), match=REFUSED[record]):
        case_with(SEXS + record, tmp_path)


def test_a_bus_field_may_name_the_own_bus_and_a_derivative_is_an_input(tmp_path: Path) -> None:
    """ICS = 6: the derivative of the voltage."""
    tail = "0 0 0 0 0 0 0 0 0 0 5 10 3 0.1 -0.1 0 0 /"
    case = case_with(f"{SEXS}102 'IEEEST' 1 6 102 {tail}", tmp_path)
    stabilizer = next(m for m in case.machines if m.name == "G102").stabilizer
    assert stabilizer.ICS == 6.0 and "102 'IEEEST' '1' 6.0 0.0 " in dyr_of(case).text


def test_a_limiter_that_acts_at_rest_is_named(tmp_path: Path) -> None:
    record = "102 'ST6B' 1 0 0.012 50 45 0 0 4.81 -3.85 1 1 1 17.3 {} 4.81 -3.85 1 0.02 /"
    case_with(record.format(4.0), tmp_path)
    with pytest.raises(
        StartError, match=r"vr is 1\.\d+ at the equilibrium, but max\(vl, VRMIN\) = .* keeps it below"
    ):
        operating_point(case_with(record.format(1.5), tmp_path))


#: what makes each a plain gain of 1 behind its input
BUS_FREQUENCY = {
    "ieeest": {"ICS": 2.0, "KS": 1.0, "LSMIN": -1.0, "LSMAX": 1.0},
    "st2cut": {"ICS1": 1.0, "ICS2": 2.0, "K1": 0.0, "K2": 1.0, "LSMIN": -1.0, "LSMAX": 1.0}
    | {f"T{k}": 0.0 for k in range(1, 11)},
}


@pytest.mark.slow
@pytest.mark.parametrize("kind", BUS_FREQUENCY)
@pytest.mark.parametrize("hz", [50.0, 60.0])
def test_a_bus_frequency_is_that_of_its_voltage(kind: str, hz: float) -> None:
    """ICS = 2, gain 1 and nothing else: the rate of the angle of the bus's voltage in Hz/Hz, late by 10 ms.

    The rotor leads its bus by a(t), so the bus turns by slip - a'/(2 pi f); where a' = W stands, a lag of T
    of the phasor gives W/(1 + (W T)**2).
    """
    model, w0, T = library()[kind], 2.0 * np.pi * hz, 0.01
    values = numbers_of(model.device, row_of(model.device, BUS_FREQUENCY[kind]), 100.0, hz)
    at = {"vt": 0.9, "pe": 0.8, "pm": 0.8, "id": 0.7, "iq": 0.5}

    def output(lead: Callable[[float], float], slip: Callable[[float], float], stop_s: float) -> float:
        def seen(t: float) -> dict[str, float]:
            return at | {"vd": 0.9 * np.sin(lead(t)), "vq": 0.9 * np.cos(lead(t)), "slip": slip(t)}

        point = rest_of(model, values, seen(0.0) | {"slip": 0.0}, None, kind)
        run = solve_ivp(
            lambda t, x: point.instance.run(x, seen(t))[1],
            (0.0, stop_s),
            point.states,
            method="DOP853",  # at this tolerance fewer steps than of the default, of lower order
            rtol=1e-10,
            atol=1e-12,
        )
        return float(point.instance.run(run.y[:, -1], seen(stop_s))[0]["vs"])

    stiff = output(lambda t: 0.6 + 1e-3 * w0 / 6.0 * np.sin(6.0 * t), lambda t: 1e-3 * np.cos(6.0 * t), 1.0)
    assert abs(stiff) < 1e-6  # a rotor that swings beside a bus of constant frequency
    together = output(lambda t: 0.6, lambda t: 2e-3, 0.3)
    assert together == pytest.approx(2e-3, rel=1e-6)
    W = 3.0
    drifting = output(lambda t: 0.6 + W * t, lambda t: 2e-3, 0.3)
    assert drifting == pytest.approx(2e-3 - W / (1.0 + (W * T) ** 2) / w0, rel=1e-6)


PSSSIM_KEYS = ("GAINK", "TW", "T1", "T2", "T3", "T4")
_PSS2 = {
    "ICS1": 6.0,
    "ICS2": 1.0,
    "M": 0.0,
    "N": 0.0,
    "KS1": 1.0,
    "KS2": 0.0,
    "KS3": 0.0,
    "VSTMIN": -9.0,
    "VSTMAX": 9.0,
}
_PSS2 |= dict.fromkeys(("TW1", "TW2", "T6", "TW3", "TW4", "T7", "T8", "T9", "T1", "T2", "T3", "T4"), 0.0)
_LIMITS = {"VS1MIN": -9.0, "VS1MAX": 9.0, "VS2MIN": -9.0, "VS2MAX": 9.0, "T10": 0.0, "T11": 0.0}
DERIVATIVE = {
    "ieeest": BUS_FREQUENCY["ieeest"] | {"ICS": 6.0, "LSMIN": -9.0, "LSMAX": 9.0},
    "st2cut": BUS_FREQUENCY["st2cut"] | {"ICS2": 6.0, "LSMIN": -9.0, "LSMAX": 9.0},
    "pss2a": _PSS2,
    "pss2b": _PSS2 | _LIMITS,
    "pss2c": _PSS2 | _LIMITS | {"T12": 0.0, "T13": 0.0},
}


@pytest.mark.slow
@pytest.mark.parametrize("kind", DERIVATIVE)
def test_the_derivative_of_the_voltage_is_an_input(kind: str) -> None:
    """ICS = 6, gain 1 and nothing else: s/(1 + s 10 ms) of the terminal voltage, by its steady swing."""
    model, omega, size, stop = library()[kind], 6.0, 0.02, 1.0
    values = numbers_of(model.device, row_of(model.device, DERIVATIVE[kind]), 100.0, 60.0)

    def seen(t: float) -> dict[str, float]:
        at = {"pe": 0.8, "pm": 0.8, "id": 0.7, "iq": 0.5, "vd": 0.6, "vq": 0.8, "slip": 0.0}
        return at | {"vt": 1.0 + size * np.sin(omega * t)}

    point = rest_of(model, values, seen(0.0), None, kind)
    run = solve_ivp(
        lambda t, x: point.instance.run(x, seen(t))[1], (0.0, stop), point.states, rtol=1e-9, atol=1e-12
    )
    expected = (1j * omega / (1.0 + 0.01j * omega) * size * np.exp(1j * omega * stop)).imag
    assert point.instance.run(run.y[:, -1], seen(stop))[0]["vs"] == pytest.approx(expected, rel=1e-5)


def test_a_stabilizer_on_the_bus_frequency_moves_modes_as_in_another_tool() -> None:
    """ANDES 2.0's modes (docs/book.md), whose filter is another; on the speed they are those of `speed`."""
    printed = [-0.483 + 3.788j, -1.525 + 7.342j, -1.576 + 7.582j]
    case = load_case("kundur-pss")
    speed = case.machines[0].stabilizer
    assert speed is not None
    p = speed.parameters
    shared = {"KS": p["K"], "T5": p["Tw"], "T6": p["Tw"], "LSMIN": -1.0, "LSMAX": 1.0}
    shared |= {key: p[key] for key in ("T1", "T2", "T3", "T4")}

    def poles(stabilizer: dict[str, float | str]) -> np.ndarray:
        changes = {"machines": {"defaults": {"saturation": "none", "stabilizer": stabilizer}}}
        return np.linalg.eigvals(state_matrix(case.with_changes(changes), default_cache()))

    on_speed, on_bus = (poles({"kind": "ieeest", "ICS": ics} | shared) for ics in (1.0, 2.0))
    for mode in [-0.5468 + 3.8263j, -2.1336 + 8.2075j, -2.1947 + 8.5231j]:
        assert np.abs(on_speed - mode).min() < 2e-4  # `speed` of the package
    for mode in printed:
        assert np.abs(on_bus - mode).min() < 0.01 * abs(mode)


def test_a_record_on_the_bus_frequency_goes_in_and_out(tmp_path: Path) -> None:
    tail = "0 0 0 0 0 0 0 0 0 0 5 10 3 0.1 -0.1 0 0 /"
    case = case_with(f"{SEXS}102 'IEEEST' 1 2 0 {tail}", tmp_path)
    assert "102 'IEEEST' '1' 2.0 0.0 " in dyr_of(case).text
    rest = operating_point(case).controls.of("stabilizer")[0].rest
    assert rest.instance.values["FBASE"] == case.frequency_hz and rest.output == 0.0


WSIEG1 = {"K": 20.0, "T1": 0.0, "T2": 0.0, "T3": 0.1, "UO": 0.3, "UC": -0.5, "PMIN": 0.0, "PMAX": 1.0}
WSIEG1 |= {"T4": 0.25, "K1": 0.3, "T5": 5.0, "K3": 0.7, "T6": 0.0, "K5": 0.0, "T7": 0.0, "K7": 0.0}


def wsieg1_at_rest(**more: float) -> RestPoint:
    model = library()["wsieg1"]
    values = numbers_of(model.device, row_of(model.device, WSIEG1 | more), 100.0, 60.0)
    return rest_of(model, values, {"slip": 0.0, "pe": 0.7}, 0.7, "test")


@pytest.mark.parametrize(
    ("err", "beyond"),
    [(0.0, 0.001), (0.0004, 0.0016), (0.001, 0.001)],
    ids=["no ERR", "a step", "ERR = DB1"],
)
def test_the_speed_deadband_of_wsieg1(err: float, beyond: float) -> None:
    """Nothing within DB1; at twice DB1 the speed less DB1, or less ERR where it is given; to either side."""
    point = wsieg1_at_rest(DB1=0.001, ERR=err)
    for sign in (1.0, -1.0):
        for slip, expected in ((0.0009, 0.0), (0.002, beyond)):
            seen = {"slip": sign * slip, "pe": 0.7}
            signal = point.instance.run(point.states, seen)[0]["w"]
            assert signal == pytest.approx(sign * 20.0 * expected, rel=1e-12, abs=1e-15)


@pytest.mark.slow
def test_the_backlash_of_wsieg1_is_a_play_of_its_width() -> None:
    """Against steps of 0.1 ms in which the valve behind the backlash is pushed along at once."""
    width, stop, h = 0.01, 12.0, 1e-4
    point = wsieg1_at_rest(DB2=width)
    names = point.instance.state_names

    def slip(t: float) -> float:
        return 0.002 * math.sin(1.5 * t)

    run = solve_ivp(
        lambda t, x: point.instance.run(x, {"slip": slip(t), "pe": 0.7})[1],
        (0.0, stop),
        point.states,
        rtol=1e-8,
        atol=1e-10,
        max_step=0.005,
        t_eval=np.arange(0.0, stop, 0.5),
    )
    s = b = x4 = x5 = 0.7
    seen = []
    for k in range(int(stop / h)):
        if k % int(0.5 / h) == 0:
            seen.append((s, b, x4, x5))
        s += h * min(max((0.7 - 20.0 * slip(k * h) - b) / 0.1, -0.5), 0.3)
        b = min(max(b, s - width), s + width)
        x4, x5 = x4 + h * (b - x4) / 0.25, x5 + h * (x4 - x5) / 5.0
    exact = np.array(seen).T
    ours = np.array([run.y[names.index(name)] for name in ("s", "b", "x4", "x5")])
    assert np.ptp(exact[1]) > 0.05 and np.abs(exact[0] - exact[1]).max() == pytest.approx(width, rel=1e-6)
    assert np.abs(ours - exact).max() < 1.5e-3


@pytest.mark.slow
def test_within_its_deadband_wsieg1_leaves_the_speed_alone(tmp_path: Path) -> None:
    """There, by either deadband, the machine swings as without a governor; without them it does not."""
    head = "0 0 20 0 0 0.1 0.3 -0.5 1 0 0.25 1 0 0 0 0 0 0 0 0 0 0"
    curve = "0 0 0.3 0.3 0.5 0.5 0.7 0.7 1 1"

    def swing(governor: str) -> complex:
        A = state_matrix(case_with(SEXS + governor, tmp_path), default_cache())
        return complex(next(pole for pole in np.linalg.eigvals(A) if pole.imag > 5.0))

    bare, plain, first, second = (
        swing(f"102 'WSIEG1' 1 {head} {deadbands} {curve} 0 /" if deadbands else "")
        for deadbands in ("", "0 0 0", "0.0006 0 0", "0 0 0.005")
    )
    assert abs(plain - bare) > 0.1
    assert first == pytest.approx(bare, rel=1e-7) and second == pytest.approx(bare, rel=1e-7)
