"""Type 3 wind turbines WTARA1, WTPTA1, WTTQA1 with WTDTA1: rest, slopes, diagram, closed forms, records."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
from grid_text import pair_with
from one_converter import NAME, SHARE, X_TO_BUS, behind_a_line, beside_machines, course, solved, states_of
from plant_shim import BlockShim
from sparse_blocks import agreeing_blocks

from interarea.models.blocks.plant import plant_block
from interarea.models.errors import CaseError
from interarea.models.grid.equilibrium import operating_point
from interarea.models.grid.machine_tables import in_plant_order
from interarea.models.importers.imported import ImportOptions
from interarea.models.importers.psse import import_psse

TURBINE = {"TRAIN": 1, "WT3": 1, "REECA": 1, "H": 4.0, "Imax": 1.3, "Kpc": 3.0, "Twref": 5.0}
POWER = TURBINE | {"Tflag": 1, "torque_Kpp": 0.5, "torque_Kip": 2.5}
TWO = {"Htfrac": 0.85, "Freq1": 1.6, "Dshaft": 1.5}
RATED = {"theta0": 4.0, "p4": 0.5, "spd4": 1.2, "p3": 0.45, "spd3": 1.0}
PLANT = {"PLANT": 1, "plant_FFLAG": 1, "plant_Kpg": 0.5, "plant_Kig": 1.0, "plant_Tp": 0.1, "plant_Tg": 0.1}
DEEP = {"Lvpnt1": 0.2, "Lvpnt0": 0.1}  # so that it gives its current in the faults below
OWN = {"wg", "pet", "wref", "torqi", "pitwi", "pitci", "pitch"}
#: name -> parameters, states besides those of every converter
TURBINES = {
    "speed": (TURBINE | {"DAMP": 0.5}, OWN),
    "power": (POWER | TWO, OWN | {"wt", "tsh"}),
    "rated": (POWER | TWO | RATED | {"Kcc": 0.1, "Trate": 180.0}, OWN | {"wt", "tsh"}),
    "plant": (POWER | RATED | PLANT, OWN | {"rp", "rpp", "pext"}),
}


@pytest.mark.parametrize(("network", "base"), [("dense", "two-area-thesis"), ("sparse", "kundur-manual")])
@pytest.mark.parametrize("name", TURBINES)
def test_it_rests_at_the_speed_of_its_power(name, network, base):
    parameters, own = TURBINES[name]
    plant = BlockShim(plant_block(beside_machines(parameters, base), network=network))
    at = states_of(plant)
    assert own <= set(at) and len(at) == 5 + len(own)
    rates, y = plant.derivatives(plant.x)
    assert np.max(np.abs(rates)) < 5e-11
    assert np.max(np.abs(rates[[at[n] for n in own]])) < 1e-12
    assert y[plant.output_names.index(f"{NAME}.p")] == pytest.approx(1.0, abs=1e-11)
    speed = {"speed": 0.79, "power": 0.79, "rated": 1.2, "plant": 1.2}[name]  # of 0.5 and 0.5 200/180 pu
    x = {n: plant.x[at[n]] for n in own}
    assert 1.0 + x["wg"] == x["wref"] == pytest.approx(speed, rel=1e-12)
    assert x["torqi"] == pytest.approx(x["pet"] / speed, rel=1e-12)
    assert x["pitch"] == x["pitwi"] == parameters.get("theta0", 0.0)


@pytest.mark.parametrize("network", ["dense", "sparse"])
@pytest.mark.parametrize("name", ["rated", "plant"])
def test_its_slopes_are_those_of_complex_steps(name, network):
    """Of the diagram in Python, with what it sees moving as C says its outputs do."""
    case = beside_machines(TURBINES[name][0])
    block = plant_block(case, network=network, more=["bus8.re", "bus8.im"])
    plant, instance = BlockShim(block), operating_point(case).controls.of("converter")[0].rest.instance
    at, rng, step = states_of(plant), np.random.default_rng(3), 1e-30
    own, names = [at[n] for n in instance.state_names], list(plant.output_names)
    x = plant.x + 1e-3 * rng.standard_normal(len(plant.x))
    vx, vu = rng.standard_normal(len(plant.x)), np.zeros(len(plant.u))
    (_, y), (slopes, moves) = plant.derivatives(x), plant.directional(vx, vu, x)
    y = y + 1j * step * moves
    V = y[names.index("bus8.re")] + 1j * 0.0, y[names.index("bus8.im")]
    u = np.sqrt(V[0] ** 2 + V[1] ** 2)
    p, q = (y[names.index(f"{NAME}.{n}")] / SHARE for n in "pq")
    seen = {"vt": u, "p": p, "q": q, "p_mod": 0.0, "q_mod": 0.0, "vr": V[0] / u, "vi": V[1] / u}
    seen |= {"vreg": u, "vdrop": u, "pbr": p, "qbr": q}
    _, rates = instance.run(x[own] + 1j * step * vx[own], seen)
    expected = np.imag(rates) / step
    assert np.max(np.abs(slopes[own] - expected)) < 1e-9 * np.max(np.abs(expected))


@pytest.mark.slow
@pytest.mark.parametrize("name", ["speed", "rated", "plant"])
def test_at_rest_it_stands_for_20_s(name):
    _, own, out = course(beside_machines(TURBINES[name][0]), 20.0, 0.002)
    assert max(np.max(np.abs(c - c[0])) for c in (*own.values(), out[f"{NAME}.p"])) < 1e-11


def limited(rate, x, low, high):
    """The rate of an integral that stands at its limits."""
    return 0.0 if (x >= high and rate > 0.0) or (x <= low and rate < 0.0) else rate


FAULT = {"kind": "bus_fault", "bus": 1, "start_s": 0.1, "end_s": 0.25, "x_pu": 0.3}
KEYS = "vm pord iqlag ip iq tsh wt wg pet wref torqi pitwi pitci pitch rp rpp pext"
ORDER = tuple(KEYS.split())
PUBLISHED = {"Htfrac": 0.0, "Freq1": 0.0, "Dshaft": 0.0, "DAMP": 0.0, "Tflag": 0, "theta0": 0.0, "Ka": 0.007}
PUBLISHED |= {"torque_Kpp": 3.0, "torque_Kip": 0.6, "Kiw": 25.0, "Kpw": 150.0, "Kic": 30.0, "Kcc": 0.0}
PUBLISHED |= {"Temax": 1.2, "Temin": 0.0, "pitch_rmax": 10.0, "pitch_rmin": -10.0, "pitch_max": 27.0}
PUBLISHED |= {
    "p1": 0.2,
    "spd1": 0.58,
    "p2": 0.4,
    "spd2": 0.72,
    "p3": 0.6,
    "spd3": 0.86,
    "p4": 0.8,
    "spd4": 1.0,
}
PUBLISHED |= {"Trate": 100.0, "plant_FFLAG": 0, "pitch_min": 0.0, "Rrpwr": 10.0, "Vdip": -99.0}
PUBLISHED |= {"plant_Kpg": 0.0, "plant_Kig": 0.0, "plant_Tp": 1.0, "plant_Tg": 1.0}


def block_diagram(first, at, p, p_mod, events):
    """Integrate the plant behind its line by scipy, everything by its published diagram and in speeds."""
    P0, w0, ratio = 0.5, 1.0 + first["wg"], 100.0 / p["Trate"]
    Ht, plant = p["Htfrac"] * p["H"], p["plant_FFLAG"] == 1
    Hg, K = p["H"] - Ht, 2.0 * (2.0 * np.pi * p["Freq1"]) ** 2 * Ht * (p["H"] - Ht) / p["H"]
    curve = [[p[f"{key}{k}"] for k in range(1, 5)] for key in ("p", "spd")]
    angles = p["pitch_min"], p["pitch_max"]

    def rates(t, s, fault):
        x = dict(zip(ORDER, s, strict=True))
        part = 0.3 / (X_TO_BUS + 0.3) if fault else 1.0
        u = np.sqrt(part**2 - (X_TO_BUS * part * x["ip"]) ** 2) + X_TO_BUS * part * x["iq"]
        power, dip = x["ip"] * u, u < p["Vdip"]
        speed = 1.0 + x["wg"]
        blades = 1.0 + x["wt"] if Ht > 0.0 else speed
        error = speed - x["wref"]
        if p["Tflag"] == 1:
            request = x["pext"] if plant else P0 + p_mod
            error = (request * ratio - x["pet"]) / speed
        torque = np.clip(x["torqi"] + p["torque_Kpp"] * error, p["Temin"], p["Temax"])
        pref = torque * speed / ratio + (0.0 if p["Tflag"] == 1 else p_mod)
        more = x["pord"] - pref
        fast = blades - x["wref"] + p["Kcc"] * more
        target = np.clip(x["pitwi"] + p["Kpw"] * fast, *angles)
        target += np.clip(x["pitci"] + p["Kpc"] * more, *angles)
        turning = np.clip((target - x["pitch"]) / 0.3, p["pitch_rmin"], p["pitch_rmax"])
        driven = (P0 - p["Ka"] * x["pitch"] * (x["pitch"] - p["theta0"])) / blades
        shaft = x["tsh"] + p["Dshaft"] * (x["wt"] - x["wg"]) if Ht > 0.0 else driven
        iqc = np.clip(x["iqlag"], -p["Imax"], p["Imax"])
        ipc = np.clip(x["pord"] / max(x["vm"], 0.01), 0.0, np.sqrt(p["Imax"] ** 2 - iqc**2))
        lost = first["pext"] + p_mod - x["rp"] if plant else 0.0
        whole = p["plant_Kpg"] * lost + x["rpp"]
        return [
            (u - x["vm"]) / 0.02,
            0.0 if dip else (pref - x["pord"]) / 0.02,
            0.0 if dip else (0.1 / max(x["vm"], 0.01) - x["iqlag"]) / 0.02,
            min((ipc - x["ip"]) / 0.02, p["Rrpwr"]),
            (iqc - x["iq"]) / 0.02,
            K * (x["wt"] - x["wg"]),
            (driven - shaft) / (2.0 * Ht) if Ht > 0.0 else 0.0,
            (shaft - power / speed - p["DAMP"] * (speed - w0)) / (2.0 * Hg),
            (power * ratio - x["pet"]) / 0.05,
            (np.interp(x["pet"], *curve) - x["wref"]) / p["Twref"],
            0.0 if dip else limited(p["torque_Kip"] * error, x["torqi"], p["Temin"], p["Temax"]),
            limited(p["Kiw"] * fast, x["pitwi"], *angles),
            limited(p["Kic"] * more, x["pitci"], *angles),
            limited(turning, x["pitch"], *angles),
            (power - x["rp"]) / p["plant_Tp"],
            0.0 if (whole > 1.0 and lost > 0.0) or (whole < 0.0 and lost < 0.0) else p["plant_Kig"] * lost,
            (np.clip(whole, 0.0, 1.0) - x["pext"]) / p["plant_Tg"],
        ]

    ends = [0.0, *(e[key] for e in events for key in ("start_s", "end_s")), at[-1]]
    state, pieces = [first[name] for name in ORDER], []
    for k, (begin, end) in enumerate(itertools.pairwise(ends)):
        inside = at[(at >= begin) & (at < end)]
        piece = solved(lambda t, s, k=k: rates(t, s, k % 2 == 1), state, np.unique([begin, *inside, end]))
        state = piece[:, -1]
        pieces.append(piece[:, : len(inside)])
    return dict(zip(ORDER, np.column_stack([*pieces, state]), strict=True))


#: parameters, step of the reference, events, and what the run reaches, put out of reach
RUNS = {
    "fault": (POWER | TWO | {"Vdip": 0.8}, 0.0, [FAULT], {"Vdip": -99.0}),
    "fault, rated": (POWER | TWO | RATED | {"pitch_rmax": 2.0}, 0.0, [FAULT], {"pitch_rmax": 1e9}),
    "fault, speed": (TURBINE | {"DAMP": 0.5, "torque_Kpp": 9.0, "Temax": 0.65}, 0.0, [FAULT], {"Temax": 9.0}),
    "reference down": (POWER | PLANT | {"Kcc": 0.1}, -0.15, [], {"Kcc": 0.0}),
    "reference up": (POWER | PLANT | {"DAMP": 0.5}, 0.15, [], {"pitch_min": -9.0}),
    "reference, rated": (POWER | TWO | RATED | PLANT | {"pitch_max": 9.0}, -0.15, [], {"pitch_max": 27.0}),
    "reference, speed": (TURBINE | {"Trate": 90.0}, -0.15, [], {"Ka": 0.0}),
}
ANGLES = ("pitch", "pitwi", "pitci")  # degrees


@pytest.mark.slow
@pytest.mark.parametrize("name", RUNS)
def test_it_follows_the_block_diagram(name):
    """Within 2e-6 pu and 2e-3 degrees; the diagram without what the run is about goes elsewhere."""
    more, p_mod, events, reaches = RUNS[name]
    time_s, states, _ = course(behind_a_line(more | DEEP), 4.0, 0.001, {"p_mod": p_mod}, events)
    first = {name: states[name][0] if name in states else 0.0 for name in ORDER}
    p = PUBLISHED | more
    expected = block_diagram(first, time_s, p, p_mod, events)
    for key in ORDER:
        if key in states:
            assert states[key] == pytest.approx(expected[key], abs=2e-3 if key in ANGLES else 2e-6), key
    other = block_diagram(first, time_s, p | reaches, p_mod, events)
    assert max(np.max(np.abs(other[key] - expected[key])) for key in ORDER) > 5e-3


@pytest.mark.slow
def test_where_the_wind_is_more_than_the_plant_asks_the_blades_turn():
    """After a step of the plant's reference to P1: Ka pitch (pitch - theta0) = P0 - P1 at the speed of P1."""
    slow = {"plant_Kpg": 0.1, "plant_Kig": 0.3, "Twref": 1.0}
    _, own, out = course(behind_a_line(POWER | PLANT | slow | {"theta0": 4.0}), 120.0, 0.005, {"p_mod": -0.1})
    end = {name: path[-1] for name, path in own.items()}
    assert out[f"{NAME}.p"][-1] == pytest.approx(0.4, abs=1e-5)
    assert 1.0 + end["wg"] == pytest.approx(0.72, abs=1e-4)  # of 0.4 pu, a point of the curve
    assert end["torqi"] == pytest.approx(0.4 / 0.72, abs=1e-4)
    assert end["pitch"] == pytest.approx(2.0 + np.sqrt(4.0 + 0.1 / 0.007), abs=1e-3)


@pytest.mark.parametrize("name", ["power", "rated"])
def test_what_the_wind_gives_and_the_grid_takes_is_its_energy(name):
    """H (speed^2 - 1) of both masses and T^2/2K of the shaft are the integral of Pm - P, without damping."""
    more = TURBINES[name][0] | {"Dshaft": 0.0}
    time_s, own, out = course(behind_a_line(more | DEEP), 2.0, 0.001, {}, [FAULT])
    theta = own["pitch"]
    net = 0.5 - 0.007 * theta * (theta - more.get("theta0", 0.0)) - out[f"{NAME}.p"]
    work = np.append(0.0, np.cumsum(np.diff(time_s) * 0.5 * (net[1:] + net[:-1])))
    Ht, Hg = 4.0 * 0.85, 4.0 * 0.15
    K = 2.0 * (2.0 * np.pi * 1.6) ** 2 * Ht * Hg / 4.0
    energy = Ht * (1.0 + own["wt"]) ** 2 + Hg * (1.0 + own["wg"]) ** 2 + own["tsh"] ** 2 / (2.0 * K)
    assert np.ptp(work) > 0.015
    assert energy - energy[0] == pytest.approx(work, abs=2e-4)  # trapezes over the jumps of P


def test_the_sparse_blocks_have_its_state_matrix():
    blocks, _, _ = agreeing_blocks(in_plant_order(beside_machines(TURBINES["rated"][0])))
    assert blocks.inputs[-2:] == (f"{NAME}_p_mod", f"{NAME}_q_mod")


@pytest.mark.parametrize(
    ("more", "says"),
    [
        ({"TRAIN": 0}, "set TRAIN to 1 (record WTDTA1), or WT3 to 0"),
        ({"theta0": -1.0}, "the pitch starts at theta0: give it pitch_min to pitch_max"),
        ({"p3": 0.3}, "the curve of the speed rises: give p1 < p2 < p3 < p4"),
        ({"spd3": 0.7}, "the curve of the speed rises: give spd1 <= spd2 <= spd3 <= spd4"),
        (
            {"Temax": 0.6},
            "(torque order, integral part) is 0.632911 at the equilibrium, above Temax = 0.6; set Temax",
        ),
        ({"pitch_min": -4.0, "pitch_max": -1.0, "theta0": -2.0}, "at the equilibrium, above pitch_max = -1"),
    ],
)
def test_what_cannot_start_is_named(more, says):
    with pytest.raises(CaseError) as reported:
        operating_point(beside_machines(TURBINE | more))
    assert says in str(reported.value)


RECORD = """4 'REGCA1' 1 0 0.02 10 0.9 0.4 1.22 1.2 0.8 0.4 -1.3 0.02 0.7 99 -99 0.7 /
4 'REECA1' 1 0 0 0 0 {PFLAG} 0 -99 99 0.02 0 0 0 1.1 -1.1 0 0 0 0 0.05 0.8 -0.8 1.1 0.9 0 0.1 0 40 0 0.02
  9 -9 1 0 1.3 0.02 0 0 0 0 0 0 0 0 0 0 0 0 0 0 0 0 /
"""
PARTS = {
    "WTDTA1": "5 0.5 0.8 1.5 1.2",
    "WTARA1": "0.006 3",
    "WTPTA1": "26 140 31 2 0.1 0.25 28 -1 9 -8",
    "WTTQA1": "1 0.5 2.5 0.06 50 1.1 0.05 0.2 0.58 0.4 0.72 0.72 0.866 0.86 1 0",
}


def records(parts=PARTS, PFLAG=0):
    text = RECORD.replace("{PFLAG}", str(PFLAG))
    return text + "".join(f"4 '{model}' 1 {fields} /\n" for model, fields in parts.items())


@pytest.mark.parametrize("user", [False, True])
def test_records_are_the_turbine_of_their_plant(tmp_path, user):
    text = records()
    if user:  # ICON: WTTQA1 has one
        text = text.replace("'WTARA1' 1", "'USRMDL' 1 'WTARAU1' 107 0 0 2 0 1")
    case = import_psse(*pair_with(tmp_path, text)).case
    values = case.converters[0].control.parameters
    pitch = (
        "Kiw",
        "Kpw",
        "Kic",
        "Kpc",
        "Kcc",
        "pitch_Tp",
        "pitch_max",
        "pitch_min",
        "pitch_rmax",
        "pitch_rmin",
    )
    torque = ("Tflag", "torque_Kpp", "torque_Kip", "torque_Tp", "Twref", "Temax", "Temin")
    curve = tuple(f"{key}{k}" for k in range(1, 5) for key in ("p", "spd"))
    for keys, model in (
        (("Ka", "theta0"), "WTARA1"),
        (pitch, "WTPTA1"),
        ((*torque, *curve, "Trate"), "WTTQA1"),
    ):
        assert [values[key] for key in keys] == [float(field) for field in PARTS[model].split()]
    assert values["WT3"] == values["TRAIN"] == 1.0
    plant = BlockShim(plant_block(case))
    assert np.max(np.abs(plant.derivatives(plant.x)[0])) < 1e-8


def test_what_a_record_writes_otherwise_is_told(tmp_path):
    """As GridPACK's file: three fields of WTARA1, four of WTDTA1; and PFLAG beside a torque control."""
    parts = PARTS | {"WTARA1": "1 0.006 3", "WTDTA1": "5 0.5 0.0 0.0"}
    imported = import_psse(*pair_with(tmp_path, records(parts, PFLAG=1)))
    values = imported.case.converters[0].control.parameters
    keys = ("Ka", "theta0", "H", "Htfrac", "Dshaft", "PFLAG")
    assert [values[key] for key in keys] == [0.006, 3.0, 5.0, 0.0, 0.0, 0.0]
    lines = imported.report.text()
    for what in (
        "first of three fields of WTARA1 ignored",
        "WTDTA1 without Dshaft, which a single mass does not have",
        "PFLAG = 1 with a WTTQA1, which already multiplies by the speed: 0 used",
    ):
        assert what in lines


@pytest.mark.parametrize("left", [("WTDTA1",), ("WTARA1",), ("WTPTA1", "WTARA1")])
def test_a_part_of_a_turbine_is_refused_with_the_remedy(tmp_path, left):
    parts = {model: fields for model, fields in PARTS.items() if model not in left}
    there = ",".join(model for model in ("WTARA1", "WTPTA1", "WTTQA1") if model in parts)
    files = pair_with(tmp_path, records(parts))
    with pytest.raises(CaseError) as reported:
        import_psse(*files)
    assert "allowed: all of WTARA1, WTPTA1, WTTQA1, WTDTA1" in str(reported.value)
    assert f"--leave-out {there} uses a turbine" in str(reported.value) and ".dyr:" in str(reported.value)
    case = import_psse(*files, options=ImportOptions(leave_out=there.split(","))).case
    assert case.converters[0].control.parameters.get("WT3", 0.0) == 0.0


@pytest.mark.parametrize("model", ["WTARA1", "WTPTA1", "WTTQA1"])
def test_a_record_cut_off_is_refused_with_its_line(tmp_path, model):
    parts = PARTS | {model: PARTS[model].rpartition(" ")[0]}
    with pytest.raises(CaseError, match=rf"grid.dyr:\d+: {model} has \d+ fields, allowed: .*cut off"):
        import_psse(*pair_with(tmp_path, records(parts)))
