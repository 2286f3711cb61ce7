#ifndef INTERAREA_BUS_DEVICE_H
#define INTERAREA_BUS_DEVICE_H
#include "../numbers/layout.h"
#include "../numbers/scalar.h"
/* Devices at a bus whose states set a current into the network: with y = scale x + bias of the state x that couples
 * (a device's output is a state, or that; models/grid/coupling.py), system base, capacitive above 0,
 *
 *     susceptance (SVC)       I = -j y V
 *     current (STATCOM)       I = -j y V/u,   u = max(|V|, P_LOW)
 *     none                    0: the voltage there is measured only
 *
 * The current turns with V, so the frame of folded ports (port.h) does not matter. */

/* Current the port injects at the bus voltage v. */
static inline void bus_device_injection(const real *row, const num *x, num v_re, num v_im, num *i_re, num *i_im)
{
    const size_t coupling = index_at(row, P_COUPLING);
    const flag on = num_above(NUM(row[P_ON]), NUM(0.5));
    num y = NUM(0.0);

    if (coupling != COUPLING_NONE) y = num_pick(on, row[P_SCALE] * x[index_at(row, P_STATE)] + row[P_BIAS], y);
    if (coupling == COUPLING_CURRENT) {
        const num v = num_sqrt(v_re * v_re + v_im * v_im), low = NUM(row[P_LOW]);
        y = num_ratio(y, num_pick(num_above(v, low), v, low));
    }
    *i_re = y * v_im;
    *i_im = -(y * v_re);
}

#if !defined PLANT_TANGENT && !defined PLANT_LANES
/* y of a device's port. x: of a complex step two numbers each, hence the stride; null: at rest. */
static inline double bus_device_at(const double *row, const double *x, size_t stride)
{
    return x == NULL ? row[P_REST] : row[P_SCALE] * x[stride * index_at(row, P_STATE)] + row[P_BIAS];
}

/* d (i_re, i_im) / d (v_re, v_im) for y, row by row. */
static inline void bus_device_slope(const double *row, double y, double v_re, double v_im, double d[4])
{
    const size_t coupling = index_at(row, P_COUPLING);
    const double v = sqrt(v_re * v_re + v_im * v_im), low = row[P_LOW];
    double along = 0.0;   /* how y/u falls with |V|, over |V| */

    if (coupling == COUPLING_NONE || !(row[P_ON] > 0.5)) y = 0.0;
    if (coupling == COUPLING_CURRENT) {
        if (v > low) along = -y / (v * v * v);
        y /= v > low ? v : low;
    }
    d[0] = along * v_re * v_im;
    d[1] = y + along * v_im * v_im;
    d[2] = -(y + along * v_re * v_re);
    d[3] = -along * v_re * v_im;
}
#endif
#endif
