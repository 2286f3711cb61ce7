/* One Runge-Kutta step, the outputs and the rates of PLANT_LANES scenarios (batch.h). */
#include "flow.h"
#include "batch.h"

static num *lanes_of(double *a) { return (num *)(void *)a; }

/* solver_inputs of the FMU; `at`: 0 begin, 1 middle, 2 end of the step. */
static void stage_inputs(const BlockGroup *g, size_t at)
{
    if (g->u_poly == NULL) return;
    const num elapsed = ((const num *)(const void *)g->elapsed)[at], *p = (const num *)(const void *)g->u_poly;
    num *u = lanes_of(g->u);

    for (size_t i = 0; i < g->layout->n_u; ++i, p += 4)
        u[i] = p[0] + elapsed * (p[1] + elapsed / 2.0 * (p[2] + elapsed / 3.0 * p[3]));
}

void BATCH_STEP(const BlockGroup *g)
{
    const size_t n = g->layout->n_x;
    num *memory = lanes_of(g->memory), *x = lanes_of(g->x), *u = lanes_of(g->u), *scratch = lanes_of(g->scratch);
    num *k1 = lanes_of(g->k), *k2 = k1 + n, *k3 = k2 + n, *k4 = k3 + n, *at = k4 + n;
    const num h = *lanes_of(g->h);

    stage_inputs(g, 0);
    (void)NAME(plant_flow)(memory, x, u, k1, scratch);
    for (size_t i = 0; i < n; ++i) at[i] = x[i] + h / 2.0 * k1[i];
    stage_inputs(g, 1);
    (void)NAME(plant_flow)(memory, at, u, k2, scratch);
    for (size_t i = 0; i < n; ++i) at[i] = x[i] + h / 2.0 * k2[i];
    (void)NAME(plant_flow)(memory, at, u, k3, scratch);
    for (size_t i = 0; i < n; ++i) at[i] = x[i] + h * k3[i];
    stage_inputs(g, 2);
    (void)NAME(plant_flow)(memory, at, u, k4, scratch);
    flag runs;   /* lane by lane: gcc 12 cannot compile the comparison of vectors here */
    for (size_t i = 0; i < PLANT_LANES; ++i) runs[i] = h[i] > 0.0 ? -1 : 0;
    for (size_t i = 0; i < n; ++i)
        x[i] = num_pick(runs, x[i] + h / 6.0 * (k1[i] + 2.0 * (k2[i] + k3[i]) + k4[i]), x[i]);
}

void BATCH_OUTPUTS(const BlockGroup *g)
{
    (void)NAME(plant_outputs)(lanes_of(g->memory), lanes_of(g->x), lanes_of(g->y), lanes_of(g->scratch));
}

void BATCH_RATES(const BlockGroup *g)
{
    (void)NAME(plant_flow)(lanes_of(g->memory), lanes_of(g->x), lanes_of(g->u), lanes_of(g->k),
                           lanes_of(g->scratch));
}
