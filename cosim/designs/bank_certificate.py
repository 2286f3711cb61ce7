"""The certificate of a bank of controllers, recomputed."""

from __future__ import annotations

import control

from interarea.design.certificates.switching import (
    BankLoop,
    SwitchingCertificate,
    proven_decay,
    switching_certificate,
)
from interarea.design.controllers.bank import ControllerBank


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
