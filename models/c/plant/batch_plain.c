/* batch_group.h over 2 scenarios. */
#include <math.h>
#include <stddef.h>
#include <stdint.h>
#include <string.h>

#include "../block/block.h"

#define PLANT_LANES 2
#define NAME(f) f##_2
#define PART(a) (a)
#define BATCH_STEP batch_step_2
#define BATCH_OUTPUTS batch_outputs_2
#define BATCH_RATES batch_rates_2
#include "batch_group.h"
