/* The communication step of master.py in C: predict, step in order, iterate
 * loops, record. See structures.h. */
#if !defined _WIN32 && !defined _POSIX_C_SOURCE
#define _POSIX_C_SOURCE 199309L /* clock_gettime */
#endif
#include "structures.h"

#include <math.h>
#include <string.h>
#if defined _WIN32
#define WIN32_LEAN_AND_MEAN /* without sockets, which have a send() */
#include <windows.h>
#else
#include <time.h>
#endif

#include "broyden.h"
#include "node.h"

#if defined _WIN32
#define EXPORT __declspec(dllexport)
#else
#define EXPORT __attribute__((visibility("default")))
#endif

EXPORT int32_t kernel_run(Kernel *k, int64_t until);
EXPORT int32_t kernel_run_lockstep(Kernel *const k[], const int64_t until[], int32_t n, double budget,
                                   int32_t code[]);
EXPORT int32_t kernel_layout(int32_t *sizes, int32_t room);

enum { MAX_SWEEPS = 50 };   /* with slopes as unknowns, and as many with straight lines */
static const double LEAST_SCALE = 1e-4; /* of the nominal value: algebraic_loop.py */

enum { RUNNING = -1, MOST_RUNS = 64 };

typedef struct {
    int64_t start, end;
    double start_s, length_s;
    double *row;                    /* outputs at its end                       */
    int edge, recorded;
} Step;

/* The clock of all runs of a call: looked at after 1, 2, 4 .. 64 steps while these are short. */
typedef struct {
    double begin, looked, budget;
    int stride, since, over;
} Watch;

/* What a run does next. */
typedef enum { AT_POINT, AT_GROUP, AT_NODE, AT_PART, WAITING, STEPPED } Place;

/* One run on its way through the steps. Where it waits for a node to be stepped, it
 * can wait for other runs. */
typedef struct {
    Kernel *k;
    Watch *watch;
    int64_t until, length;
    double length_s;                /* of `length`                              */
    int code;                       /* UNDER_WAY, or why it ended               */
    int alone;                      /* there is no other run to wait for        */
    Place at;
    Step step;
    int group, member, sweep;
    Broyden broyden;
    KernelNode *node;               /* under way: its part, when that ends      */
    int parts;
    int64_t part, part_end;
    double time, time_length;       /* step that the node waits for             */
    fmi2Status status;              /* what it returned                         */
} Run;

static double larger(double a, double b)
{
    return b > a ? b : a;
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

/* The node will be stepped from `time` over `length`: at once, or with those of other runs. */
static int step_node(Run *r, double time, double length)
{
    KernelNode *node = r->node;

    r->time = time;
    r->time_length = length;
    r->at = WAITING;
    if (!r->alone && node->lanes != NULL) return KERNEL_OK;
    r->status = node->do_step(node->component, time, length, fmi2True);
    r->at = STEPPED;
    return KERNEL_OK;
}

/* Looks at what stepping the node gave. */
static int node_stepped(Run *r)
{
    Kernel *k = r->k;
    KernelNode *node = r->node;

    r->at = AT_PART;
    if (r->status != fmi2OK) {
        node->time = r->time;
        if ((r->status != fmi2Discard || k->discarded == NULL
             || k->discarded((int32_t)(node - k->nodes), r->time, r->time_length) != 0)
            && call_failed(k, node, CALL_DO_STEP, r->status))
            return KERNEL_CALL_FAILED;
    }
    node->time = r->time + r->time_length;
    return KERNEL_OK;
}

/* The node has reached the end of the step. */
static int end_node(Run *r)
{
    Kernel *k = r->k;
    KernelNode *node = r->node;
    const Step *step = &r->step;
    const int code = receive(k, node, step->row);

    if (code != KERNEL_OK) return code;
    for (int i = 0; i < node->n_signals; ++i) {
        KernelSignal *s = k->signals + node->first_signal + i;
        signal_know(s, step->start, step->length_s, step->edge, node->y[s->index],
                    s->slope >= 0 ? node->dy[s->slope] : 0.0);
    }
    ++r->member;
    r->at = AT_NODE;
    return KERNEL_OK;
}

/* The next part of the step; in each the mean of the inputs over the part is held. */
static int begin_part(Run *r)
{
    KernelNode *node = r->node;
    const Step *step = &r->step;
    const int64_t length = step->end - step->start, n = node->substeps, now = r->part_end;
    int code;

    if (!r->parts) return end_node(r);
    if (r->part == n) {
        code = send_end(r->k, node, step->length_s);
        return code == KERNEL_OK ? end_node(r) : code;
    }
    r->part_end = step->start + length * ++r->part / n;
    if (r->part_end == now) return KERNEL_OK;
    code = send_mean(r->k, node, seconds(now - step->start), seconds(r->part_end - step->start));
    return code == KERNEL_OK ? step_node(r, seconds(now), seconds(r->part_end - now)) : code;
}

static int begin_node(Run *r, const KernelGroup *group)
{
    KernelNode *node = r->node = r->k->nodes + r->k->members[group->first + r->member];
    int code;

    r->parts = node->substeps > 1 && node->n_u > 0 && !r->step.edge;
    if (r->parts) {
        r->part = 0;
        r->part_end = r->step.start;
        r->at = AT_PART;
        return KERNEL_OK;
    }
    code = send_whole(r->k, node);
    return code == KERNEL_OK ? step_node(r, r->step.start_s, r->step.length_s) : code;
}

/* Loops are stepped until the tearing signals end as supposed: algebraic_loop.py. */
static int begin_loop(Run *r, const KernelGroup *group)
{
    Kernel *k = r->k;
    const double h = r->step.length_s;
    const int code = save_members(k, group);

    r->broyden = broyden_of(k->work, 2 * group->n_tearing);
    for (int i = 0; i < group->n_tearing; ++i) {
        const KernelSignal *s = k->signals + k->tearing[group->tearing + i];
        r->broyden.x[2 * i] = value_at(s->d, h);
        r->broyden.x[2 * i + 1] = h * slope_at(s->d, h);
    }
    r->sweep = 0;
    return code;
}

/* Compares what came out of a loop with what was supposed: goes on, or once more from the start. */
static int end_loop(Run *r, const KernelGroup *group)
{
    Kernel *k = r->k;
    Broyden *broyden = &r->broyden;
    const Step *step = &r->step;
    const double h = step->length_s;
    const int n = group->n_tearing, straight = step->edge || r->sweep >= MAX_SWEEPS;
    double error = 0.0;
    int code;

    for (int i = 0; i < n; ++i) {
        const KernelSignal *s = k->signals + k->tearing[group->tearing + i];
        const double scale = larger(larger(s->peak, fabs(s->v1)), LEAST_SCALE * s->nominal);
        const double value = s->v1 - broyden->x[2 * i];
        const double slope =
            s->kind == KIND_HERMITE && !straight ? h * s->s1 - broyden->x[2 * i + 1] : 0.0;
        broyden->r[2 * i] = value;
        broyden->r[2 * i + 1] = slope;
        error = larger(larger(error, fabs(value) / scale), fabs(slope) / scale / 8.0);
    }
    if (error <= k->tolerance) {
        k->repeated += r->sweep;
        ++r->group;
        r->at = AT_GROUP;
        return KERNEL_OK;
    }
    if (++r->sweep == 2 * MAX_SWEEPS) {
        k->group = (int32_t)(group - k->groups);
        k->value = error;
        return KERNEL_NOT_SETTLED;
    }
    if (r->sweep == MAX_SWEEPS) {
        *broyden = broyden_of(k->work, 2 * n);
        for (int i = 0; i < n; ++i) broyden->r[2 * i + 1] = 0.0;
    }
    broyden_correct(broyden);
    for (int i = 0; i < n && r->sweep >= MAX_SWEEPS; ++i)
        broyden->x[2 * i + 1] = broyden->x[2 * i] - k->signals[k->tearing[group->tearing + i]].v0;
    if ((code = restore_members(k, group)) != KERNEL_OK) return code;
    for (int i = 0; i < n; ++i)
        signal_know(k->signals + k->tearing[group->tearing + i], step->start, h, step->edge, broyden->x[2 * i],
                    broyden->x[2 * i + 1] / h);
    r->member = 0;
    return KERNEL_OK;
}

static int end_step(Run *r)
{
    Kernel *k = r->k;
    const Step *step = &r->step;

    for (int i = 0; i < k->n_signals; ++i) signal_accept(k->signals + i, step->end, step->length_s, step->edge);
    ++k->index;
    if (step->recorded) k->times[k->row++] = seconds(step->end);
    r->at = AT_POINT;
    return KERNEL_OK;
}

static int time_is_up(Watch *w)
{
    if (!w->over && ++w->since > w->stride) {
        const double now = now_s();
        w->over = now - w->begin > w->budget;
        w->stride = now - w->looked > 1e-3 ? 1 : w->stride < 64 ? 2 * w->stride : 64;
        w->looked = now;
        w->since = 1;
    }
    return w->over;
}

static int begin_step(Run *r)
{
    Kernel *k = r->k;
    Step *step = &r->step;

    if (k->index >= r->until) {
        r->code = KERNEL_OK;
        return KERNEL_OK;
    }
    if (k->stop != 0) return KERNEL_STOPPED;
    if (time_is_up(r->watch)) return KERNEL_PAUSED;
    step->start = k->points[k->index];
    step->end = k->points[k->index + 1];
    step->edge = (k->flags[k->index] & STEP_EDGE) != 0;
    step->recorded = (k->flags[k->index] & STEP_RECORDED) != 0;
    if (step->end - step->start != r->length) {
        r->length = step->end - step->start;
        r->length_s = seconds(r->length);
    }
    step->start_s = seconds(step->start);
    step->length_s = r->length_s;
    step->row = step->recorded ? k->records + k->row * k->n_columns : k->spare;
    for (int i = 0; i < k->n_signals; ++i) signal_begin(k->signals + i, step->start, step->edge);
    r->group = 0;
    r->at = AT_GROUP;
    return KERNEL_OK;
}

static int begin_group(Run *r)
{
    const KernelGroup *group = r->k->groups + r->group;

    if (r->group == r->k->n_groups) return end_step(r);
    r->member = 0;
    r->at = AT_NODE;
    return group->iterated ? begin_loop(r, group) : KERNEL_OK;
}

static int next_member(Run *r)
{
    const KernelGroup *group = r->k->groups + r->group;

    if (r->member < group->count) return begin_node(r, group);
    if (group->iterated) return end_loop(r, group);
    ++r->group;
    r->at = AT_GROUP;
    return KERNEL_OK;
}

/* Goes on until the run ends or waits. */
static void go_on(Run *r)
{
    while (r->code == RUNNING && r->at != WAITING) {
        const int code = r->at == AT_POINT ? begin_step(r)
                         : r->at == AT_GROUP ? begin_group(r)
                         : r->at == AT_NODE ? next_member(r)
                         : r->at == AT_PART ? begin_part(r)
                                            : node_stepped(r);
        if (code != KERNEL_OK) r->code = code;
    }
}

/* Steps the waiting node of run `first` and of all after it whose nodes go together with it. */
static void step_lanes(Run *runs, int first, int n)
{
    void *const work = runs[first].node->work;
    fmi2Component component[MOST_RUNS];
    double time[MOST_RUNS], length[MOST_RUNS];
    fmi2Status status[MOST_RUNS];
    Run *member[MOST_RUNS];
    size_t count = 0;
    int slopes = 0;

    for (int i = first; i < n; ++i) {
        Run *r = runs + i;
        if (r->code != RUNNING || r->at != WAITING || r->node->work != work) continue;
        component[count] = r->node->component;
        time[count] = r->time;
        length[count] = r->time_length;
        slopes |= r->node->n_dy > 0;
        member[count++] = r;
    }
    runs[first].node->lanes(work, count, component, time, length, slopes, status);
    for (size_t i = 0; i < count; ++i) {
        member[i]->status = status[i];
        member[i]->at = STEPPED;
    }
}

static void end_run(Kernel *k)
{
    for (int i = 0; i < k->n_nodes; ++i) {
        const KernelNode *node = k->nodes + i;
        if (node->y != node->y_home) memcpy(node->y_home, node->y, (size_t)node->n_y * sizeof node->y[0]);
    }
}

static Run new_run(Kernel *k, int64_t until, Watch *watch, int alone)
{
    Run r;

    memset(&r, 0, sizeof r);
    r.k = k;
    r.watch = watch;
    r.until = until;
    r.code = RUNNING;
    r.alone = alone;
    r.at = AT_POINT;
    return r;
}

static Watch new_watch(double budget)
{
    const double begin = now_s();
    const Watch w = {begin, begin, budget, 1, 0, 0};
    return w;
}

/* Steps until `k->index` is `until`, or something needs attention. */
int32_t kernel_run(Kernel *k, int64_t until)
{
    Watch watch = new_watch(k->budget);
    Run r = new_run(k, until, &watch, 1);

    go_on(&r);
    end_run(k);
    return r.code;
}

/* kernel_run of n runs: nodes that go together are stepped at once, of as many runs as
 * wait for one. Runs need not be at the same time, nor of the same structure. Returns
 * -1 when there are more than 64. */
int32_t kernel_run_lockstep(Kernel *const k[], const int64_t until[], int32_t n, double budget, int32_t code[])
{
    Watch watch = new_watch(budget);
    Run runs[MOST_RUNS];
    int waiting = 1;

    if (n > MOST_RUNS) return -1;
    for (int i = 0; i < n; ++i) runs[i] = new_run(k[i], until[i], &watch, 0);
    while (waiting) {
        waiting = 0;
        for (int i = 0; i < n; ++i) go_on(runs + i);
        for (int i = 0; i < n; ++i)
            if (runs[i].code == RUNNING && runs[i].at == WAITING) {
                step_lanes(runs, i, n);
                waiting = 1;
            }
    }
    for (int i = 0; i < n; ++i) {
        end_run(k[i]);
        code[i] = runs[i].code;
    }
    return 0;
}

/* Sizes of the structures, for whoever mirrors them; returns how many there are. */
int32_t kernel_layout(int32_t *sizes, int32_t room)
{
    const size_t actual[] = {sizeof(KernelSignal), sizeof(KernelFeed), sizeof(KernelNode), sizeof(KernelGroup),
                            sizeof(Kernel)};
    const int32_t count = (int32_t)(sizeof actual / sizeof actual[0]);

    for (int32_t i = 0; i < count && i < room; ++i) sizes[i] = (int32_t)actual[i];
    return count;
}
