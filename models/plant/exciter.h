#ifndef INTERAREA_EXCITER_H
#define INTERAREA_EXCITER_H
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
 * field limits are constants (they do not follow the terminal voltage). */
static inline num exciter_static(const double *p, size_t n, num vt, num signal,
                                 const num *x, num *dx)
{
    const num v = num_lag(vt, p[E_TR * n], &x, &dx);
    const num e = p[E_VREF * n] + signal - v;
    const num y = num_lead_lag(e, p[E_TC * n], p[E_TB * n], &x, &dx);
    return num_limited_lag(p[E_KA * n] * y, p[E_TA * n], p[E_MIN * n], p[E_MAX * n], &x, &dx);
}

/* Field voltages of all machines: the constant of the operating point, or the
 * output of the machine's exciter. */
static inline void exciter_all(const double *memory, const Plan *plan, const num *vt,
                               const num *vs, const num *u, const num *x, num *dx, num *efd)
{
    const size_t n = plan->n_exciter;
    const double *of = memory + plan->exciter_of;

    for (size_t k = 0; k < plan->n_machine; ++k)
        efd[k] = memory[plan->machine + M_EFD0 * plan->n_machine + k];
    for (size_t k = 0; k < n; ++k) {
        const size_t machine = index_at(of, n + k), input = index_at(of, 2 * n + k);
        const size_t state = index_at(of, 3 * n + k);
        const num signal = vs[machine] + memory[plan->vref_step + machine] + u[input];
        efd[machine] = exciter_static(memory + plan->exciter + k, n, vt[machine], signal,
                                      x + state, dx + state);
    }
}
#endif
