/* lanes_step.h over 4 plants. */
#include "lanes_4.h"
