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
 * within P_ANGLE_MIN .. P_ANGLE_MAX; a_i, i and order are states. w holds a: Halley's method from the angle of the last
 * solution (port.h), or from a_i + g m, that where w is at vref: starts whose sines need no voltage. The limits act on
 * the solution. */

/* A link that is blocked carries no current at its ends, its control stands still, and its dc current dies away with
 * DC_BLOCK_S, the time in which a rectifier beyond 90 deg takes it down. */
static const double DC_BLOCK_S = 0.01;
static const double DC_COSINE_MIN = -0.99, DC_COSINE_MAX = 0.9999;
/* A step d of Halley's method leaves an error of .42 b d^3 at most. Up to DC_NEAR what dc_link_turn
 * leaves out is below d^5/120 = 3e-16. */
static const double DC_SETTLED = 1e-14, DC_NEAR = 0.002;
enum { DC_STEPS = 6 };   /* at most; with b up to 1 the fourth is below rounding */

/* What an end keeps while its network is solved. Of the rectifier the cosine within its limits, of the inverter the
 * solution: the same at another voltage, or near it. Then v and the slope of v at the ac voltage DC_AT. */
enum { DC_ANGLE, DC_SINE, DC_COSINE, DC_AT, DC_VOLTS, DC_RATE, DC_SOLVED };

/* What is known already: nothing; what is held, of the solution before (layout.h); or all that is kept, at another
 * voltage. */
typedef enum { DC_NOTHING, DC_START, DC_ALL } DcKnown;

static inline int dc_link_is_inverter(const real *row) { return index_at(row, P_COUPLING) == COUPLING_INVERTER; }

/* Whether d is more than the sine and the cosine of an angle may be turned by. */
static inline flag dc_link_far(num d) { return flag_not(num_reaches(NUM(DC_NEAR * DC_NEAR), d * d)); }

/* Where `open`, the angle in `solved` becomes `angle`, d from one whose sine and cosine are given. */
static inline void dc_link_turn(num angle, num d, num sine, num cosine, flag open, num *solved)
{
    const num q = d * d;
    const flag far = open & dc_link_far(d);
    const num s = 0.5 * sine + d * (cosine * (1.0 / 6)) - q * (sine * (1.0 / 24));
    const num c = 0.5 * cosine - d * (sine * (1.0 / 6)) - q * (cosine * (1.0 / 24));

    solved[DC_ANGLE] = num_pick(open, angle, solved[DC_ANGLE]);
    solved[DC_SINE] = num_pick(open, (sine + d * cosine) - q * s, solved[DC_SINE]);
    solved[DC_COSINE] = num_pick(open, (cosine - d * sine) - q * c, solved[DC_COSINE]);
    if (flag_any(far)) {
        num far_sine, far_cosine;
        num_sincos(angle, &far_sine, &far_cosine);
        solved[DC_SINE] = num_pick(far, far_sine, solved[DC_SINE]);
        solved[DC_COSINE] = num_pick(far, far_cosine, solved[DC_COSINE]);
    }
}

/* An angle to start from, with its sine and cosine. */
static inline void dc_link_begin(num angle, DcKnown known, const num *held, num *solved)
{
    if (known == DC_START) {
        dc_link_turn(angle, angle - held[DC_NEARBY], held[DC_NEARBY_SINE], held[DC_NEARBY_COSINE], flag_all(), solved);
        return;
    }
    solved[DC_ANGLE] = angle;
    num_sincos(angle, &solved[DC_SINE], &solved[DC_COSINE]);
}

/* What is kept of a solution is held where `keep` says so: sines turned again and again would drift away. */
static inline void dc_link_hold(flag keep, const num *solved, num *held)
{
    const flag far = keep & dc_link_far(solved[DC_ANGLE] - held[DC_NEARBY]);
    num sine, cosine;

    held[DC_LAST] = num_pick(keep, solved[DC_ANGLE], held[DC_LAST]);
    if (!flag_any(far)) return;
    num_sincos(solved[DC_ANGLE], &sine, &cosine);
    held[DC_NEARBY] = num_pick(far, solved[DC_ANGLE], held[DC_NEARBY]);
    held[DC_NEARBY_SINE] = num_pick(far, sine, held[DC_NEARBY_SINE]);
    held[DC_NEARBY_COSINE] = num_pick(far, cosine, held[DC_NEARBY_COSINE]);
}

/* Into `solved` the extinction angle before its limits: current i, order and a_i; u not below P_LOW. Returns b. */
static inline num dc_link_extinction(const real *row, num i, num order, num angle, num u, DcKnown known,
                                     const num *held, num *solved)
{
    const num low = NUM(0.0), behind = row[P_MARGIN] * order - i;
    const num m = row[P_MARGIN_GAIN] * num_pick(num_above(behind, low), behind, low);
    const num per = NUM(row[P_GAIN] * row[P_PER_VREF]);
    const num a = angle + row[P_GAIN] * (m - 1.0) - per * (row[P_DROP] * i), b = per * row[P_NO_LOAD] * u;
    flag open = flag_all();

    if (known != DC_ALL) {
        num start = angle + row[P_GAIN] * m;
        if (known == DC_START) start = num_pick(num_above(NUM(INFINITY), held[DC_LAST]), held[DC_LAST], start);
        dc_link_begin(num_clamp(start, row[P_ANGLE_MIN], row[P_ANGLE_MAX]), known, held, solved);
    }
    for (int k = 0; k < DC_STEPS; ++k) {
        const num bent = b * solved[DC_COSINE], off = solved[DC_ANGLE] - a - bent, slope = 1.0 + b * solved[DC_SINE];
        const num d = num_ratio(2.0 * off * slope, off * bent - 2.0 * slope * slope);
        dc_link_turn(solved[DC_ANGLE] + d, d, solved[DC_SINE], solved[DC_COSINE], open, solved);
#ifndef PLANT_TANGENT   /* whose slopes settle a step later */
        const num size = num_pick(num_above(low, d), -d, d);
        open = open & flag_not(num_reaches(NUM(DC_SETTLED), b * size * size * size));
        if (!flag_any(open)) break;
#endif
    }
    return b;
}

static inline num dc_link_floor(const real *row, num v)
{
    const num low = NUM(row[P_LOW]);
    return num_pick(num_above(v, low), v, low);
}

/* The cosine of an angle within its limits, from the states; turn: u times its slope by u. */
static inline num dc_link_cosine(const real *row, num i, num order, num angle, num u, DcKnown known,
                                 const num *held, num *solved, num *turn)
{
    const real least = row[P_ANGLE_MIN], most = row[P_ANGLE_MAX];

    *turn = NUM(0.0);
    if (!dc_link_is_inverter(row)) {
        if (known != DC_ALL)
            dc_link_begin(num_clamp(angle + row[P_GAIN] * (i - order), least, most), known, held, solved);
        return solved[DC_COSINE];
    }
    const num b = dc_link_extinction(row, i, order, angle, u, known, held, solved), part = b * solved[DC_SINE];
    const flag beyond = num_above(solved[DC_ANGLE], NUM(most)) | num_above(NUM(least), solved[DC_ANGLE]);
    *turn = -num_ratio(part * solved[DC_COSINE], 1.0 + part);
    if (!flag_any(beyond)) return solved[DC_COSINE];
    num sine, cosine;
    num_sincos(num_clamp(solved[DC_ANGLE], least, most), &sine, &cosine);
    *turn = num_pick(beyond, NUM(0.0), *turn);
    return num_pick(beyond, cosine, solved[DC_COSINE]);
}

static inline num dc_link_bound(num a)
{
    a = num_pick(num_above(NUM(DC_COSINE_MIN), a), NUM(DC_COSINE_MIN), a);
    return num_pick(num_above(a, NUM(DC_COSINE_MAX)), NUM(DC_COSINE_MAX), a);
}

/* cos(phi) from the cosine of the angle and u times its slope, which becomes that of cos(phi); per: 1/u. */
static inline num dc_link_phi(const real *row, num i, num v, num per, num cosine, num *turn)
{
    const num drop = (row[P_DROP_SHARE] * i) * per, raw = cosine - drop;
    const num phi = dc_link_bound(raw);
    const flag free = num_above(v, NUM(row[P_LOW])) & num_reaches(raw, phi) & num_reaches(phi, raw);
    *turn = num_pick(free, drop + *turn, NUM(0.0));
    return phi;
}

/* Current into the network along and across V; what it keeps changes where `open`. per: 1/u. */
static inline void dc_link_current(const real *row, const num *x, num v, num per, DcKnown known, const num *held, flag open,
                                   num *along, num *across, num *solved)
{
    const num i = x[index_at(row, P_STATE)], size = row[P_SCALE] * i, no_load = NUM(row[P_NO_LOAD]);
    num turn;
#ifdef PLANT_LANES   /* one alone does not go on where it has ended */
    num now[DC_SOLVED];
    for (size_t k = 0; k < DC_SOLVED; ++k) now[k] = known == DC_NOTHING ? NUM(0.0) : solved[k];
#else
    num *now = solved;
    (void)open;
#endif
    const num cosine = dc_link_cosine(row, i, x[index_at(row, P_ORDER)], x[index_at(row, P_STATE_Q)],
                                      dc_link_floor(row, v), known, held, now, &turn);
    const num phi = dc_link_phi(row, i, v, per, cosine, &turn), part = v * per;
    now[DC_AT] = v;
    now[DC_VOLTS] = no_load * (v * part) * phi;
    now[DC_RATE] = no_load * (num_pick(num_above(v, NUM(row[P_LOW])), NUM(1.0), 2.0 * part) * phi + turn);
#ifdef PLANT_LANES
    for (size_t k = 0; k < DC_SOLVED; ++k) solved[k] = num_pick(open, now[k], solved[k]);
#endif
    *along = dc_link_is_inverter(row) ? size * phi : -(size * phi);
    *across = size * num_sqrt(1.0 - phi * phi);
}

/* The dc voltage of this end at v: kept at one so near that the square of their distance is below rounding. */
static inline num dc_link_voltage(num v, const num *solved)
{
    return solved[DC_VOLTS] + solved[DC_RATE] * (v - solved[DC_AT]);
}

#if !defined PLANT_TANGENT && !defined PLANT_LANES
typedef struct { double along, across; } DcEnd;

/* The current and its slopes by |V|, which angle and cos(phi) follow. x, stride: as of bus_device_slope. */
static inline void dc_link_slope(const double *row, const double *x, size_t stride, double v, DcEnd *end, double *along,
                                 double *across)
{
    const double u = dc_link_floor(row, v), i = x == NULL ? row[P_REST_Q] : x[stride * index_at(row, P_STATE)];
    const double order = x == NULL ? i : x[stride * index_at(row, P_ORDER)];
    const double angle = x == NULL ? row[P_REST] : x[stride * index_at(row, P_STATE_Q)];
    const double size = row[P_SCALE] * i, sign = dc_link_is_inverter(row) ? 1.0 : -1.0;
    double solved[DC_SOLVED], turn;
    const double cosine = dc_link_cosine(row, i, order, angle, u, DC_NOTHING, NULL, solved, &turn);
    const double phi = dc_link_phi(row, i, v, 1.0 / u, cosine, &turn), other = sqrt(1.0 - phi * phi);

    *end = (DcEnd){ sign * size * phi, size * other };
    *along = sign * size * turn / u;
    *across = -size * phi * turn / (u * other);
}
#endif
#endif
