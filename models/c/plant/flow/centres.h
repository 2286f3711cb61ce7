#ifndef INTERAREA_CENTRES_H
#define INTERAREA_CENTRES_H
#include "../machine/machine.h"
/* Centres of inertia of the parts of the network, each at the number of its first machine: of several
 * scenarios each has parts of its own. */
#if defined PLANT_LANES && !defined PLANT_ALIKE
static inline void add_at(num *centre, real part, num v)
{
    for (size_t i = 0; i < PLANT_LANES; ++i) centre[(size_t)(ptrdiff_t)part[i]][i] += v[i];
}

static inline num value_at(const num *centre, real part)
{
    num v = NUM(0.0);
    for (size_t i = 0; i < PLANT_LANES; ++i) v[i] = centre[(size_t)(ptrdiff_t)part[i]][i];
    return v;
}
#else
static inline void add_at(num *centre, real part, num v) { centre[(size_t)(ptrdiff_t)part] += v; }
static inline num value_at(const num *centre, real part) { return centre[(size_t)(ptrdiff_t)part]; }
#endif

/* Mean of the machines' angles in each part, less those at `rest` unless that is null. */
static void find_centres(const real *memory, const Plan *plan, MachineStates states, const real *rest, num *centre)
{
    for (size_t k = 0; k < plan->n_machine; ++k) centre[k] = NUM(0.0);
    for (size_t k = 0; k < plan->n_machine; ++k) {
        const num angle = rest == NULL ? states.delta[k] : states.delta[k] - rest[k];
        add_at(centre, memory[plan->part + k], memory[plan->coi + k] * angle);
    }
}
#endif
