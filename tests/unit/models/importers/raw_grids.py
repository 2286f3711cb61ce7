"""One grid of four buses as a RAW file of every layout, written for the tests."""

from __future__ import annotations

VERSIONS = (23, 26, 29, 30, 31, 32, 33, 34, 35, 36)
ZEROS = ",".join(["0"] * 12)


def raw_grid(version: int, *, revision: int | None = None, extra: dict[str, list[str]] | None = None) -> str:
    """Return a RAW file of `version`: unit - transformer - line - load with shunts, bus 4 isolated.

    revision : what the first line says instead; -1 leaves it out. extra : section -> further lines.
    """
    said = version if revision is None else revision
    head = "0 100.0" if said < 0 else f"0, 100.0, {said}, 0, 1, 50.0 / four buses"
    lines = [head, "a title", "0 / a title that looks like an end"]
    lines = (["@!IC, SBASE, REV"] if version >= 34 else []) + lines
    for name in order(version):
        if name == "system-wide":
            lines.append("GENERAL, THRSHZ=0.0002, PQBRAK=0.7")
        lines += records(name, version) + (extra or {}).get(name, [])
        if name == "system-wide":
            lines.append("0 / END OF SYSTEM-WIDE DATA, BEGIN BUS DATA")
        else:
            lines.append(f"0 / END OF {name.upper()} DATA")
    named = _with_names(lines, version)
    return "\n".join(named) + "\nQ\n"


def order(version: int) -> list[str]:
    """Return the sections of `version`."""
    names = ["system-wide"] * (version >= 34) + ["bus"] + ["load"] * (version >= 24)
    names += ["fixed shunt"] * (version >= 31) + ["voltage droop"] * (version >= 36) + ["generator"]
    names += ["rating set"] * (version >= 36) + ["branch"] + ["switching device"] * (version >= 34)
    names += ["transformer adjustment" if version <= 26 else "transformer", "area", "two-terminal dc"]
    names += ["VSC dc"] * (version >= 27) + ["switched shunt"] * (version <= 30)
    names += ["impedance correction", "multi-terminal dc", "multi-section line", "zone", "transfer", "owner"]
    names += ["FACTS"] + ["switched shunt"] * (version >= 31) + ["GNE"] * (version >= 32)
    names += ["induction machine"] * (version >= 33)
    names += ["load type", "interface", "interface element"] * (version >= 36)
    return names + ["substation"] * (version >= 34)


def _with_names(lines: list[str], version: int) -> list[str]:
    names = [n for n in order(version) if n != "system-wide"]
    result, k = [], 0
    for line in lines:
        if line.startswith("0 / END OF") and "SYSTEM" not in line:
            k += 1
            line += f", BEGIN {names[k].upper()} DATA" if k < len(names) else ""
        result.append(line)
    return result


def records(name: str, version: int) -> list[str]:
    """Return the records of section `name`: the same grid in every version."""
    if name == "bus":
        return _buses(version)
    if name == "load":
        tail = ",1,1,0" + (",0,0,0" if version >= 34 else "") + (",'            '" if version >= 35 else "")
        return [f"3,'1 ',1,1,1,80.0,20.0,5.0,2.0,4.0,-3.0{tail if version >= 31 else ',1'}"]
    if name == "fixed shunt":
        return ["3,'1 ',1,1.5,12.0"]
    if name == "generator":
        nreg, baslod = (",0", ",0") if version >= 35 else ("", "")
        owner = ",1,1.0,0,1.0,0,1.0,0,1.0,0,1.0" if version >= 26 else ""
        return [f"1,'1 ',0,0,99,-99,1.02,0{nreg},150.0,0,0.2,0,0,1.0,1,100,999,0{baslod}{owner}"]
    if name == "branch":
        return _branches(version)
    if name == "transformer adjustment":
        return ["1,2,'T1',0,1.1,0.9,1.1,0.9,0.00625,0,0,0,0"]
    if name == "transformer":
        ratings = ZEROS if version >= 34 else "0,0,0"
        node = ",0" if version >= 35 else ""
        rest = f"0,0{node},1.1,0.9,1.1,0.9,33,0,0,0,0" + (",0" if version == 34 else "")
        names = ",'YNd1        '" if version >= 33 else ""
        return [
            f"1,2,0,'T1',1,1,1,0.001,-0.002,2,'TWO W       ',1,1,1.0,0,1.0,0,1.0,0,1.0{names}",
            "0.002,0.08,100.0",
            f"1.05,0.0,3.0,{ratings},{rest}",
            "1.0,0.0",
        ]
    if name == "switched shunt":
        if version <= 26:
            return ["3,1,1.1,0.9,0,6.0,1,6.0"]
        if version <= 31:
            return ["3,1,1.1,0.9,0,100.0,'',6.0,1,6.0"]
        if version <= 34:
            return ["3,1,0,1,1.1,0.9,0,100.0,'',6.0,1,6.0"]
        text = "'name'," if version >= 36 else ""
        return [f"3,'1 ',1,0,1,1.1,0.9,0,0,100.0,'',6.0,{text}1,1,6.0"]
    if name == "substation":
        return [
            "1,'WEST        ',61.5,-12.25,0.1",
            "1,'node one    ',1,1",
            "2,'node two    ',2,1",
            "0 / END OF NODES",
            "1,2,'1 ','',2,1,1,0.0001,0,0,0",
            "0 / END OF SWITCHES",
            "1,1,'M','1 '",
            "0 / END OF TERMINALS",
        ]
    return []


def _buses(version: int) -> list[str]:
    rows = []
    for number, kind in ((1, 3), (2, 1), (3, 1), (4, 4)):
        name = f"'BUS, {number}/A  '"
        if version <= 23:
            p, q, g, b = (80.0, 20.0, 5.5, 12.0) if number == 3 else (0.0, 0.0, 0.0, 0.0)
            rows.append(f"{number},{kind},{p},{q},{g},{b},1,1.02,0.0,{name},110.0,1")
        elif version <= 30:
            g, b = (1.5, 12.0) if number == 3 else (0.0, 0.0)
            rows.append(f"{number},{name},110.0,{kind},{g},{b},1,1,1.02,0.0,1")
        else:
            limits = ",1.1,0.9,1.1,0.9" if version >= 33 else ""
            rows.append(f"{number},{name},110.0,{kind},1,1,1,1.02,0.0{limits}")
    return rows


def _branches(version: int) -> list[str]:
    if version <= 26:
        return [
            "1,2,'T1',0.002,0.08,0.0,0,0,0,1.05,3.0,0.001,-0.002,0,0,1",
            "2,-3,'1 ',0.01,0.1,0.04,0,0,0,0,0,0.001,0.002,0.003,0.004,1",
            "3,4,'1 ',0.01,0.1,0.04,0,0,0,0,0,0,0,0,0,0",
        ]
    ratings = f"'line {version}'," + ZEROS if version >= 34 else "0,0,0"
    return [
        f"2,-3,'1 ',0.01,0.1,0.04,{ratings},0.001,0.002,0.003,0.004,1,1,0.0,1,1.0",
        f"3,4,'1 ',0.01,0.1,0.04,{ratings},0,0,0,0,0,1,0.0,1,1.0",
    ]
