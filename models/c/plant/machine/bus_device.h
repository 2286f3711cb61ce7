#ifndef INTERAREA_BUS_DEVICE_H
#define INTERAREA_BUS_DEVICE_H
#include "dc_link.h"
/* Devices at a bus whose states set a current into the network: with y = scale x + bias of the state x that couples
 * (a device's output is a state, or that; models/grid/coupling.py), system base, capacitive above 0,
 *
 *     susceptance (SVC)       I = -j y V
 *     current (STATCOM)       I = -j y V/u,   u = max(|V|, P_LOW)
 *     converter (REGC_A)      I = (g(|V|) ip - j (iq - h(|V|))) V/u, ip and iq two states times scale: g rises from
 *                             0 at P_ZERO to 1 at P_FULL, h by P_TAKEN above P_HIGH, where iq - h stops at P_LEAST
 *     rectifier, inverter     the ends of a dc link (dc_link.h)
 *     none                    0: the voltage there is measured only
 *
 * The current turns with V, so the frame of folded ports (port.h) does not matter. */

/* Of a converter the current along and across V; ip, iq: system base. */
static inline void converter_current(const real *row, num ip, num iq, num v, num *along, num *across)
{
    const num zero = NUM(row[P_ZERO]), full = NUM(row[P_FULL]), high = NUM(row[P_HIGH]), least = NUM(row[P_LEAST]);
    const num part = num_ratio(v - zero, full - zero), less = iq - row[P_TAKEN] * (v - high);
    const num some = num_pick(num_above(v, zero), part * ip, NUM(0.0));

    *along = num_pick(num_above(full, v), some, ip);
    *across = -num_pick(num_above(v, high), num_pick(num_above(least, less), num_pick(num_above(iq, least), least, iq), less), iq);
}

/* Current the port injects at the bus voltage v. */
static inline void bus_device_injection(const real *row, const num *x, num v_re, num v_im, num *i_re, num *i_im)
{
    const size_t coupling = index_at(row, P_COUPLING);
    const flag on = num_above(NUM(row[P_ON]), NUM(0.5));
    num along = NUM(0.0), across = NUM(0.0);

    if (coupling != COUPLING_NONE) {
        const num y = row[P_SCALE] * x[index_at(row, P_STATE)] + row[P_BIAS];
        across = -y;
        if (coupling == COUPLING_CONVERTER) {
            const num v = num_sqrt(v_re * v_re + v_im * v_im);
            converter_current(row, y, row[P_SCALE] * x[index_at(row, P_STATE_Q)], v, &along, &across);
        } else if (coupling == COUPLING_RECTIFIER || coupling == COUPLING_INVERTER) {
            dc_link_current(row, x, num_sqrt(v_re * v_re + v_im * v_im), &along, &across);
        }
        along = num_pick(on, along, NUM(0.0));
        across = num_pick(on, across, NUM(0.0));
    }
    *i_re = along * v_re - across * v_im;
    *i_im = along * v_im + across * v_re;
    if (coupling >= COUPLING_CURRENT) {
        const num v = num_sqrt(v_re * v_re + v_im * v_im), low = NUM(row[P_LOW]);
        const num u = num_pick(num_above(v, low), v, low);
        *i_re = num_ratio(*i_re, u);
        *i_im = num_ratio(*i_im, u);
    }
}

/* Active and reactive power into the network, system base. */
static inline void bus_device_power(const real *row, const num *x, num v_re, num v_im, num *p, num *q)
{
    num i_re, i_im;
    bus_device_injection(row, x, v_re, v_im, &i_re, &i_im);
    *p = v_re * i_re + v_im * i_im;
    *q = v_im * i_re - v_re * i_im;
}

#if !defined PLANT_TANGENT && !defined PLANT_LANES
/* d (i_re, i_im) / d (v_re, v_im), row by row, of I = (along + j across) V/u, whose parts may have slopes by |V|. */
static inline void bus_device_turned(double along, double across, double along_slope, double across_slope, double v_re,
                                     double v_im, double low, double d[4])
{
    const double v = sqrt(v_re * v_re + v_im * v_im), u = v > low ? v : low, falls = v > low ? 1.0 / u : 0.0;
    const double re = along / u, im = across / u, unit_re = v > 0.0 ? v_re / v : 1.0, unit_im = v > 0.0 ? v_im / v : 0.0;
    const double re_slope = along_slope / u - re * falls, im_slope = across_slope / u - im * falls;
    const double x = re_slope * v_re - im_slope * v_im, y = re_slope * v_im + im_slope * v_re;

    d[0] = re + x * unit_re;
    d[1] = -im + x * unit_im;
    d[2] = im + y * unit_re;
    d[3] = re + y * unit_im;
}

static inline void converter_slope(const double *row, double ip, double iq, double v_re, double v_im, double d[4])
{
    const double v = sqrt(v_re * v_re + v_im * v_im), per = 1.0 / (row[P_FULL] - row[P_ZERO]);
    const int rises = v > row[P_ZERO] && v < row[P_FULL], taken = v > row[P_HIGH];
    double along, across;

    converter_current(row, ip, iq, v, &along, &across);
    bus_device_turned(along, across, rises ? ip * per : 0.0,
                      taken && -across > row[P_LEAST] && row[P_TAKEN] > 0.0 ? row[P_TAKEN] : 0.0, v_re, v_im, row[P_LOW], d);
}

/* d (i_re, i_im) / d (v_re, v_im), row by row. x: of a complex step two numbers each, hence the stride; null: at rest. */
static inline void bus_device_slope(const double *row, const double *x, size_t stride, double v_re, double v_im,
                                    double d[4])
{
    const size_t coupling = index_at(row, P_COUPLING);

    d[0] = d[1] = d[2] = d[3] = 0.0;
    if (coupling == COUPLING_NONE || !(row[P_ON] > 0.5)) return;
    const double y = x == NULL ? row[P_REST] : row[P_SCALE] * x[stride * index_at(row, P_STATE)] + row[P_BIAS];
    if (coupling == COUPLING_CONVERTER) {
        const double iq = x == NULL ? row[P_REST_Q] : row[P_SCALE] * x[stride * index_at(row, P_STATE_Q)];
        converter_slope(row, y, iq, v_re, v_im, d);
    } else if (coupling == COUPLING_RECTIFIER || coupling == COUPLING_INVERTER) {
        DcEnd end;
        double along_slope, across_slope;
        dc_link_slope(row, x, stride, sqrt(v_re * v_re + v_im * v_im), &end, &along_slope, &across_slope);
        bus_device_turned(end.along, end.across, along_slope, across_slope, v_re, v_im, row[P_LOW], d);
    } else if (coupling == COUPLING_CURRENT) {
        bus_device_turned(0.0, -y, 0.0, 0.0, v_re, v_im, row[P_LOW], d);
    } else {
        d[1] = y;
        d[2] = -y;
    }
}
#endif
#endif
