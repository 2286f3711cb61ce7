#ifndef INTERAREA_GOVERNOR_STEAM_H
#define INTERAREA_GOVERNOR_STEAM_H
#include "plan.h"
#include "scalar.h"
/* Steam turbine and governor: mechanical power on the machine base.        [Kundur1994, sec. 9.2]
 *
 * Speed relay, servomotor with rate and gate limits, a steam chest and up
 * to three reheat volumes (four-section turbine, fractions F2..F5 of the power).
 *
 *     T_SR dc/dt = Pref - (K_P/R_P) slip - c
 *          dg/dt = clamp((c - g)/T_SM, vmin, vmax),  gmin <= g <= gmax, non-windup
 *     T5 dp5/dt = g - p5,  T4 dp4/dt = p5 - p4,  T3 dp3/dt = p4 - p3,  T2 dp2/dt = p3 - p2
 *     Pm = F5 p5 + F4 p4 + F3 p3 + F2 p2
 *
 * A volume with time constant 0 is absent (its pressure is that before it). The
 * fractions add to 1, so Pref = Pm at rest. The torque is Pm (speed = 1). */
static inline num governor_steam(const real *p, size_t n, num pref, num slip,
                                 const num *x, num *dx)
{
    const real low = p[G_GMIN * n], high = p[G_GMAX * n];
    const num relay = num_lag(pref - (p[G_KP * n] / p[G_RP * n]) * slip, p[G_TSR * n], &x, &dx);

    const num state = *x++;
    const num gate = num_clamp(state, low, high);
    const num rate = num_clamp((relay - state) / p[G_TSM * n], p[G_VMIN * n], p[G_VMAX * n]);
    const flag above = num_reaches(state, NUM(high)) & num_above(rate, NUM(0.0));
    const flag below = num_reaches(NUM(low), state) & num_above(NUM(0.0), rate);
    *dx++ = num_pick(above | below, (gate - state) / p[G_TSM * n], rate);  /* back to a limit that was passed */

    const num p5 = num_lag(gate, p[G_T5 * n], &x, &dx);
    const num p4 = num_lag(p5, p[G_T4 * n], &x, &dx);
    const num p3 = num_lag(p4, p[G_T3 * n], &x, &dx);
    const num p2 = num_lag(p3, p[G_T2 * n], &x, &dx);
    return p[G_F5 * n] * p5 + p[G_F4 * n] * p4 + p[G_F3 * n] * p3 + p[G_F2 * n] * p2;
}
#endif
