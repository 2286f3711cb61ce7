/* The functions of a channel under names of their own: see member.h. */
#define block_is_sampled channel_member_is_sampled
#define block_needs channel_member_needs
#define block_start channel_member_start
#define block_derivatives channel_member_derivatives
#define block_outputs channel_member_outputs
#define block_directional channel_member_directional
#define block_next_event channel_member_next_event
#define block_event channel_member_event
#define block_step channel_member_step
#include "../channel/channel.c"
#include "member.h"

const MemberKind channel_member = {
    channel_member_needs, channel_member_start, channel_member_derivatives, channel_member_outputs,
    channel_member_directional, channel_member_next_event, channel_member_event, channel_member_step
};

size_t channel_member_jumps(const Block *b, double *at)
{
    size_t count = 0;

    for (int k = 0; k < CHANNEL_OUTAGES; ++k) {
        const double start = b->p[P_OUTAGES + 2 * k], end = b->p[P_OUTAGES + 2 * k + 1];
        if (!(end > start)) continue;
        at[count++] = start;
        at[count++] = end;
        if (b->ip[IP_ON_LOSS] == ON_LOSS_HOLD_THEN_ZERO && start + b->p[P_HOLD_TIME] < end)
            at[count++] = start + b->p[P_HOLD_TIME];
    }
    for (int k = 0; k < SIGNAL_FAULTS; ++k) {
        const double *fault = b->p + P_FAULTS + FAULT_REALS * k;
        if (b->ip[IP_FAULTS + k] == FAULT_NONE) continue;
        at[count++] = fault[FAULT_START] + b->p[P_LATENCY];
        at[count++] = fault[FAULT_END] + b->p[P_LATENCY];
    }
    return count;
}

double channel_member_latency(const Block *b)
{
    const double wait = b->p[P_PDC_WAIT];
    return b->p[P_REPORTING] > 0.0 && wait > b->p[P_LATENCY] ? wait : b->p[P_LATENCY];
}

int channel_member_packets(const Block *b)
{
    return b->p[P_REPORTING] > 0.0;
}

double channel_member_next(const Block *b, double t)
{
    return channel_member_packets(b) ? packets_next(b, t) : INFINITY;
}
