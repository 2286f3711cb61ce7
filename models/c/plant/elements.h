#ifndef INTERAREA_ELEMENTS_H
#define INTERAREA_ELEMENTS_H
#include "scalar.h"
/* All that the generated device code calls (devices.h); models/devices/elements.py has
 * the same equations for Python. Non-windup limits, moving ones too, mean here:
 *
 * - the output never shows a state beyond its limit;
 * - at or beyond a limit the state moves only inwards; what a step of the solver or a
 *   moving limit left beyond it goes back to it with the element's time constant;
 * - it leaves the limit when its input lies inside (lag) or its rate points inwards
 *   (integrator, rate-limited lag). */

#ifdef PLANT_LANES
#define REAL(a) NUM(a)
#else
#define REAL(a) (a)
#endif

/* Devices of one kind and one structure. Tables and states lie quantity by quantity. */
typedef struct {
    const stored *table;   /* rows x n                                                 */
    const stored *machine; /* n: the machine of each                                   */
    size_t n;
    uint64_t has;          /* which of the optional parts are there                    */
} DeviceGroup;

/* One entry for each machine. */
typedef struct {
    const cell *vt, *vd, *vq, *id, *iq, *pe, *slip, *ifd;
    const stored *pref_step; /* added to the governors' load reference                 */
    cell *vc, *vs, *pm, *efd; /* what devices give                                     */
} DeviceSignals;

static inline num element_min(num a, num b) { return num_pick(num_above(a, b), b, a); }
static inline num element_max(num a, num b) { return num_pick(num_above(b, a), b, a); }
static inline num element_abs(num a) { return num_pick(num_above(NUM(0.0), a), -a, a); }
static inline num element_square(num a) { return a * a; }
static inline num element_clamp(num a, num low, num high)
{
    return num_pick(num_above(low, a), low, num_pick(num_above(a, high), high, a));
}
static inline num element_deadband(num a, num width) { return a - element_clamp(a, -width, width); }

/* T dx/dt of a lag with limits. */
static inline num element_lag_rate(num u, num x, num low, num high)
{
    const flag above = num_above(u, high) & num_reaches(x, high);
    const flag below = num_above(low, u) & num_reaches(low, x);
    return num_pick(above, high, num_pick(below, low, u)) - x;
}

/* dx/dt of a state with limits whose rate would be `rate`; y is x within the limits. */
static inline num element_held_rate(num rate, num x, num y, num low, num high, real per_T)
{
    const flag above = num_reaches(x, high) & num_above(rate, NUM(0.0));
    const flag below = num_reaches(low, x) & num_above(NUM(0.0), rate);
    return num_pick(above | below, (y - x) * per_T, rate);
}

/* The integral of a PI element stands while the whole pushes outwards. */
static inline num element_pi_rate(num rate, num whole, num low, num high)
{
    const flag above = num_above(whole, high) & num_above(rate, NUM(0.0));
    const flag below = num_above(low, whole) & num_above(NUM(0.0), rate);
    return num_pick(above | below, NUM(0.0), rate);
}

static inline num element_sqrt(num a) { return num_sqrt(element_max(a, NUM(0.0))); }
static inline num element_sin(num a) { num s, c; num_sincos(a, &s, &c); return s; }
static inline num element_cos(num a) { num s, c; num_sincos(a, &s, &c); return c; }

/* E SE(E) = B (E - A)^2 above A, the scaled quadratic of PSS/E, and its inverse with KE E. */
static inline num element_vx(num e, num a, num b)
{
    return num_pick(num_above(e, a), b * (e - a) * (e - a), NUM(0.0));
}

static inline num element_vx_inverse(num f, num ke, num a, num b)
{
    const num linear = num_ratio(f, ke);
    const num root = num_sqrt(element_max(ke * ke + 4.0 * b * (f - ke * a), NUM(0.0)));
    const flag bent = num_above(b, NUM(0.0)) & num_above(linear, a);
    const num per = num_pick(num_above(b, NUM(0.0)), 2.0 * b, NUM(1.0));
    return num_pick(bent, a + num_ratio(root - ke, per), linear);
}

/* Regulation of a rectifier, continuous: 1/sqrt 3, sqrt 3/4 and sqrt 3 as they are, where
 * the standard prints 0.577, 0.433, 1.732.                                 [IEEE4215, annex D] */
static inline num element_fex(num n)
{
    const num first = 1.0 - n * 0.57735026918962576, third = 1.7320508075688772 * (1.0 - n);
    const num second = element_sqrt(0.75 - n * n);
    const num upper = num_pick(num_above(NUM(0.75), n), second,
                               num_pick(num_above(NUM(1.0), n), third, NUM(0.0)));
    return num_pick(num_above(n, NUM(0.0)), num_pick(num_reaches(NUM(0.43301270189221932), n), first, upper),
                    num_pick(num_reaches(NUM(0.0), n), NUM(1.0), NUM(0.0)));
}

/* One piece of a table: y1 + (u - x1) slope where u reaches x1, else what came before. */
static inline num element_piece(num before, num u, num x1, num y1, num slope)
{
    return num_pick(num_reaches(u, x1), y1 + (u - x1) * slope, before);
}

#if !defined PLANT_TANGENT && !defined PLANT_LANES
/* What `_prepare` needs: done once, so divisions cost nothing later. */
static inline double element_per(double T) { return T > 0.0 ? 1.0 / T : 0.0; }

static inline double element_vx_slope(double E1, double S1, double E2, double S2)
{
    const double root1 = sqrt(S1 * E1 > 0.0 ? S1 * E1 : 0.0), root2 = sqrt(S2 * E2 > 0.0 ? S2 * E2 : 0.0);
    const double slope = E2 != E1 ? (root2 - root1) / (E2 - E1) : 0.0;
    return slope > 0.0 ? slope : 0.0;
}

static inline double element_vx_a(double E1, double S1, double E2, double S2)
{
    const double slope = element_vx_slope(E1, S1, E2, S2);
    return slope > 0.0 ? E1 - sqrt(S1 * E1 > 0.0 ? S1 * E1 : 0.0) / slope : 0.0;
}

static inline double element_vx_b(double E1, double S1, double E2, double S2)
{
    const double slope = element_vx_slope(E1, S1, E2, S2);
    return slope * slope;
}
#endif
#endif
