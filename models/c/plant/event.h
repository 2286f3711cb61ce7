#ifndef INTERAREA_EVENT_H
#define INTERAREA_EVENT_H
#include "tables.h"

/* What the event slots ask for at one time. */
typedef enum {
    EVENT_NONE = 0, EVENT_BUS_FAULT, EVENT_BRANCH_TRIP, EVENT_BRANCH_RECLOSE, EVENT_VREF_PULSE,
    EVENT_LOAD_STEP, EVENT_PM_PULSE, EVENT_MACHINE_TRIP, EVENT_SHUNT_SWITCH, EVENT_KINDS
} EventKind;

BlockStatus event_check(const Block *b, const Plan *plan, const Network *network, BlockMessage *message);
double event_next(const Block *b, const Plan *plan, double t);
/* Puts what is active at t into memory (steps, switches) and rebuilds the topology. */
BlockStatus event_apply(Block *b, const Plan *plan, const Network *network, double t,
                        BlockMessage *message);
#endif
