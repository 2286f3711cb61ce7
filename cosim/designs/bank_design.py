"""A bank as a design: its members, each a separate design, and the proof for every sequence of losses."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import control

from interarea.design.certificates.signal_margins import signal_margins
from interarea.design.certificates.switching import (
    BankLoop,
    SwitchingCertificate,
    proven_decay,
    switching_certificate,
)
from interarea.design.controllers.bank import ControllerBank
from interarea.design.controllers.controller import plain
from interarea.design.linear.linearise import speeds_in_rad
from interarea.design.robust.operating_points import FamilyRow, inter_area_band, judge_family
from interarea.design.robust.signal_worth import SignalWorth, own_signals, signal_worth

from ..errors import ScenarioError
from .design_file import DESIGN_STEPS, DesignTable, design_record, run_design
from .design_tables import MemberTable, PartTable
from .family import family_plants
from .worth import clearing_change

ALL = "all"  #: the member that sees all signals
PROOF = "proof of switching"  #: the last step of `run_bank_design`


def member_tables(table: DesignTable) -> dict[str, DesignTable]:
    """Return member -> its design, that of all signals first. The supervisor has the guard.

    Raises
    ------
    ScenarioError : an actuator with none of a member's signals, or conditions of other signals.
    """
    assert table.bank is not None
    whole = table.model_copy(update={"bank": None, "guard": None})
    return {ALL: whole} | {each.name: _member_table(table, each) for each in table.bank.member}


def _member_table(table: DesignTable, member: MemberTable) -> DesignTable:
    sees = {part.actuator: part.signals for part in table.part}
    sees = sees or dict.fromkeys(table.actuators, table.signals)
    parts = []
    for actuator, signals in sees.items():
        seen = tuple(s for s in signals if s in member.signals)
        if not seen:
            raise ScenarioError(
                f"design {table.name}: bank member {member.name} leaves {actuator} without a signal; "
                f"allowed: {', '.join(signals)}"
            )
        parts.append(PartTable(actuator=actuator, signals=seen, order=member.order))
    left_out = {
        "remote",
        "local",
        "actuator",
        "part",
        "order",
        "bank",
        "target",
        "effort_under",
        "start_from",
        "guard",
        *(() if member.first_swing else ("first_swing",)),
    }
    keys: dict[str, Any] = table.model_dump(exclude=left_out, exclude_unset=True)
    for stage in keys.get("stage", ()):
        stage.pop("conditions", None)
    keys |= {
        "name": member.name,
        "part": parts,
        "conditions": member.conditions,
        "starts": max(table.starts, 1),
    }
    if table.acceptance is not None:
        keys["acceptance"] = table.acceptance.of(member.signals)
    keys["gain_of"] = {s: gain for s, gain in table.gain_of.items() if s in member.signals}
    keys["ask"] = table.ask.model_copy(
        update={"worst_swing": member.worst_swing, "inter_area": member.inter_area}
    )
    keys |= {key: getattr(member, key) for key in ("offset", "effort_cap") if getattr(member, key)}
    try:
        member_table = DesignTable.model_validate(keys)
        member_table.spec()
    except ValueError as error:
        raise ScenarioError(f"design {table.name}: bank member {member.name}: {error}") from error
    member_table._grid = table._grid
    return member_table


def bank_steps(table: DesignTable) -> tuple[str, ...]:
    """Return the names of the steps of `run_bank_design`."""
    return (*(f"{name}: {step}" for name in member_tables(table) for step in DESIGN_STEPS), PROOF)


def run_bank_design(
    table: DesignTable,
    cache: Path,
    *,
    progress: Callable[[str, float, str], object] = lambda step, share, text: None,
) -> tuple[ControllerBank, tuple[str, ...]]:
    """Design every member of a bank; return the bank with its proof, and the requirements that members miss.

    progress : called with one of `bank_steps`, its completed share, and the present result in words.

    Raises
    ------
    InfeasibleDesign, ScenarioError : as `run_design`. UncertifiedDesign : a loop that a loss makes unstable.
    """
    assert table.bank is not None
    members, missed = [], []
    for name, each in member_tables(table).items():

        def report(step: str, share: float, text: str, who: str = name) -> None:
            progress(f"{who}: {step}", share, text)

        designed = run_design(each, cache, progress=report).controller
        missed += [f"{name}: {line}" for line in (designed.certificate or {})["violations"]]
        members.append(replace(designed, name=name, design={}, certificate=None))
    times = table.bank.model_dump(exclude={"member"})
    guard = None if table.guard is None else table.guard.guard()
    bank = ControllerBank(table.name, tuple(members), table.limit_pu, **times, guard=guard)
    progress(PROOF, 0.0, "")
    bank = proven(table, bank, cache)
    progress(PROOF, 1.0, "")
    return bank, tuple(missed)


def proven(table: DesignTable, bank: ControllerBank, cache: Path) -> ControllerBank:
    """Return a bank with its switching proven on the first operating point, and the design in its record."""
    plant = bank_plants(table, cache)[table.point[0].name]
    switching, P = switching_certificate(plant, bank)
    design = {"method": "bank of robust controllers, one for each set of signals"}
    return replace(
        bank,
        design={**design, "specification": design_record(table)},
        certificate=plain(switching.as_dict()),
        lyapunov=P,
    )


def bank_plants(table: DesignTable, cache: Path) -> dict[str, control.StateSpace]:
    """Return operating point -> full dense plant without reference angle, speeds in rad/s.

    Raises
    ------
    ScenarioError : a grid too large for it.
    """
    plants = {}
    for name, each in family_plants(table, cache).items():
        if each.small is None:
            raise ScenarioError(
                f"{table.grid.name}: {each.blocks.nstates} states are too many for a switching proof"
            )
        plants[name] = speeds_in_rad(each.small, each.case.omega_b)
    return plants


def bank_worth(
    table: DesignTable, bank: ControllerBank, cache: Path, *, clearing: bool = False
) -> SignalWorth:
    """Return the value of the remote signals, compared with the member that uses the own machines' signals
    alone.

    clearing : clearing times of the design's acceptance too, of that member behind the guard of the bank.
    """
    plants = family_plants(table, cache)
    own = {s for signals in own_signals(bank.outputs, bank.inputs).values() for s in signals}
    alone = next((m for m in bank.members if set(m.inputs) <= own), None)
    worth = signal_worth(
        {name: each.judged for name, each in plants.items()},
        bank.acting(()).system,
        table.family(),
        None if alone is None else alone.system,
        bands_hz={name: inter_area_band(each.modes) for name, each in plants.items()},
    )
    if not clearing or table.acceptance is None or alone is None:
        return worth
    watched = None if table.guard is None else table.guard.of(set(alone.inputs))
    guard = None if watched is None else watched.guard()
    guarded = replace(alone, limit_pu=bank.limit_pu, guard=guard)
    return worth.with_clearing(clearing_change(table, bank, cache), clearing_change(table, guarded, cache))


def bank_margins(table: DesignTable, bank: ControllerBank, cache: Path) -> tuple[dict[str, Any], ...]:
    """Return the margins of each signal, as `SignalMargin.as_dict`, with no signal lost."""
    plants = {name: each.judged for name, each in family_plants(table, cache).items()}
    return tuple(margin.as_dict() for margin in signal_margins(plants, bank.acting(()).system))


def judged_bank(
    table: DesignTable,
    bank: ControllerBank,
    switching: SwitchingCertificate,
    worth: SignalWorth,
    margins: Sequence[Mapping[str, Any]],
    faults: Mapping[str, Any] | None,
) -> ControllerBank:
    """Return a bank with its design and certificate in its record."""
    record = {**switching.as_dict(), "worth": worth.as_dict(), "margins": margins, "acceptance": faults}
    design = {**bank.design, "specification": design_record(table)}
    return replace(bank, design=design, certificate=plain(record))


def judge_bank(table: DesignTable, bank: ControllerBank, cache: Path) -> list[FamilyRow]:
    """Evaluate, at every operating point, the member that acts under each condition of the design.

    A condition with a lost signal is evaluated with the member that acts then, and, under the same name
    followed by "unnoticed", with the member that acts until the loss is flagged.
    """
    plants = family_plants(table, cache)
    rows: list[FamilyRow] = []
    for condition in table.family():
        acting = [(condition.name, bank.acting(condition.lost))]
        if condition.lost:
            acting.append((f"{condition.name}, unnoticed", bank.acting(())))
        for name, K in acting:
            gone = tuple(s for s in condition.lost if s in K.inputs)
            late = {s: t for s, t in condition.latency_s_of.items() if s in K.inputs}
            judged = judge_family(
                {point: each.judged for point, each in plants.items()},
                K.system,
                [replace(condition, name=name, lost=gone, latency_s_of=late)],
                bands_hz={point: inter_area_band(each.modes) for point, each in plants.items()},
            )
            rows += judged.rows
    return rows


def certify_bank(plant: control.StateSpace, bank: ControllerBank) -> SwitchingCertificate:
    """Return the switching certificate of a bank on a full plant (speeds in rad/s).

    The Lyapunov matrix of the bank is verified; a new one is searched if it has none or its own proves
    nothing for this plant.
    """
    loop = BankLoop(plant, bank)
    P = bank.lyapunov
    if P is not None and P.shape == (loop.order, loop.order):
        corners = loop.corners()
        rate = proven_decay(corners, P)
        if rate > 0.0:
            return SwitchingCertificate.of_common(corners, P, rate)
    return switching_certificate(plant, bank)[0]
