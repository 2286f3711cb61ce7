#ifndef INTERAREA_RUNGE_KUTTA_H
#define INTERAREA_RUNGE_KUTTA_H
/* The classical Runge-Kutta method of order 4, in steps of equal length between events: the one
 * integrator of FMUs, of lanes side by side and of closed loops, so that all give the same bits.
 *
 * Written over RK_NUM: double, or several doubles side by side. There RK_MOVED(h, moved, x) picks
 * `x` for the lanes that have nothing to do.                                               */
#include <math.h>
#include <stddef.h>

#include "block.h"

#ifndef RK_NUM
#define RK_NUM double
#define RK_MOVED(h, moved, x) (moved)
#endif

/* How fast a mode lambda a step h can follow: |h lambda| of a decay without swing up to this, */
static const double RUNGE_KUTTA_DECAY = 2.785;
/* and none of the left half plane beyond this: |1 + z + z^2/2 + z^3/6 + z^4/24| > 1 there. */
static const double RUNGE_KUTTA_REACH = 2.97;

/* Where in a step dx/dt is asked for. */
typedef enum { RK_BEGIN, RK_MIDDLE, RK_MIDDLE_AGAIN, RK_END } RungeKuttaStage;

/* dx/dt at `stage` of a step over h, at the states x, into k. */
typedef BlockStatus RungeKuttaFlow(void *context, RungeKuttaStage stage, RK_NUM h, const RK_NUM *x, RK_NUM *k);

/* Slopes of the later stages of a step of n states over h from x, where the first are known.
 * work: 5 n numbers, the slopes of the stages and the states there. */
static inline BlockStatus runge_kutta_rest(RungeKuttaFlow *flow, void *context, size_t n, RK_NUM h, const RK_NUM *x,
                                           RK_NUM *work)
{
    RK_NUM *k1 = work, *k2 = k1 + n, *k3 = k2 + n, *k4 = k3 + n, *at = k4 + n;
    BlockStatus status;

    for (size_t i = 0; i < n; ++i) at[i] = x[i] + h / 2.0 * k1[i];
    if ((status = flow(context, RK_MIDDLE, h, at, k2)) != BLOCK_OK) return status;
    for (size_t i = 0; i < n; ++i) at[i] = x[i] + h / 2.0 * k2[i];
    if ((status = flow(context, RK_MIDDLE_AGAIN, h, at, k3)) != BLOCK_OK) return status;
    for (size_t i = 0; i < n; ++i) at[i] = x[i] + h * k3[i];
    return flow(context, RK_END, h, at, k4);
}

/* All slopes. */
static inline BlockStatus runge_kutta_stages(RungeKuttaFlow *flow, void *context, size_t n, RK_NUM h, const RK_NUM *x,
                                             RK_NUM *work)
{
    const BlockStatus status = flow(context, RK_BEGIN, h, x, work);
    return status == BLOCK_OK ? runge_kutta_rest(flow, context, n, h, x, work) : status;
}

/* The step from its slopes. */
static inline void runge_kutta_move(size_t n, RK_NUM h, RK_NUM *x, const RK_NUM *work)
{
    const RK_NUM *k1 = work, *k2 = k1 + n, *k3 = k2 + n, *k4 = k3 + n;

    for (size_t i = 0; i < n; ++i)
        x[i] = RK_MOVED(h, x[i] + h / 6.0 * (k1[i] + 2.0 * (k2[i] + k3[i]) + k4[i]), x[i]);
}

/* Steps of at most `longest` that fill `length`; what rounding adds to a whole number is none. */
static inline long runge_kutta_count(double length, double longest)
{
    const double needed = ceil(length / longest - 1e-9);
    return needed < 1.0 ? 1 : (long)needed;
}
#endif
