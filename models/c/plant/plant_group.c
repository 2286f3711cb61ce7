/* The plant's side of block_group.h. */
#include "lanes_steps.h"

#if defined __x86_64__
#include <cpuid.h>
#endif

size_t block_group_lanes(void)
{
#if defined __x86_64__
    unsigned a, b, c, d, low, high;
    if (!__get_cpuid(1, &a, &b, &c, &d) || (c & (1u << 27)) == 0) return 2;   /* OSXSAVE */
    __asm__ volatile("xgetbv" : "=a"(low), "=d"(high) : "c"(0));
    if (!__get_cpuid_count(7, 0, &a, &b, &c, &d) || (low & 6u) != 6u || (b & (1u << 5)) == 0) return 2;
    return (low & 0xE6u) == 0xE6u && (b & (1u << 16)) != 0 ? 8 : 4;
#else
    return 2;
#endif
}

/* Ports iterate: how often depends on what they start from, which stays in memory. */
int block_group_fits(const Block *b)
{
    return b->memory[H_N_MACHINE] > 0.0 && b->memory[H_N_PORT] == 0.0;
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
