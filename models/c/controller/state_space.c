/* Linear controller with limited outputs:
 *
 *     dx/dt = A x + B u,    v = C x + D u,    y_i = min(max(v_i, -low_i), high_i)
 *
 * Without a guard low = high = limit. An output with a guard watches one input,
 * s: how far the speed has left its slow course says that a first swing lasts,
 * and meanwhile the side that would add to that swing falls towards zero:
 *
 *     dw/dt = (s - w) / washout,   dl/dt = (s - w - l) / lowpass,
 *     q = min(1, max(|s - w|, |l|) / threshold),
 *     high = limit (1 - q side) where side > 0,   low = limit (1 + q side) where side < 0
 *
 * Which side adds to a swing depends on which end of a tie sends. Guards that
 * follow a power flow f have their sides times that of its slow course c, which
 * starts at the flow at rest:
 *
 *     dc/dt = (f - c) / washout,   side = given side * max(-1, min(1, c / flow))
 *
 * The matrices are parameters of the FMU, rows first, in the order A, B, C, D,
 * limit; then, where the record has `guard` (per output the number of the input
 * that it watches, or -1), side of each guarded output, threshold, washout and
 * lowpass, and where it has `guard.follows` (the number of an input), flow. A limited output moves with its limit only: its directional
 * derivative is that of the limit. On a limit itself the inner side is taken.
 *
 * With a Boolean input for each signal, u is 0 in place of a signal that is not trusted. */
#include <math.h>
#include <stdio.h>
#include <string.h>

#include "../block/block.h"

const int block_is_sampled = 0;

/* outputs with a guard, where in the record they are named, input they follow (or none: -1) */
enum { M_GUARDS, M_WATCHED, M_FOLLOWS, M_COUNT };

typedef struct {
    const double *A, *B, *C, *D;
    double limit;
    size_t n, guards;            /* states of the linear part; outputs with a guard */
    const int32_t *watched;      /* per output, NULL: no guards                     */
    const double *side;          /* per guard                                       */
    double threshold, washout, lowpass;
    double flow;                 /* at which the sides are whole                    */
    int32_t follows;             /* input whose slow course is the last state; -1: none */
} Gains;

/* What a guard sees: signal behind the washout and its low pass, and their share of the threshold. */
typedef struct { double fast, slow, share; } Swing;

static size_t guards_of(const Record *record, size_t outputs, const int32_t **watched)
{
    size_t count, guards = 0;

    *watched = record_i32(record, "guard", &count);
    if (*watched == NULL || count != outputs) return *watched = NULL, 0;
    for (size_t i = 0; i < outputs; ++i) guards += (*watched)[i] >= 0 ? 1u : 0u;
    return guards;
}

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

    g.guards = (size_t)b->memory[M_GUARDS];
    g.watched = g.guards == 0 ? NULL : (const int32_t *)(const void *)(b->record->bytes + (size_t)b->memory[M_WATCHED]);
    g.follows = (int32_t)b->memory[M_FOLLOWS];
    g.n = b->layout.n_x - 2 * g.guards - (g.follows >= 0 ? 1u : 0u);
    g.A = b->p;
    g.B = g.A + g.n * g.n;
    g.C = g.B + g.n * m;
    g.D = g.C + p * g.n;
    g.limit = g.D[p * m];
    g.side = g.D + p * m + 1;
    g.threshold = g.guards > 0 ? g.side[g.guards] : 1.0;
    g.washout = g.guards > 0 ? g.side[g.guards + 1] : 1.0;
    g.lowpass = g.guards > 0 ? g.side[g.guards + 2] : 1.0;
    g.flow = g.follows >= 0 ? g.side[g.guards + 3] : 1.0;
    return g;
}

static Swing swing_of(const Gains *g, const double *x, double signal, size_t guard)
{
    Swing s;

    s.fast = signal - x[g->n + 2 * guard];
    s.slow = x[g->n + 2 * guard + 1];
    s.share = fmin(1.0, fmax(fabs(s.fast), fabs(s.slow)) / g->threshold);
    return s;
}

/* By what the sides of the guards are multiplied. */
static double turn_of(const Gains *g, const double *x)
{
    return g->follows < 0 ? 1.0 : fmax(-1.0, fmin(1.0, x[g->n + 2 * g->guards] / g->flow));
}

/* Derivative of that. */
static double turn_slope(const Gains *g, double turn, const double *vx)
{
    return g->follows >= 0 && fabs(turn) < 1.0 ? vx[g->n + 2 * g->guards] / g->flow : 0.0;
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
    const int32_t *watched;
    const int32_t follows = followed(record);
    const size_t guards = guards_of(record, p, &watched), turned = follows >= 0 ? 1u : 0u;
    const size_t own = guards > 0 ? guards + 3 + turned : 0, extra = 2 * guards + turned;
    const size_t n = layout->n_x - extra;
    int fits = layout->n_x >= extra && (layout->n_iu == 0 || layout->n_iu == m) && layout->n_ip == 0
               && turned <= guards && follows < (int32_t)m
               && layout->n_p == n * n + n * m + p * n + p * m + 1 + own;

    for (size_t i = 0; watched != NULL && i < p; ++i) fits = fits && watched[i] < (int32_t)m;
    if (!fits) {
        snprintf(message->text, sizeof message->text,
                 "controller: %zu states, %zu inputs, %zu outputs and %zu guards do not go with %zu parameters",
                 layout->n_x, m, p, guards, layout->n_p);
        return BLOCK_ERROR;
    }
    needs->n_memory = M_COUNT;
    needs->n_scratch = p + 2 * layout->n_iu;
    return BLOCK_OK;
}

BlockStatus block_start(Block *b, double t, BlockMessage *message)
{
    const int32_t *watched;

    (void)t;
    b->memory[M_GUARDS] = (double)guards_of(b->record, b->layout.n_y, &watched);
    b->memory[M_WATCHED] = watched == NULL ? 0.0 : (double)((const unsigned char *)watched - b->record->bytes);
    b->memory[M_FOLLOWS] = (double)followed(b->record);
    const Gains g = gains_of(b);
    if (!(g.limit > 0.0)) {
        snprintf(message->text, sizeof message->text, "controller: limit is %g, it must be positive", g.limit);
        return BLOCK_ERROR;
    }
    if (!(g.threshold > 0.0 && g.washout > 0.0 && g.lowpass > 0.0 && g.flow > 0.0)) {
        snprintf(message->text, sizeof message->text,
                 "controller: guard_threshold is %g, guard_washout %g, guard_lowpass %g, guard_flow %g; "
                 "all must be positive", g.threshold, g.washout, g.lowpass, g.flow);
        return BLOCK_ERROR;
    }
    if (g.follows >= 0) b->x[g.n + 2 * g.guards] = b->u[g.follows];
    return BLOCK_OK;
}

BlockStatus block_derivatives(Block *b, double t, const double *x, const double *u, double *dx,
                              BlockMessage *message)
{
    const Gains g = gains_of(b);

    (void)t, (void)message;
    u = trusted(b, u, b->scratch + b->layout.n_y);
    multiply(g.A, g.B, g.n, g.n, b->layout.n_u, x, u, dx);
    for (size_t i = 0, k = 0; k < g.guards; ++i) {
        if (g.watched[i] < 0) continue;
        const Swing s = swing_of(&g, x, u[g.watched[i]], k);
        dx[g.n + 2 * k] = s.fast / g.washout;
        dx[g.n + 2 * k + 1] = (s.fast - s.slow) / g.lowpass;
        ++k;
    }
    if (g.follows >= 0) dx[g.n + 2 * g.guards] = (u[g.follows] - x[g.n + 2 * g.guards]) / g.washout;
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
        if (g.watched != NULL && g.watched[i] >= 0) {
            const double taken = swing_of(&g, x, u[g.watched[i]], k).share * g.side[k] * turn_of(&g, x);
            high *= 1.0 - fmax(taken, 0.0);
            low *= 1.0 + fmin(taken, 0.0);
            ++k;
        }
        y[i] = y[i] > high ? high : y[i] < -low ? -low : y[i];
    }
    return BLOCK_OK;
}

/* Derivative of limit (1 - |share side turn|) on the side that falls; vturn: of the turn. */
static double limit_slope(const Gains *g, const Swing *s, size_t guard, double turn, double vfast, double vslow,
                          double vturn)
{
    const double moved = fabs(s->fast) >= fabs(s->slow) ? copysign(vfast, s->fast * vfast)
                                                        : copysign(vslow, s->slow * vslow);
    const double vshare = s->share < 1.0 ? moved / g->threshold : 0.0;

    return -g->limit * fabs(g->side[guard]) * (fabs(turn) * vshare + s->share * copysign(vturn, turn * vturn));
}

BlockStatus block_directional(Block *b, double t, const double *x, const double *u, const double *vx,
                              const double *vu, double *vdx, double *vy, BlockMessage *message)
{
    const Gains g = gains_of(b);
    const size_t m = b->layout.n_u, p = b->layout.n_y, course = g.n + 2 * g.guards;
    const double turn = turn_of(&g, x), vturn = turn_slope(&g, turn, vx);

    (void)t, (void)message;
    u = trusted(b, u, b->scratch + p);
    vu = trusted(b, vu, b->scratch + p + b->layout.n_iu);
    if (vdx != NULL && g.follows >= 0) vdx[course] = (vu[g.follows] - vx[course]) / g.washout;
    if (vdx != NULL) multiply(g.A, g.B, g.n, g.n, m, vx, vu, vdx);
    if (vy != NULL) {
        multiply(g.C, g.D, p, g.n, m, vx, vu, vy);
        multiply(g.C, g.D, p, g.n, m, x, u, b->scratch);
    }
    for (size_t i = 0, k = 0; i < p; ++i) {
        double high = g.limit, low = g.limit, slope = 0.0;
        if (g.watched != NULL && g.watched[i] >= 0) {
            const Swing s = swing_of(&g, x, u[g.watched[i]], k);
            const double vfast = vu[g.watched[i]] - vx[g.n + 2 * k], vslow = vx[g.n + 2 * k + 1];
            if (vdx != NULL) {
                vdx[g.n + 2 * k] = vfast / g.washout;
                vdx[g.n + 2 * k + 1] = (vfast - vslow) / g.lowpass;
            }
            slope = limit_slope(&g, &s, k, turn, vfast, vslow, vturn);
            high *= 1.0 - fmax(s.share * g.side[k] * turn, 0.0);
            low *= 1.0 + fmin(s.share * g.side[k] * turn, 0.0);
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
