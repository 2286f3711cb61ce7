/* The communication step of master.py in C: predict, step in order, iterate
 * loops, record. See kernel.h. */
#if !defined _WIN32 && !defined _POSIX_C_SOURCE
#define _POSIX_C_SOURCE 199309L /* clock_gettime */
#endif
#include "kernel.h"

#include <math.h>
#include <string.h>
#if defined _WIN32
#define WIN32_LEAN_AND_MEAN /* without sockets, which have a send() */
#include <windows.h>
#else
#include <time.h>
#endif

#include "kernel_loop.h"
#include "kernel_signal.h"

#if defined _WIN32
#define EXPORT __declspec(dllexport)
#else
#define EXPORT __attribute__((visibility("default")))
#endif

EXPORT int32_t kernel_run(Kernel *k, int64_t until);
EXPORT int32_t kernel_layout(int32_t *sizes, int32_t room);

enum { MAX_SWEEPS = 50 };
static const double LEAST_SCALE = 1e-4; /* of the nominal value: loops.py */

typedef struct {
    int64_t start, end;
    double start_s, length_s;
    double *row;                    /* outputs at its end                       */
    int edge;
} Step;

static double larger(double a, double b)
{
    return b > a ? b : a;
}

static int call_failed(Kernel *k, const KernelNode *node, int call, fmi2Status status)
{
    k->node = (int32_t)(node - k->nodes);
    k->call = call;
    k->status = (int32_t)status;
    return KERNEL_CALL_FAILED;
}

/* Sets the inputs from u (Reals) and the others' signals, and derivatives up to `order` from du. */
static int send(Kernel *k, KernelNode *node, int order)
{
    fmi2Status status;

    if (node->n_u_real > 0) {
        const size_t n = (size_t)node->n_u_real;
        status = node->set_real(node->component, node->u_reference, n, node->u);
        if (status > fmi2Warning) return call_failed(k, node, CALL_SET_REAL, status);
        if (order > 0) {
            status = node->set_derivatives(node->component, node->du_reference, n * (size_t)order,
                                           node->du_order, node->du);
            if (status > fmi2Warning) return call_failed(k, node, CALL_SET_DERIVATIVES, status);
        }
    }
    for (int i = node->n_u_real; i < node->n_u; ++i) {
        const KernelFeed *feed = node->feeds + i;
        const int value = (int)(feed->gain * k->signals[feed->signal].d[0] + feed->offset);
        status = feed->type == TYPE_BOOLEAN
                     ? node->set_boolean(node->component, node->u_reference + i, 1, &value)
                     : node->set_integer(node->component, node->u_reference + i, 1, &value);
        if (status > fmi2Warning) return call_failed(k, node, CALL_SET_INTEGER, status);
    }
    return KERNEL_OK;
}

static int do_step(Kernel *k, KernelNode *node, double time, double length)
{
    const fmi2Status status = node->do_step(node->component, time, length, fmi2True);

    if (status > fmi2Warning) {
        node->time = time;
        if (status == fmi2Discard && k->discarded != NULL
            && k->discarded((int32_t)(node - k->nodes), time, length) == 0) {
            node->time = time + length;
            return KERNEL_OK;
        }
        return call_failed(k, node, CALL_DO_STEP, status);
    }
    node->time = time + length;
    return KERNEL_OK;
}

/* The step in one piece, its inputs as polynomials (order 0: held). */
static int advance_whole(Kernel *k, KernelNode *node, const Step *step)
{
    const int order = node->order;
    double *du = node->du;
    int code;

    for (int i = 0; i < node->n_u_real; ++i) {
        const KernelFeed *feed = node->feeds + i;
        const double *d = k->signals[feed->signal].d;
        node->u[i] = feed->gain == 1.0 && feed->offset == 0.0 ? d[0] : feed->gain * d[0] + feed->offset;
        for (int m = 1; m <= order; ++m) *du++ = feed->gain * d[m];
    }
    code = send(k, node, order);
    return code == KERNEL_OK ? do_step(k, node, step->start_s, step->length_s) : code;
}

/* The step in parts; in each the mean of the inputs over the part is held. */
static int advance_in_parts(Kernel *k, KernelNode *node, const Step *step)
{
    const int64_t length = step->end - step->start, n = node->substeps;
    int64_t now = step->start;
    int code;

    for (int64_t part = 1; part <= n; ++part) {
        const int64_t end = step->start + length * part / n;
        const double a = seconds(now - step->start), b = seconds(end - step->start);
        if (end == now) continue;
        for (int i = 0; i < node->n_u_real; ++i) {
            const KernelFeed *feed = node->feeds + i;
            node->u[i] = feed->gain * mean_between(k->signals[feed->signal].d, a, b) + feed->offset;
        }
        if ((code = send(k, node, 0)) != KERNEL_OK) return code;
        if ((code = do_step(k, node, seconds(now), seconds(end - now))) != KERNEL_OK) return code;
        now = end;
    }
    for (int i = 0; i < node->n_u_real; ++i) {
        const KernelFeed *feed = node->feeds + i;
        node->u[i] = feed->gain * value_at(k->signals[feed->signal].d, step->length_s) + feed->offset;
    }
    return send(k, node, 0);
}

static int receive(Kernel *k, KernelNode *node, const Step *step)
{
    double *y = node->y = step->row + node->column;
    const int n_real = node->n_real, n_integer = node->n_integer, n_boolean = node->n_boolean;
    const int32_t *place = node->y_place;
    fmi2Status status;

    if (n_real > 0) {
        const int direct = n_real == node->n_y;
        status = node->get_real(node->component, node->y_reference, (size_t)n_real, direct ? y : node->y_real);
        if (status > fmi2Warning) return call_failed(k, node, CALL_GET_REAL, status);
        if (!direct)
            for (int i = 0; i < n_real; ++i) y[place[i]] = node->y_real[i];
    }
    if (n_integer > 0) {
        status = node->get_integer(node->component, node->y_reference + n_real, (size_t)n_integer,
                                   node->y_integer);
        if (status > fmi2Warning) return call_failed(k, node, CALL_GET_INTEGER, status);
    }
    if (n_boolean > 0) {
        status = node->get_boolean(node->component, node->y_reference + n_real + n_integer,
                                   (size_t)n_boolean, node->y_integer + n_integer);
        if (status > fmi2Warning) return call_failed(k, node, CALL_GET_INTEGER, status);
    }
    for (int i = 0; i < n_integer + n_boolean; ++i) y[place[n_real + i]] = (double)node->y_integer[i];
    if (node->n_dy > 0) {
        status = node->get_derivatives(node->component, node->dy_reference, (size_t)node->n_dy,
                                       node->dy_order, node->dy);
        if (status > fmi2Warning) return call_failed(k, node, CALL_GET_DERIVATIVES, status);
    }
    for (int i = 0; i < node->n_y; ++i)
        if (!isfinite(y[i])) {
            k->node = (int32_t)(node - k->nodes);
            return KERNEL_NOT_FINITE;
        }
    return KERNEL_OK;
}

static int advance(Kernel *k, KernelNode *node, const Step *step)
{
    int code = node->substeps > 1 && node->n_u > 0 && !step->edge ? advance_in_parts(k, node, step)
                                                                  : advance_whole(k, node, step);

    if (code != KERNEL_OK || (code = receive(k, node, step)) != KERNEL_OK) return code;
    for (int i = 0; i < node->n_signals; ++i) {
        KernelSignal *s = k->signals + node->first_signal + i;
        signal_know(s, step->start, step->length_s, step->edge, node->y[s->index],
                    s->slope >= 0 ? node->dy[s->slope] : 0.0);
    }
    return KERNEL_OK;
}

static int advance_members(Kernel *k, const KernelGroup *group, const Step *step)
{
    int code = KERNEL_OK;

    for (int i = 0; i < group->count && code == KERNEL_OK; ++i)
        code = advance(k, k->nodes + k->members[group->first + i], step);
    return code;
}

static int save_members(Kernel *k, const KernelGroup *group)
{
    for (int i = 0; i < group->count; ++i) {
        KernelNode *node = k->nodes + k->members[group->first + i];
        const fmi2Status status = node->get_state(node->component, &node->state);
        if (status > fmi2Warning) return call_failed(k, node, CALL_GET_STATE, status);
    }
    return KERNEL_OK;
}

static int restore_members(Kernel *k, const KernelGroup *group)
{
    for (int i = 0; i < group->count; ++i) {
        KernelNode *node = k->nodes + k->members[group->first + i];
        const fmi2Status status = node->set_state(node->component, node->state);
        if (status > fmi2Warning) return call_failed(k, node, CALL_SET_STATE, status);
    }
    return KERNEL_OK;
}

/* Steps the members until the torn signals end as supposed: loops.py. */
static int iterate(Kernel *k, const KernelGroup *group, const Step *step)
{
    const int n = group->n_torn;
    const int32_t *torn = k->torn + group->torn;
    const double h = step->length_s;
    Secant secant = secant_of(k->work, 2 * n);
    double error = 0.0;
    int code = save_members(k, group);

    if (code != KERNEL_OK) return code;
    for (int i = 0; i < n; ++i) {
        const KernelSignal *s = k->signals + torn[i];
        secant.x[2 * i] = value_at(s->d, h);
        secant.x[2 * i + 1] = h * slope_at(s->d, h);
    }
    for (int sweep = 0; sweep < MAX_SWEEPS; ++sweep) {
        if (sweep > 0) {
            if ((code = restore_members(k, group)) != KERNEL_OK) return code;
            for (int i = 0; i < n; ++i)
                signal_know(k->signals + torn[i], step->start, h, step->edge, secant.x[2 * i],
                            secant.x[2 * i + 1] / h);
        }
        if ((code = advance_members(k, group, step)) != KERNEL_OK) return code;
        error = 0.0;
        for (int i = 0; i < n; ++i) {
            const KernelSignal *s = k->signals + torn[i];
            const double scale = larger(larger(s->peak, fabs(s->v1)), LEAST_SCALE * s->nominal);
            const double value = s->v1 - secant.x[2 * i];
            const double slope =
                s->kind == KIND_HERMITE && !step->edge ? h * s->s1 - secant.x[2 * i + 1] : 0.0;
            secant.r[2 * i] = value;
            secant.r[2 * i + 1] = slope;
            error = larger(larger(error, fabs(value) / scale), fabs(slope) / scale / 8.0);
        }
        if (error <= k->tolerance) {
            k->repeated += sweep;
            return KERNEL_OK;
        }
        secant_correct(&secant);
    }
    k->group = (int32_t)(group - k->groups);
    k->value = error;
    return KERNEL_NOT_SETTLED;
}

static double now_s(void)
{
#if defined _WIN32
    return (double)GetTickCount64() * 1e-3;
#else
    struct timespec t;

    clock_gettime(CLOCK_MONOTONIC, &t);
    return (double)t.tv_sec + 1e-9 * (double)t.tv_nsec;
#endif
}

static int run(Kernel *k, int64_t until)
{
    const double begin = now_s();
    double looked = begin, start_s = seconds(k->points[k->index]), length_s = 0.0;
    int64_t length = 0;
    int stride = 1, since = 0;

    while (k->index < until) {
        const int64_t start = k->points[k->index], end = k->points[k->index + 1];
        const int flags = k->flags[k->index], edge = (flags & STEP_EDGE) != 0;
        const int recorded = (flags & STEP_RECORDED) != 0;
        Step step = {start, end, start_s, 0.0, k->spare, edge};

        if (k->stop != 0) return KERNEL_STOPPED;
        if (++since > stride) {
            const double now = now_s();
            if (now - begin > k->budget) return KERNEL_PAUSED;
            stride = now - looked > 1e-3 ? 1 : stride < 64 ? 2 * stride : 64;
            looked = now;
            since = 1;
        }
        if (end - start != length) {
            length = end - start;
            length_s = seconds(length);
        }
        step.length_s = length_s;
        if (recorded) step.row = k->records + k->row * k->n_columns;
        for (int i = 0; i < k->n_signals; ++i) signal_begin(k->signals + i, start, edge);
        for (int i = 0; i < k->n_groups; ++i) {
            const KernelGroup *group = k->groups + i;
            const int code = group->iterated ? iterate(k, group, &step) : advance_members(k, group, &step);
            if (code != KERNEL_OK) return code;
        }
        for (int i = 0; i < k->n_signals; ++i) signal_accept(k->signals + i, end, length_s, edge);
        ++k->index;
        start_s = seconds(end);
        if (recorded) k->times[k->row++] = start_s;
    }
    return KERNEL_OK;
}

/* Steps until `k->index` is `until`, or something needs attention. The clock is
 * looked at after 1, 2, 4 .. 64 steps while these are short. */
int32_t kernel_run(Kernel *k, int64_t until)
{
    const int code = run(k, until);

    for (int i = 0; i < k->n_nodes; ++i) {
        const KernelNode *node = k->nodes + i;
        if (node->y != node->y_home) memcpy(node->y_home, node->y, (size_t)node->n_y * sizeof node->y[0]);
    }
    return code;
}

/* Sizes of the structures, for whoever mirrors them; returns how many there are. */
int32_t kernel_layout(int32_t *sizes, int32_t room)
{
    const size_t found[] = {sizeof(KernelSignal), sizeof(KernelFeed), sizeof(KernelNode), sizeof(KernelGroup),
                            sizeof(Kernel)};
    const int32_t count = (int32_t)(sizeof found / sizeof found[0]);

    for (int32_t i = 0; i < count && i < room; ++i) sizes[i] = (int32_t)found[i];
    return count;
}
