/* Classical Runge-Kutta of order 4 with a whole number of equal substeps
 * between communication points and events. The substeps depend only on the
 * interval, so a run that is saved, restored and continued gives the same bits. */
#include <math.h>
#include <stdio.h>
#include <string.h>

#include "instance.h"

void solver_inputs(const Instance *c, double elapsed, double *u)
{
    for (size_t i = 0; i < c->block.layout.n_u; ++i) {
        const double *p = c->u_poly + 4 * i;
        u[i] = p[0] + elapsed * (p[1] + elapsed / 2.0 * (p[2] + elapsed / 3.0 * p[3]));
    }
}

static BlockStatus runge_kutta_step(Instance *c, double begin, double t, double h,
                                    BlockMessage *message)
{
    Block *b = &c->block;
    const size_t n = b->layout.n_x;
    double *k1 = c->work, *k2 = k1 + n, *k3 = k2 + n, *k4 = k3 + n, *x = k4 + n, *u = x + n;
    BlockStatus status;

    solver_inputs(c, t - begin, u);
    if ((status = block_derivatives(b, t, b->x, u, k1, message)) != BLOCK_OK) return status;

    for (size_t i = 0; i < n; ++i) x[i] = b->x[i] + h / 2.0 * k1[i];
    solver_inputs(c, t + h / 2.0 - begin, u);
    if ((status = block_derivatives(b, t + h / 2.0, x, u, k2, message)) != BLOCK_OK) return status;

    for (size_t i = 0; i < n; ++i) x[i] = b->x[i] + h / 2.0 * k2[i];
    if ((status = block_derivatives(b, t + h / 2.0, x, u, k3, message)) != BLOCK_OK) return status;

    for (size_t i = 0; i < n; ++i) x[i] = b->x[i] + h * k3[i];
    solver_inputs(c, t + h - begin, u);
    if ((status = block_derivatives(b, t + h, x, u, k4, message)) != BLOCK_OK) return status;

    for (size_t i = 0; i < n; ++i)
        b->x[i] += h / 6.0 * (k1[i] + 2.0 * (k2[i] + k3[i]) + k4[i]);
    return BLOCK_OK;
}

static BlockStatus integrate(Instance *c, double begin, double from, double to, BlockMessage *message)
{
    const double length = to - from;
    const double wanted = ceil(length / *c->internal_step - 1e-9);
    const long count = wanted < 1.0 ? 1 : (long)wanted;

    for (long k = 0; k < count; ++k) {
        const double t = from + length * ((double)k / (double)count);
        const BlockStatus status = runge_kutta_step(c, begin, t, length / (double)count, message);
        if (status != BLOCK_OK) return status;
    }
    return BLOCK_OK;
}

BlockStatus solver_advance(Instance *c, double begin, double end, BlockMessage *message)
{
    Block *b = &c->block;
    RunState *run = c->run;
    /* An event this close to the end counts as reached: masters round. */
    const double slack = 1e-9 * (end - begin);

    for (long n_events = 0;; ++n_events) {
        const double after = run->last_event > run->time ? run->last_event : run->time;
        const double event = block_next_event(b, after);
        const int reached = event <= end + slack;
        const double stop = reached && event < end ? event : end;
        BlockStatus status;

        if (stop > run->time && b->layout.n_x > 0
            && (status = integrate(c, begin, run->time, stop, message)) != BLOCK_OK)
            return status;
        if (stop > run->time) run->time = stop;
        if (!reached) return BLOCK_OK;
        if (!(event > after) || n_events > SOLVER_MAX_SUBSTEPS) {
            snprintf(message->text, sizeof message->text,
                     "time %.17g: the next event at %.17g does not lie ahead", after, event);
            return BLOCK_ERROR;
        }
        solver_inputs(c, stop - begin, b->u);
        instance_log_event(c, "event at time %.9g s", event);
        ++c->memory_written;
        if ((status = block_event(b, event, b->x, message)) != BLOCK_OK) return status;
        run->last_event = event;
    }
}
