/* Factors as wide as the processor can. */
#include "sparse_factor.h"

#include "sparse_rows.h"

size_t sparse_factor(double *memory, const Plan *plan, const Pattern *s, size_t lanes, SparseRows which, double *w)
{
#ifdef SPARSE_HAS_FOUR
    if (lanes >= 4) return sparse_factor_4(memory, plan, s, which, w);
#endif
    (void)lanes;
    return factor_rows(memory, plan, s, which, w);
}
