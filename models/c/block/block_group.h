#ifndef INTERAREA_BLOCK_GROUP_H
#define INTERAREA_BLOCK_GROUP_H
/* What a block kind may offer besides block.h: several blocks of one record side
 * by side, one in each lane of a processor's vectors. Every operation is that of
 * the block's own functions, so a lane has the bits that its block alone would have.
 *
 * Arrays hold the lane last, x[state * lanes + k], and are aligned to 64 bytes.
 * Lane 0 always belongs to a block; what the others hold while nobody has them
 * does not matter.                                                            */
#include "block.h"

typedef struct {
    const BlockLayout *layout;
    const Record *record;   /* that of every block                                */
    double *memory;         /* n_memory of each lane                              */
    double *shared;         /* n_memory that all lanes have in common, bit for bit but for its end; null: they differ */
    double *warm;           /* n_warm of each lane, in place of the end of memory: what evaluations change */
    size_t n_warm;
    double *x, *u, *y;
    double *k;              /* 5 x n_x: stages of a step; its first n_x are dx/dt  */
    double *scratch;        /* n_scratch of each lane                             */
    double *notes;          /* n_notes of each lane                               */
    double *switched;       /* a lane in which a limiter switches: 1, and x is as it was (limited_step.h) */
    double *h;              /* step of each lane, 0 where it has nothing to do    */
    const double *u_poly;   /* [4*i+k]: k-th derivative of input i, or null: u is constant */
    const double *begin;    /* time from which `elapsed` counts                   */
    const double *elapsed;  /* times of begin, middle and end of the step         */
} BlockGroup;

/* Lanes of the widest vectors that this processor has: 2, 4 or 8. */
size_t block_group_lanes(void);
/* Whether a started block can go beside others of its record. */
int block_group_fits(const Block *b);
/* Another number whenever evaluations have changed the rest of a block's memory, which they rarely do; 0 where they
 * have not since the last event. */
double block_group_stamp(const Block *b);
/* One step of the classical Runge-Kutta method in each lane; changes x, except in lanes `switched`. */
void block_group_step(const BlockGroup *g, size_t lanes);
/* Outputs y at x, and unless `rates` is 0 dx/dt at (x, u) into the first n_x of k. */
void block_group_outputs(const BlockGroup *g, size_t lanes, int rates);
#endif
