#ifndef INTERAREA_SOLVER_H
#define INTERAREA_SOLVER_H
#include "instance.h"

/* From run->time to `end`, with inputs following u_poly from `begin`.
 * Events on the way split the interval and are handled exactly. */
BlockStatus solver_advance(Instance *c, double begin, double end, BlockMessage *message);
/* Input values at `elapsed` seconds into the step. */
void solver_inputs(const Instance *c, double elapsed, double *u);
enum { SOLVER_MAX_SUBSTEPS = 1000000 };

#endif
