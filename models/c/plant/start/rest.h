#ifndef INTERAREA_REST_H
#define INTERAREA_REST_H
#include "tables.h"

/* What is computed once from the tables; set-points and states of devices whose
 * parameters are not those of the record, so that the operating point stays at rest. */
void rest_prepare(double *memory, const Plan *plan);
BlockStatus rest_settle(Block *b, const Plan *plan, const Network *network, BlockMessage *message);
#endif
