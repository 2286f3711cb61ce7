/* The functions of a supervisor under names of their own: see member.h. */
#define block_is_sampled supervisor_member_is_sampled
#define block_needs supervisor_member_needs
#define block_start supervisor_member_start
#define block_derivatives supervisor_member_derivatives
#define block_outputs supervisor_member_outputs
#define block_directional supervisor_member_directional
#define block_next_event supervisor_member_next_event
#define block_event supervisor_member_event
#define block_step supervisor_member_step
#include "../controller/supervisor.c"
#include "member.h"

const MemberKind supervisor_member = {
    supervisor_member_needs, supervisor_member_start, supervisor_member_derivatives, supervisor_member_outputs,
    supervisor_member_directional, supervisor_member_next_event, supervisor_member_event, supervisor_member_step
};
