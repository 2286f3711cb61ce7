/* The right-hand side and the outputs, written once over `num`; flow.c compiles
 * it as double, tangent.c as double complex. The order is that of the physics:
 * angles -> EMFs -> network -> terminals -> governors -> stabilizers -> exciters
 * -> machines. Outputs depend on the states only. */
#ifndef INTERAREA_FLOW_H
#define INTERAREA_FLOW_H
#include "centres.h"
#include "devices.h"
#include "../machine/machine.h"
#include "../network/network.h"
#include "physics.h"
#include "../network/port.h"
#include "../network/sparse_few.h"
#include "tiles.h"

/* Work arrays, one entry per place: machines, then devices at buses; e: machines and ports; v: two per row of a sparse network. id_rotor is what the
 * rotor circuits see: id, or id + isd. lanes: how many neighbours go at a time (tiles.h).
 * vs, vc, vm: what the inputs of each place add to, one behind the other. */
typedef struct {
    num *sine, *cosine, *i_re, *i_im, *id, *iq, *vd, *vq, *vt, *vs, *vc, *vm, *efd, *pm, *id_rotor;
    num *pe, *ifd, *saturation_d, *saturation_q, *centre, *turn, *out;
    num *e_re, *e_im, *v;
    PortWork port;
    num *newton;
    size_t lanes;
    int exact;   /* the ports' slopes are wanted at the solution */
    int rates;   /* only currents of the network are: no voltages */
    const Warm *own; /* of lanes: what of the ports they keep       */
    Notes notes; /* of the devices' decisions                    */
} Work;

static Work work_arrays(num *scratch, const Plan *plan, size_t lanes)
{
    const size_t n = plan->n_place;
    num *e = scratch + 22 * n, *v = e + 2 * plan->n_source, *port = v + 2 * plan->n_node;
    Work w = { scratch, scratch + n, scratch + 2 * n, scratch + 3 * n, scratch + 4 * n,
               scratch + 5 * n, scratch + 6 * n, scratch + 7 * n, scratch + 8 * n,
               scratch + 9 * n, scratch + 10 * n, scratch + 11 * n, scratch + 12 * n,
               scratch + 13 * n, scratch + 14 * n, scratch + 15 * n, scratch + 16 * n, scratch + 17 * n, scratch + 18 * n,
               scratch + 19 * n, scratch + 20 * n, scratch + 21 * n,
               .e_re = e, .e_im = e + plan->n_source, .v = v, .lanes = lanes };
    w.port = port_arrays(port, plan->n_port);
    w.newton = port + PORT_ARRAYS * plan->n_port;
    return w;
}

static Machines machines_of(const real *memory, const Plan *plan, const num *x, const Work *w)
{
    return (Machines){ memory + plan->machine, plan->n_machine, plan->n_sixth, memory[H_OMEGA_B],
                       machine_states(x, plan->n_machine, plan->n_sixth), plan->folded > 0 ? w->turn : NULL, w->sine, w->cosine, w->e_re, w->e_im,
                       w->i_re, w->i_im, w->id, w->iq, w->vd, w->vq, w->vt, w->efd, w->pm, w->id_rotor, w->ifd,
                       w->saturation_d, w->saturation_q };
}

/* f of machine.h over the machines of each order. */
#define EVERY_MACHINE(f, plan, w, m) do { \
    TILED(f, (w)->lanes, (plan)->n_sixth, m, 0, (plan)->n_sixth); \
    TILED(f, (w)->lanes, (plan)->n_machine - (plan)->n_sixth, m, (plan)->n_sixth, (plan)->n_machine); \
} while (0)

#ifdef PLANT_TANGENT   /* tangent.c: one exact Newton step */
static size_t port_solve_tangent(const double *memory, const Plan *plan, const num *x, const num *linear, double *space,
                                 Work *w);
static void solve_sparse_tangent(const double *memory, const Plan *plan, const Pattern *pattern, const num *x,
                                 const num *base, Work *w);
#endif

#if !defined PLANT_TANGENT && !defined PLANT_LANES
static PortCare port_care(const Work *w)
{
    return w->exact ? PORT_EXACT : w->notes.stage ? PORT_STEP : PORT_ALONE;
}
#endif

/* What the ports inject, into the sources; linear: of few ports on a sparse network their voltages without that. 0, or
 * 1 + the port where Newton's method fails; of several scenarios 0, and NaN in the one for which port.c must help. */
static size_t solve_ports(real *memory, const Plan *plan, const num *x, const num *linear, num *work, Work *w)
{
#ifdef PLANT_TANGENT
    const size_t stuck = port_solve_tangent(memory, plan, x, linear, (double *)(void *)work, w);
    return stuck < plan->n_port ? stuck + 1 : 0;
#else
#ifdef PLANT_LANES
    const PortCare care = w->notes.stage ? PORT_STEP : PORT_ALONE;
    num *b = work, *more = b + 2 * plan->n_port;
    port_linear(memory, plan, 0, w->e_re, w->e_im, linear, b, more);
    const flag failed = port_iterate(memory, plan, 0, care, w->notes.stage, w->own->warm, w->own->keep, b, x, w->sine,
                                     w->cosine, w->e_re, w->e_im, w->port, more);
    w->e_re[plan->n_machine] = num_pick(failed, NUM(NAN), w->e_re[plan->n_machine]);
    return 0;
#else
    const size_t stuck = port_solve(memory, plan, w->lanes, port_care(w), w->exact ? 0 : w->notes.stage, x, w->sine,
                                    w->cosine, w->e_re, w->e_im, linear, w->port, work);
    return stuck < plan->n_port ? stuck + 1 : 0;
#endif
#endif
}

/* Terminals and rotor circuits of the machines that saturate. */
static void saturate_terminals(const real *memory, const Plan *plan, Work *w)
{
    for (size_t k = 0; k < plan->n_machine; ++k) w->id_rotor[k] = w->id[k];
    for (size_t p = 0; p < plan->n_port; ++p) {
        const real *row = memory + plan->port + P_ROWS * p;
        const size_t k = index_at(row, P_DEVICE);
        if (!port_is_machine(row)) continue;
        saturation_terminal(row, k, w->port.isd[p], w->port.isq[p], w->vd, w->vq, w->vt);
        w->id_rotor[k] += w->port.isd[p];
    }
}

static void saturate_rates(const real *memory, const Plan *plan, const Work *w, num *dx)
{
    const size_t n = plan->n_machine;
    for (size_t p = 0; p < plan->n_port; ++p) {
        const real *row = memory + plan->port + P_ROWS * p;
        const size_t k = index_at(row, P_DEVICE);
        if (!port_is_machine(row)) continue;
        saturation_rates(memory + plan->machine, n, k, w->id[k], w->iq[k], w->port.isd[p], w->port.isq[p],
                         machine_rates(dx, n, plan->n_sixth));
    }
}

/* Of few ports: as solve_ports, node voltages into w->v, where what the EMFs inject is and in `base`. */
static size_t solve_few(real *memory, const Plan *plan, const Pattern *pattern, const num *x, num *base, Work *w)
{
    num *z = base + 2 * plan->n_node, *linear = z + 2 * plan->n_node;

    sparse_few_begin(memory, plan, pattern, w->lanes, w->v, z, linear);
    const size_t stuck = solve_ports(memory, plan, x, linear, linear + 2 * plan->n_port, w);
    if (stuck > 0) return stuck;
    sparse_few_end(memory, plan, pattern, w->lanes, base, w->e_re, w->e_im, w->v);
    return 0;
}

/* I = Y E; sources beyond the EMFs are what the ports inject. */
static void solve_dense(const real *memory, const Plan *plan, Work *w)
{
    TILED(num_product_complex, w->lanes, plan->n_machine, memory + plan->y_re, memory + plan->y_im, plan->n_machine,
          plan->n_source, w->e_re, w->e_im, w->i_re, w->i_im);
}

/* The network of a large grid: node voltages into w->v, machine currents. As solve_ports. */
static size_t solve_sparse(real *memory, const Plan *plan, const Pattern *pattern, const num *x, Work *w)
{
    if (w->rates && plan->reduced > 0) {
        solve_dense(memory, plan, w);
        return 0;
    }
    network_inject(memory, plan, pattern, w->e_re, w->e_im, w->v);
    if (plan->n_port == 0) {
        network_solve(memory, plan, pattern, w->lanes, w->v);
        network_machines(memory, plan, pattern, w->e_re, w->e_im, w->v, w->i_re, w->i_im);
        return 0;
    }
    num *base = w->newton;
    memcpy(base + 2 * plan->first, w->v + 2 * plan->first, 2 * (plan->n_node - plan->first) * sizeof(num));
    if (plan->few > 0) {
        const size_t alone = solve_few(memory, plan, pattern, x, base, w);
        if (alone == 0) sparse_port_machines(memory, plan, pattern, w->e_re, w->e_im, w->v, w->i_re, w->i_im);
        return alone;
    }
#ifndef PLANT_LANES   /* block_group_fits */
#ifdef PLANT_TANGENT
    solve_sparse_tangent(memory, plan, pattern, x, base, w);
#else
    const size_t stuck = sparse_port_solve(memory, plan, pattern, w->lanes, port_care(w), x, w->sine, w->cosine, base, w->e_re,
                                           w->e_im, w->port, w->v, base + 2 * plan->n_node);
    if (stuck < plan->n_port) return stuck + 1;
#endif
    sparse_port_machines(memory, plan, pattern, w->e_re, w->e_im, w->v, w->i_re, w->i_im);
#endif
    return 0;
}

#include "seen.h"

/* Terminals of the machines from their currents, and what other devices see. */
static void solve_terminals(const real *memory, const Plan *plan, const Machines *machines, const num *x, Work *w)
{
    EVERY_MACHINE(machine_terminal, plan, w, machines);
    if (ports_of_machines(memory, plan)) saturate_terminals(memory, plan, w);
    else w->id_rotor = w->id;
    if (plan->n_at_bus > 0) see_voltages(memory, plan, x, w);
}

/* The frame in which folded ports are solved turns with the centre of inertia of each part. */
static void turn_frame(const real *memory, const Plan *plan, MachineStates states, Work *w)
{
    find_centres(memory, plan, states, memory + plan->delta_rest, w->centre);
    for (size_t k = 0; k < plan->n_machine; ++k) w->turn[k] = value_at(w->centre, memory[plan->part + k]);
}

/* Angles of the voltage sources at buses, in the frame in which their network is solved; those of other devices are
 * not used. */
static void turn_sources(const real *memory, const Plan *plan, const num *x, Work *w)
{
    if (!(first_at(memory, H_SOURCES) > 0.0)) return;
    for (size_t p = 0; p < plan->n_port; ++p) {
        const real *row = memory + plan->port + P_ROWS * p;
        if (!port_is_device(row) || index_at(row, P_COUPLING) != COUPLING_SOURCE) continue;
        const size_t k = plan->n_machine + index_at(row, P_DEVICE);
        const real part = memory[plan->bus_part + index_at(row, P_BUS)];
        const num turn = plan->folded > 0 ? value_at(w->turn, part) : NUM(0.0);
        num_sincos(x[index_at(row, P_STATE)] - turn, &w->sine[k], &w->cosine[k]);
    }
}

/* Returns 0, or 1 + the port where Newton's method fails. */
static size_t solve_network(real *memory, const Plan *plan, const Pattern *pattern, const num *x, Work *w)
{
    const Machines machines = machines_of(memory, plan, x, w);
    size_t stuck = 0;

    if (plan->folded > 0) turn_frame(memory, plan, machines.x, w);
    EVERY_MACHINE(machine_emf, plan, w, &machines);
    turn_sources(memory, plan, x, w);
    if (is_sparse(plan)) stuck = solve_sparse(memory, plan, pattern, x, w);
    else if (plan->n_port > 0) stuck = solve_ports(memory, plan, x, NULL, w->newton, w);
    if (stuck > 0) return stuck;
    if (!is_sparse(plan)) solve_dense(memory, plan, w);
    solve_terminals(memory, plan, &machines, x, w);
    return 0;
}

/* The currents of blocked dc links die away. */
static void end_blocked(const real *memory, const Plan *plan, const num *x, num *dx)
{
    for (size_t k = 0; k < plan->n_port; ++k) {
        const real *row = memory + plan->port + P_ROWS * k;
        if (index_at(row, P_KIND) != PORT_DEVICE || index_at(row, P_COUPLING) != COUPLING_RECTIFIER) continue;
        const size_t at = index_at(row, P_STATE);
        const num running = NUM(row[P_ON]), ends = num_pick(num_above(NUM(0.5), running), -x[at] / DC_BLOCK_S, dx[at]);
        dx[at] = num_pick(num_above(running, NUM(0.0)), ends, dx[at]);
    }
}

/* A tripped machine or device at a bus and its controls stand still where they were: they no longer count. */
static void hold_tripped(const real *memory, const Plan *plan, const num *x, num *dx)
{
    for (size_t k = 0; k < plan->n_state; ++k) {
        const real running = memory[plan->running + index_at(memory + plan->state_machine, k)];
        dx[k] = num_pick(num_above(NUM(running), NUM(0.5)), dx[k], NUM(0.0));
    }
    end_blocked(memory, plan, x, dx);
}

#ifdef PLANT_HELD
/* Where the overruns of group k begin: every device has as many as its kind decides at most. */
static Notes notes_each(Notes notes, const double *memory, const Plan *plan, size_t k)
{
    const double *row = memory + plan->group;
    if (notes.each == NULL) return notes;
    for (size_t before = 0; before < k; ++before, row += G_ROWS)
        notes.each += index_at(row, G_COUNT) * device_decisions(index_at(row, G_DEVICE));
    notes.most = device_decisions(index_at(row, G_DEVICE));
    return notes;
}

/* Decisions are held one device at a time. A stage of a step need not know how far they are from others: where all
 * of a group are made as they are held, several devices go at a time and have the same bits. */
enum { FEW_DEVICES = 4 };
static void run_group(size_t lanes, size_t device, const DeviceGroup *g, const DeviceSignals *in, const num *x, num *dx)
{
#ifndef __wasm__   /* a page has the same bits without it, and is shorter */
    const int stage = g->notes.each == NULL && g->notes.onto == NULL;
    if (stage && g->n >= FEW_DEVICES && devices_fit(lanes, device, g, in, x, dx)) return;
#else
    (void)lanes;
#endif
    device_run(device, g, in, x, dx);
}
#else
#define notes_each(notes, memory, plan, k) (notes)

static void run_group(size_t lanes, size_t device, const DeviceGroup *g, const DeviceSignals *in, const num *x, num *dx)
{
    TILED(device_run, lanes, g->n, device, g, in, x, dx);
}

#if !defined PLANT_TANGENT && !defined PLANT_LANES && !defined __wasm__
int devices_fit(size_t lanes, size_t device, const DeviceGroup *g, const DeviceSignals *in, const num *x, num *dx)
{
    double switched = 0.0;
    DeviceGroup trial = *g;

    trial.notes.switched = &switched;
    run_group(lanes, device, &trial, in, x, dx);
    return !(switched > 0.0);
}
#endif
#endif

static void run_groups(const real *memory, const Plan *plan, const Work *w, size_t first, size_t last,
                       const DeviceSignals *signals, const num *x, num *dx)
{
    for (size_t k = first; k < last; ++k) {
        const real *row = memory + plan->group + G_ROWS * k;
        const size_t state = index_at(row, G_STATE), machine = index_at(row, G_MACHINE);
        const Notes of = notes_of(&w->notes, machine - plan->device_machine, plan->n_device, state);
        const Notes notes = notes_each(of, memory, plan, k);
        const DeviceGroup group = { memory + index_at(row, G_TABLE), memory + machine, index_at(row, G_COUNT),
                                    (uint64_t)first_at(row, G_HAS), notes };
        run_group(w->lanes, index_at(row, G_DEVICE), &group, signals, x + state, dx + state);
    }
}

/* Field voltages and mechanical powers of all machines: constants of the operating point,
 * or what their devices give. Steps of Vref and the inputs act where the exciters add
 * the stabilizers' signals and the limiters', a step of Pm on the load reference of a governed machine. */
static void solve_devices(const real *memory, const Plan *plan, const num *x, const num *u,
                          num *dx, Work *w)
{
    const size_t n = plan->n_machine;
    const real *table = memory + plan->machine, *of = memory + plan->input_machine;
    const Machines machines = machines_of(memory, plan, x, w);
    const DeviceSignals signals = { w->vt, w->vd, w->vq, w->id, w->iq, w->pe, machines.x.slip, w->ifd,
                                    memory + plan->pm_step, w->vc, w->vs, w->pm, w->efd, w->out, w->out, w->out, w->out,
                                    w->out, w->out, w->out, w->pe, w->ifd, w->vs, w->vc, w->vt, w->pe, w->vd, w->vq,
                                    w->vt, w->pe, w->vd, w->vq, w->id, w->iq, w->efd, w->pm, w->id, w->iq, w->vc, w->vm };

    for (size_t k = 0; k < n; ++k) {
        w->efd[k] = NUM(table[M_EFD0 * n + k]);
        w->pm[k] = NUM(table[M_PM0 * n + k] + memory[plan->pm_step + k]);
        w->vs[k] = w->out[k] = NUM(0.0);
        w->vc[k] = w->vt[k];
        w->pe[k] = w->vd[k] * w->id[k] + w->vq[k] * w->iq[k];
    }
    EVERY_MACHINE(machine_field_currents, plan, w, &machines);
    run_groups(memory, plan, w, 0, plan->exciters, &signals, x, dx);
    for (size_t k = n; k < plan->n_place; ++k) w->vs[k] = w->vc[k] = w->vm[k] = NUM(0.0);
    for (size_t k = 0; k < n; ++k) w->vs[k] += w->out[k];   /* of the limiters */
    for (size_t k = 0; k < plan->n_place; ++k) w->vs[k] += memory[plan->vref_step + k];
    for (size_t k = 0; k < plan->n_input; ++k) w->vs[index_at(of, k)] += u[k];   /* and vc, vm behind it */
    run_groups(memory, plan, w, plan->exciters, plan->n_group, &signals, x, dx);
}

/* Rates of machines and controls from the machines' terminals. */
static void solve_rates(const real *memory, const Plan *plan, const num *x, const num *u, num *dx, Work *w)
{
    const size_t n = plan->n_machine, sixth = plan->n_sixth;

    solve_devices(memory, plan, x, u, dx, w);
    const Machines machines = machines_of(memory, plan, x, w);
    const MachineRates rates = machine_rates(dx, n, sixth);
    TILED(machine_derivatives, w->lanes, sixth, &machines, rates, 0, sixth);
    TILED(machine_derivatives, w->lanes, n - sixth, &machines, rates, sixth, n);
    if (ports_of_machines(memory, plan)) saturate_rates(memory, plan, w, dx);
    if (flag_any(num_above(NUM(memory[H_TRIPPED]), NUM(0.0)))) hold_tripped(memory, plan, x, dx);
}

size_t NAME(plant_flow)(real *memory, const int32_t *places, size_t lanes, const num *x, const num *u, num *dx,
                        num *scratch, Notes notes, const Warm *own_ports)
{
    Plan own;
    const Plan *plan = plan_in(memory, &own);
    const Pattern pattern = pattern_of(places, plan);
    Work w = work_arrays(scratch, plan, lanes);
    w.notes = notes;
    w.rates = 1;
    w.own = own_ports;

    const size_t stuck = solve_network(memory, plan, &pattern, x, &w);
    if (stuck > 0) return stuck;
    solve_rates(memory, plan, x, u, dx, &w);
    return 0;
}

#ifndef PLANT_HELD
#include "shown.h"

/* y: what the record says, in its order. */
size_t NAME(plant_outputs)(real *memory, const int32_t *places, size_t lanes, const num *x, num *y, num *scratch,
                           const Warm *own_ports)
{
    Plan own;
    const Plan *plan = plan_in(memory, &own);
    const Pattern pattern = pattern_of(places, plan);
    Work w = work_arrays(scratch, plan, lanes);
    w.own = own_ports;

    const size_t stuck = solve_network(memory, plan, &pattern, x, &w);
    if (stuck > 0) return stuck;
    show(memory, plan, &pattern, 0, plan->n_y, x, &w, y);
    return 0;
}

#if !defined PLANT_TANGENT && !defined PLANT_LANES
/* Locals: what the record says after the outputs. */
size_t plant_locals(double *memory, const int32_t *places, size_t lanes, const double *x, const double *u,
                    double *locals, double *scratch, double *dx)
{
    Plan own;
    const Plan *plan = plan_in(memory, &own);
    const Pattern pattern = pattern_of(places, plan);
    Work w = work_arrays(scratch, plan, lanes);

    if (plan->n_w == 0) return 0;
    const size_t stuck = solve_network(memory, plan, &pattern, x, &w);
    if (stuck > 0) return stuck;
    solve_devices(memory, plan, x, u, dx, &w);
    show(memory, plan, &pattern, plan->n_y, plan->n_y + plan->n_w, x, &w, locals);
    return 0;
}

size_t plant_voltages(double *memory, const int32_t *places, size_t lanes, const double *x, double *volts,
                      double *scratch)
{
    Plan own;
    const Plan *plan = plan_in(memory, &own);
    const Pattern pattern = pattern_of(places, plan);
    Work w = work_arrays(scratch, plan, lanes);

    const size_t stuck = solve_network(memory, plan, &pattern, x, &w);
    if (stuck > 0) return stuck;
    if (is_sparse(plan)) network_complete(memory, plan, &pattern, lanes, w.v);
    for (size_t k = 0; k < plan->n_bus; ++k) {
        double re, im;
        network_voltage(memory, plan, &pattern, k, w.e_re, w.e_im, w.v, &re, &im);
        volts[k] = bus_shown(memory, plan, SHOW_BUS_RE, k, re, im, &w);
        volts[plan->n_bus + k] = bus_shown(memory, plan, SHOW_BUS_IM, k, re, im, &w);
    }
    return 0;
}

/* Solves the ports at x, so that memory holds their voltages there, and their slopes if the network is sparse. */
size_t plant_settle(double *memory, const int32_t *places, size_t lanes, const double *x, double *scratch)
{
    Plan own;
    const Plan *plan = plan_in(memory, &own);
    const Pattern pattern = pattern_of(places, plan);
    Work w = work_arrays(scratch, plan, lanes);
    w.exact = 1;
    return plan->n_port > 0 ? solve_network(memory, plan, &pattern, x, &w) : 0;
}
#endif
#endif
#endif
