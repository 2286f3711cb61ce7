#ifndef INTERAREA_RELAY_H
#define INTERAREA_RELAY_H
#include "slot.h"

/* Frequency relays, one in each slot of their kinds. Like a numerical relay it looks every 5 ms at the angle of the
 * voltage where its load or machine is and lets what that turned since then, over the time, through a lag of
 * SLOT_FILTER: the frequency it sees. It picks up when that is beyond SLOT_THRESHOLD (above it if that is above the
 * rated frequency), drops out when it no longer is or the voltage is below RELAY_LEAST_V, and has its breaker open
 * SLOT_BREAKER after the first look SLOT_DELAY after it picked up, for good. It is in use from SLOT_START to SLOT_END. */
static inline int relay_is(int kind) { return kind == EVENT_FREQUENCY_SHED || kind == EVENT_FREQUENCY_TRIP; }
BlockStatus relay_check(const Block *b, const double *p, size_t slot, const char *kind, BlockMessage *message);
/* Forgets all that relays saw. */
void relay_start(double *memory, const Plan *plan);
/* Whether t is a time at which relays look; the next time at which one looks or opens. */
int relay_looks(const Block *b, const Plan *plan, double t);
double relay_next(const Block *b, const Plan *plan, double t);
/* All relays look at t, if they look then at all. 0, or 1 + the port where the network has no solution. */
size_t relay_look(Block *b, const Plan *plan, const Network *network, const double *x, double t);
/* What opened at t, where nothing else is to be told. */
void relay_tell(const Block *b, const Plan *plan, const Network *network, double t, BlockMessage *message);
size_t relay_work(const Plan *plan);
#endif
