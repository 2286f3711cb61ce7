"""What a publication prints beside what a study found: a file of claims such as `thesis/published.toml`."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Literal

from .spec import read_claims
from .verdicts import judge

Study = Mapping[str, Any]
Printed = Mapping[str, Any]
#: A table that the parameters were fitted to cannot agree with them
Fit = Literal["fitted", "partly", "differs"]


@dataclass(frozen=True)
class PrintedNumber:
    """A number with the digits of its print; `tolerance` is half a unit of the last digit."""

    text: str

    @property
    def value(self) -> float:
        return float(self.text)

    @property
    def tolerance(self) -> float:
        """Half a unit of the last printed digit.

        >>> PrintedNumber("0.545").tolerance
        0.0005
        """
        return 0.5 * 10.0 ** -len(self.text.partition(".")[2])

    def agrees(self, ours: float) -> bool:
        """Say whether `ours` rounds to the printed digits."""
        return abs(ours - self.value) <= self.tolerance * (1.0 + 1e-9)

    def relative_error(self, ours: float) -> float:
        """Return (ours - printed) / printed."""
        return (ours - self.value) / self.value


def printed_rows(claims: Path, study: Study) -> dict[str, Any]:
    """Return `verdicts` (statements judged), `modes` and `loops` (printed beside ours), `corrections`.

    claims : TOML with tables statement, modes, loops, correction; each may be missing. study : as study.json.

    Raises
    ------
    ScenarioError : no such file, or evidence that the study does not hold.
    """
    printed = {"modes": [], "loops": [], "statement": [], "correction": []} | read_claims(claims)
    return {
        "verdicts": [asdict(judge(row, study)) for row in printed["statement"]],
        "modes": beside_modes(printed, study),
        "loops": beside_loops(printed, study),
        "corrections": printed["correction"],
    }


def beside_modes(printed: Printed, study: Study) -> list[dict[str, Any]]:
    """Return Table 5.1 beside ours: as printed, and with rows M2 and M3 exchanged."""
    rows = []
    for entry in printed["modes"]:
        for reading in ("mode", "exchanged"):
            if reading not in entry:
                continue
            ours = study["modes"].get(entry[reading])
            if ours is None:
                continue
            row: dict[str, Any] = {
                "printed_as": entry["printed_as"],
                "reading": "as printed" if reading == "mode" else "rows exchanged",
                "mode": entry[reading],
            }
            for quantity in ("frequency_hz", "damping_ratio"):
                number = PrintedNumber(entry[quantity])
                row[quantity] = _beside(number, ours[quantity])
            rows.append(row)
    return rows


def beside_loops(printed: Printed, study: Study) -> list[dict[str, Any]]:
    """Return Table 5.2 beside ours, in the order of the print's index, with both ranks."""
    ours = {(r["actuator"], r["signal"]): r["index"] for r in study["loops"]["ranking"]}
    geometric = {(r["actuator"], r["signal"]): r["geometric"] for r in study["loops"]["ranking"]}
    entries = printed["loops"]
    value = {(r["actuator"], r["signal"]): float(r.get("meant", r["index"])) for r in entries}
    shared = [k for k in value if k in ours]
    rank_printed = {k: 1 + sum(value[j] > value[k] for j in shared) for k in shared}
    rank_ours = {k: 1 + sum(ours[j] > ours[k] for j in shared) for k in shared}
    rows = []
    for row in entries:
        key = (row["actuator"], row["signal"])
        rows.append(
            {
                "actuator": key[0],
                "signal": key[1],
                "printed": row["index"],
                "ours": geometric.get(key),
                "index": ours.get(key),
                "rank_printed": rank_printed.get(key),
                "rank_ours": rank_ours.get(key),
                "note": row.get("note", ""),
            }
        )
    return sorted(rows, key=lambda r: r["rank_printed"] or 99)


def _beside(printed: PrintedNumber, ours: float) -> dict[str, Any]:
    error = printed.relative_error(ours)
    near = printed.agrees(ours) or abs(error) <= 0.005
    verdict: Fit = "fitted" if near else "partly" if abs(error) <= 0.02 else "differs"
    digits = len(printed.text.partition(".")[2])
    return {"printed": printed.text, "ours": f"{ours:.{digits}f}", "error": error, "verdict": verdict}
