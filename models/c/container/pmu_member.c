/* The functions of a PMU under names of their own: see member.h. */
#define block_is_sampled pmu_member_is_sampled
#define block_needs pmu_member_needs
#define block_start pmu_member_start
#define block_derivatives pmu_member_derivatives
#define block_outputs pmu_member_outputs
#define block_directional pmu_member_directional
#define block_next_event pmu_member_next_event
#define block_event pmu_member_event
#define block_step pmu_member_step
#include "../pmu/pmu.c"
#include "member.h"

const MemberKind pmu_member = {
    pmu_member_needs, pmu_member_start, pmu_member_derivatives, pmu_member_outputs,
    pmu_member_directional, pmu_member_next_event, pmu_member_event, pmu_member_step
};
