#ifndef INTERAREA_KERNEL_SIGNALS_H
#define INTERAREA_KERNEL_SIGNALS_H
/* polynomials.py and signals.py, line by line. */
#include <math.h>
#include <string.h>

#include "structures.h"

static const double JUMP = 1e-6;

static double seconds(int64_t ticks)
{
    return (double)ticks / 1e9;
}

static double value_at(const double *d, double s)
{
    return d[0] + s * (d[1] + s * (d[2] / 2.0 + s * (d[3] / 6.0)));
}

static double slope_at(const double *d, double s)
{
    return d[1] + s * (d[2] + s * (d[3] / 2.0));
}

static double mean_between(const double *d, double a, double b)
{
    return (value_at(d, a) + 4.0 * value_at(d, 0.5 * (a + b)) + value_at(d, b)) / 6.0;
}

static void polynomial(double *d, double d0, double d1, double d2, double d3)
{
    d[0] = d0;
    d[1] = d1;
    d[2] = d2;
    d[3] = d3;
}

static void hermite(double *d, double v0, double s0, double v1, double s1, double h)
{
    const double mean = (v1 - v0) / h;
    const double d2 = 2.0 * (3.0 * mean - 2.0 * s0 - s1) / h;
    const double d3 = 6.0 * (s0 + s1 - 2.0 * mean) / h / h;
    polynomial(d, v0, s0, d2, d3);
}

/* Newton's divided differences through n <= 4 points, derivatives at point `at`. */
static void through(double *d, const double *times, const double *values, int n, int at)
{
    double f01, f12, f23, f012, f123, f0123, t, a, b, c;

    if (n == 1) {
        polynomial(d, values[0], 0.0, 0.0, 0.0);
        return;
    }
    f01 = (values[1] - values[0]) / (times[1] - times[0]);
    if (n == 2) {
        polynomial(d, values[at], f01, 0.0, 0.0);
        return;
    }
    f12 = (values[2] - values[1]) / (times[2] - times[1]);
    f012 = (f12 - f01) / (times[2] - times[0]);
    t = times[at];
    a = t - times[0];
    b = t - times[1];
    if (n == 3) {
        polynomial(d, values[at], f01 + f012 * (a + b), 2.0 * f012, 0.0);
        return;
    }
    f23 = (values[3] - values[2]) / (times[3] - times[2]);
    f123 = (f23 - f12) / (times[3] - times[1]);
    f0123 = (f123 - f012) / (times[3] - times[0]);
    c = t - times[2];
    polynomial(d, values[at], f01 + f012 * (a + b) + f0123 * (a * b + a * c + b * c),
               2.0 * f012 + 2.0 * f0123 * (a + b + c), 6.0 * f0123);
}

static void signal_begin(KernelSignal *s, int64_t tick, int edge)
{
    double *d = s->d, times[4];
    const double v = s->v0 = s->v1;

    s->s0 = s->s1;
    switch (s->kind) {
    case KIND_HERMITE:
        if (edge || s->h_last == 0.0) polynomial(d, v, s->s0, 0.0, 0.0);
        else polynomial(d, v, s->s0, d[2] + s->h_last * d[3], d[3]);
        break;
    case KIND_POINTS:
        for (int i = 0; i < s->n_past; ++i) times[i] = seconds(s->ticks[i] - tick);
        through(d, times, s->values, s->n_past, s->n_past - 1);
        if (edge) polynomial(d, v, d[1], 0.0, 0.0);
        break;
    case KIND_LINEAR:
        polynomial(d, v, s->h_last != 0.0 ? d[1] : 0.0, 0.0, 0.0);
        break;
    default:
        polynomial(d, v, 0.0, 0.0, 0.0);
    }
}

/* Value and slope at the end of the step [tick, end], computed or supposed. */
static void signal_know(KernelSignal *s, int64_t tick, double h, int edge, double value, double slope)
{
    double times[4], values[4];
    int n;

    s->v1 = value;
    s->s1 = slope;
    if (s->kind == KIND_HELD) return;
    if (s->kind == KIND_NEWEST) {
        s->d[0] = value; /* the others are zero since the step began */
        return;
    }
    if (edge && fabs(value - s->v0) > JUMP * fmax(s->peak, fabs(value))) {
        const double s1 = s->kind == KIND_HERMITE ? slope : 0.0;
        polynomial(s->d, value - h * s1, s1, 0.0, 0.0);
    } else if (edge || s->kind == KIND_LINEAR) {
        polynomial(s->d, s->v0, (value - s->v0) / h, 0.0, 0.0);
    } else if (s->kind == KIND_HERMITE) {
        hermite(s->d, s->v0, s->s0, value, slope, h);
    } else {
        const int skip = s->n_past > 3 ? s->n_past - 3 : 0;
        n = s->n_past - skip;
        for (int i = 0; i < n; ++i) {
            times[i] = seconds(s->ticks[skip + i] - tick);
            values[i] = s->values[skip + i];
        }
        times[n] = h;
        values[n] = value;
        through(s->d, times, values, n + 1, n - 1);
    }
}

static void signal_accept(KernelSignal *s, int64_t end, double h, int edge)
{
    if (fabs(s->v1) > s->peak) s->peak = fabs(s->v1);
    s->h_last = edge ? 0.0 : h;
    if (s->kind != KIND_POINTS) return;
    if (edge) {
        s->n_past = 0;
    } else if (s->n_past == 4) {
        memmove(s->ticks, s->ticks + 1, 3 * sizeof s->ticks[0]);
        memmove(s->values, s->values + 1, 3 * sizeof s->values[0]);
        s->n_past = 3;
    }
    s->ticks[s->n_past] = end;
    s->values[s->n_past] = s->v1;
    ++s->n_past;
}

#endif
