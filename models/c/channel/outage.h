#ifndef INTERAREA_OUTAGE_H
#define INTERAREA_OUTAGE_H
#include "../block/block.h"

/* Start of the outage that holds at time t, over touching windows; returns 0
 * when there is none. */
int outage_at(const Block *b, double t, double *since);

#endif
