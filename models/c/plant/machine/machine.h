#ifndef INTERAREA_MACHINE_H
#define INTERAREA_MACHINE_H
#include "../numbers/layout.h"
#include "../numbers/scalar.h"
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
 * Td02 d psi_kd/dt = eq1 - psi_kd - (Xd1 - Xl) id, and the same in q. The bracket
 * after (Xd - Xd1) plus eq1 is the field current Xad ifd.
 *
 * Stator:  vd = ed2 - Ra id + Xq2 iq,   vq = eq2 - Ra iq - Xd2 id
 * Torque:  Te = ed2 id + eq2 iq + (Xq2 - Xd2) id iq
 *
 * Classical: eq2 = E constant (row M_EFD0), ed2 = 0, the reactances Xd1 on both
 * axes (rows M_XD2, M_XQ2); Te = E iq. These machines come last.        [ch. 5] */
typedef struct { const cell *delta, *slip, *eq1, *ed1, *eq2, *ed2; } MachineStates;
typedef struct { cell *delta, *slip, *eq1, *ed1, *eq2, *ed2; } MachineRates;

/* All machines, and arrays with an entry for each. id_rotor is what the rotor circuits see: id, or id + isd;
 * saturation_d and _q what saturation adds to the field current and to what drives ed1. */
typedef struct {
    const stored *table;
    size_t n, sixth;
    stored omega_b;
    MachineStates x;
    const cell *turn;   /* by how much the network's frame has turned at each, or null: by nothing */
    cell *sine, *cosine, *e_re, *e_im, *i_re, *i_im, *id, *iq, *vd, *vq, *vt, *efd, *pm, *id_rotor, *ifd;
    cell *saturation_d, *saturation_q;
} Machines;

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
static inline MachineStates machine_states(const cell *x, size_t n, size_t sixth)
{
    const cell *e = x + 2 * n;
    return (MachineStates){ x, x + n, e, e + sixth, e + 2 * sixth, e + 3 * sixth };
}

static inline MachineRates machine_rates(cell *dx, size_t n, size_t sixth)
{
    cell *e = dx + 2 * n;
    return (MachineRates){ dx, dx + n, e, e + sixth, e + 2 * sixth, e + 3 * sixth };
}

/* The functions below take the machines first .. last - 1, all of one order. */

/* Subtransient EMF in the network's frame: E = (eq2 - j ed2) exp(j (delta - turn)). */
static inline void machine_emf(const Machines *m, size_t first, size_t last)
{
    const stored *emf = m->table + M_EFD0 * m->n;

    EACH(k, first, last) {
        num sine, cosine, angle = AT(m->x.delta, k);
        if (m->turn != NULL) angle = angle - AT(m->turn, k);
        num_sincos(angle, &sine, &cosine);
        PUT(m->sine, k, sine);
        PUT(m->cosine, k, cosine);
        if (first >= m->sixth) {
            PUT(m->e_re, k, AT(emf, k) * cosine);
            PUT(m->e_im, k, AT(emf, k) * sine);
        } else {
            PUT(m->e_re, k, AT(m->x.eq2, k) * cosine + AT(m->x.ed2, k) * sine);
            PUT(m->e_im, k, AT(m->x.eq2, k) * sine - AT(m->x.ed2, k) * cosine);
        }
    }
}

/* Network current (system base) -> id, iq; terminal voltage vd, vq, |V|. */
static inline void machine_terminal(const Machines *m, size_t first, size_t last)
{
    const size_t n = m->n;
    const stored *per_ratio = m->table + M_PER_RATIO * n, *Ra = m->table + M_RA * n;
    const stored *Xd2 = m->table + M_XD2 * n, *Xq2 = m->table + M_XQ2 * n, *emf = m->table + M_EFD0 * n;

    EACH(k, first, last) {
        const num sine = AT(m->sine, k), cosine = AT(m->cosine, k), i_re = AT(m->i_re, k), i_im = AT(m->i_im, k);
        const num iq = (i_re * cosine + i_im * sine) * AT(per_ratio, k);
        const num id = (i_re * sine - i_im * cosine) * AT(per_ratio, k);
        const num ed2 = first < m->sixth ? AT(m->x.ed2, k) : NUM(0.0);
        const num eq2 = first < m->sixth ? AT(m->x.eq2, k) : NUM(AT(emf, k));
        const num vd = ed2 - AT(Ra, k) * id + AT(Xq2, k) * iq;
        const num vq = eq2 - AT(Ra, k) * iq - AT(Xd2, k) * id;
        PUT(m->iq, k, iq);
        PUT(m->id, k, id);
        PUT(m->vd, k, vd);
        PUT(m->vq, k, vq);
        PUT(m->vt, k, num_sqrt(vd * vd + vq * vq));
    }
}

/* Explicit saturation, of a flux that is a state: S of the subtransient flux linkage on
 * both axes (GENROU, GENROE, GENSAE), or of eq1 (GENSAL).
 *
 *     E S(E) = B (E - A)^2 above A (kind 1),  or  B E^(1 + A) (kind 2)
 *
 * S eq2 (or S eq1) adds to the field current, S ed2 (Xq - Xl)/(Xd - Xl) to what drives ed1;
 * with one winding on the q axis (Xq1 = Xq, ed1 stays 0) to what drives ed2. */
enum { SATURATES_QUADRATIC = 1, SATURATES_EXPONENTIAL };

static inline void machine_saturation(const Machines *m, size_t k, num *d, num *q)
{
    const stored *row = m->table + k;
    const size_t n = m->n;
    const num kind = NUM(AT(row, M_SATURATES * n));
    const flag on = num_above(kind, NUM(0.5)), is_power = num_above(kind, NUM(1.5));

    *d = *q = NUM(0.0);
    if (!flag_any(on)) return;
    const real A = AT(row, M_SAT_A * n), B = AT(row, M_SAT_B * n);
    const num eq1 = AT(m->x.eq1, k), eq2 = AT(m->x.eq2, k), ed2 = AT(m->x.ed2, k);
    const flag of_emf = num_above(NUM(AT(row, M_SAT_EMF * n)), NUM(0.5));
    const num flux = num_pick(of_emf, eq1, num_sqrt(eq2 * eq2 + ed2 * ed2));
    const num bounded = num_pick(num_above(flux, NUM(1e-3)), flux, NUM(1e-3));
    const num excess = num_pick(num_above(flux, NUM(A)), flux - A, NUM(0.0));
    num s = num_ratio(B * excess * excess, bounded);
    if (flag_any(is_power)) s = num_pick(is_power, B * num_exp(A * num_log(bounded)), s);
    *d = num_pick(on, s * num_pick(of_emf, eq1, eq2), NUM(0.0));
    *q = num_pick(on, s * ed2, NUM(0.0));
}

/* Field currents in per unit of the field voltage that holds them, Xad ifd. */
static inline void machine_field_currents(const Machines *m, size_t first, size_t last)
{
    const size_t n = m->n;
    const stored *Xd = m->table + M_XD * n, *Xd1 = m->table + M_XD1 * n, *A = m->table + M_A * n;
    const stored *leak_d = m->table + M_LEAK_D * n, *emf = m->table + M_EFD0 * n;

    EACH(k, first, last) {
        num d, q;
        if (first >= m->sixth) {
            PUT(m->ifd, k, NUM(AT(emf, k)));
            continue;
        }
        const num eq1 = AT(m->x.eq1, k), eq2 = AT(m->x.eq2, k);
        const num ifd = eq1 + (AT(Xd, k) - AT(Xd1, k)) * (AT(A, k) * AT(m->id_rotor, k) + (eq1 - eq2) * AT(leak_d, k));
        machine_saturation(m, k, &d, &q);
        PUT(m->saturation_d, k, d);
        PUT(m->saturation_q, k, q);
        PUT(m->ifd, k, ifd + d);
    }
}

/* After machine_field_currents. */
static inline void machine_derivatives(const Machines *m, MachineRates dx, size_t first, size_t last)
{
    const size_t n = m->n;
    const stored *table = m->table;

    EACH(k, first, last) {
        const stored *row = table + k;
        const num slip_k = AT(m->x.slip, k), id = AT(m->id, k), iq = AT(m->iq, k), pm = AT(m->pm, k);
        const real D = AT(row, M_D * n), per_2H = AT(row, M_PER_2H * n);
        const flag by_speed = num_above(NUM(AT(row, M_BY_SPEED * n)), NUM(0.5));
        num slip;

        if (first >= m->sixth) {
            slip = (pm - AT(row, M_EFD0 * n) * iq - D * slip_k) * per_2H;
        } else {
            const real A = AT(row, M_A * n), B = AT(row, M_B * n);
            const real Xd1 = AT(row, M_XD1 * n), Xd2 = AT(row, M_XD2 * n), Xq1 = AT(row, M_XQ1 * n), Xq2 = AT(row, M_XQ2 * n);
            const real per_Td01 = AT(row, M_PER_TD01 * n), per_Td02 = AT(row, M_PER_TD02 * n);
            const real per_Tq01 = AT(row, M_PER_TQ01 * n), per_Tq02 = AT(row, M_PER_TQ02 * n);
            const num eq1_k = AT(m->x.eq1, k), ed1_k = AT(m->x.ed1, k), eq2_k = AT(m->x.eq2, k), ed2_k = AT(m->x.ed2, k);
            const num Te = ed2_k * id + eq2_k * iq + (Xq2 - Xd2) * id * iq;
            const num deq = eq1_k - eq2_k, ded = ed1_k - ed2_k;
            num eq1 = (AT(m->efd, k) - eq1_k
                       - (AT(row, M_XD * n) - Xd1) * (A * id + deq * AT(row, M_LEAK_D * n))) * per_Td01;
            num ed1 = (-ed1_k
                       + (AT(row, M_XQ * n) - Xq1) * (B * iq - ded * AT(row, M_LEAK_Q * n))) * per_Tq01;
            num eq2 = A * eq1 + (deq - (Xd1 - Xd2) * id) * per_Td02;
            num ed2 = B * ed1 + (ded + (Xq1 - Xq2) * iq) * per_Tq02;

            if (flag_any(num_above(NUM(AT(row, M_SATURATES * n)), NUM(0.5)))) {
                const num d = AT(m->saturation_d, k) * per_Td01, q = AT(m->saturation_q, k);
                const num q1 = q * (AT(row, M_SAT_Q1 * n) * per_Tq01);
                eq1 -= d;
                eq2 -= A * d;
                ed1 -= q1;
                ed2 -= B * q1 + q * (AT(row, M_SAT_Q2 * n) * per_Tq02);
            }
            PUT(dx.eq1, k, eq1);
            PUT(dx.ed1, k, ed1);
            PUT(dx.eq2, k, eq2);
            PUT(dx.ed2, k, ed2);
            slip = (pm - Te - D * slip_k) * per_2H;
        }
        if (flag_any(by_speed)) {   /* torque is power over speed, for those that take it so */
            const num share = num_ratio(slip_k, 1.0 + slip_k);
            slip = num_pick(by_speed, slip - (pm - D * slip_k) * share * per_2H, slip);
        }
        PUT(dx.delta, k, SPREAD(m->omega_b) * slip_k);
        PUT(dx.slip, k, slip);
    }
}
#endif
