"""A controller as it is designed, stored and turned into a block: u = +K y.

Inside `design` speeds are in rad/s; the block for an FMU takes and gives per unit.
"""

from __future__ import annotations

import html
import json
import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field, fields, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from interarea.models.blocks.controller import Guard, controller_block
from interarea.models.blocks.variables import Block
from interarea.models.documents import DocumentError, parse_json, read_document, toml_kind
from interarea.models.errors import UserError
from interarea.models.files import write_whole

from ..linear.matrices import LinearMatrices
from ..linear.systems import LinearSystemError, SystemLike, require_finite, state_space
from .json_text import json_text

if TYPE_CHECKING:
    import control

SCHEMA = 1

#: id of the element of an FMU's documentation that holds design and certificate as JSON
RECORD = "record"


class ControllerError(UserError):
    """A controller file or its numbers cannot be used."""


def table_html(title: str, rows: Mapping[str, str]) -> str:
    """Return what a notebook shows of one thing: its title, and a table of what it has.

    >>> table_html("a<b", {"states": "6"})
    '<p><b>a&lt;b</b></p><table><tr><th scope="row">states</th><td>6</td></tr></table>'
    """
    body = "".join(
        f'<tr><th scope="row">{html.escape(name)}</th><td>{html.escape(value)}</td></tr>'
        for name, value in rows.items()
    )
    return f"<p><b>{html.escape(title)}</b></p><table>{body}</table>"


class _SystemOnDemand:
    """The field `Controller.system`: matrices become a `StateSpace` when one is first read.

    python-control takes a second to load, and a run needs no more than the matrices.
    """

    def __get__(self, controller: Controller | None, owner: type) -> control.StateSpace:
        if controller is None:
            raise AttributeError("system")  # a field without default
        stored = vars(controller)
        if "_system" not in stored:
            stored["_system"] = controller.matrices.state_space(controller.name)
        return stored["_system"]

    def __set__(self, controller: Controller, system: SystemLike | LinearMatrices) -> None:
        what, stored = f"controller {controller.name}", vars(controller)
        try:
            if isinstance(system, LinearMatrices):
                require_finite(system, what)
                stored["_matrices"] = system
            else:
                stored["_system"] = state_space(system, what)
                stored["_matrices"] = LinearMatrices.of(stored["_system"])
        except LinearSystemError as error:
            raise ControllerError(str(error)) from None


_SYSTEM: Any = _SystemOnDemand()  #: Any: to its readers the field is a `StateSpace`


@dataclass(frozen=True)
class Controller:
    """A linear controller u = +K y with its provenance.

    Attributes
    ----------
    name : a C identifier, e.g. "wdc".
    system : inputs named by signal (``G2_dw`` ... in rad/s), outputs by actuator (``G4_vs`` in pu);
        `matrices` are the same without python-control.
    limit_pu : bound of the magnitude of every output.
    design : how it was made: method, specification, orders, gamma ...: JSON values.
    certificate : what was checked on the full plant; None before certification.
    guard : which side of the limit falls while a first swing lasts; its threshold in rad/s.
    """

    name: str
    system: control.StateSpace = _SYSTEM  # takes `LinearMatrices` too
    limit_pu: float = 0.15
    design: Mapping[str, Any] = field(default_factory=dict)
    certificate: Mapping[str, Any] | None = None
    guard: Guard | None = None

    def __post_init__(self) -> None:
        if not (isinstance(self.name, str) and self.name.isidentifier()):
            raise ControllerError(f"controller: name is {self.name!r}, wanted letters, digits and _")
        if not (self.limit_pu > 0.0 and math.isfinite(self.limit_pu)):
            raise ControllerError(
                f"controller {self.name}: limit_pu is {self.limit_pu}, wanted a positive number"
            )
        if self.guard is not None:
            try:
                self.guard.check(self.name, self.inputs, self.outputs)
            except ValueError as error:
                raise ControllerError(str(error)) from None

    @classmethod
    def of(cls, system: SystemLike) -> Controller:
        """Return a linear system as a controller (u = +K y), under the system's name where it has a good one.

        system : inputs named by signal, speeds in rad/s; outputs by actuator, pu.

        Raises
        ------
        ControllerError : another kind of thing, in discrete time, numbers that are not finite, or ports
            without names.
        """
        try:
            system = state_space(system, "controller")
        except LinearSystemError as error:
            raise ControllerError(str(error)) from None
        unnamed = [n for n in (*system.input_labels, *system.output_labels) if "[" in n]
        if unnamed:
            raise ControllerError(
                f"controller: {', '.join(unnamed)} are not names of signals and actuators; name them: "
                'control.ss(A, B, C, D, inputs=["G2_dw"], outputs=["G4_vs"]), rad/s to pu'
            )
        return cls(system.name if str(system.name).isidentifier() else "controller", system)

    @property
    def matrices(self) -> LinearMatrices:
        """A, B, C, D with the names of signals and actuators, units as in `system`."""
        matrices: LinearMatrices = vars(self)["_matrices"]
        return matrices

    @property
    def inputs(self) -> tuple[str, ...]:
        """Names of the signals."""
        return tuple(self.matrices.input_labels)

    @property
    def outputs(self) -> tuple[str, ...]:
        """Names of the actuators."""
        return tuple(self.matrices.output_labels)

    @property
    def order(self) -> int:
        """Number of states."""
        return self.matrices.nstates

    def _repr_html_(self) -> str:
        poles = np.sort(np.abs(np.linalg.eigvals(self.matrices.A)))
        results = {True: "passed", False: "not passed", None: "on record"}
        judged = None if self.certificate is None else self.certificate.get("passed")
        lines = {
            "signals (rad/s)": ", ".join(self.inputs),
            "actuators (pu)": ", ".join(self.outputs),
            "limit (pu)": f"{self.limit_pu:g}",
            "states": str(self.order),
            "poles (rad/s)": f"{poles[0]:.3g} to {poles[-1]:.3g}" if len(poles) else "none",
            "made by": str(self.design.get("method", "-")),
            "certificate": "none" if self.certificate is None else results[judged],
        }
        return table_html(f"controller {self.name}", lines)

    def scaled(self, gain: float = 1.0, limit_pu: float | None = None) -> Controller:
        """Return this controller, uncertified, with its output times `gain` before its limit."""
        K = self.matrices
        system = replace(K, C=gain * K.C, D=gain * K.D)
        limit = self.limit_pu if limit_pu is None else limit_pu
        return replace(self, system=system, limit_pu=limit, certificate=None)

    def save(self, path: str | Path) -> Path:
        """Write the controller as JSON; every number survives to the last bit."""
        return write_whole(path, json_text(self.as_dict()))

    def as_dict(self) -> dict[str, Any]:
        """Return the controller as JSON values, which `from_dict` reads."""
        K = self.matrices
        return {
            "schema": SCHEMA,
            "name": self.name,
            "convention": "u = +K y; speeds (*_dw) in rad/s, actuators in pu",
            "inputs": list(self.inputs),
            "outputs": list(self.outputs),
            "limit_pu": self.limit_pu,
            **({} if self.guard is None else {"guard": asdict(self.guard)}),
            "A": K.A.tolist(),
            "B": K.B.tolist(),
            "C": K.C.tolist(),
            "D": K.D.tolist(),
            "design": plain(self.design),
            "certificate": None if self.certificate is None else plain(self.certificate),
        }

    @classmethod
    def load(cls, path: str | Path) -> Controller:
        """Read a controller written by `save`.

        Raises
        ------
        ControllerError
            Names the file and the key at fault.
        """
        path = Path(path)
        try:
            content = read_document(path, "the JSON file of a controller")
        except DocumentError as error:
            raise ControllerError(str(error)) from None
        try:
            data = parse_json(content)
        except DocumentError as error:
            other = toml_kind(content, "controller")
            raise ControllerError(f"controller file {path}: {other or error}") from None
        try:
            return cls.from_dict(data)
        except ControllerError as error:
            raise ControllerError(f"controller file {path}: {error}") from error

    @classmethod
    def from_dict(cls, data: Any) -> Controller:
        """Return the controller of `as_dict`. Raises ControllerError naming the key at fault."""
        if not isinstance(data, dict) or data.get("schema") != SCHEMA:
            got = data.get("schema") if isinstance(data, dict) else type(data).__name__
            raise ControllerError(f"schema is {got!r}, allowed: {SCHEMA}")
        missing = [k for k in ("name", "inputs", "outputs", "A", "B", "C", "D") if k not in data]
        if missing:
            raise ControllerError(f"missing {', '.join(missing)}")
        for key in "ABCD":
            if not isinstance(data[key], list):
                raise ControllerError(f"{key} = {data[key]!r}, allowed: a matrix as a list of rows")
        for key in ("inputs", "outputs"):
            if not _are_names(data[key]):
                raise ControllerError(f"{key} = {data[key]!r}, allowed: different names without dots")
        n, p, m = len(data["A"]), len(data["outputs"]), len(data["inputs"])
        try:
            shapes = {"A": (n, n), "B": (n, m), "C": (p, n), "D": (p, m)}
            A, B, C, D = (np.array(data[k], dtype=float).reshape(shape) for k, shape in shapes.items())
            return cls(
                name=data["name"],
                system=LinearMatrices.named(A, B, C, D, data["inputs"], data["outputs"]),
                limit_pu=float(data.get("limit_pu", 0.15)),
                guard=None if data.get("guard") is None else guard_of(data["guard"]),
                design=data.get("design", {}),
                certificate=data.get("certificate"),
            )
        except ControllerError:
            raise
        except (TypeError, ValueError) as error:
            raise ControllerError(f"A, B, C, D do not fit {m} inputs and {p} outputs ({error})") from error

    def block(self, omega_b: float) -> Block:
        """Return the block for the FMU builder: speeds in pu (dw_rad = omega_b dw_pu), actuators in pu.

        Parameters
        ----------
        omega_b : base speed of the case, rad/s.
        """
        if not (omega_b > 0.0 and math.isfinite(omega_b)):
            raise ControllerError(
                f"controller {self.name}: omega_b is {omega_b}, wanted a positive number, rad/s"
            )
        scale = np.array([omega_b if name.endswith("_dw") else 1.0 for name in self.inputs])
        K = self.matrices
        design, certificate = plain(self.design), plain(self.certificate)
        documentation = {"Design": document(design)}
        if self.certificate is not None:
            documentation["Certificate"] = document(certificate)
        record = {
            "design": design,
            "certificate": certificate,
            **({} if self.guard is None else {"guard": asdict(self.guard)}),
        }
        # inside a script element only "</" would end it
        text = json.dumps(record, sort_keys=True).replace("</", "<\\/")
        documentation["Record"] = (
            "<p>Design and certificate for programs: JSON in this page's element <code>record</code>.</p>"
            f'<script type="application/json" id="{RECORD}">{text}</script>'
        )
        return controller_block(
            self.name,
            K.A,
            K.B * scale,
            K.C,
            K.D * scale,
            list(self.inputs),
            list(self.outputs),
            limit=self.limit_pu,
            guard=None if self.guard is None else self.guard.in_pu(omega_b),
            documentation=documentation,
            provenance={"method": str(self.design.get("method", "given")), "order": str(self.order)},
        )


def matrices_of_parameters(
    starts: Mapping[str, float], inputs: Sequence[str], outputs: Sequence[str], omega_b: float
) -> LinearMatrices:
    """Return the linear system in a controller FMU's parameters A[1,1].. (pu); speeds become rad/s.

    Raises
    ------
    ControllerError : there are no such parameters.
    """
    orders = [int(m[1]) for n in starts if (m := re.fullmatch(r"A\[(\d+),\1\]", n))]
    if not orders:
        raise ControllerError("has no parameter A[1,1]: not a linear controller")
    n = max(orders)

    def matrix(letter: str, rows: int, columns: int) -> Any:
        return np.array(
            [[starts[f"{letter}[{i + 1},{j + 1}]"] for j in range(columns)] for i in range(rows)]
        ).reshape(rows, columns)

    scale = np.array([omega_b if name.endswith("_dw") else 1.0 for name in inputs])
    return LinearMatrices.named(
        matrix("A", n, n),
        matrix("B", n, len(inputs)) / scale,
        matrix("C", len(outputs), n),
        matrix("D", len(outputs), len(inputs)) / scale,
        inputs,
        outputs,
    )


def _are_names(provided: object) -> bool:
    """Whether these are different names that python-control takes too."""
    if not isinstance(provided, list) or not all(isinstance(name, str) for name in provided):
        return False
    return len(set(provided)) == len(provided) and not any("." in name for name in provided)


def guard_of(data: Any) -> Guard:
    """Return the guard that a controller's file or an FMU's record describes.

    Raises ControllerError naming the key at fault.
    """
    keys = [f.name for f in fields(Guard)]
    if not isinstance(data, dict) or not set(data) <= set(keys) or not {"watched", "sides"} <= set(data):
        got = list(data) if isinstance(data, dict) else type(data).__name__
        raise ControllerError(f"guard has {got}, allowed: {', '.join(keys)}")
    numbers = {k: float(data[k]) for k in keys[2:] if k in data and k != "follows"}
    sides = {k: float(v) for k, v in data["sides"].items()}
    watched = {y: s if isinstance(s, str) else tuple(s) for y, s in data["watched"].items()}
    return Guard(watched, sides, follows=data.get("follows"), **numbers)


def plain(value: Any) -> Any:
    """Return a value made of JSON types: arrays become lists, complex numbers [re, im]."""
    kind = type(value)
    if value is None or kind in (str, bool, int) or (kind is float and math.isfinite(value)):  # nearly all
        return value
    if isinstance(value, Mapping):
        return {str(k): plain(v) for k, v in value.items()}
    if isinstance(value, np.ndarray | list | tuple | set):
        return [plain(v) for v in value]
    if isinstance(value, bool | np.bool_):
        return bool(value)
    if isinstance(value, complex | np.complexfloating):
        return [float(value.real), float(value.imag)]
    if isinstance(value, int | np.integer):
        return int(value)
    if isinstance(value, float | np.floating):
        return float(value) if math.isfinite(value) else None
    return str(value)


def document(value: Any) -> str:
    """Return nested JSON values as an HTML fragment.

    >>> document({"stable": True, "caps": [[0.05, 0.02], [2.5, 0.1]]})
    '<table><tr><th>stable</th><td>yes</td></tr><tr><th>caps</th><td>0.05, 0.02; 2.5, 0.1</td></tr></table>'
    """
    if value is None or (isinstance(value, str | list | dict) and not value):
        return "–"
    if isinstance(value, dict):
        rows = (f"<tr><th>{html.escape(k)}</th><td>{document(v)}</td></tr>" for k, v in value.items())
        return f"<table>{''.join(rows)}</table>"
    if isinstance(value, list):
        return _document_of_list(value)
    if isinstance(value, bool):
        return "yes" if value else "no"
    if isinstance(value, float):
        return f"{value:.6g}".replace("-", "−")
    return html.escape(str(value))


def _document_of_list(values: list[Any]) -> str:
    """Return a table of rows, or values with commas, or rows of values with semicolons, as HTML."""
    if all(isinstance(row, dict) for row in values):
        keys = list(dict.fromkeys(key for row in values for key in row))
        head = "".join(f"<th>{html.escape(key)}</th>" for key in keys)
        body = ("".join(f"<td>{document(row.get(key, ''))}</td>" for key in keys) for row in values)
        return f"<table><tr>{head}</tr>{''.join(f'<tr>{cells}</tr>' for cells in body)}</table>"
    separator = "; " if any(isinstance(v, list) for v in values) else ", "
    return separator.join(document(v) for v in values)
