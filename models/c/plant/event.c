/* Events: what the slots ask for at a time, put into memory. A slot is active
 * from its start (included) to its end (excluded); the state after an event
 * follows from the time alone, so nothing has to be remembered. */
#include "event.h"

#include <math.h>

#include "failure.h"
#include "topology.h"

static const double *slot_reals(const Block *b, const Plan *plan, size_t k)
{
    return b->p + b->layout.n_p - (plan->n_slot - k) * (size_t)SLOT_REALS;
}

static const int *slot_integers(const Block *b, const Plan *plan, size_t k)
{
    return b->ip + b->layout.n_ip - (plan->n_slot - k) * (size_t)SLOT_INTEGERS;
}

static const char *kind_name(int kind)
{
    static const char *const names[EVENT_KINDS] = {
        "none", "bus_fault", "branch_trip", "branch_reclose", "vref_pulse",
        "load_step", "pm_pulse", "machine_trip", "shunt_switch"
    };
    return kind >= 0 && kind < (int)EVENT_KINDS ? names[kind] : "unknown";
}

static size_t target_count(const Plan *plan, const Network *net, int kind)
{
    switch (kind) {
    case EVENT_BUS_FAULT: return plan->n_bus;
    case EVENT_BRANCH_TRIP:
    case EVENT_BRANCH_RECLOSE: return plan->n_branch;
    case EVENT_LOAD_STEP: return plan->n_load;
    case EVENT_SHUNT_SWITCH: return net->n_item;
    default: return plan->n_machine;
    }
}

static int is_regulated(const Block *b, const Plan *plan, size_t machine)
{
    for (size_t j = 0; j < plan->n_input; ++j)
        if (index_at(b->memory + plan->input_machine, j) == machine) return 1;
    return 0;
}

BlockStatus event_check(const Block *b, const Plan *plan, const Network *net, BlockMessage *message)
{
    for (size_t k = 0; k < plan->n_slot; ++k) {
        const double *p = slot_reals(b, plan, k);
        const int *i = slot_integers(b, plan, k);
        const int kind = i[SLOT_KIND], target = i[SLOT_TARGET];

        if (kind == EVENT_NONE) continue;
        if (kind < 0 || kind >= (int)EVENT_KINDS)
            return plant_fail(message, BLOCK_ERROR, "event[%zu].kind = %d, allowed: 0 to %d",
                              k + 1, kind, (int)EVENT_KINDS - 1);
        const size_t count = target_count(plan, net, kind);
        if (target < 1 || (size_t)target > count)
            return plant_fail(message, BLOCK_ERROR, "event[%zu].target = %d for %s, allowed: 1 to %zu",
                              k + 1, target, kind_name(kind), count);
        for (size_t j = 0; j < SLOT_REALS; ++j)
            if (!(fabs(p[j]) <= 1e300))
                return plant_fail(message, BLOCK_ERROR, "event[%zu] (%s): a parameter is not a finite number",
                                  k + 1, kind_name(kind));
        if (!(p[SLOT_END] > p[SLOT_START]))
            return plant_fail(message, BLOCK_ERROR,
                              "event[%zu] (%s): end = %g s with start = %g s, allowed: end > start "
                              "(1e30 for no end)",
                              k + 1, kind_name(kind), p[SLOT_END], p[SLOT_START]);
        if (kind == EVENT_BUS_FAULT
            && (!(p[SLOT_R] >= 0.0) || !(p[SLOT_R] * p[SLOT_R] + p[SLOT_X] * p[SLOT_X] >= 1e-16)))
            return plant_fail(message, BLOCK_ERROR,
                              "event[%zu] (bus_fault): r = %g, x = %g, allowed: r >= 0 and |r + jx| >= 1e-8 pu",
                              k + 1, p[SLOT_R], p[SLOT_X]);
        if (kind == EVENT_VREF_PULSE && !is_regulated(b, plan, (size_t)target - 1)) {
            char name[64];
            return plant_fail(message, BLOCK_ERROR, "event[%zu] (vref_pulse): machine %s has no voltage regulator",
                              k + 1, plant_name(net->machine_names, (size_t)target - 1, name));
        }
    }
    return BLOCK_OK;
}

double event_next(const Block *b, const Plan *plan, double t)
{
    double next = INFINITY;
    for (size_t k = 0; k < plan->n_slot; ++k) {
        const double *p = slot_reals(b, plan, k);
        if (slot_integers(b, plan, k)[SLOT_KIND] == EVENT_NONE) continue;
        if (p[SLOT_START] > t && p[SLOT_START] < next) next = p[SLOT_START];
        if (p[SLOT_END] > t && p[SLOT_END] < next && p[SLOT_END] < 1e29) next = p[SLOT_END];
    }
    return next;
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

/* Adds what an active slot asks for: switches and steps to memory, admittances to `extra`. */
static void apply_slot(const Plan *plan, const Network *net, const double *p, const int *i, double *memory,
                       double *extra)
{
    const size_t n_bus = plan->n_bus, target = (size_t)i[SLOT_TARGET] - 1;

    switch (i[SLOT_KIND]) {
    case EVENT_BUS_FAULT: {
        const double z2 = p[SLOT_R] * p[SLOT_R] + p[SLOT_X] * p[SLOT_X];
        extra[target] += p[SLOT_R] / z2;
        extra[n_bus + target] -= p[SLOT_X] / z2;
        break;
    }
    case EVENT_LOAD_STEP: {   /* size + j size_q at the load's operating voltage, of its characteristic */
        const size_t bus = (size_t)net->load_bus[target];
        const double v = net->load[L_V0 * plan->n_load + target];
        extra[bus] += p[SLOT_SIZE] / (v * v);
        extra[n_bus + bus] -= p[SLOT_SIZE_Q] / (v * v);
        step_load_port(memory, plan, target, p[SLOT_SIZE], p[SLOT_SIZE_Q]);
        break;
    }
    case EVENT_SHUNT_SWITCH: { /* size 1: in, 0: out */
        const size_t bus = (size_t)net->item_bus[target];
        const double sign = (p[SLOT_SIZE] > 0.5 ? 1.0 : 0.0) - (net->item_status[target] != 0 ? 1.0 : 0.0);
        extra[bus] += sign * net->item[target];
        extra[n_bus + bus] += sign * net->item[net->n_item + target];
        break;
    }
    case EVENT_VREF_PULSE: memory[plan->vref_step + target] += p[SLOT_SIZE]; break;
    case EVENT_PM_PULSE: memory[plan->pm_step + target] += p[SLOT_SIZE]; break;
    case EVENT_MACHINE_TRIP: memory[plan->running + target] = 0.0; break;
    default: break;
    }
}

BlockStatus event_apply(Block *b, const Plan *plan, const Network *net, double t, BlockMessage *message)
{
    double *memory = b->memory, *extra = b->scratch, *work = extra + 2 * plan->n_bus;
    const size_t n_bus = plan->n_bus;
    size_t running = 0;

    for (size_t k = 0; k < 2 * n_bus; ++k) extra[k] = 0.0;
    for (size_t k = 0; k < plan->n_machine; ++k) {
        memory[plan->running + k] = 1.0;
        memory[plan->vref_step + k] = memory[plan->pm_step + k] = 0.0;
    }
    for (size_t k = 0; k < plan->n_branch; ++k)
        memory[plan->in_service + k] = branch_state(b, plan, k, net->branch_status[k], t);
    reset_ports(memory, plan, net);

    for (size_t k = 0; k < plan->n_slot; ++k) {
        const double *p = slot_reals(b, plan, k);
        const int *i = slot_integers(b, plan, k);
        if (i[SLOT_KIND] == EVENT_NONE || !(p[SLOT_START] <= t) || !(t < p[SLOT_END])) continue;
        apply_slot(plan, net, p, i, memory, extra);
    }
    for (size_t k = 0; k < plan->n_machine; ++k)
        if (memory[plan->running + k] > 0.5) ++running;
    memory[H_TRIPPED] = (double)(plan->n_machine - running);
    if (running == 0)
        return plant_fail(message, BLOCK_ERROR, "t = %.9g s: the last machine was tripped", t);
    for (size_t k = 0; k < plan->n_port; ++k) {
        double *row = memory + plan->port + P_ROWS * k;
        if (!port_is_load(row)) row[P_ON] = memory[plan->running + index_at(row, P_DEVICE)];
    }
    const BlockStatus status = topology_build(memory, plan, net, extra, work, message);
    if (status == BLOCK_OK) centre_of_inertia(memory, plan, work, work + plan->n_machine);
    return status;
}
