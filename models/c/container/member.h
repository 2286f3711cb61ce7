#ifndef INTERAREA_LOOP_MEMBER_H
#define INTERAREA_LOOP_MEMBER_H
/* A block kind as a table of its functions. NAME_member.c includes the one file
 * of a kind that defines them, under other names, so that several kinds can be
 * linked into one binary.                                                     */
#include "../block/block.h"

typedef struct {
    BlockStatus (*needs)(const Record *, const BlockLayout *, BlockNeeds *, BlockMessage *);
    BlockStatus (*start)(Block *, double, BlockMessage *);
    BlockStatus (*derivatives)(Block *, double, const double *, const double *, double *, BlockMessage *);
    BlockStatus (*outputs)(Block *, double, const double *, const double *, double *, BlockMessage *);
    BlockStatus (*directional)(Block *, double, const double *, const double *, const double *,
                               const double *, double *, double *, BlockMessage *);
    double (*next_event)(const Block *, double);
    BlockStatus (*event)(Block *, double, double *, BlockMessage *);
    BlockStatus (*step)(Block *, double, double, const double *, double *, BlockMessage *);
} MemberKind;

extern const MemberKind plant_member, controller_member, channel_member, supervisor_member, pmu_member;

/* Of a channel: instants at which its output may jump, packets aside; its least
 * latency; whether it sends packets, so that its output is held between them;
 * when the next one comes out or is missed.                                   */
size_t channel_member_jumps(const Block *b, double *at); /* at most CHANNEL_MEMBER_JUMPS */
double channel_member_latency(const Block *b);
int channel_member_packets(const Block *b);
double channel_member_next(const Block *b, double t);
enum { CHANNEL_MEMBER_JUMPS = 32 };

#endif
