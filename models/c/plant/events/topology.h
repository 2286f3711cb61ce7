#ifndef INTERAREA_TOPOLOGY_H
#define INTERAREA_TOPOLOGY_H
#include "../start/tables.h"

/* The reduced network for the switches in memory and `extra` (2 x n_bus:
 * conductance and susceptance added by events). lanes: width of the tiles (tiles.h). work: topology_work(...) doubles. */
size_t topology_work(const Plan *plan);
BlockStatus topology_build(double *memory, const Plan *plan, const Network *network, size_t lanes, const double *extra,
                           double *work, BlockMessage *message);
#endif
