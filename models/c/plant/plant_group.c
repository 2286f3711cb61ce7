/* The plant's side of block_group.h. */
#include "lanes_steps.h"
#include "processor.h"

size_t block_group_lanes(void) { return processor_lanes(); }

/* Ports iterate: how often depends on what they start from, which stays in memory. */
int block_group_fits(const Block *b)
{
    Plan own;
    const Plan *plan = plan_in(b->memory, &own);
    return plan->n_machine > 0 && plan->n_port == 0;
}

void block_group_step(const BlockGroup *g, size_t lanes)
{
    if (lanes == 8) lanes_step_8(g);
    else if (lanes == 4) lanes_step_4(g);
    else lanes_step_2(g);
}

void block_group_outputs(const BlockGroup *g, size_t lanes, int rates)
{
    if (lanes == 8) lanes_outputs_8(g);
    else if (lanes == 4) lanes_outputs_4(g);
    else lanes_outputs_2(g);
    if (!rates) return;
    if (lanes == 8) lanes_rates_8(g);
    else if (lanes == 4) lanes_rates_4(g);
    else lanes_rates_2(g);
}
