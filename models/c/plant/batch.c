/* The scenarios of a batch: each is a Block of its own for what happens at its start
 * and at its events; between them its memory and states travel in a group's lanes. */
#include "batch.h"

#include <stdio.h>
#if defined __x86_64__
#include <cpuid.h>
#endif

static const double MOST_SUBSTEPS = 1e9;

size_t batch_lanes(void)
{
#if defined __x86_64__
    unsigned a, b, c, d, low, high;
    if (!__get_cpuid(1, &a, &b, &c, &d) || (c & (1u << 27)) == 0) return 2;   /* OSXSAVE */
    __asm__ volatile("xgetbv" : "=a"(low), "=d"(high) : "c"(0));
    if (!__get_cpuid_count(7, 0, &a, &b, &c, &d) || (low & 6u) != 6u || (b & (1u << 5)) == 0) return 2;
    return (low & 0xE6u) == 0xE6u && (b & (1u << 16)) != 0 ? 8 : 4;
#else
    return 2;
#endif
}

/* What a lane is about. */
typedef struct {
    Block block;
    size_t scenario;
    int real;              /* 0: fills up the last group                          */
    int alive;
    double time, last_event, end;
    double begin, begin_event; /* time and last_event at the communication step's start */
    double from, to, event; /* segment under way, the event at its end or infinity */
    long count, done;      /* substeps of the segment                             */
} Lane;

enum { MOST_LANES = 8 };

static size_t lane_size(const BlockLayout *l, const BlockNeeds *needs)
{
    /* x, dx, u, y, p, memory, scratch; ip as doubles */
    return 2 * l->n_x + l->n_u + l->n_y + l->n_p + needs->n_memory + needs->n_scratch + l->n_ip;
}

static size_t group_size(const BlockLayout *l, const BlockNeeds *needs)
{
    /* memory, x and k, u, y, scratch and space for one lane alone, h */
    return 2 * needs->n_memory + 6 * l->n_x + l->n_u + l->n_y + 2 * needs->n_scratch + 1;
}

BlockStatus batch_open(Record *record, const void *bytes, size_t size, const BlockLayout *layout,
                       BlockNeeds *needs, BlockMessage *message)
{
    const char *why = NULL;
    if (record_open(record, bytes, size, &why) != 0) return plant_fail(message, BLOCK_ERROR, "record: %s", why);
    return block_needs(record, layout, needs, message);
}

size_t batch_work(const BlockLayout *layout, const BlockNeeds *needs, size_t lanes)
{
    return lanes * (lane_size(layout, needs) + group_size(layout, needs));
}

static void lane_arrays(Lane *lane, const Batch *b, const BlockNeeds *needs, double *at)
{
    const BlockLayout *l = &b->layout;
    Block block = { 0 };

    block.record = b->record;
    block.layout = *l;
    block.x = at;        at += l->n_x;
    block.dx = at;       at += l->n_x;
    block.u = at;        at += l->n_u;
    block.y = at;        at += l->n_y;
    block.p = at;        at += l->n_p;
    block.memory = at;   at += needs->n_memory;
    block.scratch = at;  at += needs->n_scratch;
    block.ip = (int *)(void *)at;
    lane->block = block;
}

static void end_lane(Lane *lane, Batch *b, BlockStatus status, const BlockMessage *message)
{
    lane->alive = 0;
    if (!lane->real) return;
    b->status[lane->scenario] = (int)status;
    b->ended[lane->scenario] = lane->time;
    b->message[lane->scenario] = *message;
}

static void start_lane(Lane *lane, Batch *b)
{
    const BlockLayout *l = &b->layout;
    BlockMessage message = { { 0 } };
    const size_t k = lane->scenario;

    for (size_t i = 0; i < l->n_x; ++i) lane->block.x[i] = b->x[i * b->n + k];
    for (size_t i = 0; i < l->n_p; ++i) lane->block.p[i] = b->p[i * b->n + k];
    for (size_t i = 0; i < l->n_ip; ++i) lane->block.ip[i] = b->ip[i * b->n + k];
    for (size_t i = 0; i < l->n_u; ++i) lane->block.u[i] = 0.0;
    lane->time = lane->last_event = b->start;
    lane->event = INFINITY;
    lane->alive = 1;
    const BlockStatus status = block_start(&lane->block, b->start, &message);
    if (status != BLOCK_OK) end_lane(lane, b, status, &message);
}

/* The next stretch of a lane within its communication step, ending at an event or at
 * the step's end; as solver_advance of the FMU. */
static void next_segment(Lane *lane, Batch *b)
{
    const double slack = 1e-9 * b->step;

    for (;;) {
        if (lane->event < INFINITY) {   /* the one the last segment ended at */
            BlockMessage message = { { 0 } };
            const BlockStatus status = block_event(&lane->block, lane->event, lane->block.x, &message);
            if (status != BLOCK_OK) {
                end_lane(lane, b, status, &message);
                return;
            }
            lane->last_event = lane->event;
        }
        const double after = lane->last_event > lane->time ? lane->last_event : lane->time;
        const double event = block_next_event(&lane->block, after);
        const int reached = event <= lane->end + slack;
        lane->event = reached ? event : INFINITY;
        lane->from = lane->time;
        lane->to = reached && event < lane->end ? event : lane->end;
        lane->done = 0;
        lane->count = 0;
        if (lane->to > lane->from) {
            const double wanted = ceil((lane->to - lane->from) / b->substep[lane->scenario] - 1e-9);
            lane->count = wanted < 1.0 ? 1 : (long)wanted;
            return;
        }
        if (!reached) return;
    }
}

static void put(double *group, const double *lane, size_t n, size_t lanes, size_t k)
{
    for (size_t i = 0; i < n; ++i) group[i * lanes + k] = lane[i];
}

static void get(const double *group, double *lane, size_t n, size_t lanes, size_t k)
{
    for (size_t i = 0; i < n; ++i) lane[i] = group[i * lanes + k];
}

/* Several lanes: a Runge-Kutta step of all that have one to do; the others rest (h = 0). */
typedef struct {
    size_t lanes, n_memory;
    BlockGroup group;
    BatchStep *step, *outputs;
} Vector;

static void advance_vector(Vector *v, Lane *lanes, Batch *b)
{
    const BlockLayout *l = &b->layout;

    for (;;) {
        int busy = 0;
        for (size_t k = 0; k < v->lanes; ++k) {
            Lane *lane = &lanes[k];
            const int runs = lane->alive && lane->done < lane->count;
            v->group.h[k] = runs ? (lane->to - lane->from) / (double)lane->count : 0.0;
            v->group.memory[(size_t)H_IDLE * v->lanes + k] = runs ? 0.0 : 1.0;
            busy |= runs;
        }
        if (!busy) return;
        v->step(&v->group);
        for (size_t k = 0; k < v->lanes; ++k) {
            Lane *lane = &lanes[k];
            if (!lane->alive || lane->done == lane->count || ++lane->done < lane->count) continue;
            lane->time = lane->to;
            if (!(lane->event < INFINITY)) continue;
            get(v->group.x, lane->block.x, l->n_x, v->lanes, k);
            get(v->group.memory, lane->block.memory, v->n_memory, v->lanes, k);
            next_segment(lane, b);
            put(v->group.memory, lane->block.memory, v->n_memory, v->lanes, k);
            put(v->group.x, lane->block.x, l->n_x, v->lanes, k);
        }
    }
}

/* One lane at a time: the scalar code, ports and all. */
static void advance_scalar(Lane *lane, Batch *b, double *k1)
{
    const size_t n = b->layout.n_x;
    double *k2 = k1 + n, *k3 = k2 + n, *k4 = k3 + n, *at = k4 + n, *x = lane->block.x;
    Block *block = &lane->block;

    while (lane->alive && lane->done < lane->count) {
        const double h = (lane->to - lane->from) / (double)lane->count;
        const double t = lane->from + (lane->to - lane->from) * ((double)lane->done / (double)lane->count);
        BlockMessage message = { { 0 } };
        BlockStatus status = block_derivatives(block, t, x, block->u, k1, &message);
        for (size_t i = 0; i < n; ++i) at[i] = x[i] + h / 2.0 * k1[i];
        if (status == BLOCK_OK) status = block_derivatives(block, t + h / 2.0, at, block->u, k2, &message);
        for (size_t i = 0; i < n; ++i) at[i] = x[i] + h / 2.0 * k2[i];
        if (status == BLOCK_OK) status = block_derivatives(block, t + h / 2.0, at, block->u, k3, &message);
        for (size_t i = 0; i < n; ++i) at[i] = x[i] + h * k3[i];
        if (status == BLOCK_OK) status = block_derivatives(block, t + h, at, block->u, k4, &message);
        if (status != BLOCK_OK) {
            end_lane(lane, b, status, &message);
            return;
        }
        for (size_t i = 0; i < n; ++i) x[i] += h / 6.0 * (k1[i] + 2.0 * (k2[i] + k3[i]) + k4[i]);
        if (++lane->done < lane->count) continue;
        lane->time = lane->to;
        if (lane->event < INFINITY) next_segment(lane, b);
    }
}

/* Outputs of a lane at its time; a state that is not finite ends it. */
static void record(Lane *lane, Batch *b, size_t step, const double *y, size_t stride)
{
    const size_t n_y = b->layout.n_y;
    int finite = lane->alive;

    for (size_t i = 0; i < n_y && finite; ++i) finite = fabs(y[i * stride]) <= 1e300;
    if (lane->alive && !finite) {
        BlockMessage message;
        lane->time = step == 0 ? b->start : b->start + b->step * (double)(step - 1);
        (void)snprintf(message.text, sizeof message.text,
                       "an output is not finite after t = %.9g s; try a shorter substep than %g s", lane->time,
                       b->substep[lane->scenario]);
        end_lane(lane, b, BLOCK_ERROR, &message);
    }
    if (!lane->real) return;
    for (size_t i = 0; i < n_y; ++i)
        b->y[(step * n_y + i) * b->n + lane->scenario] = lane->alive ? y[i * stride] : NAN;
}

static int finite_lane(const double *x, size_t n, size_t lanes, size_t k)
{
    double sum = 0.0;
    for (size_t i = 0; i < n; ++i) sum += fabs(x[i * lanes + k]);
    return sum <= 1e300;
}

/* A lane whose states are not finite any more repeats its communication step by the
 * scalar code, which says why. */
static void repeat_alone(Vector *v, Lane *lane, size_t k, Batch *b)
{
    const size_t n = b->layout.n_x;
    BlockMessage message = { { 0 } };

    for (size_t i = 0; i < n; ++i) lane->block.x[i] = lane->block.dx[i];
    lane->time = lane->begin;
    lane->last_event = lane->begin_event;
    lane->event = INFINITY;
    const BlockStatus status = block_event(&lane->block, lane->begin, lane->block.x, &message);
    if (status != BLOCK_OK) {
        end_lane(lane, b, status, &message);
        return;
    }
    lane->block.memory[H_IDLE] = 0.0;
    next_segment(lane, b);
    advance_scalar(lane, b, v->group.k);
    put(v->group.memory, lane->block.memory, v->n_memory, v->lanes, k);
    put(v->group.x, lane->block.x, n, v->lanes, k);
}

/* Outputs that are not finite: the scalar code says why. */
static void explain(const Vector *v, Lane *lane, size_t k, Batch *b)
{
    BlockMessage message = { { 0 } };

    get(v->group.x, lane->block.x, b->layout.n_x, v->lanes, k);
    get(v->group.memory, lane->block.memory, v->n_memory, v->lanes, k);
    const BlockStatus status = block_outputs(&lane->block, lane->time, lane->block.x, lane->block.u,
                                             lane->block.y, &message);
    if (status != BLOCK_OK) end_lane(lane, b, status, &message);
}

static void run_group(Batch *b, Lane *lanes, Vector *v, double *k)
{
    const BlockLayout *l = &b->layout;
    const size_t width = v->lanes;

    for (size_t j = 0; j < width; ++j) start_lane(&lanes[j], b);
    for (size_t j = 0; j < width; ++j) {
        put(v->group.memory, lanes[j].block.memory, v->n_memory, width, j);
        put(v->group.x, lanes[j].block.x, l->n_x, width, j);
    }
    for (size_t step = 0; step <= b->n_steps; ++step) {
        for (size_t j = 0; j < width; ++j)
            v->group.memory[(size_t)H_IDLE * width + j] = lanes[j].alive ? 0.0 : 1.0;
        if (width > 1) v->outputs(&v->group);
        for (size_t j = 0; j < width; ++j) {
            Lane *lane = &lanes[j];
            BlockMessage message = { { 0 } };
            if (width == 1 && lane->alive) {
                const BlockStatus status = block_outputs(&lane->block, lane->time, lane->block.x,
                                                         lane->block.u, lane->block.y, &message);
                if (status != BLOCK_OK) end_lane(lane, b, status, &message);
            }
            if (width > 1 && lane->alive && !finite_lane(v->group.y, l->n_y, width, j)) explain(v, lane, j, b);
            record(lane, b, step, width > 1 ? v->group.y + j : lane->block.y, width);
        }
        if (step == b->n_steps) break;
        for (size_t j = 0; j < width; ++j) {
            Lane *lane = &lanes[j];
            for (size_t i = 0; i < l->n_u && b->u != NULL; ++i)
                lane->block.u[i] = b->u[(step * l->n_u + i) * b->n + lane->scenario];
            put(v->group.u, lane->block.u, l->n_u, width, j);
            lane->end = b->start + b->step * (double)(step + 1);
            lane->count = lane->done = 0;
            if (!lane->alive) continue;
            lane->begin = lane->time;
            lane->begin_event = lane->last_event;
            if (width > 1) get(v->group.x, lane->block.dx, l->n_x, width, j);
            next_segment(lane, b);
        }
        if (width == 1) {
            advance_scalar(&lanes[0], b, k);
            continue;
        }
        advance_vector(v, lanes, b);
        for (size_t j = 0; j < width; ++j)
            if (lanes[j].alive && !finite_lane(v->group.x, l->n_x, width, j)) repeat_alone(v, &lanes[j], j, b);
    }
    for (size_t j = 0; j < width; ++j) {
        Lane *lane = &lanes[j];
        if (!lane->real) continue;
        if (width > 1) get(v->group.x, lane->block.x, l->n_x, width, j);
        for (size_t i = 0; i < l->n_x; ++i) b->x[i * b->n + lane->scenario] = lane->block.x[i];
        if (lane->alive) b->ended[lane->scenario] = lane->time;
    }
}

BlockStatus batch_run(Batch *b, size_t lanes, BlockMessage *message)
{
    const BlockLayout *l = &b->layout;
    BlockNeeds needs;
    Lane lane[MOST_LANES];
    BlockStatus status = block_needs(b->record, l, &needs, message);

    if (status != BLOCK_OK) return status;
    if ((lanes != 1 && lanes != 2 && lanes != 4 && lanes != 8) || lanes > batch_lanes())
        return plant_fail(message, BLOCK_ERROR, "batch: %zu lanes, allowed here: 1, 2, .. %zu", lanes, batch_lanes());
    for (size_t k = 0; k < b->n; ++k)
        if (!(b->step > 0.0 && b->substep[k] > 0.0 && b->step / b->substep[k] <= MOST_SUBSTEPS))
            return plant_fail(message, BLOCK_ERROR, "batch: step = %g s, substep = %g s, allowed: above 0",
                              b->step, b->substep[k]);

    double *at = b->work;
    Vector v = { lanes, needs.n_memory, { .layout = l }, NULL, NULL };
    v.step = lanes == 8 ? batch_step_8 : lanes == 4 ? batch_step_4 : batch_step_2;
    v.outputs = lanes == 8 ? batch_outputs_8 : lanes == 4 ? batch_outputs_4 : batch_outputs_2;
    v.group.h = at;        at += lanes;
    v.group.memory = at;   at += lanes * needs.n_memory;
    v.group.x = at;        at += lanes * l->n_x;
    v.group.k = at;        at += lanes * 5 * l->n_x;
    v.group.u = at;        at += lanes * l->n_u;
    v.group.y = at;        at += lanes * l->n_y;
    v.group.scratch = at;  at += lanes * (2 * needs.n_scratch + needs.n_memory);
    for (size_t j = 0; j < lanes; ++j, at += lane_size(l, &needs)) lane_arrays(&lane[j], b, &needs, at);

    for (size_t first = 0; first < b->n; first += lanes) {
        for (size_t j = 0; j < lanes; ++j) {
            lane[j].real = first + j < b->n;
            lane[j].scenario = lane[j].real ? first + j : b->n - 1;
            if (!lane[j].real) continue;
            b->status[first + j] = BLOCK_OK;
            b->message[first + j].text[0] = '\0';
        }
        run_group(b, lane, &v, v.group.k);
    }
    return BLOCK_OK;
}
