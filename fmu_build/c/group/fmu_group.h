#ifndef INTERAREA_GROUP_H
#define INTERAREA_GROUP_H
/* Several instances of one FMU through a communication step at once.
 *
 * For each instance exactly what fmi2DoStep does, to the bit: values, status,
 * messages, last good time. The Runge-Kutta stages of all are done side by side
 * in the processor's vectors (block_group.h); an instance that cannot finish its
 * step repeats it alone, so the reason it gives is the one it would give alone. */
#include <stddef.h>

#include "fmi2Functions.h"

enum { GROUP_MOST_LANES = 8 };

/* Lanes of the widest vectors that this processor has. */
FMI2_Export size_t interarea_group_lanes(void);
/* Bytes of work, aligned to 64, for up to `lanes` (2, 4, 8) instances of the FMU of
 * `like`; 0 when instances of it go one by one. To be asked after initialization. */
FMI2_Export size_t interarea_group_size(fmi2Component like, size_t lanes);
/* Prepares work. It knows instances by their addresses: to be done again when an
 * instance may have been freed. */
FMI2_Export void interarea_group_open(void *work, fmi2Component like, size_t lanes);
/* fmi2DoStep(c[i], point[i], step[i], fmi2True) into status[i], for i < n. With `rates`
 * the derivatives are computed too, which a read of output slopes then finds ready. */
FMI2_Export void interarea_group_step(void *work, size_t n, const fmi2Component c[], const fmi2Real point[],
                                      const fmi2Real step[], int rates, fmi2Status status[]);
#endif
