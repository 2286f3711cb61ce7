/* See fmu_group.h. A lane goes through its instance's step as solver.c does (stretch.h). */
#include "fmu_group.h"

#include <math.h>
#include <string.h>

#include "block_group.h"
#include "fmi2_cs.h"
#include "solver.h"
#include "stretch.h"

enum { ALIGNMENT = 8, ELAPSED = 3 };  /* doubles */
enum { MOST_EVENTS = 64 };            /* of a lane in a step; with more its step is repeated alone */
enum { GUID_ROOM = 64 };
static const char CALL[] = "fmi2DoStep";

typedef struct {
    Instance *c;            /* whose step it is                                    */
    size_t place;           /* in the caller's arrays                              */
    int failed;             /* repeats its step alone                              */
    int events;             /* how many it has handled                             */
    int undo_begun;               /* whether c->undo holds the step's start               */
    double event_times[MOST_EVENTS];   /* when: what a relay has seen since decides which come next */
    double point, step;     /* as the caller gave them                             */
    double switches_cost;   /* of the run as the step begins                       */
    Stretch stretch;
} Lane;

typedef struct {
    size_t lanes, n_memory, n_notes;
    BlockLayout layout;
    char guid[GUID_ROOM];
    BlockGroup group;
    double *u_poly, *begin, *elapsed, *warm_before;   /* warm_before: as the Runge-Kutta step begins */
    Lane lane[GROUP_MOST_LANES];
    size_t compared;                                /* lanes whose memory was compared; 0: not yet as it is now */
    int same;                                       /* and whether it is the same in all of them */
    const Instance *owner[GROUP_MOST_LANES];        /* whose memory the lane holds */
    unsigned long written[GROUP_MOST_LANES];        /* and as of when              */
    double stamp[GROUP_MOST_LANES];
} Group;

static size_t aligned(size_t doubles)
{
    return (doubles + ALIGNMENT - 1) / ALIGNMENT * ALIGNMENT;
}

static size_t head_size(void)
{
    return aligned((sizeof(Group) + sizeof(double) - 1) / sizeof(double));
}

size_t interarea_group_lanes(void)
{
    return block_group_lanes();
}

static int needs_of(const Instance *c, BlockNeeds *needs)
{
    BlockMessage message;
    return block_needs(&c->record, &c->block.layout, needs, &message) == BLOCK_OK;
}

size_t interarea_group_size(fmi2Component like, size_t lanes)
{
    const Instance *c = like;
    const BlockLayout *l;
    BlockNeeds needs = {0};
    size_t guid;

    if (c == NULL || (lanes != 2 && lanes != 4 && lanes != 8) || c->type != fmi2CoSimulation) return 0;
    if (!block_group_fits(&c->block) || !needs_of(c, &needs)) return 0;
    (void)record_text(&c->record, "guid", &guid);
    if (guid > GUID_ROOM) return 0;
    l = &c->block.layout;
    /* a number of each lane: memory; x and k; u and its polynomial; y; scratch; notes; warm twice; h, switched, begin;
     * elapsed */
    return sizeof(double)
           * (head_size() + lanes * (needs.n_memory + 6 * l->n_x + 5 * l->n_u + l->n_y + needs.n_scratch + needs.n_notes
                         + 2 * needs.n_warm + 3 + ELAPSED)
              + 14 * ALIGNMENT);
}

void interarea_group_open(void *work, fmi2Component like, size_t lanes)
{
    const Instance *c = like;
    Group *g = work;
    const BlockLayout *l = &g->layout;
    double *at = (double *)work + head_size();
    BlockNeeds needs = {0};
    size_t size;
    const char *guid = record_text(&c->record, "guid", &size);

    (void)needs_of(c, &needs);
    memset(g, 0, sizeof *g);
    g->lanes = lanes;
    g->n_memory = needs.n_memory;
    g->n_notes = needs.n_notes;
    g->layout = c->block.layout;
    memcpy(g->guid, guid, size < GUID_ROOM ? size : GUID_ROOM);
    g->group.layout = l;
    g->group.memory = at;   at += aligned(lanes * needs.n_memory);
    g->group.x = at;        at += aligned(lanes * l->n_x);
    g->group.k = at;        at += aligned(lanes * 5 * l->n_x);
    g->group.u = at;        at += aligned(lanes * l->n_u);
    g->group.y = at;        at += aligned(lanes * l->n_y);
    g->group.scratch = at;  at += aligned(lanes * needs.n_scratch);
    g->group.notes = at;    at += aligned(lanes * needs.n_notes);
    g->group.h = at;        at += aligned(lanes);
    g->group.switched = at; at += aligned(lanes);
    g->group.warm = at;     at += aligned(lanes * needs.n_warm);
    g->warm_before = at;    at += aligned(lanes * needs.n_warm);
    g->begin = at;          at += aligned(lanes);
    g->u_poly = at;         at += aligned(lanes * 4 * l->n_u);
    g->elapsed = at;        at += aligned(lanes * ELAPSED);
    memset((double *)work + head_size(), 0, (size_t)((char *)at - (char *)((double *)work + head_size())));
    g->group.n_warm = needs.n_warm;
    g->group.u_poly = g->u_poly;
    g->group.begin = g->begin;
    g->group.elapsed = g->elapsed;
}

static void put(double *group, const double *lane, size_t n, size_t lanes, size_t k)
{
    for (size_t i = 0; i < n; ++i) group[i * lanes + k] = lane[i];
}

static void get(const double *group, double *lane, size_t n, size_t lanes, size_t k)
{
    for (size_t i = 0; i < n; ++i) lane[i] = group[i * lanes + k];
}

/* Whether an instance can go in lane k: it is of the FMU that the group was opened for, and its memory such as others
 * have. One that has a memory of its own would have all lanes read as many. */
static int belongs(const Group *g, const Instance *c, size_t k)
{
    size_t size;
    const char *guid;

    if (block_group_stamp(&c->block) > 0.0) return 0;
    if (g->owner[k] == c) return 1;
    guid = record_text(&c->record, "guid", &size);
    return size <= GUID_ROOM && memcmp(guid, g->guid, size) == 0 && block_group_fits(&c->block);
}

/* Puts the instance's memory into lane k unless it is there. */
static void load_memory(Group *g, const Instance *c, size_t k)
{
    const double stamp = block_group_stamp(&c->block);

    if (g->owner[k] == c && g->written[k] == c->memory_written && g->stamp[k] == stamp) return;
    put(g->group.memory, c->block.memory, g->n_memory, g->lanes, k);
    g->owner[k] = c;
    g->written[k] = c->memory_written;
    g->stamp[k] = stamp;
    g->compared = 0;
}

static double *warm_of(const Group *g, const Instance *c) { return c->block.memory + g->n_memory - g->group.n_warm; }

/* What the lane's ports have come to into its instance, whose own code goes on there, and back. */
static void warm_out(Group *g, Lane *lane, const double *warm, size_t k)
{
    if (!lane->undo_begun) instance_undo_begin(lane->c);
    if (g->group.n_warm > 0) instance_undo_event(lane->c);   /* alone an evaluation may change the rest as well */
    lane->undo_begun = 1;
    get(warm, warm_of(g, lane->c), g->group.n_warm, g->lanes, k);
}

static void warm_in(Group *g, const Lane *lane, size_t k)
{
    put(g->group.warm, warm_of(g, lane->c), g->group.n_warm, g->lanes, k);
}

/* Between events of their own the runs of a screening have the same network and the same tables. */
static void compare_memory(Group *g, size_t n)
{
    double *first = g->lane[0].c->block.memory;

    if (g->compared != n) {
        g->same = 1;
        for (size_t k = 1; k < n && g->same; ++k)
            g->same = memcmp(first, g->lane[k].c->block.memory, (g->n_memory - g->group.n_warm) * sizeof(double)) == 0;
        g->compared = n;
    }
    g->group.shared = g->same ? first : NULL;
}

/* The event at the end of the stretch; 0 when it cannot be handled here: it fails, or the block remarks on
 * it, which the FMU's own code tells, once and in its place. */
static int meet_event(Group *g, Lane *lane, size_t k)
{
    Instance *c = lane->c;
    Stretch *stretch = &lane->stretch;
    BlockMessage message = {{0}};

    if (lane->events == MOST_EVENTS) return 0;
    lane->event_times[lane->events] = stretch->event;
    if (stretch->end > stretch->time) stretch->time = stretch->end;
    ++lane->events;
    warm_out(g, lane, g->group.warm, k);
    instance_undo_event(c);
    get(g->group.x, c->block.x, g->layout.n_x, g->lanes, k);
    c->run->time = stretch->time;
    solver_inputs(c, stretch->to, c->block.u);
    ++c->memory_written;
    g->compared = 0;   /* an event that fails leaves a memory that is not loaded */
    if (block_event(&c->block, stretch->event, c->block.x, &message) != BLOCK_OK || message.text[0] != 0) return 0;
    c->run->last_event = stretch->last_event = stretch->event;
    put(g->group.x, c->block.x, g->layout.n_x, g->lanes, k);
    load_memory(g, c, k);
    warm_in(g, lane, k);
    return 1;
}

/* The next stretch in which there is something to do, or the end: solver_advance. */
static void next_stretch(Group *g, Lane *lane, size_t k)
{
    Stretch *stretch = &lane->stretch;

    do {
        const int met = !(stretch->event < INFINITY) || meet_event(g, lane, k);
        lane->failed = !met || !stretch_next(stretch, &lane->c->block);
    } while (!lane->failed && stretch->count == 0 && stretch->event < INFINITY);
    if (lane->failed) stretch->count = stretch->done = 0;
}

static void begin_lane(Group *g, Lane *lane, size_t k)
{
    Instance *c = lane->c;

    for (size_t i = 0; i < g->layout.n_u; ++i) c->u_poly[4 * i] = c->block.u[i];
    put(g->u_poly, c->u_poly, 4 * g->layout.n_u, g->lanes, k);
    put(g->group.x, c->block.x, g->layout.n_x, g->lanes, k);
    load_memory(g, c, k);
    warm_in(g, lane, k);
    g->begin[k] = c->run->time;
    lane->undo_begun = 0;
    lane->stretch = stretch_begin(c->run->time, lane->point + lane->step, step_length(c, lane->point, lane->step),
                              *c->internal_step, c->run->last_event);
    lane->events = 0;
    lane->switches_cost = c->run->switches_cost;
    next_stretch(g, lane, k);
}

static int finite_lane(const double *x, size_t n, size_t lanes, size_t k)
{
    double sum = 0.0;
    for (size_t i = 0; i < n; ++i) sum += fabs(x[i * lanes + k]);
    return sum <= 1e300;
}

/* A limiter switches in the step that the lane is at: alone, as it would go alone. The stages that it would take first
 * are there, unless the lane could not solve one of them: that is in all later ones. What there is to remark on the
 * FMU's own code tells. */
static void step_alone(Group *g, Lane *lane, size_t k)
{
    enum { LAST_STAGE = 3 };
    Instance *c = lane->c;
    BlockMessage message = {{0}};
    const size_t n = g->layout.n_x;
    double *x = c->work + (SOLVER_ARRAYS - 1) * n;
    const int known = finite_lane(g->group.k + LAST_STAGE * n * g->lanes, n, g->lanes, k) && solver_affords(c, &lane->stretch);
    BlockStatus status;

    get(g->group.x, x, n, g->lanes, k);
    if (g->group.n_warm > 0) warm_out(g, lane, known ? g->group.warm : g->warm_before, k);
    if (known) {
        get(g->group.k, c->work, n, g->lanes, k);
        get(g->group.notes, c->block.notes, g->n_notes, g->lanes, k);
        status = solver_switched(c, &lane->stretch, x, &message);
    } else {
        status = solver_step(c, &lane->stretch, x, &message);
    }
    lane->failed = status != BLOCK_OK || message.text[0] != 0;
    put(g->group.x, x, n, g->lanes, k);
    load_memory(g, c, k);
    warm_in(g, lane, k);
    if (lane->failed) lane->stretch.count = lane->stretch.done = 0;
}

/* Substeps of all lanes until none has any left; a lane without rests (h = 0). */
static void advance(Group *g, size_t n)
{
    const size_t lanes = g->lanes;

    for (;;) {
        int busy = 0;
        for (size_t k = 0; k < n; ++k) {
            const Stretch *stretch = &g->lane[k].stretch;
            const int runs = stretch->done < stretch->count;
            const double h = runs ? stretch_h(stretch) : 0.0, elapsed = runs ? stretch_elapsed(stretch) : 0.0;
            g->group.h[k] = h;
            g->elapsed[k] = elapsed;
            g->elapsed[lanes + k] = elapsed + h / 2.0;
            g->elapsed[2 * lanes + k] = elapsed + h;
            busy |= runs;
        }
        if (!busy) return;
        compare_memory(g, n);
        memcpy(g->warm_before, g->group.warm, lanes * g->group.n_warm * sizeof(double));
        block_group_step(&g->group, lanes);
        for (size_t k = 0; k < n; ++k) {
            Stretch *stretch = &g->lane[k].stretch;
            if (stretch->done == stretch->count) continue;
            if (g->group.switched[k] > 0.0) step_alone(g, &g->lane[k], k);
            if (g->lane[k].failed || ++stretch->done < stretch->count) continue;
            if (stretch->event < INFINITY) next_stretch(g, &g->lane[k], k);
        }
    }
}

/* Writes the end of the step into the instance. */
static void accept(Group *g, const Lane *lane, size_t k)
{
    Instance *c = lane->c;

    for (int i = 0; i < lane->events; ++i) instance_log_event(c, "event at time %.9g s", lane->event_times[i]);
    get(g->group.x, c->block.x, g->layout.n_x, g->lanes, k);
    get(g->group.y, c->block.y, g->layout.n_y, g->lanes, k);
    get(g->group.warm, warm_of(g, c), g->group.n_warm, g->lanes, k);
    c->run->time = lane->point + lane->step;
    step_consume_inputs(c, lane->step);
    c->run->outputs_fresh = FRESH_BUT_LOCALS;
    c->run->derivatives_fresh = STALE;
}

/* Back to the start of the step, then the FMU's own code, which says why it ends. */
static fmi2Status repeat_alone(Lane *lane)
{
    Instance *c = lane->c;

    if (lane->undo_begun) instance_undo(c);
    c->run->switches_cost = lane->switches_cost;
    return fmi2DoStep(c, lane->point, lane->step, fmi2True);
}

static void finish(Group *g, size_t n, int rates, fmi2Status status[])
{
    const BlockLayout *l = &g->layout;
    const size_t lanes = g->lanes;

    for (size_t k = 0; k < n; ++k) {
        Lane *lane = &g->lane[k];
        solver_inputs(lane->c, lane->step, lane->c->work);
        put(g->group.u, lane->c->work, l->n_u, lanes, k);
        g->begin[k] = lane->point + lane->step;
        g->elapsed[k] = 0.0;
    }
    compare_memory(g, n);
    block_group_outputs(&g->group, lanes, rates);
    for (size_t k = 0; k < n; ++k) {
        Lane *lane = &g->lane[k];
        if (lane->failed || !finite_lane(g->group.x, l->n_x, lanes, k) || !finite_lane(g->group.y, l->n_y, lanes, k)
            || !finite_lane(g->group.u, l->n_u, lanes, k)) {
            status[lane->place] = repeat_alone(lane);
            continue;
        }
        accept(g, lane, k);
        if (rates) {
            get(g->group.k, lane->c->block.dx, l->n_x, lanes, k);
            lane->c->run->derivatives_fresh = FRESH;
        }
        status[lane->place] = fmi2OK;
    }
}

void interarea_group_step(void *work, size_t n, const fmi2Component c[], const fmi2Real point[],
                          const fmi2Real step[], int rates, fmi2Status status[])
{
    Group *g = work;

    for (size_t i = 0; i < n;) {
        size_t taken = 0;
        for (; i < n && taken < g->lanes; ++i) {
            Lane *lane = &g->lane[taken];
            Instance *instance = c[i];
            if (n == 1 || instance == NULL || !belongs(g, instance, taken)) {
                status[i] = fmi2DoStep(instance, point[i], step[i], fmi2True);
                continue;
            }
            status[i] = fmi2Error;
            if (!instance_allowed(instance, MODE_STEP_COMPLETE, CALL)) continue;
            if (!step_is_sane(instance, point[i], step[i], CALL)) continue;
            lane->c = instance;
            lane->place = i;
            lane->point = point[i];
            lane->step = step[i];
            begin_lane(g, lane, taken++);
        }
        if (taken == 0) continue;
        g->group.record = &g->lane[0].c->record;
        for (size_t k = taken; k < g->lanes; ++k) g->group.h[k] = 0.0;
        advance(g, taken);
        finish(g, taken, rates, status);
    }
}
