#ifndef INTERAREA_SAMPLED_H
#define INTERAREA_SAMPLED_H
/* What a block that lives on communication points (block_step) answers to the calls
 * that are for integrated blocks. Included by the one C file of its kind, which
 * defines the rest of block.h.                                                      */
#include <math.h>
#include <stdio.h>

#include "block.h"

const int block_is_sampled = 1;

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

BlockStatus block_derivatives(Block *b, double t, const double *x, const double *u, double *dx,
                              BlockMessage *message)
{
    (void)b, (void)t, (void)x, (void)u, (void)dx, (void)message;
    return BLOCK_OK;
}

BlockStatus block_outputs(Block *b, double t, const double *x, const double *u, double *y,
                          BlockMessage *message)
{
    (void)b, (void)t, (void)x, (void)u, (void)y;
    snprintf(message->text, sizeof message->text, "a sampled block: outputs are made by steps");
    return BLOCK_ERROR;
}
#endif
