#ifndef INTERAREA_LANES_H
#define INTERAREA_LANES_H
/* scalar.h over several scenarios side by side: a `num` is one double for each of
 * PLANT_LANES scenarios, an extension that gcc and clang share. Every operation is
 * that of the scalar code lane by lane, in the same order, so a lane has the bits
 * that its scenario alone would have. A flag is all ones or all zeros per lane. */
typedef double num __attribute__((vector_size(8 * PLANT_LANES)));
typedef int64_t flag __attribute__((vector_size(8 * PLANT_LANES)));
typedef num real;

#define NUM(a) ((num){ 0.0 } + (a))
#define FIRST(a) ((a)[0])

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

/* real_sincos, its choices as flags. */
static inline void num_sincos(num x, num *s, num *c)
{
    const double magic = 6755399441055744.0;
    const num shifted = x * 0.63661977236758138 + magic, k = shifted - magic;
    const flag quadrant = (flag)shifted, one = (flag){ 0 } + 1, two = one + 1;

    num r = x - k * 1.57079632673412561417e+00;
    r -= k * 6.07710050630396597660e-11;
    r -= k * 2.02226624879595063154e-21;

    const num q = r * r, p = q * q;
    const num sr = r + r * q * (-1.0 / 6 + q * (1.0 / 120) + p * (-1.0 / 5040 + q * (1.0 / 362880)
        + p * (-1.0 / 39916800 + q * (1.0 / 6227020800.0) + p * (-1.0 / 1307674368000.0
        + q * (1.0 / 355687428096000.0)))));
    const num cr = 1.0 - q * (0.5 - q * (1.0 / 24) + p * (1.0 / 720 - q * (1.0 / 40320)
        + p * (1.0 / 3628800 - q * (1.0 / 479001600.0) + p * (1.0 / 87178291200.0
        - q * (1.0 / 20922789888000.0)))));

    const flag odd = (flag)((quadrant & one) != 0);
    const num a = num_pick(odd, cr, sr), b = num_pick(odd, sr, cr);
    *s = num_pick((flag)((quadrant & two) != 0), -a, a);
    *c = num_pick((flag)(((quadrant + one) & two) != 0), -b, b);
}

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

static inline num num_exp(num x)
{
    num y = x;
    for (size_t k = 0; k < PLANT_LANES; ++k) y[k] = real_exp(x[k]);
    return y;
}

static inline num num_log(num x)
{
    num y = x;
    for (size_t k = 0; k < PLANT_LANES; ++k) y[k] = real_log(x[k]);
    return y;
}

static inline num num_ratio(num a, num b) { return a / b; }
#endif
