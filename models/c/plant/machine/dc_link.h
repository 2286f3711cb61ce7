#ifndef INTERAREA_DC_LINK_H
#define INTERAREA_DC_LINK_H
#include "../numbers/layout.h"
#include "../numbers/scalar.h"
/* The two ends of a dc link with line-commutated converters.       [Kundur1994, sec. 10.2, 10.4]
 *
 * With the dc current i, u the voltage of the bus that commutates, a the delay angle of the rectifier or the extinction
 * angle of the inverter, all on the base of the link (P_NO_LOAD: c, P_DROP: r),
 *
 *     v = c u cos(phi),   cos(phi) = cos(a) - r i/(c u),
 *     |I| = c i times the base of the link over that of the system (P_SCALE),
 *
 * so that the ac power is v i at any u, and both ends draw its tangent of phi as reactive power. The current is
 * -+ P_SCALE i cos(phi) along V and P_SCALE i sin(phi) across it. Below P_LOW the current falls with the voltage, and v
 * with it; cos(phi) stays off +-1, where a converter could not commutate.
 *
 *     rectifier   a = a_i + g (i - order)
 *     inverter    a = a_i + g (w/vref - 1 + m),   w = c u cos(a) - r i,   m = P_MARGIN_GAIN max(P_MARGIN order - i, 0)
 *
 * within P_ANGLE_MIN .. P_ANGLE_MAX; a_i, i and order are states. w holds a: Halley's method from a + b, which is not below
 * the solution of a + b (cos(g) - 1) there, b = g c u/vref, and the limits act on its solution. */

/* A link that is blocked carries no current at its ends, its control stands still, and its dc current dies away with
 * DC_BLOCK_S, the time in which a rectifier beyond 90 deg takes it down. */
static const double DC_BLOCK_S = 0.01;
static const double DC_COSINE_MIN = -0.99, DC_COSINE_MAX = 0.9999;
/* A step d of Halley's method leaves an error of .42 b d^3 at most, and what is left out of the cosine is d^4/24. */
static const double DC_SETTLED = 1e-14, DC_NEAR = 1e-4;
enum { DC_STEPS = 6 };   /* at most; with b up to 1 the fourth is below rounding */

static inline int dc_link_is_inverter(const real *row) { return index_at(row, P_COUPLING) == COUPLING_INVERTER; }

/* The rectifier's delay angle before its limits: current i, order and a_i. */
static inline num dc_link_delay(const real *row, num i, num order, num angle) { return angle + row[P_GAIN] * (i - order); }

/* The extinction angle before its limits, and its cosine: current i, order and a_i; u not below P_LOW. start: an angle near it, or
 * null. */
static inline num dc_link_extinction(const real *row, num i, num order, num angle, num u, const num *start, num *cosine)
{
    const num low = NUM(0.0), behind = row[P_MARGIN] * order - i;
    const num m = row[P_MARGIN_GAIN] * num_pick(num_above(behind, low), behind, low);
    const num per = num_ratio(NUM(row[P_GAIN]), NUM(row[P_VREF]));
    const num a = angle + row[P_GAIN] * (m - 1.0) - per * (row[P_DROP] * i), b = per * (row[P_NO_LOAD] * u);
    num g = start != NULL ? *start : num_clamp(a + b, row[P_ANGLE_MIN], row[P_ANGLE_MAX]);
    flag open = num_reaches(low, low);

    *cosine = low;
    for (int k = 0; k < DC_STEPS; ++k) {
        num sine, at;
        num_sincos(g, &sine, &at);
        const num off = g - a - b * at, slope = 1.0 + b * sine;
        const num d = num_ratio(2.0 * off * slope, 2.0 * slope * slope - off * (b * at));
        g = num_pick(open, g - d, g);
        *cosine = num_pick(open, at + d * (sine - d * (0.5 * at + d * (1.0 / 6.0) * sine)), *cosine);
#ifndef PLANT_TANGENT   /* whose slopes settle a step later */
        const num size = num_pick(num_above(low, d), -d, d);
        open = open & flag_not(num_reaches(NUM(DC_NEAR), size) & num_reaches(NUM(DC_SETTLED), b * size * size * size));
        if (!flag_any(open)) break;
#endif
    }
    return g;
}

static inline num dc_link_floor(const real *row, num v)
{
    const num low = NUM(row[P_LOW]);
    return num_pick(num_above(v, low), v, low);
}

/* cos(phi) from the cosine of an angle within its limits. */
static inline num dc_link_cosine(const real *row, num i, num cosine, num u)
{
    cosine = cosine - num_ratio(row[P_DROP] * i, row[P_NO_LOAD] * u);
    cosine = num_pick(num_above(NUM(DC_COSINE_MIN), cosine), NUM(DC_COSINE_MIN), cosine);
    return num_pick(num_above(cosine, NUM(DC_COSINE_MAX)), NUM(DC_COSINE_MAX), cosine);
}

/* cos(phi). What serves again at another u is kept: the inverter's angle, from which it starts, or the cosine of the rectifier's,
 * which does not depend on u. start: null, or what was kept. */
static inline num dc_link_phi(const real *row, const num *x, num u, const num *start, num *kept)
{
    const num i = x[index_at(row, P_STATE)], order = x[index_at(row, P_ORDER)], angle = x[index_at(row, P_STATE_Q)];
    const real least = row[P_ANGLE_MIN], most = row[P_ANGLE_MAX];
    num sine, cosine;

    if (dc_link_is_inverter(row)) {
        *kept = dc_link_extinction(row, i, order, angle, u, start, &cosine);
        const flag beyond = num_above(*kept, NUM(most)) | num_above(NUM(least), *kept);
        if (flag_any(beyond)) {
            num limited;
            num_sincos(num_clamp(*kept, least, most), &sine, &limited);
            cosine = num_pick(beyond, limited, cosine);
        }
    } else {
        if (start == NULL) num_sincos(num_clamp(dc_link_delay(row, i, order, angle), least, most), &sine, &cosine);
        else cosine = *start;
        *kept = cosine;
    }
    return dc_link_cosine(row, i, cosine, u);
}

/* Current into the network along and across V. */
static inline void dc_link_current(const real *row, const num *x, num v, num *along, num *across, num *kept)
{
    const num cosine = dc_link_phi(row, x, dc_link_floor(row, v), NULL, kept), size = row[P_SCALE] * x[index_at(row, P_STATE)];
    *along = dc_link_is_inverter(row) ? size * cosine : -(size * cosine);
    *across = size * num_sqrt(1.0 - cosine * cosine);
}

/* The dc voltage of this end. start: what dc_link_current kept at a voltage near v. */
static inline num dc_link_voltage(const real *row, const num *x, num v, const num *start)
{
    const num u = dc_link_floor(row, v);
    num kept;
#ifdef PLANT_TANGENT   /* whose slopes are those at v */
    start = NULL;
#endif
    return row[P_NO_LOAD] * num_ratio(v * v, u) * dc_link_phi(row, x, u, start, &kept);
}

#if !defined PLANT_TANGENT && !defined PLANT_LANES
typedef struct { double along, across; } DcEnd;

/* The current and its slopes by |V|, which angle and cos(phi) follow. x, stride: as of bus_device_slope. */
static inline void dc_link_slope(const double *row, const double *x, size_t stride, double v, DcEnd *end, double *along,
                                 double *across)
{
    const double u = v > row[P_LOW] ? v : row[P_LOW], b = row[P_GAIN] * row[P_NO_LOAD] * u / row[P_VREF];
    const double i = x == NULL ? row[P_REST_Q] : x[stride * index_at(row, P_STATE)];
    const double order = x == NULL ? 0.0 : x[stride * index_at(row, P_ORDER)], base = x == NULL ? 0.0 : x[stride * index_at(row, P_STATE_Q)];
    double ignored;
    const double free = x == NULL ? row[P_REST]
                        : dc_link_is_inverter(row) ? dc_link_extinction(row, i, order, base, u, NULL, &ignored)
                                                   : dc_link_delay(row, i, order, base);
    const double angle = num_clamp(free, row[P_ANGLE_MIN], row[P_ANGLE_MAX]), drop = row[P_DROP] * i / (row[P_NO_LOAD] * u);
    const double size = row[P_SCALE] * i, sign = dc_link_is_inverter(row) ? 1.0 : -1.0;
    double sine, cosine, turns = 0.0;

    num_sincos(angle, &sine, &cosine);
    if (dc_link_is_inverter(row) && angle == free) turns = b / u * cosine / (1.0 + b * sine);
    double slope = v > row[P_LOW] ? drop / u - sine * turns : 0.0;
    const double raw = cosine - drop, phi = dc_link_cosine(row, i, cosine, u);
    if (raw != phi) slope = 0.0;
    const double other = sqrt(1.0 - phi * phi);
    *end = (DcEnd){ sign * size * phi, size * other };
    *along = sign * size * slope;
    *across = -size * phi * slope / other;
}
#endif
#endif
