/* The physics over double: the flow itself. */
#include "flow.h"
