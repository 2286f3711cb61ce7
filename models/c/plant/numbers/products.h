#ifndef INTERAREA_PRODUCTS_H
#define INTERAREA_PRODUCTS_H
#include "scalar.h"
/* Products with matrices whose columns lie one after the other, `rows` numbers each. Every sum begins with `from`, null:
 * 0, and adds its columns in order, so that one row at a time, tiles of rows (flow/tiles.h) and several scenarios give
 * the same bits. What they read and what they write lies apart. */

#ifdef PLANT_TILE
typedef double pair __attribute__((vector_size(16)));

static inline num num_from(const double *from, size_t k) { return from == NULL ? NUM(0.0) : num_at(from + k); }

/* Sums stay in registers, of four tiles, or of two complex ones, at a time: an addition need not wait for the one
 * before. At least as many rows as a tile is wide. Two that are left are a pair: a tile that went back over rows already
 * written would hold up whoever reads them next as tiles. */
static inline void num_product(const double *from, const double *M, size_t rows, size_t columns, const double *s,
                               double *to)
{
    enum { WIDE = PLANT_LANES };
    size_t i = 0;

    for (; i + 4 * WIDE <= rows; i += 4 * WIDE) {
        const double *m = M + i;
        num a = num_from(from, i), b = num_from(from, i + WIDE);
        num c = num_from(from, i + 2 * WIDE), d = num_from(from, i + 3 * WIDE);
        for (size_t k = 0; k < columns; ++k, m += rows) {
            a += num_at(m) * s[k];
            b += num_at(m + WIDE) * s[k];
            c += num_at(m + 2 * WIDE) * s[k];
            d += num_at(m + 3 * WIDE) * s[k];
        }
        put_at(to + i, a);
        put_at(to + i + WIDE, b);
        put_at(to + i + 2 * WIDE, c);
        put_at(to + i + 3 * WIDE, d);
    }
    for (; i + WIDE <= rows && i + WIDE + 2 != rows; i += WIDE) {
        const double *m = M + i;
        num a = num_from(from, i);
        for (size_t k = 0; k < columns; ++k, m += rows) a += num_at(m) * s[k];
        put_at(to + i, a);
    }
    if (i + WIDE + 2 == rows) {
        const double *m = M + i;
        num a = num_from(from, i);
        pair b = { 0.0, 0.0 }, of;
        if (from != NULL) memcpy(&b, from + i + WIDE, sizeof b);
        for (size_t k = 0; k < columns; ++k, m += rows) {
            memcpy(&of, m + WIDE, sizeof of);
            a += num_at(m) * s[k];
            b += of * s[k];
        }
        put_at(to + i, a);
        memcpy(to + i + WIDE, &b, sizeof b);
    } else if (i + 2 == rows) {
        const double *m = M + i;
        pair a = { 0.0, 0.0 }, of;
        if (from != NULL) memcpy(&a, from + i, sizeof a);
        for (size_t k = 0; k < columns; ++k, m += rows) {
            memcpy(&of, m, sizeof of);
            a += of * s[k];
        }
        memcpy(to + i, &a, sizeof a);
    } else if (i < rows) {
        const double *m = M + rows - WIDE;
        num a = num_from(from, rows - WIDE);
        for (size_t k = 0; k < columns; ++k, m += rows) a += num_at(m) * s[k];
        put_at(to + rows - WIDE, a);
    }
}

/* `count` products at once, of columns s and into columns `to` that lie one after the other: M is read once for eight
 * of them. */
static inline void num_products(const double *M, size_t rows, size_t columns, size_t count, const double *s, double *to)
{
    enum { WIDE = PLANT_LANES, TOGETHER = 8 };

    for (size_t q = 0; q < count; q += TOGETHER, s += TOGETHER * columns, to += TOGETHER * rows) {
        const size_t taken = count - q < TOGETHER ? count - q : TOGETHER;
        for (size_t left = 0; left < rows; left += WIDE) {
            const size_t at = left + WIDE > rows ? rows - WIDE : left;
            const double *m = M + at;
            num sum[TOGETHER];
            for (size_t p = 0; p < TOGETHER; ++p) sum[p] = NUM(0.0);
            if (taken == TOGETHER)
                for (size_t k = 0; k < columns; ++k, m += rows)
                    for (size_t p = 0; p < TOGETHER; ++p) sum[p] += num_at(m) * s[p * columns + k];
            else
                for (size_t k = 0; k < columns; ++k, m += rows)
                    for (size_t p = 0; p < taken; ++p) sum[p] += num_at(m) * s[p * columns + k];
            for (size_t p = 0; p < taken; ++p) put_at(to + p * rows + at, sum[p]);
        }
    }
}

static inline void num_product_complex(const double *g, const double *b, size_t rows, size_t columns,
                                       const double *s_re, const double *s_im, double *to_re, double *to_im)
{
    enum { WIDE = PLANT_LANES };
    size_t i = 0;

    for (; i + 2 * WIDE <= rows; i += 2 * WIDE) {
        const double *p = g + i, *q = b + i;
        num re = NUM(0.0), im = NUM(0.0), more_re = NUM(0.0), more_im = NUM(0.0);
        for (size_t k = 0; k < columns; ++k, p += rows, q += rows) {
            re += num_at(p) * s_re[k] - num_at(q) * s_im[k];
            im += num_at(p) * s_im[k] + num_at(q) * s_re[k];
            more_re += num_at(p + WIDE) * s_re[k] - num_at(q + WIDE) * s_im[k];
            more_im += num_at(p + WIDE) * s_im[k] + num_at(q + WIDE) * s_re[k];
        }
        put_at(to_re + i, re);
        put_at(to_im + i, im);
        put_at(to_re + i + WIDE, more_re);
        put_at(to_im + i + WIDE, more_im);
    }
    for (size_t left = i; left < rows; left += WIDE) {
        const size_t at = left + WIDE > rows ? rows - WIDE : left;
        const double *p = g + at, *q = b + at;
        num re = NUM(0.0), im = NUM(0.0);
        for (size_t k = 0; k < columns; ++k, p += rows, q += rows) {
            re += num_at(p) * s_re[k] - num_at(q) * s_im[k];
            im += num_at(p) * s_im[k] + num_at(q) * s_re[k];
        }
        put_at(to_re + at, re);
        put_at(to_im + at, im);
    }
}
#elif defined PLANT_LANES
/* Rows whose sums stay in registers together: one cache line of a table that the scenarios share. */
enum { PRODUCT_ROWS = 8, PRODUCT_COMPLEX_ROWS = 4 };

static inline void product_rows(size_t count, const num *from, const real *M, size_t rows, size_t columns, const num *s,
                                num *to)
{
    num sum[PRODUCT_ROWS];

    for (size_t i = 0; i < count; ++i) sum[i] = from == NULL ? NUM(0.0) : from[i];
    for (size_t k = 0; k < columns; ++k, M += rows)
        for (size_t i = 0; i < count; ++i) sum[i] += M[i] * s[k];
    for (size_t i = 0; i < count; ++i) to[i] = sum[i];
}

/* to = from + M s. */
static inline void num_product(const num *from, const real *M, size_t rows, size_t columns, const num *s, num *to)
{
    size_t i = 0;

    for (; i + PRODUCT_ROWS <= rows; i += PRODUCT_ROWS)
        product_rows(PRODUCT_ROWS, from == NULL ? NULL : from + i, M + i, rows, columns, s, to + i);
    for (; i + 2 <= rows; i += 2) product_rows(2, from == NULL ? NULL : from + i, M + i, rows, columns, s, to + i);
    for (; i < rows; ++i) product_rows(1, from == NULL ? NULL : from + i, M + i, rows, columns, s, to + i);
}

static inline void product_complex_rows(size_t count, const real *g, const real *b, size_t rows, size_t columns,
                                        const num *s_re, const num *s_im, num *to_re, num *to_im)
{
    num re[PRODUCT_COMPLEX_ROWS], im[PRODUCT_COMPLEX_ROWS];

    for (size_t i = 0; i < count; ++i) re[i] = im[i] = NUM(0.0);
    for (size_t k = 0; k < columns; ++k, g += rows, b += rows)
        for (size_t i = 0; i < count; ++i) {
            re[i] += g[i] * s_re[k] - b[i] * s_im[k];
            im[i] += g[i] * s_im[k] + b[i] * s_re[k];
        }
    for (size_t i = 0; i < count; ++i) {
        to_re[i] = re[i];
        to_im[i] = im[i];
    }
}

/* to = (g + j b) s. */
static inline void num_product_complex(const real *g, const real *b, size_t rows, size_t columns, const num *s_re,
                                       const num *s_im, num *to_re, num *to_im)
{
    size_t i = 0;

    for (; i + PRODUCT_COMPLEX_ROWS <= rows; i += PRODUCT_COMPLEX_ROWS)
        product_complex_rows(PRODUCT_COMPLEX_ROWS, g + i, b + i, rows, columns, s_re, s_im, to_re + i, to_im + i);
    for (; i < rows; ++i) product_complex_rows(1, g + i, b + i, rows, columns, s_re, s_im, to_re + i, to_im + i);
}
#else
/* to = from + M s, four columns at a time. */
static inline void num_product(const num *from, const real *M, size_t rows, size_t columns, const num *s, num *to)
{
    size_t k = 0;

    for (size_t i = 0; i < rows; ++i) to[i] = from == NULL ? NUM(0.0) : from[i];
    for (; k + 4 <= columns; k += 4, M += 4 * rows) {
        const real *m1 = M + rows, *m2 = m1 + rows, *m3 = m2 + rows;
        const num s0 = s[k], s1 = s[k + 1], s2 = s[k + 2], s3 = s[k + 3];
        for (size_t i = 0; i < rows; ++i)
            to[i] = (((to[i] + M[i] * s0) + m1[i] * s1) + m2[i] * s2) + m3[i] * s3;
    }
    for (; k < columns; ++k, M += rows) {
        const num s0 = s[k];
        for (size_t i = 0; i < rows; ++i) to[i] += M[i] * s0;
    }
}

/* `count` products at once, of columns s and into columns `to` that lie one after the other. */
static inline void num_products(const real *M, size_t rows, size_t columns, size_t count, const num *s, num *to)
{
    for (size_t q = 0; q < count; ++q, s += columns, to += rows)
        for (size_t i = 0; i < rows; ++i) {
            num sum = NUM(0.0);
            for (size_t k = 0; k < columns; ++k) sum += M[k * rows + i] * s[k];
            to[i] = sum;
        }
}

/* to = (g + j b) s. */
static inline void num_product_complex(const real *g, const real *b, size_t rows, size_t columns, const num *s_re,
                                       const num *s_im, num *to_re, num *to_im)
{
    for (size_t i = 0; i < rows; ++i) {
        to_re[i] = NUM(0.0);
        to_im[i] = NUM(0.0);
    }
    for (size_t k = 0; k < columns; ++k, g += rows, b += rows) {   /* the inner loop has stride 1 */
        const num re = s_re[k], im = s_im[k];
        for (size_t i = 0; i < rows; ++i) {
            to_re[i] += g[i] * re - b[i] * im;
            to_im[i] += g[i] * im + b[i] * re;
        }
    }
}
#endif
#endif
