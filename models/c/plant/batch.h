#ifndef INTERAREA_BATCH_H
#define INTERAREA_BATCH_H
/* Many scenarios of one grid in one call: structure of arrays, a vector of
 * scenarios ("lanes") per arithmetic operation.
 *
 * Scenarios differ in parameters, events, start values and inputs; each meets its
 * own events at their exact times. Steps are those of a co-simulation FMU: the
 * classical Runge-Kutta method, between communication points and events a whole
 * number of equal substeps no longer than `substep`. A scenario's numbers are the
 * same to the bit whatever the number of lanes.
 *
 * Arrays hold the scenario last: x[state * n + k], y[(step * n_y + output) * n + k]. */
#include "plant.h"
#include "../block/block_group.h"

#if defined _WIN32
#define BATCH_API __declspec(dllexport)
#elif defined __GNUC__
#define BATCH_API __attribute__((visibility("default")))
#else
#define BATCH_API
#endif

typedef struct {
    const Record *record;
    BlockLayout layout;
    size_t n;              /* scenarios                                             */
    double *x;             /* n_x x n: start values, on return the last states      */
    const double *p;       /* n_p x n                                               */
    const int *ip;         /* n_ip x n                                              */
    const double *u;       /* n_steps x n_u x n, constant over each step, or null   */
    double *y;             /* (n_steps + 1) x n_y x n                               */
    size_t n_steps;
    double start, step;
    const double *substep; /* n: longest Runge-Kutta step of each                   */
    int *status;           /* n: BLOCK_OK, or what ended the scenario               */
    double *ended;         /* n: last good time; after it y is NaN                  */
    BlockMessage *message; /* n                                                     */
    double *work;          /* batch_work(...) doubles, 64-byte aligned              */
} Batch;

/* Lanes of the widest vectors this processor has: 2, 4 (AVX2) or 8 (AVX-512). */
BATCH_API size_t batch_lanes(void);
/* What the record needs (block.h), by which batch_work is sized; record: bytes of model.bin. */
BATCH_API BlockStatus batch_open(Record *record, const void *bytes, size_t size, const BlockLayout *layout,
                                 BlockNeeds *needs, BlockMessage *message);
/* Doubles of work for `lanes` at a time. */
BATCH_API size_t batch_work(const BlockLayout *layout, const BlockNeeds *needs, size_t lanes);
/* Runs every scenario, `lanes` at a time: 1, 2, 4 or 8; more than the processor has
 * is BLOCK_ERROR. */
BATCH_API BlockStatus batch_run(Batch *batch, size_t lanes, BlockMessage *message);

/* batch_group.h over 2, 4 and 8 scenarios: a Runge-Kutta step, the outputs, the rates. */
typedef void BatchStep(const BlockGroup *group);
BatchStep batch_step_2, batch_step_4, batch_step_8, batch_outputs_2, batch_outputs_4, batch_outputs_8;
BatchStep batch_rates_2, batch_rates_4, batch_rates_8;
#endif
