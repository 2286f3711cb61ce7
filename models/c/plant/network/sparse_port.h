#ifndef INTERAREA_SPARSE_PORT_H
#define INTERAREA_SPARSE_PORT_H
#include "network.h"
#include "port.h"
/* Ports (port.h) on a sparse network. With the slopes D = dJ/dV of some earlier point in the factors
 * of Y - D the node voltages obey
 *
 *     V = (Y - D)^-1 [y E + J(V, x) - D V],
 *
 * a Newton step with those slopes for each evaluation of the right side: one solution. It is repeated
 * from where the ports' voltages found last point to; where it does not contract, sparse_port.c renews the
 * slopes, then takes damped Newton steps. Of one step at voltages that solve the equations, with the slopes there, the
 * tangent is exact. */

/* A machine's injection, which is on its base, on the system's. */
static inline void sparse_port_scale(const real *memory, const Plan *plan, size_t first, num *e_re, num *e_im)
{
    const real *ratio = memory + plan->machine + M_RATIO * plan->n_machine;

    for (size_t p = first; p < plan->n_port; ++p) {
        const real *row = memory + plan->port + P_ROWS * p;
        if (!port_is_machine(row)) continue;
        e_re[plan->n_machine + p] *= ratio[index_at(row, P_DEVICE)];
        e_im[plan->n_machine + p] *= ratio[index_at(row, P_DEVICE)];
    }
}

/* What the ports from `first` on inject at their nodes, into e. */
static inline void sparse_port_inject(const real *memory, const Plan *plan, size_t first, const num *x, const num *sine,
                                      const num *cosine, PortWork w, num *e_re, num *e_im)
{
    port_inject(memory, plan, first, DC_NOTHING, NULL, flag_all(), x, sine, cosine, w, e_re, e_im);
    sparse_port_scale(memory, plan, first, e_re, e_im);
}

/* One step from the port voltages in w: node voltages into v. base: what the EMFs inject. */
static inline void sparse_port_step(const real *memory, const Plan *plan, const Pattern *s, size_t lanes, const num *x,
                                    const num *sine, const num *cosine, const num *base, num *e_re, num *e_im,
                                    PortWork w, num *v)
{
    const real *slope = memory + plan->port_slope;
    const num *re = e_re + plan->n_machine, *im = e_im + plan->n_machine;

    sparse_port_inject(memory, plan, 0, x, sine, cosine, w, e_re, e_im);
    for (size_t k = 2 * plan->first; k < 2 * plan->n_node; ++k) v[k] = base[k];
    for (size_t p = 0; p < plan->n_port; ++p) {
        const real *d = slope + 4 * p;
        num *at = v + 2 * s->port[p];
        at[0] += re[p] - (d[0] * w.v_re[p] + d[1] * w.v_im[p]);
        at[1] += im[p] - (d[2] * w.v_re[p] + d[3] * w.v_im[p]);
    }
    network_solve(memory, plan, s, lanes, v);
}

/* The machines' currents and what the ports inject there. */
static inline void sparse_port_machines(const real *memory, const Plan *plan, const Pattern *s, const num *e_re,
                                        const num *e_im, const num *v, num *i_re, num *i_im)
{
    network_machines(memory, plan, s, e_re, e_im, v, i_re, i_im);
    for (size_t p = 0; p < plan->n_port; ++p) {
        const real *row = memory + plan->port + P_ROWS * p;
        const size_t k = index_at(row, P_DEVICE);
        if (!port_is_machine(row)) continue;
        i_re[k] += e_re[plan->n_machine + p];
        i_im[k] += e_im[plan->n_machine + p];
    }
}

/* The factors are those of another stage, without slopes, and so are all voltages before. */
static inline void sparse_port_forget(double *memory, const Plan *plan)
{
    double *of = memory + plan->warm;

    memory[H_FACTORS] += 1.0;
    of[F_NUMBER] = memory[H_FACTORS];
    of[F_READY] = 0.0;
    for (size_t k = 0; k < 3; ++k) memory[plan->port_past + k] = INFINITY;
}

/* Doubles of work for sparse_port_solve. */
static inline size_t sparse_port_work(const Plan *plan) { return 4 * plan->n_node + 4 * plan->n_port; }

/* With PORT_EXACT the slopes in the factors are those at the solution. Node voltages v, port voltages and what goes with them into w, of machines' ports also injections into e. Starts
 * where the last solutions point to at memory[warm + F_TIME]. Returns n_port, or the port farthest from a solution. */
size_t sparse_port_solve(double *memory, const Plan *plan, const Pattern *pattern, size_t lanes, PortCare care, const double *x,
                         const double *sine, const double *cosine, const double *base, double *e_re, double *e_im,
                         PortWork w, double *v, double *work);
#endif
