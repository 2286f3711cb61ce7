/* The plant's side of block_group.h. */
#include "lanes_steps.h"
#include "../flow/processor.h"

size_t block_group_lanes(void) { return processor_lanes(); }

/* Many ports on a sparse network have slopes of their own in the factors: nothing is left to share. */
int block_group_fits(const Block *b)
{
    Plan own;
    const Plan *plan = plan_in(b->memory, &own);
    return plan->n_machine > 0 && (plan->n_port == 0 || plan->folded > 0);
}

double block_group_stamp(const Block *b) { return b->memory[H_PORT_FOLDS]; }

/* f as wide as the group. Two lanes save too little by a memory in common to have code of their own. */
#define WIDE(f) \
    (lanes == 8 ? (g->shared != NULL ? f##_shared_8(g) : f##_8(g)) \
     : lanes == 4 ? (g->shared != NULL ? f##_shared_4(g) : f##_4(g)) : f##_2(g))

void block_group_step(const BlockGroup *g, size_t lanes)
{
    WIDE(lanes_step);
}

void block_group_outputs(const BlockGroup *g, size_t lanes, int rates)
{
    WIDE(lanes_outputs);
    if (rates) WIDE(lanes_rates);
}
