"""Identification of a channel by its name and unit in the files of different makers."""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from dataclasses import dataclass

from ..record import ANGLES, Channel

_RAD = math.pi / 180.0
#: unit as files write it, in small letters -> quantity it is the unit of ("" several), unit here, factor
_UNITS: dict[str, tuple[str, str, float]] = {
    "hz": ("frequency", "Hz", 1.0),
    "mhz": ("frequency", "Hz", 1e-3),
    "kv": ("voltage", "kV", 1.0),
    "v": ("voltage", "kV", 1e-3),
    "a": ("current", "A", 1.0),
    "amp": ("current", "A", 1.0),
    "amps": ("current", "A", 1.0),
    "ka": ("current", "A", 1e3),
    "mw": ("active power", "MW", 1.0),
    "gw": ("active power", "MW", 1e3),
    "kw": ("active power", "MW", 1e-3),
    "w": ("active power", "MW", 1e-6),
    "mvar": ("reactive power", "Mvar", 1.0),
    "gvar": ("reactive power", "Mvar", 1e3),
    "kvar": ("reactive power", "Mvar", 1e-3),
    "var": ("reactive power", "Mvar", 1e-6),
    "deg": ("voltage angle", "rad", _RAD),
    "degree": ("voltage angle", "rad", _RAD),
    "degrees": ("voltage angle", "rad", _RAD),
    "°": ("voltage angle", "rad", _RAD),
    "rad": ("voltage angle", "rad", 1.0),
    "pu": ("", "pu", 1.0),
    "p.u.": ("", "pu", 1.0),
    "1": ("", "1", 1.0),
    "": ("", "", 1.0),
}
_TIME_UNIT = re.compile(r"(?:^|[\s_.\[(])([a-zµ]+)[\])]?\s*$", re.IGNORECASE)
#: unit of a column of times, in small letters -> s
_SECONDS = {
    **dict.fromkeys(("ns", "nanoseconds"), 1e-9),
    **dict.fromkeys(("us", "µs", "usec", "microseconds"), 1e-6),
    **dict.fromkeys(("ms", "msec", "milliseconds"), 1e-3),
    **dict.fromkeys(("min", "minutes"), 60.0),
    **dict.fromkeys(("h", "hours"), 3600.0),
}
#: kind of measurement in the second row of the IEEE form -> quantity
_IEEE = {
    "F": "frequency",
    "VM": "voltage",
    "VA": "voltage angle",
    "IM": "current",
    "IA": "current angle",
    "P": "active power",
    "Q": "reactive power",
    "STAT": "status",
}
#: our own outputs: pattern of the name -> quantity
_OWN = (
    (r"(?P<at>.+)_dw", "speed"),
    (r"(?P<at>.+)_delta", "rotor angle"),
    (r"(?P<at>.+)_pe", "active power"),
    (r"(?P<at>.+)_vt", "voltage"),
    (r"(?P<at>tie)_p", "active power"),
    (r"(?P<at>bus\d+)\.v", "voltage"),
    (r"(?P<at>bus\d+)\.angle", "voltage angle"),
    (r"(?P<at>branch\[.+\])\.p", "active power"),
    (r"(?P<at>branch\[.+\])\.q", "reactive power"),
    (r"(?P<at>branch\[.+\])\.i", "current"),
)
#: PSS/E: first word of a channel -> quantity, unit here, factor; powers of machines are pu of SBASE
_PSSE = {
    "ANGL": ("rotor angle", "rad", _RAD),
    "POWR": ("active power", "pu", 1.0),
    "VARS": ("reactive power", "pu", 1.0),
    "VOLT": ("voltage", "pu", 1.0),
    "ETRM": ("voltage", "pu", 1.0),
    "VANG": ("voltage angle", "rad", _RAD),
    "FREQ": ("frequency", "pu", 1.0),
    "SPD": ("speed", "pu", 1.0),
}
#: units that a word of a name can be, as in ``VA_deg_bus1``; shorter ones are also names
_UNIT_WORDS = frozenset(unit for unit in _UNITS if len(unit) > 1 and unit not in ("amp", "amps", "var"))
#: two characters or more without a digit in round brackets at the end of a name
_ROUND = re.compile(r"\(\s*([^()\s\d]{2,})\s*\)\s*$")
_PSSE_NAME = re.compile(
    r"\s*(?P<kind>[A-Z]+)\s*(?P<bus>\d+)\s*(?:\[[^\]]*\])?\s*"
    r"(?:TO\s+(?P<to>\d+)\s+CKT\s+'?(?P<circuit>[^' ]+)\s*'?|(?P<id>\S+))?\s*$"
)
#: words of a name, spaces between -> quantity, for tables of other makes; the first that fits
_WORDS = (
    (r"\b(delta|rotor ?ang\w*)\b", "rotor angle"),
    (r"\b(ia|i ?ang\w*|curr\w* ?(phase )?ang\w*)\b", "current angle"),
    (r"\b(va|v ?ang\w*|volt\w* ?ang\w*|theta|ang|angle)\b", "voltage angle"),
    (r"\b(vm|v ?mag\w*|volt\w*|vt|v)\b", "voltage"),
    (r"\b(im|i ?mag\w*|curr\w*|i)\b", "current"),
    (r"\b(f|freq\w*)\b", "frequency"),
    (r"\b(dw|speed|omega)\b", "speed"),
    (r"\b(p|pe|mw|active\w*)\b", "active power"),
    (r"\b(q|mvar|reactive\w*)\b", "reactive power"),
    (r"\b(stat\w*)\b", "status"),
)


@dataclass(frozen=True)
class Raw:
    """A channel as a file has it: value here = `factor` x number there + `offset`."""

    channel: Channel
    factor: float = 1.0
    offset: float = 0.0


def known_unit(unit: str) -> bool:
    """Whether a unit is one that is known here."""
    return unit.strip().casefold() in _UNITS


def known_units() -> str:
    """Return the known units as a message lists them."""
    return ", ".join(sorted(u for u in _UNITS if u not in ("", "1", "°")))


def ieee_channel(terminal: str, kind: str, unit: str) -> Raw:
    """Return the channel of a column of the IEEE form."""
    quantity = _IEEE.get(kind.strip().upper(), "other")
    _, own, factor = _UNITS.get(unit.strip().casefold(), ("", "1", 1.0))
    return Raw(Channel(f"{terminal} {kind.strip()}", quantity, own or "1", terminal), factor)


def own_channel(column: str, unit: str) -> Raw | None:
    """Return the channel of a column ``INSTANCE.VARIABLE`` of a run; None of another name.

    unit : as the run has it, "" where its file has none: rad of angles, else pu.
    """
    instance, dot, variable = column.partition(".")
    if not dot:
        return None
    for pattern, quantity in _OWN:
        if match := re.fullmatch(pattern, variable):
            at = match["at"] if instance == "plant" else f"{instance}.{match['at']}"
            return Raw(Channel(column, quantity, unit or ("rad" if quantity in ANGLES else "pu"), at))
    return Raw(Channel(column, "other", unit or "1", ""))


def psse_channel(name: str, frequency_hz: float) -> Raw | None:
    """Return the channel of a PSS/E name such as ``POWR 101[NUC-A 21.6]1``; None of another name."""
    match = _PSSE_NAME.match(name.strip().strip('"'))
    if match is None or match["kind"] not in _PSSE:
        return None
    quantity, unit, factor = _PSSE[match["kind"]]
    offset, text = 0.0, " ".join(name.strip().strip('"').split())
    if quantity == "frequency":  # pu deviation
        unit, factor, offset = "Hz", frequency_hz, frequency_hz
    if match["to"]:  # flows are MW and Mvar
        terminal = f"{match['bus']}-{match['to']} {match['circuit']}"
        unit = {"active power": "MW", "reactive power": "Mvar"}.get(quantity, unit)
    elif quantity in ("voltage", "voltage angle", "frequency") and match["kind"] != "ETRM":
        terminal = f"bus{match['bus']}"
    else:
        terminal = f"{match['bus']} {match['id'] or '1'}"
    return Raw(Channel(text, quantity, unit, terminal), factor, offset)


def with_square_brackets(names: Sequence[str]) -> list[str]:
    """Return the names of columns with units in square brackets, where round ones hold a unit in one of them.

    >>> with_square_brackets(["P (North)"]), with_square_brackets(["VM (kV)", "P (horses)", "IM (1)"])
    (['P (North)'], ['VM [kV]', 'P [horses]', 'IM (1)'])
    """
    if not any(known_unit(match[1]) for name in names if (match := _ROUND.search(name))):
        return list(names)
    return [_ROUND.sub(r"[\1]", name) for name in names]


def _without_unit(column: str, unit: str) -> tuple[str, str, str]:
    """Return a name without the unit in brackets at its end, its part that is not a unit, and that unit.

    A word in square brackets is a unit even if it is not known; elsewhere it may be something else.
    """
    bracket = re.search(r"[\[(]\s*([^\[\]()\s]*)\s*[\])]\s*$", column)
    if bracket and not unit and (known_unit(bracket[1]) or "[" in bracket[0]):
        column, unit = column[: bracket.start()].strip(), bracket[1]
    words = {word for word in re.split(r"[\s_.:]+", column.casefold()) if word in _UNIT_WORDS}
    if len(words) != 1 or (unit and words != {unit.strip().casefold()}):
        return column, column, unit
    word = words.pop()
    rest = re.sub(rf"(?<![^\s_.:]){re.escape(word)}(?![^\s_.:])", "", column, count=1, flags=re.IGNORECASE)
    return column, rest, unit or word


def other_channel(column: str, unit: str = "", quantity: str = "", terminal: str = "") -> Raw:
    """Return the channel of any column, by its unit and the words of its name, such as ``Bus 7 VM [kV]``."""
    column, rest, unit = _without_unit(column, unit)
    by_unit, own, factor = _UNITS.get(unit.strip().casefold(), ("", unit or "1", 1.0))
    by_word, place = _word(rest) or _word(column) or ("", "")
    fits = not by_unit or by_word == by_unit or (own == "rad" and by_word.endswith("angle"))
    quantity = quantity or (by_word if fits and by_word else by_unit) or "other"
    return Raw(Channel(column, quantity, own or "1", terminal or place), factor)


def _word(name: str) -> tuple[str, str] | None:
    """Return the quantity that a word of a name is, and the rest of the name, its terminal."""
    words = re.sub(r"[_.:]", " ", name).casefold()
    for pattern, quantity in _WORDS:
        if match := re.search(pattern, words):
            rest = name[: match.start()] + name[match.end() :]
            return quantity, re.sub(r"([\s_.:])[\s_.:]+", r"\1", rest).strip(" _.:-")
    return None


def time_unit_s(*cells: str) -> float:
    """Return the unit of a column of times by the cells above it, such as ``Time [ms]``, s.

    >>> time_unit_s("Time (ms)"), time_unit_s("Time", "T", "sec"), time_unit_s("time_min")
    (0.001, 1.0, 60.0)
    """
    words = [match[1].casefold() for cell in cells if (match := _TIME_UNIT.search(cell.strip()))]
    return next((_SECONDS[word] for word in words if word in _SECONDS), 1.0)
