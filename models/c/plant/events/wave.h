#ifndef INTERAREA_WAVE_H
#define INTERAREA_WAVE_H
#include "slot.h"

/* What a slot asks for over time, as a share of its size, constant between times that are events of their own, so
 * that no step of a solver goes over an edge:
 *
 *     steady   1; over SLOT_RISE a ramp in equal stairs of at most 20 ms
 *     sine     sin(2 pi f s), s since the start, in stairs of at most 20 ms, 24 a period or more: the wave in the
 *              middle of a stair, times (pi/n)/sin(pi/n) for n stairs, by which their first harmonic is too small
 *     square   1 in the first half of each period, -1 in the second
 *     noise    a stationary Ornstein-Uhlenbeck process of variance 1 and corner frequency f every 20 ms. It follows
 *              from seed, stair and target alone, whatever was asked before: independent normal numbers far apart,
 *              what lies between them by halving: of two values 2h apart the middle one has the mean
 *              r (a + b) / (1 + r^2) and the variance (1 - r^2) / (1 + r^2), r = exp(-2 pi f h)
 *
 * The stairs of a ramp are at its height in their middle: what it moves in all, power times time, is that of the ramp. */
BlockStatus wave_check(const double *p, const int *i, size_t slot, const char *kind, BlockMessage *message);
/* Next time after t at which the slot does something by itself; whether t is such a time. */
double wave_next(const double *p, const int *i, double t);
int wave_acts(const double *p, const int *i, double t);
/* At t, from start to end; target: of noise, each has its own. */
double wave_at(const double *p, const int *i, size_t target, double t);
#endif
