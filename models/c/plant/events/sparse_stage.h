#ifndef INTERAREA_SPARSE_STAGE_H
#define INTERAREA_SPARSE_STAGE_H
#include "../start/tables.h"

/* The factors of a sparse network (sparse.h) for the switches in memory and `extra`, as
 * topology_build. dead: 1 for buses that are taken out. work: sparse_stage_work(plan) doubles. */
size_t sparse_stage_work(const Plan *plan);
BlockStatus sparse_stage(double *memory, const Plan *plan, const Network *network, size_t lanes, const double *extra,
                         const double *dead, double *work, BlockMessage *message);
#endif
