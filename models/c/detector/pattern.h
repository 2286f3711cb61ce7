#ifndef INTERAREA_PATTERN_H
#define INTERAREA_PATTERN_H
/* Whether n signals move together as they do in the grid: a window of each of them against a subspace.
 *
 * x holds of each signal the means over `frames` stamps each of the last `samples` times. Right signals lie near the
 * space of the columns of V (n samples, size), orthonormal, made of runs without wrong signals. Without signal i the
 * rest lies near the columns of V_i, the same rows without those of i. What is left of x and of the rest is
 *
 *     r = |x - V V' x|,   r_i = |x_i - V_i V_i' x_i|,
 *
 * and signal i is wrong if it alone makes the difference: r_i is the least of all and
 *
 *     sqrt(r^2 - r_i^2) / (floor + 3 r_i)
 *
 * is large (identification by reconstruction: Dunia1996). A disturbance that no run has shown leaves r_i large of
 * every i, and names nobody.                                                                                */
#include "../block/record.h"

typedef struct {
    size_t signals, frames, samples, size; /* frames 0: none in the record */
    const double *all, *others;            /* V, then V_1 .. V_n, rows first */
} Patterns;

/* 0 where the record has arrays that do not fit. */
int patterns_of(const Record *record, size_t signals, Patterns *patterns);

/* r_i of the window x (signals, samples); i = signals: r. */
double pattern_left(const Patterns *patterns, const double *x, size_t i);

#endif
