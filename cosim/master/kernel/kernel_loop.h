#ifndef INTERAREA_KERNEL_LOOP_H
#define INTERAREA_KERNEL_LOOP_H
/* secant.py, line by line. `work` holds n n + 6 n doubles: the inverse, residual,
 * move, image, row, supposed values, present residual. */
#include <string.h>

typedef struct {
    double *inverse, *residual, *move, *image, *row, *x, *r;
    int n, started;
} Secant;

static Secant secant_of(double *work, int n)
{
    double *vectors = work + n * n;
    Secant s = {work, vectors, vectors + n, vectors + 2 * n, vectors + 3 * n, vectors + 4 * n,
                vectors + 5 * n, n, 0};

    for (int i = 0; i < n; ++i)
        for (int j = 0; j < n; ++j) s.inverse[i * n + j] = i == j ? 1.0 : 0.0;
    return s;
}

/* The next x given the residual r at the present one. */
static void secant_correct(Secant *s)
{
    const int n = s->n;
    double *inverse = s->inverse, denominator = 0.0;

    if (s->started) {
        for (int i = 0; i < n; ++i) {
            double total = 0.0;
            for (int j = 0; j < n; ++j) total += inverse[i * n + j] * (s->residual[j] - s->r[j]);
            s->image[i] = total;
        }
        for (int i = 0; i < n; ++i) denominator += s->move[i] * s->image[i];
        if (denominator != 0.0) {
            for (int j = 0; j < n; ++j) {
                double total = 0.0;
                for (int i = 0; i < n; ++i) total += s->move[i] * inverse[i * n + j];
                s->row[j] = total;
            }
            for (int i = 0; i < n; ++i) {
                const double factor = (s->move[i] - s->image[i]) / denominator;
                for (int j = 0; j < n; ++j) inverse[i * n + j] += factor * s->row[j];
            }
        }
    }
    for (int i = 0; i < n; ++i) {
        double total = 0.0;
        for (int j = 0; j < n; ++j) total += inverse[i * n + j] * s->r[j];
        s->move[i] = total;
    }
    memcpy(s->residual, s->r, (size_t)n * sizeof(double));
    s->started = 1;
    for (int i = 0; i < n; ++i) s->x[i] += s->move[i];
}

#endif
