"""Write a block as an IEEE/CIGRE DLL, the real-code interface of EMT and RMS tools [CIGRE958].

One library is compiled for each kind of block, platform and size of record. An export copies it and writes
the block's record into the place that the library holds for it: nothing is compiled again.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from pathlib import Path

import numpy as np
import numpy.typing as npt

from interarea.models.blocks.binary_table import pack_record
from interarea.models.blocks.variables import Block, Variable
from interarea.models.files import write_whole

from ..errors import BuildError
from .compile import PLATFORMS, Platform, compile_for
from .description_xml import integer_range, product_version, record_entries
from .sources import fmi_sources, gather_sources, record_source

_C = Path(__file__).resolve().parents[1] / "c"
_LAYER = ("fmi2_common", "fmi2_cs", "fmi2_values", "instance", "placement", "solver")
_MARK = b"interarea-record"
_LEAST_ROOM = 1 << 14
MOST_SIGNALS, MOST_PARAMETERS = 256, 1024  #: c/dll/real_code.c
UNBOUNDED = 1e30  #: range of a parameter that has none: tools want a number

#: Where such a library runs, by name; tools with 32 bits (ATP) take win32.
DLL_PLATFORMS: dict[str, Platform] = {
    "linux64": PLATFORMS["linux64"],
    "win64": PLATFORMS["win64"],
    "win32": Platform("win32", "win32", ("x86-windows-gnu",), ".dll", (), ("-Wl,-s",)),
}


def build_dll(
    block: Block,
    path: Path | str,
    *,
    platform: str,
    sample_time_s: float = 0.001,
    cache: Path | None = None,
) -> Path:
    """Write `block` as an IEEE/CIGRE DLL; return its path.

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
    if platform not in DLL_PLATFORMS:
        raise BuildError(f"unknown platform of a DLL {platform!r}; allowed: {', '.join(DLL_PLATFORMS)}")
    if not 0.0 < sample_time_s < 1e6:
        raise BuildError(f"sample time of a DLL: {sample_time_s:g} s, allowed: above 0")
    to, path = DLL_PLATFORMS[platform], Path(path)
    if path.is_dir():
        path = path / f"{block.name}{to.suffix}"
    record = pack_record(record_entries(block) | _description(block, sample_time_s))
    library = compile_for(f"{block.kind}-dll", dll_sources(block, len(record)), to, cache=cache).read_bytes()
    at = library.find(_MARK)
    if at < 0 or library.count(_MARK) != 1:
        raise BuildError(
            f"the library of {block.kind} has {library.count(_MARK)} places for a record, wanted: 1"
        )
    begin = at + len(_MARK)
    return write_whole(path, library[:begin] + record + library[begin + len(record) :])


def dll_sources(block: Block, record_size: int) -> dict[str, bytes]:
    """Return the C files of the library, flat, with room for a record of that many bytes.

    The functions of FMI are called inside only: a library that exported them could be given those of another.
    """
    room = _LEAST_ROOM
    while room < record_size:
        room *= 2
    layer = tuple(p for p in fmi_sources() if p.stem in _LAYER)
    size = _C / "dll" / "real_code_size.h"
    sources = gather_sources((*layer, *sorted((_C / "dll").glob("*.c")), *block.sources, record_source()))
    sources[size.name] = sources[size.name].replace(b"16384", str(room).encode())
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
    table = block.table
    both = (*table.of_role("parameter"), *table.of_role("parameter", integers=True))
    return [v for v in both if not re.fullmatch(r"[A-Za-z_]\w*\[\d+,\d+\]", v.name)]


def _description(block: Block, sample_time_s: float) -> dict[str, npt.ArrayLike | bytes]:
    """What Model_GetInfo tells, as entries of the record (c/dll/real_code.c)."""
    table = block.table
    inputs = [*table.of_role("input"), *table.of_role("input", integers=True)]
    outputs = [*table.of_role("output"), *table.of_role("output", integers=True)]
    parameters = parameters_of(block)
    if not (block.kind != "plant" and max(len(inputs), len(outputs)) <= MOST_SIGNALS):
        raise BuildError(
            f"{block.name} is a {block.kind} with {len(inputs)} inputs and {len(outputs)} outputs; a DLL is "
            f"for a controller, supervisor, channel, PMU or chain of at most {MOST_SIGNALS} each"
        )
    if len(parameters) > MOST_PARAMETERS:
        raise BuildError(
            f"{block.name} has {len(parameters)} parameters; a DLL has at most {MOST_PARAMETERS}"
        )
    for group in (inputs, outputs, parameters):
        names = [port_name(v.name) for v in group]
        if len(set(names)) != len(names) or not all(re.fullmatch(r"[A-Za-z_]\w*", n) for n in names):
            raise BuildError(
                f"{block.name}: names {names} are no different C identifiers; rename the variables"
            )
    ports = [
        (int(v.type != "Real"), table.value_reference(v.name), int(v.role == "parameter" and not v.tunable))
        for v in (*inputs, *outputs, *parameters)
    ]
    counts = np.array([len(inputs), len(outputs), len(parameters)], dtype=np.int32)
    return {
        "dll.counts": counts,
        "dll.ports": np.array(ports, dtype=np.int32),
        "dll.range": np.array([sample_time_s, *(x for v in parameters for x in _range(v))]),
        "dll.text": b"".join(text.encode() + b"\0" for text in _texts(block, inputs, outputs, parameters)),
    }


def _range(v: Variable) -> tuple[float, float, float]:
    """Default, least and greatest value."""
    start = float(v.start or 0)
    if v.type == "Boolean":
        return start, 0.0, 1.0
    if v.type != "Real":
        low, high = integer_range(v)
        return start, float(low), float(high)
    low_, high_ = (-UNBOUNDED if v.min is None else v.min), (UNBOUNDED if v.max is None else v.max)
    return start, float(low_), float(high_)


def _texts(
    block: Block, inputs: list[Variable], outputs: list[Variable], parameters: list[Variable]
) -> Iterator[str]:
    """Texts in the order in which c/dll/real_code.c reads them."""
    yield from (block.name, product_version(), block.description)
    yield "; ".join(f"{key}: {value}" for key, value in _general(block).items())
    yield from ("", "interarea", "", "interarea", "", "")
    for v in (*inputs, *outputs):
        yield from (port_name(v.name), _meaning(v), v.unit)
    for v in parameters:
        group = v.name.split("[")[0].split(".")[0] if re.search(r"[\[.]", v.name) else "general"
        yield from (port_name(v.name), group, _meaning(v), v.unit)


def _general(block: Block) -> Mapping[str, str]:
    return {"generated by": f"interarea {product_version()}", **block.provenance}


def _meaning(v: Variable) -> str:
    """Description of a variable, with what the numbers of an enumeration stand for."""
    if v.enumeration is None:
        return v.description
    return f"{v.description}: " + ", ".join(f"{value} {item}" for item, value, _ in v.enumeration.items)
