"""Grid-forming converters REGFM_B1: at rest, in step with a second writing, at their limits."""

from __future__ import annotations

import numpy as np
import pytest
from grid_text import pair_with
from plant_shim import BlockShim
from sparse_blocks import agreeing_blocks

from interarea.design.linear.linearise import linearise, remove_reference
from interarea.design.linear.sparse_plant import sparse_plant
from interarea.design.linear.zero_eigenvalues import zero_eigenvalues_of
from interarea.fmu_build.write.device_slopes import DeviceSlopes
from interarea.models.blocks.plant import event_parameters, plant_block
from interarea.models.case.case import case_of, load_case
from interarea.models.case.events import events_of
from interarea.models.devices.library import library
from interarea.models.errors import CaseError
from interarea.models.files import default_cache
from interarea.models.grid.equilibrium import operating_point
from interarea.models.grid.machine_tables import in_plant_order
from interarea.models.grid.powerflow import solve_powerflow
from interarea.models.importers.imported import ImportOptions
from interarea.models.importers.psse import import_psse

#: name -> parameters, how many states
CONTROLS = {
    "published": ({}, 10),
    "every lag": (
        {
            "Kpv": 0.5,
            "Tvf": 0.02,
            "Tif": 0.01,
            "Tp": 0.03,
            "wFlag": 1,
            "VdrpFlag": 1,
            "PQFlag": 0,
            "Re": 0.01,
        },
        15,
    ),
    "generator": ({"ESFlag": 0, "Ke": 0.0, "FFlag": 0, "QVFlag": 0, "Imax": 0.0}, 10),
}


def with_source(control="published", base="two-area-thesis", **more):
    row = {"bus": 8, "base_mva": 200.0, "P_mw": 100.0, "Q_mvar": 20.0}
    row["control"] = {"kind": "regfm_b1"} | CONTROLS[control][0] | more
    return load_case(base).with_changes({"converters": {"gfm1": row}})


@pytest.mark.parametrize(
    ("control", "network", "base"),
    [*((c, "dense", "two-area-thesis") for c in CONTROLS), ("published", "sparse", "kundur-manual")],
)
def test_it_rests_and_the_derivatives_are_those_of_differences(control, network, base):
    plant = BlockShim(plant_block(with_source(control, base), network=network))
    own = np.array([n.startswith("gfm1.") for n in plant.state_names])
    assert own.sum() == CONTROLS[control][1]
    rates, y = plant.derivatives(plant.x)
    assert np.max(np.abs(rates[own])) < 1e-12
    assert y[plant.output_names.index("gfm1.p")] == pytest.approx(1.0, abs=1e-11)
    assert y[plant.output_names.index("gfm1.q")] == pytest.approx(0.2, abs=1e-11)
    rates_off, outputs_off = plant.directional_errors(1e-4, 1e-5)
    assert rates_off < 1e-7
    assert outputs_off < 1e-6


@pytest.mark.parametrize("Imax", [0.8, 0.0])
def test_slopes_at_its_current_limit_are_those_of_differences(Imax):
    case = with_source(Imax=Imax)
    fault = {"kind": "bus_fault", "bus": 9, "start_s": 0.0, "end_s": 1.0, "x_pu": 0.02}
    plant = BlockShim(plant_block(case), event_parameters(case, events_of([fault], where="test")))
    plant.event(0.0, plant.x)
    off, outputs_off = plant.directional_errors(1e-4, 1e-5)
    assert off < 1e-6
    assert outputs_off < 1e-5


@pytest.mark.parametrize("control", CONTROLS)
def test_the_sparse_blocks_have_its_state_matrix(control):
    blocks, _, _ = agreeing_blocks(in_plant_order(with_source(control)))
    assert blocks.inputs[-2:] == ("gfm1_p_mod", "gfm1_q_mod")


def test_all_angles_together_move_nothing():
    """The angle of the PLL turns with that of the source and those of the machines."""
    case = in_plant_order(with_source())
    block = plant_block(case)
    slopes = DeviceSlopes(block, cache=default_cache())
    assert zero_eigenvalues_of(sparse_plant(slopes, block.data, solve_powerflow(case).voltages)).rotation
    plant = BlockShim(block)
    turned = np.array([n.endswith((".delta", ".theta")) for n in plant.state_names], dtype=float)
    assert turned.sum() == len(case.machines) + 2
    assert np.max(np.abs(plant.jacobians()[0] @ turned)) < 1e-8
    relative = remove_reference(linearise(plant))
    assert "gfm1.theta-G1.delta" in relative.state_labels


#: one converter of 100 MVA behind a line of .25 pu on an infinite bus of 1 pu; a fault is a shunt at bus 1
X_LINE, BASE = 0.25, 100.0
INFINITE = {"bus": 2, "area": 1, "model": "infinite_bus", "Xd1": 1e-6, "base_mva": 1e4, "P_mw": 0.0}


def alone(P_mw=50.0, **parameters):
    control = {"kind": "regfm_b1", "Tvf": 0.02, "Tif": 0.02} | parameters
    document = {
        "name": "vsm",
        "title": "a grid-forming converter on an infinite bus",
        "source": "ours",
        "frequency_hz": 50.0,
        "base_mva": BASE,
        "buses": {"1": {"area": 1}, "2": {"area": 1}},
        "branches": {"line": {"from": 1, "to": 2, "x": X_LINE}},
        "machines": {"G2": INFINITE | {"V_pu": 1.0, "slack": True}},
        "converters": {
            "gfm1": {"bus": 1, "base_mva": BASE, "P_mw": P_mw, "Q_mvar": 10.0, "control": control}
        },
    }
    return case_of(document, where="vsm")


def run(case, seconds, events=(), step_s=0.0005, **inputs):
    """Return time and, by name, states and outputs after the inputs step at once."""
    block = plant_block(case, more=["bus1.re", "bus1.im"])
    plant = BlockShim(block, event_parameters(case, events_of(list(events), where="test")))
    u = plant.u.copy()
    for name, value in inputs.items():
        u[plant.input_names.index(f"gfm1_{name}")] = value
    time_s, x, y = plant.run(seconds, step_s, u)
    states = {n.removeprefix("gfm1."): x[:, k] for k, n in enumerate(plant.state_names)}
    return time_s, states, {n: y[:, k] for k, n in enumerate(plant.output_names)}


class Second:
    """The published equations written a second time, by Heun's method; limits that move are met at once.

    first : states at rest; fault : (begin, end, reactance) of a shunt at the bus. No state follows by Te.
    """

    ORDER = ("phase", "theta", "pf", "qf", "speed", "slow", "top", "low", "delta", "e", "vf", "idf", "iqf")

    def __init__(self, case, fault=None, p_mod=0.0, q_mod=0.0):
        self.p = {q.name: q.default for q in library()["regfm_b1"].device.parameters}
        self.p |= {k: float(v) for k, v in case.converters[0].control.parameters.items()}
        self.w0, self.fault = 2 * np.pi * case.frequency_hz, fault
        self.pset = case.converters[0].P_mw / BASE + p_mod
        self.q_mod, self.z = q_mod, complex(self.p["Re"], self.p["Xe"])
        self.most = np.arcsin(self.p["Xe"] * self.p["ImaxSS"])

    def network(self, t, E):
        """Voltage and current; beyond Imax the current along the free one, by fixed-point iteration."""
        y = 1 / (1j * (X_LINE + 1e-8))
        shunt = 1 / (1j * self.fault[2]) if self.fault and self.fault[0] <= t < self.fault[1] else 0.0
        V = (E / self.z + y) / (1 / self.z + y + shunt)
        current = (E - V) / self.z
        if abs(current) <= self.p["Imax"]:
            return V, current
        for _ in range(60):
            current *= self.p["Imax"] / abs(current)
            V = (current + y) / (y + shunt)
            current = (E - V) / self.z
        return V, current * self.p["Imax"] / abs(current)

    def seen(self, t, s):
        V, current = self.network(t, s[9] * np.exp(1j * s[8]))
        turned = current * np.exp(-1j * s[1])
        return V, V * np.conj(current), turned.real, -turned.imag

    def limits(self, s):
        p = self.p
        volts, active, reactive = s[10:]
        first, x = p["Kf"] * p["ImaxSS"], p["Xe"]
        left = np.sqrt(max(p["ImaxSS"] ** 2 - (active if p["PQFlag"] else reactive) ** 2, 1e-12))
        most, most_q = (first, left) if p["PQFlag"] else (left, first)
        return most, [np.hypot(volts + side * most_q * x, active * x) for side in (-1, 1)]

    def rates(self, t, s):
        p = self.p
        V, S, active, reactive = self.seen(t, s)
        most, _ = self.limits(s)
        across = (V * np.exp(-1j * s[1])).imag
        stands = abs(V) < p["VPLLfrz"]
        pll = np.clip(p["KpPLL"] * across + s[0], p["DwPLLmin"], p["DwPLLmax"])
        droop = p["FFlag"] * (pll if p["wFlag"] else s[4]) / p["mp"]
        push = self.pset - droop - s[2] - p["D1"] * s[4] - p["D2"] * (s[4] - s[5])
        v = (
            self.vset
            + (self.q_mod if p["QVFlag"] else p["mq"] * self.q_mod)
            - p["mq"] * (s[12] if p["VdrpFlag"] else s[3])
        )
        return np.array(
            [
                0.0 if stands else p["KiPLL"] * across,
                0.0 if stands else self.w0 * pll,
                (S.real - s[2]) / p["Tpf"],
                (S.imag - s[3]) / p["Tqf"],
                push / (2 * p["H"]),
                p["wD"] * (s[4] - s[5]),
                p["Ki"] * (most - s[11]),
                p["ESFlag"] * p["Ki"] * (-p["Ke"] * most - s[11]),
                self.w0 * s[4],
                p["Kiv"] * (v - s[10]),
                (abs(V) - s[10]) / p["Tvf"],
                (active - s[11]) / p["Tif"],
                (reactive - s[12]) / p["Tif"],
            ]
        )

    def within(self, s):
        p = self.p
        s[4] = np.clip(s[4], p["Dwmin"], p["Dwmax"])
        s[6], s[7] = np.clip(s[6], 0, self.most), np.clip(s[7], -self.most, 0)
        s[8] = np.clip(s[8], s[1] + s[7], s[1] + s[6])
        s[9] = np.clip(s[9], *self.limits(s)[1])
        return s

    def run(self, first, seconds, step_s):
        s = np.array(first)
        self.vset = s[10] + self.p["mq"] * (s[12] if self.p["VdrpFlag"] else s[3])
        rows = [s]
        for k in range(round(seconds / step_s)):
            t = (k + 0.5) * step_s  # a step lies on one side of each end of the fault
            one = self.rates(t, s)
            two = self.rates(t, self.within(s + step_s * one))
            s = self.within(s + step_s * (one + two) / 2)
            rows.append(s)
        return dict(zip(self.ORDER, np.array(rows).T, strict=True))


STATES = ("dwpll", "theta", "pf", "qf", "dwm", "wash", "dimax", "dimin", "delta", "e", "vf", "idf", "iqf")


def both(case, seconds, events=(), fault=None, step_s=0.0005, **inputs):
    time_s, states, y = run(case, seconds, events, step_s, **inputs)
    second = Second(case, fault, **inputs)
    expected = second.run([states[n][0] for n in STATES], seconds, step_s / 5)
    return time_s, states, y, {n: expected[m][::5] for n, m in zip(STATES, Second.ORDER, strict=True)}


@pytest.mark.slow
@pytest.mark.parametrize("more", [{}, {"wFlag": 1, "Re": 0.02, "mq": 0.1, "D1": 5.0, "D2": 20.0}])
def test_it_follows_the_diagram_within_its_limits(more):
    _, states, _, expected = both(alone(**more), 1.5, p_mod=0.1, q_mod=0.01)
    assert np.ptp(states["dwm"]) > 3e-4
    for name in STATES:
        assert states[name] == pytest.approx(expected[name], abs=2e-5), name


FAULT = {"kind": "bus_fault", "bus": 1, "start_s": 0.05, "end_s": 0.15, "x_pu": 0.05}
SHORT = 0.00125  #: s, Te: what follows a limit that moves is late by it, which the second writing is not


@pytest.mark.slow
def test_a_fault_meets_the_limits_as_in_the_diagram():
    """Emax falls with the voltage, so E follows it by Te: its error is Te times how fast that limit moves."""
    case = alone(Te=SHORT)
    time_s, states, y, expected = both(case, 0.8, [FAULT], (0.05, 0.15, 0.05))
    assert np.min(states["e"]) < 0.4
    for name, most in {"theta": 1e-3, "delta": 1e-3, "pf": 2e-3, "qf": 5e-3, "dwm": 5e-5, "e": 5e-2}.items():
        assert states[name] == pytest.approx(expected[name], abs=most), name
    after = time_s > 0.3
    for name in STATES:
        assert states[name][after] == pytest.approx(expected[name][after], abs=1e-3), name
    V = y["bus1.re"] + 1j * y["bus1.im"]
    current = np.conj((y["gfm1.p"] + 1j * y["gfm1.q"]) / V)
    free = (states["e"] * np.exp(1j * states["delta"]) - V) / 0.15j
    limited = (abs(free) > 1.501) & (time_s > 0.051) & (time_s < 0.149)
    assert np.count_nonzero(limited) > 10
    assert abs(current[limited]) == pytest.approx(1.5, abs=1e-9)
    assert np.angle(free[limited] / current[limited]) == pytest.approx(0.0, abs=1e-9)


@pytest.mark.slow
def test_the_angle_to_the_pll_stays_within_a_limit_that_moves():
    """p_mod asks for 1.2 of a steady limit of .9: the largest angle moves in until the current fits."""
    case = alone(P_mw=80.0, Te=SHORT)
    _, states, _, expected = both(case, 1.2, p_mod=0.4)
    assert np.min(states["dimax"]) < 0.135
    for name in ("theta", "delta", "dimax", "dwm", "dwpll"):
        assert states[name] == pytest.approx(expected[name], abs=1.5e-3), name
    assert np.max(states["delta"] - states["theta"] - states["dimax"]) < 1e-3


def test_at_rest_beyond_its_limit_it_gives_the_steady_current():
    """Kf ImaxSS, to which an integral part takes it, whatever is asked beyond that."""
    _, states, _ = run(alone(P_mw=80.0), 15.0, step_s=0.002, p_mod=0.4)
    assert states["idf"][-1] == pytest.approx(0.9, abs=1e-4)


@pytest.mark.parametrize(("flag", "input_"), [(1, 0.01), (0, 0.2)])
def test_within_its_limits_the_droops_are_straight_lines(flag, input_):
    """P = pset + p_mod at the frequency of the infinite bus; |V| = Vset - mq Q + q_mod, or + mq q_mod."""
    _, _, y = run(alone(QVFlag=flag), 8.0, step_s=0.002, p_mod=0.1, q_mod=input_)
    V = abs(y["bus1.re"] + 1j * y["bus1.im"])
    assert y["gfm1.p"][-1] == pytest.approx(0.6, abs=1e-6)
    rise = V[-1] - V[0] + 0.05 * (y["gfm1.q"][-1] - 0.1)
    assert rise == pytest.approx(input_ * (1.0 if flag else 0.05), abs=1e-6)


def test_the_damping_is_that_of_the_swing_equation():
    """With constant E and no filter of P: 2H s^2 + D1 s + w0 K = 0, K = E cos(delta)/X."""
    case = alone(FFlag=0, D2=0.0, D1=40.0, H=4.0, Tpf=0.0, Kiv=1e-6)
    plant = BlockShim(plant_block(case))
    poles = np.linalg.eigvals(plant.jacobians()[0])
    at = dict(zip(plant.state_names, plant.x, strict=True))
    K = at["gfm1.e"] * np.cos(at["gfm1.delta"]) / (0.15 + X_LINE + 1e-8)
    swing = max(np.roots([8.0, 40.0, 2 * np.pi * 50.0 * K]), key=np.imag)
    assert np.min(abs(poles - swing)) < 1e-3


def test_after_a_trip_it_gives_nothing():
    case = with_source()
    trip = {"kind": "device_trip", "device": "gfm1", "start_s": 0.1}
    plant = BlockShim(plant_block(case), event_parameters(case, events_of([trip], where="test")))
    time_s, _, y = plant.run(0.3, 0.002)
    for name in ("gfm1.p", "gfm1.q"):
        assert np.all(y[time_s > 0.101, plant.output_names.index(name)] == 0.0)


@pytest.mark.parametrize(
    ("more", "says"),
    [
        ({"Kf": 0.4}, "dimax is not constant at the equilibrium: its value is 0.150568, its rate"),
        (
            {"ImaxSS": 0.4},
            "delta (angle of the source) is -0.131941 at the equilibrium, above theta + dimax = "
            "-0.151954; change the",
        ),
        ({"Xe": 0.9, "ImaxSS": 1.0}, "Xe = 0.9, ImaxSS = 1; lower one of them until their product is 0.8"),
        ({"VPLLfrz": 0.2}, "VPLLfrz = 0.2"),
        ({"Dwmin": 0.1}, "Dwmin = 0.1"),
        ({"ImaxF": 1.5}, "ImaxF"),
    ],
)
def test_what_cannot_rest_or_is_out_of_range_is_named(more, says):
    with pytest.raises(CaseError) as reported:
        operating_point(with_source(**more))
    assert says in str(reported.value)


FIELDS = (
    "0 0 1 1 1 1 0.05 0 5 0.03 0.05 -0.05 0.265 2.65 0.2 -0.2 0 0.5 0 100 50 2 0.9 2 2.5 0.02 0.02 0 0 1 0.05"
)
RECORD = f"4 'REGFMB1' 1 {FIELDS} /\n"


@pytest.mark.parametrize("record", [RECORD, f"4 'USRMDL' 1 'REGFMB1U' 101 1 6 25 11 30 {FIELDS} /\n"])
def test_a_record_becomes_a_converter_behind_the_impedance_of_the_raw_file(tmp_path, record):
    raw, dyr = pair_with(tmp_path, record)
    case = import_psse(raw, dyr).case
    row = next(iter(case.converters))
    values = row.control.parameters
    assert row.bus == 4 and row.control.kind == "regfm_b1"
    assert (values["mp"], values["H"], values["ImaxSS"], values["Imax"]) == (0.03, 0.5, 2.0, 2.5)
    assert values["Xe"] == pytest.approx(load_case("kundur-pss").machine("G4").Xd1, rel=1e-9)
    plant = BlockShim(plant_block(case))
    assert np.max(np.abs(plant.derivatives(plant.x)[0])) < 1e-8
    assert import_psse(raw, dyr, options=ImportOptions(converters="current")).case.converters == ()


@pytest.mark.parametrize(
    ("old", "new", "says"),
    [
        ("0 0 1 1 1 1 0.05", "0 0 1 1 1 0.05", r"grid\.dyr:\d+: REGFMB1 has 30 fields, allowed: 31"),
        ("0.02 0.02 0 0 1 0.05", "0.02 0.02 0 0 1 0.3", r"grid\.dyr:\d+.*VPLLfrz.*0\.3"),
        ("0.5 0 100", "0 0 100", r"grid\.dyr:\d+.* H .*0"),
    ],
)
def test_a_spoiled_record_is_named_with_its_line(tmp_path, old, new, says):
    assert old in RECORD
    with pytest.raises(CaseError, match=says):
        import_psse(*pair_with(tmp_path, RECORD.replace(old, new, 1)))
