/* What is shown of a solved network: outputs, then locals. Part of flow.h, whose arrays it reads. */
#ifndef INTERAREA_SHOWN_H
#define INTERAREA_SHOWN_H
/* included by flow.h, after what it needs */
/* Of the voltage re + j im of a bus: shown in the frame that turns with rated frequency, its angle against the centre
 * of inertia. */
static num bus_shown(const real *memory, const Plan *plan, size_t kind, size_t bus, num re, num im, const Work *w)
{
    const real part = memory[plan->bus_part + bus];
    const num turn = plan->folded > 0 ? value_at(w->turn, part) : NUM(0.0);
    num sine, cosine;

    if (kind == SHOW_BUS_V) return num_sqrt(re * re + im * im);
    if (kind != SHOW_BUS_ANGLE && plan->folded == 0) return kind == SHOW_BUS_RE ? re : im;
    num_sincos((kind == SHOW_BUS_ANGLE ? value_at(w->centre, part) : NUM(0.0)) - turn, &sine, &cosine);
    const num along = re * cosine + im * sine, across = im * cosine - re * sine;
    return kind == SHOW_BUS_RE ? along : kind == SHOW_BUS_IM ? across : num_angle(across, along);
}

/* Active or reactive power of the device at port `of`; of a voltage source its angle against the centre of inertia. */
static num device_shown(const real *memory, const Plan *plan, size_t kind, size_t of, const num *x, const Work *w)
{
    const real *row = memory + plan->port + P_ROWS * of;
    num p = NUM(0.0), q = NUM(0.0);
    if (port_is_device(row)) {
        const size_t k = plan->n_machine + index_at(row, P_DEVICE);
        if (kind == SHOW_DEVICE_ANGLE)
            return x[index_at(row, P_STATE)] - value_at(w->centre, memory[plan->bus_part + index_at(row, P_BUS)]);
        bus_device_power(row, x, w->sine[k], w->cosine[k], w->port.v_re[of], w->port.v_im[of], &p, &q);
    }
    return kind == SHOW_DEVICE_P ? p : q;
}

/* What is shown from the solved network; Efd and Pm also need solve_devices. */
static num shown(const real *memory, const Plan *plan, const Pattern *pattern, size_t kind, size_t of,
                 const num *x, const Work *w)
{
    const MachineStates states = machine_states(x, plan->n_machine, plan->n_sixth);
    num re = NUM(0.0), im = NUM(0.0);

    if (kind >= SHOW_DEVICE_Q) return device_shown(memory, plan, kind, of, x, w);
    switch (kind) {
    case SHOW_DW: return states.slip[of];
    case SHOW_DELTA: return states.delta[of] - value_at(w->centre, memory[plan->part + of]);
    case SHOW_PE:
        return (w->vd[of] * w->id[of] + w->vq[of] * w->iq[of]) * memory[plan->machine + M_RATIO * plan->n_machine + of];
    case SHOW_VT: return w->vt[of];
    case SHOW_TIE: return network_tie_power(memory, plan, pattern, w->e_re, w->e_im, w->v);
    case SHOW_EFD: return w->efd[of];
    case SHOW_PM: return w->pm[of];
    case SHOW_BUS_V:
    case SHOW_BUS_ANGLE:
    case SHOW_BUS_RE:
    case SHOW_BUS_IM:
        network_voltage(memory, plan, pattern, of, w->e_re, w->e_im, w->v, &re, &im);
        return bus_shown(memory, plan, kind, of, re, im, w);
    case SHOW_LINE_I: {
        num a_re, a_im;
        network_line_current(memory, plan, pattern, plan->n_tie + of, w->e_re, w->e_im, w->v, &re, &im, &a_re, &a_im);
        return num_sqrt(re * re + im * im);
    }
    default:
        network_line_power(memory, plan, pattern, plan->n_tie + of, w->e_re, w->e_im, w->v, &re, &im);
        return kind == SHOW_LINE_P ? re : im;
    }
}

/* Shown variables first .. last - 1, with the rest of a sparse network's voltages if one needs them. */
static void show(const real *memory, const Plan *plan, const Pattern *pattern, size_t first, size_t last,
                 const num *x, const Work *w, num *to)
{
    const real *kinds = memory + plan->show, *of = kinds + plan->n_y + plan->n_w;
    int everywhere = 0;

    find_centres(memory, plan, machine_states(x, plan->n_machine, plan->n_sixth), NULL, w->centre);
    for (size_t k = first; k < last; ++k) {
        const size_t kind = index_at(kinds, k);
        everywhere |= kind == SHOW_TIE || kind == SHOW_BUS_V || (kind >= SHOW_LINE_P && kind <= SHOW_BUS_IM);
    }
    if (everywhere && is_sparse(plan)) network_complete(memory, plan, pattern, w->lanes, w->v);
    for (size_t k = first; k < last; ++k)
        to[k - first] = shown(memory, plan, pattern, index_at(kinds, k), index_at(of, k), x, w);
}
#endif
