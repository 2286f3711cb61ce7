#ifndef INTERAREA_EXCITER_STATIC_H
#define INTERAREA_EXCITER_STATIC_H
#include "plan.h"
#include "scalar.h"
/* Static (thyristor) exciter, with or without transient gain reduction.
 *                                  [Sundaria2016, eq. 2.1-2.2; Kundur1994, Ex. 12.6]
 *
 *     T_R dv/dt   = Vt - v                                        (T_R = 0: v = Vt)
 *     e           = Vref + vs + u - v
 *     y           = e (1 + s T_C)/(1 + s T_B)                     (T_B = 0: y = e)
 *     T_A dEfd/dt = K_A y - Efd,  Emin <= Efd <= Emax, non-windup (T_A = 0: algebraic)
 *
 * vs is the machine's stabilizer signal and a Vref step, u the FMU's input. The
 * field limits are constants (they do not follow the terminal voltage).
 * States: v, the slow part of y, Efd; those whose time is 0 are absent. */
static inline num exciter_static(const real *p, size_t n, num vt, num signal,
                                 const num *x, num *dx)
{
    const num v = num_lag(vt, p[E_TR * n], &x, &dx);
    const num e = p[E_VREF * n] + signal - v;
    const num y = num_lead_lag(e, p[E_TC * n], p[E_TB * n], &x, &dx);
    return num_limited_lag(p[E_KA * n] * y, p[E_TA * n], p[E_MIN * n], p[E_MAX * n], &x, &dx);
}

/* States at rest with field voltage efd and terminal voltage vt; returns Vref. */
static inline double exciter_static_rest(const double *p, size_t n, double efd, double vt, double *rest)
{
    const double e = efd / p[E_KA * n];
    if (p[E_TR * n] > 0.0) *rest++ = vt;
    if (p[E_TB * n] > 0.0) *rest++ = e;
    if (p[E_TA * n] > 0.0) *rest++ = efd;
    return vt + e;
}
#endif
