/* tile.h, 4 wide, for processors with AVX2 and for WebAssembly; elsewhere never called. */
#include <math.h>
#include <stddef.h>
#include <stdint.h>
#include <string.h>

#include "../../block/block.h"

#if defined __x86_64__ || defined __wasm_simd128__
#if defined __wasm_simd128__
#elif defined __clang__
#pragma clang attribute push(__attribute__((target("avx2"))), apply_to = function)
#else
#pragma GCC target("avx2")
#endif
#define PLANT_LANES 4
#define NAME(f) f##_4
#define PART(a) (a)
#include "tile.h"
#if defined __x86_64__ && defined __clang__
#pragma clang attribute pop
#endif
#else
typedef int NoTiles;   /* a translation unit is not empty */
#endif
