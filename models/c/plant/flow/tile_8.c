/* tile.h, 8 wide, for processors with AVX-512; elsewhere never called. */
#include <math.h>
#include <stddef.h>
#include <stdint.h>
#include <string.h>

#include "../../block/block.h"

#if defined __x86_64__
#if defined __clang__
#pragma clang attribute push(__attribute__((target("avx512f"))), apply_to = function)
#else
#pragma GCC target("avx512f")
#endif
#define PLANT_LANES 8
#define NAME(f) f##_8
#define PART(a) (a)
#include "tile.h"
#if defined __clang__
#pragma clang attribute pop
#endif
#else
typedef int NoTiles;   /* a translation unit is not empty */
#endif
