/* batch_group.h over 8 scenarios, for processors with AVX512; elsewhere never called. */
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
#define BATCH_STEP batch_step_8
#define BATCH_OUTPUTS batch_outputs_8
#define BATCH_RATES batch_rates_8
#if !defined __x86_64__ && defined __GNUC__ && !defined __clang__
#pragma GCC diagnostic ignored "-Wpsabi"
#endif
#include "batch_group.h"
#if defined __x86_64__ && defined __clang__
#pragma clang attribute pop
#endif
