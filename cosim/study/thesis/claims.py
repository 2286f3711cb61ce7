"""Judge what the study prints by what came out here: each check reads `study.json` and nothing else.

A check returns a verdict, our numbers in one sentence and, where they differ,
the reason. No check knows what its verdict ought to be.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, Literal

from .published import PrintedNumber, published

Verdict = Literal["agrees", "partly", "differs"]
Study = Mapping[str, Any]


@dataclass(frozen=True)
class Judgement:
    """One printed statement beside ours."""

    where: str
    says: str
    verdict: Verdict
    ours: str
    why: str = ""


def judge_statements(study: Study) -> list[Judgement]:
    """Judge every statement of `published.toml` against a study's numbers."""
    return [
        Judgement(row["where"], row["says"], *CHECKS[row["check"]](study)) for row in published()["statement"]
    ]


def judge_modes(study: Study) -> list[dict[str, Any]]:
    """Return Table 5.1 beside ours: as printed, and with rows M2 and M3 exchanged."""
    rows = []
    for printed in published()["modes"]:
        for reading in ("mode", "exchanged"):
            if reading not in printed:
                continue
            ours = study["modes"].get(printed[reading])
            if ours is None:
                continue
            row: dict[str, Any] = {
                "printed_as": printed["printed_as"],
                "reading": "as printed" if reading == "mode" else "rows exchanged",
                "mode": printed[reading],
            }
            for quantity in ("frequency_hz", "damping_ratio"):
                number = PrintedNumber(printed[quantity])
                row[quantity] = _beside(number, ours[quantity])
            rows.append(row)
    return rows


def judge_loops(study: Study) -> list[dict[str, Any]]:
    """Return Table 5.2 beside ours, in the order of the print's index, with both ranks."""
    ours = {(r["actuator"], r["signal"]): r["index"] for r in study["loops"]["ranking"]}
    geometric = {(r["actuator"], r["signal"]): r["geometric"] for r in study["loops"]["ranking"]}
    printed = published()["loops"]
    value = {(r["actuator"], r["signal"]): float(r.get("meant", r["index"])) for r in printed}
    shared = [k for k in value if k in ours]
    rank_printed = {k: 1 + sum(value[j] > value[k] for j in shared) for k in shared}
    rank_ours = {k: 1 + sum(ours[j] > ours[k] for j in shared) for k in shared}
    rows = []
    for row in printed:
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
    verdict: Verdict = "agrees" if printed.agrees(ours) or abs(error) <= 0.005 else "differs"
    if verdict == "differs" and abs(error) <= 0.02:
        verdict = "partly"
    digits = len(printed.text.partition(".")[2])
    return {"printed": printed.text, "ours": f"{ours:.{digits}f}", "error": error, "verdict": verdict}


Result = tuple[Verdict, str, str]


def _plant_order(s: Study) -> Result:
    n = s["plant"]["states"]
    why = (
        "The study prints no data of its exciters, governors and stabilizers. The set that reproduces "
        "its modes has "
        "no speed transducers; two of them would make up the difference, which proves nothing."
    )
    return ("agrees", f"{n} states.", "") if n == 58 else ("differs", f"{n} states.", why)


def _best_loop(s: Study) -> Result:
    best = s["loops"]["selected"]
    ours = f"{best['actuator']} with {best['signal']}."
    if (best["actuator"], best["signal"]) != ("G4", "dw24"):
        return (
            "differs",
            ours,
            "The index depends on the coordinates of the state, which the study does not state.",
        )
    why = (
        "Only the ranking can be compared: the index depends on state scaling and the study does not state "
        "its own."
    )
    return "agrees", ours, why


def _wdc_damping(s: Study) -> Result:
    wdc, base = s["controllers"]["wdc"], s["modes"]["inter-area"]["damping_ratio"]
    zeta = wdc["damping_ratio"]["normal"]["inter-area"]
    ours = (
        f"Order {wdc['order_full']} reduced to {wdc['order']}; damping {base:.3f} to {zeta:.3f} on the full "
        f"plant."
    )
    why = (
        "Six plant states and two weights of first order make 8, not 11. The damping comes from the "
        "pole region: the "
        "norm of W1 S cannot be below 1 (see fig. 5.11) and K = 0 reaches 1 already."
    )
    if not zeta >= 0.291:
        return "differs", ours, why
    return ("agrees" if wdc["order_full"] == 11 else "partly"), ours, why


def _settling(s: Study, name: str) -> float | None:
    value = s["scenarios"][name]["settling_time_s"]
    return None if value is None else float(value)


def _seconds(value: float | None) -> str:
    return "not within the run" if value is None else f"{value:.1f} s"


def _wdc_settling(s: Study) -> Result:
    without, with_wdc = _settling(s, "none-pulse"), _settling(s, "wdc-pulse")
    ours = f"After the pulse: without {_seconds(without)}, with {_seconds(with_wdc)} (2 % of the peak)."
    slow = without is None or without > 10.0
    if slow and with_wdc is not None and with_wdc < 10.0:
        return "agrees", ours, ""
    if with_wdc is not None and (without is None or with_wdc < without):
        return (
            "partly",
            ours,
            "The study states neither its disturbance nor its band; ours is 2 % of the peak.",
        )
    return "differs", ours, "The study states neither its disturbance nor its band; ours is 2 % of the peak."


def _sensitivity(s: Study) -> Result:
    facts = s["sensitivity"]
    ours = (
        f"|S(0)| = {facts['s_at_zero']:.3f}, norm of W1 S = {facts['w1_s']:.3f}, of W2 KS = "
        f"{facts['w2_ks']:.3f}."
    )
    why = (
        "A speed difference has no steady state response, G(0) = 0, so S(0) = 1 whatever the "
        "controller; W1 is 1 there. "
        "No controller brings W1 S below 1."
    )
    return ("agrees" if facts["s_at_zero"] < 0.5 else "differs"), ours, why


def _delay_text(rows: list[list[float]], at: float) -> str:
    delay, zeta = min(rows, key=lambda r: abs(r[0] - at))
    return f"{zeta:.3f} at {1e3 * delay:.0f} ms"


def _synchronous_delay(s: Study) -> Result:
    d = s["delay"]["synchronous"]
    margin = d["margin_s"]
    if margin is None:
        return "differs", "Never unstable.", "No characteristic root crosses the axis at any latency."
    below, above = s["scenarios"].get("wdc-margin-below"), s["scenarios"].get("wdc-margin-above")
    seen = ""
    if below and above:
        seen = f" Co-simulated: {_verb(below)} just below, {_verb(above)} just above."
    ours = (
        f"Inter-area damping {_delay_text(d['inter_area'], 0.1)}; exact margin {1e3 * margin:.1f} ms.{seen}"
    )
    again = next((at for at, zeta in d["damping"] if at > margin and zeta > 0.0), None)
    if again is not None:
        ours += f" Not unstable throughout beyond it: at {1e3 * again:.0f} ms it decays again."
    if below and above and not (below["stable"] and not above["stable"]):
        return "partly", ours, "The co-simulation does not confirm the exact margin."
    return "agrees", ours, ""


def _verb(scenario: Mapping[str, Any]) -> str:
    return "decays" if scenario["stable"] else "grows"


def _non_synchronous_delay(s: Study) -> Result:
    sync, non = s["delay"]["synchronous"], s["delay"]["non_synchronous"]
    least = min(z for _, z in non["damping"])
    if non["margin_s"] is None:
        ours = f"No crossing at any latency; least swing damping up to 500 ms is {least:.3f}."
        return "differs", ours, "The loop gain through the remote channel stays below one at every frequency."
    ours = f"Exact margin {1e3 * non['margin_s']:.1f} ms; least swing damping up to 500 ms is {least:.3f}."
    more = sync["margin_s"] is not None and non["margin_s"] > sync["margin_s"]
    return ("agrees" if more else "partly"), ours, "" if more else "Its margin is not the larger one here."


def _hundred_milliseconds(s: Study) -> Result:
    sync, non = (s["scenarios"][f"wdc-{w}-100ms"] for w in ("synchronous", "non-synchronous"))
    exact = [_delay_text(s["delay"][w]["inter_area"], 0.1) for w in ("synchronous", "non_synchronous")]
    ours = (
        f"Inter-area damping {exact[0]} synchronous, {exact[1]} non-synchronous; settling "
        f"{_seconds(sync['settling_time_s'])} against {_seconds(non['settling_time_s'])}."
    )
    rows = s["delay"]["synchronous"]["damping"], s["delay"]["non_synchronous"]["damping"]
    a, b = _at(rows[0], 0.1), _at(rows[1], 0.1)
    times = [r["settling_time_s"] if r["settling_time_s"] is not None else float("inf") for r in (sync, non)]
    better = b > a - 0.001 and times[1] <= times[0]
    if better:
        return "agrees", ours, ""
    from_s = next((d for (d, x), (_, y) in zip(*rows, strict=True) if x < y - 0.01), None)
    why = f"Least damped swing: {a:.3f} synchronous, {b:.3f} non-synchronous."
    if from_s is not None:
        why += f" Synchronous latency is the worse one from {1e3 * from_s:.0f} ms on."
    return ("partly" if b > a else "differs"), ours, why


def _at(rows: list[list[float]], delay: float) -> float:
    return min(rows, key=lambda r: abs(r[0] - delay))[1]


def _order(s: Study, name: str, full: int, reduced: int) -> Result:
    c = s["controllers"][name]
    ours = f"Order {c['order_full']} reduced to {c['order']}."
    if (c["order_full"], c["order"]) == (full, reduced):
        return "agrees", ours, ""
    why = (
        "The weight states are inert in these LMIs (the optimum is the same without them): designed on 8 "
        "states, not 11."
    )
    return ("partly" if c["order"] == reduced else "differs"), ours, why


def _cc_order(s: Study) -> Result:
    return _order(s, "cc", 11, 8)


def _ftc_order(s: Study) -> Result:
    return _order(s, "ftc", 11, 5)


def _lost(s: Study, name: str) -> str:
    z = s["controllers"][name]["damping_ratio"]
    return (
        f"inter-area damping {z['normal']['inter-area']:.3f} normal, {z['remote_lost']['inter-area']:.3f} "
        f"lost"
    )


def _cc_lost(s: Study) -> Result:
    c = s["controllers"]["cc"]
    stable = c["stable"]["remote_lost"]
    ours = f"{_lost(s, 'cc').capitalize()}; {'stable' if stable else 'unstable'} when lost."
    if not stable:
        return "agrees", ours, ""
    why = (
        "The least-effort controller keeps its loop through the local signal stable. Controllers with "
        "more gain at low "
        "frequency do become unstable on loss, through a slow real pole: the outcome hangs on a choice "
        "that the study does not print."
    )
    return "differs", ours, why


def _ftc_lost(s: Study) -> Result:
    ftc, cc = s["controllers"]["ftc"], s["controllers"]["cc"]

    def change(c: Mapping[str, Any]) -> float:
        z = c["damping_ratio"]
        return float(abs(z["normal"]["inter-area"] - z["remote_lost"]["inter-area"]))

    ours = (
        f"{_lost(s, 'ftc').capitalize()}; change {change(ftc):.3f} against {change(cc):.3f} of the "
        f"conventional one."
    )
    why = (
        f"It does so by hardly using the remote signal: remote utilisation "
        f"{_percent(ftc['remote_utilisation'])} "
        f"against {_percent(cc['remote_utilisation'])}."
    )
    if not ftc["stable"]["remote_lost"]:
        return "differs", ours, ""
    return ("agrees" if change(ftc) < change(cc) else "partly"), ours, why


def _percent(value: float) -> str:
    return f"{100.0 * value:.2g} %"


def _effort(s: Study) -> Result:
    ftc, cc = (s["controllers"][n]["effort"] for n in ("ftc", "cc"))
    return (
        ("agrees" if ftc > cc else "differs"),
        f"Norm of K(I-GK)^-1: {ftc:.3f} against {cc:.3f} pu per rad/s.",
        "",
    )


def _ftc_faster(s: Study) -> Result:
    pairs = [(_settling(s, f"ftc-{k}"), _settling(s, f"cc-{k}")) for k in ("pulse", "lost-1s")]
    ours = "; ".join(
        f"{label}: {_seconds(f)} against {_seconds(c)}"
        for label, (f, c) in zip(("normal", "lost"), pairs, strict=True)
    )
    wins = [f is not None and (c is None or f < c) for f, c in pairs]
    why = (
        ""
        if all(wins)
        else (
            "Compared at about equal damping in normal operation, where the study does not say what it "
            "held equal."
        )
    )
    return ("agrees" if all(wins) else "partly" if any(wins) else "differs"), ours + ".", why


CHECKS: dict[str, Callable[[Study], Result]] = {
    "plant_order": _plant_order,
    "best_loop": _best_loop,
    "wdc_damping": _wdc_damping,
    "wdc_settling": _wdc_settling,
    "sensitivity": _sensitivity,
    "synchronous_delay": _synchronous_delay,
    "non_synchronous_delay": _non_synchronous_delay,
    "hundred_milliseconds": _hundred_milliseconds,
    "cc_order": _cc_order,
    "cc_lost": _cc_lost,
    "ftc_order": _ftc_order,
    "ftc_lost": _ftc_lost,
    "effort": _effort,
    "ftc_faster": _ftc_faster,
}
