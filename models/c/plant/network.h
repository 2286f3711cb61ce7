#ifndef INTERAREA_NETWORK_H
#define INTERAREA_NETWORK_H
#include "layout.h"
#include "scalar.h"
/* The algebraic network between the machines.         [Kundur1994, sec. 13.3]
 *
 * Machine k is the Norton source E_k y_k behind y_k = 1/(Ra + j X''); with all
 * loads as admittances, V = Z (y E) and the machine currents are
 *     I_j = y_j (E_j - V_j) = sum_k Y_jk E_k,   Y_jk = y_j (d_jk - Z_jk y_k).
 * Y (machines) and V/E (every bus) come from topology.c, once per network stage. */

/* I = Y E, one dense complex product. Sources beyond the machines' EMFs are what
 * the ports inject (port.h); without ports there are none. */
static inline void network_currents(const real *memory, const Plan *plan,
                                    const num *e_re, const num *e_im, num *i_re, num *i_im)
{
    const size_t n = plan->n_machine;
    const real *y_re = memory + plan->y_re, *y_im = memory + plan->y_im;

    for (size_t j = 0; j < n; ++j) {
        i_re[j] = NUM(0.0);
        i_im[j] = NUM(0.0);
    }
    for (size_t k = 0; k < plan->n_source; ++k) {   /* Y by columns: the inner loop has stride 1 */
        const real *g = y_re + k * n, *b = y_im + k * n;
        const num er = e_re[k], ei = e_im[k];
        for (size_t j = 0; j < n; ++j) {
            i_re[j] += g[j] * er - b[j] * ei;
            i_im[j] += g[j] * ei + b[j] * er;
        }
    }
}

/* Voltage of one bus from the EMFs. */
static inline void network_voltage(const real *memory, const Plan *plan, size_t bus,
                                   const num *e_re, const num *e_im, num *v_re, num *v_im)
{
    const size_t n = plan->n_source;
    const real *g = memory + plan->v_re + bus * n, *b = memory + plan->v_im + bus * n;

    *v_re = NUM(0.0);
    *v_im = NUM(0.0);
    for (size_t k = 0; k < n; ++k) {
        *v_re += g[k] * e_re[k] - b[k] * e_im[k];
        *v_im += g[k] * e_im[k] + b[k] * e_re[k];
    }
}

/* Active power into the tie branches at their measured ends, in service only:
 * P = Re V_a conj(Y_aa V_a + Y_ab V_b). */
static inline num network_tie_power(const real *memory, const Plan *plan,
                                    const num *e_re, const num *e_im)
{
    const size_t n = plan->n_tie;
    const real *tie = memory + plan->tie;
    num total = NUM(0.0);

    for (size_t k = 0; k < n; ++k) {
        const real *row = tie + k;
        const real g_own = row[T_OWN_RE * n], b_own = row[T_OWN_IM * n];
        const real g_mutual = row[T_MUTUAL_RE * n], b_mutual = row[T_MUTUAL_IM * n];
        num ar, ai, br, bi;
        network_voltage(memory, plan, index_at(tie, T_OWN * n + k), e_re, e_im, &ar, &ai);
        network_voltage(memory, plan, index_at(tie, T_OTHER * n + k), e_re, e_im, &br, &bi);
        const num re = g_own * ar - b_own * ai + g_mutual * br - b_mutual * bi;
        const num im = g_own * ai + b_own * ar + g_mutual * bi + b_mutual * br;
        total += memory[plan->in_service + index_at(tie, T_BRANCH * n + k)] * (ar * re + ai * im);
    }
    return total;
}
#endif
