"""Write a block as an IEEE/CIGRE DLL, the real-code interface of EMT and RMS tools [CIGRE958].

One library is compiled for each kind of block, platform and size of record. An export copies it and writes
the block's record into the place that the library holds for it: nothing is compiled again.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import NamedTuple

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
_FRONT = _C / "dll" / "real_code.c"
_LAYER = ("fmi2_common", "fmi2_cs", "fmi2_values", "instance", "placement", "solver")
_MARK = b"interarea-record"
_LEAST_ROOM = 1 << 14  #: bytes, CAPACITY of c/dll/real_code.c
MOST_MEMBERS, MOST_SIGNALS, MOST_PARAMETERS = 24, 512, 1024  #: c/dll/real_code.c
UNBOUNDED = 1e30  #: range of a parameter that has none: tools want a number
_ENTRY = re.compile(r"[A-Za-z_]\w*\[\d+,\d+\]")  #: of a matrix
_Row = tuple[int, int, int, int]  #: Port of c/dll/real_code.c

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


class _Port(NamedTuple):
    """A variable that the DLL shows, the name it has there, and what the C file reads of it."""

    shown: str
    variable: Variable
    row: _Row


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
    sources = gather_sources((*layer, _FRONT, *block, record_source()))
    sources[_FRONT.name] = sources[_FRONT.name].replace(
        b"CAPACITY = %d " % _LEAST_ROOM, b"CAPACITY = %d " % room
    )
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


def _as_chain(block: Block | Chain) -> Chain:
    return block if isinstance(block, Chain) else Chain(block.name, {block.name: block})


def _ports(block: Block | Chain) -> dict[Role, list[_Port]]:
    """Inputs, outputs and parameters that the DLL shows.

    What a connection feeds is no input, and the entries of matrices are no parameters: they are the design.
    """
    ports: dict[Role, list[_Port]] = {"input": [], "output": [], "parameter": []}
    chain = _as_chain(block)
    hidden = {target for _, target in chain.connections}
    for member, b in chain.members.items():
        for role, of_role in ports.items():
            for v in (*b.table.of_role(role), *b.table.of_role(role, integers=True)):
                name = f"{member}.{v.name}"
                if name not in hidden and not (role == "parameter" and _ENTRY.fullmatch(v.name)):
                    if role != "parameter":
                        kept = b.kind in ("controller", "supervisor")
                        name = shown_name(member, "controller" if kept else "channel", v)
                    of_role.append(_Port(name if chain is block else v.name, v, _row(chain, member, v)))
    return ports


def _row(chain: Chain, member: str, v: Variable) -> _Row:
    """Whether it is an integer, its value reference, whether it counts at the start only, its member."""
    fixed = v.role == "parameter" and not v.tunable
    reference = chain.members[member].table.value_reference(v.name)
    return v.type != "Real", reference, fixed, list(chain.members).index(member)


def _feeds(chain: Chain, inputs: Sequence[_Port]) -> list[tuple[_Row, _Row]]:
    """Of each input of the members what feeds it, the tool's k-th value or an output, and the input.

    Raises
    ------
    BuildError : an end that does not exist, one that leads backwards, or ports of two types.
    """
    feeds: list[tuple[_Row, _Row]] = [((0, k, 0, -1), port.row) for k, port in enumerate(inputs)]
    for source, target in chain.connections:
        rows = []
        for end, role in ((source, "output"), (target, "input")):
            member, _, port = end.partition(".")
            variables = chain.members[member].table if member in chain.members else ()
            v = next((v for v in variables if (v.name, v.role) == (port, role)), None)
            if v is None:
                raise BuildError(f"{chain.name}: {source} -> {target}: {end} is no {role} of a member")
            rows.append(_row(chain, member, v))
        if not (rows[0][3] < rows[1][3] and rows[0][0] == rows[1][0]):
            raise BuildError(
                f"{chain.name}: {source} -> {target} leads backwards or joins two types, allowed: "
                "from a member to a later one"
            )
        feeds.append((rows[0], rows[1]))
    return feeds


def _check(block: Block | Chain, ports: Mapping[Role, Sequence[_Port]]) -> None:
    kinds = [b.kind for b in _as_chain(block).members.values()]
    strange = set(kinds) - set(CHAIN_KINDS) if isinstance(block, Chain) else {"plant"} & set(kinds)
    n_in, n_out, n_parameters = map(len, ports.values())
    room = 1 <= len(kinds) <= MOST_MEMBERS and n_in + n_out <= MOST_SIGNALS
    if strange or not room or n_parameters > MOST_PARAMETERS:
        raise BuildError(
            f"{block.name} is a {block.kind} of {', '.join(kinds)} with {n_in} inputs, {n_out} outputs and "
            f"{n_parameters} parameters, allowed for a DLL: a controller, supervisor, channel, PMU, or 1 to "
            f"{MOST_MEMBERS} of them in a chain, with at most {MOST_SIGNALS} inputs and outputs and "
            f"{MOST_PARAMETERS} parameters"
        )
    for group in ports.values():
        names = [port_name(p.shown) for p in group]
        if len(set(names)) != len(names) or not all(re.fullmatch(r"[A-Za-z_]\w*", n) for n in names):
            raise BuildError(
                f"{block.name}: names {names} are no different C identifiers; rename the variables"
            )


def entries_of(block: Block | Chain, sample_time_s: float) -> dict[str, npt.ArrayLike | bytes]:
    """Return the record: what Model_GetInfo tells, and the records of the members (c/dll/real_code.c)."""
    chain, ports = _as_chain(block), _ports(block)
    _check(block, ports)
    counts, rows = [*map(len, ports.values()), len(chain.members)], [*ports["output"], *ports["parameter"]]
    entries: dict[str, npt.ArrayLike | bytes] = {
        "dll.counts": np.array(counts, dtype=np.int32),
        "dll.ports": np.array([port.row for port in rows], dtype=np.int32),
        "dll.feeds": np.array(_feeds(chain, ports["input"]), dtype=np.int32),
        "dll.range": np.array([sample_time_s, *(x for p in ports["parameter"] for x in _range(p.variable))]),
        "dll.text": b"".join(text.encode() + b"\0" for text in _texts(block, ports)),
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
    low, high = (v.min, v.max) if v.type == "Real" else (0, 1) if v.type == "Boolean" else integer_range(v)
    limits = (-UNBOUNDED if low is None else low, UNBOUNDED if high is None else high)
    return float(v.start or 0), float(limits[0]), float(limits[1])


def _texts(block: Block | Chain, ports: Mapping[Role, Sequence[_Port]]) -> Iterator[str]:
    """Texts in the order in which c/dll/real_code.c reads them."""
    general = {"generated by": f"interarea {product_version()}", **block.provenance}
    yield from (block.name, product_version(), block.description)
    yield "; ".join(f"{key}: {value}" for key, value in general.items())
    for role, of_role in ports.items():
        for shown, v, _ in of_role:
            items = () if v.enumeration is None else v.enumeration.items
            numbers = ": " + ", ".join(f"{value} {item}" for item, value, _ in items) if items else ""
            yield from (port_name(shown), v.description + numbers, v.unit)
            if role == "parameter":
                yield re.split(r"[\[.]", shown)[0] if re.search(r"[\[.]", shown) else "general"
