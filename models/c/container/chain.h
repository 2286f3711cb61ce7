#ifndef INTERAREA_CHAIN_H
#define INTERAREA_CHAIN_H
/* For a library that holds blocks of several kinds, the members of a chain: after this header a call of a
 * block's function is one of the kind that its record names. */
#include "member.h"

#define RECORDS_SAY_SAMPLED
#define block_is_sampled 0      /* where a record does not say it */
#define block_needs(record, ...) kind_of(record)->needs(record, __VA_ARGS__)
#define block_start(b, ...) kind_of((b)->record)->start(b, __VA_ARGS__)
#define block_derivatives(b, ...) kind_of((b)->record)->derivatives(b, __VA_ARGS__)
#define block_outputs(b, ...) kind_of((b)->record)->outputs(b, __VA_ARGS__)
#define block_directional(b, ...) kind_of((b)->record)->directional(b, __VA_ARGS__)
#define block_next_event(b, ...) kind_of((b)->record)->next_event(b, __VA_ARGS__)
#define block_event(b, ...) kind_of((b)->record)->event(b, __VA_ARGS__)
#define block_step(b, ...) kind_of((b)->record)->step(b, __VA_ARGS__)

static inline const MemberKind *kind_of(const Record *record)
{
    static const MemberKind *const kinds[] = {
        &controller_member, &supervisor_member, &channel_member, &pmu_member};
    size_t count;

    return kinds[*record_i32(record, "member.kind", &count)];
}

#endif
