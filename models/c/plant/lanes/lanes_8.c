/* lanes_step.h over 8 plants. */
#include "lanes_8.h"
