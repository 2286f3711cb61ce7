#ifndef INTERAREA_RESOURCE_H
#define INTERAREA_RESOURCE_H
#include <stddef.h>

#include "fmi2Functions.h"

/* Reads `model.bin` out of the folder that a FMI resource location names. Returns null and
 * writes what is wrong into why. */
unsigned char *resource_read(const char *location, const fmi2CallbackFunctions *callbacks,
                             size_t *size, char *why, size_t why_size);

#endif
