#ifndef INTERAREA_PACKETS_H
#define INTERAREA_PACKETS_H
/* Packets of a channel with a reporting interval (semantics: channel_variables.h). */
#include "../block/block.h"
#include "history.h"

BlockStatus packets_check(const Block *b, BlockMessage *message);
void packets_start(Block *b, double t);
/* Sends and receives everything up to time `end`; `now` is the last instant at
 * which the input was set. Sets outputs and integer outputs. */
BlockStatus packets_step(Block *b, const History *history, double now, double end, BlockMessage *message);

/* The first instant after t at which a packet comes out or is missed, or what is
 * held for a missing one ends; INFINITY if there is none. */
double packets_next(const Block *b, double t);

/* d y(t) / d u(t). */
double packets_weight(const Block *b, const History *history, double t);

#endif
