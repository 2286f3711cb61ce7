#ifndef INTERAREA_CHANNEL_H
#define INTERAREA_CHANNEL_H
/* A communication channel for one scalar signal.
 *
 * Time and sides. At a communication point t the channel is told u(t) and, when
 * the tool offers them, the input's derivatives. Its outputs are those just
 * after t: an outage window [start, end) shows at t = start and is over at
 * t = end. Instants closer than TIME_SLACK count as equal.
 *
 * Delay.  y(t) = u(t - latency), no more and no less, at every communication
 * point, whatever the step. Between the communication points that it was told,
 * u is the cubic Hermite polynomial through values and slopes where the slopes
 * were given at both ends, else the straight line. Within the present step
 * (latency shorter than the step) u is the polynomial that the input
 * derivatives describe; without them it is held. Before the start,
 * u(t) = u(start).
 *
 * Outage. Inside a window the receiver gets nothing and `valid` is false:
 *   on_loss = zero            y = 0
 *   on_loss = hold            y = what it was when the outage began
 *   on_loss = hold_then_zero  the same for `hold_time`, then 0
 * Windows that touch or overlap are one outage. start = end switches one off.
 *
 * Slopes. dy/dt is u'(t - latency), and 0 in an outage.                      */
#include "../block/block.h"

enum { CHANNEL_OUTAGES = 8 };
enum { ON_LOSS_ZERO = 0, ON_LOSS_HOLD = 1, ON_LOSS_HOLD_THEN_ZERO = 2 };

/* Real parameters, in order. */
enum {
    P_LATENCY, P_HOLD_TIME, P_OUTAGES, /* start, end, start, end, ... */
    P_COUNT = P_OUTAGES + 2 * CHANNEL_OUTAGES
};
/* Integer parameters and outputs. */
enum { IP_ON_LOSS, IP_COUNT };
enum { IY_VALID, IY_COUNT };

/* Discrete state: a head, then the ring of samples. */
enum { M_SAMPLES, M_HELD, M_HELD_SINCE, M_HAS_HELD, M_RING };

static const double TIME_SLACK = 1e-10; /* s */

#endif
