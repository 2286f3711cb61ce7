#ifndef INTERAREA_PROCESSOR_H
#define INTERAREA_PROCESSOR_H
#include <stddef.h>
#if defined __x86_64__
#include <cpuid.h>
#endif
/* Doubles in one arithmetic operation of this processor: 8 (AVX-512), 4 (AVX2) or 2; 4 are two operations of
 * WebAssembly, which pay where one is not enough. */
static inline size_t processor_lanes(void)
{
#if defined __x86_64__
    unsigned a, b, c, d, low, high;
    if (!__get_cpuid(1, &a, &b, &c, &d) || (c & (1u << 27)) == 0) return 2;   /* OSXSAVE */
    __asm__ volatile("xgetbv" : "=a"(low), "=d"(high) : "c"(0));
    if (!__get_cpuid_count(7, 0, &a, &b, &c, &d) || (low & 6u) != 6u || (b & (1u << 5)) == 0) return 2;
    return (low & 0xE6u) == 0xE6u && (b & (1u << 16)) != 0 ? 8 : 4;
#elif defined __wasm_simd128__
    return 4;
#else
    return 2;
#endif
}
#endif
