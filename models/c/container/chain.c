/* The members of a chain, each an instance of its own: a call goes to the kind that the instance's record names. */
#include "member.h"

const int block_is_sampled = 0;     /* where a record does not say it */

static const MemberKind *kind_of(const Record *record)
{
    static const MemberKind *const kinds[] = {&controller_member, &supervisor_member, &channel_member, &pmu_member};
    size_t count;
    const int32_t *kind = record_i32(record, "member.kind", &count);

    return kinds[count == 1 && kind[0] >= 0 && kind[0] < 4 ? kind[0] : 0];
}

BlockStatus block_needs(const Record *record, const BlockLayout *layout, BlockNeeds *needs, BlockMessage *message)
{
    return kind_of(record)->needs(record, layout, needs, message);
}

BlockStatus block_start(Block *b, double t, BlockMessage *message)
{
    return kind_of(b->record)->start(b, t, message);
}

BlockStatus block_derivatives(Block *b, double t, const double *x, const double *u, double *dx, BlockMessage *message)
{
    return kind_of(b->record)->derivatives(b, t, x, u, dx, message);
}

BlockStatus block_outputs(Block *b, double t, const double *x, const double *u, double *y, BlockMessage *message)
{
    return kind_of(b->record)->outputs(b, t, x, u, y, message);
}

BlockStatus block_directional(Block *b, double t, const double *x, const double *u, const double *vx,
                              const double *vu, double *vdx, double *vy, BlockMessage *message)
{
    return kind_of(b->record)->directional(b, t, x, u, vx, vu, vdx, vy, message);
}

double block_next_event(const Block *b, double t)
{
    return kind_of(b->record)->next_event(b, t);
}

BlockStatus block_event(Block *b, double t, double *x, BlockMessage *message)
{
    return kind_of(b->record)->event(b, t, x, message);
}

BlockStatus block_step(Block *b, double t, double h, const double *u_poly, double *dy, BlockMessage *message)
{
    return kind_of(b->record)->step(b, t, h, u_poly, dy, message);
}
