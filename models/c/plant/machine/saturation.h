#ifndef INTERAREA_SATURATION_H
#define INTERAREA_SATURATION_H
#include "machine.h"
/* Magnetic saturation and subtransient saliency, as what a machine's port injects
 * at the air-gap node, behind Ra + j Xl.               [Kundur1994, sec. 3.8, 12.3.2]
 *
 * The voltage of that node in the rotor frame is psi_ad + j psi_aq. Saturation asks
 * for additional magnetising currents
 *
 *     isd = S psi_ad/(Xd - Xl),   isq = S psi_aq/(Xq - Xl),   S = psi_I/psi_at,
 *     psi_I = Asat exp(Bsat (psi_at - psiT1)),   psi_at = |psi_ad + j psi_aq|
 *
 * (K_s = 1/(1 + S)), the same S on both axes. The rotor circuits see id + isd and
 * iq + isq in place of id and iq, and the EMFs towards the stator become
 * eq2 - (Xd2 - Xl) isd and ed2 + (Xq2 - Xl) isq. psi_I is not cut to zero below
 * psiT1, where it is small: the book's jump there would stop an integrator.
 *
 * Incremental: S keeps its value along the line, with Kundur's incremental factor,
 *     isd = isd0 + Bsat psi_I0 (psi_ad - psi_ad0)/(Xd - Xl),   isq likewise.
 *
 * The network sees the EMF behind Ra + j Xd2 on both axes; what X''q differs from it
 * is (psi_aq + ed2) [1/(Xd2 - Xl) - 1/(Xq2 - Xl)] on the q axis. Altogether
 *     dI = [-isq + that + j isd] exp(j delta),   machine base.                     */

/* isd, isq at the air-gap flux. */
static inline void saturation_currents(const real *row, num psi_d, num psi_q, num *isd, num *isq)
{
    const size_t kind = index_at(row, P_SATURATION);

    if (kind == SATURATION_TOTAL) {
        const num flux = num_sqrt(psi_d * psi_d + psi_q * psi_q);
        const num bounded = num_pick(num_above(flux, NUM(1e-3)), flux, NUM(1e-3));
        const num s = row[P_ASAT] * num_ratio(num_exp(row[P_BSAT] * (flux - row[P_PSIT1])), bounded);
        *isd = s * psi_d * row[P_PER_LD];
        *isq = s * psi_q * row[P_PER_LQ];
    } else {   /* without saturation the slope and the currents at rest are zero */
        *isd = row[P_ISD0] + row[P_SLOPE] * (psi_d - row[P_PSID0]) * row[P_PER_LD];
        *isq = row[P_ISQ0] + row[P_SLOPE] * (psi_q - row[P_PSIQ0]) * row[P_PER_LQ];
    }
}

/* Current the port injects at the air-gap voltage v, machine base. */
static inline void saturation_injection(const real *row, num v_re, num v_im, num sine, num cosine, num ed2,
                                        num *i_re, num *i_im, num *isd, num *isq)
{
    const num psi_d = v_re * cosine + v_im * sine, psi_q = v_im * cosine - v_re * sine;
    saturation_currents(row, psi_d, psi_q, isd, isq);
    const num iq = (psi_q + ed2) * row[P_SALIENCY] - *isq;
    *i_re = iq * cosine - *isd * sine;
    *i_im = iq * sine + *isd * cosine;
}

#if !defined PLANT_TANGENT && !defined PLANT_LANES
/* d (isd, isq) / d (psi_d, psi_q), row by row. */
static inline void saturation_currents_slope(const double *row, double psi_d, double psi_q, double d[4])
{
    double s = row[P_SLOPE], rate = 0.0;

    if (index_at(row, P_SATURATION) == SATURATION_TOTAL) {
        const double flux = sqrt(psi_d * psi_d + psi_q * psi_q), bounded = flux > 1e-3 ? flux : 1e-3;
        s = row[P_ASAT] * real_exp(row[P_BSAT] * (flux - row[P_PSIT1])) / bounded;
        rate = s * (row[P_BSAT] - (flux > 1e-3 ? 1.0 / flux : 0.0)) / bounded;
    }
    d[0] = (s + rate * psi_d * psi_d) * row[P_PER_LD];
    d[1] = rate * psi_d * psi_q * row[P_PER_LD];
    d[2] = rate * psi_d * psi_q * row[P_PER_LQ];
    d[3] = (s + rate * psi_q * psi_q) * row[P_PER_LQ];
}

/* d (i_re, i_im) / d (v_re, v_im), row by row. */
static inline void saturation_slope(const double *row, double v_re, double v_im, double sine, double cosine,
                                    double d[4])
{
    double s[4];
    saturation_currents_slope(row, v_re * cosine + v_im * sine, v_im * cosine - v_re * sine, s);
    const double q_d = -s[2], q_q = row[P_SALIENCY] - s[3];
    /* (iq, isd) by (re, im): psi_d = re c + im s, psi_q = im c - re s */
    const double iq_re = q_d * cosine - q_q * sine, iq_im = q_d * sine + q_q * cosine;
    const double id_re = s[0] * cosine - s[1] * sine, id_im = s[0] * sine + s[1] * cosine;
    d[0] = iq_re * cosine - id_re * sine;
    d[1] = iq_im * cosine - id_im * sine;
    d[2] = iq_re * sine + id_re * cosine;
    d[3] = iq_im * sine + id_im * cosine;
}
#endif

/* After machine_terminal, which knows eq2 and ed2 only: the terminal voltage of a
 * machine with (isd, isq). */
static inline void saturation_terminal(const real *row, size_t k, num isd, num isq, num *vd, num *vq, num *vt)
{
    vd[k] += row[P_XQ2] * isq;
    vq[k] -= row[P_X2] * isd;
    vt[k] = num_sqrt(vd[k] * vd[k] + vq[k] * vq[k]);
}

/* After machine_derivatives: what (isd, isq) add to the rates of machine k. */
static inline void saturation_rates(const real *table, size_t n, size_t k, num id, num iq, num isd, num isq,
                                    MachineRates dx)
{
    const real Xd1 = table[M_XD1 * n + k], Xq1 = table[M_XQ1 * n + k];
    const real Xd2 = table[M_XD2 * n + k], Xq2 = table[M_XQ2 * n + k], Xl = table[M_XL * n + k];
    const real A = table[M_A * n + k], B = table[M_B * n + k];
    const num eq1 = -(table[M_XD * n + k] - Xd1) * A * isd * table[M_PER_TD01 * n + k];
    const num ed1 = (table[M_XQ * n + k] - Xq1) * B * isq * table[M_PER_TQ01 * n + k];

    dx.slip[k] -= ((Xq2 - Xl) * isq * id - (Xd2 - Xl) * isd * iq) * table[M_PER_2H * n + k];
    dx.eq1[k] += eq1;
    dx.ed1[k] += ed1;
    dx.eq2[k] += A * eq1 - (Xd1 - Xd2) * isd * table[M_PER_TD02 * n + k];
    dx.ed2[k] += B * ed1 + (Xq1 - Xq2) * isq * table[M_PER_TQ02 * n + k];
}
#endif
