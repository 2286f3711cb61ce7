/* The block of a channel (block.h): what it is sent into its history, out of it what arrives. */
#include <stdio.h>

#include "../block/sampled.h"
#include "channel_variables.h"
#include "history.h"
#include "outage.h"
#include "packets.h"

static size_t capacity_of(const Record *record)
{
    size_t count;
    const int32_t *capacity = record_i32(record, "capacity", &count);
    return capacity != NULL && count == 1 && capacity[0] > 1 ? (size_t)capacity[0] : 0;
}

static History history_of(const Block *b)
{
    const History history = {b->memory + M_SAMPLES, b->memory + M_RING, capacity_of(b->record)};
    return history;
}

BlockStatus block_needs(const Record *record, const BlockLayout *n, BlockNeeds *needs, BlockMessage *message)
{
    const size_t capacity = capacity_of(record);

    if (n->n_x != 0 || n->n_u != 1 || n->n_y != 2 || n->n_w != 0 || n->n_p != P_COUNT || n->n_iu != 0
        || n->n_iy != IY_COUNT || n->n_iw != 0 || n->n_ip != IP_COUNT || capacity == 0) {
        snprintf(message->text, sizeof message->text, "channel: the variables or `capacity` of the record do "
                 "not fit this binary");
        return BLOCK_ERROR;
    }
    needs->n_memory = M_RING + SAMPLE_SIZE * capacity;
    needs->n_scratch = 0;
    return BLOCK_OK;
}

BlockStatus block_start(Block *b, double t, BlockMessage *message)
{
    BlockStatus status;

    if (!(b->p[P_LATENCY] >= 0.0) || !(b->p[P_HOLD_TIME] >= 0.0)) {
        snprintf(message->text, sizeof message->text,
                 "channel: latency %g s and hold_time %g s must not be negative", b->p[P_LATENCY],
                 b->p[P_HOLD_TIME]);
        return BLOCK_ERROR;
    }
    for (int k = 0; k < CHANNEL_OUTAGES; ++k)
        if (!(b->p[P_OUTAGES + 2 * k] <= b->p[P_OUTAGES + 2 * k + 1])) {
            snprintf(message->text, sizeof message->text,
                     "channel: outage[%d] ends at %g s, before it starts at %g s", k + 1,
                     b->p[P_OUTAGES + 2 * k + 1], b->p[P_OUTAGES + 2 * k]);
            return BLOCK_ERROR;
        }
    if ((status = packets_check(b, message)) != BLOCK_OK) return status;
    const SignalFaults faults = channel_faults(b);
    const char *wrong = signal_faults_wrong(&faults);
    if (wrong != NULL) {
        snprintf(message->text, sizeof message->text, "channel: %s", wrong);
        return BLOCK_ERROR;
    }
    for (int k = 0; k < IY_COUNT; ++k) b->iy[k] = 0;
    packets_start(b, t);
    return BLOCK_OK;
}

static BlockStatus delayed(Block *b, double t, double *value, double *slope, BlockMessage *message)
{
    const History history = history_of(b);
    const SignalFaults faults = channel_faults(b);

    if (signal_fault_value(&faults, &history, t - b->p[P_LATENCY], value, slope) == 0) {
        *value = channel_quantised(b, *value);
        if (b->p[P_QUANTUM] > 0.0) *slope = 0.0;
        return BLOCK_OK;
    }
    snprintf(message->text, sizeof message->text,
             "channel: at time %.9g s the input of %g s ago is no longer among the last %zu communication "
             "points; take longer steps or build the channel with a larger capacity", t, b->p[P_LATENCY],
             history.capacity);
    return BLOCK_ERROR;
}

/* y and its slope at time t in an outage that began at `since`. */
static BlockStatus lost(Block *b, double t, double since, double *y, BlockMessage *message)
{
    double *m = b->memory, slope;

    *y = 0.0;
    if (b->ip[IP_ON_LOSS] == ON_LOSS_ZERO) return BLOCK_OK;
    if (m[M_HAS_HELD] == 0.0 || m[M_HELD_SINCE] != since) {
        const BlockStatus status = delayed(b, since, &m[M_HELD], &slope, message);
        if (status != BLOCK_OK) return status;
        m[M_HELD_SINCE] = since;
        m[M_HAS_HELD] = 1.0;
    }
    if (b->ip[IP_ON_LOSS] == ON_LOSS_HOLD || t < since + b->p[P_HOLD_TIME] - TIME_SLACK) *y = m[M_HELD];
    return BLOCK_OK;
}

BlockStatus block_step(Block *b, double t, double h, const double *u_poly, double *dy, BlockMessage *message)
{
    const History history = history_of(b);
    const double end = t + h;
    double since;

    history_add(&history, t, u_poly, b->u_order[0]);
    dy[0] = dy[1] = 0.0;
    if (b->p[P_REPORTING] > 0.0) {
        dy[1] = 1.0;
        return packets_step(b, &history, t, end, message);
    }
    b->y[1] = b->p[P_LATENCY];
    b->iy[IY_VALID] = !outage_at(b, end, &since);
    if (b->iy[IY_VALID]) return delayed(b, end, &b->y[0], &dy[0], message);
    b->y[1] += end - since;
    dy[1] = 1.0;
    return lost(b, end, since, &b->y[0], message);
}

BlockStatus block_directional(Block *b, double t, const double *x, const double *u, const double *vx,
                              const double *vu, double *vdx, double *vy, BlockMessage *message)
{
    const History history = history_of(b);
    double since, weight = 0.0;

    (void)x, (void)u, (void)vx, (void)vdx, (void)message;
    if (vy == NULL) return BLOCK_OK;
    if (b->p[P_QUANTUM] > 0.0) weight = 0.0;
    else if (b->p[P_REPORTING] > 0.0) weight = packets_weight(b, &history, t);
    else if (!outage_at(b, t, &since)) {
        const SignalFaults faults = channel_faults(b);
        weight = signal_fault_weight(&faults, &history, t - b->p[P_LATENCY], t, b->u_order[0]);
    }
    vy[0] = weight * vu[0];
    vy[1] = 0.0;
    return BLOCK_OK;
}
