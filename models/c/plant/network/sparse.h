#ifndef INTERAREA_SPARSE_H
#define INTERAREA_SPARSE_H
#include "../numbers/layout.h"
#include "../numbers/scalar.h"
/* The network of a large grid: A = Y with the machines' and loads' admittances, factored as L U with U of
 * unit diagonal. Order and places of all entries are made once, in models/grid/sparse_pattern.py, and stay
 * the same for every switching state; rows are numbered so that those no current enters come first.
 *
 * The pattern is one array of the record, the parts one after the other:
 *
 *   row            row of each bus                              n_bus
 *   machine        row of each machine                          n_machine
 *   lower          first entry of each row of L                 n_node + 1
 *   needed         first entry that a solution needs            n_node
 *   upper          first entry of each row of U                 n_node + 1
 *   lower_column, upper_column                                  n_fill each
 *   branch         places of (from, to) and (to, from) in the factors: entry of L, or n_fill + entry of U
 *   port           row of each port                             n_port
 *   gap            places of (air gap, bus) and (bus, air gap) of each machine with a port
 *
 * Nodes are the buses and, of each machine with a port (port.h), its air gap: there its EMF acts behind
 * j (Xd2 - Xl), and Ra + j Xl lead to its bus. `machine` is the row where the EMF acts.
 *
 * With ports A is Y less the slopes of what they inject, in real and imaginary parts: entries are 2 x 2.
 * Structure is symmetric, values are not (phase shifters). Nobody pivots: the diagonal carries the loads
 * and machines; topology.c checks a residual after each factorisation. */
typedef struct {
    const int32_t *row, *machine, *lower, *needed, *upper, *lower_column, *upper_column, *branch, *port, *gap;
} Pattern;

static inline size_t pattern_size(const Plan *p)
{
    return p->n_bus + p->n_machine + 3 * p->n_node + 2 + 2 * p->n_fill + 2 * p->n_branch + p->n_port
           + 2 * (p->n_node - p->n_bus);
}

/* Where the pattern lies: `at` bytes into the record, memory[H_PATTERN]; null for a dense network. */
static inline const int32_t *plant_places(const Record *record, double at)
{
    return at > 0.0 ? (const int32_t *)(const void *)(record->bytes + (size_t)at) : NULL;
}

static inline Pattern pattern_of(const int32_t *at, const Plan *p)
{
    Pattern s = { NULL, NULL, NULL, NULL, NULL, NULL, NULL, NULL, NULL, NULL };
    if (at == NULL) return s;
    s.row = at;
    s.machine = s.row + p->n_bus;
    s.lower = s.machine + p->n_machine;
    s.needed = s.lower + p->n_node + 1;
    s.upper = s.needed + p->n_node;
    s.lower_column = s.upper + p->n_node + 1;
    s.upper_column = s.lower_column + p->n_fill;
    s.branch = s.upper_column + p->n_fill;
    s.port = s.branch + 2 * p->n_branch;
    s.gap = s.port + p->n_port;
    return s;
}

/* sum a_k v[column_k]. What the real and the imaginary part of an entry multiply is summed apart, and every
 * other entry: the loads and sums go in pairs, and an addition need not wait for the one before. */
static inline void sparse_row(const real *a, const int32_t *column, size_t count, const num *v,
                              num *re, num *im)
{
    num r0 = NUM(0.0), s0 = NUM(0.0), p0 = NUM(0.0), q0 = NUM(0.0);
    num r1 = NUM(0.0), s1 = NUM(0.0), p1 = NUM(0.0), q1 = NUM(0.0);
    size_t k = 0;

    for (; k + 2 <= count; k += 2, a += 4) {
        const num *v0 = v + 2 * column[k], *v1 = v + 2 * column[k + 1];
        r0 += a[0] * v0[0];
        s0 += a[0] * v0[1];
        p0 += a[1] * v0[0];
        q0 += a[1] * v0[1];
        r1 += a[2] * v1[0];
        s1 += a[2] * v1[1];
        p1 += a[3] * v1[0];
        q1 += a[3] * v1[1];
    }
    if (k < count) {
        const num *v0 = v + 2 * column[k];
        r0 += a[0] * v0[0];
        s0 += a[0] * v0[1];
        p0 += a[1] * v0[0];
        q0 += a[1] * v0[1];
    }
    *re = (r0 + r1) - (q0 + q1);
    *im = (s0 + s1) + (p0 + p1);
}

/* The same with entries of 2 x 2 real numbers: products with the real and the imaginary part are summed apart. */
static inline void sparse_row_4(const real *a, const int32_t *column, size_t count, const num *v,
                                num *re, num *im)
{
    num r0 = NUM(0.0), q0 = NUM(0.0), i0 = NUM(0.0), p0 = NUM(0.0);
    num r1 = NUM(0.0), q1 = NUM(0.0), i1 = NUM(0.0), p1 = NUM(0.0);
    size_t k = 0;

    for (; k + 2 <= count; k += 2, a += 8) {
        const num *v0 = v + 2 * column[k], *v1 = v + 2 * column[k + 1];
        r0 += a[0] * v0[0];
        q0 += a[1] * v0[1];
        i0 += a[2] * v0[0];
        p0 += a[3] * v0[1];
        r1 += a[4] * v1[0];
        q1 += a[5] * v1[1];
        i1 += a[6] * v1[0];
        p1 += a[7] * v1[1];
    }
    if (k < count) {
        const num *v0 = v + 2 * column[k];
        r0 += a[0] * v0[0];
        q0 += a[1] * v0[1];
        i0 += a[2] * v0[0];
        p0 += a[3] * v0[1];
    }
    *re = (r0 + r1) + (q0 + q1);
    *im = (i0 + i1) + (p0 + p1);
}

/* Row k of v = L^-1 b, where nothing enters the rows before plan->first unless the solution is `whole`. */
static inline void sparse_forward_row(const real *memory, const Plan *plan, const Pattern *s, int whole, size_t k,
                                      const num *b, num *v)
{
    const size_t width = plan->width, from = (size_t)(whole ? s->lower[k] : s->needed[k]), to = (size_t)s->lower[k + 1];
    const real *lower = memory + plan->lower + width * from, *d = memory + plan->pivot + width * k;
    num re, im;

    if (width == 2) sparse_row(lower, s->lower_column + from, to - from, v, &re, &im);
    else sparse_row_4(lower, s->lower_column + from, to - from, v, &re, &im);
    re = b[2 * k] - re;
    im = b[2 * k + 1] - im;
    v[2 * k] = width == 2 ? d[0] * re - d[1] * im : d[0] * re + d[1] * im;
    v[2 * k + 1] = width == 2 ? d[0] * im + d[1] * re : d[2] * re + d[3] * im;
}

/* Row k of v = U^-1 y, the rows after it done. */
static inline void sparse_backward_row(const real *memory, const Plan *plan, const Pattern *s, size_t k, const num *y,
                                       num *v)
{
    const size_t from = (size_t)s->upper[k], to = (size_t)s->upper[k + 1];
    const real *upper = memory + plan->upper + plan->width * from;
    num re, im;

    if (plan->width == 2) sparse_row(upper, s->upper_column + from, to - from, v, &re, &im);
    else sparse_row_4(upper, s->upper_column + from, to - from, v, &re, &im);
    v[2 * k] = y[2 * k] - re;
    v[2 * k + 1] = y[2 * k + 1] - im;
}

/* All rows, or those that the slopes of the ports change: the others are as they were. */
typedef enum { SPARSE_ALL, SPARSE_PATH } SparseRows;

#if defined __x86_64__ && !defined PLANT_DENSE
#define SPARSE_HAS_FOUR   /* sparse_4.c, for processors with AVX2 */
size_t sparse_factor_4(double *memory, const Plan *plan, const Pattern *s, SparseRows which, double *w);
void sparse_forward_4(const double *memory, const Plan *plan, const Pattern *s, size_t first, double *v);
void sparse_backward_4(const double *memory, const Plan *plan, const Pattern *s, size_t first, size_t last, double *v);
#endif

/* v = L^-1 v from row `first` on; nothing enters the rows before. lanes: width of the tiles (tiles.h). */
static inline void sparse_forward(const real *memory, const Plan *plan, const Pattern *s, size_t lanes, size_t first,
                                  num *v)
{
#if defined SPARSE_HAS_FOUR && !defined PLANT_TANGENT && !defined PLANT_LANES
    if (lanes >= 4) {
        sparse_forward_4(memory, plan, s, first, v);
        return;
    }
#endif
    (void)lanes;
    for (size_t k = first; k < plan->n_node; ++k) sparse_forward_row(memory, plan, s, first == 0, k, v, v);
}

/* v = U^-1 v for the rows last - 1 down to first; those from `last` on are done. */
static inline void sparse_backward(const real *memory, const Plan *plan, const Pattern *s, size_t lanes, size_t first,
                                   size_t last, num *v)
{
#if defined SPARSE_HAS_FOUR && !defined PLANT_TANGENT && !defined PLANT_LANES
    if (lanes >= 4) {
        sparse_backward_4(memory, plan, s, first, last, v);
        return;
    }
#endif
    (void)lanes;
    for (size_t k = last; k-- > first;) sparse_backward_row(memory, plan, s, k, v, v);
}
#endif
