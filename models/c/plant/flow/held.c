/* The physics over double with the devices' decisions held (elements.h). */
#define PLANT_HELD
#define NAME(f) f##_held
#include "flow.h"
