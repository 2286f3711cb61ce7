/* A co-simulation step: the block integrated over it, its events handled on the way. */
#include <stdio.h>
#include <string.h>

#include "limited_step.h"
#include "solver.h"

void solver_inputs(const Instance *c, double elapsed, double *u)
{
    for (size_t i = 0; i < c->block.layout.n_u; ++i) {
        const double *p = c->u_poly + 4 * i;
        u[i] = p[0] + elapsed * (p[1] + elapsed / 2.0 * (p[2] + elapsed / 3.0 * p[3]));
    }
}

typedef struct {
    Instance *c;
    double begin, elapsed;   /* of the communication step; of the Runge-Kutta step in it */
    double *u;
    BlockMessage *message;
} Flow;

static BlockStatus flow(void *context, double into, BlockLimits *limits, const double *x, double *k)
{
    const Flow *f = context;
    const double elapsed = f->elapsed + into;
    Block *b = &f->c->block;

    solver_inputs(f->c, elapsed, f->u);
    b->limits = limits;
    const BlockStatus status = block_derivatives(b, f->begin + elapsed, x, f->u, k, f->message);
    b->limits = NULL;
    return status;
}

/* What the run may still spend on finding switches, and room for it. */
static LimitedRun run_of(const Instance *c)
{
    return (LimitedRun){c->run->start_time, &c->run->switches_cost, c->overruns, c->n_decisions};
}

static Flow flow_of(Instance *c, const Stretch *s, BlockMessage *message)
{
    return (Flow){c, s->begin, stretch_elapsed(s), c->work + SOLVER_ARRAYS * c->block.layout.n_x, message};
}

BlockStatus solver_step(Instance *c, const Stretch *s, double *x, BlockMessage *message)
{
    Flow f = flow_of(c, s, message);
    const LimitedRun run = run_of(c);

    return limited_step(flow, &f, c->block.layout.n_x, f.begin + f.elapsed, stretch_h(s), x, c->work, &run, message);
}

int solver_affords(const Instance *c, const Stretch *s)
{
    const LimitedRun run = run_of(c);
    return limited_affords(&run, s->begin + stretch_elapsed(s), stretch_h(s));
}

BlockStatus solver_switched(Instance *c, const Stretch *s, double *x, BlockMessage *message)
{
    Flow f = flow_of(c, s, message);
    const LimitedRun run = run_of(c);
    LimitedStep step = limited_of(flow, &f, c->block.layout.n_x, f.begin + f.elapsed, c->work, message);

    return limited_switched(&step, stretch_h(s), x, &run);
}

static BlockStatus integrate(Instance *c, Stretch *s, BlockMessage *message)
{
    for (; s->done < s->count; ++s->done) {
        const BlockStatus status = solver_step(c, s, c->block.x, message);
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
        instance_undo_event(c);
        if ((status = block_event(b, s.event, b->x, message)) != BLOCK_OK) return status;
        instance_remark(c, message);
        run->last_event = s.last_event = s.event;
    }
}
