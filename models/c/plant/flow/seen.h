#ifndef INTERAREA_SEEN_H
#define INTERAREA_SEEN_H
/* What devices at buses see of the network once it is solved; part of flow.h, which includes it after its Work. */

/* Direction of the voltage v at a port in the synchronous frame: real and imaginary part of a unit, less at low voltage. */
static void see_direction(const real *memory, const Plan *plan, size_t p, size_t at, num v, Work *w)
{
    const real *row = memory + plan->port + P_ROWS * p;
    const num low = NUM(row[P_LOW]), size = num_pick(num_above(v, low), v, low);
    const num turn = plan->folded > 0 ? value_at(w->turn, memory[plan->bus_part + index_at(row, P_BUS)]) : NUM(0.0);
    num sine, cosine;

    num_sincos(turn, &sine, &cosine);
    w->vd[at] = num_ratio(w->port.v_re[p] * cosine - w->port.v_im[p] * sine, size);
    w->vq[at] = num_ratio(w->port.v_re[p] * sine + w->port.v_im[p] * cosine, size);
}

/* Of a source at port p the voltage and, on its base, the current in the synchronous frame. */
static void see_components(const real *memory, const Plan *plan, const num *x, size_t p, size_t at, Work *w)
{
    const real *row = memory + plan->port + P_ROWS * p;
    const num turn = plan->folded > 0 ? value_at(w->turn, memory[plan->bus_part + index_at(row, P_BUS)]) : NUM(0.0);
    const num v_re = w->port.v_re[p], v_im = w->port.v_im[p], scale = NUM(row[P_SCALE]);
    num sine, cosine, i_re, i_im;

    num_sincos(turn, &sine, &cosine);
    bus_device_injection(row, x, w->sine[at], w->cosine[at], v_re, v_im, &i_re, &i_im);
    w->vd[at] = v_re * cosine - v_im * sine;
    w->vq[at] = v_re * sine + v_im * cosine;
    w->id[at] = num_ratio(i_re * cosine - i_im * sine, scale);
    w->iq[at] = num_ratio(i_re * sine + i_im * cosine, scale);
}

/* Voltages that devices at buses see, the powers of converters and dc voltages of links, on their base. */
static void see_voltages(const real *memory, const Plan *plan, const num *x, Work *w)
{
    for (size_t p = 0; p < plan->n_port; ++p) {
        const real *row = memory + plan->port + P_ROWS * p;
        if (!port_is_device(row) || index_at(row, P_SEES) == 0) continue;
        const size_t at = plan->n_machine + index_at(row, P_SEES) - 1, coupling = index_at(row, P_COUPLING);
        const num v = num_sqrt(w->port.v_re[p] * w->port.v_re[p] + w->port.v_im[p] * w->port.v_im[p]);
        if (coupling == COUPLING_RECTIFIER || coupling == COUPLING_INVERTER) {
            *(coupling == COUPLING_RECTIFIER ? &w->vt[at] : &w->pe[at]) = dc_link_voltage(row, x, v);
            continue;
        }
        const int far = coupling == COUPLING_CONVERTER && index_at(row, P_FAR) == 1;
        *(far ? &w->vd[at] : &w->vt[at]) = v;
        if (coupling != COUPLING_CONVERTER && coupling != COUPLING_SOURCE) continue;
        num active, reactive;
        bus_device_power(row, x, w->sine[at], w->cosine[at], w->port.v_re[p], w->port.v_im[p], &active, &reactive);
        *(far ? &w->vq[at] : &w->pe[at]) = num_ratio(active, NUM(row[P_SCALE]));
        if (far) continue;
        w->ifd[at] = num_ratio(reactive, NUM(row[P_SCALE]));
        if (index_at(row, P_DIRECTION) != 1) continue;
        if (coupling == COUPLING_CONVERTER) see_direction(memory, plan, p, at, v, w);
        else see_components(memory, plan, x, p, at, w);
    }
}
#endif
