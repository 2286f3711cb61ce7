/* lanes_step.h over 8 plants, for processors with AVX512; elsewhere never called. */
#include <math.h>
#include <stddef.h>
#include <stdint.h>
#include <string.h>

#include "../block/block.h"

#if defined __x86_64__ && defined __clang__
#pragma clang attribute push(__attribute__((target("avx512f"))), apply_to = function)
#elif defined __x86_64__
#pragma GCC target("avx512f")
#endif
#define PLANT_LANES 8
#define NAME(f) f##_8
#define PART(a) (a)
#define LANES_STEP lanes_step_8
#define LANES_OUTPUTS lanes_outputs_8
#define LANES_RATES lanes_rates_8
#if !defined __x86_64__ && defined __GNUC__ && !defined __clang__
#pragma GCC diagnostic ignored "-Wpsabi"
#endif
#include "lanes_step.h"
#if defined __x86_64__ && defined __clang__
#pragma clang attribute pop
#endif
