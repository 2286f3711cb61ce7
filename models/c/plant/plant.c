/* The plant as a block (block.h): keeps the prepared numbers in memory and hands the
 * work to tables.c, flow.c, tangent.c, event.c and topology.c. */
#include <math.h>

#include "events/event.h"
#include "start/failure.h"
#include "flow/physics.h"
#include "flow/processor.h"
#include "network/port.h"
#include "events/relay.h"
#include "start/rest.h"
#include "network/sparse.h"
#include "start/tables.h"
#include "events/topology.h"

const int block_is_sampled = 0;

static const double READY = 20250101.0;

/* The prepared plan and network of a started block. */
static int prepared(const Block *b, Plan *plan, Network *net)
{
    BlockMessage unheard;
    if (!(b->memory[H_READY] == READY)) return 0;
    return plant_read(b->record, &b->layout, plan, net, &unheard) == BLOCK_OK;
}

static size_t scratch_of(const Plan *plan, const BlockLayout *l)
{
    const size_t shown = l->n_y > 2 * plan->n_source ? l->n_y : 2 * plan->n_source;
    const size_t tangent = 2 * (2 * l->n_x + l->n_u + shown + flow_work(plan)) + 2 * plan->n_machine;
    const size_t stage = 2 * plan->n_bus + topology_work(plan);
    const size_t most = tangent > stage ? tangent : stage;
    return most > relay_work(plan) ? most : relay_work(plan);
}

BlockStatus block_needs(const Record *record, const BlockLayout *layout, BlockNeeds *needs,
                        BlockMessage *message)
{
    Plan plan;
    Network net;
    BlockStatus status = plant_read(record, layout, &plan, &net, message);

    if (status == BLOCK_OK) status = plant_check(record, layout, &plan, &net, message);
    if (status != BLOCK_OK) return status;
    needs->n_memory = plan.total;
    needs->n_scratch = scratch_of(&plan, layout);
    needs->n_notes = plan.n_device * (plan.wide ? 2 : 1);
    needs->n_decisions = plan.n_decision;
    needs->n_warm = plan.n_port > 0 ? plan.total - plan.warm : 0;
    return BLOCK_OK;
}

BlockStatus block_start(Block *b, double t, BlockMessage *message)
{
    Plan plan;
    Network net;
    BlockStatus status = plant_read(b->record, &b->layout, &plan, &net, message);
    size_t count;

    if (status != BLOCK_OK) return status;
    double *memory = b->memory;
    b->lanes = processor_lanes();
    for (size_t k = 0; k < plan.total; ++k) memory[k] = 0.0;
    memory[H_OMEGA_B] = record_f64(b->record, "plant.base", &count)[0];
    plan_keep(memory, &plan);
    memory[H_PATTERN] = is_sparse(&plan) ? (double)((const unsigned char *)net.places - b->record->bytes) : 0.0;
    status = plant_tables(b, &plan, &net, message);
    if (status == BLOCK_OK) rest_prepare(memory, &plan);
    if (status == BLOCK_OK) status = rest_settle(b, &plan, &net, message);
    if (status == BLOCK_OK) status = event_check(b, &plan, &net, message);
    relay_start(memory, &plan);
    if (status == BLOCK_OK) status = event_apply(b, &plan, &net, EVENT_SWITCHES, t, message);
    if (status == BLOCK_OK) memory[H_READY] = READY;
    return status;
}

static const int32_t *places_of(const Block *b) { return plant_places(b->record, b->memory[H_PATTERN]); }

/* Newton's method failed at port `stuck` - 1. */
static BlockStatus unsolved(const Block *b, size_t stuck, double t, BlockMessage *message)
{
    Plan plan;
    Network net;
    char name[64];

    if (!prepared(b, &plan, &net))
        return plant_fail(message, BLOCK_ERROR, "plant: the network has no solution at t = %.9g s", t);
    const double *row = b->memory + plan.port + P_ROWS * (stuck - 1);
    const char *const what = port_is_load(row) ? "a load that is not constant impedance"
                           : port_is_machine(row) ? "the saturation of a machine" : "a device at the bus";
    return plant_fail(message, BLOCK_DISCARD,
                      "network: no voltage solution at bus %s with %s at t = %.9g s (Newton's method, residual "
                      "above 1e-11 pu); the voltage has collapsed or a state is not finite",
                      plant_name(net.bus_names, port_bus(&net, row), name), what, t);
}

static BlockStatus not_started(BlockMessage *message)
{
    return plant_fail(message, BLOCK_ERROR, "plant: used before block_start");
}

/* Ports start where their last voltages point to. Plants without them differ in what was switched alone, so that
 * those side by side can read one memory. Returns whether the plant goes by itself (block_group_fits). */
static int keep_time(const Block *b, double t)
{
    Plan own;
    const Plan *plan = plan_in(b->memory, &own);
    if (plan->n_port > 0) b->memory[plan->warm + (plan->folded > 0 ? W_TIME : F_TIME)] = t;
    return plan->n_port > 0 && plan->folded == 0;
}

BlockStatus block_derivatives(Block *b, double t, const double *x, const double *u, double *dx,
                              BlockMessage *message)
{
    BlockLimits *limits = b->limits;
    double switched = 0.0;
    Notes notes = NO_NOTES;
    size_t stuck;

    if (!(b->memory[H_READY] == READY)) return not_started(message);
    const int alone = keep_time(b, t);
    if (limits != NULL) {
        limits->alone = alone;
        notes.words = b->notes;
        notes.switched = limits->mode == LIMITS_WATCH ? &switched : NULL;
        notes.worst = &limits->worst;
        notes.onto = limits->onto;
        notes.each = limits->each;
        notes.stage = limits->stage;
    }
    if (limits != NULL && limits->mode == LIMITS_HOLD)
        stuck = plant_flow_held(b->memory, places_of(b), b->lanes, x, u, dx, b->scratch, notes, NULL);
    else
        stuck = plant_flow(b->memory, places_of(b), b->lanes, x, u, dx, b->scratch, notes, NULL);
    if (switched > 0.0) limits->switched = 1;
    return stuck == 0 ? BLOCK_OK : unsolved(b, stuck, t, message);
}

BlockStatus block_outputs(Block *b, double t, const double *x, const double *u, double *y,
                          BlockMessage *message)
{
    Plan own;

    if (!(b->memory[H_READY] == READY)) return not_started(message);
    (void)keep_time(b, t);
    size_t stuck = plant_outputs(b->memory, places_of(b), b->lanes, x, y, b->scratch, NULL);
    if (b->w != NULL && stuck == 0)
        stuck = plant_locals(b->memory, places_of(b), b->lanes, x, u, b->w, b->scratch,
                             b->scratch + flow_work(plan_in(b->memory, &own)));
    return stuck == 0 ? BLOCK_OK : unsolved(b, stuck, t, message);
}

BlockStatus block_directional(Block *b, double t, const double *x, const double *u, const double *vx,
                              const double *vu, double *vdx, double *vy, BlockMessage *message)
{
    if (!(b->memory[H_READY] == READY)) return not_started(message);
    (void)keep_time(b, t);
    const size_t stuck = plant_directional(b->memory, places_of(b), &b->layout, x, u, vx, vu, vdx, vy, b->scratch);
    return stuck == 0 ? BLOCK_OK : unsolved(b, stuck, t, message);
}

double block_next_event(const Block *b, double t)
{
    Plan own;
    if (!(b->memory[H_READY] == READY)) return INFINITY;
    return event_next(b, plan_in(b->memory, &own), t);
}

BlockStatus block_event(Block *b, double t, double *x, BlockMessage *message)
{
    Plan plan;
    Network net;

    if (!prepared(b, &plan, &net)) return not_started(message);
    /* the slots may have been set anew since the start */
    BlockStatus status = event_check(b, &plan, &net, message);
    if (status != BLOCK_OK) return status;
    const size_t stuck = relay_look(b, &plan, &net, x, t);
    if (stuck > 0) return unsolved(b, stuck, t, message);
    const EventReach reach = event_reach(b, &plan, t);
    if (reach != EVENT_SWITCHES && port_rest_due(b->memory, &plan, t))   /* if it is too early: later the next time */
        port_fold_at_rest(b->memory, &plan, b->lanes, 2.0 * b->memory[plan.warm + W_WAIT], b->scratch);
    if (reach == EVENT_LOOKS) return BLOCK_OK;
    status = event_apply(b, &plan, &net, reach, t, message);
    if (status == BLOCK_OK) relay_tell(b, &plan, &net, t, message);
    return status;
}

BlockStatus block_step(Block *b, double t, double h, const double *u_poly, double *dy,
                       BlockMessage *message)
{
    (void)b;
    (void)t;
    (void)h;
    (void)u_poly;
    (void)dy;
    return plant_fail(message, BLOCK_ERROR, "plant: not a sampled block; integrate block_derivatives");
}
