/* sin and cos, exp, ln: the same operations in the same order over one double or
 * over several, so that all have the same bits; no libm. A template, included once
 * for each kind of number (scalar.h, lanes.h), which first says
 *
 *     E_NAME(f)           name of function f
 *     E_NUM, E_WORD       number; 64-bit unsigned word, or vectors of them
 *     E_ALL(a)            a double as E_NUM
 *     E_PICK(c, a, b)     a where the comparison c holds, else b
 *     E_BITS(a), E_OF(w)  the bits of a number; the number with these bits          */

/* sin and cos to about 1 ulp for |x| < 1e6: x = k pi/2 + r, |r| <= pi/4, with
 * pi/2 in three pieces of at most 33 bits (k times the first two is exact),
 * then the Taylor polynomials, whose remainders are below 1e-18 on that range. */
static inline void E_NAME(sincos)(E_NUM x, E_NUM *s, E_NUM *c)
{
    const double magic = 6755399441055744.0; /* 1.5 2^52: adding it rounds to an integer */
    const E_NUM shifted = x * 0.63661977236758138 + magic, k = shifted - magic;
    const E_WORD quadrant = E_BITS(shifted);

    E_NUM r = x - k * 1.57079632673412561417e+00;
    r -= k * 6.07710050630396597660e-11;
    r -= k * 2.02226624879595063154e-21;

    const E_NUM q = r * r, p = q * q;
    const E_NUM sr = r + r * q * (-1.0 / 6 + q * (1.0 / 120) + p * (-1.0 / 5040 + q * (1.0 / 362880)
        + p * (-1.0 / 39916800 + q * (1.0 / 6227020800.0) + p * (-1.0 / 1307674368000.0
        + q * (1.0 / 355687428096000.0)))));
    const E_NUM cr = 1.0 - q * (0.5 - q * (1.0 / 24) + p * (1.0 / 720 - q * (1.0 / 40320)
        + p * (1.0 / 3628800 - q * (1.0 / 479001600.0) + p * (1.0 / 87178291200.0
        - q * (1.0 / 20922789888000.0)))));

    const E_NUM a = E_PICK((quadrant & 1u) != 0, cr, sr), b = E_PICK((quadrant & 1u) != 0, sr, cr);
    *s = E_PICK((quadrant & 2u) != 0, -a, a);
    *c = E_PICK(((quadrant + 1u) & 2u) != 0, -b, b);
}

/* exp to about 1 ulp: x = k ln 2 + r, |r| <= 0.35, ln 2 in two pieces (k times the
 * first is exact), then the Taylor polynomial (remainder below 1e-18). Beyond
 * +-700 it stays at exp(+-700); a NaN stays a NaN. */
static inline E_NUM E_NAME(exp)(E_NUM x)
{
    const double magic = 6755399441055744.0;
    const E_NUM bounded = E_PICK(x > 700.0, E_ALL(700.0), E_PICK(x < -700.0, E_ALL(-700.0), x));
    const E_NUM shifted = bounded * 1.4426950408889634 + magic, k = shifted - magic;
    E_NUM r = bounded - k * 6.93147180369123816490e-01;
    r -= k * 1.90821492927058770002e-10;
    const E_NUM tail = r * (1.0 + r * (1.0 / 2 + r * (1.0 / 6 + r * (1.0 / 24 + r * (1.0 / 120
        + r * (1.0 / 720 + r * (1.0 / 5040 + r * (1.0 / 40320 + r * (1.0 / 362880
        + r * (1.0 / 3628800 + r * (1.0 / 39916800 + r * (1.0 / 479001600.0
        + r * (1.0 / 6227020800.0)))))))))))));
    const E_NUM power = E_OF(((E_BITS(shifted) + 1023u) & 2047u) << 52);   /* 2^k */
    return power + power * tail;
}

/* ln x to about 2 ulp for normal x > 0 (else NaN): x = 2^k m, m near 1, and the
 * series of artanh((m - 1)/(m + 1)). */
static inline E_NUM E_NAME(log)(E_NUM x)
{
    const E_WORD bits = E_BITS(x);
    /* the exponent as a number: it goes into the last bits of 2^52 */
    const E_NUM exponent = E_OF((bits >> 52) | 0x4330000000000000u) - 4503599627370496.0;
    const E_NUM whole = E_OF((bits & 0xFFFFFFFFFFFFFu) | 0x3FF0000000000000u);
    const E_NUM m = E_PICK(whole > 1.4142135623730951, whole * 0.5, whole);
    const E_NUM k = exponent - 1023.0 + E_PICK(whole > 1.4142135623730951, E_ALL(1.0), E_ALL(0.0));
    const E_NUM s = (m - 1.0) / (m + 1.0), q = s * s;
    const E_NUM tail = q * (1.0 / 3 + q * (1.0 / 5 + q * (1.0 / 7 + q * (1.0 / 9 + q * (1.0 / 11
        + q * (1.0 / 13 + q * (1.0 / 15 + q * (1.0 / 17 + q * (1.0 / 19 + q * (1.0 / 21
        + q * (1.0 / 23)))))))))));
    const E_NUM y = k * 6.93147180369123816490e-01
        + (2.0 * s + (2.0 * s * tail + k * 1.90821492927058770002e-10));
    return E_PICK(x >= 2.3e-308, E_PICK(x <= 1.7e308, y, E_ALL(NAN)), E_ALL(NAN));
}

#undef E_NAME
#undef E_NUM
#undef E_WORD
#undef E_ALL
#undef E_PICK
#undef E_BITS
#undef E_OF
