#ifndef INTERAREA_NETWORK_H
#define INTERAREA_NETWORK_H
#include "plan.h"
#include "scalar.h"
/* The algebraic network between the machines.         [Kundur1994, sec. 13.3]
 *
 * Machine k is the Norton source E_k y_k behind y_k = 1/(Ra + j X''); with all
 * loads as admittances, V = Z (y E) and the machine currents are
 *     I_j = y_j (E_j - V_j) = sum_k Y_jk E_k,   Y_jk = y_j (d_jk - Z_jk y_k).
 * Y (machines) and V/E (every bus) come from stage.c, once per network stage. */

/* I = Y E, one dense complex product. */
static inline void network_currents(const double *memory, const Plan *plan,
                                    const num *e_re, const num *e_im, num *i_re, num *i_im)
{
    const size_t n = plan->n_machine;
    const double *y_re = memory + plan->y_re, *y_im = memory + plan->y_im;

    for (size_t j = 0; j < n; ++j) {
        i_re[j] = 0.0;
        i_im[j] = 0.0;
    }
    for (size_t k = 0; k < n; ++k) {   /* Y is stored by columns: the inner loop has stride 1 */
        const double *g = y_re + k * n, *b = y_im + k * n;
        const num er = e_re[k], ei = e_im[k];
        for (size_t j = 0; j < n; ++j) {
            i_re[j] += g[j] * er - b[j] * ei;
            i_im[j] += g[j] * ei + b[j] * er;
        }
    }
}

/* Voltage of one bus from the EMFs. */
static inline void network_voltage(const double *memory, const Plan *plan, size_t bus,
                                   const num *e_re, const num *e_im, num *v_re, num *v_im)
{
    const size_t n = plan->n_machine;
    const double *g = memory + plan->v_re + bus * n, *b = memory + plan->v_im + bus * n;

    *v_re = 0.0;
    *v_im = 0.0;
    for (size_t k = 0; k < n; ++k) {
        *v_re += g[k] * e_re[k] - b[k] * e_im[k];
        *v_im += g[k] * e_im[k] + b[k] * e_re[k];
    }
}

/* Active power into branch `line` at its end 0 (from) or 1 (to):
 * P = Re V_a conj(Y_aa V_a + Y_ab V_b). Zero when the branch is out. */
static inline num network_branch_power(const double *memory, const Plan *plan, const double *admittance,
                                       size_t line, int end, const num *va, const num *vb)
{
    const size_t n = plan->n_branch;
    const size_t own = (end == 0 ? B_FF_RE : B_TT_RE) * n + line;
    const size_t other = (end == 0 ? B_FT_RE : B_TF_RE) * n + line;
    const num re = admittance[own] * va[0] - admittance[own + n] * va[1]
                 + admittance[other] * vb[0] - admittance[other + n] * vb[1];
    const num im = admittance[own] * va[1] + admittance[own + n] * va[0]
                 + admittance[other] * vb[1] + admittance[other + n] * vb[0];
    return memory[plan->in_service + line] * (va[0] * re + va[1] * im);
}
#endif
