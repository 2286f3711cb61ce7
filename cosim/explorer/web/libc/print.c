/* Texts with numbers in them, digit by digit those of the C standard: see stdio.h. */
#include <stdint.h>
#include <stdarg.h>
#include <stddef.h>

#include "math.h"
#include "stdio.h"
#include "string.h"

enum { WORDS = 90, DIGITS = 9 * WORDS };   /* 5^1074 (2^53 - 1) has 767 digits */
static const uint32_t WORD = 1000000000u;

typedef struct {
    char *to;
    size_t size, used;
} Text;

static void put(Text *t, char c)
{
    if (t->used + 1 < t->size) t->to[t->used] = c;
    ++t->used;
}

/* At most `most` characters of a text, all where that is below 0. */
static void put_text(Text *t, const char *s, int most)
{
    for (; most != 0 && *s != 0; ++s, --most) put(t, *s);
}

static void put_whole(Text *t, uint64_t n, unsigned base)
{
    char digits[20];
    int count = 0;

    do digits[count++] = "0123456789abcdef"[n % base];
    while ((n /= base) > 0);
    while (count > 0) put(t, digits[--count]);
}

/* The digits of a number of n words, the lowest first; returns how many, from the first that is not 0. */
static int spell(const uint32_t *words, int n, unsigned char *digit)
{
    int count = 0;

    for (int i = n; i-- > 0;)
        for (uint32_t unit = WORD / 10; unit > 0; unit /= 10) {
            const unsigned char d = (unsigned char)(words[i] / unit % 10);
            if (count > 0 || d > 0) digit[count++] = d;
        }
    return count;
}

/* The exact decimal digits of x > 0, the first not 0; returns the exponent of the first. */
static int digits_of(double x, unsigned char *digit, int *count)
{
    uint32_t words[WORDS];
    uint64_t bits, m;
    int n = 0, e, k;

    memcpy(&bits, &x, sizeof bits);
    m = bits & 0xFFFFFFFFFFFFFu;
    e = (int)(bits >> 52 & 2047u);
    if (e > 0) m |= (uint64_t)1 << 52;
    e = (e > 0 ? e : 1) - 1075;                /* x = m 2^e */
    for (; m > 0; m /= WORD) words[n++] = (uint32_t)(m % WORD);
    for (k = e < 0 ? -e : e; k > 0;) {         /* m 2^e, or m 5^-e with the point -e digits from the right */
        uint64_t factor = 1, carry = 0;
        for (int most = e < 0 ? 12 : 29; k > 0 && most > 0; --most, --k) factor *= e < 0 ? 5u : 2u;
        for (int i = 0; i < n; ++i, carry /= WORD) {
            carry += words[i] * factor;
            words[i] = (uint32_t)(carry % WORD);
        }
        for (; carry > 0; carry /= WORD) words[n++] = (uint32_t)(carry % WORD);
    }
    *count = spell(words, n, digit);
    return *count - 1 + (e < 0 ? e : 0);
}

/* Keeps the first `keep` digits, rounded, ties to even; returns what that adds to the exponent. */
static int round_to(unsigned char *digit, int *count, int keep)
{
    int up, i;

    if (keep >= *count) return 0;
    up = digit[keep] > 5 || (digit[keep] == 5 && keep > 0 && digit[keep - 1] % 2 == 1);
    for (i = keep + 1; digit[keep] == 5 && !up && i < *count; ++i) up = digit[i] > 0;
    *count = keep;
    if (!up) return 0;
    for (i = keep; i-- > 0;) {
        if (++digit[i] < 10) return 0;
        digit[i] = 0;
    }
    for (i = keep; i > 0; --i) digit[i] = digit[i - 1];
    digit[0] = 1;
    if (keep == 0) *count = 1;
    return 1;
}

typedef struct {
    unsigned char digit[DIGITS];
    int count, exponent;                       /* of the first digit */
} Decimal;

/* The digits that count: `precision` of them, or, if `fixed`, so many behind the point. */
static void round_off(Decimal *d, double x, int precision, int fixed)
{
    int keep;

    if (x != 0.0) d->exponent = digits_of(fabs(x), d->digit, &d->count);
    keep = fixed ? d->exponent + 1 + precision : precision;
    if (keep < 0) d->count = 0;
    else d->exponent += round_to(d->digit, &d->count, keep);
    if (fixed && d->count == 0) d->exponent = 0;
    while (!fixed && d->count > 0 && d->digit[d->count - 1] == 0) --d->count;
}

/* The digits with the point, `behind` of them after it. */
static void put_digits(Text *t, const Decimal *d, int scientific, int behind)
{
    for (int place = scientific || d->exponent < 0 ? 0 : d->exponent; place >= -behind || place >= 0; --place) {
        const int i = scientific ? -place : d->exponent - place;
        if (place == -1) put(t, '.');
        put(t, (char)('0' + (i >= 0 && i < d->count ? d->digit[i] : 0)));
    }
}

static void put_exponent(Text *t, int exponent)
{
    put(t, 'e');
    put(t, exponent < 0 ? '-' : '+');
    if (exponent < 0) exponent = -exponent;
    if (exponent < 10) put(t, '0');
    put_whole(t, (uint64_t)exponent, 10);
}

static void put_number(Text *t, double x, int precision, int fixed)
{
    Decimal d = {{0}, 0, 0};
    uint64_t bits;
    int behind;

    memcpy(&bits, &x, sizeof bits);
    if (bits >> 63) put(t, '-');
    if (!isfinite(x)) {
        put_text(t, isnan(x) ? "nan" : "inf", -1);
        return;
    }
    if (!fixed && precision == 0) precision = 1;
    round_off(&d, x, precision, fixed);
    const int scientific = !fixed && (d.exponent < -4 || d.exponent >= precision);
    behind = fixed ? precision : d.count - 1;
    if (!fixed && !scientific) behind -= d.exponent;
    put_digits(t, &d, scientific, behind);
    if (scientific) put_exponent(t, d.exponent);
}

/* One argument, as the letter at the end of its conversion says; any other letter is put as it is. */
static void put_argument(Text *t, char letter, char length, int precision, va_list *arguments)
{
    switch (letter) {
    case 's': put_text(t, va_arg(*arguments, const char *), precision); break;
    case 'd': {
        const int64_t n = length == 'l' ? va_arg(*arguments, long) : va_arg(*arguments, int);
        if (n < 0) put(t, '-');
        put_whole(t, n < 0 ? (uint64_t)-n : (uint64_t)n, 10);
        break;
    }
    case 'u': case 'x':
        put_whole(t, length == 'z' ? va_arg(*arguments, size_t) : length == 'l' ? va_arg(*arguments, unsigned long)
                  : va_arg(*arguments, unsigned), letter == 'x' ? 16 : 10);
        break;
    case 'g': case 'f':
        put_number(t, va_arg(*arguments, double), precision < 0 ? 6 : precision, letter == 'f');
        break;
    default: put(t, letter); break;
    }
}

int vsnprintf(char *to, size_t size, const char *format, va_list arguments)
{
    Text t = {to, size, 0};
    va_list rest;

    va_copy(rest, arguments);
    for (; *format != 0; ++format) {
        int precision = -1;
        char length = 0;

        if (*format != '%') {
            put(&t, *format);
            continue;
        }
        if (*++format == '.')
            for (precision = 0, ++format; *format >= '0' && *format <= '9'; ++format)
                precision = 10 * precision + (*format - '0');
        if (*format == 'z' || *format == 'l') length = *format++;
        put_argument(&t, *format, length, precision, &rest);
    }
    va_end(rest);
    if (size > 0) to[t.used < size ? t.used : size - 1] = 0;
    return (int)t.used;
}

int snprintf(char *to, size_t size, const char *format, ...)
{
    va_list arguments;

    va_start(arguments, format);
    const int used = vsnprintf(to, size, format, arguments);
    va_end(arguments);
    return used;
}
