#ifndef INTERAREA_PORT_H
#define INTERAREA_PORT_H
#include "load.h"
#include "saturation.h"
/* Ports: where nonlinear elements meet the linear network. Port p injects a
 * current J_p(V_p, x) that depends on its own voltage; with the EMFs E
 *
 *     V_p = sum_k W_pk E_k + sum_q Z_pq J_q,   (W, Z) = port_w, by columns, per stage.
 *
 * A load's port is its bus. A machine's port is the air-gap node, and its current
 * acts like the EMF j (Xd2 - Xl) J added to its own: stage.c folds that into the
 * columns, so that everything behind the ports sees n_source = n_machine + n_port
 * sources. The equations are solved by Newton's method in the 2 n_port reals, from
 * the voltages found last and with the inverse used last: near a solution that
 * needs no new one (port.c). Tangents take one exact Newton step (tangent.c). */

/* What the physics needs at the ports besides sources: air-gap or bus voltages,
 * and at a machine's port its isd, isq. n_port each. */
typedef struct { num *v_re, *v_im, *isd, *isq; } PortWork;

static inline PortWork port_arrays(num *scratch, size_t n)
{
    return (PortWork){ scratch, scratch + n, scratch + 2 * n, scratch + 3 * n };
}

/* Injected current of every port into the sources at n_machine.. */
static inline void port_inject(const double *memory, const Plan *plan, const num *ed2, const num *sine,
                               const num *cosine, PortWork w, num *e_re, num *e_im)
{
    const size_t n = plan->n_machine;

    for (size_t p = 0; p < plan->n_port; ++p) {
        const double *row = memory + plan->port + P_ROWS * p;
        if (port_is_load(row)) {
            load_injection(row, w.v_re[p], w.v_im[p], &e_re[n + p], &e_im[n + p]);
        } else if (row[P_ON] > 0.5) {
            const size_t k = index_at(row, P_DEVICE);
            saturation_injection(row, w.v_re[p], w.v_im[p], sine[k], cosine[k], ed2[k],
                                 &e_re[n + p], &e_im[n + p], &w.isd[p], &w.isq[p]);
        } else {
            e_re[n + p] = e_im[n + p] = w.isd[p] = w.isq[p] = 0.0;
        }
    }
}

/* v = W s over the sources first .. last - 1, added to what v holds. */
static inline void port_voltages(const double *memory, const Plan *plan, size_t first, size_t last,
                                 const num *e_re, const num *e_im, num *v_re, num *v_im)
{
    const size_t n = plan->n_port;

    for (size_t k = first; k < last; ++k) {
        const double *g = memory + plan->port_w_re + k * n, *b = memory + plan->port_w_im + k * n;
        const num er = e_re[k], ei = e_im[k];
        for (size_t p = 0; p < n; ++p) {
            v_re[p] += g[p] * er - b[p] * ei;
            v_im[p] += g[p] * ei + b[p] * er;
        }
    }
}

/* Work arrays of port_solve beyond PortWork, for each port. */
enum { PORT_ARRAYS = 4, PORT_NEWTON = 10 };

/* port.c: fills the injected currents e[n_machine..] and w from the EMFs before
 * them. Returns n_port, or the port farthest from a solution. */
size_t port_solve(double *memory, const Plan *plan, const double *ed2, const double *sine,
                  const double *cosine, double *e_re, double *e_im, double *const w[4], double *work);
/* Inverse of 1 - Z dJ/dV at the voltages v (row-major, real and imaginary part of
 * each port in turn). 0: singular. work: 2 n_port doubles. */
int port_inverse(const double *memory, const Plan *plan, const double *v_re, const double *v_im,
                 const double *sine, const double *cosine, double *inverse, double *work);
#endif
