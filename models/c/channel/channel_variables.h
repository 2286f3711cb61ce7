#ifndef INTERAREA_CHANNEL_VARIABLES_H
#define INTERAREA_CHANNEL_VARIABLES_H
/* A communication channel for one scalar signal.
 *
 * Time and sides. At a communication point t the channel gets u(t) and, when
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
 * Slopes. dy/dt is u'(t - latency), and 0 in an outage.
 *
 * Packets. With reporting_interval = T > 0 the signal travels in packets:
 * packet k takes the value of u at its time stamp k T exactly (by the same
 * polynomials) and arrives latency + jitter * U1 + Q(U2) later, U uniform in
 * [0, 1), Q linear between quantile[1..33] at probabilities 0, 1/32, ..., 1.
 * y is the value with the newest stamp that has arrived. Older ones that arrive
 * afterwards count as late. pdc_wait > 0: a concentrator releases packet k at
 * k T + pdc_wait; whatever took longer it throws away, which counts as late.
 * A packet is lost with probability loss_good or loss_bad, in the good or bad
 * state of a Markov chain that moves once per packet (good_to_bad = 0: plain
 * Bernoulli loss), or when it comes out inside an outage. `valid` is false from
 * the instant at which a packet is missed, or an outage begins, until the next
 * one is delivered; on_loss rules in between. Until the first one arrives y is
 * u(start), stamped with the start.
 *   sent = delivered + dropped + late + in transit;  age = t - newest stamp
 * (continuous: the latency, growing in an outage). Packets are counted when due.
 *
 * Random numbers are a hash of (seed, packet number, purpose): the same packets
 * in every tool, for every step, after restoring a state too.
 *
 * y jumps at arrivals. A master sees the value at communication points only:
 * an arrival inside a step shows at its end. With steps that divide reporting
 * interval and latency nothing is lost by that.
 *
 * Faults of the signal itself, which the receiver is not told of: signal_fault.h.
 *
 * quantum > 0 rounds what is sent to its nearest multiple (slopes are then 0). */
#include <math.h>

#include "../block/block.h"
#include "signal_fault.h"

enum { CHANNEL_OUTAGES = 8, CHANNEL_QUANTILES = 33, CHANNEL_IN_FLIGHT = 512 };
enum { ON_LOSS_ZERO = 0, ON_LOSS_HOLD = 1, ON_LOSS_HOLD_THEN_ZERO = 2 };

/* Real parameters, in order. */
enum {
    P_LATENCY, P_HOLD_TIME, P_OUTAGES, /* start, end, start, end, ... */
    P_REPORTING = P_OUTAGES + 2 * CHANNEL_OUTAGES, P_JITTER, P_QUANTUM, P_PDC_WAIT,
    P_LOSS_GOOD, P_LOSS_BAD, P_GOOD_TO_BAD, P_BAD_TO_GOOD,
    P_QUANTILES,
    P_FAULTS = P_QUANTILES + CHANNEL_QUANTILES,
    P_COUNT = P_FAULTS + FAULT_REALS * SIGNAL_FAULTS
};
/* Integer parameters and outputs. */
enum { IP_ON_LOSS, IP_SEED, IP_FAULTS, IP_COUNT = IP_FAULTS + SIGNAL_FAULTS };
enum { IY_VALID, IY_SENT, IY_DELIVERED, IY_DROPPED, IY_LATE, IY_COUNT };

/* Discrete state: a head, packets in transit, then the ring of samples. */
enum {
    M_SAMPLES, M_HELD, M_HELD_SINCE, M_HAS_HELD,
    M_FIRST, M_NEXT, M_BAD, M_NEWEST, M_RECEIVED, M_LOST, M_LOST_SINCE, M_IN_FLIGHT,
    M_PENDING, /* due time, stamp, fate, due time, ... */
    M_FAULTS = M_PENDING + 3 * CHANNEL_IN_FLIGHT,
    M_RING = M_FAULTS + FM_COUNT
};

static const double TIME_SLACK = 1e-10; /* s */

static inline SignalFaults channel_faults(const Block *b)
{
    const SignalFaults faults = {b->p + P_FAULTS, b->ip + IP_FAULTS, b->p[P_REPORTING], b->ip[IP_SEED], 128,
                                 b->memory + M_FAULTS, 0};
    return faults;
}

/* What is sent of a value. */
static inline double channel_quantised(const Block *b, double value)
{
    const double quantum = b->p[P_QUANTUM];
    return quantum > 0.0 ? quantum * floor(value / quantum + 0.5) : value;
}

#endif
