"""The corpus of malformed and hostile files: recipes, not bulk. `entries(folder)` writes and names them.

Each entry is one wrong file, the command that meets it, and what its message must name. Mutations take a
valid file, find its numbers, texts and tables, and spoil one at a time.
"""

from __future__ import annotations

import json
import re
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

Write = Callable[[Path], None]


@dataclass(frozen=True)
class Entry:
    """One wrong file: `write` makes it; `command` gets {file} and {out}; `says`: pattern of the message."""

    name: str
    suffix: str
    write: Write
    command: tuple[str, ...]
    says: str


def text(content: str) -> Write:
    return lambda path: path.write_text(content, encoding="utf-8")


def raw(content: bytes) -> Write:
    return lambda path: path.write_bytes(content)


NUMBER = re.compile(r"(?<=[=\[,]\s)-?\d[\d_.eE+-]*(?=[\s,\]}#]|$)", re.MULTILINE)
STRING = re.compile(r'(?<=[=\[,]\s)"[^"\n]*"')
KEY = re.compile(r"([A-Za-z_][A-Za-z_0-9]*)\s*=\s*\[?\[?[^=]*$")


def spoiled(toml: str, what: str, pattern: re.Pattern[str], bad: str) -> Iterator[tuple[str, str, str]]:
    """Yield (name, key, text) for each place of `pattern` replaced by `bad`."""
    for k, match in enumerate(pattern.finditer(toml)):
        before = toml[: match.start()]
        line = before.rsplit("\n", 1)[-1]
        key = KEY.search(line)
        if key is None or line.lstrip().startswith("#"):
            continue
        yield f"{what} {k} {key[1]}", key[1], before + bad + toml[match.end() :]


BROKEN: tuple[tuple[str, bytes, str], ...] = (
    ("empty", b"", "."),
    ("binary", bytes(range(256)), "TOML|UTF-8|utf-8|not text|codec"),
    ("latin-1", 'title = "Pr\xfcfung"\n'.encode("latin-1"), "TOML|UTF-8|utf-8|codec"),
    ("nul", b"title = \x00\n", "TOML"),
    ("unclosed", b'title = "never closed\n', "TOML"),
    ("twice", b"case = 'a'\ncase = 'b'\n", "TOML"),
    ("deep", b"x = " + b"[" * 5000 + b"]" * 5000, "TOML|nest|deep|recursion"),
    ("list", b"[[case]]\n[[case]]\n", "."),
)


def toml_entries(kind: str, good: str, command: tuple[str, ...]) -> Iterator[Entry]:
    """Yield what can be wrong with any TOML file of a kind."""
    for name, content, says in BROKEN:
        yield Entry(f"{kind}: {name}", ".toml", raw(content), command, says)
    for share in (0.3, 0.6, 0.9):
        said = re.sub(r"#.*", "", good)  # a cut inside a comment leaves whole TOML
        cut = said[: int(share * len(said))].rsplit("=", 1)[0] + "="
        yield Entry(f"{kind}: cut at {share}", ".toml", text(cut), command, "TOML")
    yield Entry(f"{kind}: unknown key", ".toml", text("colour = 'blue'\n" + good), command, "colour")
    for name, key, changed in spoiled(good, "nan for number", NUMBER, "nan"):
        yield Entry(f"{kind}: {name}", ".toml", text(changed), command, key)
    for name, key, changed in spoiled(good, "text for number", NUMBER, '"seven"'):
        yield Entry(f"{kind}: {name}", ".toml", text(changed), command, key)
    for name, key, changed in spoiled(good, "table for text", STRING, "{ a = 1 }"):
        yield Entry(f"{kind}: {name}", ".toml", text(changed), command, key)


CASE = ("loops", "{file}")
RUN = ("run", "{file}", "--out", "{out}")
SWEEP = ("sweep", "{file}", "--out", "{out}")
DESIGN = ("design", "{file}", "--out", "{out}/made.json")
CERTIFY = ("certify", "{file}")
IMPORT = ("import", "{file}", "--out", "{out}/case.toml")

SCENARIO = """
title = "one of each"
case = "two-area-thesis"
controller = "ftc"
stop_s = 4.0
step_s = 0.01
[channels.remote]
signal = "G2_dw"
latency_s = 0.1
on_loss = "hold"
reporting_interval_s = 0.02
loss = { kind = "bernoulli", rate = 0.1 }
seed = 3
outages_s = [ [ 1.0, 2.0 ] ]
[channels.local]
signal = "G4_dw"
[[event]]
kind = "bus_fault"
bus = 8
start_s = 1.0
end_s = 1.1
x_pu = 1e-4
[[event]]
kind = "vref_pulse"
machine = "G1"
size_pu = 0.05
start_s = 2.0
end_s = 2.2
"""

SWEEP_FILE = """
seed = 1
samples = 4
time_limit_s = 60.0
[scenario]
case = "two-area-thesis"
controller = "ftc"
stop_s = 4.0
[scenario.channels.remote]
signal = "G2_dw"
[parameters.latency]
path = "channels.remote.latency_s"
range = { start = 0.0, stop = 0.4, step = 0.1 }
[parameters.tie]
path = "case.tie_flow_mw"
random = { low = -100.0, high = 100.0 }
"""

SCENARIO_WRONG: tuple[tuple[str, str, str, str], ...] = (
    ("unknown case", 'case = "two-area-thesis"', 'case = "two-area"', "two-area"),
    ("unknown controller", 'controller = "ftc"', 'controller = "fct"', "fct"),
    ("unknown signal", 'signal = "G2_dw"', 'signal = "G9_dw"', "G9_dw"),
    ("signal of no input", 'signal = "G2_dw"', 'signal = "G1_dw"', "G1_dw"),
    ("unknown bus", "bus = 8", "bus = 88", "88"),
    ("unknown machine", 'machine = "G1"', 'machine = "G7"', "G7"),
    ("unknown event", 'kind = "bus_fault"', 'kind = "bus_falut"', "bus_fa"),
    ("unknown rule", 'on_loss = "hold"', 'on_loss = "holt"', "on_loss"),
    ("unknown loss", 'kind = "bernoulli"', 'kind = "bernouli"', "loss"),
    ("probability above one", "rate = 0.1", "rate = 1.1", "rate"),
    ("negative latency", "latency_s = 0.1", "latency_s = -0.1", "latency_s"),
    ("latency off the clock", "latency_s = 0.1", "latency_s = 1e-10", "latency_s"),
    ("outage backwards", "[ 1.0, 2.0 ]", "[ 2.0, 1.0 ]", "outages_s"),
    ("outages overlap", "[ [ 1.0, 2.0 ] ]", "[ [ 1.0, 2.0 ], [ 1.5, 3.0 ] ]", "outages_s"),
    ("half an outage", "[ 1.0, 2.0 ]", "[ 1.0 ]", "outages_s"),
    ("fault ends before it starts", "end_s = 1.1", "end_s = 0.9", "end_s"),
    ("event after the end", "start_s = 2.0\nend_s = 2.2", "start_s = 9.0\nend_s = 9.2", "9"),
    ("no time", "stop_s = 4.0", "stop_s = 0.0", "stop_s"),
    ("endless", "stop_s = 4.0", "stop_s = inf", "stop_s"),
    ("negative step", "step_s = 0.01", "step_s = -0.01", "step_s"),
    ("step longer than the run", "step_s = 0.01", "step_s = 40.0", "step_s"),
    ("loss without packets", "reporting_interval_s = 0.02\n", "", "reporting_interval_s"),
    ("negative seed", "seed = 3", "seed = -3", "seed"),
    ("half a seed", "seed = 3", "seed = 3.5", "seed"),
    ("channel named plant", "[channels.local]", "[channels.plant]", "plant"),
    ("channel named controller", "[channels.local]", "[channels.controller]", "controller"),
    ("no case", 'case = "two-area-thesis"\n', "", "case"),
    ("no end", "stop_s = 4.0\n", "", "stop_s"),
    ("two channels on one input", 'signal = "G4_dw"', 'signal = "G2_dw"', "G2_dw"),
    ("case outside", 'case = "two-area-thesis"', 'case = "../../../../etc/passwd"', "passwd"),
    ("controller is a folder", 'controller = "ftc"', 'controller = "."', "controller"),
)

SWEEP_WRONG: tuple[tuple[str, str, str, str], ...] = (
    ("unknown parameter", "channels.remote.latency_s", "channels.remote.latancy_s", "latancy_s"),
    ("unknown channel", "channels.remote.latency_s", "channels.remoet.latency_s", "remoet"),
    ("backwards", "stop = 0.4", "stop = -0.4", "latency"),
    ("no step", "step = 0.1", "step = 0.0", "latency|step"),
    ("enormous", "step = 0.1", "step = 1e-9", "runs|--large"),
    ("two ways", "range = {", "values = [ 0.1 ]\nrange = {", "latency"),
    ("no way", "range = { start = 0.0, stop = 0.4, step = 0.1 }", "", "latency"),
    ("no values", "range = { start = 0.0, stop = 0.4, step = 0.1 }", "values = []", "latency"),
    ("low above high", "low = -100.0", "low = 200.0", "tie"),
    ("negative samples", "samples = 4", "samples = -4", "samples"),
    ("no time", "time_limit_s = 60.0", "time_limit_s = 0.0", "time_limit_s"),
    ("unknown metric", "seed = 1", 'seed = 1\nmetrics = ["dampng"]', "dampng"),
    ("wrong scenario", "stop_s = 4.0", "stop_s = -4.0", "stop_s"),
    ("unknown case", '"two-area-thesis"', '"two-area-thesys"', "two-area-thesys"),
)

CASE_WRONG: tuple[tuple[str, str, str, str], ...] = (
    ("no reactance", '5, to = 6, r = 0.0025, x = 0.025', '5, to = 6, r = 0.0025, x = nan', "5-6"),
    ("unknown bus of a branch", '"5-6" = { from = 5', '"5-6" = { from = 55', "55"),
    ("branch to itself", '"5-6" = { from = 5, to = 6', '"5-6" = { from = 5, to = 5', "5-6"),
    ("island", '"6-7" = { from = 6, to = 7, r = 0.001, x = 0.01, b = 0.0175 }\n', "", "island|connected|6"),
    ("unknown bus of a load", "L7 = { bus = 7", "L7 = { bus = 77", "77"),
    ("unknown kind", 'kind = "transformer", from = 1', 'kind = "transfomer", from = 1', "kind"),
    ("zero base", "base_mva = 100.0", "base_mva = 0.0", "base_mva"),
    ("negative frequency", "frequency_hz = 60.0", "frequency_hz = -60.0", "frequency_hz"),
    ("zero time constant", "Td01 = 8.0", "Td01 = 0.0", "Td01"),
    ("transient above synchronous", "Xd1 = 0.3", "Xd1 = 3.0", "Xd1"),
    ("unknown exciter", 'exciter = { kind = "constant" }', 'exciter = { kind = "constnt" }', "exciter"),
    ("load beyond the network", "P_mw = 967.0", "P_mw = 96700.0", "converge|power flow"),
)  # fmt: skip

RAW_LINES: tuple[tuple[str, int, Callable[[str], str], str], ...] = (
    ("base is text", 0, lambda s: s.replace("100.0", "'base'"), ":1:"),
    ("base is nan", 0, lambda s: s.replace("100.0", "nan"), ":1:"),
    ("bus number is text", 3, lambda s: "x" + s, ":4:"),
    ("bus record cut", 3, lambda s: s[:8], ":4:|:22:"),
    ("bus twice", 4, lambda s: "1" + s[1:], ":5:"),
    ("bus type 9", 3, lambda s: s.replace(",0.0,3,", ",0.0,9,").replace(",0.0,2,", ",0.0,9,"), ":4:|:22:"),
)


def replaced(good: str, old: str, new: str) -> str:
    assert old in good, f"recipe: {old!r} is not in the base file"
    return good.replace(old, new, 1)


def raw_entries(good: str) -> Iterator[Entry]:
    """Yield RAW files with one wrong line, cut short, or without their ends."""
    lines = good.splitlines()
    for name, k, change, says in RAW_LINES:
        changed = [*lines[:k], change(lines[k]), *lines[k + 1 :]]
        yield Entry(f"raw: {name}", ".raw", text("\n".join(changed) + "\n"), IMPORT, says)
    for share in (0.05, 0.3, 0.5, 0.7):
        yield Entry(f"raw: cut at {share}", ".raw", text(good[: int(share * len(good))]), IMPORT, ".")
    for k, line in enumerate(lines):
        fields = line.split(",")
        numbers = [j for j, f in enumerate(fields) if re.fullmatch(r"\s*-?\d+\.\d+\s*", f)]
        if k >= 3 and numbers:
            j = numbers[-1]
            bad = ",".join([*fields[:j], "nan", *fields[j + 1 :]])
            changed = [*lines[:k], bad, *lines[k + 1 :]]
            yield Entry(
                f"raw: nan in line {k + 1}", ".raw", text("\n".join(changed) + "\n"), IMPORT, f":{k + 1}:"
            )
    yield Entry("raw: empty", ".raw", text(""), IMPORT, ".")
    yield Entry("raw: binary", ".raw", raw(bytes(range(256)) * 20), IMPORT, ".")


def beside(grid: str, content: str) -> Write:
    """Write `content`, and the RAW file `grid` beside it."""

    def write(path: Path) -> None:
        path.with_name("grid.raw").write_text(grid, encoding="utf-8")
        path.write_text(content, encoding="utf-8")

    return write


IMPORT_DYR = ("import", "{folder}/grid.raw", "--dyr", "{file}", "--out", "{out}/case.toml")


def dyr_entries(grid: str, good: str) -> Iterator[Entry]:
    """Yield DYR files with one number or model spoiled, or cut short."""
    lines = good.splitlines()
    for k, line in enumerate(lines):
        numbers = list(re.finditer(r"(?<=\s)-?\d+\.\d+(?=\s)", line))
        if numbers:
            last = numbers[-1]
            bad = [*lines[:k], line[: last.start()] + "nan" + line[last.end() :], *lines[k + 1 :]]
            yield Entry(
                f"dyr: nan in line {k + 1}",
                ".dyr",
                beside(grid, "\n".join(bad)),
                IMPORT_DYR,
                r"wrong\.dyr:\d",
            )
        model = re.search(r"'[A-Z0-9]+'", line)
        if model:
            bad = [*lines[:k], line.replace(model[0], "'NOSUCH'"), *lines[k + 1 :]]
            yield Entry(
                f"dyr: model in line {k + 1}", ".dyr", beside(grid, "\n".join(bad)), IMPORT_DYR, "NOSUCH"
            )
    for share in (0.1, 0.4, 0.8):
        cut = beside(grid, good[: int(share * len(good))])
        yield Entry(f"dyr: cut at {share}", ".dyr", cut, IMPORT_DYR, ".")


def matpower_entries(good: str) -> Iterator[Entry]:
    """Yield MATPOWER files with one number spoiled in each row (P or r), or cut short."""
    lines = good.splitlines()
    for k, line in enumerate(lines):
        if line.startswith("\t"):
            words = line.split(" ")
            place = 1 if "," in line else 2
            for bad in ("nan", "x7"):
                row = " ".join([*words[:place], bad + ("," if "," in line else ""), *words[place + 1 :]])
                content = "\n".join([*lines[:k], row, *lines[k + 1 :]])
                yield Entry(
                    f"matpower: {bad} in line {k + 1}", ".m", text(content), IMPORT, f"wrong\\.m:{k + 1}"
                )
    for share in (0.02, 0.3, 0.6, 0.9):
        yield Entry(f"matpower: cut at {share}", ".m", text(good[: int(share * len(good))]), IMPORT, ".")
    for bad in ("nan", "-100", "x7", "'100'"):
        changed = re.sub(r"mpc.baseMVA = [^;]*", f"mpc.baseMVA = {bad}", good)
        yield Entry(f"matpower: base {bad}", ".m", text(changed), IMPORT, "base")


def json_entries(good: str) -> Iterator[Entry]:
    """Yield controller files with a key missing, of another type, or with matrices that do not fit."""
    data = json.loads(good)
    for key in ("schema", "name", "inputs", "outputs", "A", "B", "C", "D"):
        without = {k: v for k, v in data.items() if k != key}
        yield Entry(f"controller: no {key}", ".json", text(json.dumps(without)), CERTIFY, key)
    for key, bad in {
        "schema": 99, "name": "two words", "A": [[1.0, 2.0]], "B": "matrix", "C": [], "D": [[0.0] * 7],
        "limit_pu": -1.0, "inputs": [1, 2, 3],
    }.items():  # fmt: skip
        yield Entry(f"controller: {key} wrong", ".json", text(json.dumps(data | {key: bad})), CERTIFY, ".")
    poisoned = json.dumps(data).replace(str(data["A"][0][0]), "NaN", 1)
    yield Entry("controller: A has NaN", ".json", text(poisoned), CERTIFY, "NaN")
    for share in (0.0, 0.2, 0.8):
        yield Entry(
            f"controller: cut at {share}", ".json", text(good[: int(share * len(good))]), CERTIFY, "JSON"
        )
    yield Entry("controller: a list", ".json", text("[]"), CERTIFY, "schema")
    yield Entry("controller: deep", ".json", text("[" * 100_000), CERTIFY, ".")
