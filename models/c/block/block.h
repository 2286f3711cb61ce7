#ifndef INTERAREA_BLOCK_H
#define INTERAREA_BLOCK_H
/* The contract between a block (plant, controller, channel) and whatever runs
 * it: the FMI layer, a test shim, a batch driver. A block kind is one
 * translation unit that defines the functions below; one kind is linked into
 * one binary.
 *
 * A block owns no globals, opens no file, allocates nothing and keeps no
 * pointer between calls. Everything that can change during a run lies in the
 * arrays of `Block` marked SAVED, so saving and restoring an FMU state is
 * copying these arrays.                                                      */
#include <stddef.h>
#include "record.h"

#ifdef __cplusplus
extern "C" {
#endif

enum { BLOCK_MESSAGE_SIZE = 256, BLOCK_INPUT_ORDER = 3 };

typedef enum {
    BLOCK_OK = 0,
    BLOCK_DISCARD = 1,   /* the step cannot be computed, the state before it is intact */
    BLOCK_ERROR = 2      /* message says what, where, got, allowed                      */
} BlockStatus;

/* Set by the callee on any status other than BLOCK_OK; with BLOCK_OK a text, which the caller had made empty,
 * is a remark for whoever keeps a log (block_start, block_event). */
typedef struct { char text[BLOCK_MESSAGE_SIZE]; } BlockMessage;

/* How many of each variable the block has: the order of the value references.
 * Reals:    states, derivatives, inputs, outputs, locals, parameters.
 * Integers (Integer, Enumeration, Boolean): inputs, outputs, locals, parameters. */
typedef struct {
    size_t n_x, n_u, n_y, n_w, n_p;
    size_t n_iu, n_iy, n_iw, n_ip;
} BlockLayout;

/* How limiters are to be taken, for a runner that locates the instants at which they switch
 * (limited_step.h). They switch where they are asked to, and */
typedef enum {
    LIMITS_NOTE,    /* what they are at is noted                                         */
    LIMITS_WATCH,   /* `switched` is set where one is at something else than was noted   */
    LIMITS_HOLD     /* they do not switch but stay at what was noted, if need be beyond their range */
} LimitMode;
typedef struct {
    LimitMode mode;
    int switched;
    double worst;   /* LIMITS_HOLD: set to by how much a limiter is beyond its range at least, if it is more */
    int stage;      /* from 1, a stage of a step asks: far below the step's own error is close enough */
    int alone;      /* set to 1 by a block that never goes side by side with others (block_group.h): how often it is
                     * asked may then change its last bits */
    double *onto;   /* LIMITS_HOLD: states, of which those at a limit are put onto it, or null */
    double *each;   /* LIMITS_HOLD: by how much each of the block's n_decisions is beyond its range, or null;
                     * those that a device does not make are left as they are */
} BlockLimits;

typedef struct {
    const Record *record;   /* read-only data of the case or design            */
    BlockLayout layout;
    double *x;              /* SAVED states                                    */
    double *dx;             /* SAVED derivatives as last computed              */
    double *u;              /* SAVED inputs at the current time                */
    double *y;              /* SAVED outputs as last computed                  */
    double *w;              /* SAVED locals as last computed                   */
    double *p;              /* SAVED parameters                                */
    int *iu, *iy, *iw, *ip; /* SAVED integer variables                         */
    int *u_order;           /* SAVED per input of a sampled block: the highest derivative
                             * that was handed over for the coming step, 0 = value only */
    double *memory;         /* SAVED discrete state of n_memory doubles        */
    double *scratch;        /* n_scratch doubles; contents mean nothing between calls */
    double *notes;          /* n_notes doubles: written with LIMITS_NOTE                */
    BlockLimits *limits;    /* of the coming call of block_derivatives, null: nothing is noted */
    size_t lanes;           /* of this machine, from block_start; 0: one number in each operation */
} Block;

/* What the runner must provide besides the variables; read from the record,
 * checked once at instantiation (sizes that disagree with the layout, unknown
 * format: BLOCK_ERROR). What the block does not set is 0. n_warm: so many numbers at the end of memory are written
 * by evaluations as well, the others by block_start and block_event only (and all by block_step). */
typedef struct { size_t n_memory, n_scratch, n_notes, n_decisions, n_warm; } BlockNeeds;
BlockStatus block_needs(const Record *record, const BlockLayout *layout,
                        BlockNeeds *needs, BlockMessage *message);

/* Leaves initialization mode: checks parameters and prepares memory. x holds
 * the start values; the block may overwrite states that follow from parameters. */
BlockStatus block_start(Block *b, double t, BlockMessage *message);

/* dx/dt and, in one pass, nothing else. Called 4 times per Runge-Kutta step. */
BlockStatus block_derivatives(Block *b, double t, const double *x,
                              const double *u, double *dx, BlockMessage *message);

/* Outputs y, locals w (into b->w, unless that is null: nobody asks) and integer outputs (b->iy, b->iw). */
BlockStatus block_outputs(Block *b, double t, const double *x,
                          const double *u, double *y, BlockMessage *message);

/* Derivative of (dx, y) at (t, x, u) in the direction (vx, vu), exact to
 * rounding. Either result pointer may be null. */
BlockStatus block_directional(Block *b, double t, const double *x, const double *u,
                              const double *vx, const double *vu,
                              double *vdx, double *vy, BlockMessage *message);

/* Time of the first event strictly after t; INFINITY if there is none.
 * Events at the start time are handled by block_start. */
double block_next_event(const Block *b, double t);

/* Handles every event at time t exactly (as block_next_event returned it).
 * May change x, memory. */
BlockStatus block_event(Block *b, double t, double *x, BlockMessage *message);

/* Blocks that live on communication points (channels). The runner calls this
 * instead of integrating when block_is_sampled is nonzero.
 * `u_poly[4*i + k]` is the k-th time derivative at t of real input i over the
 * step [t, t+h] (k = 0 is the value). On return b->y and the integer outputs
 * hold their values at t+h and `dy[i]` the first time derivative of output i
 * there. A zero-length call (h = 0) at the start of a run gives the outputs
 * at the initial time. */
extern const int block_is_sampled;
BlockStatus block_step(Block *b, double t, double h, const double *u_poly,
                       double *dy, BlockMessage *message);

#ifdef __cplusplus
}
#endif
#endif
