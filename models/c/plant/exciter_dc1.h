#ifndef INTERAREA_EXCITER_DC1_H
#define INTERAREA_EXCITER_DC1_H
#include "plan.h"
#include "scalar.h"
/* Rotating exciter with a commutator and its regulator.
 *                         [Kundur1994, sec. 8.6; IEEE4215, type DC1A; IEEET1, IEEEX1 of PSS/E]
 *
 *     T_R dv/dt   = Vt - v
 *     e           = Vref + vs + u - v - K_F s/(1 + s T_F) Efd
 *     y           = e (1 + s T_C)/(1 + s T_B)
 *     T_A dr/dt   = K_A y - r,  VRmin <= r <= VRmax, non-windup
 *     T_E dEfd/dt = r - (K_E + S_E) Efd,   S_E = Aex exp(Bex Efd)
 *
 * The rate feedback is K_F/T_F (Efd - f) with T_F df/dt = Efd - f. "Self-excited"
 * means K_E = -S_E at the operating point, so that r = 0 there.
 * States: v, the slow part of y, r, Efd, f; v, y, r are absent when their time is 0. */
static inline num exciter_dc1(const real *p, size_t n, num vt, num signal, const num *x, num *dx)
{
    const size_t before = (FIRST(p[E_TR * n]) > 0.0 ? 1u : 0u) + (FIRST(p[E_TB * n]) > 0.0 ? 1u : 0u)
                        + (FIRST(p[E_TA * n]) > 0.0 ? 1u : 0u);
    const num efd = x[before], slow = x[before + 1];
    const num feedback = p[E_KF * n] / p[E_TF * n] * (efd - slow);
    const num loss = p[E_KE * n] + p[E_AEX * n] * num_exp(p[E_BEX * n] * efd);

    const num v = num_lag(vt, p[E_TR * n], &x, &dx);
    const num e = p[E_VREF * n] + signal - v - feedback;
    const num y = num_lead_lag(e, p[E_TC * n], p[E_TB * n], &x, &dx);
    const num r = num_limited_lag(p[E_KA * n] * y, p[E_TA * n], p[E_MIN * n], p[E_MAX * n], &x, &dx);
    dx[0] = (r - loss * efd) / p[E_TE * n];
    dx[1] = (efd - slow) / p[E_TF * n];
    return efd;
}

/* What the regulator must give for efd at rest. */
static inline double exciter_dc1_regulator(const double *p, size_t n, double efd)
{
    return (p[E_KE * n] + p[E_AEX * n] * real_exp(p[E_BEX * n] * efd)) * efd;
}

/* States at rest with field voltage efd and terminal voltage vt; returns Vref. */
static inline double exciter_dc1_rest(const double *p, size_t n, double efd, double vt, double *rest)
{
    const double r = exciter_dc1_regulator(p, n, efd), e = r / p[E_KA * n];
    if (p[E_TR * n] > 0.0) *rest++ = vt;
    if (p[E_TB * n] > 0.0) *rest++ = e;
    if (p[E_TA * n] > 0.0) *rest++ = r;
    *rest++ = efd;
    *rest++ = efd;
    return vt + e;
}
#endif
