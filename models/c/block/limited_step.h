#ifndef INTERAREA_LIMITED_STEP_H
#define INTERAREA_LIMITED_STEP_H
/* A Runge-Kutta step that keeps its order where limiters switch in it.
 *
 * As long as they stay where they are at the begin of the step, it is the step of runge_kutta.h, to
 * the bit. Where one is found elsewhere in a later stage, the step is done again with all limiters
 * held, so that its right-hand side is smooth, as far as the instant at which the first of them gets
 * beyond its range; from just after it on the limiters are as they now are. That instant and
 * the states at it are found on a quartic through values and slopes at both ends.
 *
 * A step too long for its fastest motion grows until a limiter switches in it; its parts are shorter and keep
 * the growth bounded, so nothing would ever tell. So a step done again tells where it is that long.
 *
 * What a run may spend on this is bounded (LimitedRun): beyond it a step in which limiters switch is an
 * ordinary one, whose error falls with h alone.                                                       */
#include <stdio.h>
#include <string.h>

#include "runge_kutta.h"

/* Arrays of n that a step needs. */
enum { LIMITED_STEP_ARRAYS = 10 };

/* Evaluations that a run has for finding switches, enough for some 190, beside one for two of its steps. A grid
 * out of step has hundreds a second, none of which matters: it must not take ten times as long for them. */
static const double LIMITED_FIRST = 1500.0;
enum { LIMITED_POINTS = 3 };   /* for each of which `overruns` has room */
typedef struct {
    double begin, *spent;     /* since when it goes on; how many it has used                */
    double *overruns;         /* by how much each of n_decisions is beyond its range, at LIMITED_POINTS points */
    size_t n_decisions;
} LimitedRun;

/* dx/dt at x, `into` seconds after the begin of the step, limiters as `limits` says. */
typedef BlockStatus LimitedFlow(void *context, double into, BlockLimits *limits, const double *x, double *k);

typedef struct {
    LimitedFlow *flow;
    void *context;
    size_t n;
    double begin, done;       /* of the step: its time; how much of it is done, s       */
    double *work, *x;         /* 5 n of runge_kutta.h; where the part of the step begins */
    double *end, *slope, *at; /* where it ends: states, their slopes; another point      */
    double *bend;             /* of the quartic between them */
    const LimitedRun *run;
    int early, tried;         /* to hold limiters from the stage on in which one switches; whether they were held */
    BlockLimits limits;
    long count;               /* of evaluations after the first try with limiters held */
    BlockMessage *message;
} LimitedStep;

static inline BlockStatus limited_flow(LimitedStep *s, double into, const double *x, double *k)
{
    ++s->count;
    return s->flow(s->context, s->done + into, &s->limits, x, k);
}

static inline BlockStatus limited_stage(void *context, RungeKuttaStage stage, double h, const double *x, double *k)
{
    LimitedStep *s = context;
    const double into = stage == RK_BEGIN ? 0.0 : stage == RK_END ? h : h / 2.0;

    if (s->limits.mode != LIMITS_HOLD) s->limits.mode = stage == RK_BEGIN ? LIMITS_NOTE : LIMITS_WATCH;
    s->limits.stage = 1 + (int)stage;
    BlockStatus status = limited_flow(s, into, x, k);
    if (status == BLOCK_OK && s->early && s->limits.alone && s->limits.switched && !s->tried) {
        s->limits.mode = LIMITS_HOLD;   /* as in the stages before */
        s->tried = 1;
        status = limited_flow(s, into, x, k);
    }
    s->limits.stage = 0;
    return status;
}

/* By how much a limiter is beyond its range at x, `into` seconds after s->done, and each of them; states held go onto
 * their limits in s->at. near: the voltages of ports need not be closer than a step's stages have them. */
static inline BlockStatus limited_overrun(LimitedStep *s, double into, int near, const double *x, double *k,
                                          double *each, double *overrun)
{
    for (size_t i = 0; i < s->run->n_decisions; ++i) each[i] = -INFINITY;
    s->limits.mode = LIMITS_HOLD;
    s->limits.worst = -INFINITY;
    s->limits.onto = s->at;
    s->limits.each = each;
    s->limits.stage = near;
    const BlockStatus status = limited_flow(s, into, x, k);
    s->limits.stage = 0;
    s->limits.each = NULL;
    s->limits.onto = NULL;
    *overrun = s->limits.worst;
    return status;
}

/* From s->x over h with limiters held: s->end, and in s->at with held states on their limits. */
static inline BlockStatus limited_try(LimitedStep *s, double h, double *overrun)
{
    BlockStatus status;

    s->limits.mode = LIMITS_HOLD;
    status = s->tried ? BLOCK_OK : runge_kutta_rest(limited_stage, s, s->n, h, s->x, s->work);
    if (status != BLOCK_OK) return status;
    s->tried = 0;
    memcpy(s->end, s->x, s->n * sizeof(double));
    runge_kutta_move(s->n, h, s->end, s->work);
    memcpy(s->at, s->end, s->n * sizeof(double));
    return limited_overrun(s, h, 1, s->end, s->slope, s->run->overruns, overrun);
}

/* x on the quartic through values and slopes at both ends of h, `into` seconds after its begin; bent as
 * limited_bend found it. */
static inline void limited_between(const LimitedStep *s, double h, double into, double *x)
{
    const double *k1 = s->work, q = into / h, r = 1.0 - q, part = q * q * (3.0 - 2.0 * q);

    for (size_t i = 0; i < s->n; ++i)
        x[i] = s->x[i] + part * (s->end[i] - s->x[i])
               + q * r * (h * (r * k1[i] - q * s->slope[i]) + q * r * s->bend[i]);
}

/* By how much more than the cubic the quartic bends, from the slope k at LIMITED_BEND h on the cubic: not in the middle,
 * where every quartic has the cubic's slope. */
static const double LIMITED_BEND = 0.4;
static inline void limited_bend(LimitedStep *s, double h, const double *k)
{
    const double *k1 = s->work, q = LIMITED_BEND, r = 1.0 - q;

    for (size_t i = 0; i < s->n; ++i) {
        const double slope = 6.0 * q * r * (s->end[i] - s->x[i])
                             + h * (r * (r - 2.0 * q) * k1[i] - q * (2.0 * r - q) * s->slope[i]);
        s->bend[i] = (h * k[i] - slope) / (2.0 * q * r * (r - q));
    }
}

/* Where on the quartic over h the first limiter gets beyond its range: after `low`, before `high`, which is among the
 * points last looked at. */
typedef struct { double at, *each; } LimitedPoint;
typedef struct {
    LimitedPoint point[LIMITED_POINTS];
    int count;
    double low, high, width, reach;
    int slow;
} LimitedSearch;

/* The point at `high`, and of the two others the nearer one first. Returns how many there are. */
static inline int limited_order(const LimitedSearch *s, LimitedPoint *p)
{
    int n = 1;
    for (int i = 0; i < s->count; ++i) {
        if (s->point[i].at == s->high) p[0] = s->point[i];
        else p[n++] = s->point[i];
    }
    if (n == 3 && fabs(p[2].at - s->high) < fabs(p[1].at - s->high)) {
        const LimitedPoint farther = p[1];
        p[1] = p[2];
        p[2] = farther;
    }
    return n;
}

/* Where decision i, beyond its range at p[0], gets there: on the line through two points, on the parabola through
 * three; NaN where they tell nothing. */
static inline double limited_root(const LimitedPoint *p, int n, size_t i)
{
    if (n < 2) return NAN;
    const double at = p[0].each[i], steep = (p[1].each[i] - at) / (p[1].at - p[0].at);
    double t = p[0].at - at / steep;

    if (n < 3) return t;
    const double bent = ((p[2].each[i] - at) / (p[2].at - p[0].at) - steep) / (p[2].at - p[1].at);
    for (int round = 0; round < 3; ++round) {
        const double a = t - p[0].at, b = t - p[1].at;
        t -= (at + a * (steep + b * bent)) / (steep + (a + b) * bent);
    }
    return t;
}

/* Where the first limiter does, as far as the points tell: between `low` and `high`. */
static inline double limited_first(const LimitedSearch *s, size_t decisions)
{
    LimitedPoint p[LIMITED_POINTS];
    const int n = limited_order(s, p);
    double first = s->high;

    for (size_t i = 0; i < decisions; ++i) {
        if (!(p[0].each[i] > 0.0)) continue;
        double root = limited_root(p, n, i);
        if (!(root > s->low && root < s->high)) root = limited_root(p, n < 2 ? n : 2, i);
        if (!(root > s->low && root < s->high)) root = 0.5 * (s->low + s->high);
        if (root < first) first = root;
    }
    return first;
}

/* The numbers of the point that is to be looked at next: of one that is not `high`, the farthest from there. */
static inline double *limited_room(LimitedSearch *s, double into, double *overruns, size_t decisions)
{
    int old = 0;

    if (s->count < LIMITED_POINTS) return overruns + (size_t)s->count * decisions;
    for (int i = 1; i < LIMITED_POINTS; ++i) {
        const int farther = fabs(s->point[i].at - into) > fabs(s->point[old].at - into);
        if (s->point[old].at == s->high || (farther && s->point[i].at != s->high)) old = i;
    }
    double *room = s->point[old].each;
    s->point[old] = s->point[--s->count];
    return room;
}

/* Takes in that a limiter is `value` beyond its range at `into`; whether that is as just after its switch as `close`
 * says. */
static inline int limited_record(LimitedSearch *s, double into, double value, double *each, size_t decisions,
                                double close)
{
    const int beyond = value > 0.0, last = s->count;
    double nearest = INFINITY;

    for (int i = 0; i < last; ++i) nearest = fmin(nearest, fabs(into - s->point[i].at));
    s->point[s->count++] = (LimitedPoint){into, each};
    if (beyond) s->high = into;
    else s->low = into;
    if (!beyond) return 0;
    if (into - s->low <= 4.0 * close) return 1;
    /* of points far apart a parabola promises an end that is none */
    return into - limited_first(s, decisions) <= 4.0 * close && nearest <= 5e5 * close;
}

/* Where to look next: just after where the first limiter seems to switch, or in the middle where that has gained too
 * little three times. What falls short of it by little is followed by larger and larger steps. */
static inline double limited_aim(LimitedSearch *s, size_t decisions, double close)
{
    const double first = limited_first(s, decisions), middle = 0.5 * (s->low + s->high);

    s->reach = first - s->low <= 2.0 * s->reach ? 8.0 * s->reach : 2.0 * close;
    s->slow = s->high - s->low > 0.5 * s->width ? s->slow + 1 : 0;
    s->width = s->high - s->low;
    if (first + s->reach < s->high && s->slow <= 2) return first + s->reach;
    s->slow = 0;
    return middle;
}

/* Over h, at whose end a limiter is overrun, to just after the first switch: s->at, held states on their limits. They
 * are as exact there as at the end of a step: no step need end there. */
static inline BlockStatus limited_land(LimitedStep *s, double h, double *landed)
{
    enum { MOST = 30, COARSE = 2 };
    const size_t decisions = s->run->n_decisions;
    const double close = 1e-7 * h;
    double *x = s->work + 4 * s->n, *k = s->work + s->n, into = LIMITED_BEND * h;
    LimitedSearch search = {{{h, s->run->overruns}}, 1, 0.0, h, h, 2.0 * close, 0};

    memset(s->bend, 0, s->n * sizeof(double));
    for (int count = 0;; ++count, into = count < MOST ? limited_aim(&search, decisions, close) : search.high) {
        double value, *each = limited_room(&search, into, s->run->overruns, decisions);
        limited_between(s, h, into, x);
        memcpy(s->at, x, s->n * sizeof(double));
        const BlockStatus status = limited_overrun(s, into, count < COARSE, x, k, each, &value);
        if (status != BLOCK_OK) return status;
        if (count == 0) limited_bend(s, h, k);
        if (limited_record(&search, into, value, each, decisions, close) || count == MOST) break;
    }
    *landed = into;
    return BLOCK_OK;
}

static inline double limited_product(const LimitedStep *s, const double *a, const double *b)
{
    double sum = 0.0;
    for (size_t i = 0; i < s->n; ++i) sum += a[i] * b[i] / ((1.0 + fabs(s->x[i])) * (1.0 + fabs(s->x[i])));
    return sum;
}

/* The rate of the fastest motion about s->x, limiters held, 1/s: powers of the Jacobian matrix applied to the
 * direction d, by differences, or 0 where a step h can follow it. */
static inline BlockStatus limited_fastest(LimitedStep *s, double h, double *d, double *k, double *x, double *fastest)
{
    enum { ROUNDS = 12 };
    const double *k1 = s->work;
    double rate = 0.0, lately = 1.0, aligned = 0.0;   /* lately: product of the last four */

    *fastest = 0.0;
    for (int round = 0; round < ROUNDS; ++round) {
        const double size = sqrt(limited_product(s, d, d)) / 1e-6;
        for (size_t i = 0; i < s->n; ++i) {
            d[i] /= size;
            x[i] = s->x[i] + d[i];
        }
        s->limits.mode = LIMITS_HOLD;
        const BlockStatus status = limited_flow(s, 0.0, x, k);
        if (status != BLOCK_OK) return status;
        for (size_t i = 0; i < s->n; ++i) k[i] -= k1[i];
        rate = sqrt(limited_product(s, k, k)) / 1e-6;
        if (!(h * rate > 1.0)) return BLOCK_OK;
        aligned = limited_product(s, k, d) / (1e-12 * rate);
        if (round >= ROUNDS - 4) lately *= rate;
        memcpy(d, k, s->n * sizeof(double));
    }
    lately = sqrt(sqrt(lately));
    if (aligned < -0.99) *fastest = rate;
    else if (h * lately > RUNGE_KUTTA_REACH) *fastest = lately;
    return BLOCK_OK;
}

/* Tells a step h that is beyond stability. The slopes of its stages, k2 - k1 and then k3 - k2, are two powers
 * already: rarely do they ask for more. */
static inline BlockStatus limited_stable(LimitedStep *s, double h)
{
    double *k1 = s->work, *k2 = k1 + s->n, *k3 = k2 + s->n, *x = k2 + 3 * s->n, fastest;

    for (size_t i = 0; i < s->n; ++i) {
        const double later = k3[i] - k2[i];
        k3[i] = k2[i] - k1[i];
        k2[i] = later;
    }
    const double rate = 2.0 / h * sqrt(limited_product(s, k2, k2) / limited_product(s, k3, k3));
    if (!(h * rate > RUNGE_KUTTA_DECAY && rate < INFINITY)) return BLOCK_OK;
    const BlockStatus status = limited_fastest(s, h, k2, k3, x, &fastest);
    if (status != BLOCK_OK || !(h * fastest > RUNGE_KUTTA_DECAY)) return status;
    (void)snprintf(s->message->text, sizeof s->message->text,
                   "t = %.9g s: Runge-Kutta steps of %.4g s grow without bound where the fastest mode is at %.4g 1/s, "
                   "allowed there: at most %.4g s; try a shorter solver.step", s->begin, h, fastest,
                   RUNGE_KUTTA_DECAY / fastest);
    return BLOCK_ERROR;
}

/* The step in parts between switches. */
static inline BlockStatus limited_again(LimitedStep *s, double h, double *x)
{
    enum { MOST = 12 };
    const size_t size = s->n * sizeof(double);
    BlockStatus status;

    memcpy(s->x, x, size);
    s->early = 0;
    for (int count = 0; count < MOST && s->done < h; ++count) {
        double overrun, landed;
        if (count > 0) {
            s->limits.mode = LIMITS_NOTE;
            if ((status = limited_stage(s, RK_BEGIN, 0.0, s->x, s->work)) != BLOCK_OK) return status;
        }
        if ((status = limited_try(s, h - s->done, &overrun)) != BLOCK_OK) return status;
        if (count == 0 && (status = limited_stable(s, h)) != BLOCK_OK) return status;
        if (count == 0) s->count = 0;
        if (!(overrun > 0.0)) {
            memcpy(x, s->at, size);
            return BLOCK_OK;
        }
        if ((status = limited_land(s, h - s->done, &landed)) != BLOCK_OK) return status;
        memcpy(s->x, s->at, size);
        s->done += landed;
    }
    if (s->done < h) {   /* more switches than that: over the rest of them without looking */
        s->limits.mode = LIMITS_NOTE;
        status = runge_kutta_stages(limited_stage, s, s->n, h - s->done, s->x, s->work);
        if (status != BLOCK_OK) return status;
        runge_kutta_move(s->n, h - s->done, s->x, s->work);
    }
    memcpy(x, s->x, size);
    return BLOCK_OK;
}

/* Whether there are evaluations left for finding switches at time t, in steps of h. */
static inline int limited_affords(const LimitedRun *run, double t, double h)
{
    return *run->spent < LIMITED_FIRST + 0.5 * (t - run->begin) / h;
}

/* Adds what a step has used; the message is sent when a run has used its first. */
static inline void limited_pay(const LimitedRun *run, const LimitedStep *s)
{
    const int first = *run->spent < LIMITED_FIRST;

    *run->spent += (double)s->count;
    if (first && !(*run->spent < LIMITED_FIRST))
        (void)snprintf(s->message->text, sizeof s->message->text,
                       "t = %.9g s: limiters switch so often that %.0f evaluations were spent on the switching instants; from "
                       "here on few instants are located: use a shorter solver.step if the result depends on it",
                       s->begin, LIMITED_FIRST);
}

/* A step of n states from time t, not taken yet. work: LIMITED_STEP_ARRAYS n numbers. */
static inline LimitedStep limited_of(LimitedFlow *flow, void *context, size_t n, double t, double *work,
                                     BlockMessage *message)
{
    return (LimitedStep){.flow = flow, .context = context, .n = n, .work = work, .x = work + 5 * n, .end = work + 6 * n,
                         .slope = work + 7 * n, .at = work + 8 * n, .bend = work + 9 * n,
                         .limits = {.mode = LIMITS_NOTE}, .begin = t, .message = message};
}

/* The step where somebody has found that limiters switch in it, and that the run affords it: the first n numbers of
 * `work` hold the slopes at its begin, the block's notes what limiters are at there. */
static inline BlockStatus limited_switched(LimitedStep *s, double h, double *x, const LimitedRun *run)
{
    s->run = run;
    const BlockStatus status = limited_again(s, h, x);
    if (status == BLOCK_OK) limited_pay(run, s);
    return status;
}

/* One step over h of states x. Where the flow does not return BLOCK_OK, or the step is beyond stability, x is left as it
 * was and the message says why. */
static inline BlockStatus limited_step(LimitedFlow *flow, void *context, size_t n, double t, double h, double *x,
                                       double *work, const LimitedRun *run, BlockMessage *message)
{
    LimitedStep s = limited_of(flow, context, n, t, work, message);
    s.early = limited_affords(run, t, h);
    const BlockStatus status = runge_kutta_stages(limited_stage, &s, n, h, x, work);

    if (status != BLOCK_OK) return status;
    if (s.limits.switched && s.early) return limited_switched(&s, h, x, run);
    runge_kutta_move(n, h, x, work);
    return BLOCK_OK;
}
#endif
