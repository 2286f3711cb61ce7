#ifndef INTERAREA_PORT_H
#define INTERAREA_PORT_H
#include "../machine/load.h"
#include "../machine/saturation.h"
#include "../numbers/products.h"
/* Ports: where nonlinear elements meet the linear network. Port p injects a
 * current J_p(V_p, x) that depends on its own voltage; with the EMFs E
 *
 *     V_p = sum_k W_pk E_k + sum_q Z_pq J_q,   (W, Z) = port_w, by columns, per stage.
 *
 * A load's port is its bus. A machine's port is the air-gap node, and its current
 * acts like the EMF j (Xd2 - Xl) J added to its own: topology.c folds that into the
 * columns, so that everything behind the ports sees n_source = n_machine + n_port
 * sources.
 *
 * With the slopes D = dJ/dV of some earlier point (2 x 2 for each port, in real and
 * imaginary parts) the same equations read
 *
 *     V = b(E) + Zf [J(V, x) - D V],  b(E) = (1 - Z D)^-1 W E,  Zf = (1 - Z D)^-1 Z,
 *
 * a Newton step with those slopes for each evaluation of the right side, one real
 * matrix product. port_iterate repeats it from the voltages found last, moved by
 * the change of b: near the earlier point a few times give rounding. Where it does
 * not contract, port.c takes damped Newton steps with slopes of their own and folds
 * the network anew. Tangents take one exact Newton step (tangent.c). */

/* What the physics needs at the ports besides sources: air-gap or bus voltages,
 * and at a machine's port its isd, isq. n_port each. */
typedef struct { num *v_re, *v_im, *isd, *isq; } PortWork;

static inline PortWork port_arrays(num *scratch, size_t n)
{
    return (PortWork){ scratch, scratch + n, scratch + 2 * n, scratch + 3 * n };
}

/* Injected current of every port into the sources at n_machine.. */
static inline void port_inject(const real *memory, const Plan *plan, const num *ed2, const num *sine,
                               const num *cosine, PortWork w, num *e_re, num *e_im)
{
    const size_t n = plan->n_machine;

    for (size_t p = 0; p < plan->n_port; ++p) {
        const real *row = memory + plan->port + P_ROWS * p;
        num *re = e_re + n + p, *im = e_im + n + p;
        if (port_is_load(row)) {
            load_injection(row, w.v_re[p], w.v_im[p], re, im);
        } else {
            const size_t k = index_at(row, P_DEVICE);
            const flag on = num_above(NUM(row[P_ON]), NUM(0.5));   /* a tripped machine gives nothing */
            saturation_injection(row, w.v_re[p], w.v_im[p], sine[k], cosine[k], ed2[k], re, im,
                                 &w.isd[p], &w.isq[p]);
            *re = num_pick(on, *re, NUM(0.0));
            *im = num_pick(on, *im, NUM(0.0));
            w.isd[p] = num_pick(on, w.isd[p], NUM(0.0));
            w.isq[p] = num_pick(on, w.isq[p], NUM(0.0));
        }
    }
}

/* Work arrays: those of PortWork, and numbers of port_solve for each port besides
 * its (2 n_port)^2 for an inverse. */
enum { PORT_ARRAYS = 4, PORT_NEWTON = 10 };

#if !defined PLANT_TANGENT && !defined PLANT_ALIKE
static inline num num_size(num a) { return num_pick(num_above(NUM(0.0), a), -a, a); }

/* Fills the injected currents e[n_machine..] and w from the EMFs before them. True
 * where that failed and port.c must help; an idle lane never asks for it and keeps
 * its memory. work: 6 n_port. */
static inline flag port_iterate(real *memory, const Plan *plan, const num *ed2, const num *sine,
                                const num *cosine, num *e_re, num *e_im, PortWork w, num *work)
{
    enum { MOST = 12, ENOUGH = 6 };
    const size_t n = plan->n_port, m = plan->n_machine;
    const real *from_e = memory + plan->port_b, *from_j = memory + plan->port_z;
    const real *slope = memory + plan->port_slope;
    real *last = memory + plan->port_v, *last_b = last + 2 * n;
    num *b = work, *rest = work + 2 * n, *next = work + 4 * n;
    num size = NUM(1.0), before = NUM(1e30);
    const flag idle = num_above(NUM(memory[H_IDLE]), NUM(0.5)), busy = flag_not(idle);
    flag open = busy & num_above(NUM(memory[H_PORT_READY]), NUM(0.5));
    flag failed = busy & flag_not(open), tired = open & failed;

    for (size_t p = 0; p < 2 * n; ++p) b[p] = NUM(0.0);
    for (size_t k = 0; k < m; ++k) {
        const real *re = from_e + 4 * n * k, *im = re + 2 * n;
        for (size_t p = 0; p < 2 * n; ++p) b[p] += re[p] * e_re[k] + im[p] * e_im[k];
    }
    for (size_t p = 0; p < 2 * n; ++p) size += num_size(b[p]);
    for (size_t p = 0; p < n; ++p) {
        w.v_re[p] = last[p] + (b[p] - last_b[p]);
        w.v_im[p] = last[n + p] + (b[n + p] - last_b[n + p]);
    }
    for (int count = 1; count <= MOST && flag_any(open); ++count) {
        num moved = NUM(0.0);
        port_inject(memory, plan, ed2, sine, cosine, w, e_re, e_im);
        for (size_t p = 0; p < n; ++p) {
            const real *d = slope + 4 * p;
            rest[p] = e_re[m + p] - (d[0] * w.v_re[p] + d[1] * w.v_im[p]);
            rest[n + p] = e_im[m + p] - (d[2] * w.v_re[p] + d[3] * w.v_im[p]);
        }
        num_product(b, from_j, 2 * n, 2 * n, rest, next);
        for (size_t p = 0; p < n; ++p) {
            moved += num_size(next[p] - w.v_re[p]) + num_size(next[n + p] - w.v_im[p]);
            w.v_re[p] = num_pick(open, next[p], w.v_re[p]);
            w.v_im[p] = num_pick(open, next[n + p], w.v_im[p]);
        }
        open = open & flag_not(num_reaches(1e-13 * size, moved));
        const flag poor = open & flag_not(num_reaches(0.3 * before, moved));   /* NaN is poor as well */
        failed = failed | poor;
        open = open & flag_not(poor);
        before = moved;
        if (count == ENOUGH) tired = open;   /* slow: fold anew the next time */
    }
    failed = failed | open;
    port_inject(memory, plan, ed2, sine, cosine, w, e_re, e_im);
    memory[H_PORT_READY] = num_pick(failed | tired, NUM(0.0), NUM(memory[H_PORT_READY]));
    for (size_t p = 0; p < 2 * n; ++p) {
        const num v = p < n ? w.v_re[p] : w.v_im[p - n];
        last[p] = num_pick(failed | idle, NUM(last[p]), v);
        last_b[p] = num_pick(failed | idle, NUM(last_b[p]), b[p]);
    }
    return failed;
}
#endif

#ifndef PLANT_LANES
/* v = W e over `count` sources, whose columns are w_re + j w_im, added to what v holds. */
static inline void port_voltages(const double *w_re, const double *w_im, size_t n, size_t count, const num *e_re,
                                 const num *e_im, num *v_re, num *v_im)
{
    for (size_t k = 0; k < count; ++k) {
        const double *g = w_re + k * n, *b = w_im + k * n;
        const num er = e_re[k], ei = e_im[k];
        for (size_t p = 0; p < n; ++p) {
            v_re[p] += g[p] * er - b[p] * ei;
            v_im[p] += g[p] * ei + b[p] * er;
        }
    }
}
#endif

/* port.c: as port_iterate, with damped Newton steps where that fails. Returns n_port,
 * or the port farthest from a solution. w: arrays of PortWork. */
size_t port_solve(double *memory, const Plan *plan, const double *ed2, const double *sine,
                  const double *cosine, double *e_re, double *e_im, double *const w[4], double *work);
/* The same where the network gives the ports the voltages at work + 0 .. 2 n_port - 1 without what they inject, and
 * W of their own sources alone is kept (sparse_few.h). */
size_t port_solve_few(double *memory, const Plan *plan, const double *ed2, const double *sine, const double *cosine,
                      double *e_re, double *e_im, double *const w[4], double *work);
/* dJ/dV of port p, row by row, a machine's on its base. */
void port_slope_at(const double *memory, const Plan *plan, size_t p, double v_re, double v_im, const double *sine,
                   const double *cosine, double d[4]);
/* Inverse of 1 - Z dJ/dV at the voltages v (row-major, real and imaginary part of
 * each port in turn). 0: singular. work: 2 n_port doubles. */
int port_inverse(const double *memory, const Plan *plan, const double *v_re, const double *v_im,
                 const double *sine, const double *cosine, double *inverse, double *work);

#ifdef PLANT_LANES
/* port.c for one lane: its memory and the port's surroundings travel to `space` and
 * back. A lane without solution becomes NaN, which its driver finds. */
static inline void port_rescue(size_t lane, num *memory, const Plan *plan, const num *ed2, const num *sine,
                               const num *cosine, num *e_re, num *e_im, PortWork w, double *space)
{
    const size_t m = plan->n_machine, n = plan->n_port;
    double *own = space, *own_ed2 = own + plan->total, *own_sine = own_ed2 + m, *own_cosine = own_sine + m;
    double *own_re = own_cosine + m, *own_im = own_re + plan->n_source, *ports = own_im + plan->n_source;
    double *const at[4] = { ports, ports + n, ports + 2 * n, ports + 3 * n };
    num *const to[4] = { w.v_re, w.v_im, w.isd, w.isq };

    for (size_t k = 0; k < plan->total; ++k) own[k] = memory[k][lane];
    for (size_t k = 0; k < m; ++k) {
        own_ed2[k] = k < plan->n_sixth ? ed2[k][lane] : 0.0;
        own_sine[k] = sine[k][lane];
        own_cosine[k] = cosine[k][lane];
        own_re[k] = e_re[k][lane];
        own_im[k] = e_im[k][lane];
    }
    const size_t stuck = port_solve(own, plan, own_ed2, own_sine, own_cosine, own_re, own_im, at, ports + 4 * n);
    for (size_t k = plan->port_v; k < plan->total; ++k) memory[k][lane] = own[k];
    memory[H_PORT_READY][lane] = own[H_PORT_READY];
    for (size_t p = 0; p < n; ++p) {
        e_re[m + p][lane] = stuck < n ? NAN : own_re[m + p];
        e_im[m + p][lane] = own_im[m + p];
        for (size_t a = 0; a < 4; ++a) to[a][p][lane] = at[a][p];
    }
}
#endif
#endif
