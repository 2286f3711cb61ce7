/* Linear controller with limited outputs:
 *
 *     dx/dt = A x + B u,    v = C x + D u,    y_i = min(max(v_i, -low_i), high_i)
 *
 * Without a guard (guard.h) low = high = limit.
 *
 * Which side adds to a swing depends on which end of a tie sends. Guards that
 * follow a power flow f have their sides times that of its slow course c, which
 * starts at the flow at rest:
 *
 *     dc/dt = (f - c) / washout,   side = given side * max(-1, min(1, c / flow))
 *
 * The matrices are parameters of the FMU, rows first, in the order A, B, C, D,
 * limit; then, where the record has `guard`, side of each guarded output,
 * threshold, washout and lowpass, and where it has `guard.follows` (the number of
 * an input), flow. A limited output moves with its limit only: its directional
 * derivative is that of the limit. On a limit itself the inner side is taken.
 *
 * With a Boolean input for each signal, u is 0 in place of a signal that is not trusted. */
#include <math.h>
#include <stdio.h>
#include <string.h>

#include "../block/block.h"
#include "guard.h"

const int block_is_sampled = 0;

/* outputs with a guard, where in the record their weights are, input they follow (or none: -1) */
enum { M_GUARDS, M_WEIGHTS, M_FOLLOWS, M_COUNT };

typedef struct {
    const double *A, *B, *C, *D;
    double limit;
    size_t n;       /* states of the linear part                            */
    Guards guards;
    double flow;    /* at which the sides are whole                         */
    int32_t follows; /* input whose slow course is the last state; -1: none */
} Gains;

/* The input whose sign turns the sides; -1: none. */
static int32_t followed(const Record *record)
{
    size_t count;
    const int32_t *input = record_i32(record, "guard.follows", &count);

    return input != NULL && count == 1 ? input[0] : -1;
}

static Gains gains_of(const Block *b)
{
    const size_t m = b->layout.n_u, p = b->layout.n_y;
    Gains g;

    g.guards = (Guards){(size_t)b->memory[M_GUARDS], m, NULL, NULL, 1.0, 1.0, 1.0};
    if (g.guards.guards > 0)
        g.guards.weights = (const double *)(const void *)(b->record->bytes + (size_t)b->memory[M_WEIGHTS]);
    g.follows = (int32_t)b->memory[M_FOLLOWS];
    g.n = b->layout.n_x - 2 * g.guards.guards - (g.follows >= 0 ? 1u : 0u);
    g.A = b->p;
    g.B = g.A + g.n * g.n;
    g.C = g.B + g.n * m;
    g.D = g.C + p * g.n;
    g.limit = g.D[p * m];
    guards_set(&g.guards, g.D + p * m + 1);
    g.flow = g.follows >= 0 ? g.guards.side[g.guards.guards + 3] : 1.0;
    return g;
}

/* By what the sides of the guards are multiplied. */
static double turn_of(const Gains *g, const double *x)
{
    return g->follows < 0 ? 1.0 : fmax(-1.0, fmin(1.0, x[g->n + 2 * g->guards.guards] / g->flow));
}

/* Derivative of that. */
static double turn_slope(const Gains *g, double turn, const double *vx)
{
    return g->follows >= 0 && fabs(turn) < 1.0 ? vx[g->n + 2 * g->guards.guards] / g->flow : 0.0;
}

/* out = M x + N u */
static void multiply(const double *M, const double *N, size_t rows, size_t n, size_t m,
                     const double *x, const double *u, double *out)
{
    for (size_t i = 0; i < rows; ++i) {
        double sum = 0.0;
        for (size_t j = 0; j < n; ++j) sum += M[i * n + j] * x[j];
        for (size_t j = 0; j < m; ++j) sum += N[i * m + j] * u[j];
        out[i] = sum;
    }
}

/* u, or where signals have flags a copy with 0 in place of those not trusted. */
static const double *trusted(const Block *b, const double *u, double *copy)
{
    for (size_t j = 0; j < b->layout.n_iu; ++j) copy[j] = b->iu[j] ? u[j] : 0.0;
    return b->layout.n_iu > 0 ? copy : u;
}

BlockStatus block_needs(const Record *record, const BlockLayout *layout, BlockNeeds *needs,
                        BlockMessage *message)
{
    const size_t m = layout->n_u, p = layout->n_y;
    const int32_t follows = followed(record);
    const size_t guards = guards_of(record, p, m).guards, turned = follows >= 0 ? 1u : 0u;
    const size_t own = guards > 0 ? guards + 3 + turned : 0, extra = 2 * guards + turned;
    const size_t n = layout->n_x - extra;
    const int fits = layout->n_x >= extra && (layout->n_iu == 0 || layout->n_iu == m) && layout->n_ip == 0
               && turned <= guards && follows < (int32_t)m
               && layout->n_p == n * n + n * m + p * n + p * m + 1 + own;

    if (!fits) {
        snprintf(message->text, sizeof message->text,
                 "controller: %zu states, %zu inputs, %zu outputs and %zu guards do not match %zu parameters",
                 layout->n_x, m, p, guards, layout->n_p);
        return BLOCK_ERROR;
    }
    needs->n_memory = M_COUNT;
    needs->n_scratch = p + 2 * layout->n_iu;
    return BLOCK_OK;
}

BlockStatus block_start(Block *b, double t, BlockMessage *message)
{
    const Guards guards = guards_of(b->record, b->layout.n_y, b->layout.n_u);
    const unsigned char *weights = (const unsigned char *)guards.weights;

    (void)t;
    b->memory[M_GUARDS] = (double)guards.guards;
    b->memory[M_WEIGHTS] = guards.guards == 0 ? 0.0 : (double)(weights - b->record->bytes);
    b->memory[M_FOLLOWS] = (double)followed(b->record);
    const Gains g = gains_of(b);
    if (!(g.limit > 0.0)) {
        snprintf(message->text, sizeof message->text, "controller: limit is %g, it must be positive", g.limit);
        return BLOCK_ERROR;
    }
    if (!(guards_can_act(&g.guards) && g.flow > 0.0)) {
        snprintf(message->text, sizeof message->text,
                 "controller: guard_threshold is %g, guard_washout %g, guard_lowpass %g, guard_flow %g; "
                 "all must be positive", g.guards.threshold, g.guards.washout, g.guards.lowpass, g.flow);
        return BLOCK_ERROR;
    }
    if (g.follows >= 0) b->x[g.n + 2 * g.guards.guards] = b->u[g.follows];
    return BLOCK_OK;
}

BlockStatus block_derivatives(Block *b, double t, const double *x, const double *u, double *dx,
                              BlockMessage *message)
{
    const Gains g = gains_of(b);

    (void)t, (void)message;
    u = trusted(b, u, b->scratch + b->layout.n_y);
    multiply(g.A, g.B, g.n, g.n, b->layout.n_u, x, u, dx);
    for (size_t i = 0, k = g.n; k < g.n + 2 * g.guards.guards; ++i) {
        if (!guards_watch(&g.guards, i)) continue;
        const Swing s = guards_swing(&g.guards, x + k, guards_seen(&g.guards, i, u));
        guards_derivatives(&g.guards, s.fast, s.slow, dx + k);
        k += 2;
    }
    if (g.follows >= 0) {
        const size_t course = g.n + 2 * g.guards.guards;
        dx[course] = (u[g.follows] - x[course]) / g.guards.washout;
    }
    return BLOCK_OK;
}

BlockStatus block_outputs(Block *b, double t, const double *x, const double *u, double *y,
                          BlockMessage *message)
{
    const Gains g = gains_of(b);

    (void)t, (void)message;
    u = trusted(b, u, b->scratch + b->layout.n_y);
    multiply(g.C, g.D, b->layout.n_y, g.n, b->layout.n_u, x, u, y);
    for (size_t i = 0, k = 0; i < b->layout.n_y; ++i) {
        double high = g.limit, low = g.limit;
        if (guards_watch(&g.guards, i)) {
            const Swing s = guards_swing(&g.guards, x + g.n + 2 * k, guards_seen(&g.guards, i, u));
            const double taken = s.share * g.guards.side[k] * turn_of(&g, x);
            high *= 1.0 - fmax(taken, 0.0);
            low *= 1.0 + fmin(taken, 0.0);
            ++k;
        }
        y[i] = y[i] > high ? high : y[i] < -low ? -low : y[i];
    }
    return BLOCK_OK;
}

BlockStatus block_directional(Block *b, double t, const double *x, const double *u, const double *vx,
                              const double *vu, double *vdx, double *vy, BlockMessage *message)
{
    const Gains g = gains_of(b);
    const size_t m = b->layout.n_u, p = b->layout.n_y, course = g.n + 2 * g.guards.guards;
    const double turn = turn_of(&g, x), vturn = turn_slope(&g, turn, vx);

    (void)t, (void)message;
    u = trusted(b, u, b->scratch + p);
    vu = trusted(b, vu, b->scratch + p + b->layout.n_iu);
    if (vdx != NULL && g.follows >= 0) vdx[course] = (vu[g.follows] - vx[course]) / g.guards.washout;
    if (vdx != NULL) multiply(g.A, g.B, g.n, g.n, m, vx, vu, vdx);
    if (vy != NULL) {
        multiply(g.C, g.D, p, g.n, m, vx, vu, vy);
        multiply(g.C, g.D, p, g.n, m, x, u, b->scratch);
    }
    for (size_t i = 0, k = 0; i < p; ++i) {
        double high = g.limit, low = g.limit, slope = 0.0;
        if (guards_watch(&g.guards, i)) {
            const size_t own = g.n + 2 * k;
            const Swing s = guards_swing(&g.guards, x + own, guards_seen(&g.guards, i, u));
            const double vfast = guards_seen(&g.guards, i, vu) - vx[own], vslow = vx[own + 1];
            const double taken = s.share * g.guards.side[k] * turn;
            if (vdx != NULL) guards_derivatives(&g.guards, vfast, vslow, vdx + own);
            slope = guards_slope(&g.guards, &s, k, g.limit, turn, vfast, vslow, vturn);
            high *= 1.0 - fmax(taken, 0.0);
            low *= 1.0 + fmin(taken, 0.0);
            ++k;
        }
        if (vy == NULL) continue;
        if (b->scratch[i] > high) vy[i] = high < g.limit ? slope : 0.0;
        else if (b->scratch[i] < -low) vy[i] = low < g.limit ? -slope : 0.0;
    }
    return BLOCK_OK;
}

double block_next_event(const Block *b, double t)
{
    (void)b, (void)t;
    return INFINITY;
}

BlockStatus block_event(Block *b, double t, double *x, BlockMessage *message)
{
    (void)b, (void)t, (void)x, (void)message;
    return BLOCK_OK;
}

BlockStatus block_step(Block *b, double t, double h, const double *u_poly, double *dy, BlockMessage *message)
{
    (void)b, (void)t, (void)h, (void)u_poly, (void)dy;
    snprintf(message->text, sizeof message->text, "controller: not a sampled block");
    return BLOCK_ERROR;
}
