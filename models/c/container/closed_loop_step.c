/* Stepping the closed loop: see closed_loop.h. */
#include "closed_loop_step.h"
#include "../block/limited_step.h"

#include <math.h>
#include <stdio.h>
#include <string.h>

static const double NANOSECOND = 1e-9;
static const double SLACK = 1e-10;         /* latencies this close to a step cover it      */
static const double EDGE = 1.5e-9;          /* a step up to this long may hold a jump     */
static const double TOLERANCE = 1e-9;       /* of repeated steps, relative to the signal  */
static const double LEAST_SCALE = 1e-4;     /* signals smaller than that are measured against it */

static double value_at(const double *d, double s)
{
    return d[0] + s * (d[1] + s * (d[2] / 2.0 + s * (d[3] / 6.0)));
}

static double slope_at(const double *d, double s)
{
    return d[1] + s * (d[2] + s * (d[3] / 2.0));
}

/* Over a step of length h: the cubic through values and slopes at both ends,
 * the straight line across a jump. */
static void draw(double *d, double v0, double s0, double v1, double s1, double h, int edge)
{
    const double mean = (v1 - v0) / h;

    d[0] = v0;
    d[1] = edge ? mean : s0;
    d[2] = edge ? 0.0 : 2.0 * (3.0 * mean - 2.0 * s0 - s1) / h;
    d[3] = edge ? 0.0 : 6.0 * (s0 + s1 - 2.0 * mean) / h / h;
}

/* Outputs of plant and controller at t, from states x and from the channels'
 * outputs in y; the plant's first, they depend on its states only. Fills u.
 * Within a step, not all: those that another member takes directly. */
static BlockStatus signals(ClosedLoop *l, double t, int all, const double *x, double *y, double *u,
                           BlockMessage *message)
{
    for (int plant = 1; plant >= 0; --plant)
        for (size_t k = 0; k < l->count; ++k) {
            BlockStatus status;

            if (!loop_is(l, k, plant) || !(all || l->plan->member[k].direct)) continue;
            for (size_t i = 0; i < l->block[k].layout.n_u; ++i) {
                const int32_t from = l->wire[l->first_u[k] + i];
                u[l->first_u[k] + i] = from < 0 || plant ? 0.0 : y[from];
            }
            status = l->member[k]->outputs(&l->block[k], t, x + l->first_x[k], u + l->first_u[k],
                                           y + l->first_y[k], message);
            if (status != BLOCK_OK) return status;
        }
    for (size_t k = 0; k < l->count; ++k)
        for (size_t i = 0; i < l->block[k].layout.n_u; ++i) {
            const int32_t from = l->wire[l->first_u[k] + i];
            u[l->first_u[k] + i] = from < 0 ? 0.0 : y[from];
        }
    return BLOCK_OK;
}

/* dx of member k; its limiters as those of the whole loop. */
static BlockStatus derivatives(ClosedLoop *l, size_t k, double t, const double *x, const double *u, double *dx,
                               BlockMessage *message)
{
    Block *inner = &l->block[k];
    BlockLimits *whole = l->limits, own;

    if (whole != NULL) {
        own = *whole;
        own.onto = whole->onto != NULL ? whole->onto + l->first_x[k] : NULL;
        own.each = whole->each != NULL ? whole->each + l->first_decision[k] : NULL;
        inner->limits = &own;
    }
    const BlockStatus status = l->member[k]->derivatives(inner, t, x + l->first_x[k], u + l->first_u[k],
                                                         dx + l->first_x[k], message);
    inner->limits = NULL;
    if (whole != NULL) {
        whole->switched = own.switched;
        whole->worst = own.worst;
        whole->alone |= own.alone;
    }
    return status;
}

/* dx of plant and controller at `elapsed` into the step, channels along l->poly. */
static BlockStatus flow(ClosedLoop *l, double t, double elapsed, const double *x, double *dx, BlockMessage *message)
{
    double *u = l->work + LOOP_ARRAYS * l->n_x, *y = u + l->n_u;
    BlockStatus status;

    for (size_t k = 0; k < l->count; ++k)
        for (size_t j = 0; l->kind[k] == KIND_CHANNEL && j < l->block[k].layout.n_y; ++j)
            y[l->first_y[k] + j] = value_at(l->poly + 4 * (l->first_y[k] + j), elapsed);
    if ((status = signals(l, t, 0, x, y, u, message)) != BLOCK_OK) return status;
    for (size_t k = 0; k < l->count; ++k) {
        if (l->kind[k] == KIND_CHANNEL) continue;
        status = derivatives(l, k, t, x, u, dx, message);
        if (status != BLOCK_OK) return status;
    }
    return BLOCK_OK;
}

typedef struct {
    ClosedLoop *l;
    double t, elapsed;      /* where the Runge-Kutta step begins                   */
    BlockMessage *message;
} Flow;

static BlockStatus stage_flow(void *context, double into, BlockLimits *limits, const double *x, double *dx)
{
    const Flow *f = context;
    ClosedLoop *l = f->l;

    l->limits = limits;
    const BlockStatus status = flow(l, f->t + into, f->elapsed + into, x, dx, f->message);
    l->limits = NULL;
    return status;
}

/* Over `length` from `begin`, which lies `since` after the begin of the channels' polynomials. */
static BlockStatus integrate(ClosedLoop *l, double begin, double since, double length, BlockMessage *message)
{
    const long count = runge_kutta_count(length, l->internal_step);
    Flow f = {l, begin, since, message};
    const LimitedRun run = {l->outer->memory[M_ORIGIN], &l->outer->memory[M_SWITCHES_COST], l->overruns, l->n_decisions};

    for (long step = 0; step < count; ++step) {
        const double into = length * ((double)step / (double)count);
        f.elapsed = since + into;
        f.t = begin + into;
        const double h = length / (double)count;
        const BlockStatus status = limited_step(stage_flow, &f, l->n_x, f.t, h, l->state, l->work, &run, message);
        if (status != BLOCK_OK) return status;
    }
    return BLOCK_OK;
}

#ifdef LOOP_DRAWN          /* a page's runs that are only looked at */
#include LOOP_DRAWN
#else
#define drawn(l) 0
#define drawn_begin(l) ((void)0)
#define drawn_integrate(l, t, h, message) BLOCK_OK
#define drawn_settle(l, k, t, dx, message) BLOCK_OK
#endif

/* dx of member k where it now is, and the slopes of its outputs for those vu of its inputs. */
static BlockStatus settle_slopes(ClosedLoop *l, size_t k, double t, int plant, double *dx, double *vu,
                                 BlockMessage *message)
{
    Block *inner = &l->block[k];
    BlockStatus status = l->member[k]->derivatives(inner, t, inner->x, inner->u, dx + l->first_x[k], message);

    if (status != BLOCK_OK) return status;
    for (size_t i = 0; i < inner->layout.n_u; ++i) {
        const int32_t from = l->wire[l->first_u[k] + i];
        vu[i] = from < 0 || plant ? 0.0 : l->slope[from];
    }
    return l->member[k]->directional(inner, t, inner->x, inner->u, dx + l->first_x[k], vu, NULL,
                                     l->slope + l->first_y[k], message);
}

/* Inputs, outputs and slopes of plant and controller where they now are. */
static BlockStatus settle(ClosedLoop *l, double t, BlockMessage *message)
{
    double *dx = l->work, *vu = l->work + LOOP_ARRAYS * l->n_x, *y = l->outer->y;
    BlockStatus status = signals(l, t, !(l->between && l->plain), l->state, y, vu, message);

    if (status != BLOCK_OK) return status;
    for (size_t k = 0; k < l->count; ++k) {
        memcpy(l->block[k].u, vu + l->first_u[k], l->block[k].layout.n_u * sizeof(double));
        for (size_t i = 0; i < l->block[k].layout.n_iu; ++i) {
            const int32_t from = l->flag[l->first_iu[k] + i];
            if (from >= 0) l->block[k].iu[i] = l->outer->iy[from];
        }
    }
    for (int plant = 1; plant >= 0; --plant)
        for (size_t k = 0; k < l->count; ++k) {
            if (!loop_is(l, k, plant)) continue;
            status = drawn(l) ? drawn_settle(l, k, t, dx, message) : settle_slopes(l, k, t, plant, dx, vu, message);
            if (status != BLOCK_OK) return status;
        }
    l->settled = 1;
    return BLOCK_OK;
}

/* Steps the channels, each told its input as the polynomial of its source. */
static BlockStatus step_channels(ClosedLoop *l, double t, double h, BlockMessage *message)
{
    static const double nothing[4] = {0.0, 0.0, 0.0, 0.0};

    for (size_t k = 0; k < l->count; ++k) {
        const int32_t from = l->wire[l->first_u[k]];
        BlockStatus status;

        if (l->kind[k] != KIND_CHANNEL) continue;
        l->u_order[k] = 3;
        status = l->member[k]->step(&l->block[k], t, h, from < 0 ? nothing : l->poly + 4 * from,
                                    l->slope + l->first_y[k], message);
        if (status != BLOCK_OK) return status;
    }
    return BLOCK_OK;
}

BlockStatus closed_loop_refresh(ClosedLoop *l, double t, BlockMessage *message)
{
    BlockStatus status = BLOCK_OK;

    /* twice: slopes of the plant need the controller's outputs, these the channels' */
    for (int round = 0; round < 2 && status == BLOCK_OK; ++round) {
        status = settle(l, t, message);
        for (size_t i = 0; i < l->n_y; ++i) {
            const double now[4] = {l->outer->y[i], round == 0 ? 0.0 : l->slope[i], 0.0, 0.0};
            memcpy(l->poly + 4 * i, now, sizeof now);
        }
        if (status == BLOCK_OK) status = step_channels(l, t, 0.0, message);
    }
    return status == BLOCK_OK ? settle(l, t, message) : status;
}

static int repeats(const ClosedLoop *l, double length)
{
    for (size_t k = 0; k < l->count; ++k)
        if (l->kind[k] == KIND_CHANNEL && channel_member_latency(&l->block[k]) < length - SLACK) return 1;
    return 0;
}

/* How far what the channels were told is from what came out; takes over the latter. */
static double correct(ClosedLoop *l, double h)
{
    const double *y = l->outer->y;
    double worst = 0.0;

    for (size_t k = 0; k < l->count; ++k) {
        const int32_t from = l->wire[l->first_u[k]];

        if (l->kind[k] != KIND_CHANNEL || from < 0) continue;
        const double *passed = l->poly + 4 * from;
        const double scale = fmax(fabs(y[from]), LEAST_SCALE);
        worst = fmax(worst, fabs(value_at(passed, h) - y[from]) / scale);
        worst = fmax(worst, h * fabs(slope_at(passed, h) - l->slope[from]) / scale / 8.0);
    }
    for (size_t k = 0; k < l->count; ++k) {
        const int32_t i = l->wire[l->first_u[k]];
        if (l->kind[k] == KIND_CHANNEL && i >= 0)
            draw(l->poly + 4 * i, l->y0[i], l->slope0[i], y[i], l->slope[i], h, 0);
    }
    return worst;
}

/* Polynomials over the coming step: bent on as they were over the last one. */
static void predict(ClosedLoop *l, double last)
{
    for (size_t i = 0; i < l->n_y; ++i) {
        double *d = l->poly + 4 * i;

        d[0] = l->y0[i] = l->outer->y[i];
        d[1] = l->slope0[i] = l->slope[i];
        d[2] = last > 0.0 ? l->bend[2 * i] + last * l->bend[2 * i + 1] : 0.0;
        d[3] = last > 0.0 ? l->bend[2 * i + 1] : 0.0;
    }
}

/* Handles the events of plant and controllers up to `t`; counts them. A plant's
 * are known by their times, a supervisor's come from its flags. */
static BlockStatus events(ClosedLoop *l, double t, int *count, BlockMessage *message)
{
    double *last = &l->outer->memory[M_LAST_EVENT];

    *count = 0;
    for (size_t k = 0; k < l->count; ++k) {
        const int supervisor = l->kind[k] == KIND_SUPERVISOR;
        Block *inner = &l->block[k];

        if (l->kind[k] == KIND_CHANNEL) continue;
        for (int round = 0; round < LOOP_EVENTS; ++round) {
            const double event = l->member[k]->next_event(inner, supervisor ? t - 0.5 * NANOSECOND : *last);
            BlockStatus status;

            if (!(event <= t + 0.6 * NANOSECOND)) break;
            status = l->member[k]->event(inner, supervisor ? t : event, inner->x, message);
            if (status != BLOCK_OK) return status;
            if (!supervisor) *last = event;
            ++*count;
        }
    }
    return BLOCK_OK;
}

/* What a step that is done again must find as it was. */
static void keep_members(ClosedLoop *l)
{
    memcpy(l->saved, l->members, l->n_members * sizeof(double));
    memcpy(l->saved_state, l->state, l->n_x * sizeof(double));
    memcpy(l->saved_iy, l->outer->iy, l->n_iy * sizeof(int));
}

static void put_members_back(ClosedLoop *l)
{
    memcpy(l->members, l->saved, l->n_members * sizeof(double));
    memcpy(l->state, l->saved_state, l->n_x * sizeof(double));
    memcpy(l->outer->iy, l->saved_iy, l->n_iy * sizeof(int));
    l->settled = 0;
}

/* Draws what the channels give over the step that they have done. */
static void draw_channels(ClosedLoop *l, double h, int edge)
{
    for (size_t k = 0; k < l->count; ++k) {
        if (l->kind[k] != KIND_CHANNEL) continue;
        const int held = channel_member_packets(&l->block[k]);
        for (size_t j = 0; j < l->block[k].layout.n_y; ++j) {
            const size_t i = l->first_y[k] + j;
            draw(l->poly + 4 * i, l->y0[i], held ? 0.0 : l->slope0[i], held ? l->y0[i] : l->outer->y[i],
                 held ? 0.0 : l->slope[i], h, edge);
        }
    }
}

/* How far signals bend at the end of a step, for the next one's prediction. */
static void keep_bends(ClosedLoop *l)
{
    for (size_t i = 0; i < l->n_y; ++i) {
        l->bend[2 * i] = l->poly[4 * i + 2];
        l->bend[2 * i + 1] = l->poly[4 * i + 3];
    }
}

/* Handles events at t and, where there were any, settles anew; counts them. */
static BlockStatus events_and_settle(ClosedLoop *l, double t, int *handled, BlockMessage *message)
{
    const BlockStatus status = events(l, t, handled, message);

    return status == BLOCK_OK && *handled > 0 ? settle(l, t, message) : status;
}

/* Channels, then plant and controllers, over the step from t to `end`. */
static BlockStatus sweep_once(ClosedLoop *l, double t, double end, int edge, BlockMessage *message)
{
    const double h = end - t;
    BlockStatus status = step_channels(l, t, h, message);

    if (status != BLOCK_OK) return status;
    draw_channels(l, h, edge);
    status = drawn(l) ? drawn_integrate(l, t, h, message) : integrate(l, t, 0.0, h, message);
    if (status != BLOCK_OK) return status;
    return settle(l, end, message);
}

/* One step between inner communication points. */
static BlockStatus step_once(ClosedLoop *l, double t, double end, BlockMessage *message)
{
    const double h = end - t;
    const int edge = h <= EDGE, again = !edge && repeats(l, h);
    double *last = &l->outer->memory[M_LAST_LENGTH];
    BlockStatus status;
    double error = 0.0;
    int handled;

    /* what a tool changed between two steps */
    if ((status = events_and_settle(l, t, &handled, message)) != BLOCK_OK) return status;
    predict(l, edge || handled > 0 ? 0.0 : *last);
    if (again) keep_members(l);
    for (int sweep = 0;; ++sweep) {
        if (sweep > 0) put_members_back(l);
        if ((status = sweep_once(l, t, end, edge, message)) != BLOCK_OK) return status;
        error = correct(l, h);
        if (!again || error <= TOLERANCE) break;
        if (sweep == LOOP_SWEEPS) {
            snprintf(message->text, sizeof message->text, "loop: the step from %.9g to %.9g s does not converge "
                     "in %d sweeps; relative change %.3g", t, end, LOOP_SWEEPS, error);
            return BLOCK_ERROR;
        }
    }
    keep_bends(l);
    if ((status = events_and_settle(l, end, &handled, message)) != BLOCK_OK) return status;
    *last = edge || handled > 0 ? 0.0 : h;
    return BLOCK_OK;
}

/* The first inner communication point after `now`, ns. */
static int64_t next_point(const ClosedLoop *l, int64_t now)
{
    const double *m = l->outer->memory;
    const int64_t origin = (int64_t)floor(m[M_ORIGIN] * 1e9 + 0.5);
    int64_t next = origin + ((now - origin) / l->step + 1) * l->step;

    for (size_t k = 0; k < (size_t)m[M_MARK_COUNT]; ++k) {
        const int64_t mark = (int64_t)m[M_MARKS + k], before = mark - 1;
        if (before > now && before < next) next = before;
        if (mark > now && mark < next) next = mark;
    }
    for (size_t k = 0; k < l->count; ++k) {
        double due;

        if (l->kind[k] == KIND_CHANNEL) due = channel_member_next(&l->block[k], (double)now / 1e9) * 1e9;
        else if (l->kind[k] == KIND_SUPERVISOR)
            due = l->member[k]->next_event(&l->block[k], (double)now / 1e9) * 1e9;
        else continue;
        if (!(due < (double)next)) continue;
        /* rounding of k T + latency is far below a nanosecond: such an instant is that one, others the next */
        due = fabs(due - floor(due + 0.5)) < 0.05 ? floor(due + 0.5) : ceil(due);
        if ((int64_t)due > now && (int64_t)due < next) next = (int64_t)due;
    }
    return next;
}

/* Tools add up their steps: a time this close to a whole nanosecond is meant to be it. */
static double whole(double t)
{
    const double near = floor(t * 1e9 + 0.5) / 1e9;
    return fabs(near - t) < 0.1 * NANOSECOND ? near : t;
}

BlockStatus closed_loop_advance(ClosedLoop *l, double t, double end, BlockMessage *message)
{
    t = whole(t);
    end = whole(end);
    if (drawn(l)) drawn_begin(l);
    while (t < end) {
        const double at = (double)next_point(l, (int64_t)floor(t * 1e9 + 0.5)) / 1e9;
        const double to = at < end ? at : end;
        l->between = to < end;
        const BlockStatus status = step_once(l, t, to, message);

        if (status != BLOCK_OK) return status;
        t = to;
    }
    return BLOCK_OK;
}
