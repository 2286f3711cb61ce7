/* One Runge-Kutta step, the outputs and the rates of PLANT_LANES plants (lanes_steps.h). */
#include "../flow/flow.h"
#include "lanes_steps.h"
#define RK_NUM num
#define RK_MOVED(h, moved, x) keep_idle(h, moved, x)
static inline num keep_idle(num h, num moved, num x)
{
    flag runs;   /* lane by lane: gcc 12 cannot compile the comparison of vectors here */
    for (size_t i = 0; i < PLANT_LANES; ++i) runs[i] = h[i] > 0.0 ? -1 : 0;
    return num_pick(runs, moved, x);
}
#include "../../block/runge_kutta.h"

static num *lanes_of(double *a) { return (num *)(void *)a; }

#ifdef PLANT_ALIKE   /* one memory for all: a PLANT_LANES-th of what there is to read */
static real *memory_of(const BlockGroup *g) { return g->shared; }
#else
static real *memory_of(const BlockGroup *g) { return lanes_of(g->memory); }
#endif

static const int32_t *places_of(const BlockGroup *g)
{
    return plant_places(g->record, first_at(memory_of(g), H_PATTERN));
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

/* What the ports keep, at a time of the step: begin, middle or end. Only lanes that run bring it up to date. */
static Warm stage_warm(const BlockGroup *g, size_t at, flag runs)
{
    num *warm = lanes_of(g->warm);
    if (g->n_warm > 0) warm[W_TIME] = *(const num *)(const void *)g->begin + ((const num *)(const void *)g->elapsed)[at];
    return (Warm){ warm, runs };
}

static BlockStatus lane_flow(void *context, RungeKuttaStage stage, num h, const num *x, num *k)
{
    const BlockGroup *g = context;
    const Notes notes = { lanes_of(g->notes), stage == RK_BEGIN ? NULL : lanes_of(g->switched), NULL, NULL, NULL, 0, 0, 1 + (int)stage };
    const size_t at = stage == RK_BEGIN ? 0 : stage == RK_END ? 2 : 1;
    const Warm warm = stage_warm(g, at, num_above(h, NUM(0.0)));

    if (stage != RK_MIDDLE_AGAIN) stage_inputs(g, at);
    (void)NAME(plant_flow)(memory_of(g), places_of(g), 0, x, lanes_of(g->u), k, lanes_of(g->scratch), notes, &warm);
    return BLOCK_OK;
}

void LANES_STEP(const BlockGroup *g)
{
    BlockGroup context = *g;
    num *switched = lanes_of(g->switched), *x = lanes_of(g->x), *k = lanes_of(g->k), h = *lanes_of(g->h);

    *switched = NUM(0.0);
    (void)runge_kutta_stages(lane_flow, &context, g->layout->n_x, h, x, k);
    h = num_pick(num_above(*switched, NUM(0.0)), NUM(0.0), h);
    runge_kutta_move(g->layout->n_x, h, x, k);
}

void LANES_OUTPUTS(const BlockGroup *g)
{
    const Warm warm = stage_warm(g, 0, num_above(NUM(0.0), NUM(1.0)));
    (void)NAME(plant_outputs)(memory_of(g), places_of(g), 0, lanes_of(g->x), lanes_of(g->y), lanes_of(g->scratch), &warm);
}

void LANES_RATES(const BlockGroup *g)
{
    const Warm warm = stage_warm(g, 0, num_above(NUM(0.0), NUM(1.0)));
    (void)NAME(plant_flow)(memory_of(g), places_of(g), 0, lanes_of(g->x), lanes_of(g->u), lanes_of(g->k),
                           lanes_of(g->scratch), NO_NOTES, &warm);
}
