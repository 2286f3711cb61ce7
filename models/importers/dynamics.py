"""Dynamic data of a PSS/E DYR file as machine, exciter, stabilizer and governor tables.

How the models map (parameters in the order of the PSS/E model library):

GENROU, GENROE  -> round_rotor; X''q = X''d, Ra from the RAW file; S(1.0), S(1.2) of the open-circuit curve
                   become the exponential through both points.
GENSAL          -> round_rotor with Xq1 = Xq: then ed1 stays 0 and the one q damper is the outer one.
                   Its saturation, on the d axis only, has no counterpart: S(1.0), S(1.2) must be 0.
GENCLS          -> classical behind ZR + jZX of the RAW file; with H = 0 an infinite bus there.
SEXS            -> static or static_tgr;   EXST1, ESST1A -> st1a;   IEEET1, IEEEX1, ESDC1A -> dc1, the
                   saturation factor being the exponential through both points.
IEEEST, STAB1   -> stabilizer;             TGOV1 -> tgov1.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from ..case.errors import CaseError
from .dyr import read_dyr
from .raw.record import Record
from .report import Report

#: machine models that are converters
CONVERTERS = frozenset(
    ["REGCA1", "REGCB1", "REGCC1", "GDFORM", "WT1G1", "WT2G1", "WT3G1", "WT3G2", "WT4G1", "WT4G2", "PVGU1"]
)


@dataclass(frozen=True)
class Dynamics:
    """What a DYR file says of the units of a grid.

    rows : name of a machine -> keys to merge into its row. where : name -> file:line of its machine model.
    constant : name of a unit without machine model -> exponent of its injection.
    """

    rows: dict[str, dict[str, Any]]
    where: dict[str, str]
    constant: dict[str, float]


def machine_dynamics(
    path: Path,
    machine_of: Mapping[tuple[int, str], str],
    out: Collection[tuple[int, str]],
    report: Report,
    *,
    converters_as_current: bool = False,
) -> Dynamics:
    """Return the dynamic data of the DYR file `path`.

    machine_of : (bus, id) -> name of a unit in service. out : units out of service, whose records are
    counted and passed over. A unit without a machine model is constant P and Q; a converter is refused, or a
    constant current if `converters_as_current`.

    Raises
    ------
    CaseError : a model that is not supported, a record that is cut off or too long, a second model of one
        kind for one machine; each with file and line.
    """
    file = read_dyr(path)
    for note in file.notes:
        place, _, what = note.partition(": ")
        report.assume(what, place)
    rows: dict[str, dict[str, Any]] = {name: {} for name in machine_of.values()}
    seen: dict[tuple[str, str], str] = {}
    where: dict[str, str] = {}
    constant: dict[str, float] = {}
    for record in file.records:
        at = (record.bus, record.identity)
        if record.model in CONVERTERS and at in machine_of and converters_as_current:
            constant[machine_of[at]] = 1.0
            report.assume("converter taken as a constant current", record.where)
    for record in file.records:
        at, model = (record.bus, record.identity), record.model
        if at in out:
            report.drop("DYR record of a unit out of service", record.where)
            continue
        if at not in machine_of:
            report.assume("DYR record of a unit that the grid does not have left out", record.where)
            continue
        name = machine_of[at]
        if name in constant:
            report.drop("further DYR record of a constant current", record.where)
            continue
        if model not in _MODELS:
            raise CaseError(f"{record.where}: {_unknown(model, record.bus)}")
        kind, count, convert = _MODELS[model]
        if len(record.fields) != count:
            less = len(record.fields) < count
            raise CaseError(
                f"{record.where}: {model} has {len(record.fields)} parameters, allowed: {count} "
                f"({'cut off?' if less else 'is the / of the record missing?'})"
            )
        position = {str(k + 1): k for k in range(count)}
        fields = Record(model, record.fields, record.where, position)
        values = [fields.number(str(k + 1)) for k in range(count)]
        if (name, kind) in seen:
            raise CaseError(f"{record.where}: second {kind} of {name}, the first is at {seen[name, kind]}")
        seen[name, kind] = record.where
        table = convert(record.where, *values)
        if kind == "machine model":
            where[name] = record.where
        rows[name] |= (
            table if kind == "machine model" else {kind: {"source": f"{path.name}, {model}"} | table}
        )
        report.read[f"{model}"] += 1
    for (bus, identity), name in machine_of.items():
        if name in where or name in constant:
            continue
        other = next((place for (n, _), place in seen.items() if n == name), None)
        if other is not None:
            raise CaseError(f"{other}: machine {name} has controls but no machine model in {path.name}")
        constant[name] = 0.0
        report.assume("unit without DYR record taken as constant P and Q", f"{path}: bus {bus}, {identity!r}")
    return Dynamics({name: row for name, row in rows.items() if name not in constant}, where, constant)


def _unknown(model: str, bus: int) -> str:
    advice = "; --converters current takes converters as constant currents" if model in CONVERTERS else ""
    return f"model {model!r} at bus {bus} is not supported, allowed: {', '.join(_MODELS)}{advice}"


def _through(e1: float, s1: float, e2: float, s2: float, where: str) -> tuple[float, float]:
    """Return A, B of S = A exp(B E) through two points."""
    if s1 == 0.0 and s2 == 0.0:
        return 0.0, 0.0
    if not (0.0 < s1 < s2 and 0.0 < e1 < e2):
        raise CaseError(
            f"{where}: saturation S({e1:g}) = {s1:g}, S({e2:g}) = {s2:g}, allowed: both rising, or both 0"
        )
    slope = math.log(s2 / s1) / (e2 - e1)
    return s1 * math.exp(-slope * e1), slope


def _genrou(where: str, *p: float) -> dict[str, Any]:
    keys = ("Td01", "Td02", "Tq01", "Tq02", "H", "D", "Xd", "Xq", "Xd1", "Xq1", "Xd2", "Xl")
    row: dict[str, Any] = dict(zip(keys, p[:12], strict=True)) | {"Xq2": p[10], "model": "round_rotor"}
    factor, slope = _through(1.0, p[12], 1.2, 1.2 * p[13], where)  # S relative to the flux
    if factor:
        row["saturation"] = {"Asat": factor * math.exp(0.8 * slope), "Bsat": slope, "psiT1": 0.8}
    return row


def _gensal(where: str, *p: float) -> dict[str, Any]:
    keys = ("Td01", "Td02", "Tq02", "H", "D", "Xd", "Xq", "Xd1", "Xd2", "Xl")
    row: dict[str, Any] = dict(zip(keys, p[:10], strict=True))
    if p[10] or p[11]:
        raise CaseError(
            f"{where}: GENSAL S(1.0) = {p[10]:g}, S(1.2) = {p[11]:g}: d-axis saturation, allowed: 0"
        )
    # with Xq1 = Xq nothing drives ed1, so its time constant plays no part
    return row | {"model": "round_rotor", "Xq1": row["Xq"], "Xq2": row["Xd2"], "Tq01": 1.0}


def _gencls(where: str, H: float, D: float) -> dict[str, Any]:
    if H == 0.0:
        return {"model": "infinite_bus"}
    if not H > 0.0:
        raise CaseError(f"{where}: GENCLS with H = {H:g}, allowed: 0 (an infinite bus) or above")
    return {"model": "classical", "H": H, "D": D}


def _sexs(
    where: str, ratio: float, TB: float, K: float, TE: float, low: float, high: float
) -> dict[str, Any]:
    row = {"KA": K, "TA": TE, "Efd_min": low, "Efd_max": high}
    if TB == 0.0 or ratio == 1.0:
        return {"kind": "static"} | row
    return {"kind": "static_tgr", "TC": ratio * TB, "TB": TB} | row


def _st1a(
    where: str, TR: float, high: float, low: float, TC: float, TB: float, KA: float, TA: float, *rest: float
) -> dict[str, Any]:
    VRmax, VRmin, KC, KF, _TF = rest
    if KF:
        raise CaseError(f"{where}: KF = {KF:g}: rate feedback, allowed: 0")
    if high < 1.0 or low > -1.0:
        raise CaseError(
            f"{where}: VIMAX = {high:g}, VIMIN = {low:g}, allowed: beyond +-1 pu (no limit on the error)"
        )
    if TC == TB:
        TC = TB = 0.0
    return {
        "kind": "st1a",
        "TR": TR,
        "TC": TC,
        "TB": TB,
        "KA": KA,
        "TA": TA,
        "VRmax": VRmax,
        "VRmin": VRmin,
        "KC": KC,
    }


def _esst1a(where: str, *p: float) -> dict[str, Any]:
    TR, high, low, TC, TB, TC1, TB1, KA, TA, VAmax, VAmin, VRmax, VRmin, KC, KF, TF, KLR, _ILR = p[2:]
    if TC1 != TB1:
        raise CaseError(f"{where}: TC1 = {TC1:g}, TB1 = {TB1:g}: second lead-lag, allowed: equal times")
    if KLR:
        raise CaseError(f"{where}: KLR = {KLR:g}: field current limiter, allowed: 0")
    if p[1] != 1.0:
        raise CaseError(f"{where}: VOS = {p[1]:g}, allowed: 1 (stabilizer at the summing point)")
    if VAmax < VRmax or VAmin > VRmin:
        raise CaseError(
            f"{where}: VAMAX = {VAmax:g}, VAMIN = {VAmin:g} inside VRMAX, VRMIN, allowed: not inside"
        )
    return _st1a(where, TR, high, low, TC, TB, KA, TA, VRmax, VRmin, KC, KF, TF)


def _ieeet1(where: str, TR: float, KA: float, TA: float, *rest: float) -> dict[str, Any]:
    return _ieeex1(where, TR, KA, TA, 0.0, 0.0, *rest)


def _ieeex1(
    where: str, TR: float, KA: float, TA: float, TB: float, TC: float, *rest: float
) -> dict[str, Any]:
    VRmax, VRmin, KE, TE, KF, TF, _switch, E1, S1, E2, S2 = rest
    if KE == 0.0 or VRmax == 0.0:
        raise CaseError(
            f"{where}: KE = {KE:g}, VRMAX = {VRmax:g}: to be computed by PSS/E, allowed: given values"
        )
    if TB == TC:
        TB = TC = 0.0
    Aex, Bex = _through(E1, S1, E2, S2, where)
    row = {"TR": TR, "KA": KA, "TA": TA, "TB": TB, "TC": TC, "VRmax": VRmax, "VRmin": VRmin}
    return {"kind": "dc1", "KE": KE, "TE": TE, "KF": KF, "TF": TF or 1.0, "Aex": Aex, "Bex": Bex} | row


def _ieeest(where: str, mode: float, *p: float) -> dict[str, Any]:
    if mode != 1.0:
        raise CaseError(f"{where}: IEEEST input code {mode:g}, allowed: 1 (speed deviation)")
    if p[0]:
        raise CaseError(f"{where}: IEEEST remote bus {p[0]:g}, allowed: 0 (own machine)")
    if any(p[1:7]):
        raise CaseError(f"{where}: IEEEST filter A1..A6 = {list(p[1:7])}, allowed: 0")
    T1, T2, T3, T4, T5, T6, KS, high, low, over, under = p[7:]
    if over or under:
        raise CaseError(f"{where}: IEEEST VCU = {over:g}, VCL = {under:g}, allowed: 0")
    row = {"K": KS * T5 / T6 if T6 else KS, "Tw": T6, "Vs_max": high, "Vs_min": low}
    return row | _stages(where, (T1, T2), (T3, T4))


def _stab1(
    where: str, K: float, T: float, a: float, T3: float, b: float, T4: float, limit: float
) -> dict[str, Any]:
    row = {"K": K, "Tw": T, "Vs_max": limit, "Vs_min": -limit}
    return row | _stages(where, (a * T3, T3), (b * T4, T4))


def _stages(where: str, *pairs: tuple[float, float]) -> dict[str, float]:
    kept = [pair for pair in pairs if pair[0] != pair[1]]
    for lead, lag in kept:
        if not lag > 0.0:
            raise CaseError(f"{where}: lead-lag (1 + {lead:g} s)/(1 + {lag:g} s), allowed: a lag above 0")
    keys = (("T1", "T2"), ("T3", "T4"))
    return {k: v for names, pair in zip(keys, kept, strict=False) for k, v in zip(names, pair, strict=True)}


def _tgov1(
    where: str, R: float, T1: float, high: float, low: float, T2: float, T3: float, Dt: float
) -> dict[str, Any]:
    return {"kind": "tgov1", "R": R, "T1": T1, "Vmax": high, "Vmin": low, "T2": T2, "T3": T3, "Dt": Dt}


_MODELS: dict[str, tuple[str, int, Callable[..., dict[str, Any]]]] = {
    "GENROU": ("machine model", 14, _genrou),
    "GENROE": ("machine model", 14, _genrou),
    "GENSAL": ("machine model", 12, _gensal),
    "GENCLS": ("machine model", 2, _gencls),
    "SEXS": ("exciter", 6, _sexs),
    "EXST1": ("exciter", 12, _st1a),
    "ESST1A": ("exciter", 20, _esst1a),
    "IEEET1": ("exciter", 14, _ieeet1),
    "IEEEX1": ("exciter", 16, _ieeex1),
    "ESDC1A": ("exciter", 16, _ieeex1),
    "IEEEST": ("stabilizer", 19, _ieeest),
    "STAB1": ("stabilizer", 7, _stab1),
    "TGOV1": ("governor", 7, _tgov1),
}
