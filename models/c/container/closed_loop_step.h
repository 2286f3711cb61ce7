#ifndef INTERAREA_CLOSED_LOOP_STEP_H
#define INTERAREA_CLOSED_LOOP_STEP_H
#include "closed_loop.h"

/* Outputs and their slopes at time t from the states and the channels' outputs. */
BlockStatus closed_loop_refresh(ClosedLoop *l, double t, BlockMessage *message);

/* From `t` to `end` over all inner communication points between. */
BlockStatus closed_loop_advance(ClosedLoop *l, double t, double end, BlockMessage *message);

#endif
