/* lanes_step.h over 4 plants, for processors with AVX2; elsewhere never called. */
#include <math.h>
#include <stddef.h>
#include <stdint.h>
#include <string.h>

#include "../block/block.h"

#if defined __x86_64__ && defined __clang__
#pragma clang attribute push(__attribute__((target("avx2"))), apply_to = function)
#elif defined __x86_64__
#pragma GCC target("avx2")
#endif
#define PLANT_LANES 4
#define NAME(f) f##_4
#define PART(a) (a)
#define LANES_STEP lanes_step_4
#define LANES_OUTPUTS lanes_outputs_4
#define LANES_RATES lanes_rates_4
#if !defined __x86_64__ && defined __GNUC__ && !defined __clang__
#pragma GCC diagnostic ignored "-Wpsabi"
#endif
#include "lanes_step.h"
#if defined __x86_64__ && defined __clang__
#pragma clang attribute pop
#endif
