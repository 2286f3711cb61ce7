/* Linear controller with limited outputs:
 *
 *     dx/dt = A x + B u,    v = C x + D u,    y_i = min(max(v_i, -limit), limit)
 *
 * The matrices are parameters of the FMU, rows first, in the order A, B, C, D,
 * limit. A limited output does not move with its arguments: its directional
 * derivative is zero. On the limit itself the inner side is taken.           */
#include <math.h>
#include <stdio.h>
#include <string.h>

#include "../block/block.h"

const int block_is_sampled = 0;

typedef struct { const double *A, *B, *C, *D; double limit; } Gains;

static Gains gains_of(const Block *b)
{
    const size_t n = b->layout.n_x, m = b->layout.n_u, p = b->layout.n_y;
    Gains g;
    g.A = b->p;
    g.B = g.A + n * n;
    g.C = g.B + n * m;
    g.D = g.C + p * n;
    g.limit = g.D[p * m];
    return g;
}

/* out = M x + N u */
static void multiply(const double *M, const double *N, size_t rows, size_t n, size_t m,
                     const double *x, const double *u, double *out)
{
    for (size_t i = 0; i < rows; ++i) {
        double sum = 0.0;
        for (size_t j = 0; j < n; ++j) sum += M[i * n + j] * x[j];
        for (size_t j = 0; j < m; ++j) sum += N[i * m + j] * u[j];
        out[i] = sum;
    }
}

BlockStatus block_needs(const Record *record, const BlockLayout *layout, BlockNeeds *needs,
                        BlockMessage *message)
{
    const size_t n = layout->n_x, m = layout->n_u, p = layout->n_y;

    (void)record;
    if (layout->n_p != n * n + n * m + p * n + p * m + 1 || layout->n_iu + layout->n_ip > 0) {
        snprintf(message->text, sizeof message->text,
                 "controller: %zu states, %zu inputs and %zu outputs do not go with %zu parameters", n, m, p,
                 layout->n_p);
        return BLOCK_ERROR;
    }
    needs->n_memory = 0;
    needs->n_scratch = p;
    return BLOCK_OK;
}

BlockStatus block_start(Block *b, double t, BlockMessage *message)
{
    (void)t;
    if (!(gains_of(b).limit > 0.0)) {
        snprintf(message->text, sizeof message->text, "controller: limit is %g, it must be positive",
                 gains_of(b).limit);
        return BLOCK_ERROR;
    }
    return BLOCK_OK;
}

BlockStatus block_derivatives(Block *b, double t, const double *x, const double *u, double *dx,
                              BlockMessage *message)
{
    const Gains g = gains_of(b);

    (void)t, (void)message;
    multiply(g.A, g.B, b->layout.n_x, b->layout.n_x, b->layout.n_u, x, u, dx);
    return BLOCK_OK;
}

BlockStatus block_outputs(Block *b, double t, const double *x, const double *u, double *y,
                          BlockMessage *message)
{
    const Gains g = gains_of(b);

    (void)t, (void)message;
    multiply(g.C, g.D, b->layout.n_y, b->layout.n_x, b->layout.n_u, x, u, y);
    for (size_t i = 0; i < b->layout.n_y; ++i)
        y[i] = y[i] > g.limit ? g.limit : y[i] < -g.limit ? -g.limit : y[i];
    return BLOCK_OK;
}

BlockStatus block_directional(Block *b, double t, const double *x, const double *u, const double *vx,
                              const double *vu, double *vdx, double *vy, BlockMessage *message)
{
    const Gains g = gains_of(b);
    const size_t n = b->layout.n_x, m = b->layout.n_u, p = b->layout.n_y;

    (void)t, (void)message;
    if (vdx != NULL) multiply(g.A, g.B, n, n, m, vx, vu, vdx);
    if (vy != NULL) {
        multiply(g.C, g.D, p, n, m, vx, vu, vy);
        multiply(g.C, g.D, p, n, m, x, u, b->scratch);
        for (size_t i = 0; i < p; ++i)
            if (fabs(b->scratch[i]) > g.limit) vy[i] = 0.0;
    }
    return BLOCK_OK;
}

double block_next_event(const Block *b, double t)
{
    (void)b, (void)t;
    return INFINITY;
}

BlockStatus block_event(Block *b, double t, double *x, BlockMessage *message)
{
    (void)b, (void)t, (void)x, (void)message;
    return BLOCK_OK;
}

BlockStatus block_step(Block *b, double t, double h, const double *u_poly, double *dy, BlockMessage *message)
{
    (void)b, (void)t, (void)h, (void)u_poly, (void)dy;
    snprintf(message->text, sizeof message->text, "controller: not a sampled block");
    return BLOCK_ERROR;
}
