"""Robust design and certification from a TOML file: operating points, losses, latencies, what is asked."""

from __future__ import annotations

import re
import tomllib
from collections.abc import Callable
from pathlib import Path
from typing import Annotated, Any

import control
import numpy as np
from fmpy import read_model_description
from pydantic import BaseModel, ConfigDict, Field, ValidationError

from interarea.design.conditions import Condition, condition_of
from interarea.design.controller import Controller, ControllerError
from interarea.design.family import FamilyCertificate, judge_family
from interarea.design.linearise import remove_reference, speeds_in_rad
from interarea.design.robust import RobustSpec, design_robust
from interarea.design.shipped import shipped_controller, shipped_names
from interarea.models.case import Case, load_case
from interarea.models.case_variants import operating_variant

from .artefacts import linear_plant
from .errors import ScenarioError

Positive = Annotated[float, Field(gt=0.0)]


class _Table(BaseModel):
    model_config = ConfigDict(frozen=True, extra="forbid")


class PointTable(_Table):
    """One operating point, as a change to the case (`models.case_variants`)."""

    name: str
    tie_flow_mw: float = 0.0
    out: tuple[str, ...] = ()
    load_scale: Positive = 1.0


class AskTable(_Table):
    """What the certificate asks of every operating point under every condition."""

    worst_swing: float = 0.0
    inter_area: float = 0.0
    effort: Positive = float("inf")
    fastest_pole: Positive = float("inf")


class DesignTable(_Table):
    """A robust design: one controller for a family of operating points, losses and latencies."""

    name: str
    case: str
    remote: str
    local: str
    actuator: str
    conditions: tuple[str, ...] = Field(min_length=1)
    point: tuple[PointTable, ...] = Field(min_length=1)
    order: Annotated[int, Field(ge=1, le=20)] = 6
    washout_s: Annotated[float, Field(ge=0.0)] = 2.0
    effort_cap: tuple[tuple[Positive, Positive], ...] = ((0.05, 0.155), (300.0, 0.155))
    limit_pu: Positive = 0.15
    starts: Annotated[int, Field(ge=1)] = 5
    seed: int = 1
    ask: AskTable = AskTable()
    source: str = ""

    def family(self) -> tuple[Condition, ...]:
        """Return the conditions of the codes in `conditions`."""
        return tuple(condition_of(code, self.local, self.remote) for code in self.conditions)


def load_design(path: str | Path) -> DesignTable:
    """Read and check a design file, or the bundled one of that name.

    Raises ScenarioError naming file, key, value and what is allowed.
    """
    path = Path(path)
    bundled = Path(__file__).parent / "templates" / f"design_{path}.toml"
    file = bundled if not path.suffix and bundled.exists() else path
    try:
        table = DesignTable.model_validate(tomllib.loads(file.read_text(encoding="utf-8")))
        table.family()
    except FileNotFoundError as error:
        raise ScenarioError(f"design {path}: no such file; bundled: {', '.join(design_names())}") from error
    except tomllib.TOMLDecodeError as error:
        raise ScenarioError(f"{path}: is no TOML: {error}") from error
    except ValidationError as error:
        first = error.errors()[0]
        key = ".".join(str(part) for part in first["loc"])
        raise ScenarioError(f"{path}: {key} = {first['input']!r}: {first['msg'].lower()}") from error
    except ValueError as error:
        raise ScenarioError(f"{path}: {error}") from error
    return table


def design_names() -> list[str]:
    """Return the names of the bundled design files."""
    folder = Path(__file__).parent / "templates"
    return sorted(p.stem.removeprefix("design_") for p in folder.glob("design_*.toml"))


def family_cases(table: DesignTable) -> dict[str, Case]:
    """Return operating point -> case of a design."""
    case = load_case(table.case)
    return {
        p.name: operating_variant(case, tie_flow_mw=p.tie_flow_mw, out=p.out, load_scale=p.load_scale)
        for p in table.point
    }


def family_plants(table: DesignTable, cache: Path) -> dict[str, control.StateSpace]:
    """Return operating point -> full linear plant of its FMU without reference angle, speeds in pu."""
    cases = family_cases(table)
    return {name: remove_reference(linear_plant(case, cache)) for name, case in cases.items()}


def run_design(
    table: DesignTable, cache: Path, *, progress: Callable[[str, float], None] | None = None
) -> Controller:
    """Design the controller of `table`; its certificate, on full plants with exact latency, comes with it."""
    plants = family_plants(table, cache)
    omega_b = load_case(table.case).omega_b
    spec = RobustSpec(
        (table.remote, table.local),
        (table.actuator,),
        table.family(),
        order=table.order,
        washout_s=table.washout_s,
        effort_cap=table.effort_cap,
        starts=table.starts,
        seed=table.seed,
    )
    made = design_robust(plants, spec, omega_b, progress=progress)
    facts = {
        "method": "smoothed worst damping over operating points, losses and latencies",
        "specification": table.model_dump(mode="json", exclude={"ask"}),
        "objective": made.objective,
        "evaluations": made.evaluations,
    }
    record = certify(table, made.system, cache).as_dict()
    return Controller(table.name, made.system, table.limit_pu, facts, record)


def certify(table: DesignTable, K: control.StateSpace, cache: Path) -> FamilyCertificate:
    """Judge a controller (speeds in rad/s) on the family of a design and by what it asks."""
    omega_b = load_case(table.case).omega_b
    plants = {name: speeds_in_rad(p, omega_b) for name, p in family_plants(table, cache).items()}
    return judge_family(
        plants,
        K,
        table.family(),
        worst_swing=table.ask.worst_swing,
        inter_area=table.ask.inter_area,
        effort_cap=table.ask.effort,
        fastest_pole=table.ask.fastest_pole,
    )


def any_controller(name: str, omega_b: float) -> Controller:
    """Return a shipped controller, one from a JSON file, or one read from the parameters of its FMU alone."""
    if name in shipped_names():
        return shipped_controller(name)
    path = Path(name)
    if path.suffix == ".fmu":
        return _from_fmu(path, omega_b)
    return Controller.load(path)


def _from_fmu(path: Path, omega_b: float) -> Controller:
    """Read A, B, C, D (pu) and the limit from an FMU's parameters; speeds become rad/s."""
    if not path.is_file():
        raise ControllerError(f"controller FMU {path}: not found")
    description = read_model_description(str(path))
    variables = description.modelVariables
    starts = {v.name: v.start for v in variables if v.causality == "parameter"}
    inputs = [v.name for v in variables if v.causality == "input"]
    outputs = [v.name for v in variables if v.causality == "output"]
    orders = [int(m[1]) for n in starts if (m := re.fullmatch(r"A\[(\d+),\1\]", n))]
    if not orders:
        raise ControllerError(f"controller FMU {path}: has no parameter A[1,1]: no linear controller")
    n = max(orders)

    def matrix(letter: str, rows: int, columns: int) -> Any:
        return np.array(
            [[float(starts[f"{letter}[{i + 1},{j + 1}]"]) for j in range(columns)] for i in range(rows)]
        ).reshape(rows, columns)

    scale = np.array([omega_b if name.endswith("_dw") else 1.0 for name in inputs])
    system = control.ss(
        matrix("A", n, n),
        matrix("B", n, len(inputs)) / scale,
        matrix("C", len(outputs), n),
        matrix("D", len(outputs), len(inputs)) / scale,
        inputs=inputs,
        outputs=outputs,
    )
    return Controller(description.modelName, system, float(starts["limit"]), {"method": "read from the FMU"})
