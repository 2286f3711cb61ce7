#ifndef INTERAREA_STABILIZER_H
#define INTERAREA_STABILIZER_H
#include "plan.h"
#include "scalar.h"
/* Power system stabilizer on the speed deviation in per unit.
 *                                       [Sundaria2016, eq. 2.3; Kundur1994, sec. 12.5]
 *
 *     s  = slip / (1 + s T_S)                         (T_S = 0: s = slip)
 *     w  = K s s T_W / (1 + s T_W)                    (T_W dx/dt = s - x, w = K (s - x))
 *     vs = w (1+sT1)/(1+sT2) (1+sT3)/(1+sT4) (1+sT5)/(1+sT6), clamped to [min, max]
 *
 * Stages whose lag (T2, T4, T6) is 0 are absent. The limiter acts on the output
 * only; no state lies behind it, so nothing can wind up. */
static inline num stabilizer_signal(const real *p, size_t n, num slip, const num *x, num *dx)
{
    const num sensed = num_lag(slip, p[S_TS * n], &x, &dx);
    const num slow = num_lag(sensed, p[S_TW * n], &x, &dx);
    num y = p[S_K * n] * (sensed - slow);
    y = num_lead_lag(y, p[S_T1 * n], p[S_T2 * n], &x, &dx);
    y = num_lead_lag(y, p[S_T3 * n], p[S_T4 * n], &x, &dx);
    y = num_lead_lag(y, p[S_T5 * n], p[S_T6 * n], &x, &dx);
    return num_clamp(y, p[S_MIN * n], p[S_MAX * n]);
}

/* Signals of all machines; zero where there is no stabilizer. */
static inline void stabilizer_all(const real *memory, const Plan *plan, const num *slip,
                                  const num *x, num *dx, num *vs)
{
    const size_t n = plan->n_stabilizer;
    const real *of = memory + plan->stabilizer_of;

    for (size_t k = 0; k < plan->n_machine; ++k) vs[k] = NUM(0.0);
    for (size_t k = 0; k < n; ++k) {
        const size_t machine = index_at(of, k), state = index_at(of, n + k);
        vs[machine] = stabilizer_signal(memory + plan->stabilizer + k, n, slip[machine],
                                        x + state, dx + state);
    }
}
#endif
