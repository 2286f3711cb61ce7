"""A bank of controllers, one for each set of signals that can be trusted: active fault tolerance.

Every controller of the bank runs all the time; the supervisor in C (`models/c/controller/supervisor.c`)
follows the validity flags of the signals and fades from one output to the other.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Collection, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from interarea.models.blocks.controller import Guard
from interarea.models.blocks.supervisor import MAX_BANK, MAX_SIGNALS, Matrices, supervisor_block
from interarea.models.blocks.variables import Block
from interarea.models.documents import DocumentError, parse_json, read_document
from interarea.models.files import write_whole

from ..linear.matrices import LinearMatrices
from ..lmi.problem import Matrix
from .controller import Controller, ControllerError, document, guard_of, plain, table_html
from .json_text import json_text

SCHEMA = 1
OFF = "off"  #: the member that does nothing, for sets of signals no controller can live on


@dataclass(frozen=True)
class ControllerBank:
    """Controllers in order of preference; the first whose signals are all trusted is active.

    Attributes
    ----------
    name : a C identifier.
    members : each reads only the signals it needs; all drive the same actuators. Names differ.
    limit_pu : bound of the magnitude of every output.
    fade_s : time constant of the bumpless transfer, 0 = at once.
    loss_s, return_s : how long a flag is down, or up again, before it is believed.
    design : how it was made, JSON values.
    certificate : what was proven (`switching.SwitchingCertificate.as_dict`), None before.
    lyapunov : the matrix of that proof, states of the plant first; None where there is none.
    guard : which side of the limit falls while a first swing lasts, whoever acts; its threshold in rad/s.
        Those of members are not regarded.
    """

    name: str
    members: tuple[Controller, ...]
    limit_pu: float = 0.15
    fade_s: float = 0.05
    loss_s: float = 0.0
    return_s: float = 1.0
    design: Mapping[str, Any] = field(default_factory=dict)
    certificate: Mapping[str, Any] | None = None
    lyapunov: Matrix | None = None
    guard: Guard | None = None

    def __post_init__(self) -> None:
        if not self.name.isidentifier():
            raise ControllerError(f"bank: name is {self.name!r}, wanted letters, digits and _")
        names = [member.name for member in self.members]
        if not 1 <= len(names) < MAX_BANK or len({*names, OFF}) != len(names) + 1:
            raise ControllerError(
                f"bank {self.name}: members are {names}, wanted 1 to {MAX_BANK - 1} different names "
                f"other than {OFF!r}"
            )
        for member in self.members:
            if member.outputs != self.members[0].outputs:
                raise ControllerError(
                    f"bank {self.name}: {member.name} drives {', '.join(member.outputs)}, "
                    f"{names[0]} drives {', '.join(self.members[0].outputs)}; all must drive the same"
                )
        if len(self.inputs) > MAX_SIGNALS:
            raise ControllerError(
                f"bank {self.name}: {len(self.inputs)} signals, allowed: at most {MAX_SIGNALS}"
            )
        for key in ("limit_pu", "fade_s", "loss_s", "return_s"):
            value = getattr(self, key)
            least = "positive" if key == "limit_pu" else "not negative"
            if not (math.isfinite(value) and (value > 0.0 or (value == 0.0 and key != "limit_pu"))):
                raise ControllerError(f"bank {self.name}: {key} is {value}, wanted finite and {least}")
        self._check_guard()

    def _check_guard(self) -> None:
        if self.guard is not None:
            try:
                self.guard.check(self.name, self.inputs, self.outputs)
            except ValueError as error:
                raise ControllerError(str(error)) from error

    def _repr_html_(self) -> str:
        lines = {
            k.name: f"{', '.join(k.inputs)} to {', '.join(k.outputs)}, order {k.order}" for k in self.members
        }
        return table_html(f"bank {self.name}: the first whose signals are trusted is active", lines)

    @property
    def inputs(self) -> tuple[str, ...]:
        """Names of all signals, in the order in which the members name them."""
        return tuple(dict.fromkeys(signal for member in self.members for signal in member.inputs))

    @property
    def outputs(self) -> tuple[str, ...]:
        """Names of the actuators."""
        return self.members[0].outputs

    @property
    def order(self) -> int:
        """States of all members together."""
        return sum(member.order for member in self.members)

    def active(self, trusted: Sequence[str]) -> str:
        """Return the name of the member that is active while just these signals are trusted."""
        have = set(trusted)
        return next((m.name for m in self.members if have.issuperset(m.inputs)), OFF)

    def acting(self, lost: Collection[str]) -> Controller:
        """Return the member that is active while these signals are lost; where none is, one of gain 0."""
        name = self.active([s for s in self.inputs if s not in lost])
        member = next((m for m in self.members if m.name == name), None)
        return self.members[0].scaled(0.0) if member is None else member

    def signal_sets(self) -> list[tuple[str, ...]]:
        """Return every set of trusted signals, the full one first."""
        n = len(self.inputs)
        return [c for size in range(n, -1, -1) for c in itertools.combinations(self.inputs, size)]

    def matrices(self) -> dict[str, Matrices]:
        """Return member -> (A, B, C, D) with a column of B and D for each signal of the bank; OFF if used."""
        matrices: dict[str, Matrices] = {}
        for member in self.members:
            K, columns = member.matrices, [self.inputs.index(s) for s in member.inputs]
            B, D = np.zeros((len(K.A), len(self.inputs))), np.zeros((len(K.C), len(self.inputs)))
            B[:, columns], D[:, columns] = K.B, K.D
            matrices[member.name] = (np.asarray(K.A), B, np.asarray(K.C), D)
        if any(self.active(s) == OFF for s in self.signal_sets()):
            m, p = len(self.inputs), len(self.outputs)
            matrices[OFF] = (np.zeros((0, 0)), np.zeros((0, m)), np.zeros((p, 0)), np.zeros((p, m)))
        return matrices

    def block(self, omega_b: float) -> Block:
        """Return the supervisor's block: speeds in pu, actuators in pu. `omega_b`: base speed, rad/s."""
        if not (omega_b > 0.0 and math.isfinite(omega_b)):
            raise ControllerError(f"bank {self.name}: omega_b is {omega_b}, wanted a positive number, rad/s")
        scale = np.array([omega_b if name.endswith("_dw") else 1.0 for name in self.inputs])
        bank = {who: (A, B * scale, C, D * scale) for who, (A, B, C, D) in self.matrices().items()}
        choice = [
            self.active([s for j, s in enumerate(self.inputs) if word >> j & 1])
            for word in range(2 ** len(self.inputs))
        ]
        documentation = {"Design": document(plain(self.design))}
        if self.certificate is not None:
            documentation["Switching certificate"] = document(plain(self.certificate))
        return supervisor_block(
            self.name,
            bank,
            choice,
            self.inputs,
            self.outputs,
            limit=self.limit_pu,
            fade_s=self.fade_s,
            loss_s=self.loss_s,
            return_s=self.return_s,
            guard=None if self.guard is None else self.guard.in_pu(omega_b),
            extra={} if self.lyapunov is None else {"lyapunov": self.lyapunov},
            documentation=documentation,
            provenance={"method": str(self.design.get("method", "given")), "order": str(self.order)},
        )

    def save(self, path: str | Path) -> Path:
        """Write the bank as JSON; every number survives to the last bit."""
        return write_whole(path, json_text(self.as_dict()))

    def as_dict(self) -> dict[str, Any]:
        """Return the bank as JSON values, which `load_controller` reads from a file."""
        return {
            "schema": SCHEMA,
            "kind": "bank",
            "name": self.name,
            "limit_pu": self.limit_pu,
            "fade_s": self.fade_s,
            "loss_s": self.loss_s,
            "return_s": self.return_s,
            "members": [member.as_dict() for member in self.members],
            "design": plain(self.design),
            "certificate": None if self.certificate is None else plain(self.certificate),
            "lyapunov": None if self.lyapunov is None else np.asarray(self.lyapunov).tolist(),
            **({} if self.guard is None else {"guard": asdict(self.guard)}),
        }

    @classmethod
    def load(cls, path: str | Path) -> ControllerBank:
        """Read a bank written by `save`. Raises ControllerError naming the file and what is wrong."""
        controller = load_controller(path)
        if not isinstance(controller, ControllerBank):
            raise ControllerError(f"controller file {path}: one controller, wanted a bank")
        return controller


def bank_of_record(
    name: str,
    members: Sequence[str],
    inputs: Sequence[str],
    outputs: Sequence[str],
    arrays: Mapping[str, Any],
    parameters: Mapping[str, float],
    omega_b: float,
) -> ControllerBank:
    """Return the bank that an FMU holds: `arrays` of its record (pu), `parameters` by name; speeds in rad/s.

    Raises
    ------
    ControllerError : the arrays do not fit the names.
    """
    m, p = len(inputs), len(outputs)
    orders = [int(n) for n in arrays.get("orders", ())]
    sizes = {"A": [n * n for n in orders], "B": [n * m for n in orders], "C": [p * n for n in orders]}
    sizes["D"] = [p * m] * len(orders)
    wrong = [k for k, counts in sizes.items() if len(arrays.get(k, ())) != sum(counts)]
    if wrong or len(orders) != len(members):
        raise ControllerError(
            f"bank {name}: arrays {', '.join(wrong) or 'orders'} do not fit {len(members)} members"
        )
    parts = {k: np.split(np.asarray(arrays[k]), np.cumsum(counts)[:-1]) for k, counts in sizes.items()}
    scale = np.array([omega_b if signal.endswith("_dw") else 1.0 for signal in inputs])
    controllers = []
    for k, (who, n) in enumerate(zip(members, orders, strict=True)):
        if who != OFF:
            A, C = parts["A"][k].reshape(n, n), parts["C"][k].reshape(p, n)
            B, D = parts["B"][k].reshape(n, m) / scale, parts["D"][k].reshape(p, m) / scale
            controllers.append(
                Controller(who, _of_used_signals(A, B, C, D, inputs, outputs), parameters["limit"])
            )
    return ControllerBank(
        name,
        tuple(controllers),
        parameters["limit"],
        parameters["fade_time"],
        parameters["loss_time"],
        parameters["return_time"],
        lyapunov=_square(arrays.get("lyapunov")),
        guard=_guard(arrays.get("guard"), inputs, outputs, parameters, omega_b),
    )


def _guard(
    weights: Any,
    inputs: Sequence[str],
    outputs: Sequence[str],
    parameters: Mapping[str, float],
    omega_b: float,
) -> Guard | None:
    """Return the guard of an FMU's record and parameters; its threshold in rad/s."""
    if weights is None:
        return None
    rows = dict(zip(outputs, np.asarray(weights).reshape(len(outputs), len(inputs)), strict=True))
    seen = {y: tuple(s for s, weight in zip(inputs, row, strict=True) if weight) for y, row in rows.items()}
    watched = {y: signals[0] if len(signals) == 1 else signals for y, signals in seen.items() if signals}
    sides = {y: parameters[f"guard_side[{k}]"] for k, y in enumerate(watched, start=1)}
    numbers = (parameters[f"guard_{what}"] for what in ("threshold", "washout", "lowpass"))
    threshold, washout_s, lowpass_s = numbers
    return Guard(watched, sides, threshold * omega_b, washout_s, lowpass_s)


def _square(entries: Any) -> Matrix | None:
    return None if entries is None else np.asarray(entries).reshape(2 * (round(len(entries) ** 0.5),))


def _of_used_signals(
    A: Matrix, B: Matrix, C: Matrix, D: Matrix, inputs: Sequence[str], outputs: Sequence[str]
) -> LinearMatrices:
    """Return a member as a system of the inputs that it reads."""
    used = [j for j in range(len(inputs)) if np.any(B[:, j]) or np.any(D[:, j])]
    names = [inputs[j] for j in used]
    return LinearMatrices.named(A, B[:, used], C, D[:, used], names, outputs)


def load_controller(path: str | Path) -> Controller | ControllerBank:
    """Read a controller or a bank of controllers from its JSON file.

    Raises
    ------
    ControllerError : names the file and the key at fault.
    """
    try:
        data = parse_json(read_document(Path(path), "the JSON file of a controller"))
    except (OSError, DocumentError):
        return Controller.load(path)  # which says what is wrong with the file
    if not isinstance(data, dict) or data.get("kind") != "bank":
        return Controller.load(path)
    if data.get("schema") != SCHEMA:
        raise ControllerError(f"bank file {path}: schema is {data.get('schema')!r}, allowed: {SCHEMA}")
    try:
        members = tuple(Controller.from_dict(m) for m in data["members"])
        limits = {k: float(data[k]) for k in ("limit_pu", "fade_s", "loss_s", "return_s")}
        P = data.get("lyapunov")
        return ControllerBank(
            data["name"],
            members,
            **limits,
            design=data.get("design", {}),
            certificate=data.get("certificate"),
            lyapunov=None if P is None else np.array(P, dtype=float),
            guard=None if data.get("guard") is None else guard_of(data["guard"]),
        )
    except KeyError as error:
        raise ControllerError(f"bank file {path}: missing {error.args[0]}") from error
    except (TypeError, ValueError) as error:
        raise ControllerError(f"bank file {path}: {error}") from error
