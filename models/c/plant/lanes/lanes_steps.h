#ifndef INTERAREA_LANES_STEPS_H
#define INTERAREA_LANES_STEPS_H
/* Plants of one grid side by side, a vector of 2, 4 (AVX2) or 8 (AVX-512) of them per arithmetic
 * operation: a Runge-Kutta step, the outputs, the rates. A plant's numbers are the same to the bit
 * whatever the number of lanes. */
#include "../numbers/layout.h"
#include "../../block/block_group.h"

typedef void LanesStep(const BlockGroup *group);
LanesStep lanes_step_2, lanes_step_4, lanes_step_8, lanes_outputs_2, lanes_outputs_4, lanes_outputs_8;
LanesStep lanes_rates_2, lanes_rates_4, lanes_rates_8;
LanesStep lanes_step_shared_4, lanes_step_shared_8, lanes_outputs_shared_4, lanes_outputs_shared_8;
LanesStep lanes_rates_shared_4, lanes_rates_shared_8;
#endif
