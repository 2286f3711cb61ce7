"""Rules that fmpy and fmu-manipulation-toolbox already check, reported in one form.

Each of their messages is sorted under a rule with its fix; when both tools
find the same thing it is reported once.
"""

from __future__ import annotations

import importlib.util
import logging
import re
from dataclasses import dataclass
from pathlib import Path

from interarea.models.files import temporary_files_in, temporary_folder

from ..finding import Report


@dataclass(frozen=True)
class _Rule:
    pattern: str  #: of either tool's message; a group gives the variable
    rule: str
    fix: str


_RULES = (
    _Rule(r"variable name \"(.+?)\" .*is not unique|Name '(.+?)' is used by", "FMI2 2.2.7 unique names",
          "give every variable a name of its own"),
    _Rule(r"unit \"(.+?)\" of variable", "FMI2 2.2.2 units", "define the unit in UnitDefinitions"),
    _Rule(r"[Vv]ariable [\"'](.+?)[\"'].*(?:has no start value|start value is required)", "FMI2 2.2.7 start",
          "give the variable a start value"),
    _Rule(r"[Vv]ariable [\"'](.+?)[\"'].*(?:provides a start|start value is not allowed)", "FMI2 2.2.7 start",
          "remove the start value, or change initial"),
    _Rule(r"in variable \"(.+?)\"|Variable '(.+?)': (?:causality=|initial|unknown causality)",
          "FMI2 2.2.7 causality, variability, initial", "use a combination from the standard's table"),
    _Rule(r"[Vv]ariable [\"'](.+?)[\"'].*continuous", "FMI2 2.2.7 continuous",
          "only Real variables may have variability continuous"),
    _Rule(r"(InitialUnknowns)", "FMI2 2.2.8 InitialUnknowns",
          "list exactly the outputs, states, derivatives and calculated parameters that are computed"),
    _Rule(r"variable \"(.+?)\".*must have the attribute|lists '(.+?)', which has no derivative",
          "FMI2 2.2.8 Derivatives", "give the variable the attribute derivative=\"index of its state\""),
    _Rule(r"Output '(.+?)' is not listed|lists '(.+?)', which is not an output|(ModelStructure/Outputs)",
          "FMI2 2.2.8 Outputs", "list each variable with causality output once"),
    _Rule(r"derivative='.*' is not a variable|Variable '(.+?)': derivative=", "FMI2 2.2.7 derivative",
          "give the 1-based index of the state"),
    _Rule(r"(?:entry of '(.+?)': )?dependenc|<(.+?)><Unknown index|list index out of range",
          "FMI2 2.2.8 indices", "indices run from 1 to the number of variables"),
    _Rule(r"\"(.+?)\" \(line .*naming convention|\"(.+?)\" \(line .*illegal", "FMI2 2.2.9 variable names",
          "follow the declared naming convention"),
    _Rule(r"declaredType=\"(.+?)\"", "FMI2 2.2.3 types", "define the type in TypeDefinitions"),
)  # fmt: skip


def _tell(message: str, tool: str, where: str, report: Report) -> None:
    text = " ".join(message.split())
    for rule in _RULES:
        hit = re.search(rule.pattern, text)
        if hit is None:
            continue
        name = next((g for g in hit.groups() if g), "")
        place = f"{where} {name}".strip()
        if not any(f.rule == rule.rule and (f.where == place or not name) for f in report.findings):
            report.add(rule.rule, place, f"{text} (seen by {tool})", rule.fix)
        return
    report.add(tool, where, text, f"see the message of {tool}")


def fmpy_rules(folder: Path, where: str, report: Report) -> None:
    """Run fmpy's validation of names, starts, causalities, units and ModelStructure."""
    from fmpy import read_model_description
    from fmpy.model_description import ValidationError

    try:
        read_model_description(
            str(folder), validate=True, validate_variable_names=True, validate_model_structure=True
        )
    except ValidationError as error:
        for problem in error.problems:
            _tell(problem, "fmpy", where, report)
    except Exception as error:  # fmpy lets what it trips over through
        _tell(str(error) or type(error).__name__, "fmpy", where, report)


def toolbox_rules(path: Path, where: str, report: Report) -> None:
    """Run fmu-manipulation-toolbox's semantic rules on the archive, where that package is installed."""
    if importlib.util.find_spec("fmu_manipulation_toolbox") is None:
        report.notes.append(
            "fmu-manipulation-toolbox is not installed, its rules were not run "
            "(`pip install fmu-manipulation-toolbox`)"
        )
        return
    from fmu_manipulation_toolbox.checker import OperationSemanticCheck
    from fmu_manipulation_toolbox.operations import FMU

    logger = logging.getLogger("fmu_manipulation_toolbox")
    silenced, logger.disabled = logger.disabled, True
    children = [
        log
        for name, log in logging.Logger.manager.loggerDict.items()
        if name.startswith("fmu_manipulation_toolbox") and isinstance(log, logging.Logger)
    ]
    before = [log.disabled for log in children]
    for log in children:
        log.disabled = True
    try:
        operation = OperationSemanticCheck()
        with temporary_folder() as folder, temporary_files_in(folder), FMU(str(path)) as fmu:
            fmu.apply_operation(operation)
        for message in operation.errors:
            _tell(message, "fmutool", where, report)
    except Exception as error:  # it, too, lets through what it trips over
        _tell(str(error) or type(error).__name__, "fmutool", where, report)
    finally:
        logger.disabled = silenced
        for log, was in zip(children, before, strict=True):
            log.disabled = was
