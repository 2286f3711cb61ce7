/* One Runge-Kutta step, the outputs and the rates of PLANT_LANES plants (lanes_steps.h). */
#include "flow.h"
#include "lanes_steps.h"
#define RK_NUM num
#define RK_MOVED(h, moved, x) keep_idle(h, moved, x)
static inline num keep_idle(num h, num moved, num x)
{
    flag runs;   /* lane by lane: gcc 12 cannot compile the comparison of vectors here */
    for (size_t i = 0; i < PLANT_LANES; ++i) runs[i] = h[i] > 0.0 ? -1 : 0;
    return num_pick(runs, moved, x);
}
#include "../block/runge_kutta.h"

static num *lanes_of(double *a) { return (num *)(void *)a; }

static const int32_t *places_of(const BlockGroup *g)
{
    return plant_places(g->record, g->memory[H_PATTERN * PLANT_LANES]);
}

/* solver_inputs of the FMU; `at`: 0 begin, 1 middle, 2 end of the step. */
static void stage_inputs(const BlockGroup *g, size_t at)
{
    if (g->u_poly == NULL) return;
    const num elapsed = ((const num *)(const void *)g->elapsed)[at], *p = (const num *)(const void *)g->u_poly;
    num *u = lanes_of(g->u);

    for (size_t i = 0; i < g->layout->n_u; ++i, p += 4)
        u[i] = p[0] + elapsed * (p[1] + elapsed / 2.0 * (p[2] + elapsed / 3.0 * p[3]));
}

static BlockStatus lane_flow(void *context, RungeKuttaStage stage, const num *x, num *k)
{
    const BlockGroup *g = context;

    if (stage != RK_MIDDLE_AGAIN) stage_inputs(g, stage == RK_BEGIN ? 0 : stage == RK_END ? 2 : 1);
    (void)NAME(plant_flow)(lanes_of(g->memory), places_of(g), 0, x, lanes_of(g->u), k, lanes_of(g->scratch));
    return BLOCK_OK;
}

void LANES_STEP(const BlockGroup *g)
{
    BlockGroup context = *g;

    (void)runge_kutta_step(lane_flow, &context, g->layout->n_x, *lanes_of(g->h), lanes_of(g->x), lanes_of(g->k));
}

void LANES_OUTPUTS(const BlockGroup *g)
{
    (void)NAME(plant_outputs)(lanes_of(g->memory), places_of(g), 0, lanes_of(g->x), lanes_of(g->y), lanes_of(g->scratch));
}

void LANES_RATES(const BlockGroup *g)
{
    (void)NAME(plant_flow)(lanes_of(g->memory), places_of(g), 0, lanes_of(g->x), lanes_of(g->u), lanes_of(g->k),
                           lanes_of(g->scratch));
}
