/* One Runge-Kutta step and the outputs of PLANT_LANES scenarios (batch.h). */
#include "flow.h"
#include "batch.h"

static num *lanes_of(double *a) { return (num *)(void *)a; }

void BATCH_STEP(const BatchGroup *g)
{
    const size_t n = g->layout->n_x;
    num *memory = lanes_of(g->memory), *x = lanes_of(g->x), *u = lanes_of(g->u), *scratch = lanes_of(g->scratch);
    num *k1 = lanes_of(g->k), *k2 = k1 + n, *k3 = k2 + n, *k4 = k3 + n, *at = k4 + n;
    const num h = *lanes_of(g->h);

    (void)NAME(plant_flow)(memory, x, u, k1, scratch);
    for (size_t i = 0; i < n; ++i) at[i] = x[i] + h / 2.0 * k1[i];
    (void)NAME(plant_flow)(memory, at, u, k2, scratch);
    for (size_t i = 0; i < n; ++i) at[i] = x[i] + h / 2.0 * k2[i];
    (void)NAME(plant_flow)(memory, at, u, k3, scratch);
    for (size_t i = 0; i < n; ++i) at[i] = x[i] + h * k3[i];
    (void)NAME(plant_flow)(memory, at, u, k4, scratch);
    const flag runs = num_above(h, NUM(0.0));
    for (size_t i = 0; i < n; ++i)
        x[i] = num_pick(runs, x[i] + h / 6.0 * (k1[i] + 2.0 * (k2[i] + k3[i]) + k4[i]), x[i]);
}

void BATCH_OUTPUTS(const BatchGroup *g)
{
    (void)NAME(plant_outputs)(lanes_of(g->memory), lanes_of(g->x), lanes_of(g->y), lanes_of(g->scratch));
}
