"""Two-area system in plain numpy: the independent path of the tests.

Written apart from `models/` (nothing of ours is imported): power flow, sixth-order
machines, static exciter, stabilizer, steam governor, constant-impedance loads, dense
network. Everything is real arithmetic, so that one complex step differentiates the
whole right-hand side to rounding error.

Data: [Kundur1994], Ex. 12.6, and for ``two-area-thesis`` the capacitors, stabilizers
and governor fitted to [Sundaria2016], Table 5.1.

Per unit on the machine base (900 MVA) inside a machine, 100 MVA in the network;
angles rad, time s, speed deviation (slip) per unit.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cache
from itertools import pairwise

import control
import numpy as np
from numpy.typing import NDArray
from scipy.integrate import solve_ivp

OMEGA_B = 2.0 * np.pi * 60.0
RATIO = 9.0  # 900 MVA machine on the 100 MVA network base
MACHINES = ("G1", "G2", "G3", "G4")
AREAS = {"G1": 1, "G2": 1, "G3": 2, "G4": 2}
BUS_OF = {"G1": 1, "G2": 2, "G3": 3, "G4": 4}
N_BUS = 11

XD, XQ, XL, XD1, XQ1, X2, RA = 1.8, 1.7, 0.2, 0.3, 0.55, 0.25, 0.0025
TD01, TQ01, TD02, TQ02 = 8.0, 0.4, 0.03, 0.05
H = np.array([6.5, 6.5, 6.175, 6.175])

# name, from, to, r, x, b (pu on 100 MVA); step-up transformers first
BRANCHES: list[tuple[str, int, int, float, float, float]] = [
    (f"{a}-{b}", a, b, 0.0, 0.15 / RATIO, 0.0) for a, b in ((1, 5), (2, 6), (3, 11), (4, 10))
]
for _a, _b, _km, _names in (
    (5, 6, 25, ("5-6",)),
    (6, 7, 10, ("6-7",)),
    (7, 8, 110, ("7-8 a", "7-8 b")),
    (8, 9, 110, ("8-9 a", "8-9 b")),
    (9, 10, 10, ("9-10",)),
    (10, 11, 25, ("10-11",)),
):
    BRANCHES += [(_n, _a, _b, 1e-4 * _km, 1e-3 * _km, 1.75e-3 * _km) for _n in _names]

LOADS = {7: 9.67 + 1.0j, 9: 17.67 + 1.0j}
P_GEN = {1: 7.0, 2: 7.0, 4: 7.0}  # bus 3 is the slack
V_GEN = np.array([1.03, 1.01, 1.03, 1.01])
SLACK_ANGLE = np.deg2rad(-6.8)


@dataclass(frozen=True)
class Variant:
    """One parameter set of the two-area system; None leaves a device out."""

    capacitors: dict[int, float]
    ka: float | None = 200.0
    tr: float = 0.01
    ta: float = 0.001
    pss: dict[str, tuple[float, float, float, float]] = field(default_factory=dict)  # K, Tw, T1, T2
    governor: bool = False
    efd_limits: tuple[float, float] = (-20.0, 20.0)
    pss_limit: float = 0.15


VARIANTS = {
    "two-area-thesis": Variant(
        capacitors={7: 2.2287, 9: 3.7287},
        pss={"G1": (12.4424, 10.0, 0.1494, 0.0363), "G3": (10.7135, 10.0, 0.1186, 0.0363)},
        governor=True,
    ),
    "kundur-thyristor-z": Variant(capacitors={7: 2.0, 9: 3.5}),
    "kundur-manual-z": Variant(capacitors={7: 2.0, 9: 3.5}, ka=None),
}

# steam governor: droop, speed relay, servomotor, then the three stages and their shares
RP, TSR, TSM = 0.05, 0.001, 0.15
STAGE_T = np.array([0.5, 3.3, 10.0])
STAGE_F = np.array([0.28, 0.36, 0.36])
GATE_RATE, GATE = (-0.1, 0.1), (0.0, 4.496)


def admittance(out: tuple[str, ...] = (), shunts: dict[int, complex] | None = None) -> NDArray[np.complex128]:
    """Bus admittance matrix (11, 11), 100 MVA base, without the branches named in `out`."""
    Y = np.zeros((N_BUS, N_BUS), complex)
    for name, a, b, r, x, charging in BRANCHES:
        if name in out:
            continue
        y, i, j = 1.0 / (r + 1j * x), a - 1, b - 1
        Y[i, i] += y + 0.5j * charging
        Y[j, j] += y + 0.5j * charging
        Y[i, j] -= y
        Y[j, i] -= y
    for bus, y in (shunts or {}).items():
        Y[bus - 1, bus - 1] += y
    return Y


def power_flow(
    v: Variant, loads: dict[int, complex] = LOADS, out: tuple[str, ...] = ()
) -> NDArray[np.complex128]:
    """Bus voltages (11,) by Newton's method on a differenced mismatch; loads are constant power."""
    Y = admittance(out, {b: 1j * c for b, c in v.capacitors.items()})
    P = np.zeros(N_BUS)
    Q = np.zeros(N_BUS)
    for bus, p in P_GEN.items():
        P[bus - 1] += p
    for bus, s in loads.items():
        P[bus - 1] -= s.real
        Q[bus - 1] -= s.imag
    angle = [i for i in range(N_BUS) if i != 2]
    magnitude = list(range(4, N_BUS))

    def voltages(z: NDArray) -> NDArray:
        th, vm = np.full(N_BUS, SLACK_ANGLE, z.dtype), np.ones(N_BUS, z.dtype)
        vm[:4] = V_GEN
        th[angle], vm[magnitude] = z[: len(angle)], z[len(angle) :]
        return vm * np.exp(1j * th)

    def mismatch(z: NDArray) -> NDArray:
        V = voltages(z)
        S = V * np.conj(Y @ V)
        return np.r_[(S.real - P)[angle], (S.imag - Q)[magnitude]]

    z = np.r_[np.full(len(angle), SLACK_ANGLE), np.ones(len(magnitude))]
    for _ in range(30):
        f = mismatch(z)
        if np.max(np.abs(f)) < 1e-12:
            return voltages(z)
        J = np.column_stack(
            [(mismatch(z + 1e-6 * e) - mismatch(z - 1e-6 * e)) / 2e-6 for e in np.eye(z.size)]
        )
        z = z - np.linalg.solve(J, f)
    if np.max(np.abs(mismatch(z))) < 1e-9:
        return voltages(z)
    raise RuntimeError("power flow of the independent two-area model did not converge")


class TwoArea:
    """Nonlinear model: states, right-hand side, outputs, linearisation and fault simulation."""

    def __init__(
        self, variant: Variant, loads: dict[int, complex] = LOADS, out: tuple[str, ...] = ()
    ) -> None:
        self.v = variant
        self.out = out
        self.V0 = power_flow(variant, loads, out)
        self.shunts: dict[int, complex] = {b: 1j * c for b, c in variant.capacitors.items()}
        for bus, s in loads.items():
            self.shunts[bus] += np.conj(s) / abs(self.V0[bus - 1]) ** 2
        self.y_gen = RATIO / (RA + 1j * X2)
        self.network = self.stage(out)
        self.state_names = self._names()
        self.index = {n: i for i, n in enumerate(self.state_names)}
        self.input_names = tuple(f"{m}_vs" for m in MACHINES)
        self.output_names = (
            *(f"{m}_{q}" for m in MACHINES for q in ("dw", "delta", "pe", "vt")),
            "tie_p",
        )
        self.x0 = self._equilibrium()

    def _names(self) -> tuple[str, ...]:
        names: list[str] = []
        for m in MACHINES:
            names += [f"{m}.{s}" for s in ("delta", "slip", "eq1", "psi1d", "ed1", "psi2q")]
            if self.v.ka is not None:
                names += [f"{m}.vm", f"{m}.efd"]
            if m in self.v.pss:
                names += [f"{m}.washout", f"{m}.lead"]
            if self.v.governor:
                names += [f"{m}.relay", f"{m}.gate", f"{m}.stage1", f"{m}.stage2", f"{m}.stage3"]
        return tuple(names)

    def stage(self, out: tuple[str, ...] = (), fault: tuple[int, complex] | None = None) -> NDArray:
        """Real (22, 8) map from the machines' internal EMFs (re, im) to bus voltages (re, im)."""
        Y = admittance(out, self.shunts)
        Y[np.arange(4), np.arange(4)] += self.y_gen
        if fault is not None:
            Y[fault[0] - 1, fault[0] - 1] += 1.0 / fault[1]
        M = np.linalg.inv(Y)[:, :4] * self.y_gen
        return np.block([[M.real, -M.imag], [M.imag, M.real]])

    def _get(self, x: NDArray, what: str) -> NDArray:
        return np.array([x[self.index[f"{m}.{what}"]] for m in MACHINES])

    def _equilibrium(self) -> NDArray:
        Y = admittance(self.out, {b: 1j * c for b, c in self.v.capacitors.items()})
        V = self.V0[:4]
        I = ((Y @ self.V0)[:4]) / RATIO  # machine base
        delta = np.angle(V + (RA + 1j * XQ) * I)
        turn = np.exp(-1j * (delta - np.pi / 2))
        vdq, idq = V * turn, I * turn
        i_d, i_q = idq.real, idq.imag
        eq1 = vdq.imag + RA * i_q + XD1 * i_d
        ed1 = (XQ - XQ1) * i_q
        psi1d = eq1 - (XD1 - XL) * i_d
        psi2q = -ed1 - (XQ1 - XL) * i_q
        efd = eq1 + (XD - XD1) * i_d
        torque = (V * I.conj()).real + RA * np.abs(I) ** 2
        self.torque0, self.efd0 = torque, efd
        self.vref = np.abs(V) + (efd / self.v.ka if self.v.ka is not None else 0.0)
        x = np.zeros(len(self.state_names))
        values = {
            "delta": delta,
            "eq1": eq1,
            "psi1d": psi1d,
            "ed1": ed1,
            "psi2q": psi2q,
            "vm": np.abs(V),
            "efd": efd,
        }
        values |= dict.fromkeys(("relay", "gate", "stage1", "stage2", "stage3"), torque)
        for what, value in values.items():
            for k, m in enumerate(MACHINES):
                if f"{m}.{what}" in self.index:
                    x[self.index[f"{m}.{what}"]] = value[k]
        return x

    def derivatives(
        self,
        x: NDArray,
        u: NDArray,
        network: NDArray | None = None,
        vref_add: NDArray | float = 0.0,
    ) -> tuple[NDArray, NDArray]:
        """Right-hand side and outputs; `u` (4,) is added at the exciters' summing points, pu."""
        v, get = self.v, lambda what: self._get(x, what)
        delta, slip, eq1, psi1d, ed1, psi2q = map(get, ("delta", "slip", "eq1", "psi1d", "ed1", "psi2q"))
        gd, gq = (X2 - XL) / (XD1 - XL), (X2 - XL) / (XQ1 - XL)
        e_q = gd * eq1 + (1 - gd) * psi1d
        e_d = gq * ed1 - (1 - gq) * psi2q
        c, s = np.cos(delta), np.sin(delta)
        # network = (d + j q) exp(j (delta - pi/2))
        e_re, e_im = e_d * s + e_q * c, e_q * s - e_d * c
        V = (self.network if network is None else network) @ np.concatenate([e_re, e_im])
        v_re, v_im = V[:4], V[N_BUS : N_BUS + 4]
        g, b = RA / (RA**2 + X2**2), -X2 / (RA**2 + X2**2)
        i_re = g * (e_re - v_re) - b * (e_im - v_im)
        i_im = b * (e_re - v_re) + g * (e_im - v_im)
        i_d, i_q = i_re * s - i_im * c, i_re * c + i_im * s
        vt = np.sqrt(v_re**2 + v_im**2)
        pe = v_re * i_re + v_im * i_im
        te = pe + RA * (i_re**2 + i_im**2)

        kd, kq = (XD1 - X2) / (XD1 - XL) ** 2, (XQ1 - X2) / (XQ1 - XL) ** 2
        efd = np.asarray(get("efd") if v.ka is not None else self.efd0)
        d: dict[str, NDArray] = {
            "delta": OMEGA_B * slip,
            "eq1": (efd - eq1 - (XD - XD1) * (i_d - kd * (psi1d + (XD1 - XL) * i_d - eq1))) / TD01,
            "psi1d": (-psi1d + eq1 - (XD1 - XL) * i_d) / TD02,
            "ed1": (-ed1 + (XQ - XQ1) * (i_q - kq * (psi2q + (XQ1 - XL) * i_q + ed1))) / TQ01,
            "psi2q": (-psi2q - ed1 - (XQ1 - XL) * i_q) / TQ02,
        }
        tm = self.torque0.astype(x.dtype)
        if v.governor:
            relay, gate = get("relay"), get("gate")
            stages = np.array([get(f"stage{k}") for k in (1, 2, 3)])
            rate = np.where(
                np.abs(((relay - gate) / TSM).real) > GATE_RATE[1],
                np.sign((relay - gate).real) * GATE_RATE[1],
                (relay - gate) / TSM,
            )
            d["relay"] = (self.torque0 - slip / RP - relay) / TSR
            d["gate"] = np.where((gate.real <= GATE[0]) & (rate.real < 0), 0.0, rate)
            flow = np.vstack([gate, stages[:-1]])
            for k in range(3):
                d[f"stage{k + 1}"] = (flow[k] - stages[k]) / STAGE_T[k]
            tm = STAGE_F @ stages
        d["slip"] = (tm - te) / (2 * H)

        dx = np.zeros(x.size, np.result_type(x, u))
        vpss = np.zeros(4, dx.dtype)
        for k, m in enumerate(MACHINES):
            for what, value in d.items():
                dx[self.index[f"{m}.{what}"]] = value[k]
            if m in v.pss:
                K, tw, t1, t2 = v.pss[m]
                xw, xl = x[self.index[f"{m}.washout"]], x[self.index[f"{m}.lead"]]
                w = K * slip[k] - xw  # K s Tw / (1 + s Tw)
                dx[self.index[f"{m}.washout"]] = w / tw
                dx[self.index[f"{m}.lead"]] = (w - xl) / t2
                out = xl + t1 / t2 * (w - xl)
                vpss[k] = out if abs(out.real) <= v.pss_limit else np.sign(out.real) * v.pss_limit
        if v.ka is not None:
            vm = get("vm")
            lo, hi = v.efd_limits
            slope = (v.ka * (self.vref + vref_add + u + vpss - vm) - efd) / v.ta
            held = ((efd.real >= hi) & (slope.real > 0)) | ((efd.real <= lo) & (slope.real < 0))
            slope = np.where(held, 0.0, slope)
            for k, m in enumerate(MACHINES):
                dx[self.index[f"{m}.vm"]] = (vt[k] - vm[k]) / v.tr
                dx[self.index[f"{m}.efd"]] = slope[k]

        coi = (H @ delta) / H.sum()
        v7, v8 = V[[6, 6 + N_BUS]], V[[7, 7 + N_BUS]]
        p78 = 0.0
        for _, _a, _b, r, xx, _charging in (
            br for br in BRANCHES if br[0] in ("7-8 a", "7-8 b") and br[0] not in self.out
        ):
            gg, bs = r / (r * r + xx * xx), -xx / (r * r + xx * xx)
            dv = v7 - v8
            p78 = p78 + v7[0] * (gg * dv[0] - bs * dv[1]) + v7[1] * (bs * dv[0] + gg * dv[1])
        y = np.array([q for k in range(4) for q in (slip[k], delta[k] - coi, RATIO * pe[k], vt[k])] + [p78])
        return dx, y

    def jacobians(self) -> tuple[NDArray, NDArray, NDArray, NDArray]:
        """A, B, C, D by one complex step of 1e-30: exact to rounding."""
        n, m = self.x0.size, 4
        z = np.r_[self.x0, np.zeros(m)].astype(complex)
        J = []
        for i in range(n + m):
            w = z.copy()
            w[i] += 1e-30j
            dx, y = self.derivatives(w[:n], w[n:])
            J.append(np.r_[dx.imag, y.imag] / 1e-30)
        M = np.array(J).T
        return M[:n, :n], M[:n, n:], M[n:, :n], M[n:, n:]

    def simulate(
        self,
        stop_s: float,
        *,
        fault: tuple[int, float, float, complex] | None = None,
        trip: tuple[str, float] | None = None,
        vref_pulse: tuple[str, float, float, float] | None = None,
        step_s: float = 0.01,
    ) -> tuple[NDArray, NDArray]:
        """Trajectory (t, outputs) of the uncontrolled plant by DOP853, restarted at each event.

        fault: bus, start s, end s, impedance pu; trip: branch, start s; vref_pulse: machine,
        start s, end s, size pu.
        """
        times = sorted(
            {
                0.0,
                stop_s,
                *(fault[1:3] if fault else ()),
                *(trip[1:] if trip else ()),
                *(vref_pulse[1:3] if vref_pulse else ()),
            }
        )
        grid = np.arange(round(stop_s / step_s) + 1) * step_s
        x, ts, ys = self.x0.copy(), [], []
        for a, b in pairwise(times):
            mid = 0.5 * (a + b)
            out = self.out + ((trip[0],) if trip and mid > trip[1] else ())
            network = self.stage(out, (fault[0], fault[3]) if fault and fault[1] < mid < fault[2] else None)
            add = np.zeros(4)
            if vref_pulse and vref_pulse[1] < mid < vref_pulse[2]:
                add[MACHINES.index(vref_pulse[0])] = vref_pulse[3]

            def rhs(_t: float, z: NDArray, network: NDArray | None = network, add: NDArray = add) -> NDArray:
                return self.derivatives(z, np.zeros(4), network, add)[0]

            inside = grid[(grid >= a - 1e-12) & (grid < b - 1e-12)] if b < stop_s else grid[grid >= a - 1e-12]
            evaluate = np.unique(np.r_[np.clip(inside, a, b), b])
            sol = solve_ivp(rhs, (a, b), x, method="DOP853", rtol=1e-9, atol=1e-11, t_eval=evaluate)
            for k in range(inside.size):
                ts.append(inside[k])
                ys.append(self.derivatives(sol.y[:, k], np.zeros(4), network, add)[1])
            x = sol.y[:, -1]
        return np.array(ts), np.array(ys)


@cache
def two_area(name: str) -> TwoArea:
    """The nonlinear model of a variant at its base operating point."""
    return TwoArea(VARIANTS[name])


@cache
def linear_plant(name: str) -> control.StateSpace:
    """Full linear model (reference angle included): inputs G1_vs.., outputs as in the plant FMU, pu."""
    plant = two_area(name)
    return control.ss(
        *plant.jacobians(),
        states=list(plant.state_names),
        inputs=list(plant.input_names),
        outputs=list(plant.output_names),
        name=name,
    )
