#ifndef INTERAREA_SOLVER_H
#define INTERAREA_SOLVER_H
#include "instance.h"

/* Over the step from run->time to `stop`, `length` seconds, with inputs following u_poly from there.
 * Events on the way split the interval and are handled exactly. */
BlockStatus solver_advance(Instance *c, double stop, double length, BlockMessage *message);
/* Input values at `elapsed` seconds into the step. */
void solver_inputs(const Instance *c, double elapsed, double *u);
enum { SOLVER_MAX_SUBSTEPS = 1000000 };

#endif
