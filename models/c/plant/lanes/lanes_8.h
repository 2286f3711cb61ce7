/* lanes_step.h over 8 plants, for processors with AVX512; elsewhere never called. No guard: lanes_8.c and alike_8.c. */
#include <math.h>
#include <stddef.h>
#include <stdint.h>
#include <string.h>

#include "../../block/block.h"

#if defined __x86_64__ && defined __clang__
#pragma clang attribute push(__attribute__((target("avx512f"))), apply_to = function)
#elif defined __x86_64__
#pragma GCC target("avx512f")
#endif
#define PLANT_LANES 8
#define PART(a) (a)
#ifdef PLANT_ALIKE
#define NAME(f) f##_shared_8
#else
#define NAME(f) f##_8
#endif
#define LANES_STEP NAME(lanes_step)
#define LANES_OUTPUTS NAME(lanes_outputs)
#define LANES_RATES NAME(lanes_rates)
#if !defined __x86_64__ && defined __GNUC__ && !defined __clang__
#pragma GCC diagnostic ignored "-Wpsabi"
#endif
#include "lanes_step.h"
#if defined __x86_64__ && defined __clang__
#pragma clang attribute pop
#endif
