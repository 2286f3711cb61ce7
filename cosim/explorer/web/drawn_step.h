#ifndef INTERAREA_DRAWN_STEP_H
#define INTERAREA_DRAWN_STEP_H
/* Steps of a run that is only looked at, for a page while somebody drags. Part of closed_loop_step.c there.
 *
 * The fastest poles, of exciters, keep the classical method to a few milliseconds, though nothing that is drawn moves
 * that fast. This one has order 4 as well, for any right-hand side, and seven stages, of which it spends three on
 * stability: decays up to 12/h along the negative real axis, of all that are faster than .6/h at most .55 are left
 * after a step. Near zero its errors are smaller than the classical method's (norm of the defects of order 5: .0053,
 * there .0224). The slopes at a step's begin are those that the last one ended with.
 *
 * A step in which a limiter switches is left to limited_step.h, and to its step.                              */

enum { DRAWN_STAGES = 7 };
#define drawn(l) ((l)->outer->memory[M_DRAWN] > 0.0)

typedef struct {
    size_t stages;
    double a[DRAWN_STAGES - 1][DRAWN_STAGES - 1], b[DRAWN_STAGES];
} DrawnMethod;

static const DrawnMethod DRAWN_CLASSICAL = {
    4, {{0.5}, {0.0, 0.5}, {0.0, 0.0, 1.0}}, {1.0 / 6.0, 1.0 / 3.0, 1.0 / 3.0, 1.0 / 6.0}
};
static const DrawnMethod DRAWN_STABLE = {
    7,
    {{0.05274412891248803},
     {-0.01840150070820801, 0.19977142049203775},
     {-0.041522647271989496, 0.089248424526255, 0.3456676920321763},
     {-0.013592105575228658, 0.0, 0.4357540881558603, 0.16973176618712524},
     {0.15131260007488154, 0.0, 0.0, 0.0830799093521796, 0.31923956482469934},
     {0.21326737373517723, 0.0, 0.0, 0.0, 0.38807397391913667, 0.2915429368939466}},
    {0.1637505345628398, -0.12869320112572985, 0.22183427463508718, 0.24981985637203633, 0.098835098353495,
     0.12505417636490454, 0.2693992608373671}
};

/* A controller's longest step in a drawn run, times the one it was made with (a tenth of its fastest time constant at most). */
static const double DRAWN_CONTROLLERS = 20.0;
static const double DRAWN_AHEAD = 1e-7;   /* s: slopes of outputs are differences over that */

/* to = x + h sum of w[j] k_j; two at a time, which the compiler does not see where it saves bytes. */
static void drawn_sum(size_t n, size_t count, double h, const double *w, const double *x, const double *k, double *to)
{
    typedef double Two __attribute__((vector_size(16), aligned(8), may_alias));

    memmove(to, x, n * sizeof(double));
    for (size_t j = 0; j < count; ++j, k += n) {
        const double share = h * w[j];
        size_t i = 0;
        if (share == 0.0) continue;
        for (; i + 2 <= n; i += 2) *(Two *)(to + i) += share * *(const Two *)(k + i);
        if (i < n) to[i] += share * k[i];
    }
}

/* One step over h from f->t; `known`: its first slopes are in l->work, and the limiters noted. */
static BlockStatus drawn_step(Flow *f, double h, int known)
{
    ClosedLoop *l = f->l;
    const DrawnMethod *m = h <= l->internal_step * (1.0 + 1e-9) ? &DRAWN_CLASSICAL : &DRAWN_STABLE;
    double *at = l->work + DRAWN_STAGES * l->n_x;
    BlockLimits limits = {.mode = LIMITS_NOTE, .stage = 1};
    BlockStatus status = known ? BLOCK_OK : stage_flow(f, 0.0, &limits, l->state, l->work);

    limits.mode = LIMITS_WATCH;
    for (size_t i = 1; i < m->stages && status == BLOCK_OK && !limits.switched; ++i) {
        double into = 0.0;
        for (size_t j = 0; j < i; ++j) into += m->a[i - 1][j];
        drawn_sum(l->n_x, i, h, m->a[i - 1], l->state, l->work, at);
        limits.stage = 1 + (int)i;
        status = stage_flow(f, h * into, &limits, at, l->work + i * l->n_x);
    }
    if (status != BLOCK_OK) return status;
    if (limits.switched) return integrate(l, f->t, f->elapsed, h, f->message);   /* from where it began */
    drawn_sum(l->n_x, m->stages, h, m->b, l->state, l->work, l->state);
    return BLOCK_OK;
}

static BlockStatus drawn_integrate(ClosedLoop *l, double begin, double length, BlockMessage *message)
{
    const double longest = fmin(l->outer->memory[M_DRAWN], DRAWN_CONTROLLERS * l->plan->internal_step);
    const long count = runge_kutta_count(length, fmax(longest, l->internal_step));
    BlockStatus status = BLOCK_OK;

    for (long step = 0; step < count && status == BLOCK_OK; ++step) {
        const double elapsed = length * ((double)step / (double)count);
        Flow f = {l, begin + elapsed, elapsed, message};
        status = drawn_step(&f, length / (double)count, step == 0 && l->settled);
    }
    l->settled = 0;
    return status;
}

/* Whether all that channels hear are states of plants: then outputs are asked for at the end of a communication step
 * alone, and no slopes but those of states. */
static int drawn_plain(ClosedLoop *l)
{
    for (size_t k = 0; k < l->count; ++k) {
        const int32_t from = l->wire[l->first_u[k]];
        size_t count, plant = 0;

        if (l->kind[k] != KIND_CHANNEL || from < 0) continue;
        while (plant + 1 < l->count && (size_t)from >= l->first_y[plant + 1]) ++plant;
        const int32_t *state = record_i32(&l->record[plant], "output.state", &count);
        if (state == NULL || state[(size_t)from - l->first_y[plant]] < 0) return 0;
        l->source[k] = l->first_x[plant] + (size_t)state[(size_t)from - l->first_y[plant]];
    }
    return 1;
}

/* Before all else: as long between inner communication points as the steps are. */
static void drawn_begin(ClosedLoop *l)
{
    const double times = floor(l->outer->memory[M_DRAWN] * 1e9 / (double)l->step);

    l->plain = drawn_plain(l);
    if (times > 1.0) l->step *= (int64_t)times;
}

/* Outputs of a plant that the channels hear, and their slopes. */
static void drawn_sources(ClosedLoop *l, const double *dx)
{
    for (size_t k = 0; k < l->count; ++k) {
        const int32_t from = l->wire[l->first_u[k]];
        if (l->kind[k] != KIND_CHANNEL || from < 0) continue;
        l->outer->y[from] = l->state[l->source[k]];
        l->slope[from] = dx[l->source[k]];
    }
}

/* As settle_slopes, limiters noted; slopes of the plants' outputs only, from what they will be. */
static BlockStatus drawn_settle(ClosedLoop *l, size_t k, double t, double *dx, BlockMessage *message)
{
    Block *inner = &l->block[k];
    double *ahead = l->work + l->n_x, *slope = l->slope + l->first_y[k];
    BlockLimits limits = {.mode = LIMITS_NOTE, .stage = 1};
    BlockStatus status;

    inner->limits = &limits;
    status = l->member[k]->derivatives(inner, t, inner->x, inner->u, dx + l->first_x[k], message);
    inner->limits = NULL;
    if (status != BLOCK_OK || l->kind[k] != KIND_PLANT) return status;
    if (l->plain) {
        drawn_sources(l, dx);
        return BLOCK_OK;
    }
    for (size_t i = 0; i < inner->layout.n_x; ++i) ahead[i] = inner->x[i] + DRAWN_AHEAD * dx[l->first_x[k] + i];
    status = l->member[k]->outputs(inner, t, ahead, inner->u, slope, message);
    for (size_t i = 0; i < inner->layout.n_y; ++i) slope[i] = (slope[i] - inner->y[i]) / DRAWN_AHEAD;
    return status;
}
#endif
