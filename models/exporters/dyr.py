"""The dynamic data of a case as a PSS/E DYR file, to go with its RAW file."""

from __future__ import annotations

import math

from ..case.case import Case
from ..case.control_schema import Control, control_model, control_numbers
from ..case.schema import Machine
from ..devices.dyr import dyr_fields
from ..devices.language.device import NO_LIMIT
from ..devices.language.structure import Model
from ..errors import DeviceError
from .raw import machine_identities
from .written import Written, named

_CONTROLS = ("exciter", "stabilizer", "compensator", "limiter", "governor")
#: what a user-written model is, the number IC of its record
_CODES = {"compensator": 2, "stabilizer": 3, "exciter": 4, "governor": 5}
_ROUND = ("Td01", "Td02", "Tq01", "Tq02", "H", "D", "Xd", "Xq", "Xd1", "Xq1", "Xd2", "Xl")
_SALIENT = ("Td01", "Td02", "Tq02", "H", "D", "Xd", "Xq", "Xd1", "Xd2", "Xl")
_WIDE = 9999.0  #: an absent limit, as people write it


def dyr_of(case: Case) -> Written:
    """Return machines and controls of `case` as records; identifiers are those of `raw_of`.

    A machine without dynamic data has no record. What no record can hold is left out and named.
    """
    identity = machine_identities(case)
    lines = [f"// {case.name}"]
    bare: list[str] = []
    losses: list[str] = []
    for m in case.machines:
        if m.model == "power_flow":
            bare.append(m.name)
            continue
        model, values, own_losses = _machine(m)
        lines.append(_record(m.bus, model, identity[m.name], values))
        losses += own_losses
        for word in _CONTROLS:
            control = getattr(m, word)
            device = None if control is None else control_model(word, control, case.own_devices)
            if control is None or device is None:
                continue
            try:
                name, fields = _control(device, control, m.base_mva, case.frequency_hz)
            except DeviceError as error:
                losses.append(f"{m.name}.{word}: {error}")
                continue
            if control.kind in case.own_devices and word not in _CODES:
                losses.append(f"{m.name}.{word}: no code of a user-written model stands for a {word}")
                continue
            user = _user(device) if control.kind in case.own_devices else ""
            lines.append(_record(m.bus, name, identity[m.name], fields, user))
    if bare:
        losses.append(f"machines without dynamic data have no record ({named(bare)})")
    return Written("\n".join([*lines, ""]), tuple(losses))


def _record(bus: int, model: str, identity: str, fields: tuple[float, ...], user: str = "") -> str:
    head = f"{bus} '{model}' '{identity}' "
    if user:  # a user-written model: its name after the identifier, then what it is and how much it has
        head = f"{bus} 'USRMDL' '{identity}' '{model}' {user.format(len(fields))} "
    return head + " ".join(f"{value!r}" for value in fields) + " /"


def _user(model: Model) -> str:
    """What stands between name and values of a user-written model: IC IT NI NC NS NV."""
    return f"{_CODES[model.device.kind]} 0 0 {{}} {len(model.states)} 0"


def _machine(m: Machine) -> tuple[str, tuple[float, ...], list[str]]:
    """Model, fields and losses of a machine."""
    if m.model == "infinite_bus":
        return "GENCLS", (0.0, 0.0), []
    if m.model == "classical":
        return "GENCLS", (m.number("H"), m.D), []
    salient = m.one_q_winding and _saturates_as_salient(m)
    exponential = m.flux_saturation is not None and m.flux_saturation.shape == "exponential"
    letter = "E" if exponential else "L" if salient else "U"
    keys = _SALIENT if salient else _ROUND
    values = (1.0 if key == "Tq01" and m.one_q_winding else m.number(key) for key in keys)
    return ("GENSA" if salient else "GENRO") + letter, (*values, *_saturation(m)), _lost(m)


def _lost(m: Machine) -> list[str]:
    """Return what no record holds of a round-rotor machine."""
    losses = []
    if m.Xd2 != m.Xq2:
        losses.append(f"{m.name}: X''q = {m.Xq2:g}, which becomes X''d")
    if not m.torque_by_speed:
        losses.append(f"{m.name}: its torque is not power over speed, which PSS/E's is")
    if m.flux_saturation is None and m.saturation is not None:
        use = m.saturation.use
        losses.append(f"{m.name}: saturation of the form Asat exp(Bsat (flux - psiT1)), used as {use!r}")
    if m.one_q_winding and not _saturates_as_salient(m):
        losses.append(
            f"{m.name}: saturation on the one winding of its q axis, which GENROU has on the outer of two"
        )
    return losses


def _saturates_as_salient(m: Machine) -> bool:
    """Return whether GENSAL or GENSAE has the saturation of a machine, if it has any."""
    s = m.flux_saturation
    if s is None:
        return m.saturation is None
    return s.shape == "exponential" or s.of == "transient_emf"


def _saturation(m: Machine) -> tuple[float, float]:
    """S(1.0) and S(1.2) of a machine, 0 without saturation."""
    if m.flux_saturation is not None:
        return m.flux_saturation.S10, m.flux_saturation.S12
    if m.saturation is None:
        return 0.0, 0.0
    s = m.saturation
    at = [s.Asat * math.exp(s.Bsat * (flux - s.psiT1)) for flux in (1.0, 1.2)]
    return at[0], at[1] / 1.2  # of the flux


def _control(
    model: Model, control: Control, base_mva: float, frequency_hz: float
) -> tuple[str, tuple[float, ...]]:
    values: dict[str, float] = {}
    for name, value in control_numbers(model, control, base_mva, frequency_hz).items():
        if isinstance(value, str):
            raise DeviceError(f"{name} = {value!r} is computed at the equilibrium")
        values[name] = math.copysign(_WIDE, value) if abs(value) >= NO_LIMIT else float(value)
    try:
        return dyr_fields(model, values)
    except KeyError as error:
        raise DeviceError(f"{model.device.name}: no record holds {error}") from None
