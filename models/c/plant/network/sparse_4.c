/* Factors and solutions of a sparse network, four numbers of an entry in one operation: for processors with AVX2. The
 * operations are those of sparse.h and sparse_rows.h in the same order, hence the same bits. */
#include <math.h>
#include <stddef.h>
#include <stdint.h>
#include <string.h>

#include "../../block/block.h"

#if defined __x86_64__ && !defined PLANT_DENSE
#if defined __clang__
#pragma clang attribute push(__attribute__((target("avx2"))), apply_to = function)
#else
#pragma GCC target("avx2")
#endif
#define SPARSE_FOUR
typedef double four __attribute__((vector_size(32)));
/* Real and imaginary part. One store writes both: a load of both right after two stores would wait for them. */
typedef double two __attribute__((vector_size(16)));

static inline four four_at(const double *a)
{
    four f;
    memcpy(&f, a, sizeof f);
    return f;
}

static inline void put_four(double *to, four f) { memcpy(to, &f, sizeof f); }
static inline four twice(const double *a) { return (four){ a[0], a[1], a[0], a[1] }; }

static inline two two_at(const double *a)
{
    two t;
    memcpy(&t, a, sizeof t);
    return t;
}

static inline void put_two(double *to, two t) { memcpy(to, &t, sizeof t); }
/* What products with the real part of v give and those with its imaginary one, of an entry of either width. */
static inline two whole_complex(four f) { return (two){ f[0], f[3] } + (two){ -1.0, 1.0 } * (two){ f[1], f[2] }; }
static inline two whole_block(four f) { return (two){ f[0], f[2] } + (two){ f[1], f[3] }; }

#include "sparse_rows.h"

/* sparse_row: products with the real part of the entry and with the imaginary one, of both parts of v. */
static inline four row_complex(const double *a, const int32_t *column, size_t count, const double *v)
{
    four even = { 0.0, 0.0, 0.0, 0.0 }, odd = even;
    size_t k = 0;

    for (; k + 2 <= count; k += 2, a += 4) {
        const double *v0 = v + 2 * column[k], *v1 = v + 2 * column[k + 1];
        even += twice(a) * (four){ v0[0], v0[1], v0[1], v0[0] };
        odd += twice(a + 2) * (four){ v1[0], v1[1], v1[1], v1[0] };
    }
    if (k < count) {
        const double *v0 = v + 2 * column[k];
        even += twice(a) * (four){ v0[0], v0[1], v0[1], v0[0] };
    }
    return even + odd;
}

/* sparse_row_4. */
static inline four row_block(const double *a, const int32_t *column, size_t count, const double *v)
{
    four even = { 0.0, 0.0, 0.0, 0.0 }, odd = even;
    size_t k = 0;

    for (; k + 2 <= count; k += 2, a += 8) {
        even += four_at(a) * twice(v + 2 * column[k]);
        odd += four_at(a + 4) * twice(v + 2 * column[k + 1]);
    }
    if (k < count) even += four_at(a) * twice(v + 2 * column[k]);
    return even + odd;
}

void sparse_forward_4(const double *memory, const Plan *plan, const Pattern *s, size_t first, double *v)
{
    const size_t width = plan->width;
    const double *lower = memory + plan->lower, *d = memory + plan->pivot + width * first;

    for (size_t k = first; k < plan->n_node; ++k, d += width) {
        const size_t from = (size_t)(first == 0 ? s->lower[k] : s->needed[k]), count = (size_t)s->lower[k + 1] - from;
        if (width == 2) {
            const two b = two_at(v + 2 * k) - whole_complex(row_complex(lower + 2 * from, s->lower_column + from, count, v));
            put_two(v + 2 * k, (two){ d[0], d[0] } * b + (two){ -d[1], d[1] } * (two){ b[1], b[0] });
        } else {
            const two b = two_at(v + 2 * k) - whole_block(row_block(lower + 4 * from, s->lower_column + from, count, v));
            put_two(v + 2 * k, whole_block(four_at(d) * (four){ b[0], b[1], b[0], b[1] }));
        }
    }
}

void sparse_backward_4(const double *memory, const Plan *plan, const Pattern *s, size_t first, size_t last, double *v)
{
    const size_t width = plan->width;
    const double *upper = memory + plan->upper;

    for (size_t k = last; k-- > first;) {
        const size_t from = (size_t)s->upper[k], count = (size_t)s->upper[k + 1] - from;
        const int32_t *column = s->upper_column + from;
        const two sum = width == 2 ? whole_complex(row_complex(upper + 2 * from, column, count, v))
                                   : whole_block(row_block(upper + 4 * from, column, count, v));
        put_two(v + 2 * k, two_at(v + 2 * k) - sum);
    }
}

size_t sparse_factor_4(double *memory, const Plan *plan, const Pattern *s, SparseRows which, double *w)
{
    return factor_rows(memory, plan, s, which, w);
}
#if defined __clang__
#pragma clang attribute pop
#endif
#else
typedef int NoFour;   /* a translation unit is not empty */
#endif
