#ifndef INTERAREA_KERNEL_BROYDEN_H
#define INTERAREA_KERNEL_BROYDEN_H
/* Broyden of algebraic_loop.py, line by line. `work` holds n n + 6 n doubles: the inverse, residual,
 * step, predicted, row, supposed values, present residual. */
#include <string.h>

typedef struct {
    double *inverse, *residual, *step, *predicted, *row, *x, *r;
    int n, started;
} Broyden;

static Broyden broyden_of(double *work, int n)
{
    double *vectors = work + n * n;
    Broyden s = {work, vectors, vectors + n, vectors + 2 * n, vectors + 3 * n, vectors + 4 * n,
                vectors + 5 * n, n, 0};

    for (int i = 0; i < n; ++i)
        for (int j = 0; j < n; ++j) s.inverse[i * n + j] = i == j ? 1.0 : 0.0;
    return s;
}

/* The next x given the residual r at the present one. */
static void broyden_correct(Broyden *s)
{
    const int n = s->n;
    double *inverse = s->inverse, denominator = 0.0;

    if (s->started) {
        for (int i = 0; i < n; ++i) {
            double total = 0.0;
            for (int j = 0; j < n; ++j) total += inverse[i * n + j] * (s->residual[j] - s->r[j]);
            s->predicted[i] = total;
        }
        for (int i = 0; i < n; ++i) denominator += s->step[i] * s->predicted[i];
        if (denominator != 0.0) {
            for (int j = 0; j < n; ++j) {
                double total = 0.0;
                for (int i = 0; i < n; ++i) total += s->step[i] * inverse[i * n + j];
                s->row[j] = total;
            }
            for (int i = 0; i < n; ++i) {
                const double factor = (s->step[i] - s->predicted[i]) / denominator;
                for (int j = 0; j < n; ++j) inverse[i * n + j] += factor * s->row[j];
            }
        }
    }
    for (int i = 0; i < n; ++i) {
        double total = 0.0;
        for (int j = 0; j < n; ++j) total += inverse[i * n + j] * s->r[j];
        s->step[i] = total;
    }
    memcpy(s->residual, s->r, (size_t)n * sizeof(double));
    s->started = 1;
    for (int i = 0; i < n; ++i) s->x[i] += s->step[i];
}

#endif
