#ifndef INTERAREA_CLOSED_LOOP_H
#define INTERAREA_CLOSED_LOOP_H
/* A plant, its controller and the channels between them in one block that has
 * no inputs: the whole closed loop, stepped inside one FMU.
 *
 * Plant and controller are one system of ordinary differential equations,
 * integrated together by the classical Runge-Kutta method: between them there
 * is no delay at all. A channel is stepped from one inner communication point
 * to the next and drawn between them as the cubic through values and slopes at
 * both ends. Where its latency covers the step, what it gives depends on the
 * past only; where it does not, the step is repeated until what the channel was
 * told agrees with what the plant did.
 *
 * Inner communication points, in whole nanoseconds whatever steps the tool
 * takes: every `loop.step` from the start; every event of the plant and every
 * beginning and end of an outage; these again one latency later; and 1 ns before
 * each of them, so that what a signal was just before a jump and just after are
 * both known. Across such a nanosecond signals are straight lines. And every
 * instant at which a packet comes out of a channel: its output is held between.
 * A supervisor sees a flag of validity at the instant at which it changes.       */
#include <stdint.h>
#include "../block/limited_step.h"
#include "member.h"

enum { LOOP_MEMBERS = 24, LOOP_MARKS = 4096, LOOP_EVENTS = 256, LOOP_SWEEPS = 50 };
enum { LOOP_ARRAYS = LIMITED_STEP_ARRAYS };   /* of n_x in `work` */
enum { KIND_PLANT = 0, KIND_CONTROLLER = 1, KIND_CHANNEL = 2, KIND_SUPERVISOR = 3, KIND_COUNT = 4 };

/* Head of `memory`; then what the record says of the loop, read once. */
enum {
    M_ORIGIN, M_LAST_EVENT, M_LAST_LENGTH, M_MARK_COUNT, M_SWITCHES_COST,
#ifdef LOOP_DRAWN
    M_DRAWN,                /* longest step of a run that is only looked at, s; 0: of an exact run */
#endif
    M_MARKS
};

typedef struct {
    int kind;
    int direct;                             /* whether its outputs reach another member within a step */
    BlockLayout layout;
    size_t record, size, entries;           /* its record: where in the outer one, bytes, how many entries */
    size_t n_memory, n_notes, n_decisions;
} LoopMemberPlan;

typedef struct {
    size_t count;                           /* 0: not read yet */
    size_t n_scratch;                       /* of the member that needs most */
    size_t wire, flag;                      /* where in the record */
    size_t solver;                          /* parameter that holds the plant's longest step */
    int64_t step;                           /* ns */
    double internal_step;                   /* the controllers' longest Runge-Kutta step, s */
    double plants_step;                     /* the plant's as the record has it */
    LoopMemberPlan member[LOOP_MEMBERS];
} LoopPlan;

enum {
    LOOP_PLAN = M_MARKS + LOOP_MARKS,
    LOOP_SAVED = LOOP_PLAN + (sizeof(LoopPlan) + sizeof(double) - 1) / sizeof(double)
};

/* The block of this binary taken apart; lives for one call. */
typedef struct {
    Block *outer;
    const LoopPlan *plan;
    size_t count;
    int kind[LOOP_MEMBERS];
    const MemberKind *member[LOOP_MEMBERS];
    Record record[LOOP_MEMBERS];
    Block block[LOOP_MEMBERS];
    int u_order[LOOP_MEMBERS];              /* of a channel's one input                  */
    size_t first_u[LOOP_MEMBERS], first_y[LOOP_MEMBERS], first_x[LOOP_MEMBERS];
    size_t first_iu[LOOP_MEMBERS], first_note[LOOP_MEMBERS], first_decision[LOOP_MEMBERS];
    size_t n_x, n_u, n_y, n_iu, n_iy;       /* of all members together                   */
    size_t n_notes, n_decisions;            /* of all members' limiters                  */
    size_t n_memory, n_scratch;             /* what the outer block needs                */
    const int32_t *wire;                    /* per input: the output that feeds it, or -1 */
    const int32_t *flag;                    /* the same of integer inputs and outputs    */
    int64_t step;                           /* ns                                        */
    double internal_step;                   /* longest Runge-Kutta step, s (longest_step) */
    double *slope, *bend;                   /* SAVED per output: 1st; 2nd and 3rd derivative */
    double *state;                          /* SAVED x of all members, one after the other */
    double *members;                        /* SAVED u, integer inputs, memory of each member */
    size_t n_members;
    int settled;                            /* whether `work` begins with the slopes of the states as they are */
    int plain, between;                     /* of a page's runs (drawn_step.h)           */
    size_t source[LOOP_MEMBERS];
    /* scratch */
    BlockLimits *limits;                    /* of the evaluation under way, or null      */
    double *saved, *saved_state, *saved_iy, *poly, *y0, *slope0, *work, *overruns;
} ClosedLoop;

/* Whether a member is a plant, or what controls it. */
static inline int loop_is(const ClosedLoop *l, size_t k, int plant)
{
    return plant ? l->kind[k] == KIND_PLANT : l->kind[k] == KIND_CONTROLLER || l->kind[k] == KIND_SUPERVISOR;
}

#endif
