#include "pattern.h"

#include <math.h>

enum { SIZES = 3, MOST = 256 };

int patterns_of(const Record *record, size_t signals, Patterns *patterns)
{
    size_t n_sizes, n_all, n_others, rows;
    const int32_t *sizes = record_i32(record, "pattern.size", &n_sizes);

    patterns->signals = signals;
    patterns->frames = 0;
    if (sizes == NULL) return 1;
    patterns->all = record_f64(record, "pattern.all", &n_all);
    patterns->others = record_f64(record, "pattern.others", &n_others);
    if (n_sizes != SIZES || sizes[0] < 1 || sizes[1] < 1 || sizes[2] < 1 || sizes[0] > MOST || sizes[1] > MOST
        || sizes[0] * sizes[1] > MOST || patterns->all == NULL || patterns->others == NULL || signals < 3)
        return 0;
    patterns->frames = (size_t)sizes[0];
    patterns->samples = (size_t)sizes[1];
    patterns->size = (size_t)sizes[2];
    rows = signals * patterns->samples;
    return patterns->size <= rows && n_all == rows * patterns->size
           && n_others == signals * (rows - patterns->samples) * patterns->size;
}

/* Adds the squares of x between two rows to `left`. */
static double with_squares(const double *x, size_t from, size_t to, double left)
{
    for (size_t r = from; r < to; ++r) left += x[r] * x[r];
    return left;
}

/* Adds the products with x between two rows to `sum`; column: of V, its first row that of `from`. */
static double with_products(const double *column, size_t size, const double *x, size_t from, size_t to, double sum)
{
    for (size_t r = from; r < to; ++r, column += size) sum += *column * x[r];
    return sum;
}

double pattern_left(const Patterns *patterns, const double *x, size_t i)
{
    const size_t L = patterns->samples, rows = patterns->signals * L, size = patterns->size;
    const int whole = i >= patterns->signals;
    const size_t end = whole ? rows : i * L, again = whole ? rows : end + L;   /* the rows of i are left out */
    const double *V = whole ? patterns->all : patterns->others + i * (rows - L) * size;
    double left = with_squares(x, again, rows, with_squares(x, 0, end, 0.0));

    for (size_t k = 0; k < size; ++k) {
        const double before = with_products(V + k, size, x, 0, end, 0.0);
        const double sum = with_products(V + end * size + k, size, x, again, rows, before);
        left -= sum * sum;
    }
    return sqrt(fmax(left, 0.0));
}
