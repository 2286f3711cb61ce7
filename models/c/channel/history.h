#ifndef INTERAREA_HISTORY_H
#define INTERAREA_HISTORY_H
/* The last samples of a signal, in a ring of doubles that lies in a block's
 * memory: time, value, three derivatives, and how many of these were given.
 * memory[0] counts the samples ever written.                                 */
#include <stddef.h>

enum { SAMPLE_SIZE = 6 };

typedef struct {
    double *count;      /* samples ever written                                */
    double *ring;       /* SAMPLE_SIZE * capacity                              */
    size_t capacity;
} History;

/* Notes the value and derivatives u[0..3] at time t, of which `order`
 * derivatives were given. A sample at the same time replaces the last one. */
void history_add(const History *history, double t, const double *u, int order);

/* Value and slope at time s: constant before the first sample, between samples
 * as channel_variables.h says, after the last one its polynomial. Returns 0, or 1 when s
 * lies before the oldest sample that the ring still has. */
int history_at(const History *history, double s, double *value, double *slope);

/* Whether the value at time s can no longer change, whatever is set at the newest sample. */
int history_settled(const History *history, double s);

/* d value(s) / d u(t) if u(t) is given at the present time t, with `order` derivatives. */
double history_weight(const History *history, double s, double t, int order);

#endif
