"""Energy flow: a network whose flows are known in closed form, a run with a known source, a public event."""

from __future__ import annotations

import json
import os
import warnings
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from command_line import invoke

import interarea as ia
from interarea.cosim.records.energy import located, strongest_line
from interarea.cosim.records.record import Channel, Record, RecordError

STEP_S, F = 1.0 / 30.0, 0.7
TIME = np.arange(1800) * STEP_S
RECORDS = Path(os.environ.get("INTERAREA_RECORDS", "no such folder"))


def phasors(ends: dict[str, tuple[complex, complex]], noise: float = 0.0, seed: int = 0) -> Record:
    """Return a PMU record: terminal -> complex amplitude of P (MW) and of the angle (rad) at F."""
    rng, channels, columns = np.random.default_rng(seed), [], []
    for name, (p, theta) in ends.items():
        angle = 0.3 * TIME + np.real(theta * np.exp(2j * np.pi * F * TIME))
        P = 100.0 + np.real(p * np.exp(2j * np.pi * F * TIME)) + noise * rng.standard_normal(len(TIME))
        volts = np.full(len(TIME), 200.0) + 1e-6 * rng.standard_normal(len(TIME))
        units = {"voltage": "kV", "voltage angle": "rad", "current": "A", "current angle": "rad"}
        for quantity, values in zip(units, (volts, angle, P * 1e3 / 3.0 / 200.0, angle), strict=True):
            channels.append(Channel(f"{name} {quantity}", quantity, units[quantity], name))
            columns.append(values)
    return Record("pmu.csv", TIME, np.column_stack(columns), tuple(channels))


#: energy comes in at Ln:1-2 of substation 1; the ends of the line agree
ENDS = {
    "Sub:1:Ln:1-2": (5.0 * 1j, -0.01 + 0.0j),
    "Sub:2:Ln:1-2": (-5.0 * 1j, -0.01 + 0.0j),
    "Sub:1:Ln:9": (1.0j, -0.01 + 0.0j),
}


def test_slopes_are_those_of_the_closed_form() -> None:
    """Of P = Re(p e^jwt) and angle = Re(th e^jwt) the mean of P d(angle)/dt is Re(p conj(jw th)) / 2."""
    result = located(phasors(ENDS))
    assert result.frequency_hz == pytest.approx(F, abs=0.005)
    for flow in result.flows:
        p, theta = ENDS[flow.terminal]
        power = 0.5 * np.real(p * np.conj(1j * 2 * np.pi * F * theta))
        assert flow.slope == pytest.approx(power, rel=0.01)
        assert (
            min(flow.halves) <= flow.slope * 1.01 if flow.slope > 0 else max(flow.halves) >= flow.slope * 1.01
        )


def test_the_terminal_where_energy_comes_in_is_named_and_the_ends_of_a_line_agree() -> None:
    result = located(phasors(ENDS))
    assert result.source == "Sub:1:Ln:1-2"
    (line,) = result.lines
    assert set(line.ends) == {"Sub:1:Ln:1-2", "Sub:2:Ln:1-2"}
    assert line.own is None  # one voltage at both ends: no line is between them
    assert line.apart < 0.01


def of_a_line(growth: float, ratio: float = 1.0) -> tuple[Record, float]:
    """Return a record at both ends of a pi line, and the slope of its own energy.

    growth : of the oscillation, 1/s. ratio : of the transformers of current at the second end.
    The energy is that of dS = dV conj(I) + V conj(dI) for a steady oscillation, in complex amplitudes.
    """
    z, charging = 2.0 + 28.0j, 2e-4j  # ohm, siemens at each end
    rest = np.array([200.0, 202.0 * np.exp(0.09j)])  # kV
    angle, log_v = np.array([-0.01, -0.0115 * np.exp(-0.3j)]), np.array([0.002j, 0.0025j])
    Y = np.array([[1 / z + charging, -1 / z], [-1 / z, 1 / z + charging]])
    swing = np.exp((growth + 2j * np.pi * F) * (TIME - TIME[len(TIME) // 2]))[:, None]
    V = rest * np.exp(np.real(log_v * swing) + 1j * (np.real(angle * swing) + 0.3 * TIME[:, None]))
    I = 1e3 * V @ Y.T * [1.0, ratio]
    jw = 2j * np.pi * F
    dP, dQ = np.zeros(2, complex), np.zeros(2, complex)
    for part, sign in ((1.0, 1.0), (-1j, 1j)):  # cosine and sine of the amplitudes
        dV = rest * (np.real(log_v * part) + 1j * np.real(angle * part))
        dS = 3.0 * (dV * np.conj(Y @ rest) + rest * np.conj(Y @ dV))
        dP, dQ = dP + sign * dS.real, dQ + sign * dS.imag
    own = float(np.sum(0.5 * np.real(dP * np.conj(jw * angle) + dQ * np.conj(jw * log_v))))
    quantities = {"voltage": "kV", "voltage angle": "rad", "current": "A", "current angle": "rad"}
    columns, channels = [], []
    for k, name in enumerate(("Sub:1:Ln:1-2", "Sub:2:Ln:1-2")):
        values = (np.abs(V[:, k]), np.angle(V[:, k]), np.abs(I[:, k]), np.angle(I[:, k]))
        for (quantity, unit), x in zip(quantities.items(), values, strict=True):
            channels.append(Channel(f"{name} {quantity}", quantity, unit, name))
            columns.append(np.unwrap(x) if unit == "rad" else x)
    return Record("pmu.csv", TIME, np.column_stack(columns), tuple(channels)), own


def test_the_own_energy_of_a_line_is_that_of_its_impedance() -> None:
    record, own = of_a_line(0.0)
    result = located(record, frequency_hz=F)
    (line,) = result.lines
    mean = np.mean([abs(flow.slope) for flow in result.flows])
    assert line.own is not None
    assert line.own == pytest.approx(own / mean, rel=0.01)
    assert abs(line.measured) > 0.01  # more than what remains
    assert line.apart < 2e-4
    assert line.ratio == pytest.approx(0.0, abs=1e-4)


def test_growth_and_wrong_transformers_are_told_from_disagreement() -> None:
    """Of a growing oscillation the stored energy counts; a current 2 % too large shows at rest too."""
    steady, growing = (located(of_a_line(g)[0], frequency_hz=F).lines[0] for g in (0.0, 0.05))
    assert steady.own is not None
    assert growing.own is not None
    assert abs(growing.own - steady.own) > 2e-3
    assert growing.apart < 5e-4
    (large,) = located(of_a_line(0.05, 1.02)[0], frequency_hz=F).lines
    assert large.ratio is not None
    assert abs(large.ratio) == pytest.approx(0.0198, abs=3e-4)  # of 1 to 1.02 on their mean
    assert abs(large.measured - growing.measured) == pytest.approx(0.0198, abs=3e-4)
    assert large.apart < 1e-3
    assert "powers at rest apart by 2.0%" in large.text
    (double,) = located(of_a_line(0.0, 2.0)[0], frequency_hz=F).lines
    assert not double.agree
    assert "disagree by" in double.text


def test_the_speed_of_a_machine_counts_at_the_rated_frequency_of_its_grid() -> None:
    swing = np.sin(2 * np.pi * F * TIME)
    values = np.column_stack([2.0 * swing, np.full(len(TIME), 1.0) + 1e-9 * swing, 1e-3 * swing])
    names = (("P", "active power", "pu"), ("V", "voltage", "pu"), ("w", "speed", "pu"))
    record = Record("run", TIME, values, tuple(Channel(n, q, unit, "G1") for n, q, unit in names))
    for rated_hz in (50.0, 60.0):  # P into the bus: the mean of -2 sin x 2 pi f 1e-3 sin
        (flow,) = located(record, frequency_hz=F, rated_hz=rated_hz).flows
        assert flow.slope == pytest.approx(-2e-3 * np.pi * rated_hz, rel=0.01)
    assumed = "speeds are taken as pu of 60 Hz; a case has the rated frequency"
    assert assumed in located(record, frequency_hz=F).notes
    assert assumed not in located(record, frequency_hz=F, rated_hz=60.0).notes


def test_powers_of_another_unit_are_not_compared() -> None:
    """In pu of 100 MVA the largest inflow would be the least of all."""
    MW = phasors(ENDS)
    channels, values = list(MW.channels), MW.values.copy()
    for k, channel in enumerate(channels):
        if channel.terminal == "Sub:1:Ln:1-2" and channel.quantity in ("voltage", "current"):
            channels[k] = replace(channel, unit="pu")
            values[:, k] /= 200.0 if channel.quantity == "voltage" else 100e3 / 3.0 / 200.0
    result = located(Record("pmu.csv", TIME, values, tuple(channels)))
    assert {flow.terminal for flow in result.flows} == set(ENDS) - {"Sub:1:Ln:1-2"}
    assert "Sub:1:Ln:1-2: power in pu, not in MW as elsewhere: left out" in result.notes
    mixed = [replace(c, unit="pu") if c.quantity == "voltage" else c for c in MW.channels]
    with pytest.raises(RecordError, match="no terminal has power and angle"):
        located(Record("pmu.csv", TIME, values, tuple(mixed)))


def test_no_source_is_named_where_the_checks_fail() -> None:
    spoiled = {**ENDS, "Sub:2:Ln:1-2": (2.0j, 0.01 + 0.0j)}  # a wrong current transformer
    result = located(phasors(spoiled))
    assert result.source == ""
    assert "disagree by" in result.why
    twins = {"A": (-5.0j, 0.01 + 0j), "B": (-4.5j, 0.01 + 0j), "C": (9.0j, 0.01 + 0j)}
    result = located(phasors(twins))
    assert result.source == ""
    assert "too similar" in result.why
    result = located(phasors({"C": twins["C"]}))
    assert result.source == ""
    assert "not at an observed terminal" in result.why


@pytest.mark.slow
@pytest.mark.parametrize("machine", ["G1", "G3"])
def test_the_machine_whose_turbine_swings_is_found_in_a_run(machine: str) -> None:
    """A square wave of mechanical power on the full plant, of which the meter also says that it is forced."""
    f = 0.8
    pulses = [
        {
            "kind": "pm_pulse",
            "machine": machine,
            "size_pu": 0.02,
            "start_s": 1 + k / f,
            "end_s": 1 + (k + 0.5) / f,
        }
        for k in range(30)
    ]
    settings = {"case": "kundur-manual", "controller": "none", "stop_s": 38.0, "event": pulses}
    run = ia.simulate({**settings, "show": ["branch[*].p", "branch[*].q", "bus*.v", "bus*.angle"]})
    record = ia.read_record(run.to_frame()).between(13.0, 38.0)
    case = ia.load_case("kundur-manual")
    at = {m.name: f"bus{m.bus}" for m in case.machines}
    at |= {f"branch[{b.name}]": f"bus{b.from_bus}" for b in case.branches}
    result = located(record, at=at)
    assert result.frequency_hz == pytest.approx(f, abs=0.01)
    assert result.source == machine


def test_records_that_cannot_be_located_are_refused_with_what_would_do() -> None:
    record = phasors(ENDS)
    with pytest.raises(RecordError, match=r"5 s are 3\.5 periods of 0\.7 Hz, wanted: 10 at least, 14\.3 s"):
        located(record.between(0.0, 5.0), frequency_hz=F)
    quiet = phasors(dict.fromkeys(ENDS, (0j, 0j)), noise=1.0)
    with pytest.raises(RecordError, match="no oscillation exceeds the background"):
        located(quiet)
    volts = record.only([c.name for c in record.channels if c.quantity == "voltage"])
    with pytest.raises(RecordError, match="no terminal has power and angle, wanted at each: V, I"):
        located(volts)


def test_the_command_prints_a_table_or_json(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "r.parquet"
    names = {"voltage": "VM", "voltage angle": "VA", "current": "IM", "current angle": "IA"}
    record = phasors(ENDS)
    rows = ["Time," + ",".join(c.terminal for c in record.channels)]
    rows.append("T," + ",".join(names[c.quantity] for c in record.channels))
    rows.append("s," + ",".join("RAD" if c.unit == "rad" else c.unit for c in record.channels))
    rows.append("," * len(record.channels))
    rows += [
        f"{t:.4f}," + ",".join(f"{v:.8f}" for v in values)
        for t, values in zip(TIME, record.values, strict=True)
    ]
    path = tmp_path / "pmu.csv"
    path.write_text("\n".join(rows))
    code, out, _ = invoke(["locate", str(path)], monkeypatch)
    assert code == 0
    assert "agree to" in out
    code, out, _ = invoke(["locate", str(path), "--json"], monkeypatch)
    document = json.loads(out)
    assert document["source"] == located(record).source
    code, _, err = invoke(["locate", str(path), "--frequency", "100"], monkeypatch)
    assert code == 2
    assert "100 Hz, allowed: above 0 and below 12" in err


@pytest.mark.skipif(not (RECORDS / "case3row.mat").is_file(), reason="needs the record: docs/records.md")
@pytest.mark.parametrize("start_s", range(55, 105, 5))
def test_twenty_seconds_of_the_public_event_name_one_terminal(start_s: int) -> None:
    """Event 3 of ISO-NE: 1.13 Hz; by the energy flow the source is beyond Ln:2 of substation 2."""
    import pandas as pd
    from scipy.io import loadmat

    data = loadmat(RECORDS / "case3row.mat")
    words = [["" if not cell.size else str(cell[0]) for cell in row] for row in data["txt"][:3]]
    frame = pd.DataFrame(
        data["num"], columns=["Time", *(f"{a} {b}" for a, b in list(zip(*words[:2], strict=True))[1:])]
    )
    quantity = {
        "F": "frequency",
        "VM": "voltage",
        "VA": "voltage angle",
        "IM": "current",
        "IA": "current angle",
    }
    columns = list(zip(frame.columns[1:], *(row[1:] for row in words), strict=True))
    frame.attrs["units"] = {c: unit for c, _, _, unit in columns}
    frame.attrs["quantity"] = {c: quantity[kind] for c, _, kind, _ in columns}
    frame.attrs["terminal"] = {c: place for c, place, _, _ in columns}
    result = located(ia.read_record(frame, window_s=(start_s, start_s + 20.0)))
    assert result.frequency_hz == pytest.approx(1.14, abs=0.03)
    assert result.source == "Sub:2:Ln:2"
    assert all(line.apart < 0.01 for line in result.lines)
    assert len(result.lines) == 2


def test_constant_powers_have_no_oscillation() -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        with pytest.raises(RecordError, match=r"no oscillation exceeds the background .* largest ratio 0,"):
            strongest_line(phasors(ENDS), [np.full(len(TIME), 100.0)], (0.1, 2.5))
