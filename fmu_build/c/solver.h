#ifndef INTERAREA_SOLVER_H
#define INTERAREA_SOLVER_H
#include "instance.h"
#include "stretch.h"

/* Over the step from run->time to `stop`, `length` seconds, with inputs following u_poly from there.
 * Events on the way split the interval and are handled exactly. */
BlockStatus solver_advance(Instance *c, double stop, double length, BlockMessage *message);
/* Input values at `elapsed` seconds into the step. */
void solver_inputs(const Instance *c, double elapsed, double *u);
/* The Runge-Kutta step of a stretch that is next, of states x. */
BlockStatus solver_step(Instance *c, const Stretch *s, double *x, BlockMessage *message);
/* The same where somebody has taken its stages, with the slopes of the first in c->work and its notes in the block, and
 * found that limiters switch; and whether the run still looks for such instants. */
BlockStatus solver_switched(Instance *c, const Stretch *s, double *x, BlockMessage *message);
int solver_affords(const Instance *c, const Stretch *s);
enum { SOLVER_MAX_SUBSTEPS = 1000000 };
/* Arrays of n_x in Instance.work: those of a step, and states for one that is not the instance's own. */
enum { SOLVER_ARRAYS = 10 };

#endif
