#include "packets.h"

#include <math.h>
#include <stdio.h>

#include "channel_variables.h"
#include "outage.h"
#include "../block/random.h"

enum { STREAM_JITTER = 1, STREAM_TABLE, STREAM_STATE, STREAM_LOSS };
enum { DUE = 0, STAMP = 1, FATE = 2, PACKET_SIZE = 3 };
enum { FATE_ARRIVES = 0, FATE_LOST = 1, FATE_TOO_LATE = 2 };

/* Whether p[first .. last] lie in 0 to `most`. */
static int within(const double *p, int first, int last, double most)
{
    for (int k = first; k <= last; ++k)
        if (!(p[k] >= 0.0 && p[k] <= most)) return 0;
    return 1;
}

/* Whether anything is asked for that only packets have. */
static int wants_packets(const double *p)
{
    return p[P_JITTER] > 0.0 || p[P_PDC_WAIT] > 0.0 || p[P_LOSS_GOOD] > 0.0 || p[P_GOOD_TO_BAD] > 0.0
           || p[P_QUANTILES + CHANNEL_QUANTILES - 1] > 0.0;
}

BlockStatus packets_check(const Block *b, BlockMessage *message)
{
    const double *p = b->p, *q = p + P_QUANTILES;
    const char *bad = NULL;

    if (!within(p, P_LOSS_GOOD, P_BAD_TO_GOOD, 1.0)) bad = "probabilities of loss and transition must lie in 0 to 1";
    if (!within(p, P_REPORTING, P_PDC_WAIT, 1e6))
        bad = "reporting_interval, jitter, quantum and pdc_wait must lie in 0 to 1e6";
    if (p[P_REPORTING] > 0.0 && !(p[P_REPORTING] >= 1e-4)) bad = "reporting_interval must be 0 or at least 1e-4 s";
    if (p[P_GOOD_TO_BAD] > 0.0 && !(p[P_BAD_TO_GOOD] > 0.0)) bad = "bad_to_good must be positive";
    int ascends = within(q, 0, CHANNEL_QUANTILES - 1, 1e6);
    for (int k = 1; k < CHANNEL_QUANTILES; ++k) ascends = ascends && q[k] >= q[k - 1];
    if (!ascends) bad = "quantile[1], quantile[2], ... must be non-negative and non-decreasing";
    if (p[P_REPORTING] == 0.0 && wants_packets(p))
        bad = "jitter, quantile, loss and pdc_wait act on packets: set reporting_interval";
    if (bad == NULL) return BLOCK_OK;
    snprintf(message->text, sizeof message->text, "channel: %s", bad);
    return BLOCK_ERROR;
}

void packets_start(Block *b, double t)
{
    double *m = b->memory;
    const double a = b->p[P_GOOD_TO_BAD], z = b->p[P_BAD_TO_GOOD];

    if (!(b->p[P_REPORTING] > 0.0)) return;
    m[M_FIRST] = m[M_NEXT] = ceil((t - TIME_SLACK) / b->p[P_REPORTING]);
    m[M_NEWEST] = t;
    /* the state before the first packet, from the stationary distribution */
    m[M_BAD] = a > 0.0 && packet_random(b->ip[IP_SEED], m[M_FIRST] - 1.0, STREAM_STATE) * (a + z) < a;
}

static double latency_of(const Block *b, double number)
{
    const double *q = b->p + P_QUANTILES;
    const int seed = b->ip[IP_SEED];
    const double at = packet_random(seed, number, STREAM_TABLE) * (CHANNEL_QUANTILES - 1);
    const int k = (int)at;

    return b->p[P_LATENCY] + b->p[P_JITTER] * packet_random(seed, number, STREAM_JITTER)
           + (q[k] + (at - k) * (q[k + 1] - q[k]));
}

/* Sends packet M_NEXT. */
static BlockStatus post(Block *b, BlockMessage *message)
{
    double *m = b->memory, *packet = m + M_PENDING + PACKET_SIZE * (size_t)m[M_IN_FLIGHT];
    const double number = m[M_NEXT], wait = b->p[P_PDC_WAIT], latency = latency_of(b, number);
    const double move = packet_random(b->ip[IP_SEED], number, STREAM_STATE);

    if ((int)m[M_IN_FLIGHT] >= CHANNEL_IN_FLIGHT) {
        snprintf(message->text, sizeof message->text, "channel: at time %.9g s more than %d packets are in "
                 "transit; shorten the latency or lengthen reporting_interval",
                 number * b->p[P_REPORTING], CHANNEL_IN_FLIGHT);
        return BLOCK_ERROR;
    }
    m[M_BAD] = m[M_BAD] != 0.0 ? !(move < b->p[P_BAD_TO_GOOD]) : move < b->p[P_GOOD_TO_BAD];
    packet[STAMP] = number * b->p[P_REPORTING];
    packet[DUE] = packet[STAMP] + (wait > 0.0 ? wait : latency);
    packet[FATE] = FATE_ARRIVES;
    if (wait > 0.0 && latency > wait + TIME_SLACK) packet[FATE] = FATE_TOO_LATE;
    if (packet_random(b->ip[IP_SEED], number, STREAM_LOSS) < b->p[m[M_BAD] != 0.0 ? P_LOSS_BAD : P_LOSS_GOOD])
        packet[FATE] = FATE_LOST;
    m[M_IN_FLIGHT] += 1.0;
    m[M_NEXT] += 1.0;
    return BLOCK_OK;
}

static void lose(double *m, double since)
{
    if (m[M_LOST] != 0.0) return;
    m[M_LOST] = 1.0;
    m[M_LOST_SINCE] = since;
}

static BlockStatus value_at(const Block *b, const History *history, double stamp, double *value,
                            BlockMessage *message)
{
    const SignalFaults faults = channel_faults(b);
    double slope;

    if (signal_fault_value(&faults, history, stamp, value, &slope) != 0) {
        snprintf(message->text, sizeof message->text, "channel: the input at time %.9g s is no longer among the "
                 "last %zu communication points; build the channel with a larger capacity", stamp,
                 history->capacity);
        return BLOCK_ERROR;
    }
    *value = channel_quantised(b, *value);
    return BLOCK_OK;
}

/* The packet at place k is due. */
static BlockStatus receive(Block *b, const History *history, size_t k, BlockMessage *message)
{
    double *m = b->memory, *list = m + M_PENDING;
    const double due = list[PACKET_SIZE * k + DUE], stamp = list[PACKET_SIZE * k + STAMP];
    const int fate = (int)list[PACKET_SIZE * k + FATE];
    double since;

    m[M_IN_FLIGHT] -= 1.0;
    for (size_t i = PACKET_SIZE * k; i < PACKET_SIZE * (size_t)m[M_IN_FLIGHT]; ++i) list[i] = list[i + PACKET_SIZE];
    if (fate == FATE_LOST || outage_at(b, due, &since)) {
        b->iy[IY_DROPPED] += 1;
        if (stamp > m[M_NEWEST]) lose(m, fate == FATE_LOST ? due : since);
        return BLOCK_OK;
    }
    if (fate == FATE_TOO_LATE || (m[M_RECEIVED] != 0.0 && stamp < m[M_NEWEST])) {
        b->iy[IY_LATE] += 1;
        if (fate == FATE_TOO_LATE) lose(m, due);
        return BLOCK_OK;
    }
    b->iy[IY_DELIVERED] += 1;
    m[M_RECEIVED] = 1.0;
    m[M_NEWEST] = stamp;
    m[M_LOST] = 0.0;
    return value_at(b, history, stamp, &m[M_HELD], message);
}

/* The first packet due by `end`, or `count`. */
static size_t first_due(const double *list, size_t count, double end)
{
    size_t best = count;

    for (size_t k = 0; k < count; ++k) {
        const double due = list[PACKET_SIZE * k + DUE];
        if (due <= end + TIME_SLACK && (best == count || due < list[PACKET_SIZE * best + DUE])) best = k;
    }
    return best;
}

/* Whether packets are missing and the rule on loss says zero. */
static int silent(const Block *b, double t)
{
    const double *m = b->memory;

    return m[M_LOST] != 0.0
           && (b->ip[IP_ON_LOSS] == ON_LOSS_ZERO
               || (b->ip[IP_ON_LOSS] == ON_LOSS_HOLD_THEN_ZERO
                   && t >= m[M_LOST_SINCE] + b->p[P_HOLD_TIME] - TIME_SLACK));
}

BlockStatus packets_step(Block *b, const History *history, double now, double end, BlockMessage *message)
{
    double *m = b->memory, since;
    const double interval = b->p[P_REPORTING];
    BlockStatus status;

    if ((end - m[M_NEXT] * interval) / interval > 1e5) {
        snprintf(message->text, sizeof message->text, "channel: the step to time %.9g s spans more than 100000 "
                 "packets; take shorter steps", end);
        return BLOCK_ERROR;
    }
    /* the input may have been set anew since the newest packet took its value */
    if ((m[M_RECEIVED] == 0.0 || m[M_NEWEST] >= now - TIME_SLACK)
        && (status = value_at(b, history, m[M_NEWEST], &m[M_HELD], message)) != BLOCK_OK)
        return status;
    for (;;) {
        const double stamp = m[M_NEXT] * interval;
        const int more = stamp <= end + TIME_SLACK;
        /* before a packet is sent, all that is due until then arrives */
        const double until = more && stamp < end ? stamp : end;
        size_t k;

        while ((k = first_due(m + M_PENDING, (size_t)m[M_IN_FLIGHT], until)) < (size_t)m[M_IN_FLIGHT])
            if ((status = receive(b, history, k, message)) != BLOCK_OK) return status;
        if (!more) break;
        if ((status = post(b, message)) != BLOCK_OK) return status;
    }
    if (outage_at(b, end, &since)) lose(m, since);
    b->iy[IY_SENT] = (int)(m[M_NEXT] - m[M_FIRST]);
    b->iy[IY_VALID] = m[M_LOST] == 0.0;
    b->y[1] = end - m[M_NEWEST];
    b->y[0] = silent(b, end) ? 0.0 : m[M_HELD];
    return BLOCK_OK;
}

double packets_weight(const Block *b, const History *history, double t)
{
    const double *m = b->memory;
    const SignalFaults faults = channel_faults(b);

    if (silent(b, t)) return 0.0;
    return m[M_RECEIVED] == 0.0 || m[M_NEWEST] >= t - TIME_SLACK
               ? signal_fault_weight(&faults, history, m[M_NEWEST], t, b->u_order[0]) : 0.0;
}

double packets_next(const Block *b, double t)
{
    const double *m = b->memory, *list = m + M_PENDING, *p = b->p;
    const double least = p[P_PDC_WAIT] > 0.0 ? p[P_PDC_WAIT] : p[P_LATENCY];
    double next = INFINITY;

    for (size_t k = 0; k < (size_t)m[M_IN_FLIGHT]; ++k) {
        const double due = list[PACKET_SIZE * k + DUE];
        if (due > t + TIME_SLACK && due < next) next = due;
    }
    for (double number = m[M_NEXT]; number * p[P_REPORTING] + least < next; number += 1.0) {
        const double due = number * p[P_REPORTING] + (p[P_PDC_WAIT] > 0.0 ? least : latency_of(b, number));
        if (due > t + TIME_SLACK && due < next) next = due;
    }
    if (m[M_LOST] != 0.0 && b->ip[IP_ON_LOSS] == ON_LOSS_HOLD_THEN_ZERO) {
        const double end = m[M_LOST_SINCE] + p[P_HOLD_TIME];
        if (end > t + TIME_SLACK && end < next) next = end;
    }
    return next;
}
