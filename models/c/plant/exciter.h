#ifndef INTERAREA_EXCITER_H
#define INTERAREA_EXCITER_H
#include "exciter_dc1.h"
#include "exciter_st1a.h"
#include "exciter_static.h"

/* Field voltages of all machines: the constant of the operating point, or the
 * output of the machine's exciter. id: d-axis currents, machine base. */
static inline void exciter_all(const real *memory, const Plan *plan, const num *vt, const num *id,
                               const num *vs, const num *u, const num *x, num *dx, num *efd)
{
    const size_t n = plan->n_exciter, m = plan->n_machine;
    const real *of = memory + plan->exciter_of, *table = memory + plan->machine;

    for (size_t k = 0; k < m; ++k) efd[k] = NUM(table[M_EFD0 * m + k]);
    for (size_t k = 0; k < n; ++k) {
        const real *p = memory + plan->exciter + k;
        const size_t kind = index_at(of, k), machine = index_at(of, n + k);
        const size_t input = index_at(of, 2 * n + k), state = index_at(of, 3 * n + k);
        const num signal = vs[machine] + memory[plan->vref_step + machine] + u[input];

        if (kind == EXCITER_DC1) {
            efd[machine] = exciter_dc1(p, n, vt[machine], signal, x + state, dx + state);
        } else if (kind == EXCITER_ST1A) {
            const num ifd = flag_any(num_above(NUM(p[E_KC * n]), NUM(0.0)))
                ? machine_field_current(table, m, machine, machine_states(x, m, plan->n_sixth), id[machine])
                : NUM(0.0);
            efd[machine] = exciter_st1a(p, n, vt[machine], ifd, signal, x + state, dx + state);
        } else {
            efd[machine] = exciter_static(p, n, vt[machine], signal, x + state, dx + state);
        }
    }
}

enum { EXCITER_STATES = 6 };  /* most an exciter has */

/* States at rest of an exciter with table column p; returns Vref. At rest the
 * field current equals the field voltage. */
static inline double exciter_rest(const double *p, size_t n, size_t kind, double efd, double vt,
                                  double rest[EXCITER_STATES])
{
    for (size_t k = 0; k < EXCITER_STATES; ++k) rest[k] = 0.0;
    return kind == EXCITER_DC1 ? exciter_dc1_rest(p, n, efd, vt, rest)
                               : exciter_static_rest(p, n, efd, vt, rest);
}

/* The limited quantity at rest, and the limits it must keep. */
static inline double exciter_limited(const double *p, size_t n, size_t kind, double efd, double vt,
                                     double *low, double *high)
{
    *low = p[E_MIN * n];
    *high = p[E_MAX * n];
    if (kind == EXCITER_ST1A) {
        *low *= vt;
        *high = *high * vt - p[E_KC * n] * efd;
    }
    return kind == EXCITER_DC1 ? exciter_dc1_regulator(p, n, efd) : efd;
}
#endif
