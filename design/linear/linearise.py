"""From a nonlinear plant to a linear system: exact matrices, checked, reference angle removed once.

The plant supplies its own Jacobians; nothing here trusts them. Central differences at
two steps must agree with each other and with the exact matrices, so that an active limit,
a slope discontinuity at the operating point or a wrong derivative is an error and not a wrong eigenvalue.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, TypeVar

import numpy as np
from numpy.typing import NDArray

from interarea.models.errors import InterareaError, UserError

from .matrices import LinearMatrices
from .systems import state_space

if TYPE_CHECKING:
    import control

    from interarea.models.blocks.linear_plant import Plant

Matrix = NDArray[np.float64]
#: the functions below return the kind of system that they get: python-control takes a second to load
Linear = TypeVar("Linear", "control.StateSpace", LinearMatrices)

#: factor on the steps of the columns whose differences disagree, before they are refused
SMALLER = 1e-2


class LinearisationError(InterareaError, ValueError):
    """The linear model would not describe the plant at this operating point."""


def linearise(
    plant: Plant, *, rest: float = 1e-7, step: float = 1e-5, tolerance: float = 1e-6
) -> control.StateSpace:
    r"""Linearise a plant at its operating point.

    :math:`\dot x = f(x, u),\ y = h(x, u)` at :math:`f(x_0, u_0) = 0` gives
    :math:`A = \partial f/\partial x` and so on, taken from ``plant.jacobians()``. The
    differences :math:`D_h = (f(x_0 + h e_i) - f(x_0 - h e_i))/2h` at h and 2h must agree with each
    other, and :math:`(4 D_h - D_{2h})/3` with the exact column, to `tolerance` of the largest
    entry of the row.

    Parameters
    ----------
    plant : anything that follows the `Plant` protocol; n states, m inputs, p outputs.
    rest : largest \|dx/dt\| accepted at the operating point, unit of the state per second.
    step : step of the differences, relative to max(1, \|x_i\|).
    tolerance : largest relative disagreement.

    Returns
    -------
    StateSpace with A (n, n), B (n, m), C (p, n), D (p, m) and the plant's names (outputs with `_` for a dot);
    speeds in pu.

    Raises
    ------
    LinearisationError : not at rest, not finite, or derivatives that disagree (named).
    """
    x0, u0 = (np.asarray(v, dtype=float) for v in plant.operating_point())
    states, inputs, outputs = list(plant.state_names), list(plant.input_names), list(plant.output_names)
    dx0, _ = plant.derivatives(x0, u0)
    worst = int(np.argmax(np.where(np.isfinite(dx0), np.abs(dx0), np.inf))) if x0.size else 0
    if x0.size and not abs(dx0[worst]) <= rest:
        raise LinearisationError(
            f"the plant is not in equilibrium: d {states[worst]}/dt = {dx0[worst]:.3g} at its operating "
            f"point; allowed: {rest:g}; solve the equilibrium before linearising"
        )
    A, B, C, D = (np.asarray(M, dtype=float) for M in plant.jacobians())
    exact = np.block([[A, B], [C, D]])
    if exact.shape != (len(states) + len(outputs), len(states) + len(inputs)):
        raise LinearisationError(
            f"Jacobians of shape {exact.shape} for {len(states)} states, {len(inputs)} inputs and "
            f"{len(outputs)} outputs; the plant must return A, B, C, D in the order of its names"
        )
    if not np.all(np.isfinite(exact)):
        row, col = np.argwhere(~np.isfinite(exact))[0]
        raise LinearisationError(f"d {(states + outputs)[row]} / d {(states + inputs)[col]} is not finite")
    _check_differences(plant, x0, u0, exact, step, tolerance)
    import control

    labels = [name.replace(".", "_") for name in outputs]  # python-control takes no dots there
    return control.ss(A, B, C, D, states=states, inputs=inputs, outputs=labels)


def _like(
    system: Linear,
    matrices: tuple[Matrix, Matrix, Matrix, Matrix],
    states: list[str],
    inputs: list[str],
    outputs: list[str],
) -> Linear:
    """Return a system of the kind and name of another."""
    if isinstance(system, LinearMatrices):
        return LinearMatrices(*matrices, states, inputs, outputs)
    import control

    name = {"name": system.name} if system.name else {}
    return control.ss(*matrices, states=states, inputs=inputs, outputs=outputs, **name)


def _one_sided(plant: Plant, z0: Matrix, n: int, i: int, h: float, at_rest: Matrix) -> Matrix:
    """Return the differences of second order on the side of `h` from the operating point."""
    ends = []
    for step in (h, 2.0 * h):
        z = z0.copy()
        z[i] += step
        ends.append(np.concatenate(plant.derivatives(z[:n], z[n:])))
    return np.asarray((4.0 * ends[0] - ends[1] - 3.0 * at_rest) / (2.0 * h))


def _check_differences(plant: Plant, x0: Matrix, u0: Matrix, exact: Matrix, step: float, tol: float) -> None:
    """Raise unless differences at two steps agree with each other and with the exact matrices."""
    z0 = np.concatenate([x0, u0])
    n = x0.size

    def column(i: int, h: float) -> Matrix:
        ends = []
        for sign in (1.0, -1.0):
            z = z0.copy()
            z[i] += sign * h
            dx, y = plant.derivatives(z[:n], z[n:])
            ends.append(np.concatenate([dx, y]))
        return np.asarray((ends[0] - ends[1]) / (2.0 * h))

    def differences(columns: NDArray[np.intp]) -> tuple[Matrix, Matrix]:
        return (
            np.column_stack([column(i, steps[i]) for i in columns]),
            np.column_stack([column(i, 2.0 * steps[i]) for i in columns]),
        )

    def errors() -> tuple[Matrix, Matrix]:
        return np.abs(one - two) / scale, np.abs((4.0 * one - two) / 3.0 - exact) / scale

    steps = step * np.maximum(1.0, np.abs(z0))
    scale = np.maximum(np.max(np.abs(exact), axis=1, keepdims=True), 1.0)
    one, two = differences(np.arange(z0.size))
    # a steep gain reaches its limit within the step: the limit acts only if it does within a smaller one too
    again = np.flatnonzero(~np.all(np.maximum(*errors()) <= tol, axis=0))
    if again.size:
        steps[again] *= SMALLER
        one[:, again], two[:, again] = differences(again)
    # at a limit the exact derivatives are those of one side
    two_sided = np.all(np.maximum(*errors()) <= tol, axis=0)
    at_rest = np.concatenate(plant.derivatives(x0, u0))
    for i in np.flatnonzero(~two_sided):
        sides = [_one_sided(plant, z0, n, int(i), sign * steps[i], at_rest) for sign in (1.0, -1.0)]
        agrees = np.any([np.abs(side - exact[:, i]) <= tol * scale[:, 0] for side in sides], axis=0)
        one[agrees, i] = two[agrees, i] = exact[agrees, i]
    rows = [f"d({name})/dt" for name in plant.state_names] + list(plant.output_names)
    cols = list(plant.state_names) + list(plant.input_names)
    for what, error in (
        ("differences at two steps disagree", errors()[0]),
        ("the exact Jacobian disagrees with differences", errors()[1]),
    ):
        if not np.all(error <= tol):
            row, col = np.unravel_index(int(np.argmax(np.nan_to_num(error, nan=np.inf))), error.shape)
            raise LinearisationError(
                f"{what}: {rows[row]} with respect to {cols[col]}, exact {exact[row, col]:.9g}, differences "
                f"{one[row, col]:.9g} and {two[row, col]:.9g} (step {steps[col]:g} and twice that), allowed "
                f"is {tol:g} of the row's largest entry; is a limit active at the operating point?"
            )


def remove_reference(system: Linear, *, tolerance: float = 1e-7) -> Linear:
    r"""Take out the zero mode of the reference angle, once, by going over to relative angles.

    With r = 1 on every angle (rotors: states ``*.delta``, phase-locked loops: ``*.theta``) and 0 elsewhere, a
    plant without an infinite bus has :math:`A r = 0`: only angle differences act. If the outputs do not
    see r either
    (:math:`C r = 0`), the states z = x_i - r_i x_ref with the reference angle left out satisfy

    .. math:: \dot z = P A E z + P B u, \qquad y = C E z + D u

    exactly, where P subtracts the reference row from the other angles and E drops its column.
    The transfer function is unchanged and every other eigenvalue stays where it is. With constant
    mechanical torque and no damping torque a second zero remains (the common speed); it is a
    mode of the plant, and reductions keep it.

    Parameters
    ----------
    system : n states, at least one named ``*.delta``.
    tolerance : allowed \|A r\|, \|C r\| relative to the largest entries in those columns.

    Returns
    -------
    StateSpace with n - 1 states; angles are named ``G2.delta-G1.delta``.

    Raises
    ------
    LinearisationError : no angle states, or the angles have a reference already (infinite
        bus, relative angles, or called twice).
    """
    names = list(system.state_labels)
    angles = [i for i, name in enumerate(names) if name.endswith((".delta", ".theta"))]
    if not angles:
        raise LinearisationError(
            "no rotor angle to refer to: none of the states is named '*.delta'; "
            "was the reference removed already? (it is removed once)"
        )
    A, B, C = (np.asarray(M, dtype=float) for M in (system.A, system.B, system.C))
    for what, M in (("A", A), ("C", C)):
        if M.shape[0] == 0:
            continue
        drift = np.abs(M[:, angles].sum(axis=1))
        scale = np.maximum(
            np.max(np.abs(M[:, angles]), axis=1), 1e-6 * max(1.0, np.max(np.abs(M[:, angles])))
        )
        worst = int(np.argmax(drift / scale))
        if not drift[worst] <= tolerance * scale[worst]:
            row = names[worst] if what == "A" else list(system.output_labels)[worst]
            raise LinearisationError(
                f"the angles have a reference already: a common rotation of all rotors moves {row} by "
                f"{drift[worst]:.3g} per rad (allowed {tolerance * scale[worst]:.1g}); an infinite bus or an "
                "absolute angle output has no zero mode to remove"
            )
    ref = angles[0]
    keep = [i for i in range(len(names)) if i != ref]
    P = np.eye(len(names))
    P[[i for i in angles if i != ref], ref] = -1.0
    P = P[keep]
    states = [f"{names[i]}-{names[ref]}" if i in angles else names[i] for i in keep]
    matrices = ((P @ A)[:, keep], P @ B, C[:, keep], system.D)
    return _like(system, matrices, states, list(system.input_labels), list(system.output_labels))


def bus_frequencies(
    system: Linear, at_rest: Mapping[str, float], signals: Mapping[str, int], omega_b: float
) -> Linear:
    r"""Put bus frequencies in place of the bus voltages ``bus7_re``, ``bus7_im`` among the outputs.

    With :math:`\theta = C_\theta x` the angle of a bus, whose row follows from those of its voltage,
    :math:`\dot\theta/\omega_b = C_\theta (A x + B u)/\omega_b`: which has no reference, unlike the voltages.

    Parameters
    ----------
    at_rest : outputs of the plant at the operating point, by its names. omega_b : rated speed, rad/s.
    signals : name of an output (it takes the place of one of that name) -> number of the bus, whose
        ``re`` and ``im`` are outputs; frequencies in pu.
    """
    labels = [str(n) for n in system.output_labels]
    C, D = np.asarray(system.C, dtype=float), np.asarray(system.D, dtype=float)
    rows: dict[str, tuple[Matrix, Matrix]] = {
        n: (C[k], D[k]) for k, n in enumerate(labels) if not n.endswith(("_re", "_im"))
    }
    for name, bus in signals.items():
        re, im = at_rest[f"bus{bus}.re"], at_rest[f"bus{bus}.im"]
        theta = re * C[labels.index(f"bus{bus}_im")] - im * C[labels.index(f"bus{bus}_re")]
        theta = theta / (re * re + im * im) / omega_b
        rows[name] = (theta @ system.A, theta @ system.B)
    states, inputs = list(system.state_labels), list(system.input_labels)
    C, D = (np.array([row[k] for row in rows.values()]) for k in (0, 1))
    return _like(system, (system.A, system.B, C, D), states, inputs, list(rows))


def scaled_inputs(system: control.StateSpace, factor_of: Mapping[str, float]) -> control.StateSpace:
    """Return a system with named inputs multiplied by a factor; others as they are."""
    labels = list(system.input_labels)
    scale = np.array([factor_of.get(str(name), 1.0) for name in labels])
    matrices = (system.A, system.B * scale, system.C, system.D * scale)
    return _like(system, matrices, list(system.state_labels), labels, list(system.output_labels))


def with_input(system: control.StateSpace, name: str | None) -> control.StateSpace:
    """Return a system with an input of this name too, which it does not answer; with None as it is."""
    labels = list(system.input_labels)
    if name is None or name in labels:
        return system
    B, D = (np.hstack([M, np.zeros((M.shape[0], 1))]) for M in (system.B, system.D))
    matrices = (system.A, B, system.C, D)
    return _like(system, matrices, list(system.state_labels), [*labels, name], list(system.output_labels))


def speeds_in_rad(system: Linear, omega_b: float) -> Linear:
    """Scale the outputs ``*_dw`` from per unit to rad/s (dw_rad = omega_b dw_pu); the design's unit.

    omega_b : rated speed, rad/s. States and all other outputs stay as they are.
    """
    if not (np.isfinite(omega_b) and omega_b > 0.0):
        raise ValueError(f"omega_b = {omega_b!r} rad/s: must be positive, 2 pi 60 = 376.99 for 60 Hz")
    labels = list(system.output_labels)
    scale = np.array([omega_b if name.endswith("_dw") else 1.0 for name in labels])
    matrices = (system.A, system.B, scale[:, None] * system.C, scale[:, None] * system.D)
    return _like(system, matrices, list(system.state_labels), list(system.input_labels), labels)


def select(
    system: Linear,
    inputs: list[str] | tuple[str, ...] | None = None,
    outputs: list[str] | tuple[str, ...] | dict[str, dict[str, float]] | None = None,
) -> Linear:
    """Pick named inputs and outputs, or weighted sums of outputs, of a system.

    outputs : names, or {new name: {output: weight}} such as ``{"dw24": {"G2_dw": 1, "G4_dw": -1}}``.

    Raises UserError naming an unknown signal and the known ones, or what is no linear system.
    """
    if not isinstance(system, LinearMatrices):
        state_space(system, "plant")
    known_in, known_out = list(system.input_labels), list(system.output_labels)
    selected_inputs = known_in if inputs is None else list(inputs)
    combos: dict[str, dict[str, float]] = (
        dict(outputs)
        if isinstance(outputs, dict)
        else {name: {name: 1.0} for name in (known_out if outputs is None else outputs)}
    )
    for kind, requested, known in (
        ("input", selected_inputs, known_in),
        ("output", [o for combo in combos.values() for o in combo], known_out),
    ):
        for name in requested:
            if name not in known:
                raise UserError(f"unknown {kind} {name!r} of the plant; known are {', '.join(known)}")
    pick = np.array([known_in.index(name) for name in selected_inputs], dtype=int)
    W = np.zeros((len(combos), len(known_out)))
    for k, combo in enumerate(combos.values()):
        for name, weight in combo.items():
            W[k, known_out.index(name)] += weight
    matrices = (system.A, system.B[:, pick], W @ system.C, W @ system.D[:, pick])
    return _like(system, matrices, list(system.state_labels), selected_inputs, list(combos))
