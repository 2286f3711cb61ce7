#ifndef INTERAREA_GOVERNOR_H
#define INTERAREA_GOVERNOR_H
#include "governor_steam.h"
#include "governor_tgov1.h"

/* Mechanical power of all machines; constant where there is no governor. A step
 * of Pm acts on the load reference of a governed machine. */
static inline void governor_all(const real *memory, const Plan *plan, const num *slip,
                                const num *x, num *dx, num *pm)
{
    const size_t n = plan->n_governor;
    const real *of = memory + plan->governor_of;

    for (size_t k = 0; k < plan->n_machine; ++k)
        pm[k] = NUM(memory[plan->machine + M_PM0 * plan->n_machine + k] + memory[plan->pm_step + k]);
    for (size_t k = 0; k < n; ++k) {
        const real *p = memory + plan->governor + k;
        const size_t machine = index_at(of, n + k), state = index_at(of, 2 * n + k);
        pm[machine] = index_at(of, k) == GOVERNOR_TGOV1
            ? governor_tgov1(p, n, pm[machine], slip[machine], x + state, dx + state)
            : governor_steam(p, n, pm[machine], slip[machine], x + state, dx + state);
    }
}
#endif
