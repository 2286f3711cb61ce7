"""Grid files with one record, line, digit, quote or separator spoiled each, made by a seeded generator.

The good files are of our own; their stored voltages are the solution, so that a loss in the network shows.
"""

from __future__ import annotations

import random
import re
from collections.abc import Callable, Iterator
from dataclasses import dataclass

RAW = """0, 100.0, 33, 0, 1, 60.0 / a small grid of our own
line two
line three
1,'WEST GEN',20.0,3,1,1,1,1.03,0.0,1.1,0.9,1.1,0.9
2,'EAST GEN',20.0,2,2,1,1,1.01,-4.08539,1.1,0.9,1.1,0.9
3,'WEST',230.0,1,1,1,1,1.023117,-2.94506,1.1,0.9,1.1,0.9
4,'EAST',230.0,1,2,1,1,1.007771,-6.91688,1.1,0.9,1.1,0.9
0 / END OF BUS DATA, BEGIN LOAD DATA
3,'1',1,1,1,150.0,30.0,0.0,0.0,0.0,0.0,1,1,0
4,'3',1,2,1,320.0,60.0,0.0,0.0,0.0,0.0,1,1,0
0 / END OF LOAD DATA, BEGIN FIXED SHUNT DATA
4,'1',1,0.0,80.0
0 / END OF FIXED SHUNT DATA, BEGIN GENERATOR DATA
1,'1',270.7156,42.4077,300.0,-300.0,1.03,0,500.0,0.0,0.25,0.0,0.0,1.0,1,100.0,450.0,0.0,1,1.0
2,'B',200.0,-43.7449,300.0,-300.0,1.01,0,400.0,0.0,0.25,0.0,0.0,1.0,1,100.0,360.0,0.0,1,1.0
0 / END OF GENERATOR DATA, BEGIN BRANCH DATA
3,4,'1',0.01,0.12,0.21,400.0,400.0,400.0,0.0,0.0,0.0,0.0,1,1,50.0,1,1.0
3,4,'2',0.01,0.12,0.21,400.0,400.0,400.0,0.0,0.0,0.0,0.0,1,1,50.0,1,1.0
0 / END OF BRANCH DATA, BEGIN TRANSFORMER DATA
1,3,0,'1',1,1,1,0.0,0.0,2,'T WEST',1,1,1.0
0.0,0.02,100.0
1.0,0.0,0.0,500.0,500.0,500.0,0,0,1.1,0.9,1.1,0.9,33,0,0.0,0.0,0.0
1.0,0.0
2,4,0,'7',2,2,1,0.0,0.0,2,'T EAST',1,1,1.0
0.0,0.1,400.0
20.2,20.0,0.0,500.0,500.0,500.0,0,0,1.1,0.9,1.1,0.9,33,0,0.0,0.0,0.0
229.0,230.0
0 / END OF TRANSFORMER DATA, BEGIN AREA DATA
1,1,0.0,5.0,'WESTLAND'
2,2,0.0,5.0,'EASTLAND'
0 / END OF AREA DATA, BEGIN TWO-TERMINAL DC DATA
0 / END OF TWO-TERMINAL DC DATA, BEGIN VSC DC LINE DATA
Q
"""
DYR = """// dynamic data of the small grid
1 'GENROU' 1 8.0 0.03 0.4 0.05 6.5 0.0
  1.8 1.7 0.3 0.55 0.25 0.2 0.04 0.22 /
1 'SEXS' 1 0.1 10.0 100.0 0.05 -5.0 5.0 /
1 'TGOV1' 1 0.05 0.5 1.0 0.0 2.1 7.0 0.0 /
1 'IEEEST' 1 1 0 0.0 0.0 0.0 0.0 0.0 0.0 0.05 0.02 3.0 5.4
  10.0 10.0 20.0 0.1 -0.1 0.0 0.0 /
2 'GENROU' B 8.0 0.03 0.4 0.05 6.2 0.0 1.8 1.7 0.3 0.55 0.25 0.2 0.04 0.22 /
2 'SEXS' B 0.1 10.0 100.0 0.05 -5.0 5.0 /
2 'TGOV1' 'B' 0.05 0.5 1.0 0.0 2.1 7.0 0.0 /
"""
MATPOWER = """function mpc = small
mpc.version = '2';
mpc.baseMVA = 100;
% bus type Pd Qd Gs Bs area Vm Va kV zone Vmax Vmin
mpc.bus = [
	1	3	0	0	0	0	1	1.03	0.0	20	1	1.1	0.9;
	2	2	0	0	0	0	2	1.01	-4.10778	20	1	1.1	0.9;
	3	1	150	30	0	0	1	1.025992	-2.93656	230	1	1.1	0.9;
	4	1	320	60	0	80	2	1.019188	-6.8919	230	1	1.1	0.9;
];
% bus Pg Qg Qmax Qmin Vg mBase status Pmax Pmin
mpc.gen = [
	1	270.6935	27.5788	300	-300	1.03	500	1	450	0;
	2	200	-32.2612	300	-300	1.01	400	1	360	0;
];
% from to r x b rateA rateB rateC ratio angle status angmin angmax
mpc.branch = [
	1	3	0	0.02	0	500	500	500	1	0	1	-360	360;
	2	4	0	0.025	0	500	500	500	1	0	1	-360	360;
	3	4	0.01	0.12	0.21	400	400	400	0	0	1	-360	360;
	3	4	0.01	0.12	0.21	400	400	400	0	0	1	-360	360;
];
"""
GOOD = {"raw": RAW, "dyr": DYR, "m": MATPOWER}
_NUMBER = re.compile(r"(?<![\w.'])-?\d+(?:\.\d+)?(?![\w.'])")


@dataclass(frozen=True)
class Spoiled:
    """One spoiled file. file : "raw", "dyr" or "m". line : that was spoiled, from 1. was, is_now : its text.

    value : whether it can still be read as the same record with another number.
    """

    name: str
    file: str
    line: int
    was: str
    is_now: str
    text: str
    value: bool


def _without(text: str, at: int, length: int = 1) -> str:
    return text[:at] + text[at + length :]


def _one_of(matches: list[re.Match[str]], rng: random.Random) -> re.Match[str] | None:
    return rng.choice(matches) if matches else None


def _character(pattern: str, change: Callable[[str, int], str]) -> Callable[[str, random.Random], str | None]:
    """Return what changes a line at one place where a pattern is."""

    def spoil(line: str, rng: random.Random) -> str | None:
        match = _one_of(list(re.finditer(pattern, line)), rng)
        return None if match is None else change(line, match.start())

    return spoil


def _number(change: Callable[[str, random.Random], str]) -> Callable[[str, random.Random], str | None]:
    """Return what changes one number of a line."""

    def spoil(line: str, rng: random.Random) -> str | None:
        match = _one_of(list(_NUMBER.finditer(line.partition(" /")[0])), rng)
        if match is None:
            return None
        return line[: match.start()] + change(match.group(), rng) + line[match.end() :]

    return spoil


def _letter_in(number: str, rng: random.Random) -> str:
    k = rng.choice([i for i, c in enumerate(number) if c.isdigit()])
    return number[:k] + rng.choice("OlSx") + number[k + 1 :]


def _inside(number: str, sign: str, rng: random.Random) -> str:
    """Put a sign for a point, or between two digits."""
    places = [k for k in range(1, len(number) - 1) if number[k] == "."]
    if places:
        return number[: places[0]] + sign + number[places[0] + 1 :]
    digits = [k for k in range(1, len(number)) if number[k - 1 : k + 1].isdigit()]
    k = rng.choice(digits or [len(number)])
    return number[:k] + sign + number[k:]


def _digit_more(number: str, rng: random.Random) -> str:
    k = rng.choice([i for i, c in enumerate(number) if c.isdigit()])
    return number[: k + 1] + rng.choice("123456789") + number[k + 1 :]


def _digit_less(number: str, rng: random.Random) -> str:
    places = [i for i, c in enumerate(number) if c.isdigit()]
    return _without(number, rng.choice(places)) if len(places) > 1 else number + "7"


#: kind -> how it spoils a line, and whether the line may still be read as the same record
KINDS: dict[str, tuple[Callable[[str, random.Random], str | None], bool]] = {
    "quote lost": (_character("'", lambda s, k: _without(s, k)), False),
    "quote more": (_character("'", lambda s, k: s[:k] + "'" + s[k:]), False),
    "end of record lost": (_character(r"[/;]\s*$|/", lambda s, k: _without(s, k)), False),
    "separator lost": (_character(r"[,\t]|(?<=\d) (?=[-\d])", lambda s, k: _without(s, k)), False),
    "separator more": (_character(r",|(?<=\d)\t", lambda s, k: s[:k] + "," + s[k:]), False),
    "bracket lost": (_character(r"[\[\]]", lambda s, k: _without(s, k)), False),
    "letter in a number": (_number(_letter_in), False),
    "two points in a number": (_number(lambda n, _: n + ".5.1" if "." not in n else n + ".1"), False),
    "field lost": (_number(lambda n, _: ""), False),
    "digit more": (_number(_digit_more), True),
    "digit less": (_number(_digit_less), True),
    "sign": (_number(lambda n, _: n[1:] if n.startswith("-") else "-" + n), True),
    "not finite": (_number(lambda n, rng: rng.choice(["NaN", "inf", "1e999", "-1e400"])), False),
    "underscore in a number": (_number(lambda n, rng: _inside(n, "_", rng)), False),
    "decimal comma": (_number(lambda n, _: n.replace(".", ",")), False),
    "minus of a text": (_number(lambda n, _: "\u2212" + n.lstrip("-")), False),
    "blank in a number": (_number(lambda n, rng: _inside(n, " ", rng)), False),
    "stray character": (_number(lambda n, rng: n + rng.choice("@#?\\")), False),
}
WHOLE_LINES = ("line lost", "line twice", "cut there", "joined with the next", "lines exchanged")


def spoiled_files(seed: int = 46, each: int = 5) -> Iterator[Spoiled]:
    """Give spoiled files: `each` of every kind for every file that has what the kind spoils."""
    rng = random.Random(seed)
    for file, good in GOOD.items():
        lines = good.splitlines()
        for kind, (spoil, value) in KINDS.items():
            spots: set[tuple[int, str]] = set()
            for _ in range(20 * each):
                k = rng.randrange(0 if file != "raw" else 3, len(lines))
                now = spoil(lines[k], rng)
                if now is None or now == lines[k] or (k, now) in spots or len(spots) >= each:
                    continue
                spots.add((k, now))
                text = "\n".join([*lines[:k], now, *lines[k + 1 :]]) + "\n"
                yield Spoiled(f"{file} {kind} {len(spots)}", file, k + 1, lines[k], now, text, value)
        for kind in WHOLE_LINES:
            first = 3 if file == "raw" else 1
            for j, k in enumerate(
                rng.sample(places := range(first, len(lines) - 1), min(each, len(places))), 1
            ):
                new = {
                    "line lost": [*lines[:k], *lines[k + 1 :]],
                    "line twice": [*lines[: k + 1], *lines[k:]],
                    "cut there": [*lines[:k], lines[k][: len(lines[k]) // 2]],
                    "joined with the next": [*lines[:k], lines[k] + lines[k + 1], *lines[k + 2 :]],
                    "lines exchanged": [*lines[:k], lines[k + 1], lines[k], *lines[k + 2 :]],
                }[kind]
                if new != lines:  # two lines may be alike
                    yield Spoiled(
                        f"{file} {kind} {j}", file, k + 1, lines[k], "", "\n".join(new) + "\n", False
                    )
