#ifndef INTERAREA_DEVICE_SLOPES_H
#define INTERAREA_DEVICE_SLOPES_H
/* A plant's devices and its network apart (plant_device_slopes of physics.h), from its record, without an FMU. */
#include <stddef.h>

#include "block.h"
#include "fmi2Functions.h"

/* Bytes of work for a plant of that record and layout; 0 with a message when it is refused. */
FMI2_Export size_t interarea_devices_size(const void *record, size_t bytes, const BlockLayout *layout,
                                          BlockMessage *message);
/* Starts the plant in `work` (8-byte aligned), its variables at these values; 0 when that went well. The record
 * must stay. */
FMI2_Export int interarea_devices_open(void *work, const void *record, size_t bytes, const BlockLayout *layout,
                                       const double *x, const double *u, const double *p, const int *ip,
                                       BlockMessage *message);
/* Machines and ports: how many currents plant_device_slopes gives. */
FMI2_Export size_t interarea_devices_sources(const void *work);
/* plant_device_slopes at the values the plant was started with; 0 when that went well. */
FMI2_Export int interarea_devices_slopes(void *work, const double *vx, const double *vu, const double *vv,
                                         double *vdx, double *vi);
#endif
