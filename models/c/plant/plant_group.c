/* The plant's side of block_group.h: the vectors of the batch. */
#include "batch.h"

size_t block_group_lanes(void)
{
    return batch_lanes();
}

/* Ports iterate: how often depends on what they start from, which stays in memory. */
int block_group_fits(const Block *b)
{
    return b->memory[H_N_MACHINE] > 0.0 && b->memory[H_N_PORT] == 0.0;
}

void block_group_step(const BlockGroup *g, size_t lanes)
{
    if (lanes == 8) batch_step_8(g);
    else if (lanes == 4) batch_step_4(g);
    else batch_step_2(g);
}

void block_group_outputs(const BlockGroup *g, size_t lanes, int rates)
{
    if (lanes == 8) batch_outputs_8(g);
    else if (lanes == 4) batch_outputs_4(g);
    else batch_outputs_2(g);
    if (!rates) return;
    if (lanes == 8) batch_rates_8(g);
    else if (lanes == 4) batch_rates_4(g);
    else batch_rates_2(g);
}
