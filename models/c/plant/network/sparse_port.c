/* Newton's method at the ports of a sparse network (sparse_port.h). */
#include "sparse_port.h"

#include "sparse_factor.h"

enum { MOST = 12, ENOUGH = 5, MOST_STEPS = 40 };
static const double ACCURACY = 1e-11;   /* of the voltages, estimated error relative to the largest */
static const double STEP_ACCURACY = 1e-7; /* the same within a step of the integrator, whose own error is 1e-5 */
static const double ROUNDING = 1e-13;   /* what a further step moves when all is said */
static const double SLOW = 0.3;         /* contraction above which other slopes are wanted */
static const double SLOWER = 0.004;     /* contraction above which they are wanted when these have been used enough */
static const double OFTEN = 64.0;        /* solutions that pay for other slopes */
static const double LEAST = 1e-4;       /* contraction that is believed */
static const double MARGIN = 2.0;        /* how much slower it may be than a solution before has found it */
static const double DECAY = 1.05;      /* by what it is taken to be slower after a solution that did not look */
static const double SAME_S = 1e-9;      /* times so close are one */
static const double MOST_FLUX = 1.2;    /* where an iteration may start: psi_I grows exponentially */

/* One problem: everything that stays the same while it is solved. */
typedef struct {
    double *memory;
    const Plan *plan;
    const Pattern *pattern;
    size_t lanes;
    const double *x, *sine, *cosine, *base;
    double *e_re, *e_im;
    PortWork at;
    double *v, *work;
} Problem;

static double larger(double a, double b) { return a > b ? a : b; }

/* One step with the slopes in the factors; returns the largest move, and leaves the new voltages in s->v. */
static double step(const Problem *s, size_t *port)
{
    double moved = 0.0;

    sparse_port_step(s->memory, s->plan, s->pattern, s->lanes, s->x, s->sine, s->cosine, s->base, s->e_re, s->e_im, s->at,
                     s->v);
    for (size_t p = 0; p < s->plan->n_port; ++p) {
        const double *v = s->v + 2 * s->pattern->port[p];
        const double off = fabs(v[0] - s->at.v_re[p]) + fabs(v[1] - s->at.v_im[p]);
        if (!(off <= moved)) {
            moved = off;
            *port = p;
        }
    }
    return moved;
}

static void take(const Problem *s, double share)
{
    for (size_t p = 0; p < s->plan->n_port; ++p) {
        const double *v = s->v + 2 * s->pattern->port[p];
        s->at.v_re[p] += share * (v[0] - s->at.v_re[p]);
        s->at.v_im[p] += share * (v[1] - s->at.v_im[p]);
    }
}

static void start_from_last(const Problem *s)
{
    const double *last = s->memory + s->plan->port_v;
    for (size_t p = 0; p < s->plan->n_port; ++p) {
        s->at.v_re[p] = last[p];
        s->at.v_im[p] = last[s->plan->n_port + p];
    }
}

/* Older solutions move up: the newest is forgotten, or left to be overwritten. */
static void shift(const Problem *s, int forget)
{
    const size_t n = 2 * s->plan->n_port;
    double *times = s->memory + s->plan->port_past, *newest = s->memory + s->plan->port_v;
    double *older = times + 3, *oldest = older + n;

    if (forget) {
        if (times[1] < INFINITY) memcpy(newest, older, n * sizeof(double));
        memcpy(older, oldest, n * sizeof(double));
        times[0] = times[1];
        times[1] = times[2];
        times[2] = INFINITY;
    } else {
        memcpy(oldest, older, n * sizeof(double));
        memcpy(older, newest, n * sizeof(double));
        times[2] = times[1];
        times[1] = times[0];
    }
}

/* Where the last solutions point to at this time: along a parabola, a line, or where they stand. A step that is
 * done again goes back in time. */
static void start_from_past(const Problem *s)
{
    const size_t n = s->plan->n_port;
    const double *times = s->memory + s->plan->port_past, *newest = s->memory + s->plan->port_v;
    const double *older = times + 3, *oldest = older + 2 * n, t = s->memory[s->plan->warm + F_TIME];
    double w1 = 0.0, w2 = 0.0;

    while (times[0] < INFINITY && times[0] > t + SAME_S) shift(s, 1);
    const double a = t - times[0], b = times[0] - times[1], c = times[1] - times[2];
    const int ahead = a > SAME_S && a <= 2.0 * b, bent = ahead && a + b <= 4.0 * c;
    if (bent) {   /* less than three: b or c is no positive number */
        w1 = -a * (a + b + c) / (b * c);
        w2 = a * (a + b) / (c * (b + c));
    } else if (ahead) {
        w1 = -a / b;
    }
    for (size_t p = 0; p < n; ++p) {
        s->at.v_re[p] = newest[p];
        s->at.v_im[p] = newest[n + p];
        if (ahead) {
            s->at.v_re[p] += w1 * (older[p] - newest[p]);
            s->at.v_im[p] += w1 * (older[n + p] - newest[n + p]);
        }
        if (bent) {
            s->at.v_re[p] += w2 * (oldest[p] - newest[p]);
            s->at.v_im[p] += w2 * (oldest[n + p] - newest[n + p]);
        }
    }
}

static void keep(const Problem *s)
{
    double *times = s->memory + s->plan->port_past, *last = s->memory + s->plan->port_v;
    const double t = s->memory[s->plan->warm + F_TIME];

    if (!(fabs(t - times[0]) <= SAME_S)) shift(s, 0);
    times[0] = t;
    for (size_t p = 0; p < s->plan->n_port; ++p) {
        last[p] = s->at.v_re[p];
        last[s->plan->n_port + p] = s->at.v_im[p];
    }
}

/* The slopes in memory into the factors. 0: singular. */
static int factor(const Problem *s)
{
    double *memory = s->memory, *of = memory + s->plan->warm;

    memory[H_FACTORS] += 1.0;
    of[F_NUMBER] = memory[H_FACTORS];
    return sparse_factor(memory, s->plan, s->pattern, s->lanes, SPARSE_PATH, s->work) == s->plan->n_node;
}

/* A step that has been undone may leave factors with other slopes. */
static void restore_factors(const Problem *s)
{
    double *of = s->memory + s->plan->warm;
    if (of[F_NUMBER] < s->memory[H_FACTORS] && !factor(s)) of[F_READY] = 0.0;
}

/* Slopes at the port voltages in s->at into the factors. 0: singular. */
static int fold(const Problem *s)
{
    double *memory = s->memory, *at = memory + s->plan->port_fold;
    const double *ratio = memory + s->plan->machine + M_RATIO * s->plan->n_machine;

    for (size_t p = 0; p < s->plan->n_port; ++p) {
        const double *row = memory + s->plan->port + P_ROWS * p;
        const double of = port_is_machine(row) ? ratio[index_at(row, P_DEVICE)] : 1.0;
        double *d = memory + s->plan->port_slope + 4 * p;
        port_slope_at(memory, s->plan, p, s->at.v_re[p], s->at.v_im[p], s->x, 1, s->sine, s->cosine, d);
        for (size_t i = 0; i < 4; ++i) d[i] *= of;
        at[2 * p] = s->at.v_re[p];
        at[2 * p + 1] = s->at.v_im[p];
    }
    double *of = memory + s->plan->warm;
    of[F_READY] = factor(s) ? 1.0 : 0.0;
    of[F_RATIO] = 1.0;
    of[F_USED] = 0.0;
    return of[F_READY] > 0.5;
}

/* Steps with the same slopes until the next would move nothing worth it; 0: they do not contract. How well they
 * do is known from the solution before, so that a good start needs one. */
static int iterate(const Problem *s, double accuracy, size_t *port)
{
    double *of = s->memory + s->plan->warm, *known = of + F_RATIO, before = INFINITY;

    for (int count = 1; count <= MOST; ++count) {
        const double moved = step(s, port), ratio = moved / before;
        if (!(moved < 1e6) || (moved > ROUNDING && !(ratio < SLOW) && count > 1)) return 0;
        take(s, 1.0);
        if (count == ENOUGH) of[F_READY] = 0.0;   /* slow: other slopes the next time */
        if (count > 1) *known = larger(ratio, LEAST);
        if (moved <= ROUNDING) return 1;
        if (moved * *known * (count > 1 ? 1.0 : MARGIN) <= accuracy) {
            if (count == 1) *known *= DECAY;
            return 1;
        }
        before = moved;
    }
    return 0;
}

/* Newton steps with slopes of their own from s->at, halved until the next step would be shorter, or `free`
 * to grow, which passes the slope discontinuities where a load becomes an impedance. */
static int newton(const Problem *s, int free, size_t *port)
{
    double *from = s->work + 4 * s->plan->n_node, *to = from + 2 * s->plan->n_port;

    for (int count = 0; count < MOST_STEPS; ++count) {
        double moved, share = 1.0, next = INFINITY;
        if (!fold(s)) return 0;
        moved = step(s, port);
        if (!(moved < 1e6)) return 0;
        for (size_t p = 0; p < s->plan->n_port; ++p) {
            from[2 * p] = s->at.v_re[p];
            from[2 * p + 1] = s->at.v_im[p];
            to[2 * p] = s->v[2 * s->pattern->port[p]];
            to[2 * p + 1] = s->v[2 * s->pattern->port[p] + 1];
        }
        for (int tries = 0; tries < 10; ++tries, share *= 0.5) {
            for (size_t p = 0; p < s->plan->n_port; ++p) {
                s->at.v_re[p] = from[2 * p] + share * (to[2 * p] - from[2 * p]);
                s->at.v_im[p] = from[2 * p + 1] + share * (to[2 * p + 1] - from[2 * p + 1]);
            }
            if (moved <= ROUNDING) return 1;
            next = step(s, port);
            if (free || next <= larger((1.0 - 0.25 * share) * moved, ROUNDING)) break;
        }
        if (!(next < 1e6)) return 0;
        if (next < 1e-6) return fold(s) && iterate(s, ACCURACY, port);
    }
    return 0;
}

/* As port.c: from the last voltages, those of the linear network, then low ones. */
static int newton_from_many(const Problem *s, size_t *port)
{
    const size_t n = s->plan->n_port, from = 2 * s->plan->first;

    for (size_t tries = 0; tries < 8; ++tries) {
        const double share = tries % 4 < 2 ? 1.0 : tries % 4 == 2 ? 0.6 : 0.2;
        start_from_last(s);
        if (tries % 4 > 0) {   /* without what the ports inject */
            for (size_t k = 0; k < 4 * n; ++k) s->memory[s->plan->port_slope + k] = 0.0;
            if (!factor(s)) return 0;
            memcpy(s->v + from, s->base + from, (2 * s->plan->n_node - from) * sizeof(double));
            network_solve(s->memory, s->plan, s->pattern, s->lanes, s->v);
            take(s, 1.0);
        }
        for (size_t p = 0; p < n; ++p) {
            const double size = sqrt(s->at.v_re[p] * s->at.v_re[p] + s->at.v_im[p] * s->at.v_im[p]);
            const double own = share * (size > MOST_FLUX ? MOST_FLUX / size : 1.0);
            s->at.v_re[p] *= own;
            s->at.v_im[p] *= own;
        }
        if (newton(s, tries >= 4, port)) return 1;
    }
    return 0;
}

/* Whether the slopes in the factors are those at the solution. */
static int folded_at(const Problem *s)
{
    const double *at = s->memory + s->plan->port_fold;
    double off = s->memory[s->plan->warm + F_READY] > 0.5 ? 0.0 : 1.0;
    for (size_t p = 0; p < s->plan->n_port; ++p)
        off = larger(off, fabs(s->at.v_re[p] - at[2 * p]) + fabs(s->at.v_im[p] - at[2 * p + 1]));
    return off <= 1e-12;
}

size_t sparse_port_solve(double *memory, const Plan *plan, const Pattern *pattern, size_t lanes, PortCare care, const double *x,
                         const double *sine, const double *cosine, const double *base, double *e_re, double *e_im,
                         PortWork w, double *v, double *work)
{
    const Problem problem = { memory, plan, pattern, lanes, x, sine, cosine, base, e_re, e_im, w, v, work };
    const Problem *s = &problem;
    const double accuracy = care == PORT_EXACT ? 0.0 : care == PORT_STEP ? STEP_ACCURACY : ACCURACY;
    size_t port = 0;

    double *of = memory + plan->warm;
    restore_factors(s);
    start_from_past(s);
    int solved = of[F_READY] > 0.5 && iterate(s, accuracy, &port);
    if (!solved) {
        start_from_last(s);
        solved = fold(s) && iterate(s, accuracy, &port);
    }
    if (!solved) solved = newton_from_many(s, &port);
    if (!solved) {
        of[F_READY] = 0.0;
        return port;
    }
    if (care == PORT_EXACT && !folded_at(s) && !fold(s)) return port;
    if (plan->n_node > plan->n_bus)
        sparse_port_inject(memory, plan, ports_at_buses(memory, plan), x, sine, cosine, w, e_re, e_im);
    keep(s);
    of[F_USED] += 1.0;
    if (of[F_RATIO] > SLOWER && of[F_USED] >= OFTEN) of[F_READY] = 0.0;
    return plan->n_port;
}
