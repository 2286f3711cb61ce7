#ifndef INTERAREA_LOAD_H
#define INTERAREA_LOAD_H
#include "../numbers/layout.h"
#include "../numbers/scalar.h"
/* Voltage characteristic of a load, for P and Q each.       [Kundur1994, sec. 7.1]
 *
 * With u = |V|/V0 and the shares z + i + p + e = 1 of constant impedance, current
 * and power and of an exponent a,
 *
 *     P = P0 u^2 h(u),   h = z + i/u + p/u^2 + e u^(a-2)
 *
 * The network holds P0 u^2 as an admittance; the port injects what is left,
 *
 *     dI = -[P0 (h_P - 1) - j Q0 (h_Q - 1)] V / V0^2 .
 *
 * A share that is not constant impedance becomes so, continuously, below a voltage
 * of its own: in 1/u, 1/u^2, u^(a-2) the u stays at that voltage. A current or a
 * power that holds down to zero volts would leave a faulted bus without solution. */

/* h(u) - 1; per_i and per_p are 1/u, at least what they are at the voltages below which the shares follow no more. */
static inline num load_factor(const real *mix, num per_i, num per_p, num u)
{
    num h = NUM(0.0);

    if (FIRST(mix[0]) != 0.0) h += mix[0] * (per_i - 1.0);
    if (FIRST(mix[1]) != 0.0) h += mix[1] * (per_p * per_p - 1.0);
    if (FIRST(mix[2]) != 0.0) {
        const num at = num_pick(num_above(u, NUM(mix[4])), u, NUM(mix[4]));
        h += mix[2] * (num_exp((mix[3] - 2.0) * num_log(at)) - 1.0);
    }
    return h;
}

/* 1/u or, below `low`, 1/low, where P or Q has a share of that kind. */
static inline num load_per(real p_share, real q_share, real low, num u)
{
    if (FIRST(p_share) == 0.0 && FIRST(q_share) == 0.0) return NUM(0.0);
    return num_ratio(NUM(1.0), num_pick(num_above(u, NUM(low)), u, NUM(low)));
}

/* Both shares of P and Q at u. */
static inline void load_factors(const real *row, num u, num *h_p, num *h_q)
{
    const real *p = row + P_P_MIX, *q = row + P_Q_MIX;
    const num per_i = load_per(p[0], q[0], row[P_LOW_I], u), per_p = load_per(p[1], q[1], row[P_LOW_P], u);

    *h_p = load_factor(p, per_i, per_p, u);
    *h_q = load_factor(q, per_i, per_p, u);
}

/* Current the port injects at the bus voltage v_re + j v_im, whose size is v. */
static inline void load_injection(const real *row, num v, num v_re, num v_im, num *i_re, num *i_im)
{
    const real y = row[P_PER_V0] * row[P_PER_V0];
    const num u = v * row[P_PER_V0];
    num h_p, h_q;

    load_factors(row, u, &h_p, &h_q);
    const num g = row[P_P] * y * h_p, b = row[P_Q] * y * h_q;
    *i_re = -(g * v_re + b * v_im);
    *i_im = -(g * v_im - b * v_re);
}

#if !defined PLANT_TANGENT && !defined PLANT_LANES
/* dh/du. */
static inline double load_factor_slope(const double *mix, double low_i, double low_p, double u)
{
    double d = 0.0;
    if (mix[0] != 0.0 && u > low_i) d -= mix[0] / (u * u);
    if (mix[1] != 0.0 && u > low_p) d -= 2.0 * mix[1] / (u * u * u);
    if (mix[2] != 0.0 && u > mix[4]) d += mix[2] * (mix[3] - 2.0) * real_exp((mix[3] - 3.0) * real_log(u));
    return d;
}

/* d (i_re, i_im) / d (v_re, v_im), row by row. */
static inline void load_slope(const double *row, double v_re, double v_im, double d[4])
{
    const double y = row[P_PER_V0] * row[P_PER_V0], low_i = row[P_LOW_I], low_p = row[P_LOW_P];
    const double v = sqrt(v_re * v_re + v_im * v_im), u = v * row[P_PER_V0];
    double h_p, h_q;

    load_factors(row, u, &h_p, &h_q);
    const double g = row[P_P] * y * h_p, b = row[P_Q] * y * h_q;
    const double scale = v > 0.0 ? y * row[P_PER_V0] / v : 0.0;
    const double gu = row[P_P] * load_factor_slope(row + P_P_MIX, low_i, low_p, u) * scale;
    const double bu = row[P_Q] * load_factor_slope(row + P_Q_MIX, low_i, low_p, u) * scale;
    const double along = gu * v_re + bu * v_im, across = gu * v_im - bu * v_re;
    d[0] = -(g + along * v_re);
    d[1] = -(b + along * v_im);
    d[2] = -(across * v_re - b);
    d[3] = -(g + across * v_im);
}
#endif
#endif
