/* Over 8 plants whose memory is the same, bit for bit. */
#define PLANT_ALIKE
#include "lanes_8.h"
