"""A plant, its controller and the channels between them as one block (c/container/closed_loop.h)."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import numpy.typing as npt

from .channel import channel_block
from .plant import plant_sources
from .variables import STEP_PARAMETER, Block, Role, Variable, VariableTable

_C_FOLDER = Path(__file__).resolve().parents[1] / "c"
_KINDS_INSIDE = ("plant", "controller", "channel", "supervisor")
_OWN = ("container", "closed_loop_step", *(f"{kind}_member" for kind in _KINDS_INSIDE))
_KINDS = {kind: number for number, kind in enumerate(_KINDS_INSIDE)}  #: as closed_loop.h counts
_MOST = 24  #: LOOP_MEMBERS of closed_loop.h
#: What feeds what; anything else would need an order of evaluation that closed_loop.h does not promise.
_MAY_FEED = {
    *((source, target) for source in ("plant", "channel") for target in ("controller", "supervisor")),
    *((source, "plant") for source in ("controller", "supervisor")),
    ("plant", "channel"),
}


def container_sources(plant: Iterable[Path] | None = None) -> tuple[Path, ...]:
    """Return the C files of every container: its own, and of the members' those no `*_member.c` includes.

    plant : sources of the plant inside; default `plant_sources()`.
    """
    return (
        *(_C_FOLDER / f"container/{name}.c" for name in _OWN),
        *(p for p in (plant_sources() if plant is None else plant) if p.name not in ("plant.c", "record.c")),
        *(p for p in channel_block().sources if p.name != "channel.c"),
    )


#: Kinds of the members of a chain, as chain.h counts them.
CHAIN_KINDS = ("controller", "supervisor", "channel", "pmu")


def chain_sources() -> tuple[Path, ...]:
    """Return the C files, and the header, of a chain: members one after the other, without a plant."""
    parts = ("chain.h", *(f"{kind}_member.c" for kind in CHAIN_KINDS))
    return (
        *(_C_FOLDER / "container" / name for name in parts),
        *(p for p in channel_block().sources if p.name != "channel.c"),
    )


@dataclass(frozen=True)
class LoopMember:
    """One member: its name in the loop, its block with the start values it shall have, its packed record."""

    name: str
    block: Block
    record: bytes


def _solver_step(members: Sequence[LoopMember]) -> tuple[int, float]:
    """Return which of all parameters is the plant's longest step, and its start value, s."""
    parameters = [v for m in members for v in m.block.table.of_role("parameter")]
    place = next(k for k, v in enumerate(parameters) if v.name == STEP_PARAMETER)
    return place, float(parameters[place].start or 0.0)


def loop_block(
    name: str,
    members: Sequence[LoopMember],
    connections: Iterable[tuple[str, str]],
    *,
    step_s: float,
    stop_s: float,
    description: str = "",
    documentation: Mapping[str, str] | None = None,
    provenance: Mapping[str, str] | None = None,
) -> Block:
    """Return the closed loop of `members` as a block that simulates by itself.

    Outputs keep their names (`G1_dw`, `G4_vs`), those of a channel go behind its
    name (`remote_y`); parameters are `MEMBER.NAME`. Plant and controller are
    integrated as one system; a channel delays by its latency, no more and no less. Who sets the plant's
    `solver.step` longer than it starts makes the controllers' longest step so many times longer too, at most
    five times: half of their fastest time constant.

    Parameters
    ----------
    name : model name, a C identifier.
    members : one plant, and controllers and channels, in any order.
    connections : pairs ("member.output", "member.input").
    step_s : inner communication step, s; also that of the DefaultExperiment.

    Raises
    ------
    ValueError : a kind of block or a connection that a loop cannot hold, an input fed twice, a name taken.
    """
    by_name = {m.name: m for m in members}
    _check(name, members, by_name)
    pairs = list(connections)
    _check_pairs(name, pairs, by_name)
    controllers = [m.block.longest_step_s for m in members if m.block.kind not in ("plant", "channel")]
    own_step, step_of_plant = _solver_step(members)
    integrated = min([*controllers, step_of_plant])
    data: dict[str, npt.NDArray[np.float64] | npt.NDArray[np.int32] | bytes] = {
        "loop.kinds": np.array([_KINDS[m.block.kind] for m in members], dtype=np.int32),
        "loop.wire": _wires(members, pairs, integers=False),
        "loop.flag": _wires(members, pairs, integers=True),
        "loop.step": np.array([step_s]),
        "loop.internal": np.array([min(controllers, default=1.0)]),
        "loop.solver": np.array([own_step], dtype=np.int32),
        **{f"member.{k}.record": m.record for k, m in enumerate(members)},
    }
    return Block(
        kind="loop",
        name=name,
        description=description or f"Closed loop of {', '.join(m.name for m in members)}",
        table=VariableTable([v for m in members for v in _outside(m)]),
        data=data,
        sources=container_sources(next(m.block.sources for m in members if m.block.kind == "plant")),
        step_s=step_s,
        stop_s=stop_s,
        internal_step_s=integrated,
        model_exchange=False,
        documentation={"Behaviour": _BEHAVIOUR, **(documentation or {})},
        provenance=dict(provenance or {}),
    )


def _wires(
    members: Sequence[LoopMember], pairs: Sequence[tuple[str, str]], *, integers: bool
) -> npt.NDArray[np.int32]:
    """Per Real (or integer) input of all members: the number of the output that feeds it, or -1."""

    def ports(role: Role) -> list[str]:
        return [f"{m.name}.{v.name}" for m in members for v in m.block.table.of_role(role, integers=integers)]

    place = {port: k for k, port in enumerate(ports("output"))}
    feeds = {target: place[source] for source, target in pairs if source in place}
    return np.array([feeds.get(port, -1) for port in ports("input")], dtype=np.int32)


def _check(name: str, members: Sequence[LoopMember], by_name: Mapping[str, LoopMember]) -> None:
    if len(by_name) != len(members) or not 0 < len(members) <= _MOST:
        raise ValueError(f"loop {name}: {len(members)} members, allowed: 1 to {_MOST}, named apart")
    for m in members:
        if m.block.kind not in _KINDS:
            raise ValueError(
                f"loop {name}: member {m.name} is a {m.block.kind}, allowed: {', '.join(_KINDS)}; "
                "write an SSP for tools that connect FMUs"
            )
    plants = [m.name for m in members if m.block.kind == "plant"]
    if len(plants) != 1:
        raise ValueError(f"loop {name}: plants {plants}, allowed: one")


def _check_pairs(name: str, pairs: Sequence[tuple[str, str]], by_name: Mapping[str, LoopMember]) -> None:
    fed = set()
    for source, target in pairs:
        blocks = [by_name[end.partition(".")[0]].block for end in (source, target)]
        kinds = (blocks[0].kind, blocks[1].kind)
        variables = [b.table[end.partition(".")[2]] for b, end in zip(blocks, (source, target), strict=True)]
        if kinds not in _MAY_FEED or variables[0].type != variables[1].type:
            raise ValueError(f"loop {name}: {source} -> {target} ({' -> '.join(kinds)}) is not possible")
        if target in fed:
            raise ValueError(f"loop {name}: {target} is fed twice")
        fed.add(target)


def shown_name(member: str, kind: str, output: Variable) -> str:
    """Return what a loop calls an output of a member of that kind, and a chain an input or output."""
    own = kind in ("channel", "pmu") or output.type != "Real"
    return f"{member}_{output.name}" if own else output.name


def _outside(member: LoopMember) -> list[Variable]:
    """The variables of a member that the loop shows: outputs, which depend on nothing, and parameters."""
    variables = []
    for v in member.block.table:
        if v.role == "output":
            variables.append(replace(v, name=shown_name(member.name, member.block.kind, v), depends_on=()))
        elif v.role == "parameter":
            variables.append(replace(v, name=f"{member.name}.{v.name}"))
    return variables


_BEHAVIOUR = """<p>A closed loop without inputs. Plant and controller are one system of differential
equations, integrated together: between them there is no delay. A channel gives y(t) = u(t &minus; latency),
no more and no less, whatever communication step the tool takes; between inner communication points it is the
cubic through values and slopes at both ends. Events, outages and their echoes through the channels are inner
communication points.</p>"""
