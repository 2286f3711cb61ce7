#ifndef INTERAREA_BUS_DEVICE_H
#define INTERAREA_BUS_DEVICE_H
#include "dc_link.h"
/* Devices at a bus whose states set a current into the network: with y = scale x + bias of the state x that couples
 * (a device's output is a state, or that; models/grid/coupling.py), system base, capacitive above 0,
 *
 *     susceptance (SVC)       I = -j y V
 *     current (STATCOM)       I = -j y V/u,   u = max(|V|, P_LOW)
 *     converter (REGC_A)      I = (g(|V|) ip - j (iq - h(|V|))) V/u, ip and iq two states times scale: g rises from
 *                             0 at P_ZERO to 1 at P_FULL, h by P_TAKEN above P_HIGH, where iq - h stops at P_LEAST;
 *                             of REGC_B, E/(R + jX) by both states and V taken off by P_SHUNT and P_TAKEN;
 *                             of a dc link with such converters both ends, the second with P_FAR
 *     rectifier, inverter     the ends of a dc link (dc_link.h)
 *     source (REGFM_A1, B1)   I = (E - V)/(R + jX), E by two states, its angle and its size; beyond P_MOST that much
 *                             of it, as if E moved to V + (R + jX) I
 *     none                    0: the voltage there is measured only
 *
 * The current turns with V, so the frame of folded ports (port.h) does not matter; of a source the angle in that frame
 * is given (sine, cosine). */

/* Of a source with voltage e; how much of it the limit leaves into `share`. */
static inline void source_current(const real *row, num e, num sine, num cosine, num v_re, num v_im, num *i_re, num *i_im,
                                  num *share)
{
    const num re = e * cosine - v_re, im = e * sine - v_im, one = NUM(1.0), most = NUM(row[P_MOST]);
    const num g = NUM(row[P_COND]), b = NUM(row[P_SUSC]);

    *i_re = g * re - b * im;
    *i_im = g * im + b * re;
    const num size = num_sqrt(*i_re * *i_re + *i_im * *i_im);
    const flag beyond = num_above(most, NUM(0.0)) & num_above(size, most);
    *share = num_pick(beyond, num_ratio(most, num_pick(beyond, size, one)), one);
    *i_re *= *share;
    *i_im *= *share;
}

/* Of a converter the current along and across V; ip, iq: system base. */
static inline void converter_current(const real *row, num ip, num iq, num v, num *along, num *across)
{
    const num zero = NUM(row[P_ZERO]), full = NUM(row[P_FULL]), high = NUM(row[P_HIGH]), least = NUM(row[P_LEAST]);
    const num part = (v - zero) * num_ratio(NUM(1.0), full - zero), less = iq - row[P_TAKEN] * (v - high);
    const num reduced = num_pick(num_above(v, zero), part * ip, NUM(0.0));

    *along = num_pick(num_above(full, v), reduced, ip);
#ifndef PLANT_LANES /* there it may differ from lane to lane */
    if (row[P_SHUNT] != 0.0)
#endif
        *along = *along - row[P_SHUNT] * v;
    *across = -num_pick(num_above(v, high), num_pick(num_above(least, less), num_pick(num_above(iq, least), least, iq), less), iq);
}

/* Active and reactive power of a converter into the network, system base. */
static inline void converter_power(const real *row, const num *x, num v, num *p, num *q)
{
    const num ip = row[P_SCALE] * x[index_at(row, P_STATE)] + row[P_BIAS], iq = row[P_SCALE] * x[index_at(row, P_STATE_Q)];
    const num low = NUM(row[P_LOW]), u = num_pick(num_above(v, low), v, low);
    const num size = num_pick(num_above(NUM(row[P_ON]), NUM(0.5)), v * num_ratio(v, u), NUM(0.0));
    num along, across;

    converter_current(row, ip, iq, v, &along, &across);
    *p = size * along;
    *q = -(size * across);
}

/* Current the port injects at the bus voltage v_re + j v_im, whose size is v; known, held, open, kept: of a dc link
 * (dc_link.h). */
static inline void bus_device_injection(const real *row, const num *x, num sine, num cosine, num v, num v_re, num v_im,
                                        num *i_re, num *i_im, DcKnown known, const num *held,
                                        flag open, num *solved)
{
    const size_t coupling = index_at(row, P_COUPLING);
    const flag on = num_above(NUM(row[P_ON]), NUM(0.5));
    num along = NUM(0.0), across = NUM(0.0);

    if (coupling == COUPLING_SOURCE) {
        source_current(row, x[index_at(row, P_STATE_Q)], sine, cosine, v_re, v_im, i_re, i_im, &along);
        *i_re = num_pick(on, *i_re, NUM(0.0));
        *i_im = num_pick(on, *i_im, NUM(0.0));
        return;
    }
    if (coupling != COUPLING_NONE) {
        const num y = row[P_SCALE] * x[index_at(row, P_STATE)] + row[P_BIAS];
        num per = NUM(1.0);   /* 1/u: one division for both parts */
        across = -y;
        if (coupling >= COUPLING_CURRENT) {
            const num low = NUM(row[P_LOW]);
            per = num_ratio(NUM(1.0), num_pick(num_above(v, low), v, low));
            if (coupling == COUPLING_CONVERTER)
                converter_current(row, y, row[P_SCALE] * x[index_at(row, P_STATE_Q)], v, &along, &across);
            else if (coupling == COUPLING_RECTIFIER || coupling == COUPLING_INVERTER)
                dc_link_current(row, x, v, per, known, held, open, &along, &across, solved);
        }
        along = num_pick(on, per * along, NUM(0.0));
        across = num_pick(on, per * across, NUM(0.0));
    }
    *i_re = along * v_re - across * v_im;
    *i_im = along * v_im + across * v_re;
}

/* The same current where the port's voltage is known and nothing of a dc link. */
static inline void bus_device_current(const real *row, const num *x, num sine, num cosine, num v_re, num v_im,
                                      num *i_re, num *i_im)
{
    const num v = num_sqrt(v_re * v_re + v_im * v_im);
    num solved[DC_SOLVED];
    bus_device_injection(row, x, sine, cosine, v, v_re, v_im, i_re, i_im, DC_NOTHING, NULL, flag_all(), solved);
}

/* Active and reactive power into the network, system base. */
static inline void bus_device_power(const real *row, const num *x, num sine, num cosine, num v_re, num v_im, num *p,
                                    num *q)
{
    num i_re, i_im;
    bus_device_current(row, x, sine, cosine, v_re, v_im, &i_re, &i_im);
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
    bus_device_turned(along, across, (rises ? ip * per : 0.0) - row[P_SHUNT],
                      taken && -across > row[P_LEAST] && row[P_TAKEN] > 0.0 ? row[P_TAKEN] : 0.0, v_re, v_im, row[P_LOW], d);
}

/* Of a source: -1/(R + jX), and while its limit acts what is left of that across the current. */
static inline void source_slope(const double *row, double e, double sine, double cosine, double v_re, double v_im,
                                double d[4])
{
    double i_re, i_im, share;

    source_current(row, e, sine, cosine, v_re, v_im, &i_re, &i_im, &share);
    d[0] = d[3] = -row[P_COND] * share;
    d[1] = row[P_SUSC] * share;
    d[2] = -d[1];
    if (!(share < 1.0)) return;
    const double most = row[P_MOST], re = i_re / most, im = i_im / most;
    for (size_t k = 0; k < 2; ++k) {
        const double along = re * d[k] + im * d[2 + k];
        d[k] -= re * along;
        d[2 + k] -= im * along;
    }
}

/* d (i_re, i_im) / d (v_re, v_im), row by row. x: of a complex step two numbers each, hence the stride; null: at rest,
 * where no limit acts and sine and cosine are not read. */
static inline void bus_device_slope(const double *row, const double *x, size_t stride, const double *sine,
                                    const double *cosine, double v_re, double v_im, double d[4])
{
    const size_t coupling = index_at(row, P_COUPLING);

    d[0] = d[1] = d[2] = d[3] = 0.0;
    if (coupling == COUPLING_NONE || !(row[P_ON] > 0.5)) return;
    if (coupling == COUPLING_SOURCE) {
        d[0] = d[3] = -row[P_COND];
        d[1] = row[P_SUSC];
        d[2] = -d[1];
        if (x != NULL) source_slope(row, x[stride * index_at(row, P_STATE_Q)], *sine, *cosine, v_re, v_im, d);
        return;
    }
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
