#ifndef INTERAREA_PORT_H
#define INTERAREA_PORT_H
#include "../machine/bus_device.h"
#include "../machine/load.h"
#include "../machine/saturation.h"
#include "../numbers/tiled.h"
/* Ports: where nonlinear elements meet the linear network. Port p injects a
 * current J_p(V_p, x) that depends on its own voltage; with the EMFs E
 *
 *     V_p = sum_k W_pk E_k + sum_q Z_pq J_q.
 *
 * A load's port is its bus. A machine's port is the air-gap node, and its current
 * acts like the EMF j (Xd2 - Xl) J added to its own: topology.c folds that into the
 * columns, so that everything behind the ports sees n_source = n_machine + n_port
 * sources.
 *
 * With any slopes D (2 x 2 for each port, in real and imaginary parts) the same equations read
 *
 *     V = b(E) + Zf [J(V, x) - D V],  b(E) = (1 - Z D)^-1 W E,  Zf = (1 - Z D)^-1 Z,
 *
 * and repeating that converges as fast as D is near dJ/dV. Here the network is folded once for each of its stages,
 * with the slopes at rest: the same numbers for every run, whatever has happened in it, so that runs side by side
 * read one table. They stay good since the network is solved in a frame that has turned with the machines since
 * then (flow.h): J turns with V, so only what ports have turned against each other counts. What is left,
 * r = V - b, is small and smooth: the iteration starts where its last three values point to, and by how much that
 * missed at the same stage of the step before. Where it does not
 * contract, port.c folds with the slopes where the voltages are, or takes damped Newton steps; after a while, an event
 * like others, it is tried with those at rest again, since only runs that have these can go side by side on one memory.
 * Many ports on a sparse network are sparse_port.h's. Tangents take one exact Newton step (tangent.c). */

/* What the physics needs at the ports besides sources: air-gap or bus voltages,
 * at a machine's port its isd, isq, at the end of a dc link what it keeps. n_port each, one after the other. */
typedef struct { num *v_re, *v_im, *isd, *isq, *solved; } PortWork;

static inline PortWork port_arrays(num *scratch, size_t n)
{
    return (PortWork){ scratch, scratch + n, scratch + 2 * n, scratch + 3 * n, scratch + 4 * n };
}

/* Injected current of the ports from `first` on into the sources at n_machine.. known, held, open: of a dc link
 * (dc_link.h), held for each port. */
static inline void port_inject(const real *memory, const Plan *plan, size_t first, DcKnown known, const num *held,
                               flag open, const num *x, const num *sine, const num *cosine, PortWork w, num *e_re, num *e_im)
{
    const size_t n = plan->n_machine;
    num *size = e_re + n;   /* of the voltages, until a port injects: no root waits for another */
    const num *ed2 = machine_states(x, n, plan->n_sixth).ed2;

    for (size_t p = first; p < plan->n_port; ++p) size[p] = num_sqrt(w.v_re[p] * w.v_re[p] + w.v_im[p] * w.v_im[p]);
    for (size_t p = first; p < plan->n_port; ++p) {
        const real *row = memory + plan->port + P_ROWS * p;
        num *re = e_re + n + p, *im = e_im + n + p;
        if (port_is_load(row)) {
            load_injection(row, size[p], w.v_re[p], w.v_im[p], re, im);
        } else if (port_is_device(row)) {
            const size_t k = n + index_at(row, P_DEVICE);
            bus_device_injection(row, x, sine[k], cosine[k], size[p], w.v_re[p], w.v_im[p], re, im, known,
                                 held == NULL ? NULL : held + DC_HELD * p, open, w.solved + DC_SOLVED * p);
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

/* Whether the slopes at rest are to be folded again at time t, and the next time after t at which they are. One that
 * has gone by within a step of whoever integrates is made good later. */
static inline int port_rest_due(const double *memory, const Plan *plan, double t)
{
    return plan->folded > 0 && memory[plan->warm + W_REST] <= t;
}

static inline double port_rest_next(const double *memory, const Plan *plan, double t)
{
    if (plan->folded == 0) return INFINITY;
    return port_rest_due(memory, plan, t) ? t + memory[plan->warm + W_WAIT] : memory[plan->warm + W_REST];
}

/* Ports at buses come before those of machines. */
static inline size_t ports_at_buses(const real *memory, const Plan *plan)
{
    size_t count = 0;
    while (count < plan->n_port && !port_is_machine(memory + plan->port + P_ROWS * count)) ++count;
    return count;
}

/* Whether machines have ports: these come last. */
static inline int ports_of_machines(const real *memory, const Plan *plan)
{
    return plan->n_port > 0 && port_is_machine(memory + plan->port + P_ROWS * (plan->n_port - 1));
}

/* How well the ports are solved: within a step of the integrator, far below its own error; for whoever asks by
 * himself or looks for the instant of a switch; to rounding, as tangents need it. */
typedef enum { PORT_STEP, PORT_ALONE, PORT_EXACT } PortCare;

/* Work arrays: those of PortWork, and numbers of port_solve for each port besides
 * its 2 x (2 n_port)^2 for an inverse and its columns. */
enum { PORT_ARRAYS = 4 + DC_SOLVED, PORT_NEWTON = 12 };

#if !defined PLANT_TANGENT
static inline num num_size(num a) { return num_pick(num_above(NUM(0.0), a), -a, a); }
static inline num num_larger(num a, num b) { return num_pick(num_above(b, a), b, a); }

/* b from the EMFs, or of few ports from their voltages without what they inject. work: 2 n_port. */
static inline void port_linear(const real *memory, const Plan *plan, size_t lanes, const num *e_re, const num *e_im,
                              const num *linear, num *b, num *work)
{
    const size_t n = 2 * plan->n_port, m = plan->n_machine;
    const real *from = memory + plan->port_b;

    if (linear != NULL) {
        TILED(num_product, lanes, n, NULL, from, n, n, linear, b);
        return;
    }
    TILED(num_product, lanes, n, NULL, from, n, m, e_re, work);
    TILED(num_product, lanes, n, work, from + n * m, n, m, e_im, b);
}

static const double PORT_SAME_S = 1e-9;   /* times so close are one */

/* How far the ports, n numbers, were from where the solutions before pointed to at this stage of the step before, as they
 * nearly are again: what the states of a stage are off the motion is smooth from step to step. Null: outside a step. */
static inline num *port_missed(num *warm, size_t n, int stage)
{
    return stage > 0 && stage <= PORT_STAGES ? warm + W_V + 6 * n + n * (size_t)(stage - 1) : NULL;
}

/* Where the last solutions point to at this time, along a parabola, a line, or where they stand, into `aim`, and where
 * they are expected to be into v. Where `keep` says so, what a step done again has seen later is forgotten. */
static inline void port_predict(num *restrict warm, size_t n, flag keep, const num *restrict b, const num *restrict missed,
                                num *restrict aim, num *restrict v)
{
    num *last = warm + W_V, *r0 = last + n, *r1 = r0 + n, *r2 = r1 + n, *times = warm + W_FIRST;
    const num t = warm[W_TIME], never = NUM(INFINITY);

    for (int count = 0; count < 3; ++count) {
        const flag back = keep & num_above(times[0], t + PORT_SAME_S) & num_above(never, times[0]);
        if (!flag_any(back)) break;
        for (size_t k = 0; k < n; ++k) {
            r0[k] = num_pick(back, r1[k], r0[k]);
            r1[k] = num_pick(back, r2[k], r1[k]);
        }
        times[0] = num_pick(back, times[1], times[0]);
        times[1] = num_pick(back, times[2], times[1]);
        times[2] = num_pick(back, never, times[2]);
    }
    const num a = t - times[0], h = times[0] - times[1], g = times[1] - times[2];
    const flag known = num_above(never, times[0]);
    const flag ahead = num_above(a, NUM(PORT_SAME_S)) & num_reaches(2.0 * h, a);
    if (!flag_any(known)) {
        for (size_t k = 0; k < n; ++k) aim[k] = v[k] = last[k];
        return;
    }
    const flag bent = ahead & num_reaches(4.0 * g, a + h);   /* less than three: h or g is no positive number */
    const num line = num_pick(ahead, -num_ratio(a, h), NUM(0.0));
    const num w1 = num_pick(bent, -num_ratio(a * (a + h + g), h * g), line);
    const num w2 = num_pick(bent, num_ratio(a * (a + h), g * (h + g)), NUM(0.0));
    for (size_t k = 0; k < n; ++k) {
        aim[k] = num_pick(known, b[k] + (r0[k] + w1 * (r1[k] - r0[k]) + w2 * (r2[k] - r0[k])), last[k]);
        v[k] = missed == NULL ? aim[k] : num_pick(known, aim[k] + missed[k], aim[k]);
    }
}

/* The solution v at this time becomes the newest. */
static inline void port_keep(num *restrict warm, size_t n, flag keep, const num *restrict b, const num *restrict aim,
                             const num *restrict v, num *restrict missed)
{
    num *last = warm + W_V, *r0 = last + n, *r1 = r0 + n, *r2 = r1 + n, *times = warm + W_FIRST;
    const num t = warm[W_TIME];
    const flag known = num_above(NUM(INFINITY), times[0]);
    const flag moves = keep & flag_not(num_reaches(NUM(PORT_SAME_S), num_size(t - times[0])));

    times[2] = num_pick(moves, times[1], times[2]);
    times[1] = num_pick(moves, times[0], times[1]);
    times[0] = num_pick(keep, t, times[0]);
    for (size_t k = n; flag_any(moves) && k-- > 0;) {
        r2[k] = num_pick(moves, r1[k], r2[k]);
        r1[k] = num_pick(moves, r0[k], r1[k]);
    }
    for (size_t k = 0; flag_any(keep) && k < n; ++k) {
        r0[k] = num_pick(keep, v[k] - b[k], r0[k]);
        last[k] = num_pick(keep, v[k], last[k]);
        if (missed != NULL) missed[k] = num_pick(keep, num_pick(known, v[k] - aim[k], NUM(0.0)), missed[k]);
    }
}

/* Angles of dc links in this solution, for the next to start from. */
static inline void port_hold(const real *memory, const Plan *plan, flag keep, const num *solved, num *held)
{
    const real *row = memory + plan->port;

    if (plan->n_at_bus == 0) return;
    for (size_t p = 0; p < plan->n_port; ++p, row += P_ROWS, solved += DC_SOLVED, held += DC_HELD) {
        const size_t coupling = port_is_device(row) ? index_at(row, P_COUPLING) : COUPLING_NONE;
        if (coupling == COUPLING_RECTIFIER || coupling == COUPLING_INVERTER) dc_link_hold(keep, solved, held);
    }
}

/* What the slopes d leave of the injected currents, where `open`, and the currents from that. re, im: of the ports. */
static inline void port_left(const real *restrict d, size_t n, flag open, const num *restrict v, const num *restrict re,
                             const num *restrict im, num *restrict rest)
{
    for (size_t p = 0; p < n; ++p, d += 4) {
        rest[p] = num_pick(open, re[p] - (d[0] * v[p] + d[1] * v[n + p]), rest[p]);
        rest[n + p] = num_pick(open, im[p] - (d[2] * v[p] + d[3] * v[n + p]), rest[n + p]);
    }
}

static inline void port_whole(const real *restrict d, size_t n, const num *restrict v, const num *restrict rest,
                              num *restrict re, num *restrict im)
{
    for (size_t p = 0; p < n; ++p, d += 4) {
        re[p] = rest[p] + (d[0] * v[p] + d[1] * v[n + p]);
        im[p] = rest[n + p] + (d[2] * v[p] + d[3] * v[n + p]);
    }
}

/* The voltages become the next ones where `open`. Returns the largest move. */
static inline num port_move(size_t n, flag open, const num *restrict next, num *restrict v)
{
    num moved = NUM(0.0), across = NUM(0.0);   /* of the imaginary parts: a second sum need not wait for the first */

    for (size_t p = 0; p < n; ++p) {
        const num off = num_size(next[p] - v[p]), other = num_size(next[n + p] - v[n + p]);
        moved = num_pick(num_above(moved, off), moved, off);   /* NaN as well */
        across = num_pick(num_above(across, other), across, other);
        v[p] = num_pick(open, next[p], v[p]);
        v[n + p] = num_pick(open, next[n + p], v[n + p]);
    }
    return num_pick(num_above(moved, across), moved, across);
}

/* Fills the injected currents e[n_machine..] and w from b. True where that failed and port.c must help; the memory of
 * what was is changed only where `keep` says so. Steps go on until the next would move less than is asked for: how
 * much closer one brings is known from the solution before, so that a good start needs one. stage: that of a step, from
 * 1, or 0. work: 6 n_port. */
static inline flag port_iterate(const real *memory, const Plan *plan, size_t lanes, PortCare care, int stage, num *warm,
                                flag keep, const num *b, const num *x, const num *sine, const num *cosine, num *e_re, num *e_im,
                                PortWork w, num *work)
{
    enum { MOST = 16 };
    const double accuracy = care == PORT_EXACT ? 0.0 : 1e-12;
    const double rounding = 1e-13, slow_from = 0.3, least = 1e-4, margin = 4.0, decay = 1.1;
    const size_t n = plan->n_port, m = plan->n_machine;
    const real *slope = memory + plan->port_slope;
    num *v = w.v_re, *rest = work, *next = work + 2 * n, *aim = work + 4 * n, before = NUM(INFINITY), known = warm[W_RATIO], scale = NUM(1.0);
    num *missed = port_missed(warm, 2 * n, stage), *held = warm + W_V + 8 * n;
    flag open = num_above(NUM(memory[H_PORT_READY]), NUM(0.5)), failed = flag_not(open);

    for (size_t p = 0; p < 2 * n; ++p) {
        scale = num_larger(scale, num_size(b[p]));
        rest[p] = NUM(0.0);
    }
    port_predict(warm, 2 * n, keep, b, missed, aim, v);
    for (int count = 1; count <= MOST && flag_any(open); ++count) {
        port_inject(memory, plan, 0, count > 1 ? DC_ALL : DC_START, held, open, x, sine, cosine, w, e_re, e_im);
        port_left(slope, n, open, v, e_re + m, e_im + m, rest);
        TILED(num_product, lanes, 2 * n, b, memory + plan->port_z, 2 * n, 2 * n, rest, next);
        const num moved = port_move(n, open, next, v), ratio = num_ratio(moved, before);
        const flag quiet = num_reaches(rounding * scale, moved), first = num_above(NUM(1.5), NUM((double)count));
        const flag contracts = num_above(NUM(slow_from), ratio) | first | quiet;
        const flag poor = open & flag_not(num_above(NUM(1e6), moved) & contracts);
        failed = failed | poor;
        open = open & flag_not(poor);
        known = num_pick(open & flag_not(first), num_larger(ratio, NUM(least)), known);
        const num after = num_pick(first, margin * known, known) * moved;
        const flag enough = open & (quiet | num_reaches(NUM(accuracy), after));
        known = num_pick(enough & first & flag_not(quiet), known * decay, known);
        open = open & flag_not(enough);
        before = moved;
    }
    failed = failed | open;
    /* what the voltages were made from; a machine's isd and isq are wanted at the voltages themselves */
    port_whole(slope, n, v, rest, e_re + m, e_im + m);
    if (ports_of_machines(memory, plan))
        port_inject(memory, plan, ports_at_buses(memory, plan), DC_NOTHING, NULL, flag_all(), x, sine, cosine, w, e_re, e_im);
    keep = keep & flag_not(failed);
    port_keep(warm, 2 * n, keep, b, aim, v, missed);
    port_hold(memory, plan, keep, w.solved, held);
    warm[W_RATIO] = num_pick(keep, known, warm[W_RATIO]);
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

/* port.c: as port_iterate, with slopes where the voltages are and damped Newton steps where that fails. Returns n_port,
 * or the port farthest from a solution. linear: of few ports their voltages without what they inject; null: of
 * the EMFs' columns. w: arrays of PortWork, which lie one after the other. work: PORT_NEWTON n_port + 8 n_port^2. */
size_t port_solve(double *memory, const Plan *plan, size_t lanes, PortCare care, int stage, const double *x,
                  const double *sine, const double *cosine, double *e_re, double *e_im, const double *linear,
                  PortWork w, double *work);
/* The network folded with the slopes at rest; others, where they are wanted, are kept for `wait` seconds.
 * work: 2 n_machine + 6 n_port + 8 n_port^2. */
void port_fold_at_rest(double *memory, const Plan *plan, size_t lanes, double wait, double *work);
/* dJ/dV of port p, row by row, a machine's on its base. x, stride: as of bus_device_slope. */
void port_slope_at(const double *memory, const Plan *plan, size_t p, double v_re, double v_im, const double *x,
                   size_t stride, const double *sine, const double *cosine, double d[4]);
/* Inverse of 1 - Z dJ/dV at the voltages v (row-major, real and imaginary part of
 * each port in turn). 0: singular. work: 2 n_port doubles. */
int port_inverse(const double *memory, const Plan *plan, const double *v_re, const double *v_im,
                 const double *x, size_t stride, const double *sine, const double *cosine, double *inverse, double *work);
#endif
