/* The functions of a plant under names of their own: see member.h. */
#define block_is_sampled plant_member_is_sampled
#define block_needs plant_member_needs
#define block_start plant_member_start
#define block_derivatives plant_member_derivatives
#define block_outputs plant_member_outputs
#define block_directional plant_member_directional
#define block_next_event plant_member_next_event
#define block_event plant_member_event
#define block_step plant_member_step
#include "../plant/plant.c"
#include "member.h"

const MemberKind plant_member = {
    plant_member_needs, plant_member_start, plant_member_derivatives, plant_member_outputs,
    plant_member_directional, plant_member_next_event, plant_member_event, plant_member_step
};
