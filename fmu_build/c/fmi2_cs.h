#ifndef INTERAREA_FMI2_CS_H
#define INTERAREA_FMI2_CS_H
#include "instance.h"

/* Whether a step can be tried; reports why not. */
int step_is_sane(Instance *c, double begin, double step, const char *call);
/* How long the step from where the last one ended is: `step`, whatever rounding made of the times. */
double step_length(const Instance *c, double begin, double step);
/* After a step the inputs stay where it left them and their derivatives must be given anew. */
void step_consume_inputs(Instance *c, double elapsed);

#endif
