#ifndef INTERAREA_GOVERNOR_TGOV1_H
#define INTERAREA_GOVERNOR_TGOV1_H
#include "plan.h"
#include "scalar.h"
/* Simple steam governor: droop, valve with limits, reheat as one lead-lag, damping
 * of the turbine. Per unit on the machine base.                     [TGOV1 of PSS/E]
 *
 *     T1 dg/dt = Pref - slip/R - g,  Vmin <= g <= Vmax, non-windup
 *     Pm       = g (1 + s T2)/(1 + s T3) - Dt slip
 *
 * Pref = Pm at rest (the model library writes Pref/R). States: g, slow part of Pm. */
static inline num governor_tgov1(const real *p, size_t n, num pref, num slip, const num *x, num *dx)
{
    const num valve = num_limited_lag(pref - slip / p[G_RP * n], p[G_TSM * n], p[G_GMIN * n],
                                      p[G_GMAX * n], &x, &dx);
    const num power = num_lead_lag(valve, p[G_T2 * n], p[G_T3 * n], &x, &dx);
    return power - p[G_DT * n] * slip;
}
#endif
