#ifndef INTERAREA_SPARSE_ROWS_H
#define INTERAREA_SPARSE_ROWS_H
#include "sparse.h"
/* Row k less its multiples of the rows above: those multiples are its part of L. For sparse_factor.c, and for
 * sparse_4.c with a block's four numbers in one operation: the same bits. */

static const double SINGULAR = 1e-24;  /* squared pivot against the squared largest entry of its row */

static double size_of(const double *a, size_t width)
{
    double size = 0.0;
    for (size_t i = 0; i < width; ++i) size += a[i] * a[i];
    return size;
}

/* An entry into its row; returns the larger of `scale` and its size. */
static double spread(double *w, const double *entry, size_t width, double scale)
{
    const double size = size_of(entry, width);
    for (size_t i = 0; i < width; ++i) w[i] = entry[i];
    return size > scale ? size : scale;
}

/* w less l times a row of U. */
static inline void less_row_complex(double *w, const double *l, const double *u, const int32_t *column, size_t count)
{
    for (size_t c = 0; c < count; ++c, u += 2) {
        double *at = w + 2 * (size_t)column[c];
        at[0] -= l[0] * u[0] - l[1] * u[1];
        at[1] -= l[0] * u[1] + l[1] * u[0];
    }
}

#ifdef SPARSE_FOUR
static inline void less_row_blocks(double *w, const double *l, const double *u, const int32_t *column, size_t count)
{
    const four left = { l[0], l[0], l[2], l[2] }, right = { l[1], l[1], l[3], l[3] };

    for (size_t c = 0; c < count; ++c, u += 4) {
        const four u0 = twice(u), u2 = twice(u + 2);
        double *at = w + 4 * (size_t)column[c];
        put_four(at, four_at(at) - (left * u0 + right * u2));
    }
}
#else
static inline void less_row_blocks(double *w, const double *l, const double *u, const int32_t *column, size_t count)
{
    for (size_t c = 0; c < count; ++c, u += 4) {
        double *at = w + 4 * (size_t)column[c];
        at[0] -= l[0] * u[0] + l[1] * u[2];
        at[1] -= l[0] * u[1] + l[1] * u[3];
        at[2] -= l[2] * u[0] + l[3] * u[2];
        at[3] -= l[2] * u[1] + l[3] * u[3];
    }
}
#endif

/* to = a u. */
static void times(double *to, const double *a, const double *u, size_t width)
{
    if (width == 2) {
        to[0] = a[0] * u[0] - a[1] * u[1];
        to[1] = a[0] * u[1] + a[1] * u[0];
        return;
    }
    to[0] = a[0] * u[0] + a[1] * u[2];
    to[1] = a[0] * u[1] + a[1] * u[3];
    to[2] = a[2] * u[0] + a[3] * u[2];
    to[3] = a[2] * u[1] + a[3] * u[3];
}

/* 1/a; 0: it vanishes against `scale`. */
static int inverse(double *to, const double *a, size_t width, double scale)
{
    if (width == 2) {
        const double size = size_of(a, 2);
        if (!(size > SINGULAR * scale)) return 0;
        to[0] = a[0] / size;
        to[1] = -a[1] / size;
        return 1;
    }
    const double det = a[0] * a[3] - a[1] * a[2];
    if (!(fabs(det) > SINGULAR * scale)) return 0;
    to[0] = a[3] / det;
    to[1] = -a[1] / det;
    to[2] = -a[2] / det;
    to[3] = a[0] / det;
    return 1;
}

/* A complex number as the real matrix that multiplies real and imaginary parts. */
static void expand(double *to, const double *from)
{
    to[0] = to[3] = from[0];
    to[1] = -from[1];
    to[2] = from[1];
}

/* The entries of row k, of which the factors take the places, into w; returns the largest of their sizes. */
static double row_complex_into(const double *memory, const Plan *plan, const Pattern *s, size_t k, double *w)
{
    const double *lower = memory + plan->lower, *upper = memory + plan->upper;
    double scale = spread(w + 2 * k, memory + plan->pivot + 2 * k, 2, 0.0);

    for (size_t e = (size_t)s->lower[k]; e < (size_t)s->lower[k + 1]; ++e)
        scale = spread(w + 2 * (size_t)s->lower_column[e], lower + 2 * e, 2, scale);
    for (size_t e = (size_t)s->upper[k]; e < (size_t)s->upper[k + 1]; ++e)
        scale = spread(w + 2 * (size_t)s->upper_column[e], upper + 2 * e, 2, scale);
    return scale;
}

/* The same of the linear matrix, 2 x 2 numbers an entry. The pivot's place holds the slopes of ports in the row. */
static double row_blocks_into(const double *memory, const Plan *plan, const Pattern *s, size_t k, double *w)
{
    const double *lower = memory + plan->linear, *upper = lower + 2 * plan->n_fill, *slope = memory + plan->pivot + 4 * k;
    double own[4], block[4];

    expand(own, upper + 2 * plan->n_fill + 2 * k);
    for (size_t i = 0; i < 4; ++i) own[i] -= slope[i];
    double scale = spread(w + 4 * k, own, 4, 0.0);
    for (size_t e = (size_t)s->lower[k]; e < (size_t)s->lower[k + 1]; ++e) {
        expand(block, lower + 2 * e);
        scale = spread(w + 4 * (size_t)s->lower_column[e], block, 4, scale);
    }
    for (size_t e = (size_t)s->upper[k]; e < (size_t)s->upper[k + 1]; ++e) {
        expand(block, upper + 2 * e);
        scale = spread(w + 4 * (size_t)s->upper_column[e], block, 4, scale);
    }
    return scale;
}

/* 0: the pivot vanishes. */
static int factor_row(double *memory, const Plan *plan, const Pattern *s, size_t k, double *w)
{
    const size_t width = plan->width, first = (size_t)s->upper[k], last = (size_t)s->upper[k + 1];
    double *lower = memory + plan->lower, *upper = memory + plan->upper, *pivot = memory + plan->pivot + width * k;
    const double scale = width == 2 ? row_complex_into(memory, plan, s, k, w) : row_blocks_into(memory, plan, s, k, w);

    for (size_t e = (size_t)s->lower[k]; e < (size_t)s->lower[k + 1]; ++e) {
        const size_t j = (size_t)s->lower_column[e], from = (size_t)s->upper[j], count = (size_t)s->upper[j + 1] - from;
        double *l = lower + width * e;
        (void)spread(l, w + width * j, width, 0.0);
        if (width == 2) less_row_complex(w, l, upper + 2 * from, s->upper_column + from, count);
        else less_row_blocks(w, l, upper + 4 * from, s->upper_column + from, count);
    }
    if (!inverse(pivot, w + width * k, width, scale)) return 0;
    for (size_t e = first; e < last; ++e)
        times(upper + width * e, pivot, w + width * (size_t)s->upper_column[e], width);
    return 1;
}

/* Row i of those that are to be factored. */
static inline size_t row_at(const double *memory, const Plan *plan, SparseRows which, size_t i)
{
    return which == SPARSE_ALL ? i : index_at(memory + plan->port_path, i);
}

/* As sparse_factor. */
static size_t factor_rows(double *memory, const Plan *plan, const Pattern *s, SparseRows which, double *w)
{
    const double *slope = memory + plan->port_slope;
    double *pivot = memory + plan->pivot;
    const size_t count = which == SPARSE_ALL ? plan->n_node : index_at(memory, H_PORT_PATH);

    for (size_t i = 0; plan->width == 4 && i < count; ++i)
        memset(pivot + 4 * row_at(memory, plan, which, i), 0, 4 * sizeof(double));
    for (size_t i = 0; plan->width == 4 && i < 4 * plan->n_port; ++i)
        pivot[4 * (size_t)s->port[i / 4] + i % 4] += slope[i];
    for (size_t i = 0; i < count; ++i) {
        const size_t k = row_at(memory, plan, which, i);
        if (!factor_row(memory, plan, s, k, w)) return k;
    }
    return plan->n_node;
}
#endif
