#ifndef INTERAREA_SPARSE_FACTOR_H
#define INTERAREA_SPARSE_FACTOR_H
#include "sparse.h"

/* Factors the matrix that lies in its places (sparse.h), row by row. With ports: the linear matrix less
 * the slopes in memory. Returns n_node, or the row whose pivot vanishes. lanes: width of the tiles (tiles.h).
 * w: 4 n_node doubles. */
size_t sparse_factor(double *memory, const Plan *plan, const Pattern *pattern, size_t lanes, SparseRows which, double *w);
#endif
