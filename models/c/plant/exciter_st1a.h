#ifndef INTERAREA_EXCITER_ST1A_H
#define INTERAREA_EXCITER_ST1A_H
#include "machine.h"
#include "plan.h"
#include "scalar.h"
/* Bus-fed static exciter: the field voltage cannot exceed what the terminal
 * voltage and the commutation drop leave.         [IEEE4215, type ST1A; EXST1 of PSS/E]
 *
 *     T_R dv/dt   = Vt - v
 *     y           = (Vref + vs + u - v) (1 + s T_C)/(1 + s T_B)
 *     T_A dEfd/dt = K_A y - Efd,  Vt VRmin <= Efd <= Vt VRmax - K_C Ifd
 *
 * Ifd is the field current in per unit of the field voltage that holds it. The
 * limits follow the voltage at once, also in a fault; the lag does not wind up: a
 * state that a limit has passed follows it with T_A. States as exciter_static. */
static inline num exciter_st1a(const real *p, size_t n, num vt, num ifd, num signal,
                               const num *x, num *dx)
{
    const num v = num_lag(vt, p[E_TR * n], &x, &dx);
    const num e = p[E_VREF * n] + signal - v;
    const num y = num_lead_lag(e, p[E_TC * n], p[E_TB * n], &x, &dx);
    const num low = vt * p[E_MIN * n], drooped = vt * p[E_MAX * n] - p[E_KC * n] * ifd;
    const num high = num_pick(num_above(low, drooped), low, drooped);
    return num_limited_lag(p[E_KA * n] * y, p[E_TA * n], low, high, &x, &dx);
}
#endif
