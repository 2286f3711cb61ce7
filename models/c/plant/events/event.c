/* Events: what the slots ask for at a time, put into memory. A slot is active
 * from its start (included) to its end (excluded); the state after an event
 * follows from the time and from when breakers of relays opened (relay.c). */
#include "event.h"

#include <math.h>

#include "../network/port.h"
#include "../start/failure.h"
#include "relay.h"
#include "topology.h"
#include "wave.h"

static const char *kind_name(int kind)
{
    static const char *const names[EVENT_KINDS] = {
        "none", "bus_fault", "branch_trip", "branch_reclose", "vref_pulse",
        "load_step", "pm_pulse", "machine_trip", "shunt_switch", "frequency_shed", "frequency_trip",
        "device_trip", "hvdc_block"
    };
    return kind >= 0 && kind < (int)EVENT_KINDS ? names[kind] : "unknown";
}

static size_t target_count(const Plan *plan, const Network *net, int kind)
{
    switch (kind) {
    case EVENT_BUS_FAULT: return plan->n_bus;
    case EVENT_BRANCH_TRIP:
    case EVENT_BRANCH_RECLOSE: return plan->n_branch;
    case EVENT_LOAD_STEP:
    case EVENT_FREQUENCY_SHED: return plan->n_load;
    case EVENT_SHUNT_SWITCH: return net->n_item;
    case EVENT_DEVICE_TRIP:
    case EVENT_HVDC_BLOCK: return plan->n_at_bus;
    default: return plan->n_machine;
    }
}

static int is_regulated(const Block *b, const Plan *plan, size_t machine)
{
    for (size_t j = 0; j < plan->n_input; ++j)
        if (index_at(b->memory + plan->input_machine, j) == machine) return 1;
    return 0;
}

/* Times and numbers that every kind has. */
static BlockStatus check_numbers(const double *p, const int *i, size_t slot, BlockMessage *message)
{
    const int kind = i[SLOT_KIND];

    for (size_t j = 0; j < SLOT_REALS; ++j)
        if (!(fabs(p[j]) <= 1e300))
            return plant_fail(message, BLOCK_ERROR, "event[%zu] (%s): a parameter is not a finite number", slot,
                              kind_name(kind));
    if (!(p[SLOT_END] > p[SLOT_START]))
        return plant_fail(message, BLOCK_ERROR,
                          "event[%zu] (%s): end = %g s with start = %g s, allowed: end > start (1e30 for no end)",
                          slot, kind_name(kind), p[SLOT_END], p[SLOT_START]);
    return wave_check(p, i, slot, kind_name(kind), message);
}

static BlockStatus check_slot(const Block *b, const Plan *plan, const Network *net, size_t k, BlockMessage *message)
{
    const double *p = slot_reals(b, plan, k);
    const int *i = slot_integers(b, plan, k);
    const int kind = i[SLOT_KIND], target = i[SLOT_TARGET];

    if (kind < 0 || kind >= (int)EVENT_KINDS)
        return plant_fail(message, BLOCK_ERROR, "event[%zu].kind = %d, allowed: 0 to %d", k + 1, kind,
                          (int)EVENT_KINDS - 1);
    const size_t count = target_count(plan, net, kind);
    const int least = kind == EVENT_LOAD_STEP && i[SLOT_WAVE] == WAVE_NOISE ? 0 : 1;   /* 0: every load */
    if (target < least || target > (int)count)
        return plant_fail(message, BLOCK_ERROR, "event[%zu].target = %d for %s, allowed: %d to %zu", k + 1, target,
                          kind_name(kind), least, count);
    const BlockStatus status = check_numbers(p, i, k + 1, message);
    if (status != BLOCK_OK) return status;
    if (kind == EVENT_BUS_FAULT
        && (!(p[SLOT_R] >= 0.0) || !(p[SLOT_R] * p[SLOT_R] + p[SLOT_X] * p[SLOT_X] >= 1e-16)))
        return plant_fail(message, BLOCK_ERROR,
                          "event[%zu] (bus_fault): r = %g, x = %g, allowed: r >= 0 and |r + jx| >= 1e-8 pu", k + 1,
                          p[SLOT_R], p[SLOT_X]);
    if (kind == EVENT_VREF_PULSE && !is_regulated(b, plan, (size_t)target - 1)) {
        char name[64];
        return plant_fail(message, BLOCK_ERROR, "event[%zu] (vref_pulse): machine %s has no voltage regulator", k + 1,
                          plant_name(net->machine_names, (size_t)target - 1, name));
    }
    return relay_is(kind) ? relay_check(b, p, k, kind_name(kind), message) : BLOCK_OK;
}

BlockStatus event_check(const Block *b, const Plan *plan, const Network *net, BlockMessage *message)
{
    for (size_t k = 0; k < plan->n_slot; ++k) {
        if (slot_integers(b, plan, k)[SLOT_KIND] == EVENT_NONE) continue;
        const BlockStatus status = check_slot(b, plan, net, k, message);
        if (status != BLOCK_OK) return status;
    }
    return BLOCK_OK;
}

double event_next(const Block *b, const Plan *plan, double t)
{
    const double relay = relay_next(b, plan, t), ports = port_rest_next(b->memory, plan, t);
    double next = relay < ports ? relay : ports;
    for (size_t k = 0; k < plan->n_slot; ++k) {
        if (slot_integers(b, plan, k)[SLOT_KIND] == EVENT_NONE) continue;
        const double own = wave_next(slot_reals(b, plan, k), slot_integers(b, plan, k), t);
        if (own < next) next = own;
    }
    return next;
}

EventReach event_reach(const Block *b, const Plan *plan, double t)
{
    EventReach reach = EVENT_SWITCHES;   /* a time that is no slot's: somebody set one anew */
    int looks = relay_looks(b, plan, t) || port_rest_due(b->memory, plan, t), steps = 0;

    for (size_t k = 0; k < plan->n_slot; ++k) {
        const int *i = slot_integers(b, plan, k), kind = i[SLOT_KIND];
        if (relay_is(kind) && b->memory[plan->relay + RELAY_ROWS * k + RELAY_OPENS] == t) return EVENT_SWITCHES;
        if (kind == EVENT_NONE || relay_is(kind) || !wave_acts(slot_reals(b, plan, k), i, t)) continue;
        if (!slot_sets(kind)) return EVENT_SWITCHES;
        steps = 1;
    }
    if (steps) reach = EVENT_STEPS;
    else if (looks) reach = EVENT_LOOKS;
    return reach;
}

/* A branch follows the latest of its edges: trip opens at start and closes again
 * at end; reclose closes at start and opens again at end. */
static double branch_state(const Block *b, const Plan *plan, size_t branch, int initial, double t)
{
    double latest = -INFINITY, state = initial != 0 ? 1.0 : 0.0;
    for (size_t k = 0; k < plan->n_slot; ++k) {
        const double *p = slot_reals(b, plan, k);
        const int *i = slot_integers(b, plan, k);
        const int trip = i[SLOT_KIND] == EVENT_BRANCH_TRIP, close = i[SLOT_KIND] == EVENT_BRANCH_RECLOSE;
        if ((!trip && !close) || (size_t)i[SLOT_TARGET] != branch + 1) continue;
        if (p[SLOT_START] <= t && p[SLOT_START] >= latest) {
            latest = p[SLOT_START];
            state = close ? 1.0 : 0.0;
        }
        if (p[SLOT_END] <= t && p[SLOT_END] >= latest) {
            latest = p[SLOT_END];
            state = close ? 0.0 : 1.0;
        }
    }
    return state;
}

/* Of each part of the network. Infinite buses, as long as one runs, are the centre: their H is infinite.
 * total, infinite: a number for each machine. */
static void centre_of_inertia(double *memory, const Plan *plan, double *total, double *infinite)
{
    const size_t n = plan->n_machine;
    const double *H = memory + plan->machine + M_H * n, *ratio = memory + plan->machine + M_RATIO * n;
    const double *running = memory + plan->running;

    for (size_t k = 0; k < n; ++k) total[k] = infinite[k] = 0.0;
    for (size_t k = 0; k < n; ++k) {
        const size_t part = index_at(memory + plan->part, k);
        if (isinf(H[k])) infinite[part] += running[k];
        else total[part] += H[k] * ratio[k] * running[k];
    }
    for (size_t k = 0; k < n; ++k) {
        const size_t part = index_at(memory + plan->part, k);
        const double weight = isinf(H[k]) ? 1.0 : infinite[part] > 0.0 ? 0.0 : H[k] * ratio[k];
        const double all = infinite[part] > 0.0 ? infinite[part] : total[part];
        memory[plan->coi + k] = running[k] > 0.5 ? weight / all : 0.0;
    }
}

/* Ports of loads draw what the case says, before load steps. */
static void reset_ports(double *memory, const Plan *plan, const Network *net)
{
    for (size_t k = 0; k < plan->n_port; ++k) {
        double *row = memory + plan->port + P_ROWS * k;
        const size_t load = index_at(row, P_DEVICE);
        if (!port_is_load(row)) continue;
        row[P_P] = net->load[L_P * plan->n_load + load];
        row[P_Q] = net->load[L_Q * plan->n_load + load];
    }
}

static void step_load_port(double *memory, const Plan *plan, size_t load, double size, double size_q)
{
    for (size_t k = 0; k < plan->n_port; ++k) {
        double *row = memory + plan->port + P_ROWS * k;
        if (!port_is_load(row) || index_at(row, P_DEVICE) != load) continue;
        row[P_P] += size;
        row[P_Q] += size_q;
    }
}

/* size + j size_q at the load's operating voltage, of its characteristic. */
static void step_load(const Plan *plan, const Network *net, size_t load, double size, double size_q, double *memory,
                      double *extra)
{
    const size_t bus = (size_t)net->load_bus[load];
    const double v = net->load[L_V0 * plan->n_load + load];

    extra[bus] += size / (v * v);
    extra[plan->n_bus + bus] -= size_q / (v * v);
    step_load_port(memory, plan, load, size, size_q);
}

/* Noise of every load, each of its own powers. */
static void step_loads(const Plan *plan, const Network *net, const double *p, const int *i, double t, double *memory,
                       double *extra)
{
    for (size_t load = 0; load < plan->n_load; ++load) {
        const double share = p[SLOT_SIZE] * wave_at(p, i, load, t);
        step_load(plan, net, load, share * net->load[L_P * plan->n_load + load],
                  share * net->load[L_Q * plan->n_load + load], memory, extra);
    }
}

/* Adds what a slot active at t asks for: switches and steps to memory, admittances to `extra`. */
static void apply_slot(const Plan *plan, const Network *net, const double *p, const int *i, double t, double *memory,
                       double *extra)
{
    if (i[SLOT_TARGET] == 0) {
        step_loads(plan, net, p, i, t, memory, extra);
        return;
    }
    const size_t n_bus = plan->n_bus, target = (size_t)i[SLOT_TARGET] - 1;
    const double share = wave_at(p, i, target, t), size = share * p[SLOT_SIZE], size_q = share * p[SLOT_SIZE_Q];

    switch (i[SLOT_KIND]) {
    case EVENT_BUS_FAULT: {
        const double z2 = p[SLOT_R] * p[SLOT_R] + p[SLOT_X] * p[SLOT_X];
        extra[target] += p[SLOT_R] / z2;
        extra[n_bus + target] -= p[SLOT_X] / z2;
        break;
    }
    case EVENT_FREQUENCY_SHED:
    case EVENT_LOAD_STEP: step_load(plan, net, target, size, size_q, memory, extra); break;
    case EVENT_SHUNT_SWITCH: { /* size 1: in, 0: out */
        const size_t bus = (size_t)net->item_bus[target];
        const double sign = (p[SLOT_SIZE] > 0.5 ? 1.0 : 0.0) - (net->item_status[target] != 0 ? 1.0 : 0.0);
        extra[bus] += sign * net->item[target];
        extra[n_bus + bus] += sign * net->item[net->n_item + target];
        break;
    }
    case EVENT_VREF_PULSE: memory[plan->vref_step + target] += size; break;
    case EVENT_PM_PULSE: memory[plan->pm_step + target] += size; break;
    case EVENT_FREQUENCY_TRIP:
    case EVENT_MACHINE_TRIP: memory[plan->running + target] = 0.0; break;
    case EVENT_DEVICE_TRIP: memory[plan->running + plan->n_machine + target] = 0.0; break;
    case EVENT_HVDC_BLOCK: {   /* a trip beside it prevails */
        double *running = memory + plan->running + plan->n_machine + target;
        if (*running > RUNNING_BLOCKED) *running = RUNNING_BLOCKED;
        break;
    }
    default: break;
    }
}

/* Set-points as the slots ask for at t. */
static void apply_steps(Block *b, const Plan *plan, const Network *net, double t)
{
    double *memory = b->memory;

    for (size_t k = 0; k < plan->n_machine; ++k) memory[plan->vref_step + k] = memory[plan->pm_step + k] = 0.0;
    for (size_t k = 0; k < plan->n_slot; ++k) {
        const double *p = slot_reals(b, plan, k);
        const int *i = slot_integers(b, plan, k);
        if (slot_sets(i[SLOT_KIND]) && p[SLOT_START] <= t && t < p[SLOT_END])
            apply_slot(plan, net, p, i, t, memory, NULL);
    }
}

/* Whether a slot that is no set-point acts at t. */
static int switches(const Block *b, const Plan *plan, size_t k, double t)
{
    const double *p = slot_reals(b, plan, k);
    const int kind = slot_integers(b, plan, k)[SLOT_KIND];

    if (kind == EVENT_NONE || slot_sets(kind)) return 0;
    if (relay_is(kind)) return b->memory[plan->relay + RELAY_ROWS * k + RELAY_OPENS] <= t;
    return p[SLOT_START] <= t && t < p[SLOT_END];
}

BlockStatus event_apply(Block *b, const Plan *plan, const Network *net, EventReach reach, double t,
                        BlockMessage *message)
{
    double *memory = b->memory, *extra = b->scratch, *work = extra + 2 * plan->n_bus;
    const size_t n_bus = plan->n_bus;
    size_t running = 0;

    apply_steps(b, plan, net, t);
    if (reach != EVENT_SWITCHES) return BLOCK_OK;
    for (size_t k = 0; k < 2 * n_bus; ++k) extra[k] = 0.0;
    for (size_t k = 0; k < plan->n_place; ++k) memory[plan->running + k] = 1.0;
    for (size_t k = 0; k < plan->n_branch; ++k)
        memory[plan->in_service + k] = branch_state(b, plan, k, net->branch_status[k], t);
    reset_ports(memory, plan, net);

    for (size_t k = 0; k < plan->n_slot; ++k) {
        if (switches(b, plan, k, t))
            apply_slot(plan, net, slot_reals(b, plan, k), slot_integers(b, plan, k), t, memory, extra);
    }
    for (size_t k = 0; k < plan->n_machine; ++k)
        if (memory[plan->running + k] > 0.5) ++running;
    memory[H_TRIPPED] = (double)(plan->n_machine - running);
    for (size_t k = plan->n_machine; k < plan->n_place; ++k) memory[H_TRIPPED] += 1.0 - memory[plan->running + k];
    if (running == 0)
        return plant_fail(message, BLOCK_ERROR, "t = %.9g s: the last machine was tripped", t);
    for (size_t k = 0; k < plan->n_port; ++k) {
        double *row = memory + plan->port + P_ROWS * k;
        const size_t first = port_is_machine(row) ? 0 : plan->n_machine;
        if (!port_is_load(row)) row[P_ON] = memory[plan->running + first + index_at(row, P_DEVICE)];
    }
    const BlockStatus status = topology_build(memory, plan, net, b->lanes, extra, work, message);
    if (status == BLOCK_OK) centre_of_inertia(memory, plan, work, work + plan->n_machine);
    return status;
}
