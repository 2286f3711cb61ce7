#ifndef INTERAREA_SCALAR_H
#define INTERAREA_SCALAR_H
/* The scalar `num` of the physics. The device equations are written once over
 * `num` and compiled several times: as double (the flow); with PLANT_TANGENT as
 * double complex with a tiny imaginary part (the complex step), which carries
 * exact directional derivatives, f(x + i h v) = f(x) + i h f'(x) v; and with
 * PLANT_LANES as several scenarios side by side (lanes.h), or with PLANT_TILE as
 * several devices of one scenario (tile.h). `real` is what tables give: double, or
 * one double for each scenario or device; `stored` and `cell` are what an entry of
 * a table or of an array of `num` is in memory. A condition on numbers is a
 * `flag` and chooses with num_pick; what a table says about the structure (a time
 * constant that is zero) is the same in every scenario and is read with FIRST.
 *
 * Nothing here calls libm except sqrt, which IEEE 754 rounds correctly, so the
 * same inputs give the same bits on every platform.                          */
#include <math.h>
#include <stddef.h>
#include <stdint.h>
#include <string.h>

#if defined PLANT_TANGENT
#include <complex.h>
typedef double complex num;
typedef double real;
typedef int flag;
#define NAME(f) f##_tangent
#define PART(a) creal(a)     /* what comparisons look at */
#define SLOPE(a) cimag(a)
#elif !defined PLANT_LANES
typedef double num;
typedef double real;
typedef int flag;
#ifndef NAME
#define NAME(f) f
#endif
#define PART(a) (a)
#endif

static inline uint64_t real_bits(double a)
{
    uint64_t bits;
    memcpy(&bits, &a, sizeof bits);
    return bits;
}

static inline double real_of_bits(uint64_t bits)
{
    double a;
    memcpy(&a, &bits, sizeof a);
    return a;
}

#define E_NAME(f) real_##f
#define E_NUM double
#define E_WORD uint64_t
#define E_ALL(a) (a)
#define E_PICK(c, a, b) ((c) ? (a) : (b))
#define E_BITS(a) real_bits(a)
#define E_OF(w) real_of_bits(w)
#include "elementary.h"

#if defined PLANT_LANES
#include "lanes.h"   /* NUM, FIRST, flags and the functions below for several scenarios */
#else

typedef num cell;
typedef real stored;
#define NUM(a) ((num)(a))
#define FIRST(a) (a)
static inline flag num_above(num a, num b) { return PART(a) > PART(b); }
static inline flag num_reaches(num a, num b) { return PART(a) >= PART(b); }
static inline num num_pick(flag c, num a, num b) { return c ? a : b; }
static inline flag flag_not(flag c) { return !c; }
static inline int flag_any(flag c) { return c; }

#ifdef PLANT_TANGENT

static inline num with_slope(double value, double slope)
{
    const double parts[2] = { value, slope };   /* C99 6.2.5: a complex is an array of two */
    num z;
    memcpy(&z, parts, sizeof z);
    return z;
}

static inline void num_sincos(num x, num *s, num *c)
{
    double sv, cv;
    real_sincos(creal(x), &sv, &cv);
    *s = with_slope(sv, cv * cimag(x));
    *c = with_slope(cv, -sv * cimag(x));
}

static inline num num_sqrt(num x)
{
    const double v = sqrt(creal(x));
    return with_slope(v, v > 0.0 ? 0.5 * cimag(x) / v : 0.0);
}

static inline num num_exp(num x)
{
    const double v = real_exp(creal(x));
    return with_slope(v, v * cimag(x));
}

static inline num num_log(num x) { return with_slope(real_log(creal(x)), cimag(x) / creal(x)); }

static inline num num_ratio(num a, num b)
{
    const double v = creal(a) / creal(b);
    return with_slope(v, (cimag(a) - v * cimag(b)) / creal(b));
}

#else

static inline void num_sincos(num x, num *s, num *c) { real_sincos(x, s, c); }
static inline num num_sqrt(num x) { return sqrt(x); }
static inline num num_exp(num x) { return real_exp(x); }
static inline num num_log(num x) { return real_log(x); }
static inline num num_ratio(num a, num b) { return a / b; }

#endif
#endif

/* What a table holds, the same in every scenario. */
static inline double first_at(const stored *memory, size_t at)
{
#ifdef PLANT_TILE
    return memory[at];
#else
    return FIRST(memory[at]);
#endif
}

static inline size_t index_at(const stored *memory, size_t at) { return (size_t)(ptrdiff_t)first_at(memory, at); }

/* Entry k of an array (AT, PUT) and that of an index which a table holds (OF, TO): of a tile the entries
 * from k on. EACH goes through first .. last - 1, of which a tile needs as many as it is wide: the last
 * tile goes back over entries that the one before has done. */
#ifdef PLANT_TILE
typedef struct { size_t at[PLANT_LANES]; } where;

static inline num num_at(const double *a)
{
    num v;
    memcpy(&v, a, sizeof v);
    return v;
}

static inline num num_of(const double *a, where w)
{
    num v = { 0.0 };
    for (size_t i = 0; i < PLANT_LANES; ++i) v[i] = a[w.at[i]];
    return v;
}

static inline void num_to(double *a, where w, num v)
{
    for (size_t i = 0; i < PLANT_LANES; ++i) a[w.at[i]] = v[i];
}

static inline where where_at(const double *table, size_t k)
{
    where w;
    for (size_t i = 0; i < PLANT_LANES; ++i) w.at[i] = (size_t)(ptrdiff_t)table[k + i];
    return w;
}

static inline size_t next_of(size_t k, size_t last)
{
    const size_t next = k + PLANT_LANES;
    return next < last && next + PLANT_LANES > last ? last - PLANT_LANES : next;
}

#define AT(a, k) num_at((a) + (k))
#define PUT(a, k, v) put_at((a) + (k), v)
#define OF(a, w) num_of(a, w)
#define TO(a, w, v) num_to(a, w, v)
#define SPREAD(a) NUM(a)
static inline void put_at(double *a, num v) { memcpy(a, &v, sizeof v); }
#else
typedef size_t where;
#define where_at(table, k) index_at(table, k)
#define next_of(k, last) ((k) + 1)
#define AT(a, k) ((a)[k])
#define PUT(a, k, v) ((a)[k] = (v))
#define OF(a, w) ((a)[w])
#define TO(a, w, v) ((a)[w] = (v))
#define SPREAD(a) (a)
#endif
#define EACH(k, first, last) for (size_t k = (first); k < (last); k = next_of(k, last))

static inline flag flag_all(void) { return num_reaches(NUM(0.0), NUM(0.0)); }

static inline num num_clamp(num a, real low, real high)
{
    return num_pick(num_above(NUM(low), a), NUM(low), num_pick(num_above(a, NUM(high)), NUM(high), a));
}

/* Angle of x + j y, -pi to pi, to about 2 ulp, 0 of nothing: half of it by a square root, three times more
 * halved, then the series of the arctangent, whose remainder is below 1e-18 there. */
static inline num num_angle(num y, num x)
{
    const num size = num_sqrt(x * x + y * y), behind = num_pick(num_above(NUM(0.0), x), -x, x);
    const flag nonzero = num_above(size, NUM(0.0));
    num t = num_ratio(y, num_pick(nonzero, size + behind, NUM(1.0)));
    for (int k = 0; k < 3; ++k) t = num_ratio(t, 1.0 + num_sqrt(1.0 + t * t));
    const num q = t * t;
    const num tail = q * (-1.0 / 3 + q * (1.0 / 5 + q * (-1.0 / 7 + q * (1.0 / 9 + q * (-1.0 / 11
        + q * (1.0 / 13 + q * (-1.0 / 15 + q * (1.0 / 17))))))));
    const num angle = 16.0 * (t + t * tail);
    const num turn = num_pick(num_above(NUM(0.0), y), NUM(-3.14159265358979312), NUM(3.14159265358979312));
    return num_pick(num_above(NUM(0.0), x), turn - angle, angle);
}
#endif
