/* batch_group.h over 4 scenarios, for processors with AVX2; elsewhere never called. */
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
#define BATCH_STEP batch_step_4
#define BATCH_OUTPUTS batch_outputs_4
#define BATCH_RATES batch_rates_4
#if !defined __x86_64__ && defined __GNUC__ && !defined __clang__
#pragma GCC diagnostic ignored "-Wpsabi"
#endif
#include "batch_group.h"
#if defined __x86_64__ && defined __clang__
#pragma clang attribute pop
#endif
