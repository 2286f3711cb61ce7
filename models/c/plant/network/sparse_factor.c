/* Row k less its multiples of the rows above: those multiples are its part of L. */
#include "sparse_factor.h"

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

/* at -= l u. */
static void less_complex(double *at, const double *l, const double *u)
{
    at[0] -= l[0] * u[0] - l[1] * u[1];
    at[1] -= l[0] * u[1] + l[1] * u[0];
}

static void less_block(double *at, const double *l, const double *u)
{
    at[0] -= l[0] * u[0] + l[1] * u[2];
    at[1] -= l[0] * u[1] + l[1] * u[3];
    at[2] -= l[2] * u[0] + l[3] * u[2];
    at[3] -= l[2] * u[1] + l[3] * u[3];
}

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

static void expand(double *to, const double *from, size_t count)
{
    for (size_t k = 0; k < count; ++k, to += 4, from += 2) {
        to[0] = to[3] = from[0];
        to[1] = -from[1];
        to[2] = from[1];
    }
}

/* The linear matrix as 2 x 2 blocks, less the slopes of the ports. */
static void with_slopes(double *memory, const Plan *plan, const Pattern *s)
{
    const double *linear = memory + plan->linear, *slope = memory + plan->port_slope;

    expand(memory + plan->lower, linear, plan->n_fill);
    expand(memory + plan->upper, linear + 2 * plan->n_fill, plan->n_fill);
    expand(memory + plan->pivot, linear + 4 * plan->n_fill, plan->n_node);
    for (size_t p = 0; p < plan->n_port; ++p)
        for (size_t i = 0; i < 4; ++i) memory[plan->pivot + 4 * (size_t)s->port[p] + i] -= slope[4 * p + i];
}

size_t sparse_factor(double *memory, const Plan *plan, const Pattern *s, double *w)
{
    const size_t width = plan->width;
    double *lower = memory + plan->lower, *upper = memory + plan->upper, *pivot = memory + plan->pivot;

    if (width == 4) with_slopes(memory, plan, s);
    for (size_t k = 0; k < plan->n_node; ++k) {
        const size_t row = (size_t)s->lower[k], above = (size_t)s->lower[k + 1];
        const size_t first = (size_t)s->upper[k], last = (size_t)s->upper[k + 1];
        double scale = spread(w + width * k, pivot + width * k, width, 0.0);
        for (size_t e = row; e < above; ++e)
            scale = spread(w + width * (size_t)s->lower_column[e], lower + width * e, width, scale);
        for (size_t e = first; e < last; ++e)
            scale = spread(w + width * (size_t)s->upper_column[e], upper + width * e, width, scale);
        for (size_t e = row; e < above; ++e) {
            const size_t j = (size_t)s->lower_column[e];
            double *l = lower + width * e;
            (void)spread(l, w + width * j, width, 0.0);
            if (width == 2)
                for (int32_t c = s->upper[j]; c < s->upper[j + 1]; ++c)
                    less_complex(w + 2 * s->upper_column[c], l, upper + 2 * (size_t)c);
            else
                for (int32_t c = s->upper[j]; c < s->upper[j + 1]; ++c)
                    less_block(w + 4 * s->upper_column[c], l, upper + 4 * (size_t)c);
        }
        if (!inverse(pivot + width * k, w + width * k, width, scale)) return k;
        for (size_t e = first; e < last; ++e)
            times(upper + width * e, pivot + width * k, w + width * (size_t)s->upper_column[e], width);
    }
    return plan->n_node;
}
