/* lanes_step.h over 2 plants. */
#include <math.h>
#include <stddef.h>
#include <stdint.h>
#include <string.h>

#include "../../block/block.h"

#define PLANT_LANES 2
#define NAME(f) f##_2
#define PART(a) (a)
#define LANES_STEP lanes_step_2
#define LANES_OUTPUTS lanes_outputs_2
#define LANES_RATES lanes_rates_2
#include "lanes_step.h"
