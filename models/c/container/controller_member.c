/* The functions of a controller under names of their own: see member.h. */
#define block_is_sampled controller_member_is_sampled
#define block_needs controller_member_needs
#define block_start controller_member_start
#define block_derivatives controller_member_derivatives
#define block_outputs controller_member_outputs
#define block_directional controller_member_directional
#define block_next_event controller_member_next_event
#define block_event controller_member_event
#define block_step controller_member_step
#include "../controller/state_space.c"
#include "member.h"

const MemberKind controller_member = {
    controller_member_needs, controller_member_start, controller_member_derivatives, controller_member_outputs,
    controller_member_directional, controller_member_next_event, controller_member_event, controller_member_step
};
