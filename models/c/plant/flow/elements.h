#ifndef INTERAREA_ELEMENTS_H
#define INTERAREA_ELEMENTS_H
#include "notes.h"
/* All that the generated device code calls (devices.h); models/devices/language/elements.py has
 * the same equations for Python. Non-windup limits, moving ones too, mean here:
 *
 * - the output never shows a state beyond its limit;
 * - at or beyond a limit the state moves only inwards; what a step of the solver or a
 *   moving limit left beyond it goes back to it with the element's time constant;
 * - it leaves the limit when its input lies inside (lag) or its rate points inwards
 *   (integrator, rate-limited lag). */

#if defined PLANT_LANES && !defined PLANT_ALIKE
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
    Notes notes;           /* of their decisions                                       */
} DeviceGroup;

/* One entry for each machine and device at a bus. */
typedef struct {
    const cell *vt, *vd, *vq, *id, *iq, *pe, *slip, *ifd;
    const stored *pref_step; /* added to the governors' load reference                 */
    cell *vc, *vs, *pm, *efd, *vl, *b, *i, *ip, *idc, *delta, *ip1; /* what devices give         */
    const cell *p, *q, *p_mod, *q_mod; /* of a converter: in the arrays of pe, ifd, vs, vc    */
    const cell *vdr, *vdi; /* of a dc link: in the arrays of vt, pe                           */
    const cell *vr, *vi;   /* of a converter and a source: in the arrays of vd, vq            */
    const cell *v1, *p1, *v2, *p2; /* of a link of converters: in the arrays of vt, pe, vd, vq */
    const cell *ir, *ii;   /* of a source: in the arrays of id, iq                            */
    const cell *vreg, *vdrop, *pbr, *qbr; /* of a plant control: in the arrays of efd, pm, id, iq */
    const cell *q_mod1, *q_mod2; /* of a link of converters: in the arrays of vc, vm          */
} DeviceSignals;

/* Limiters, gates and other slope discontinuities decide by comparing signals: decision i of a device is bit i of
 * its word, from 64 on of its second one. A step of the solver in which a word changes is done again (block/limited_step.h) with
 * the decisions held as they were at its begin, up to where the first no longer fits. PLANT_HELD
 * compiles that: what a decision would be does not matter there, but `enter` is above 0 where one
 * that is held off no longer fits, `leave` where one that is held on does not. */
#if defined PLANT_LANES
typedef word Decisions;
#else
typedef uint64_t Decisions;
#endif
typedef struct {
    Decisions bits;
#ifdef PLANT_HELD
    double worst, *each;
#endif
} Limiters;

#ifdef PLANT_HELD
static inline int limiter_is(const Limiters *l, unsigned i) { return (int)(l->bits >> i & 1u); }

static inline flag limiter(Limiters *l, unsigned i, flag natural, num enter, num leave)
{
    const double overrun = limiter_is(l, i) ? leave : enter;
    (void)natural;
    if (overrun > l->worst) l->worst = overrun;
    if (l->each != NULL) l->each[i] = overrun;
    return limiter_is(l, i);
}
#else
static inline flag limiter(Limiters *l, unsigned i, flag natural, num enter, num leave)
{
    (void)enter, (void)leave;
#ifdef PLANT_LANES
    l->bits |= (word)natural & ((uint64_t)1 << i);
#else
    l->bits |= (uint64_t)(natural != 0) << i;
#endif
    return natural;
}
#endif

/* The first or second word (0, 1) of device k before it decides, and what becomes of it after. */
static inline Limiters limiters_begin(const DeviceGroup *g, size_t k, size_t word)
{
#ifdef PLANT_HELD
    double *each = g->notes.each != NULL ? g->notes.each + k * g->notes.most + 64 * word : NULL;
    const Limiters l = { real_bits(g->notes.words[k + word * g->notes.second]), -1e300, each };
#else
    const Limiters l = { (Decisions){ 0 } };
    (void)g, (void)k, (void)word;
#endif
    return l;
}

static inline void limiters_end(const DeviceGroup *g, size_t k, size_t word, const Limiters *l)
{
#if defined PLANT_HELD
    (void)k, (void)word;
    if (l->worst > *g->notes.worst) *g->notes.worst = l->worst;
#elif defined PLANT_TANGENT
    (void)g, (void)k, (void)word, (void)l;
#else
    const Notes *notes = &g->notes;
    if (notes->words == NULL) return;
    cell *at = notes->words + k + word * notes->second;
    if (notes->switched == NULL) {
        memcpy(at, &l->bits, sizeof l->bits);
        return;
    }
    Decisions before;
    memcpy(&before, at, sizeof before);
#if !defined PLANT_LANES
    if (before != l->bits) *notes->switched = 1.0;
#elif defined PLANT_TILE
    for (size_t i = 0; i < PLANT_LANES; ++i)
        if (before[i] != l->bits[i]) *notes->switched = 1.0;
#else
    *notes->switched = num_pick((flag)(before != l->bits), NUM(1.0), *notes->switched);
#endif
#endif
}

/* a > b, a >= b as decision i. */
static inline flag limiter_above(Limiters *l, unsigned i, num a, num b)
{
    return limiter(l, i, num_above(a, b), a - b, b - a);
}
static inline flag limiter_reaches(Limiters *l, unsigned i, num a, num b)
{
    return limiter(l, i, num_reaches(a, b), a - b, b - a);
}

/* Without a word: of parameters, and where a device's decisions do not depend on it. */
static inline num element_min(num a, num b) { return num_pick(num_above(a, b), b, a); }
static inline num element_max(num a, num b) { return num_pick(num_above(b, a), b, a); }
static inline num element_abs(num a) { return num_pick(num_above(NUM(0.0), a), -a, a); }
static inline num element_square(num a) { return a * a; }
static inline num element_clamp(num a, num low, num high)
{
    return num_pick(num_above(low, a), low, num_pick(num_above(a, high), high, a));
}
static inline num element_deadband(num a, num width) { return a - element_clamp(a, -width, width); }

/* The same with decisions from i on: 1, 1, 1, 2, 2. */
static inline num limiter_min(Limiters *l, unsigned i, num a, num b) { return num_pick(limiter_above(l, i, a, b), b, a); }
static inline num limiter_max(Limiters *l, unsigned i, num a, num b) { return num_pick(limiter_above(l, i, b, a), b, a); }
static inline num limiter_abs(Limiters *l, unsigned i, num a)
{
    return num_pick(limiter_above(l, i, NUM(0.0), a), -a, a);
}
/* What passes between two limits. Where they coincide nothing moves: there the slope is that of what is held. */
static inline num limiter_between(num a, num held, num low, num high)
{
#ifdef PLANT_TANGENT
    return num_pick(num_above(high, low), a, held);
#else
    (void)held, (void)low, (void)high;
    return a;
#endif
}
static inline num limiter_clamp(Limiters *l, unsigned i, num a, num low, num high)
{
    const flag below = limiter_above(l, i, low, a), above = limiter_above(l, i + 1, a, high);
    return num_pick(below, low, num_pick(above, high, limiter_between(a, low, low, high)));
}
/* A band without width does nothing and decides nothing. */
static inline num limiter_deadband(Limiters *l, unsigned i, num a, num width)
{
    const flag wide = num_above(width, NUM(0.0)), below = num_above(-width, a), above = num_above(a, width);
    const num no = NUM(-1e300);
    const flag low = limiter(l, i, below & wide, num_pick(wide, -width - a, no), num_pick(wide, a + width, no));
    const flag high = limiter(l, i + 1, above & wide, num_pick(wide, a - width, no), num_pick(wide, width - a, no));
    return num_pick(wide, a - num_pick(low, -width, num_pick(high, width, a)), a - element_clamp(a, -width, width));
}

/* A state within its limits, decisions i .. i + 3: outside while it is free, low, outside while it
 * is free, high; held at the lower limit, at the upper one. Both of the last are made with its rate. */
static inline num limiter_state(Limiters *l, unsigned i, num x, num low, num high)
{
#ifdef PLANT_HELD
    if (limiter_is(l, i + 2)) return low;
    if (limiter_is(l, i + 3)) return high;
#endif
    return limiter_clamp(l, i, x, low, high);
}

/* At a limit it does not matter on which side of it rounding has put the state. */
static inline void limiter_forget(Limiters *l, unsigned i, flag held)
{
#if defined PLANT_HELD
    (void)l, (void)i, (void)held;
#elif defined PLANT_LANES
    l->bits &= ~((word)held & ((uint64_t)3 << i));
#else
    if (held) l->bits &= ~((uint64_t)3 << i);
#endif
}

/* T dx/dt of a lag with limits. */
static inline num limiter_lag_rate(Limiters *l, unsigned i, num u, num x, num low, num high)
{
    const flag at_low = num_above(low, u) & num_reaches(low, x), at_high = num_above(u, high) & num_reaches(x, high);
    const flag below = limiter(l, i + 2, at_low & flag_not(at_high), element_min(low - u, low - x), u - low);
    const flag above = limiter(l, i + 3, at_high, element_min(u - high, x - high), high - u);
    limiter_forget(l, i, below | above);
    return num_pick(above, high, num_pick(below, low, limiter_between(u, low, low, high))) - x;
}

/* dx/dt of a state with limits whose rate would be `rate`. On a limit its slope is that of beyond: it is held. */
static inline num limiter_held_rate(Limiters *l, unsigned i, num rate, num x, num low, num high, real per_T)
{
    const flag at_low = num_reaches(low, x) & num_above(NUM(0.0), rate);
    const flag at_high = num_reaches(x, high) & num_above(rate, NUM(0.0));
    const flag below = limiter(l, i + 2, at_low, element_min(low - x, -rate), rate);
    const flag above = limiter(l, i + 3, at_high, element_min(x - high, rate), -rate);
    limiter_forget(l, i, below | above);
    return num_pick(above | below, (num_pick(above, high, low) - x) * per_T,
                    limiter_between(rate, NUM(0.0), low, high));
}

/* The integral of a PI element stands while the whole pushes outwards: decisions i, i + 1. */
static inline num limiter_pi_rate(Limiters *l, unsigned i, num rate, num whole, num low, num high)
{
    const flag out_low = num_above(low, whole) & num_above(NUM(0.0), rate);
    const flag out_high = num_above(whole, high) & num_above(rate, NUM(0.0));
    const flag below = limiter(l, i, out_low, element_min(low - whole, -rate), element_max(whole - low, rate));
    const flag above = limiter(l, i + 1, out_high, element_min(whole - high, rate), element_max(high - whole, -rate));
    return num_pick(above | below, NUM(0.0), rate);
}

/* A state that is held goes exactly onto its limit where it is behind it, which moves, or where rounding
 * left it. Beyond a limit that falls it follows with its own time constant. */
#ifdef PLANT_HELD
static inline void limiter_onto(const Limiters *l, unsigned i, double *x, double low, double high)
{
    const double slack = 1e-7;
    if (limiter_is(l, i + 2) && *x > low - slack * (1.0 + fabs(low))) *x = low;
    if (limiter_is(l, i + 3) && *x < high + slack * (1.0 + fabs(high))) *x = high;
}
#define LIMITER_ONTO(l, i, g, at, low, high) do { \
    if ((g)->notes.onto != NULL) limiter_onto(l, i, (g)->notes.onto + (at), low, high); \
} while (0)
#else
#define LIMITER_ONTO(l, i, g, at, low, high) ((void)0)
#endif

/* f over the devices of a group: of kinds that are mostly alone once more for one, whose places are known then. */
#if defined __GNUC__ && !defined PLANT_TANGENT && !defined PLANT_LANES && !defined PLANT_HELD && !defined __wasm__
#define DEVICE_COPIED inline __attribute__((always_inline))
#define DEVICE_FEW(f, g, ...) ((g)->n == 1 ? f(1, g, __VA_ARGS__) : f((g)->n, g, __VA_ARGS__))
#else
#define DEVICE_COPIED inline
#define DEVICE_FEW(f, g, ...) f((g)->n, g, __VA_ARGS__)
#endif

static inline num element_sqrt(num a) { return num_sqrt(element_max(a, NUM(0.0))); }
static inline num element_sin(num a) { num s, c; num_sincos(a, &s, &c); return s; }
static inline num element_cos(num a) { num s, c; num_sincos(a, &s, &c); return c; }

/* E SE(E) = B (E - A)^2 above A, the scaled quadratic of PSS/E, and its inverse with KE E. */
static inline num limiter_vx(Limiters *l, unsigned i, num e, num a, num b)
{
    const flag bends = num_above(b, NUM(0.0));
    const flag bent = limiter(l, i, num_above(e, a) & bends, num_pick(bends, e - a, NUM(-1e300)), a - e);
    return num_pick(bent, b * (e - a) * (e - a), NUM(0.0));
}

static inline num limiter_vx_inverse(Limiters *l, unsigned i, num f, num ke, num a, num b)
{
    const num linear = num_ratio(f, ke);
    const num root = num_sqrt(element_max(ke * ke + 4.0 * b * (f - ke * a), NUM(0.0)));
    const flag bends = num_above(b, NUM(0.0));
    const flag bent = limiter(l, i, num_above(linear, a) & bends, num_pick(bends, linear - a, NUM(-1e300)), a - linear);
    const num per = num_pick(bends, 2.0 * b, NUM(1.0));
    return num_pick(bent, a + num_ratio(root - ke, per), linear);
}

/* Regulation of a rectifier, continuous: 1/sqrt 3, sqrt 3/4 and sqrt 3 as they are, where
 * the standard prints 0.577, 0.433, 1.732.                                 [IEEE4215, annex D] */
static inline num limiter_fex(Limiters *l, unsigned i, num n)
{
    const num first = 1.0 - n * 0.57735026918962576, third = 1.7320508075688772 * (1.0 - n);
    const num second = element_sqrt(0.75 - n * n);
    const flag loaded = limiter_above(l, i, n, NUM(0.0)), light = limiter_reaches(l, i + 1, NUM(0.43301270189221932), n);
    const flag middle = limiter_above(l, i + 2, NUM(0.75), n), heavy = limiter_above(l, i + 3, NUM(1.0), n);
    const num upper = num_pick(middle, second, num_pick(heavy, third, NUM(0.0)));
    return num_pick(loaded, num_pick(light, first, upper), num_pick(num_reaches(n, n), NUM(1.0), NUM(0.0)));
}

/* One piece of a table: y1 + (u - x1) slope where u reaches x1, else what came before. */
static inline num limiter_piece(Limiters *l, unsigned i, num before, num u, num x1, num y1, num slope)
{
    return num_pick(limiter_reaches(l, i, u, x1), y1 + (u - x1) * slope, before);
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
