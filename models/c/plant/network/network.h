#ifndef INTERAREA_NETWORK_H
#define INTERAREA_NETWORK_H
#include "../numbers/layout.h"
#include "../numbers/scalar.h"
#include "sparse.h"
/* The algebraic network between the machines.         [Kundur1994, sec. 13.3]
 *
 * Machine k is the Norton source E_k y_k behind y_k = 1/(Ra + j X''); with all
 * loads as admittances, V = Z (y E) and the machine currents are
 *     I_j = y_j (E_j - V_j) = sum_k Y_jk E_k,   Y_jk = y_j (d_jk - Z_jk y_k).
 * A small network is dense: Y (machines) and V/E (every bus) come from topology.c, once
 * per network stage. A large one is solved for V with the factors of sparse.h each time. */

/* Norton admittance of machine k on the system base, 0 after a trip. Below equal X''d, X''q. */
static inline void network_norton(const real *memory, const Plan *plan, size_t k, real *g, real *b)
{
    const size_t n = plan->n_machine;
    const real *table = memory + plan->machine;
    const real ratio = table[M_RATIO * n + k] * memory[plan->running + k];
    const real r = table[M_RA * n + k], x = table[M_XD2 * n + k];
    *g = ratio * r / (r * r + x * x);
    *b = -ratio * x / (r * r + x * x);
}

/* What the machines' EMFs send into a sparse network, into the rows of v from plan->first on; zero elsewhere. */
static inline void network_inject(const real *memory, const Plan *plan, const Pattern *pattern,
                                  const num *e_re, const num *e_im, num *v)
{
    const size_t n = plan->n_machine;
    const real *g = memory + plan->norton, *b = g + n;

    for (size_t k = 2 * plan->first; k < 2 * plan->n_node; ++k) v[k] = NUM(0.0);
    for (size_t k = 0; k < n; ++k) {
        num *at = v + 2 * pattern->machine[k];
        at[0] += g[k] * e_re[k] - b[k] * e_im[k];
        at[1] += g[k] * e_im[k] + b[k] * e_re[k];
    }
}

/* Node voltages in place of node currents, from row `first` on. */
static inline void network_solve(const real *memory, const Plan *plan, const Pattern *pattern, size_t lanes, num *v)
{
    sparse_forward(memory, plan, pattern, lanes, plan->first, v);
    sparse_backward(memory, plan, pattern, lanes, plan->first, plan->n_node, v);
}

/* The voltages of the rows before plan->first, into which nothing is sent. */
static inline void network_complete(const real *memory, const Plan *plan, const Pattern *pattern, size_t lanes, num *v)
{
    for (size_t k = 0; k < 2 * plan->first; ++k) v[k] = NUM(0.0);
    sparse_backward(memory, plan, pattern, lanes, 0, plan->first, v);
}

/* Machine currents from the node voltages v. */
static inline void network_machines(const real *memory, const Plan *plan, const Pattern *pattern, const num *e_re,
                                    const num *e_im, const num *v, num *i_re, num *i_im)
{
    const size_t n = plan->n_machine;
    const real *g = memory + plan->norton, *b = g + n;

    for (size_t k = 0; k < n; ++k) {
        const num *at = v + 2 * pattern->machine[k];
        const num dr = e_re[k] - at[0], di = e_im[k] - at[1];
        i_re[k] = g[k] * dr - b[k] * di;
        i_im[k] = g[k] * di + b[k] * dr;
    }
}

/* Voltage of one bus from the EMFs, or where the network is sparse from its solution v. */
static inline void network_voltage(const real *memory, const Plan *plan, const Pattern *pattern, size_t bus,
                                   const num *e_re, const num *e_im, const num *v, num *v_re, num *v_im)
{
    if (is_sparse(plan)) {
        *v_re = v[2 * pattern->row[bus]];
        *v_im = v[2 * pattern->row[bus] + 1];
        return;
    }
    const size_t n = plan->n_source;
    const real *g = memory + plan->v_re + bus * n, *b = memory + plan->v_im + bus * n;

    *v_re = NUM(0.0);
    *v_im = NUM(0.0);
    for (size_t k = 0; k < n; ++k) {
        *v_re += g[k] * e_re[k] - b[k] * e_im[k];
        *v_im += g[k] * e_im[k] + b[k] * e_re[k];
    }
}

/* Current into tie or line k at its measured end, in service only, and the voltage there. */
static inline void network_line_current(const real *memory, const Plan *plan, const Pattern *pattern, size_t k,
                                        const num *e_re, const num *e_im, const num *v, num *i_re, num *i_im,
                                        num *v_re, num *v_im)
{
    const size_t n = plan->n_tie + plan->n_line;
    const real *tie = memory + plan->tie, *row = tie + k;
    const real g_own = row[T_OWN_RE * n], b_own = row[T_OWN_IM * n];
    const real g_mutual = row[T_MUTUAL_RE * n], b_mutual = row[T_MUTUAL_IM * n];
    const real on = memory[plan->in_service + index_at(tie, T_BRANCH * n + k)];
    num br, bi;

    network_voltage(memory, plan, pattern, index_at(tie, T_OWN * n + k), e_re, e_im, v, v_re, v_im);
    network_voltage(memory, plan, pattern, index_at(tie, T_OTHER * n + k), e_re, e_im, v, &br, &bi);
    *i_re = on * (g_own * *v_re - b_own * *v_im + g_mutual * br - b_mutual * bi);
    *i_im = on * (g_own * *v_im + b_own * *v_re + g_mutual * bi + b_mutual * br);
}

/* Power there: S = V_a conj(Y_aa V_a + Y_ab V_b). */
static inline void network_line_power(const real *memory, const Plan *plan, const Pattern *pattern, size_t k,
                                      const num *e_re, const num *e_im, const num *v, num *p, num *q)
{
    num ar, ai, re, im;

    network_line_current(memory, plan, pattern, k, e_re, e_im, v, &re, &im, &ar, &ai);
    *p = ar * re + ai * im;
    *q = ai * re - ar * im;
}

/* Active power over the tie branches. */
static inline num network_tie_power(const real *memory, const Plan *plan, const Pattern *pattern,
                                    const num *e_re, const num *e_im, const num *v)
{
    num total = NUM(0.0), p, q;

    for (size_t k = 0; k < plan->n_tie; ++k) {
        network_line_power(memory, plan, pattern, k, e_re, e_im, v, &p, &q);
        total += p;
    }
    return total;
}
#endif
