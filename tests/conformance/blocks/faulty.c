/* dx/dt = u - x, y = x, with a fault of behaviour that the parameter `fault` picks: what the run-time
 * part of `interarea check` must find. Nothing here is an example to follow. */
#include <math.h>
#include <stdlib.h>

#include "block.h"

const int block_is_sampled = 0;

enum {
    SOUND, CRASHES, HANGS, EXITS, GLOBAL_COUNTER, HIDDEN_STATE, WRONG_DERIVATIVE, HIDDEN_INPUT, COUNTS_STEPS
};

static double counter, hidden;

BlockStatus block_needs(const Record *record, const BlockLayout *n, BlockNeeds *needs, BlockMessage *message)
{
    (void)record, (void)n, (void)message;
    needs->n_memory = 1;
    needs->n_scratch = 0;
    return BLOCK_OK;
}

BlockStatus block_start(Block *b, double t, BlockMessage *message)
{
    (void)t, (void)message;
    if (b->ip[0] == CRASHES) abort();
    hidden = 0.0;
    return BLOCK_OK;
}

BlockStatus block_derivatives(Block *b, double t, const double *x, const double *u, double *dx,
                              BlockMessage *message)
{
    (void)message;
    while (b->ip[0] == HANGS && t > 0.15)
        if (getenv("NEVER_SET_BY_ANYONE") != NULL) break;
    if (b->ip[0] == EXITS && t > 0.15) exit(3);
    dx[0] = u[0] - x[0];
    return BLOCK_OK;
}

BlockStatus block_outputs(Block *b, double t, const double *x, const double *u, double *y, BlockMessage *message)
{
    (void)t, (void)message;
    y[0] = x[0];
    switch (b->ip[0]) {
    case GLOBAL_COUNTER: y[0] += 0.01 * ++counter; break;
    case HIDDEN_STATE: y[0] += 0.01 * ++hidden; break;
    case HIDDEN_INPUT: y[0] += 0.1 * u[0]; break;
    case COUNTS_STEPS: y[0] += 0.01 * ++b->memory[0]; break;
    default: break;
    }
    return BLOCK_OK;
}

BlockStatus block_directional(Block *b, double t, const double *x, const double *u, const double *vx,
                              const double *vu, double *vdx, double *vy, BlockMessage *message)
{
    (void)t, (void)x, (void)u, (void)message;
    if (vdx != NULL) vdx[0] = vu[0] - (b->ip[0] == WRONG_DERIVATIVE ? 1.01 : 1.0) * vx[0];
    if (vy != NULL) vy[0] = vx[0];
    return BLOCK_OK;
}

double block_next_event(const Block *b, double t)
{
    (void)b, (void)t;
    return INFINITY;
}

BlockStatus block_event(Block *b, double t, double *x, BlockMessage *message)
{
    (void)b, (void)t, (void)x, (void)message;
    return BLOCK_OK;
}

BlockStatus block_step(Block *b, double t, double h, const double *u_poly, double *dy, BlockMessage *message)
{
    (void)b, (void)t, (void)h, (void)u_poly, (void)dy, (void)message;
    return BLOCK_ERROR;
}
