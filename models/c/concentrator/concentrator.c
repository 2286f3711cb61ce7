#include "concentrator.h"

#include <math.h>
#include <stdio.h>

#include "../block/sampled.h"
#include "../channel/history.h"
#include "../block/random.h"
#include "../channel/signal_fault.h"

static const double SLACK = 1e-10; /* s; instants closer than this count as equal */
static const unsigned FIRST_STREAM = 16;

/* What becomes of the set with one stamp. */
typedef struct {
    double stamp, released;
    double arrival[CONCENTRATOR_SIGNALS]; /* INFINITY: lost on the way */
} Set;

static size_t capacity_of(const Record *record)
{
    size_t count;
    const int32_t *capacity = record_i32(record, "capacity", &count);
    return capacity != NULL && count == 1 && capacity[0] > 1 ? (size_t)capacity[0] : 0;
}

static History history_of(const Block *b, size_t i)
{
    const size_t n = b->layout.n_u, capacity = capacity_of(b->record);
    double *memory = b->memory + M_HELD + 2 * n + i * (1 + SAMPLE_SIZE * capacity);
    const History history = {memory, memory + 1, capacity};
    return history;
}

static SignalFaults faults_of(const Block *b, size_t i)
{
    const size_t n = b->layout.n_u;
    double *memory = b->memory + M_HELD + 2 * n + n * (1 + SAMPLE_SIZE * capacity_of(b->record)) + FM_COUNT * i;
    const SignalFaults faults = {b->p + P_SIGNAL + PER_SIGNAL * n + FAULT_REALS * SIGNAL_FAULTS * i,
                                 b->ip + IP_FAULTS + SIGNAL_FAULTS * i, b->p[P_REPORTING], b->ip[IP_SEED],
                                 128 + 16 * (unsigned)i, memory, n};
    return faults;
}

static const double *signal_of(const Block *b, size_t i) { return b->p + P_SIGNAL + PER_SIGNAL * i; }

BlockStatus block_needs(const Record *record, const BlockLayout *l, BlockNeeds *needs, BlockMessage *message)
{
    const size_t n = l->n_u, capacity = capacity_of(record);

    if (n < 1 || n > CONCENTRATOR_SIGNALS || l->n_x != 0 || l->n_y != n + 1 || l->n_w != 0
        || l->n_p != P_SIGNAL + (PER_SIGNAL + FAULT_REALS * SIGNAL_FAULTS) * n || l->n_iu != 0 || l->n_iy != n + COUNT_COUNT || l->n_iw != 0
        || l->n_ip != IP_FAULTS + SIGNAL_FAULTS * n || capacity == 0) {
        snprintf(message->text, sizeof message->text, "concentrator: the variables or `capacity` of the record "
                 "do not fit this binary");
        return BLOCK_ERROR;
    }
    needs->n_memory = M_HELD + 2 * n + n * (1 + SAMPLE_SIZE * capacity + FM_COUNT);
    needs->n_scratch = 0;
    return BLOCK_OK;
}

static const char *wrong_signal(const double *s)
{
    if (!(s[S_LATENCY] >= 0.0 && s[S_LATENCY] <= 1e6) || !(s[S_JITTER] >= 0.0 && s[S_JITTER] <= 1e6))
        return "latency and jitter of a signal must lie in 0 to 1e6 s";
    if (!(s[S_LOSS] >= 0.0 && s[S_LOSS] <= 1.0)) return "loss of a signal must lie in 0 to 1";
    if (!(s[S_LOST_START] <= s[S_LOST_END])) return "lost.end of a signal lies before lost.start";
    return NULL;
}

static const char *wrong(const Block *b)
{
    const double *p = b->p;
    const char *bad = NULL;

    if (!(p[P_REPORTING] >= 1e-4 && p[P_REPORTING] <= 1e6)) return "reporting_interval must lie in 1e-4 to 1e6 s";
    if (!(p[P_WAIT] >= 0.0 && p[P_WAIT] <= 1e6) || !(p[P_LATENCY] >= 0.0 && p[P_LATENCY] <= 1e6))
        return "wait and latency must lie in 0 to 1e6 s";
    if (!(p[P_HOLD_TIME] >= 0.0)) return "hold_time must not be negative";
    for (size_t i = 0; i < b->layout.n_u && bad == NULL; ++i) bad = wrong_signal(signal_of(b, i));
    return bad;
}

BlockStatus block_start(Block *b, double t, BlockMessage *message)
{
    const char *bad = wrong(b);
    double *m = b->memory;

    for (size_t i = 0; i < b->layout.n_u && bad == NULL; ++i) {
        const SignalFaults faults = faults_of(b, i);
        bad = signal_faults_wrong(&faults);
    }

    if (bad != NULL) {
        snprintf(message->text, sizeof message->text, "concentrator: %s", bad);
        return BLOCK_ERROR;
    }
    for (size_t k = 0; k < b->layout.n_iy; ++k) b->iy[k] = k < b->layout.n_u;
    m[M_FIRST] = m[M_NEXT] = ceil((t - SLACK) / b->p[P_REPORTING]);
    m[M_RELEASED] = t;
    m[M_NEWEST] = t;
    m[M_ANY] = 0.0;
    return BLOCK_OK;
}

/* Set number k, after one that was released at `before`. */
static Set set_of(const Block *b, double k, double before)
{
    const double *p = b->p;
    const int seed = b->ip[IP_SEED];
    double first = INFINITY, last = 0.0, end;
    Set set;

    set.stamp = k * p[P_REPORTING];
    for (size_t i = 0; i < b->layout.n_u; ++i) {
        const double *s = signal_of(b, i);
        const unsigned stream = FIRST_STREAM + 2 * (unsigned)i;
        const int gone = packet_random(seed, k, stream + 1) < s[S_LOSS]
                         || (s[S_LOST_START] <= set.stamp + SLACK && set.stamp < s[S_LOST_END] - SLACK);

        set.arrival[i] = gone ? INFINITY
                              : set.stamp + s[S_LATENCY] + s[S_JITTER] * packet_random(seed, k, stream);
        if (set.arrival[i] < first) first = set.arrival[i];
        if (set.arrival[i] > last) last = set.arrival[i];
    }
    end = (b->ip[IP_RELATIVE] ? first : set.stamp) + p[P_WAIT];
    set.released = last < end ? last : end;
    if (set.released < before) set.released = before;
    return set;
}

static BlockStatus input_at(const Block *b, size_t i, double time, double *value, BlockMessage *message)
{
    const SignalFaults faults = faults_of(b, i);
    const History history = history_of(b, signal_fault_source(&faults, time, i));
    double slope;

    if (signal_fault_value(&faults, &history, time, value, &slope) == 0) return BLOCK_OK;
    snprintf(message->text, sizeof message->text, "concentrator: input %zu at time %.9g s is no longer among the "
             "last %zu communication points; build it with a larger capacity", i + 1, time, history.capacity);
    return BLOCK_ERROR;
}

/* Lets a set come out. */
static BlockStatus deliver(Block *b, const Set *set, BlockMessage *message)
{
    const size_t n = b->layout.n_u;
    double *m = b->memory;
    int *count = b->iy + n;

    for (size_t i = 0; i < n; ++i) {
        const int lost = isinf(set->arrival[i]) != 0, late = !lost && set->arrival[i] > set->released + SLACK;

        count[COUNT_DROPPED] += lost;
        count[COUNT_LATE] += late;
        count[COUNT_DELIVERED] += !lost && !late;
        if (b->iy[i]) m[M_HELD + n + i] = set->released + b->p[P_LATENCY]; /* of the set that lacks it first */
        b->iy[i] = !lost && !late;
        if (b->iy[i]) {
            const BlockStatus status = input_at(b, i, set->stamp, &m[M_HELD + i], message);
            if (status != BLOCK_OK) return status;
        }
    }
    m[M_NEWEST] = set->stamp;
    m[M_ANY] = 1.0;
    return BLOCK_OK;
}

/* Whether a missing signal still stands at its last value. */
static int held(const Block *b, size_t i, double t)
{
    const int rule = b->ip[IP_ON_LOSS];

    return rule == ON_LOSS_HOLD
           || (rule == ON_LOSS_HOLD_THEN_ZERO
               && t < b->memory[M_HELD + b->layout.n_u + i] + b->p[P_HOLD_TIME] - SLACK);
}

BlockStatus block_step(Block *b, double t, double h, const double *u_poly, double *dy, BlockMessage *message)
{
    const size_t n = b->layout.n_u;
    const double end = t + h, interval = b->p[P_REPORTING];
    double *m = b->memory;
    BlockStatus status;

    if ((end - m[M_NEXT] * interval) / interval > 1e5) {
        snprintf(message->text, sizeof message->text, "concentrator: the step to time %.9g s spans more than "
                 "100000 frames; take shorter steps", end);
        return BLOCK_ERROR;
    }
    for (size_t i = 0; i < n; ++i) {
        const History history = history_of(b, i);
        history_add(&history, t, u_poly + 4 * i, b->u_order[i]);
        if (m[M_ANY] == 0.0 && (status = input_at(b, i, m[M_NEWEST], &m[M_HELD + i], message)) != BLOCK_OK)
            return status;
    }
    while (m[M_NEXT] * interval <= end + SLACK) {
        const Set set = set_of(b, m[M_NEXT], m[M_RELEASED]);
        if (isinf(set.released)) { /* relative wait, and nothing came: no set */
            b->iy[n + COUNT_DROPPED] += (int)n;
        } else {
            if (set.released + b->p[P_LATENCY] > end + SLACK) break;
            m[M_RELEASED] = set.released;
            if ((status = deliver(b, &set, message)) != BLOCK_OK) return status;
        }
        m[M_NEXT] += 1.0;
    }
    for (size_t i = 0; i < n; ++i) {
        b->y[i] = b->iy[i] || held(b, i, end) ? m[M_HELD + i] : 0.0;
        dy[i] = 0.0;
    }
    b->iy[n + COUNT_SENT] = (int)n * (int)(floor((end + SLACK) / interval) - m[M_FIRST] + 1.0);
    b->y[n] = end - m[M_NEWEST];
    dy[n] = 1.0;
    return BLOCK_OK;
}

BlockStatus block_directional(Block *b, double t, const double *x, const double *u, const double *vx,
                              const double *vu, double *vdx, double *vy, BlockMessage *message)
{
    (void)t, (void)x, (void)u, (void)vx, (void)vu, (void)vdx, (void)message;
    if (vy != NULL)
        for (size_t j = 0; j < b->layout.n_y; ++j) vy[j] = 0.0;
    return BLOCK_OK;
}
