#ifndef INTERAREA_LOAD_H
#define INTERAREA_LOAD_H
#include "plan.h"
#include "scalar.h"
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

/* h(u) - 1, and its derivative unless `slope` is null. */
static inline num load_factor(const double *mix, double low_i, double low_p, num u, double *slope)
{
    const double i = mix[0], p = mix[1], e = mix[2], power = mix[3] - 2.0, low_e = mix[4];
    num h = 0.0;
    double d = 0.0;

    if (i != 0.0) {
        const num q = PART(u) > low_i ? num_ratio(1.0, u) : (num)(1.0 / low_i);
        h += i * (q - 1.0);
        if (PART(u) > low_i) d -= i * PART(q) * PART(q);
    }
    if (p != 0.0) {
        const num q = PART(u) > low_p ? num_ratio(1.0, u) : (num)(1.0 / low_p);
        h += p * (q * q - 1.0);
        if (PART(u) > low_p) d -= 2.0 * p * PART(q) * PART(q) * PART(q);
    }
    if (e != 0.0) {
        const num q = num_exp(power * num_log(PART(u) > low_e ? u : (num)low_e));
        h += e * (q - 1.0);
        if (PART(u) > low_e) d += e * power * PART(q) / PART(u);
    }
    if (slope != NULL) *slope = d;
    return h;
}

/* Current the port injects at the bus voltage v. */
static inline void load_injection(const double *row, num v_re, num v_im, num *i_re, num *i_im)
{
    const double y = 1.0 / (row[P_V0] * row[P_V0]);
    const num u = num_sqrt(v_re * v_re + v_im * v_im) / row[P_V0];
    const num g = row[P_P] * y * load_factor(row + P_P_MIX, row[P_LOW_I], row[P_LOW_P], u, NULL);
    const num b = row[P_Q] * y * load_factor(row + P_Q_MIX, row[P_LOW_I], row[P_LOW_P], u, NULL);
    *i_re = -(g * v_re + b * v_im);
    *i_im = -(g * v_im - b * v_re);
}

#ifndef PLANT_TANGENT
/* d (i_re, i_im) / d (v_re, v_im), row by row. */
static inline void load_slope(const double *row, double v_re, double v_im, double d[4])
{
    const double y = 1.0 / (row[P_V0] * row[P_V0]);
    const double v = sqrt(v_re * v_re + v_im * v_im), u = v / row[P_V0];
    double dg, db;
    const double g = row[P_P] * y * load_factor(row + P_P_MIX, row[P_LOW_I], row[P_LOW_P], u, &dg);
    const double b = row[P_Q] * y * load_factor(row + P_Q_MIX, row[P_LOW_I], row[P_LOW_P], u, &db);
    const double scale = v > 0.0 ? y / (row[P_V0] * v) : 0.0;
    const double gu = row[P_P] * dg * scale, bu = row[P_Q] * db * scale;
    const double along = gu * v_re + bu * v_im, across = gu * v_im - bu * v_re;
    d[0] = -(g + along * v_re);
    d[1] = -(b + along * v_im);
    d[2] = -(across * v_re - b);
    d[3] = -(g + across * v_im);
}
#endif
#endif
