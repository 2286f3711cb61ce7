#ifndef INTERAREA_CONCENTRATOR_H
#define INTERAREA_CONCENTRATOR_H
/* A phasor data concentrator: several measured signals, aligned by time stamp
 * (IEEE C37.247: aligned with wait time, absolute or relative).
 *
 * PMU i samples its signal at k T (T = reporting_interval), exactly as a channel
 * does (channel_variables.h), and its frame reaches the concentrator latency[i] +
 * jitter[i] U later, U uniform in [0, 1), or never: lost with probability
 * loss[i], or stamped inside [lost[i].start, lost[i].end).
 *
 * The frames of one stamp make a set. A set is released when its last frame has
 * arrived, or when the wait is over, whichever comes first: `wait` after the
 * stamp, or with `relative` after the first frame of the set arrived. Sets are
 * released in the order of their stamps; one of which nothing arrives is
 * released at the end of an absolute wait and left out of a relative one. What
 * arrives after its set was released counts as late. A released set comes out
 * `latency` later, all signals at the same instant and with the same stamp.
 *
 * y[i] is the value of signal i in the newest set that has come out; where the
 * set has none, valid[i] is false and on_loss rules: zero, the last value, or
 * that for `hold_time` after the first set without the signal, then zero.
 * Until the first set comes out y[i] is u[i](start) and valid.
 * Faults make what PMU i sends wrong, its flag up (channel/signal_fault.h).
 *   sent = delivered + dropped + late + in transit (frames, all signals);
 *   age = t - stamp of the newest set. Frames are counted when their set comes out.
 *
 * Random numbers are a hash of (seed, k, i), as a channel's. y jumps when a set
 * comes out; a master sees it at communication points only. */
#include "../block/block.h"

enum { CONCENTRATOR_SIGNALS = 32 };

/* Real parameters, in order: the common ones, then PER_SIGNAL of each signal. */
enum { P_REPORTING, P_WAIT, P_LATENCY, P_HOLD_TIME, P_SIGNAL };
enum { S_LATENCY, S_JITTER, S_LOSS, S_LOST_START, S_LOST_END, PER_SIGNAL };
/* Then FAULT_REALS of each of the SIGNAL_FAULTS of each signal (channel/signal_fault.h). */
/* Integer parameters, and integer outputs after valid[1..n]. */
enum { IP_RELATIVE, IP_ON_LOSS, IP_SEED, IP_FAULTS };
enum { COUNT_SENT, COUNT_DELIVERED, COUNT_DROPPED, COUNT_LATE, COUNT_COUNT };
enum { ON_LOSS_ZERO = 0, ON_LOSS_HOLD = 1, ON_LOSS_HOLD_THEN_ZERO = 2 };

/* Discrete state: a head, the last values, since when each is missing, each signal's ring of samples, then what its faults remember. */
enum { M_FIRST, M_NEXT, M_RELEASED, M_NEWEST, M_ANY, M_HELD };

#endif
