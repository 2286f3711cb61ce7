#ifndef INTERAREA_PLACEMENT_H
#define INTERAREA_PLACEMENT_H
#include "instance.h"

enum { WHY_SIZE = 512 };
/* Reads c->record: counts, start values and ranges of the variables, what the block needs. Returns 0, or 1 and
 * writes what is wrong into why. */
int instance_describe(Instance *c, BlockNeeds *needs, char *why);
/* Sets c->saved_size and its parts; returns the bytes of c->work. */
size_t instance_sizes(Instance *c, const BlockNeeds *needs);
/* Points into c->run, c->undo and c->work, which the caller has set. */
void instance_place(Instance *c, const BlockNeeds *needs);

#endif
