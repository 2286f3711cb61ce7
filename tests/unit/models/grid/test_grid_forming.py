"""Grid-forming converters REGFM_A1: at rest, in step with an independent program, at their limits."""

from __future__ import annotations

import numpy as np
import pytest
import scipy.integrate
import scipy.optimize
from grid_text import pair_with
from plant_shim import BlockShim
from sparse_blocks import agreeing_blocks

from interarea.cosim.results.verdict import LOST, SETTLED
from interarea.cosim.run.run import run_scenario
from interarea.design.linear.linearise import linearise
from interarea.design.linear.sparse_plant import sparse_plant
from interarea.design.linear.zero_eigenvalues import zero_eigenvalues_of
from interarea.fmu_build.write.device_slopes import DeviceSlopes
from interarea.models.blocks.plant import event_parameters, plant_block
from interarea.models.blocks.plant_shown import shown_of
from interarea.models.case.case import case_of, load_case
from interarea.models.case.events import events_of
from interarea.models.case.write_toml import export_toml
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
    "voltage": ({}, 9),
    "proportional": ({"kpv": 0.5}, 10),
    "source": ({"Vflag": 0}, 8),
    "resistance": ({"Re": 0.01, "QVflag": 0, "Imax": 0.0}, 9),
}


WAITING = ("xpmax", "xpmin", "xqmax", "xqmin")


def with_source(control="voltage", base="two-area-thesis", **more):
    row = {"bus": 8, "base_mva": 200.0, "P_mw": 100.0, "Q_mvar": 20.0}
    row["control"] = {"kind": "regfm_a1"} | CONTROLS[control][0] | more
    return load_case(base).with_changes({"converters": {"gfm1": row}})


def test_limits_that_wait_are_held_in_the_linear_model():
    """Each has a pole of -1 1/s, the slope beyond its limit, and moves nothing else."""
    plant, free = (
        BlockShim(plant_block(with_source(**more))) for more in ({}, {"kipmax": 0.0, "kiqmax": 0.0})
    )
    A, B = linearise(plant).A, linearise(free).A  # refuses what differences at two steps do not show
    held = [plant.state_names.index(f"gfm1.{name}") for name in WAITING]
    others = np.setdiff1d(np.arange(len(A)), held)
    np.testing.assert_array_equal(np.diag(A)[held], -1.0)
    assert np.count_nonzero(A[np.ix_(held, others)]) == np.count_nonzero(A[np.ix_(others, held)]) == 0
    np.testing.assert_array_equal(A[np.ix_(others, others)], B[np.ix_(others, others)])


@pytest.mark.parametrize(
    ("control", "network", "base"),
    [*((c, "dense", "two-area-thesis") for c in CONTROLS), ("voltage", "sparse", "kundur-manual")],
)
def test_it_rests_and_the_derivatives_are_those_of_differences(control, network, base):
    # without integral parts: the limits of P and Q have a kink where they wait
    plant = BlockShim(plant_block(with_source(control, base, kipmax=0.0, kiqmax=0.0), network=network))
    own = np.array([n.startswith("gfm1.") for n in plant.state_names])
    assert own.sum() == CONTROLS[control][1]
    rates, y = plant.derivatives(plant.x)
    assert np.max(np.abs(rates)) < 5e-11
    assert y[plant.output_names.index("gfm1.p")] == pytest.approx(1.0, abs=1e-11)
    assert y[plant.output_names.index("gfm1.q")] == pytest.approx(0.2, abs=1e-11)
    rates_off, outputs_off = plant.directional_errors(1e-4, 1e-5)
    assert rates_off < 1e-7
    assert outputs_off < 1e-6


@pytest.mark.parametrize("network", ["dense", "sparse"])
def test_its_angle_is_shown_against_the_centre_of_inertia(network):
    """In closed form from the states: its own less the mean of the machines' by H times rating."""
    case = with_source(base="two-area-thesis")
    plant = BlockShim(plant_block(case, network=network))
    moved = plant.x + 0.1 * np.sin(np.arange(plant.x.size))
    _, y = plant.derivatives(moved)
    angle = {n.removesuffix(".delta"): moved[k] for k, n in enumerate(plant.state_names) if "delta" in n}
    weight = {m.name: m.H * m.base_mva for m in case.machines}
    centre = sum(w * angle[m] for m, w in weight.items()) / sum(weight.values())
    shown = y[plant.output_names.index("gfm1_delta")]
    assert shown == pytest.approx(angle["gfm1"] - centre, abs=1e-12)
    line = next(s.variable for s in shown_of(case) if s.variable.name == "gfm1_delta")
    assert set(line.depends_on) == {f"{name}.delta" for name in angle} and line.unit == "rad"


def test_a_run_in_which_it_slips_once_is_lost_though_the_machines_hardly_swing(tmp_path):
    """A droop of 20 % turns it by half a turn and more while a fault keeps its power from the grid."""
    export_toml(with_source(mp=0.2), tmp_path / "case.toml")
    scenario = {"case": str(tmp_path / "case.toml"), "stop_s": 12.0, "controller": "none"}
    verdicts = {}
    for end_s in (1.02, 1.2):
        event = {"kind": "bus_fault", "bus": 8, "start_s": 1.0, "end_s": end_s}
        verdicts[end_s] = run_scenario(scenario | {"event": [event]}).metrics.verdict
    assert verdicts[1.02].name == SETTLED
    assert verdicts[1.2].name == LOST and verdicts[1.2].slips == 1 and verdicts[1.2].pair[0] == "gfm1"


#: one converter of 100 MVA behind a line of .25 pu on an infinite bus of 1 pu; a fault is a shunt at bus 1
X_LINE, BASE = 0.25, 100.0


def alone(**parameters):
    document = {
        "name": "droop",
        "title": "a grid-forming converter on an infinite bus",
        "source": "ours",
        "frequency_hz": 50.0,
        "base_mva": BASE,
        "buses": {"1": {"area": 1}, "2": {"area": 1}},
        "branches": {"line": {"from": 1, "to": 2, "x": X_LINE}},
        "machines": {
            "G2": {
                "bus": 2,
                "area": 1,
                "model": "infinite_bus",
                "Xd1": 1e-6,
                "base_mva": 1e4,
                "P_mw": 0.0,
                "V_pu": 1.0,
                "slack": True,
            },
        },
        "converters": {
            "gfm1": {
                "bus": 1,
                "base_mva": BASE,
                "P_mw": 50.0,
                "Q_mvar": 10.0,
                "control": {"kind": "regfm_a1"} | parameters,
            }
        },
    }
    return case_of(document, where="droop")


def run(case, seconds, events=(), step_s=0.001, **inputs):
    """Return time, states by name, outputs by name after the inputs step at once."""
    block = plant_block(case, more=["bus1.re", "bus1.im", "bus2.re", "bus2.im"])
    plant = BlockShim(block, event_parameters(case, events_of(list(events), where="test")))
    u = plant.u.copy()
    for name, value in inputs.items():
        u[plant.input_names.index(f"gfm1_{name}")] = value
    time_s, x, y = plant.run(seconds, step_s, u)
    states = {n.removeprefix("gfm1."): x[:, k] for k, n in enumerate(plant.state_names)}
    return time_s, states, {n: y[:, k] for k, n in enumerate(plant.output_names)}


def block_diagram(case, first, seconds, at, fault=None, **inputs):
    """Integrate the published block diagram with scipy; bus voltage in closed form, at the limit searched.

    first : states at rest; inputs : p_mod, q_mod; fault : (begin, end, reactance) of a shunt at the bus.
    """
    p = {q.name: q.default for q in library()["regfm_a1"].device.parameters}
    p |= {k: float(v) for k, v in case.converters[0].control.parameters.items()}
    pset, vset = 0.5, first["vf"] + p["mq"] * first["qf"]
    z, w0 = complex(p["Re"], p["Xe"]), 2 * np.pi * case.frequency_hz

    def bus(t, E):
        y = 1 / (1j * (X_LINE + 1e-8))
        shunt = 1 / (1j * fault[2]) if fault and fault[0] <= t < fault[1] else 0.0
        V = (E / z + y) / (1 / z + y + shunt)  # the infinite bus is 1
        I = (E - V) / z
        if abs(I) <= p["Imax"] or not p["Imax"]:
            return V, I

        def off(v):
            V = complex(*v)
            I = (E - V) / z
            gap = I * p["Imax"] / abs(I) - (V * (y + shunt) - y)
            return [gap.real, gap.imag]

        V = complex(*scipy.optimize.fsolve(off, [V.real, V.imag], xtol=1e-13))
        I = (E - V) / z
        return V, I * p["Imax"] / abs(I)

    def rates(t, s):
        pf, qf, vf, xa, xb, xc, xd, delta, e = s
        V, I = bus(t, e * np.exp(1j * delta))
        S = V * np.conj(I)
        dw = p["mp"] * (pset + inputs.get("p_mod", 0.0) - pf)
        dw += min(p["kppmax"] * (p["Pmax"] - pf) + xa, 0) + max(p["kppmax"] * (p["Pmin"] - pf) + xb, 0)
        v = vset - p["mq"] * qf + inputs.get("q_mod", 0.0)
        v += min(p["kpqmax"] * (p["Qmax"] - qf) + xc, 0) + max(p["kpqmax"] * (p["Qmin"] - qf) + xd, 0)

        def held(x, rate, sign):
            return 0.0 if sign * x >= 0.0 and sign * rate > 0.0 else rate

        return [
            (S.real - pf) / p["Tpf"],
            (S.imag - qf) / p["Tqf"],
            (abs(V) - vf) / p["Tvf"],
            held(xa, p["kipmax"] * (p["Pmax"] - pf), 1),
            held(xb, p["kipmax"] * (p["Pmin"] - pf), -1),
            held(xc, p["kiqmax"] * (p["Qmax"] - qf), 1),
            held(xd, p["kiqmax"] * (p["Qmin"] - qf), -1),
            w0 * dw,
            held(e - p["Emax"], p["kiv"] * (v - vf), 1),
        ]

    begin = [first[name] for name in ORDER]
    solved = scipy.integrate.solve_ivp(
        rates, (0, seconds), begin, method="RK45", t_eval=at, rtol=1e-8, atol=1e-10, max_step=1e-3
    )
    return dict(zip(ORDER, solved.y, strict=True))


ORDER = ("pf", "qf", "vf", "xpmax", "xpmin", "xqmax", "xqmin", "delta", "e")


def test_it_follows_the_block_diagram_beyond_the_limits_of_p_and_q():
    """p_mod asks for more than Pmax, q_mod for more than Qmax; another writing, another solver.

    Steps that pass a limit without a stop there are of first order: what is left is 3e-4.
    """
    case = alone(Pmax=0.7, Qmax=0.3, Imax=0.0, kiqmax=5.0, kpqmax=0.5)
    time_s, states, _ = run(case, 3.0, p_mod=0.6, q_mod=0.3)
    first = {name: course[0] for name, course in states.items()}
    expected = block_diagram(case, first, 3.0, time_s, p_mod=0.6, q_mod=0.3)
    assert np.max(states["pf"]) > 0.75
    assert np.min(states["xqmax"]) < -0.05
    for name in ORDER:
        assert states[name] == pytest.approx(expected[name], abs=5e-4), name


def test_at_rest_beyond_its_limits_it_gives_pmax_and_qmax():
    """Both limits have an integral part: what is asked beyond them changes nothing in the end."""
    case = alone(Pmax=0.7, Qmax=0.3, kipmax=1.0, kppmax=0.05, kpqmax=0.5, kiqmax=5.0)
    _, _, y = run(case, 20.0, step_s=0.004, p_mod=0.2001, q_mod=0.3)
    assert y["gfm1.p"][-1] == pytest.approx(0.7, abs=1e-5)
    assert y["gfm1.q"][-1] == pytest.approx(0.3, abs=1e-5)


@pytest.mark.parametrize(("flag", "input_"), [(1, 0.01), (0, 0.2)])
def test_within_its_limits_the_droops_are_straight_lines(flag, input_):
    """P = pset + p_mod at the frequency of the infinite bus; |V| = Vset - mq Q + q_mod, or + mq q_mod."""
    case = alone(QVflag=flag, mq=0.05)
    _, states, y = run(case, 8.0, step_s=0.004, p_mod=0.1, q_mod=input_)
    V = abs(y["bus1.re"] + 1j * y["bus1.im"])
    assert y["gfm1.p"][-1] == pytest.approx(0.6, abs=1e-6)
    rise = V[-1] - V[0] + 0.05 * (y["gfm1.q"][-1] - 0.1)
    assert rise == pytest.approx(input_ * (1.0 if flag else 0.05), abs=1e-6)
    assert states["vf"][-1] == pytest.approx(V[-1], abs=1e-6)


def test_a_fault_meets_the_current_limit_as_in_the_block_diagram():
    """|I| is Imax to rounding while it acts, in the direction of what the source would give."""
    case = alone(Imax=1.2, mp=0.02)
    fault = {"kind": "bus_fault", "bus": 1, "start_s": 0.05, "end_s": 0.15, "x_pu": 0.02}
    time_s, states, y = run(case, 0.6, [fault], step_s=0.0005)
    V = y["bus1.re"] + 1j * y["bus1.im"]
    current = np.conj((y["gfm1.p"] + 1j * y["gfm1.q"]) / V)
    limited = (time_s > 0.051) & (time_s < 0.149)
    assert abs(current[limited]) == pytest.approx(1.2, abs=1e-9)
    E = states["e"] * np.exp(1j * states["delta"])
    free = (E - V) / 0.15j
    assert np.all(abs(free[limited]) > 1.3)
    assert np.angle(free[limited] / current[limited]) == pytest.approx(0.0, abs=1e-9)
    after = time_s > 0.2
    assert current[after] == pytest.approx(free[after], abs=1e-9)
    expected = block_diagram(
        case, {n: c[0] for n, c in states.items()}, 0.6, time_s, fault=(0.05, 0.15, 0.02)
    )
    for name in ("pf", "qf", "vf", "delta", "e"):
        assert states[name] == pytest.approx(expected[name], abs=3e-3), name


@pytest.mark.parametrize("Imax", [1.0, 0.0])
def test_slopes_at_its_current_limit_are_those_of_differences(Imax):
    """In a fault the limit acts; derivatives by a complex step against differences there."""
    case = with_source("voltage", Imax=Imax, kipmax=0.0, kiqmax=0.0)
    fault = {"kind": "bus_fault", "bus": 9, "start_s": 0.0, "end_s": 1.0, "x_pu": 0.02}
    plant = BlockShim(plant_block(case), event_parameters(case, events_of([fault], where="test")))
    plant.event(0.0, plant.x)
    off, outputs_off = plant.directional_errors(1e-4, 1e-5)
    assert off < 1e-6
    assert outputs_off < 1e-5


def test_after_a_trip_it_gives_nothing():
    case = with_source()
    trip = {"kind": "device_trip", "device": "gfm1", "start_s": 0.1}
    plant = BlockShim(plant_block(case), event_parameters(case, events_of([trip], where="test")))
    time_s, x, y = plant.run(0.3, 0.002)
    tripped = time_s > 0.101
    for name in ("gfm1.p", "gfm1.q"):
        assert np.all(y[tripped, plant.output_names.index(name)] == 0.0)
    own = [k for k, name in enumerate(plant.state_names) if name.startswith("gfm1.")]
    assert np.array_equal(x[-1, own], x[np.flatnonzero(tripped)[0], own])


@pytest.mark.parametrize("control", CONTROLS)
def test_the_sparse_blocks_have_its_state_matrix(control):
    case = in_plant_order(with_source(control))
    blocks, _, _ = agreeing_blocks(case)
    assert blocks.inputs[-2:] == ("gfm1_p_mod", "gfm1_q_mod")


@pytest.mark.parametrize(
    ("more", "says"),
    [
        ({"Pmax": 0.4}, "xpmax is not constant at the equilibrium: its value is 0, its rate -0.01 1/s"),
        (
            {"Emax": 0.9},
            "e (voltage of the source) is 0.977897 at the equilibrium, above pick(Vflag == 1, Emax, 99) "
            "= 0.9",
        ),
        ({"Qmin": 0.5}, "Qmin = 0.5, Qmax = 0.44"),
    ],
)
def test_what_cannot_rest_is_named(more, says):
    with pytest.raises(CaseError) as reported:
        operating_point(with_source("voltage", **more))
    assert says in str(reported.value)


def test_all_angles_together_move_nothing():
    """The angle of the source turns with those of the machines; its droop brings a common speed back."""
    case = in_plant_order(with_source())
    block = plant_block(case)
    slopes = DeviceSlopes(block, cache=default_cache())
    zero = zero_eigenvalues_of(sparse_plant(slopes, block.data, solve_powerflow(case).voltages))
    assert zero.rotation
    plant = BlockShim(block)
    A = plant.jacobians()[0]
    turned = np.array([name.endswith(".delta") for name in plant.state_names], dtype=float)
    assert turned.sum() == len(case.machines) + 1
    assert np.max(np.abs(A @ turned)) < 1e-8


RECORD = "4 'REGFMA1' 1 1 1 0.01 0.02 0.03 1.5 1.15 0 1.0 0 0.5 -0.5 0.02 0.05 0.01 0.1 3 20 0 5.86 /\n"


def _pair(tmp_path, record=RECORD):
    return pair_with(tmp_path, record)


def test_a_record_becomes_a_converter_behind_the_impedance_of_the_raw_file(tmp_path):
    raw, dyr = _pair(tmp_path)
    case = import_psse(raw, dyr).case
    row = next(iter(case.converters))
    assert row.bus == 4
    values = row.control.parameters
    assert (row.control.kind, values["Imax"], values["mp"], values["kiv"]) == ("regfm_a1", 1.5, 0.02, 5.86)
    assert values["Xe"] == pytest.approx(load_case("kundur-pss").machine("G4").Xd1, rel=1e-9)
    rates, _ = BlockShim(plant_block(case)).derivatives(BlockShim(plant_block(case)).x)
    assert np.max(np.abs(rates)) < 1e-8
    assert import_psse(raw, dyr, options=ImportOptions(converters="current")).case.converters == ()


def test_a_record_of_gridpack_is_the_same_converter(tmp_path):
    """GDFORM: the numbers of REGFMA1 in another order, Vflag last; that it is one program's is said."""
    plain = import_psse(*_pair(tmp_path)).case.converters
    record = "4 'GDFORM' 1 0.05 0 5.86 0.02 0.01 0.1 1.0 0 1.15 0 0.01 1.5 0.5 -0.5 3 20 0.02 0.03 1 /\n"
    read = import_psse(*_pair(tmp_path, record))
    assert [row.control.parameters for row in read.case.converters] == [plain[0].control.parameters]
    assert any("GDFORM modelled as REGFMA1" in line for line in read.report.assumed)
    flat = import_psse(*_pair(tmp_path, record.replace("0.03 1 /", "0.03 0 /"))).case.converters[0]
    assert flat.control.parameters["Vflag"] == 0.0


def test_a_record_without_its_first_flag_is_refused(tmp_path):
    """One public reader takes 19 values; PSS/E 36 numbers two flags and 18 constants."""
    raw, dyr = _pair(tmp_path, RECORD.replace(" 1 1 1 ", " 1 1 ", 1))
    with pytest.raises(CaseError, match=r"grid\.dyr:\d+: REGFMA1 has 19 fields, allowed: 20"):
        import_psse(raw, dyr)
