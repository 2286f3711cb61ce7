/* The plant without FMI: a classical Runge-Kutta loop of order 4 straight over
 * its right-hand side, for bench_plant.py. Compiled together with the sources of
 * the plant, with the flags of the FMU. */
#include <stdlib.h>
#include <string.h>
#include <time.h>

#include "block.h"
#include "limited_step.h"
#include "physics.h"
#include "sparse.h"

#pragma GCC visibility push(default)

typedef struct {
    Record record;
    Block block;
    BlockMessage message;
    double *k;               /* of limited_step */
    double t;                /* where the step under way begins */
    long evaluations, switches;
    double spent, *overruns; /* of limited_step */
    size_t n_decisions;
} Plain;

static double *zeros(size_t n) { return calloc(n + 1, sizeof(double)); }

/* A started plant from its record, the counts of its variables and start values; NULL if refused. */
void *plain_open(const void *bytes, size_t size, const size_t counts[9], const double *x0,
                 const double *parameters, const int *integers)
{
    Plain *c = calloc(1, sizeof *c);
    BlockNeeds needs = {0};
    const char *why;
    if (c == NULL || record_open(&c->record, bytes, size, &why) != 0) return NULL;
    Block *b = &c->block;
    b->record = &c->record;
    memcpy(&b->layout, counts, sizeof b->layout);
    if (block_needs(b->record, &b->layout, &needs, &c->message) != BLOCK_OK) return NULL;
    b->x = zeros(b->layout.n_x);
    b->dx = zeros(b->layout.n_x);
    b->u = zeros(b->layout.n_u);
    b->y = zeros(b->layout.n_y);
    b->w = zeros(b->layout.n_w);
    b->p = zeros(b->layout.n_p);
    b->ip = calloc(b->layout.n_ip + 1, sizeof(int));
    b->memory = zeros(needs.n_memory);
    b->scratch = zeros(needs.n_scratch);
    b->notes = zeros(needs.n_notes);
    c->n_decisions = needs.n_decisions;
    c->overruns = zeros(LIMITED_POINTS * needs.n_decisions);
    c->k = zeros(LIMITED_STEP_ARRAYS * b->layout.n_x);
    if (b->ip == NULL) return NULL;
    memcpy(b->x, x0, b->layout.n_x * sizeof(double));
    memcpy(b->p, parameters, b->layout.n_p * sizeof(double));
    memcpy(b->ip, integers, b->layout.n_ip * sizeof(int));
    return block_start(b, 0.0, &c->message) == BLOCK_OK ? c : NULL;
}

/* The states now, n_x of them. */
void plain_states(const void *plant, double *x)
{
    const Block *b = &((const Plain *)plant)->block;
    memcpy(x, b->x, b->layout.n_x * sizeof(double));
}

/* CPU seconds of `steps` steps of length h. */
double plain_run(void *plant, long steps, double h)
{
    Plain *c = plant;
    Block *b = &c->block;
    const size_t n = b->layout.n_x;
    double *k1 = c->k, *k2 = k1 + n, *k3 = k2 + n, *k4 = k3 + n, *x = k4 + n;
    const int32_t *places = plant_places(b->record, b->memory[H_PATTERN]);
    const clock_t begin = clock();

    for (long step = 0; step < steps; ++step) {
        plant_flow(b->memory, places, b->lanes, b->x, b->u, k1, b->scratch, NO_NOTES, NULL);
        for (size_t i = 0; i < n; ++i) x[i] = b->x[i] + h / 2.0 * k1[i];
        plant_flow(b->memory, places, b->lanes, x, b->u, k2, b->scratch, NO_NOTES, NULL);
        for (size_t i = 0; i < n; ++i) x[i] = b->x[i] + h / 2.0 * k2[i];
        plant_flow(b->memory, places, b->lanes, x, b->u, k3, b->scratch, NO_NOTES, NULL);
        for (size_t i = 0; i < n; ++i) x[i] = b->x[i] + h * k3[i];
        plant_flow(b->memory, places, b->lanes, x, b->u, k4, b->scratch, NO_NOTES, NULL);
        for (size_t i = 0; i < n; ++i) b->x[i] += h / 6.0 * (k1[i] + 2.0 * (k2[i] + k3[i]) + k4[i]);
    }
    return (double)(clock() - begin) / CLOCKS_PER_SEC;
}

/* dx/dt, counted; a switch begins with limiters noted in the middle of a step. */
static BlockStatus counted(void *context, double into, BlockLimits *limits, const double *x, double *k)
{
    Plain *c = context;
    c->evaluations += 1;
    c->switches += limits->mode == LIMITS_NOTE && into > 0.0;
    c->block.limits = limits;
    const BlockStatus status = block_derivatives(&c->block, c->t + into, x, c->block.u, k, &c->message);
    c->block.limits = NULL;
    return status;
}

/* CPU seconds from `begin` to `stop` in steps of at most h between events, as the FMU takes them; the counts
 * of evaluations of the right-hand side, of switches of limiters that were located and of steps. -1: it failed. */
double plain_events(void *plant, double begin, double stop, double h, long counts[3])
{
    Plain *c = plant;
    Block *b = &c->block;
    const clock_t started = clock();

    c->evaluations = c->switches = counts[2] = 0;
    for (double from = begin; from < stop;) {
        const double event = block_next_event(b, from), to = event < stop ? event : stop;
        const long count = runge_kutta_count(to - from, h);
        counts[2] += count;
        for (long k = 0; k < count; ++k) {
            c->t = from + (to - from) * ((double)k / (double)count);
            const double step = (to - from) / (double)count;
            const LimitedRun run = {0.0, &c->spent, c->overruns, c->n_decisions};
            if (limited_step(counted, c, b->layout.n_x, c->t, step, b->x, c->k, &run, &c->message) != BLOCK_OK) return -1.0;
        }
        if (event <= stop && block_event(b, event, b->x, &c->message) != BLOCK_OK) return -1.0;
        from = to;
    }
    counts[0] = c->evaluations;
    counts[1] = c->switches;
    return (double)(clock() - started) / CLOCKS_PER_SEC;
}
