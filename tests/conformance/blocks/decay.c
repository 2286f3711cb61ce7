/* dx/dt = -rate x + u, y = x; at each kick x jumps by its size. A step in which
 * x exceeds `ceiling` cannot be computed. Made to test the FMI layer. */
#include <math.h>
#include <stdio.h>

#include "../../../models/c/block/block.h"

const int block_is_sampled = 0;

enum { RATE, CEILING, KICK_TIME, KICK_SIZE };

BlockStatus block_needs(const Record *record, const BlockLayout *n, BlockNeeds *needs, BlockMessage *message)
{
    (void)record;
    needs->n_memory = 1; /* kicks so far */
    needs->n_scratch = 0;
    if (n->n_x == 1 && n->n_u == 1 && n->n_y == 1 && n->n_w == 1 && n->n_p == 4 && n->n_iy == 1 && n->n_ip == 1)
        return BLOCK_OK;
    snprintf(message->text, sizeof message->text, "decay: wrong counts");
    return BLOCK_ERROR;
}

BlockStatus block_start(Block *b, double t, BlockMessage *message)
{
    (void)t;
    if (b->p[RATE] >= 0.0) return BLOCK_OK;
    snprintf(message->text, sizeof message->text, "decay: rate is %g, must not be negative", b->p[RATE]);
    return BLOCK_ERROR;
}

BlockStatus block_derivatives(Block *b, double t, const double *x, const double *u, double *dx,
                              BlockMessage *message)
{
    if (x[0] > b->p[CEILING]) {
        snprintf(message->text, sizeof message->text, "decay: x = %g is above the ceiling at %g s", x[0], t);
        return BLOCK_DISCARD;
    }
    dx[0] = -b->p[RATE] * x[0] + u[0];
    return BLOCK_OK;
}

BlockStatus block_outputs(Block *b, double t, const double *x, const double *u, double *y, BlockMessage *message)
{
    (void)t, (void)message;
    y[0] = x[0];
    if (b->w != NULL) b->w[0] = b->p[RATE] * x[0] - u[0];
    b->iy[0] = (int)b->memory[0];
    return BLOCK_OK;
}

BlockStatus block_directional(Block *b, double t, const double *x, const double *u, const double *vx,
                              const double *vu, double *vdx, double *vy, BlockMessage *message)
{
    (void)t, (void)x, (void)u, (void)message;
    if (vdx != NULL) vdx[0] = -b->p[RATE] * vx[0] + vu[0];
    if (vy != NULL) vy[0] = vx[0];
    return BLOCK_OK;
}

double block_next_event(const Block *b, double t)
{
    return b->ip[0] && b->p[KICK_TIME] > t ? b->p[KICK_TIME] : INFINITY;
}

BlockStatus block_event(Block *b, double t, double *x, BlockMessage *message)
{
    (void)t, (void)message;
    x[0] += b->p[KICK_SIZE];
    b->memory[0] += 1.0;
    return BLOCK_OK;
}

BlockStatus block_step(Block *b, double t, double h, const double *u_poly, double *dy, BlockMessage *message)
{
    (void)b, (void)t, (void)h, (void)u_poly, (void)dy, (void)message;
    return BLOCK_ERROR;
}
