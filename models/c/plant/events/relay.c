/* Frequency relays: what they see, when they pick up and when their breakers open (relay.h). */
#include "relay.h"

#include <math.h>

#include "../start/failure.h"
#include "../flow/physics.h"

static const double LOOK_S = 0.005, RELAY_LEAST_V = 0.3, TURN = 6.28318530717958648;

static double *state_of(double *memory, const Plan *plan, size_t slot)
{
    return memory + plan->relay + RELAY_ROWS * slot;
}

static double rated_hz(const double *memory) { return memory[H_OMEGA_B] / TURN; }

/* In use at t and not opened yet. */
static int in_use(const Block *b, const Plan *plan, size_t k, double t)
{
    const double *p = slot_reals(b, plan, k);
    return relay_is(slot_integers(b, plan, k)[SLOT_KIND]) && t < p[SLOT_END]
           && !(state_of(b->memory, plan, k)[RELAY_OPENS] < INFINITY);
}

BlockStatus relay_check(const Block *b, const double *p, size_t slot, const char *kind, BlockMessage *message)
{
    const double rated = rated_hz(b->memory), threshold = p[SLOT_THRESHOLD];

    if (!(threshold > 0.0 && threshold < 2.0 * rated && fabs(threshold - rated) > 1e-9 * rated))
        return plant_fail(message, BLOCK_ERROR,
                          "event[%zu] (%s): threshold = %g Hz, allowed: 0 to %g, not %g", slot + 1, kind, threshold,
                          2.0 * rated, rated);
    if (!(p[SLOT_DELAY] >= 0.0) || !(p[SLOT_BREAKER] >= 0.0) || !(p[SLOT_FILTER] >= 0.0))
        return plant_fail(message, BLOCK_ERROR,
                          "event[%zu] (%s): delay = %g s, breaker = %g s, filter = %g s, allowed: at least 0",
                          slot + 1, kind, p[SLOT_DELAY], p[SLOT_BREAKER], p[SLOT_FILTER]);
    return BLOCK_OK;
}

static void forget(double *s)
{
    s[RELAY_TIME] = -INFINITY;
    s[RELAY_ANGLE] = 0.0;
    s[RELAY_FREQUENCY] = 1.0;
    s[RELAY_SINCE] = s[RELAY_OPENS] = INFINITY;
}

void relay_start(double *memory, const Plan *plan)
{
    for (size_t k = 0; k < plan->n_slot; ++k) forget(state_of(memory, plan, k));
}

static int any_in_use(const Block *b, const Plan *plan, double t)
{
    for (size_t k = 0; k < plan->n_slot; ++k)
        if (in_use(b, plan, k, t)) return 1;
    return 0;
}

int relay_looks(const Block *b, const Plan *plan, double t)
{
    return any_in_use(b, plan, t) && floor(t / LOOK_S + 0.5) * LOOK_S == t;
}

double relay_next(const Block *b, const Plan *plan, double t)
{
    double next = INFINITY;

    if (any_in_use(b, plan, t)) {
        const double k = floor(t / LOOK_S);
        next = k * LOOK_S > t ? k * LOOK_S : (k + 1.0) * LOOK_S > t ? (k + 1.0) * LOOK_S : (k + 2.0) * LOOK_S;
    }
    for (size_t k = 0; k < plan->n_slot; ++k) {
        const double opens = state_of(b->memory, plan, k)[RELAY_OPENS];
        if (relay_is(slot_integers(b, plan, k)[SLOT_KIND]) && opens > t && opens < next) next = opens;
    }
    return next;
}

static size_t bus_of(const Network *net, const int *i)
{
    const size_t target = (size_t)i[SLOT_TARGET] - 1;
    return (size_t)(i[SLOT_KIND] == EVENT_FREQUENCY_SHED ? net->load_bus[target] : net->machine_bus[target]);
}

/* One relay at t, where the voltage is re + j im in the frame that turns with rated frequency. */
static void look(const Block *b, const double *p, double *s, double re, double im, double t)
{
    const double since = t - s[RELAY_TIME], omega = b->memory[H_OMEGA_B], rated = rated_hz(b->memory);
    const double angle = num_angle(im, re), before = s[RELAY_ANGLE];
    const double threshold = p[SLOT_THRESHOLD] / rated;

    s[RELAY_ANGLE] = angle;
    s[RELAY_TIME] = t;
    if (!(re * re + im * im >= RELAY_LEAST_V * RELAY_LEAST_V)) {   /* it does not know what it sees */
        s[RELAY_TIME] = -INFINITY;
        s[RELAY_FREQUENCY] = 1.0;
        s[RELAY_SINCE] = INFINITY;
        return;
    }
    if (!(since < INFINITY)) return;
    const double turned = angle - before, whole = floor(turned / TURN + 0.5);
    const double seen = 1.0 + (turned - TURN * whole) / (omega * since);
    const double decay = p[SLOT_FILTER] > 0.0 ? real_exp(-since / p[SLOT_FILTER]) : 0.0;
    s[RELAY_FREQUENCY] = seen + decay * (s[RELAY_FREQUENCY] - seen);
    const double beyond = threshold < 1.0 ? threshold - s[RELAY_FREQUENCY] : s[RELAY_FREQUENCY] - threshold;
    if (!(beyond > 0.0) || t < p[SLOT_START]) {
        s[RELAY_SINCE] = INFINITY;
        return;
    }
    if (!(s[RELAY_SINCE] < INFINITY)) s[RELAY_SINCE] = t;
    if (t - s[RELAY_SINCE] >= p[SLOT_DELAY] - 1e-9) s[RELAY_OPENS] = t + p[SLOT_BREAKER];
}

size_t relay_work(const Plan *plan) { return flow_work(plan) + 2 * plan->n_bus; }

size_t relay_look(Block *b, const Plan *plan, const Network *net, const double *x, double t)
{
    double *volts = b->scratch + flow_work(plan);

    for (size_t k = 0; k < plan->n_slot; ++k)   /* a slot that was given another kind */
        if (!relay_is(slot_integers(b, plan, k)[SLOT_KIND])) forget(state_of(b->memory, plan, k));
    if (!relay_looks(b, plan, t)) return 0;
    const size_t stuck = plant_voltages(b->memory, net->places, b->lanes, x, volts, b->scratch);
    if (stuck > 0) return stuck;
    for (size_t k = 0; k < plan->n_slot; ++k) {
        const int *i = slot_integers(b, plan, k);
        if (!in_use(b, plan, k, t)) continue;
        const size_t bus = bus_of(net, i);
        look(b, slot_reals(b, plan, k), state_of(b->memory, plan, k), volts[bus], volts[plan->n_bus + bus], t);
    }
    return 0;
}

void relay_tell(const Block *b, const Plan *plan, const Network *net, double t, BlockMessage *message)
{
    for (size_t k = 0; k < plan->n_slot; ++k) {
        const double *s = state_of(b->memory, plan, k);
        const int *i = slot_integers(b, plan, k);
        char name[64];
        if (!relay_is(i[SLOT_KIND]) || s[RELAY_OPENS] != t || message->text[0] != '\0') continue;
        (void)plant_fail(message, BLOCK_OK, "event[%zu]: relay at bus %s opens its breaker: frequency %.4g Hz for %g s",
                         k + 1, plant_name(net->bus_names, bus_of(net, i), name),
                         s[RELAY_FREQUENCY] * rated_hz(b->memory), slot_reals(b, plan, k)[SLOT_DELAY]);
    }
}
