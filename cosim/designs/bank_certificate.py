"""The certificate of a bank of controllers, recomputed from its file or from its FMU alone."""

from __future__ import annotations

import zipfile
import zlib
from pathlib import Path

import control

from interarea.design.certificates.switching import (
    BankLoop,
    SwitchingCertificate,
    proven_decay,
    switching_certificate,
)
from interarea.design.controllers.bank import ControllerBank, bank_of_record, load_controller
from interarea.design.controllers.controller import Controller, ControllerError
from interarea.fmu_build.open.fmu_file import describe
from interarea.models.blocks.binary_table import unpack_record

RECORD = "resources/model.bin"


def bank_from_fmu(path: Path, omega_b: float) -> ControllerBank:
    """Read a bank from the supervisor FMU that `ControllerBank.block` made; speeds become rad/s.

    Raises
    ------
    ControllerError : no such file, or the FMU of something else.
    """
    if not path.is_file():
        raise ControllerError(f"controller FMU {path}: not found")
    description = describe(path)
    variables = {v.name: v for v in description.variables}
    inputs = [n for n, v in variables.items() if v.causality == "input" and f"{n}_valid" in variables]
    outputs = [n for n, v in variables.items() if v.causality == "output" and v.type == "Real"]
    members = [n.removesuffix(".weight") for n in variables if n.endswith(".weight") and "der(" not in n]
    if not inputs or not members:
        raise ControllerError(f"controller FMU {path}: holds no bank of controllers")
    with zipfile.ZipFile(path) as archive:
        try:
            arrays = unpack_record(archive.read(RECORD))
        except (KeyError, ValueError, zipfile.BadZipFile, zlib.error) as error:
            raise ControllerError(f"controller FMU {path}: {RECORD}: {error}") from error
    numbers = {n: v.number("start") or 0.0 for n, v in variables.items() if v.causality == "parameter"}
    return bank_of_record(description.name, members, inputs, outputs, arrays, numbers, omega_b)


def any_bank(name: str, omega_b: float) -> ControllerBank | None:
    """Return the bank that a JSON file or an FMU holds; None where it holds one controller."""
    path = Path(name)
    if path.suffix == ".fmu":
        try:
            return bank_from_fmu(path, omega_b)
        except ControllerError as error:
            if "holds no bank" in str(error):
                return None
            raise
    if not path.is_file():
        return None
    made = load_controller(path)
    return None if isinstance(made, Controller) else made


def certify_bank(plant: control.StateSpace, bank: ControllerBank) -> SwitchingCertificate:
    """Return the switching certificate of a bank on a full plant (speeds in rad/s).

    The Lyapunov matrix that comes with the bank is checked; one is sought where it brings none or its own
    proves nothing for this plant.
    """
    loop = BankLoop(plant, bank)
    P = bank.lyapunov
    if P is not None and P.shape == (loop.order, loop.order):
        corners = loop.corners()
        rate = proven_decay(corners, P)
        if rate > 0.0:
            return SwitchingCertificate.of_common(corners, P, rate)
    return switching_certificate(plant, bank)[0]
