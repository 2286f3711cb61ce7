#ifndef INTERAREA_EVENT_H
#define INTERAREA_EVENT_H
#include "slot.h"

BlockStatus event_check(const Block *b, const Plan *plan, const Network *network, BlockMessage *message);
double event_next(const Block *b, const Plan *plan, double t);
/* What happens at t: nothing but relays that look, steps of set-points only, or more. */
typedef enum { EVENT_LOOKS, EVENT_STEPS, EVENT_SWITCHES } EventReach;
EventReach event_reach(const Block *b, const Plan *plan, double t);
/* Puts what is active at t into memory: set-points, and unless these are all the switches and the topology. */
BlockStatus event_apply(Block *b, const Plan *plan, const Network *network, EventReach reach, double t,
                        BlockMessage *message);
#endif
