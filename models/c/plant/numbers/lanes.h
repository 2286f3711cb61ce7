#ifndef INTERAREA_LANES_H
#define INTERAREA_LANES_H
/* scalar.h over several scenarios side by side, or neighbours of one plant (tile.h): a `num` is one
 * double for each of PLANT_LANES, an extension that gcc and clang share. Every operation is
 * that of the scalar code lane by lane, in the same order, so a lane has the bits
 * that its scenario alone would have. A flag is all ones or all zeros per lane. */
typedef double num __attribute__((vector_size(8 * PLANT_LANES)));
typedef int64_t flag __attribute__((vector_size(8 * PLANT_LANES)));
typedef uint64_t word __attribute__((vector_size(8 * PLANT_LANES)));
#if defined PLANT_TILE      /* tile.h: neighbours in arrays of double */
typedef num real;
typedef double cell;
typedef double stored;
#elif defined PLANT_ALIKE   /* lanes_step.h: the scenarios' tables are one */
typedef double real;
typedef num cell;
typedef double stored;
#else
typedef num real;
typedef num cell;
typedef num stored;
#endif

#define NUM(a) ((a) - (num){ 0.0 })   /* keeps a zero's sign */
#ifdef PLANT_ALIKE
#define FIRST(a) (a)
#else
#define FIRST(a) ((a)[0])
#endif

static inline flag num_above(num a, num b) { return (flag)(a > b); }
static inline flag num_reaches(num a, num b) { return (flag)(a >= b); }
static inline num num_pick(flag c, num a, num b) { return (num)((c & (flag)a) | (~c & (flag)b)); }

static inline flag flag_not(flag c) { return ~c; }

static inline int flag_any(flag c)
{
    int64_t any = 0;
    for (size_t k = 0; k < PLANT_LANES; ++k) any |= c[k];
    return any != 0;
}

#define E_NAME(f) num_##f
#define E_NUM num
#define E_WORD word
#define E_ALL(a) NUM(a)
#define E_PICK(c, a, b) num_pick((flag)(c), a, b)
#define E_BITS(a) ((word)(a))
#define E_OF(w) ((num)(w))
#include "elementary.h"

static inline num num_sqrt(num x)
{
#if defined __has_builtin
#if __has_builtin(__builtin_elementwise_sqrt)
#define PLANT_ELEMENTWISE_SQRT
#endif
#endif
#ifdef PLANT_ELEMENTWISE_SQRT
    return __builtin_elementwise_sqrt(x);
#else
    num y = x;
    for (size_t k = 0; k < PLANT_LANES; ++k) y[k] = sqrt(x[k]);
    return y;
#endif
}

static inline num num_ratio(num a, num b) { return a / b; }
#endif
