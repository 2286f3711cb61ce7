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
    bus_device_current(row, x, w->sine[at], w->cosine[at], v_re, v_im, &i_re, &i_im);
    w->vd[at] = v_re * cosine - v_im * sine;
    w->vq[at] = v_re * sine + v_im * cosine;
    w->id[at] = num_ratio(i_re * cosine - i_im * sine, scale);
    w->iq[at] = num_ratio(i_re * sine + i_im * cosine, scale);
}

/* What a plant control sees: the voltage of the bus that it regulates, also less its drop, and power, with `re`, `im`
 * the current that it measures and `power_re`, `power_im` the voltage there. */
static void see_measured(const real *row, num v_re, num v_im, num re, num im, num power_re, num power_im, size_t at, Work *w)
{
    const num per = num_ratio(NUM(1.0), NUM(row[P_SCALE])), r = NUM(row[P_DROP_R]), x = NUM(row[P_DROP_X]);
    const num less_re = v_re - (r * re - x * im), less_im = v_im - (r * im + x * re);

    w->efd[at] = num_sqrt(v_re * v_re + v_im * v_im);
    w->pm[at] = num_sqrt(less_re * less_re + less_im * less_im);
    w->id[at] = per * (power_re * re + power_im * im);
    w->iq[at] = per * (power_im * re - power_re * im);
}

/* Whether port p only measures for a plant control, and is of such a kind. */
static int port_measures(const real *memory, const Plan *plan, size_t p, size_t kind)
{
    const real *row = memory + plan->port + P_ROWS * p;
    return p < plan->n_port && port_is_device(row) && index_at(row, P_COUPLING) == COUPLING_NONE
           && index_at(row, P_MEASURES) == kind;
}

/* Of the converter at port p: at its own bus, or where the ports behind its own are. */
static void see_plant(const real *memory, const Plan *plan, const num *x, size_t p, size_t at, Work *w)
{
    const real *row = memory + plan->port + P_ROWS * p;
    const int flow = port_measures(memory, plan, p + 2, MEASURE_FLOW) && port_measures(memory, plan, p + 1, MEASURE_REGULATED);
    const size_t bus = port_measures(memory, plan, p + 1, MEASURE_REGULATED) ? p + 1 : p, end = flow ? p + 2 : p;
    const num a_re = w->port.v_re[end], a_im = w->port.v_im[end];
    num re, im;

#ifndef PLANT_LANES   /* there the drop may differ from lane to lane; without one these are the same bits */
    if (bus == p && row[P_DROP_R] == 0.0 && row[P_DROP_X] == 0.0) {
        w->efd[at] = w->pm[at] = w->vt[at];
        w->id[at] = w->pe[at];
        w->iq[at] = w->ifd[at];
        return;
    }
#endif
    if (flow) {
        const real *of = row + 2 * P_ROWS, on = memory[plan->in_service + index_at(of, P_BRANCH)];
        const num b_re = w->port.v_re[p + 3], b_im = w->port.v_im[p + 3];
        re = on * (of[P_OWN_RE] * a_re - of[P_OWN_IM] * a_im + of[P_MUTUAL_RE] * b_re - of[P_MUTUAL_IM] * b_im);
        im = on * (of[P_OWN_RE] * a_im + of[P_OWN_IM] * a_re + of[P_MUTUAL_RE] * b_im + of[P_MUTUAL_IM] * b_re);
    } else {
        bus_device_current(row, x, w->sine[at], w->cosine[at], a_re, a_im, &re, &im);
    }
    see_measured(row, w->port.v_re[bus], w->port.v_im[bus], re, im, a_re, a_im, at, w);
}

/* What the converter or source at port p sees, whose voltage is v. */
static void see_converter(const real *memory, const Plan *plan, const num *x, size_t p, size_t at, int far, num v, Work *w)
{
    const real *row = memory + plan->port + P_ROWS * p;
    const size_t sees = index_at(row, P_DIRECTION);
    const num per = num_ratio(NUM(1.0), NUM(row[P_SCALE]));   /* does not wait for the voltages */
    num active, reactive;

    if (index_at(row, P_COUPLING) == COUPLING_CONVERTER) converter_power(row, x, v, &active, &reactive);
    else bus_device_power(row, x, w->sine[at], w->cosine[at], w->port.v_re[p], w->port.v_im[p], &active, &reactive);
    *(far ? &w->vq[at] : &w->pe[at]) = per * active;
    if (far) return;
    w->ifd[at] = per * reactive;
    if (sees & 1u) see_direction(memory, plan, p, at, v, w);
    if (sees & 2u) see_plant(memory, plan, x, p, at, w);
    if (sees & 4u) see_components(memory, plan, x, p, at, w);
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
            *(coupling == COUPLING_RECTIFIER ? &w->vt[at] : &w->pe[at]) = dc_link_voltage(v, w->port.solved + DC_SOLVED * p);
            continue;
        }
        const int far = coupling == COUPLING_CONVERTER && index_at(row, P_FAR) == 1;
        *(far ? &w->vd[at] : &w->vt[at]) = v;
        if (coupling == COUPLING_CONVERTER || coupling == COUPLING_SOURCE) see_converter(memory, plan, x, p, at, far, v, w);
    }
}
#endif
