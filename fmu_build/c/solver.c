/* A co-simulation step: the block integrated over it, its events handled on the way. */
#include <stdio.h>
#include <string.h>

#include "solver.h"
#include "stretch.h"

void solver_inputs(const Instance *c, double elapsed, double *u)
{
    for (size_t i = 0; i < c->block.layout.n_u; ++i) {
        const double *p = c->u_poly + 4 * i;
        u[i] = p[0] + elapsed * (p[1] + elapsed / 2.0 * (p[2] + elapsed / 3.0 * p[3]));
    }
}

typedef struct {
    Instance *c;
    double begin, t, h;     /* of the communication step; of the Runge-Kutta step */
    double *u;
    BlockMessage *message;
} Flow;

static BlockStatus flow(void *context, RungeKuttaStage stage, const double *x, double *k)
{
    const Flow *f = context;
    const double t = stage == RK_BEGIN ? f->t : stage == RK_END ? f->t + f->h : f->t + f->h / 2.0;

    if (stage != RK_MIDDLE_AGAIN) solver_inputs(f->c, t - f->begin, f->u);
    return block_derivatives(&f->c->block, t, x, f->u, k, f->message);
}

static BlockStatus integrate(Instance *c, Stretch *s, BlockMessage *message)
{
    const size_t n = c->block.layout.n_x;
    Flow f = {c, s->begin, 0.0, stretch_h(s), c->work + 5 * n, message};

    for (; s->done < s->count; ++s->done) {
        f.t = stretch_t(s);
        const BlockStatus status = runge_kutta_step(flow, &f, n, f.h, c->block.x, c->work);
        if (status != BLOCK_OK) return status;
    }
    return BLOCK_OK;
}

BlockStatus solver_advance(Instance *c, double begin, double end, BlockMessage *message)
{
    Block *b = &c->block;
    RunState *run = c->run;
    Stretch s = {.begin = begin, .end = end, .longest = *c->internal_step};
    BlockStatus status;

    for (;;) {
        s.time = run->time;
        s.last_event = run->last_event;
        if (!stretch_next(&s, b)) {
            snprintf(message->text, sizeof message->text,
                     "time %.17g: the next event does not lie ahead, or they are more than %d",
                     stretch_after(&s), STRETCH_MOST_EVENTS);
            return BLOCK_ERROR;
        }
        if (b->layout.n_x > 0 && (status = integrate(c, &s, message)) != BLOCK_OK) return status;
        if (s.to > run->time) run->time = s.to;
        if (!(s.event < INFINITY)) return BLOCK_OK;
        solver_inputs(c, s.to - begin, b->u);
        instance_log_event(c, "event at time %.9g s", s.event);
        ++c->memory_written;
        if ((status = block_event(b, s.event, b->x, message)) != BLOCK_OK) return status;
        run->last_event = s.event;
    }
}
