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
    double begin, elapsed, h;   /* of the communication step; of the Runge-Kutta step in it */
    double *u;
    BlockMessage *message;
} Flow;

static BlockStatus flow(void *context, RungeKuttaStage stage, const double *x, double *k)
{
    const Flow *f = context;
    const double elapsed = f->elapsed + (stage == RK_BEGIN ? 0.0 : stage == RK_END ? f->h : f->h / 2.0);

    if (stage != RK_MIDDLE_AGAIN) solver_inputs(f->c, elapsed, f->u);
    return block_derivatives(&f->c->block, f->begin + elapsed, x, f->u, k, f->message);
}

static BlockStatus integrate(Instance *c, Stretch *s, BlockMessage *message)
{
    const size_t n = c->block.layout.n_x;
    Flow f = {c, s->begin, 0.0, stretch_h(s), c->work + 5 * n, message};

    for (; s->done < s->count; ++s->done) {
        f.elapsed = stretch_elapsed(s);
        const BlockStatus status = runge_kutta_step(flow, &f, n, f.h, c->block.x, c->work);
        if (status != BLOCK_OK) return status;
    }
    return BLOCK_OK;
}

BlockStatus solver_advance(Instance *c, double stop, double length, BlockMessage *message)
{
    Block *b = &c->block;
    RunState *run = c->run;
    Stretch s = stretch_begin(run->time, stop, length, *c->internal_step, run->last_event);
    BlockStatus status;

    for (;;) {
        if (!stretch_next(&s, b)) {
            snprintf(message->text, sizeof message->text,
                     "time %.17g: the next event does not lie ahead, or they are more than %d",
                     stretch_after(&s), STRETCH_MOST_EVENTS);
            return BLOCK_ERROR;
        }
        if (b->layout.n_x > 0 && (status = integrate(c, &s, message)) != BLOCK_OK) return status;
        if (s.end > run->time) run->time = s.time = s.end;
        if (!(s.event < INFINITY)) return BLOCK_OK;
        solver_inputs(c, s.to, b->u);
        instance_log_event(c, "event at time %.9g s", s.event);
        ++c->memory_written;
        if ((status = block_event(b, s.event, b->x, message)) != BLOCK_OK) return status;
        instance_remark(c, message);
        run->last_event = s.last_event = s.event;
    }
}
