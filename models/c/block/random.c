#include "random.h"

#include <stdint.h>

/* The finaliser of SplitMix64. */
static uint64_t mixed(uint64_t z)
{
    z = (z ^ (z >> 30)) * UINT64_C(0xbf58476d1ce4e5b9);
    z = (z ^ (z >> 27)) * UINT64_C(0x94d049bb133111eb);
    return z ^ (z >> 31);
}

double packet_random(int seed, double packet, unsigned stream)
{
    const uint64_t golden = UINT64_C(0x9e3779b97f4a7c15);
    uint64_t z = mixed((uint64_t)(uint32_t)seed + golden);

    z = mixed(z + golden * (uint64_t)stream);
    z = mixed(z + golden * (uint64_t)(int64_t)packet);
    return (double)(z >> 11) * (1.0 / 9007199254740992.0);
}
