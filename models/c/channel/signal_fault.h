#ifndef INTERAREA_SIGNAL_FAULT_H
#define INTERAREA_SIGNAL_FAULT_H
/* Faults of a signal at its source: a wrong value is sent, and the receiver's flag stays up.
 *
 * A fault holds for the values measured in [start, end). It is linear in the true signal u: at time s
 *
 *     stuck       u(start)
 *     bias        u(s) + size
 *     ramp        u(s) + size (s - start)
 *     drift       u(s) + size (1 - exp(-(s - start) / detail))
 *     scale       size u(s)
 *     polarity    -u(s)
 *     noise       u(s) + size n, n the sum of 12 uniform numbers less 6: variance 1
 *     spike       u(s) + size or u(s) - size with probability `detail`, else u(s)
 *     replay      u(s - m size), m the least whole number that leads before start
 *     time_error  u(s - size - detail (s - start)): the stamp is too new by so much
 *     oscillating u(s) + size sin(2 pi detail (s - start))
 *     swap        u of signal number `size` of the concentrator, at s
 *
 * noise, spike and replay are of packets; their random numbers are a hash as a packet's loss is.
 * Of several faults the first whose window holds acts.                                          */
#include "history.h"

enum { SIGNAL_FAULTS = 4, SIGNAL_FAULT_RECORD = 1024 };
enum {
    FAULT_NONE, FAULT_STUCK, FAULT_BIAS, FAULT_RAMP, FAULT_DRIFT, FAULT_SCALE, FAULT_POLARITY, FAULT_NOISE,
    FAULT_SPIKE, FAULT_REPLAY, FAULT_TIME_ERROR, FAULT_OSCILLATING, FAULT_SWAP, FAULT_KINDS
};
/* Real parameters of one fault, in order. */
enum { FAULT_START, FAULT_END, FAULT_SIZE, FAULT_DETAIL, FAULT_REALS };
/* Discrete state: a value that stays, and the packets that a replay repeats. */
enum { FM_KNOWN, FM_TIME, FM_VALUE, FM_RECORDED, FM_RECORD, FM_COUNT = FM_RECORD + SIGNAL_FAULT_RECORD };

typedef struct {
    const double *p;    /* FAULT_REALS of each fault                */
    const int *kind;    /* of each fault                            */
    double interval;    /* between packets, 0: none                 */
    int seed;
    unsigned stream;    /* of the random numbers, the first of 16   */
    double *memory;     /* FM_COUNT                                 */
    size_t signals;     /* of the concentrator, 0: a channel        */
} SignalFaults;

/* Why the parameters cannot be, or NULL. */
const char *signal_faults_wrong(const SignalFaults *faults);

/* Number of the signal whose history is sent at time s in place of number `own`, from 0. */
size_t signal_fault_source(const SignalFaults *faults, double s, size_t own);

/* What is sent at time s and its slope; as history_at, whose result it returns. */
int signal_fault_value(const SignalFaults *faults, const History *history, double s, double *value, double *slope);

/* d of it / d u(t): see history_weight. */
double signal_fault_weight(const SignalFaults *faults, const History *history, double s, double t, int order);

#endif
