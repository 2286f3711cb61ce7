"""The command `loops`: which actuator with which signal, for the inter-area modes or any of a band."""

from __future__ import annotations

import json
from dataclasses import asdict
from math import isfinite, nan
from typing import TYPE_CHECKING, Annotated, Any

import typer

from ..command_usage import LATENCY_S, CaseName
from .modes import Below, CircuitsOut, at_point, region_of
from .terminal import busy, print_table

if TYPE_CHECKING:
    from collections.abc import Sequence

    from interarea.cosim.designs.short_designs import ShortDesign
    from interarea.design.modes.loop_choice import LoopChoice
    from interarea.models.case.case import Case


def loops(
    case: CaseName,
    json_: Annotated[bool, typer.Option("--json", help="print JSON instead of a table")] = False,
    band: Annotated[
        str | None,
        typer.Option("--band", metavar="LOW:HIGH", help="of the modes, Hz; default 0.1:2.5"),
    ] = None,
    below: Below = None,
    mode: Annotated[
        list[str] | None,
        typer.Option(
            "--mode", metavar="NAME", help="target, as named by `modes --band`; default: inter-area modes"
        ),
    ] = None,
    latency: Annotated[
        float,
        typer.Option(
            "--latency",
            metavar="S",
            help="of every signal; changes the phase to compensate",
            callback=LATENCY_S,
        ),
    ] = 0.0,
    signals: Annotated[
        list[str] | None,
        typer.Option(
            "--signals", metavar="KIND", help="speed, frequency, angle, power or current; default all"
        ),
    ] = None,
    actuator: Annotated[
        list[str] | None,
        typer.Option("--actuator", metavar="INPUT", help="allowed actuator, as G1_vs; default all"),
    ] = None,
    together: Annotated[
        int | None,
        typer.Option("--together", metavar="N", min=1, help="actuators in a set; default 2, or all allowed"),
    ] = None,
    most: Annotated[int, typer.Option("--most", metavar="N", min=1, help="rows to show")] = 10,
    circuit_out: CircuitsOut = None,
    tried: Annotated[
        int,
        typer.Option("--try", metavar="N", min=0, help="short design of the best N sets, ranked by damping"),
    ] = 0,
    point: Annotated[
        list[str] | None,
        typer.Option(
            "--point",
            metavar="KEY=VALUE",
            help="additional operating point: out=BRANCH, tie=MW or load=FACTOR",
        ),
    ] = None,
) -> None:
    """Rank every signal at every actuator for the inter-area modes, or others of a band; any grid."""
    loaded = at_point(case, 0.0, circuit_out, 1.0)
    options: dict[str, Any] = {"latency_s": latency, "together": together, "most": max(most, tried)}
    options |= {"targets": mode or (), "actuators": actuator or ()} | ({"kinds": signals} if signals else {})
    options["points"] = {words: _variant(loaded, words) for words in point or ()}
    with busy(f"loops of {loaded.name}"):
        choice = _chosen(loaded, *region_of(band, below), options)
        designs = _designed(loaded, choice, tried, latency) if tried else ()
    if json_:
        result = {"case": loaded.name, **_as_dict(choice)}
        if tried:
            result["designs"] = [
                {"actuators": d.chosen.actuators, "damping": d.damping, "own": d.own, "worth": d.sentence}
                for d in designs
            ]
        typer.echo(json.dumps(result, indent=2, allow_nan=False))
        return
    _print_choice(loaded.name, choice)
    if tried:
        _print_designs(loaded.name, designs, latency)


def _variant(case: Case, words: str) -> Case:
    """Return a case at the operating point that `words` say."""
    from interarea.models.case.case import CaseError
    from interarea.models.case.variants import operating_variant

    key, _, value = words.partition("=")
    if key == "out":
        return operating_variant(case, out=[value])
    try:
        number = float(value)
    except ValueError:
        number = nan
    if key == "tie" and isfinite(number):
        return operating_variant(case, tie_flow_mw=number)
    if key == "load" and isfinite(number):
        return operating_variant(case, load_scale=number)
    raise CaseError(f"--point {words!r}, wanted out=BRANCH, tie=MW or load=FACTOR")


def _chosen(case: Case, band_hz: tuple[float, float], below: float, options: dict[str, Any]) -> LoopChoice:
    from interarea.cosim.designs.ranked_loops import ranked_loops
    from interarea.fmu_build.write.cache import default_cache

    return ranked_loops(case, default_cache(), band_hz=band_hz, below=below, **options)


def _designed(case: Case, choice: LoopChoice, tried: int, latency_s: float) -> list[ShortDesign]:
    """Return short designs of the best sets, the one that reaches most first."""
    from interarea.cosim.designs.short_designs import LATENCY_S, short_designs
    from interarea.fmu_build.write.cache import default_cache

    result = short_designs(case, choice.sets[:tried], default_cache(), latency_s=latency_s or LATENCY_S)
    return sorted(result, key=lambda design: -design.damping)


def _print_designs(name: str, designs: Sequence[ShortDesign], latency_s: float) -> None:
    from interarea.cosim.designs.short_designs import LATENCY_S

    print_table(
        f"{name}: the same after a short design, least inter-area damping with all signals 0 and "
        f"{latency_s or LATENCY_S:g} s late",
        ("actuators", "damping", "own speed alone", "score"),
        [
            (", ".join(d.chosen.actuators), f"{d.damping:.3f}", f"{d.own:.3f}", f"{d.chosen.score:.3f}")
            for d in designs
        ],
    )
    for d in designs:
        typer.echo(f"{', '.join(d.chosen.actuators)}: {d.sentence}")


def _as_dict(choice: LoopChoice) -> dict[str, Any]:
    def row(loop: Any) -> dict[str, Any]:
        return asdict(loop) | {"residue": [loop.residue.real, loop.residue.imag], "beside": list(loop.beside)}

    return {
        "targets": list(choice.targets),
        "latency_s": choice.latency_s,
        "loops": {mode: [row(loop) for loop in ranked] for mode, ranked in choice.loops.items()},
        "sets": [asdict(one) | {"reason": one.reason} for one in choice.sets],
        "remarks": list(choice.remarks),
    }


def _print_choice(name: str, choice: LoopChoice) -> None:
    late = f", signals {choice.latency_s:g} s late" if choice.latency_s else ""
    for mode, ranked in choice.loops.items():
        print_table(
            f"{name}: loops for {mode}{late}",
            ("actuator", "signal", "index", "phase to make up", "moves most beside"),
            [
                (
                    loop.actuator,
                    loop.signal,
                    f"{loop.index:.3f}",
                    f"{loop.lead_deg:+.0f}°",
                    f"{loop.beside[0]} {loop.beside[1]:.2g} times" if loop.beside[0] else "-",
                )
                for loop in ranked
            ],
        )
    print_table(
        f"{name}: sets of actuators for {', '.join(choice.targets)}",
        ("actuators", "score", "each with", "reason"),
        [
            (
                ", ".join(one.actuators),
                f"{one.score:.3f}",
                ", ".join(f"{a} <- {s}" for a, s in one.loops.items()),
                one.reason,
            )
            for one in choice.sets
        ],
    )
    for remark in choice.remarks:
        typer.echo(remark)
    typer.echo("index: residue over the largest of its kind of signal for that mode; score: least over modes")
