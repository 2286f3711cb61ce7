#ifndef INTERAREA_MACHINE_H
#define INTERAREA_MACHINE_H
#include "layout.h"
#include "scalar.h"
/* Synchronous machines. Per unit on the machine base; q leads d by 90 degrees,
 * delta is the angle of the q axis to the synchronous frame; current out is
 * positive; stator transients and the speed terms in the stator and torque
 * equations are neglected.             [Kundur1994, ch. 3-5; GENROU of PSS/E]
 *
 * Sixth order (field, one d damper, two q dampers, leakage Xl; saturation: below).
 * With a = (Xd2 - Xl)/(Xd1 - Xl) and b = (Xq2 - Xl)/(Xq1 - Xl):
 *
 *        d delta/dt = omega_b slip
 *    2H  d slip/dt  = Tm - Te - D slip
 *   Td01 d eq1/dt   = Efd - eq1 - (Xd - Xd1) [a id + (eq1 - eq2)/(Xd1 - Xl)]
 *   Tq01 d ed1/dt   =     - ed1 + (Xq - Xq1) [b iq - (ed1 - ed2)/(Xq1 - Xl)]
 *        d eq2/dt   = a d eq1/dt + [eq1 - eq2 - (Xd1 - Xd2) id]/Td02
 *        d ed2/dt   = b d ed1/dt + [ed1 - ed2 + (Xq1 - Xq2) iq]/Tq02
 *
 * eq2, ed2 are the subtransient EMFs themselves: eq2 = a eq1 + (1-a) psi_kd,
 * ed2 = b ed1 + (1-b) psi_kq, the flux linkages psi of the outer dampers obeying
 * Td02 d psi_kd/dt = eq1 - psi_kd - (Xd1 - Xl) id, and alike in q. The bracket
 * after (Xd - Xd1) plus eq1 is the field current Xad ifd.
 *
 * Stator:  vd = ed2 - Ra id + Xq2 iq,   vq = eq2 - Ra iq - Xd2 id
 * Torque:  Te = ed2 id + eq2 iq + (Xq2 - Xd2) id iq
 *
 * Classical: eq2 = E constant (row M_EFD0), ed2 = 0, the reactances Xd1 on both
 * axes (rows M_XD2, M_XQ2); Te = E iq. These machines come last.        [ch. 5] */
typedef struct { const num *delta, *slip, *eq1, *ed1, *eq2, *ed2; } MachineStates;
typedef struct { num *delta, *slip, *eq1, *ed1, *eq2, *ed2; } MachineRates;

/* Fills the rows of the table that follow from the others, once at the start. */
static inline void machine_prepare(double *table, size_t n, size_t sixth)
{
    for (size_t k = 0; k < n; ++k) {
        double *m = table + k;
        m[M_PER_RATIO * n] = 1.0 / m[M_RATIO * n];
        m[M_PER_2H * n] = 1.0 / (2.0 * m[M_H * n]);
        if (k >= sixth) continue;
        m[M_LEAK_D * n] = 1.0 / (m[M_XD1 * n] - m[M_XL * n]);
        m[M_LEAK_Q * n] = 1.0 / (m[M_XQ1 * n] - m[M_XL * n]);
        m[M_A * n] = (m[M_XD2 * n] - m[M_XL * n]) * m[M_LEAK_D * n];
        m[M_B * n] = (m[M_XQ2 * n] - m[M_XL * n]) * m[M_LEAK_Q * n];
        m[M_PER_TD01 * n] = 1.0 / m[M_TD01 * n];
        m[M_PER_TD02 * n] = 1.0 / m[M_TD02 * n];
        m[M_PER_TQ01 * n] = 1.0 / m[M_TQ01 * n];
        m[M_PER_TQ02 * n] = 1.0 / m[M_TQ02 * n];
    }
}

/* States lie quantity by quantity at the start of x, of the first `sixth` machines
 * all six, of the classical ones after them only the first two. */
static inline MachineStates machine_states(const num *x, size_t n, size_t sixth)
{
    const num *e = x + 2 * n;
    return (MachineStates){ x, x + n, e, e + sixth, e + 2 * sixth, e + 3 * sixth };
}

static inline MachineRates machine_rates(num *dx, size_t n, size_t sixth)
{
    num *e = dx + 2 * n;
    return (MachineRates){ dx, dx + n, e, e + sixth, e + 2 * sixth, e + 3 * sixth };
}

/* Subtransient EMF in the network frame: E = (eq2 - j ed2) exp(j delta). */
static inline void machine_emf(const real *table, size_t n, size_t sixth, MachineStates x,
                               num *sine, num *cosine, num *e_re, num *e_im)
{
    for (size_t k = 0; k < sixth; ++k) {
        num_sincos(x.delta[k], &sine[k], &cosine[k]);
        e_re[k] = x.eq2[k] * cosine[k] + x.ed2[k] * sine[k];
        e_im[k] = x.eq2[k] * sine[k] - x.ed2[k] * cosine[k];
    }
    for (size_t k = sixth; k < n; ++k) {
        num_sincos(x.delta[k], &sine[k], &cosine[k]);
        e_re[k] = table[M_EFD0 * n + k] * cosine[k];
        e_im[k] = table[M_EFD0 * n + k] * sine[k];
    }
}

/* Network current (system base) -> id, iq; terminal voltage vd, vq, |V|. */
static inline void machine_terminal(const real *table, size_t n, size_t sixth, MachineStates x,
                                    const num *sine, const num *cosine,
                                    const num *i_re, const num *i_im,
                                    num *id, num *iq, num *vd, num *vq, num *vt)
{
    const real *per_ratio = table + M_PER_RATIO * n, *Ra = table + M_RA * n;
    const real *Xd2 = table + M_XD2 * n, *Xq2 = table + M_XQ2 * n;

    for (size_t k = 0; k < n; ++k) {
        const num iq_system = i_re[k] * cosine[k] + i_im[k] * sine[k];
        const num id_system = i_re[k] * sine[k] - i_im[k] * cosine[k];
        iq[k] = iq_system * per_ratio[k];
        id[k] = id_system * per_ratio[k];
        const num ed2 = k < sixth ? x.ed2[k] : NUM(0.0);
        const num eq2 = k < sixth ? x.eq2[k] : NUM(table[M_EFD0 * n + k]);
        vd[k] = ed2 - Ra[k] * id[k] + Xq2[k] * iq[k];
        vq[k] = eq2 - Ra[k] * iq[k] - Xd2[k] * id[k];
        vt[k] = num_sqrt(vd[k] * vd[k] + vq[k] * vq[k]);
    }
}

/* Explicit saturation, of a flux that is a state: S of the subtransient flux linkage on
 * both axes (GENROU, GENROE, GENSAE), or of eq1 (GENSAL).
 *
 *     E S(E) = B (E - A)^2 above A (kind 1),  or  B E^(1 + A) (kind 2)
 *
 * S eq2 (or S eq1) adds to the field current, S ed2 (Xq - Xl)/(Xd - Xl) to what drives ed1;
 * with one damper in the q axis (Xq1 = Xq: ed1 stays 0) to what drives ed2. */
enum { SATURATES_QUADRATIC = 1, SATURATES_EXPONENTIAL };

static inline void machine_saturation_of(const real *table, size_t n, size_t k, MachineStates x, num *d, num *q)
{
    const real A = table[M_SAT_A * n + k], B = table[M_SAT_B * n + k];
    const int of_emf = index_at(table, M_SAT_EMF * n + k) != 0;
    const num flux = of_emf ? x.eq1[k] : num_sqrt(x.eq2[k] * x.eq2[k] + x.ed2[k] * x.ed2[k]);
    const num bounded = num_pick(num_above(flux, NUM(1e-3)), flux, NUM(1e-3));
    const num excess = num_pick(num_above(flux, NUM(A)), flux - A, NUM(0.0));
    const num s = index_at(table, M_SATURATES * n + k) == SATURATES_QUADRATIC
        ? num_ratio(B * excess * excess, bounded) : B * num_exp(A * num_log(bounded));
    *d = s * (of_emf ? x.eq1[k] : x.eq2[k]);
    *q = s * x.ed2[k];
}

static inline void machine_saturation(const real *table, size_t n, size_t sixth, MachineStates x, MachineRates dx)
{
    for (size_t k = 0; k < sixth; ++k) {
        num d, q;
        if (index_at(table, M_SATURATES * n + k) == 0) continue;
        machine_saturation_of(table, n, k, x, &d, &q);
        d = d * table[M_PER_TD01 * n + k];
        const num q1 = q * (table[M_SAT_Q1 * n + k] * table[M_PER_TQ01 * n + k]);
        dx.eq1[k] -= d;
        dx.eq2[k] -= table[M_A * n + k] * d;
        dx.ed1[k] -= q1;
        dx.ed2[k] -= table[M_B * n + k] * q1 + q * (table[M_SAT_Q2 * n + k] * table[M_PER_TQ02 * n + k]);
    }
}

/* Field currents in per unit of the field voltage that holds them, Xad ifd. */
static inline void machine_field_currents(const real *table, size_t n, size_t sixth, MachineStates x,
                                          const num *id, num *ifd)
{
    const real *Xd = table + M_XD * n, *Xd1 = table + M_XD1 * n, *A = table + M_A * n;
    const real *leak_d = table + M_LEAK_D * n;

    for (size_t k = 0; k < sixth; ++k)
        ifd[k] = x.eq1[k] + (Xd[k] - Xd1[k]) * (A[k] * id[k] + (x.eq1[k] - x.eq2[k]) * leak_d[k]);
    for (size_t k = 0; k < sixth; ++k) {
        num d, q;
        if (index_at(table, M_SATURATES * n + k) == 0) continue;
        machine_saturation_of(table, n, k, x, &d, &q);
        ifd[k] += d;
    }
    for (size_t k = sixth; k < n; ++k) ifd[k] = NUM(table[M_EFD0 * n + k]);
}

static inline void machine_derivatives(const real *table, size_t n, size_t sixth, real omega_b,
                                       MachineStates x, const num *id, const num *iq,
                                       const num *efd, const num *pm, MachineRates dx)
{
    const real *Xd = table + M_XD * n, *Xd1 = table + M_XD1 * n, *Xd2 = table + M_XD2 * n;
    const real *Xq = table + M_XQ * n, *Xq1 = table + M_XQ1 * n, *Xq2 = table + M_XQ2 * n;
    const real *A = table + M_A * n, *B = table + M_B * n;
    const real *leak_d = table + M_LEAK_D * n, *leak_q = table + M_LEAK_Q * n;
    const real *per_Td01 = table + M_PER_TD01 * n, *per_Td02 = table + M_PER_TD02 * n;
    const real *per_Tq01 = table + M_PER_TQ01 * n, *per_Tq02 = table + M_PER_TQ02 * n;
    const real *per_2H = table + M_PER_2H * n, *D = table + M_D * n;

    for (size_t k = sixth; k < n; ++k) {
        dx.delta[k] = omega_b * x.slip[k];
        dx.slip[k] = (pm[k] - table[M_EFD0 * n + k] * iq[k] - D[k] * x.slip[k]) * per_2H[k];
    }
    for (size_t k = 0; k < sixth; ++k) {
        const num Te = x.ed2[k] * id[k] + x.eq2[k] * iq[k] + (Xq2[k] - Xd2[k]) * id[k] * iq[k];
        const num deq = x.eq1[k] - x.eq2[k], ded = x.ed1[k] - x.ed2[k];
        const num eq1 = (efd[k] - x.eq1[k]
                         - (Xd[k] - Xd1[k]) * (A[k] * id[k] + deq * leak_d[k])) * per_Td01[k];
        const num ed1 = (-x.ed1[k]
                         + (Xq[k] - Xq1[k]) * (B[k] * iq[k] - ded * leak_q[k])) * per_Tq01[k];

        dx.delta[k] = omega_b * x.slip[k];
        dx.slip[k] = (pm[k] - Te - D[k] * x.slip[k]) * per_2H[k];
        dx.eq1[k] = eq1;
        dx.ed1[k] = ed1;
        dx.eq2[k] = A[k] * eq1 + (deq - (Xd1[k] - Xd2[k]) * id[k]) * per_Td02[k];
        dx.ed2[k] = B[k] * ed1 + (ded + (Xq1[k] - Xq2[k]) * iq[k]) * per_Tq02[k];
    }
    machine_saturation(table, n, sixth, x, dx);
    for (size_t k = 0; k < n; ++k) {   /* torque is power over speed, for those that take it so */
        if (index_at(table, M_BY_SPEED * n + k) == 0) continue;
        const num share = num_ratio(x.slip[k], 1.0 + x.slip[k]);
        dx.slip[k] -= (pm[k] - D[k] * x.slip[k]) * share * per_2H[k];
    }
}
#endif
