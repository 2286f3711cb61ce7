"""Write a block as an IEEE/CIGRE DLL, the real-code interface of EMT and RMS tools [CIGRE958].

One library is compiled for each kind of block, platform and size of record. An export copies it and writes
the block's record into the place that the library holds for it: nothing is compiled again.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import numpy.typing as npt

from interarea.models.blocks.binary_table import pack_record
from interarea.models.blocks.container import CHAIN_KINDS, chain_sources, shown_name
from interarea.models.blocks.variables import Block, Role, Variable
from interarea.models.files import write_whole

from ..errors import BuildError
from .compile import PLATFORMS, Platform, compile_for
from .description_xml import integer_range, product_version, record_entries
from .sources import fmi_sources, gather_sources, record_source

_C = Path(__file__).resolve().parents[1] / "c"
_FRONT = (_C / "dll" / "real_code.c", _C / "dll" / "real_code_data.c")
_LAYER = ("fmi2_common", "fmi2_cs", "fmi2_values", "instance", "placement", "solver")
_MARK = b"interarea-record"
_LEAST_ROOM = 1 << 14
MOST_MEMBERS, MOST_SIGNALS, MOST_PARAMETERS = 24, 256, 1024  #: c/dll/real_code.c
UNBOUNDED = 1e30  #: range of a parameter that has none: tools want a number

#: Where such a library runs, by name; tools with 32 bits (ATP) take win32.
DLL_PLATFORMS: dict[str, Platform] = {
    "linux64": PLATFORMS["linux64"],
    "win64": PLATFORMS["win64"],
    "win32": Platform("win32", "win32", ("x86-windows-gnu",), ".dll", (), ("-Wl,-s",)),
}


@dataclass(frozen=True)
class Chain:
    """Blocks that one DLL calls one after the other: PMUs and channels before the controllers that they feed.

    members : by name, in the order of the calls. connections : ("member.output", "member.input"), forwards.
    Controllers' ports keep their names, those of the others and all parameters go behind the member's.
    """

    name: str
    members: Mapping[str, Block]
    connections: Sequence[tuple[str, str]] = ()
    description: str = ""
    provenance: Mapping[str, str] = field(default_factory=dict)
    kind = "chain"


@dataclass(frozen=True)
class _Port:
    """A variable that the DLL shows, the name it has there, and the number of its member."""

    member: int
    shown: str
    variable: Variable


def build_dll(
    block: Block | Chain,
    path: Path | str,
    *,
    platform: str,
    sample_time_s: float = 0.001,
    cache: Path | None = None,
) -> Path:
    """Write a block or a chain of them as an IEEE/CIGRE DLL; return its path.

    Parameters
    ----------
    path : the file to write, or an existing folder to write ``NAME.dll`` (linux64: ``NAME.so``) into.
    platform : a key of `DLL_PLATFORMS`.
    sample_time_s : interval at which the tool calls the block, s.
    cache : folder of compiled libraries; default ``$INTERAREA_CACHE``, else the user's cache folder.

    Raises
    ------
    BuildError : an unknown platform, a sample time that is not positive, a block that is a whole plant or has
        more ports than the interface's tables hold, or the compiler's message.
    """
    suffix = suffix_of(platform)
    if not 0.0 < sample_time_s < 1e6:
        raise BuildError(f"sample time of a DLL: {sample_time_s:g} s, allowed: above 0")
    to, path = DLL_PLATFORMS[platform], Path(path)
    if path.is_dir():
        path = path / f"{block.name}{suffix}"
    record = pack_record(entries_of(block, sample_time_s))
    sources = chain_sources() if isinstance(block, Chain) else block.sources
    library = compile_for(
        f"{block.kind}-dll", dll_sources(sources, len(record)), to, cache=cache
    ).read_bytes()
    return write_whole(path, completed(library, record))


def suffix_of(platform: str) -> str:
    """Return what the name of a DLL for `platform` ends in.

    Raises
    ------
    BuildError : an unknown platform.
    """
    if platform not in DLL_PLATFORMS:
        raise BuildError(f"unknown platform of a DLL {platform!r}; allowed: {', '.join(DLL_PLATFORMS)}")
    return DLL_PLATFORMS[platform].suffix


def completed(library: bytes, record: bytes) -> bytes:
    """Return a library with the record in its place.

    Raises
    ------
    BuildError : no such place, or two.
    """
    if library.count(_MARK) != 1:
        raise BuildError(f"the library has {library.count(_MARK)} places for a record, wanted: 1")
    begin = library.index(_MARK) + len(_MARK)
    return library[:begin] + record + library[begin + len(record) :]


def dll_sources(block: Sequence[Path], record_size: int) -> dict[str, bytes]:
    """Return the C files of the library, flat, with room for a record of that many bytes.

    The functions of FMI are called inside only: a library that exported them could be given those of another.
    """
    room = _LEAST_ROOM
    while room < record_size:
        room *= 2
    layer = tuple(p for p in fmi_sources() if p.stem in _LAYER)
    size = _C / "dll" / "real_code_size.h"
    sources = gather_sources((*layer, *_FRONT, *block, record_source()))
    sources[size.name] = sources[size.name].replace(b"16384", str(room).encode())
    if any(path.name == "chain.c" for path in block):  # whose members are of both kinds
        sources["instance.h"] = b"#define RECORDS_SAY_SAMPLED\n" + sources["instance.h"]
    name = "fmi2Functions.h"
    sources[name], count = re.subn(rb"(#\s*define FMI2_Export).*", rb"\1", sources[name])
    if count < 1:
        raise BuildError("fmi2Functions.h of fmpy does not define FMI2_Export; reinstall fmpy")
    return sources


def port_name(name: str) -> str:
    """Return the C identifier that stands for the name of a variable.

    >>> port_name("outage[1].start")
    'outage_1_start'
    """
    return re.sub(r"\W+", "_", name, flags=re.ASCII).strip("_")


def parameters_of(block: Block) -> list[Variable]:
    """Return the parameters that a tool's user sees: not the entries of matrices, which are the design."""
    parameters = _of_role(block, "parameter")
    return [v for v in parameters if not re.fullmatch(r"[A-Za-z_]\w*\[\d+,\d+\]", v.name)]


def _of_role(block: Block, role: Role) -> list[Variable]:
    return [*block.table.of_role(role), *block.table.of_role(role, integers=True)]


def _ports(block: Block | Chain) -> list[list[_Port]]:
    """Inputs, outputs and parameters that the DLL shows; what a connection feeds is no input."""
    exposed: dict[Role, list[_Port]] = {"input": [], "output": [], "parameter": []}
    chain = _as_chain(block)
    fed = {target for _, target in chain.connections}
    for k, (name, b) in enumerate(chain.members.items()):
        for role, ports in exposed.items():
            variables = parameters_of(b) if role == "parameter" else _of_role(b, role)
            for v in variables:
                if f"{name}.{v.name}" not in fed:
                    ports.append(_Port(k, _name_in_chain(name, b, v) if chain is block else v.name, v))
    return list(exposed.values())


def _name_in_chain(member: str, block: Block, v: Variable) -> str:
    if v.role == "parameter":
        return f"{member}.{v.name}"
    return shown_name(member, "controller" if block.kind in ("controller", "supervisor") else "channel", v)


def _as_chain(block: Block | Chain) -> Chain:
    return block if isinstance(block, Chain) else Chain(block.name, {block.name: block})


def _wires(chain: Chain) -> list[tuple[int, int, int, int, int]]:
    """Of each connection: whether it is of integers, member and value reference at both ends.

    Raises
    ------
    BuildError : an end that does not exist, one that leads backwards, or ports of two types.
    """
    numbers, rows = {name: k for k, name in enumerate(chain.members)}, []
    for source, target in chain.connections:
        ends = []
        for end, role in ((source, "output"), (target, "input")):
            member, _, port = end.partition(".")
            table = chain.members[member].table if member in chain.members else ()
            v = next((v for v in table if v.name == port and v.role == role), None)
            if v is None:
                raise BuildError(f"{chain.name}: {source} -> {target}: {end} is no {role} of a member")
            ends.append(
                (numbers[member], chain.members[member].table.value_reference(port), v.type != "Real")
            )
        if not (ends[0][0] < ends[1][0] and ends[0][2] == ends[1][2]):
            raise BuildError(
                f"{chain.name}: {source} -> {target} leads backwards or joins two types, allowed: "
                "from a member to a later one"
            )
        rows.append((int(ends[0][2]), *ends[0][:2], *ends[1][:2]))
    return rows


def _check(block: Block | Chain, groups: Sequence[list[_Port]]) -> None:
    inputs, outputs, parameters = groups
    members = _as_chain(block).members
    kinds = [b.kind for b in members.values()]
    strange = set(kinds) - set(CHAIN_KINDS) if isinstance(block, Chain) else {"plant"} & set(kinds)
    if strange or not 1 <= len(members) <= MOST_MEMBERS or max(len(inputs), len(outputs)) > MOST_SIGNALS:
        raise BuildError(
            f"{block.name} is a {block.kind} of {', '.join(kinds)} with {len(inputs)} inputs and "
            f"{len(outputs)} outputs, allowed for a DLL: a controller, supervisor, channel, PMU, or 1 to "
            f"{MOST_MEMBERS} of them in a chain, with at most {MOST_SIGNALS} each"
        )
    if len(parameters) > MOST_PARAMETERS:
        raise BuildError(
            f"{block.name} has {len(parameters)} parameters; a DLL has at most {MOST_PARAMETERS}"
        )
    for group in groups:
        names = [port_name(p.shown) for p in group]
        if len(set(names)) != len(names) or not all(re.fullmatch(r"[A-Za-z_]\w*", n) for n in names):
            raise BuildError(
                f"{block.name}: names {names} are no different C identifiers; rename the variables"
            )


def entries_of(block: Block | Chain, sample_time_s: float) -> dict[str, npt.ArrayLike | bytes]:
    """Return the record: what Model_GetInfo tells, and the records of the members (c/dll/real_code.c)."""
    groups = _ports(block)
    _check(block, groups)
    chain = _as_chain(block)
    tables = [b.table for b in chain.members.values()]
    ports = [
        (p.variable.type != "Real", tables[p.member].value_reference(p.variable.name),
         p.variable.role == "parameter" and not p.variable.tunable, p.member)
        for group in groups for p in group
    ]  # fmt: skip
    entries: dict[str, npt.ArrayLike | bytes] = {
        "dll.counts": np.array([*map(len, groups), len(tables)], dtype=np.int32),
        "dll.ports": np.array(ports, dtype=np.int32),
        "dll.wires": np.array(_wires(chain), dtype=np.int32),
        "dll.range": np.array([sample_time_s, *(x for p in groups[2] for x in _range(p.variable))]),
        "dll.text": b"".join(text.encode() + b"\0" for text in _texts(block, groups)),
    }
    for k, b in enumerate(chain.members.values()):
        own: dict[str, npt.ArrayLike | bytes] = {}
        if chain is block:
            own["member.kind"] = np.array([CHAIN_KINDS.index(b.kind)], dtype=np.int32)
            own["sampled"] = np.array([b.kind in ("channel", "pmu")], dtype=np.int32)
        entries[f"member.{k}.record"] = pack_record(record_entries(b) | own)
    return entries


def _range(v: Variable) -> tuple[float, float, float]:
    """Default, least and greatest value."""
    start = float(v.start or 0)
    if v.type == "Boolean":
        return start, 0.0, 1.0
    low, high = (v.min, v.max) if v.type == "Real" else integer_range(v)
    return start, float(-UNBOUNDED if low is None else low), float(UNBOUNDED if high is None else high)


def _texts(block: Block | Chain, groups: Sequence[list[_Port]]) -> Iterator[str]:
    """Texts in the order in which c/dll/real_code.c reads them."""
    general = {"generated by": f"interarea {product_version()}", **block.provenance}
    yield from (block.name, product_version(), block.description)
    yield "; ".join(f"{key}: {value}" for key, value in general.items())
    yield from ("", "interarea", "", "interarea", "", "")
    for p in (*groups[0], *groups[1]):
        yield from (port_name(p.shown), _meaning(p.variable), p.variable.unit)
    for p in groups[2]:
        group = p.shown.split("[")[0].split(".")[0] if re.search(r"[\[.]", p.shown) else "general"
        yield from (port_name(p.shown), group, _meaning(p.variable), p.variable.unit)


def _meaning(v: Variable) -> str:
    """Description of a variable, with what the numbers of an enumeration stand for."""
    if v.enumeration is None:
        return v.description
    return f"{v.description}: " + ", ".join(f"{value} {item}" for item, value, _ in v.enumeration.items)
