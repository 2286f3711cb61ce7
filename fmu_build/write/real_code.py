"""Write a block as an IEEE/CIGRE DLL, the real-code interface of EMT and RMS tools [CIGRE958].

One library is compiled for each kind of block, platform and size of record. An export copies it and writes
the block's record into the place that the library holds for it: nothing is compiled again.
"""

from __future__ import annotations

import itertools
import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import NamedTuple

import numpy.typing as npt

from interarea.models.blocks.binary_table import pack_record
from interarea.models.blocks.container import CHAIN_KINDS, chain_sources, shown_name
from interarea.models.blocks.variables import Block, Variable
from interarea.models.files import write_whole

from ..errors import BuildError
from .compile import PLATFORMS, Platform, compile_for, platform_of
from .description_xml import integer_range, product_version, record_entries
from .sources import fmi_sources, gather_sources, record_source

_FRONT = Path(__file__).resolve().parents[1] / "c" / "dll" / "real_code.c"
_LAYER = ("fmi2_common", "fmi2_cs", "fmi2_values", "instance", "placement", "solver")
_MARK = b"interarea-record"
_LEAST_ROOM = 1 << 14  #: for a record, bytes
MOST_MEMBERS = 24  #: c/dll/real_code.c
UNBOUNDED = 1e30  #: range of a parameter that has none: tools want a number
_ROLES = ("input", "output", "parameter")
_SAMPLED = ("channel", "pmu")  #: kinds of blocks that step themselves
_ENTRY = re.compile(r"[A-Za-z_]\w*\[\d+,\d+\]")  #: of a matrix

#: Where such a library runs, by name; tools with 32 bits (ATP) take win32.
DLL_PLATFORMS: dict[str, Platform] = {
    **{name: PLATFORMS[name] for name in ("linux64", "win64")},
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


class _Port(NamedTuple):
    """A variable of a member, its name in the DLL, and what the C file reads of it, a Port there."""

    shown: str
    variable: Variable
    integer: bool
    reference: int
    fixed: bool  #: it counts at the start only
    member: int


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
    BuildError : an unknown platform, a sample time that is not positive, a block that is a whole plant, or
        the compiler's message.
    """
    to = platform_of(platform, DLL_PLATFORMS)
    if not 0.0 < sample_time_s < 1e6:
        raise BuildError(f"sample time of a DLL: {sample_time_s:g} s, allowed: above 0, below 1e6")
    path = Path(path)
    if path.is_dir():
        path = path / f"{block.name}{to.suffix}"
    record = pack_record(entries_of(block, sample_time_s))
    sources = dll_sources(chain_sources() if isinstance(block, Chain) else block.sources, len(record))
    library = compile_for(f"{block.kind}-dll", sources, to, cache=cache)
    return write_whole(path, completed(library.read_bytes(), record))


def completed(library: bytes, record: bytes) -> bytes:
    """Return a library with the record in its place.

    Raises
    ------
    BuildError : no such place, or two.
    """
    head, mark, rest = library.partition(_MARK)
    if not mark or _MARK in rest:
        raise BuildError("the compiled library does not have one place for a record; clear the cache")
    return head + mark + record + rest[len(record) :]


def dll_sources(block: Sequence[Path], record_size: int) -> dict[str, bytes]:
    """Return the C files of the library, flat, with room for a record of that many bytes.

    The functions of FMI are called inside only: a library that exported them could be given those of another.
    """
    room = max(_LEAST_ROOM, 1 << (record_size - 1).bit_length())
    layer = tuple(p for p in fmi_sources() if p.stem in _LAYER)
    sources = gather_sources((*layer, _FRONT, *block, record_source()))
    sources[_FRONT.name] = b"#define CAPACITY %d\n" % room + sources[_FRONT.name]
    if "chain.h" in sources:
        sources["instance.h"] = b'#include "chain.h"\n' + sources["instance.h"]
    header = sources["fmi2Functions.h"]
    sources["fmi2Functions.h"] = header.replace(b"FMI2_Export fmi2", b"fmi2")
    if sources["fmi2Functions.h"] == header:
        raise BuildError("fmi2Functions.h of fmpy declares no function with FMI2_Export; reinstall fmpy")
    return sources


def port_name(name: str) -> str:
    """Return the C identifier that stands for the name of a variable.

    >>> port_name("outage[1].start")
    'outage_1_start'
    """
    return re.sub(r"\W+", "_", name, flags=re.ASCII).strip("_")


def _ports(chain: Chain, alone: bool) -> dict[str, _Port]:
    """Return inputs, outputs and parameters of the members by "member.name"; `alone`: those keep their names.

    The entries of matrices are no parameters: they are the design.
    """
    ports = {}
    for k, (member, block) in enumerate(chain.members.items()):
        for v in block.table:
            name, parameter = f"{member}.{v.name}", v.role == "parameter"
            if v.role in _ROLES and not (parameter and _ENTRY.fullmatch(v.name)):
                shown = v.name if alone else name if parameter else shown_name(member, block.kind, v)
                reference = block.table.value_reference(v.name)
                ports[name] = _Port(shown, v, v.type != "Real", reference, parameter and not v.tunable, k)
    return ports


def _wires(chain: Chain, ports: Mapping[str, _Port]) -> Iterator[tuple[tuple[int, ...], ...]]:
    """Give the ports, from and to, of each connection.

    Raises
    ------
    BuildError : an end that does not exist or is fed twice, one that leads backwards, or ports of two types.
    """
    fed = [target for _, target in chain.connections]
    for connection in chain.connections:
        where = f"{chain.name}: {' -> '.join(connection)}"
        for end, role in zip(connection, ("output", "input"), strict=True):
            if end not in ports or ports[end].variable.role != role:
                raise BuildError(f"{where}: {end} is no {role} of a member")
        source, target = (ports[end] for end in connection)
        if not (source.member < target.member and source.integer == target.integer):
            raise BuildError(f"{where} leads backwards or joins two types, allowed: to a later member")
        if fed.count(connection[1]) > 1:
            raise BuildError(f"{chain.name}: {connection[1]} is fed twice, allowed: by one output")
        yield source[2:], target[2:]


def _check(block: Block | Chain, chain: Chain, groups: Iterable[Sequence[_Port]]) -> None:
    kinds = [b.kind for b in chain.members.values()]
    strange = set(kinds) - set(CHAIN_KINDS) if chain is block else {"plant"} & set(kinds)
    if strange or not 1 <= len(kinds) <= MOST_MEMBERS:
        raise BuildError(
            f"{block.name} is a {block.kind} of {', '.join(kinds) or 'nothing'}, allowed for a DLL: "
            f"a controller, supervisor, channel, PMU, or 1 to {MOST_MEMBERS} of them in a chain"
        )
    for group in groups:
        names = [port_name(p.shown) for p in group]
        if len(set(names)) != len(names) or not all(map(str.isidentifier, names)):
            raise BuildError(f"{block.name}: {names} are no different C identifiers; rename the variables")


def entries_of(block: Block | Chain, sample_time_s: float) -> dict[str, npt.ArrayLike | bytes]:
    """Return the record: what Model_GetInfo tells, and the records of the members (c/dll/real_code.c)."""
    chain = block if isinstance(block, Chain) else Chain(block.name, {block.name: block})
    ports, fed = _ports(chain, alone=chain is not block), {target for _, target in chain.connections}
    shown = [p for name, p in ports.items() if name not in fed]  # what a connection feeds is no input
    groups = [[p for p in shown if p.variable.role == role] for role in _ROLES]
    _check(block, chain, groups)
    inputs, outputs, parameters = groups
    of_tool = (((0, k, 0, -1), p[2:]) for k, p in enumerate(inputs))  # member -1: the tool
    entries: dict[str, npt.ArrayLike | bytes] = {
        "dll.counts": [*map(len, groups), len(chain.members)],
        "dll.ports": [p[2:] for p in (*outputs, *parameters)],
        "dll.feeds": [*of_tool, *_wires(chain, ports)],
        "dll.range": [float(sample_time_s), *(x for p in parameters for x in _range(p.variable))],
        "dll.text": b"".join(text.encode() + b"\0" for text in _texts(block, groups)),
    }
    for k, b in enumerate(chain.members.values()):
        record = record_entries(b)
        if chain is block:  # whose C takes members of several kinds
            record |= {"member.kind": [CHAIN_KINDS.index(b.kind)], "sampled": [int(b.kind in _SAMPLED)]}
        entries[f"member.{k}.record"] = pack_record(record)
    return entries


def _range(v: Variable) -> tuple[float, float, float]:
    """Default, least and greatest value."""
    low, high = (v.min, v.max) if v.type == "Real" else (0, 1) if v.type == "Boolean" else integer_range(v)
    return v.start or 0, -UNBOUNDED if low is None else low, UNBOUNDED if high is None else high


def _texts(block: Block | Chain, groups: Iterable[Sequence[_Port]]) -> Iterator[str]:
    """Texts in the order in which c/dll/real_code.c reads them."""
    general = {"generated by": f"interarea {product_version()}", **block.provenance}
    yield from (block.name, product_version(), block.description)
    yield "; ".join(f"{key}: {value}" for key, value in general.items())
    for shown, v, *_ in itertools.chain(*groups):
        items = () if v.enumeration is None else v.enumeration.items
        numbers = ": " + ", ".join(f"{value} {item}" for item, value, _ in items) if items else ""
        yield port_name(shown)
        if v.role == "parameter":
            yield re.split(r"[\[.]", shown)[0] if re.search(r"[\[.]", shown) else "general"
        yield from (v.description + numbers, v.unit)
