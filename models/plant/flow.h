/* The right-hand side and the outputs, written once over `num`; flow.c compiles
 * it as double, tangent.c as double complex. The order is that of the physics:
 * angles -> EMFs -> network -> terminals -> stabilizers -> exciters -> governors
 * -> machines. Outputs depend on the states only. */
#ifndef INTERAREA_FLOW_H
#define INTERAREA_FLOW_H
#include "exciter.h"
#include "governor.h"
#include "machine.h"
#include "network.h"
#include "plant.h"
#include "stabilizer.h"

/* Work arrays, one entry per machine. */
typedef struct {
    num *sine, *cosine, *e_re, *e_im, *i_re, *i_im, *id, *iq, *vd, *vq, *vt, *vs, *efd, *pm;
} Work;

static Work work_arrays(num *scratch, size_t n)
{
    return (Work){ scratch, scratch + n, scratch + 2 * n, scratch + 3 * n, scratch + 4 * n,
                   scratch + 5 * n, scratch + 6 * n, scratch + 7 * n, scratch + 8 * n,
                   scratch + 9 * n, scratch + 10 * n, scratch + 11 * n, scratch + 12 * n,
                   scratch + 13 * n };
}

static void solve_network(const double *memory, const Plan *plan, const num *x, Work *w)
{
    const size_t n = plan->n_machine;
    const double *table = memory + plan->machine;
    const MachineStates states = machine_states(x, n);

    machine_emf(n, states, w->sine, w->cosine, w->e_re, w->e_im);
    network_currents(memory, plan, w->e_re, w->e_im, w->i_re, w->i_im);
    machine_terminal(table, n, states, w->sine, w->cosine, w->i_re, w->i_im,
                     w->id, w->iq, w->vd, w->vq, w->vt);
}

static void solve_devices(const double *memory, const Plan *plan, const num *x, const num *u,
                          num *dx, Work *w)
{
    const size_t n = plan->n_machine;
    const MachineStates states = machine_states(x, n);

    stabilizer_all(memory, plan, states.slip, x, dx, w->vs);
    exciter_all(memory, plan, w->vt, w->id, w->vs, u, x, dx, w->efd);
    governor_all(memory, plan, states.slip, x, dx, w->pm);
}

void NAME(plant_flow)(const double *memory, const num *x, const num *u, num *dx, num *scratch)
{
    Plan plan;
    plan_of(memory, &plan);
    const size_t n = plan.n_machine;
    Work w = work_arrays(scratch, n);

    solve_network(memory, &plan, x, &w);
    solve_devices(memory, &plan, x, u, dx, &w);
    machine_derivatives(memory + plan.machine, n, memory[H_OMEGA_B], machine_states(x, n),
                        w.id, w.iq, w.efd, w.pm, machine_rates(dx, n));
    machine_hold(memory + plan.running, n, machine_rates(dx, n));
}

/* y: dw, delta to the centre of inertia, pe, vt of each machine; then the tie's
 * power if the case has one. */
void NAME(plant_outputs)(const double *memory, const num *x, num *y, num *scratch)
{
    Plan plan;
    plan_of(memory, &plan);
    const size_t n = plan.n_machine;
    const MachineStates states = machine_states(x, n);
    Work w = work_arrays(scratch, n);
    num centre = 0.0;

    solve_network(memory, &plan, x, &w);
    for (size_t k = 0; k < n; ++k) centre += memory[plan.coi + k] * states.delta[k];
    for (size_t k = 0; k < n; ++k) {
        y[4 * k] = states.slip[k];
        y[4 * k + 1] = states.delta[k] - centre;
        y[4 * k + 2] = (w.vd[k] * w.id[k] + w.vq[k] * w.iq[k]) * memory[plan.machine + M_RATIO * n + k];
        y[4 * k + 3] = w.vt[k];
    }
    if (plan.n_tie > 0) y[4 * n] = network_tie_power(memory, &plan, w.e_re, w.e_im);
}

#ifndef PLANT_TANGENT
/* Locals: every bus voltage, then Efd and Pm of each machine. */
void plant_locals(const double *memory, const double *x, const double *u, double *locals,
                  double *scratch, double *dx)
{
    Plan plan;
    plan_of(memory, &plan);
    const size_t n = plan.n_machine;
    Work w = work_arrays(scratch, n);

    solve_network(memory, &plan, x, &w);
    solve_devices(memory, &plan, x, u, dx, &w);
    for (size_t k = 0; k < plan.n_bus; ++k) {
        double re, im;
        network_voltage(memory, &plan, k, w.e_re, w.e_im, &re, &im);
        locals[k] = sqrt(re * re + im * im);
    }
    for (size_t k = 0; k < n; ++k) {
        locals[plan.n_bus + 2 * k] = w.efd[k];
        locals[plan.n_bus + 2 * k + 1] = w.pm[k];
    }
}
#endif
#endif
