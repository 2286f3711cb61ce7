/* One network stage: the admittance matrix of the buses with what is switched
 * now, reduced to the machines. Done at the start and at events only. */
#include "topology.h"

#include <stdio.h>

#include "../start/failure.h"
#include "../network/network.h"
#include "../network/port.h"
#include "sparse_stage.h"

static const double REST_AGAIN_S = 0.25;   /* ports' slopes other than those at rest are kept so long (port.h) */

size_t topology_work(const Plan *plan)
{
    const size_t n = plan->n_bus;
    const size_t stage = is_sparse(plan) ? sparse_stage_work(plan) : 2 * n * n + 3 * n;
    const size_t ports = plan->n_port * plan->folded, fold = 2 * plan->n_machine + (6 + 8 * ports) * ports;
    return 2 * n + (stage > fold ? stage : fold);
}

static void add(double *a, size_t n, size_t row, size_t col, double re, double im)
{
    a[2 * (row * n + col)] += re;
    a[2 * (row * n + col) + 1] += im;
}

/* Voltages of all buses for each source, by column of `v`: an EMF of 1, a current
 * of 1 at a port at a bus, or at a machine's port an EMF of j (Xd2 - Xl). */
static size_t source_at(const double *memory, const Plan *plan, const Network *net, size_t source,
                        double *re, double *im, size_t *machine)
{
    double g, b;
    const double *row = memory + plan->port + P_ROWS * (source < plan->n_machine ? 0 : source - plan->n_machine);

    *machine = source < plan->n_machine ? source : plan->n_machine;
    if (source >= plan->n_machine && !port_is_machine(row)) {
        *re = 1.0;
        *im = 0.0;
        return port_bus(net, row);
    }
    if (source >= plan->n_machine) *machine = index_at(row, P_DEVICE);
    network_norton(memory, plan, *machine, &g, &b);
    *re = source < plan->n_machine ? g : -b * row[P_X2];
    *im = source < plan->n_machine ? b : g * row[P_X2];
    return index_at(memory + plan->machine_bus, *machine);
}

/* EMF of machine k per unit of a source: 1 for its own, j (Xd2 - Xl) for its port. */
static void own_emf(const double *memory, const Plan *plan, size_t source, size_t machine, size_t k,
                    double *re, double *im)
{
    *re = *im = 0.0;
    if (machine != k) return;
    if (source < plan->n_machine) *re = 1.0;
    else *im = memory[plan->port + P_ROWS * (source - plan->n_machine) + P_X2];
}

/* Voltage of port p from a source that gives the bus voltages v: the bus itself, or
 * the air-gap node V + (Ra + j Xl)/(Ra + j Xd2) (E - V). */
static void port_row(double *memory, const Plan *plan, const Network *net, size_t source, size_t machine,
                     const double *v)
{
    const size_t n = plan->n_machine;
    const double *table = memory + plan->machine;

    for (size_t p = 0; p < plan->n_port; ++p) {
        const double *row = memory + plan->port + P_ROWS * p;
        const size_t k = index_at(row, P_DEVICE), at = source * plan->n_port + p;
        const size_t bus = port_bus(net, row);
        double re = v[2 * bus], im = v[2 * bus + 1];
        if (port_is_machine(row)) {
            const double r = table[M_RA * n + k], xl = table[M_XL * n + k], x = table[M_XD2 * n + k];
            const double size = r * r + x * x, kr = (r * r + xl * x) / size, ki = (xl - x) * r / size;
            double er, ei;
            own_emf(memory, plan, source, machine, k, &er, &ei);
            er -= v[2 * bus];
            ei -= v[2 * bus + 1];
            re += kr * er - ki * ei;
            im += kr * ei + ki * er;
        }
        memory[plan->port_w_re + at] = re;
        memory[plan->port_w_im + at] = im;
    }
}

static void assemble(const double *memory, const Plan *plan, const Network *net,
                     const double *extra, const double *dead, double *a)
{
    const size_t n = plan->n_bus, m = plan->n_branch, n_load = plan->n_load;

    for (size_t k = 0; k < 2 * n * n; ++k) a[k] = 0.0;
    for (size_t k = 0; k < n; ++k)
        if (dead[k] > 0.5) a[2 * (k * n + k)] = 1.0;   /* V = 0 */
        else add(a, n, k, k, net->shunt[k] + extra[k], net->shunt[n + k] + extra[n + k]);
    for (size_t k = 0; k < m; ++k) {
        if (!(memory[plan->in_service + k] > 0.5) || dead[net->branch_from[k]] > 0.5) continue;
        const size_t f = (size_t)net->branch_from[k], t = (size_t)net->branch_to[k];
        const double *y = net->branch + k;
        add(a, n, f, f, y[B_FF_RE * m], y[B_FF_IM * m]);
        add(a, n, f, t, y[B_FT_RE * m], y[B_FT_IM * m]);
        add(a, n, t, f, y[B_TF_RE * m], y[B_TF_IM * m]);
        add(a, n, t, t, y[B_TT_RE * m], y[B_TT_IM * m]);
    }
    for (size_t k = 0; k < n_load; ++k) {
        const double v = net->load[L_V0 * n_load + k];
        if (dead[net->load_bus[k]] > 0.5) continue;
        add(a, n, (size_t)net->load_bus[k], (size_t)net->load_bus[k],
            net->load[L_P * n_load + k] / (v * v), -net->load[L_Q * n_load + k] / (v * v));
    }
    for (size_t k = 0; k < plan->n_machine; ++k) {
        const size_t bus = index_at(memory + plan->machine_bus, k);
        double g, b;
        network_norton(memory, plan, k, &g, &b);
        add(a, n, bus, bus, g, b);
    }
}

/* LU with partial pivoting, in place; order[k] is the row that stands at k.
 * Returns n, or the column whose pivot vanishes. */
static size_t factor(double *a, size_t n, double *order)
{
    for (size_t k = 0; k < n; ++k) order[k] = (double)k;
    for (size_t k = 0; k < n; ++k) {
        size_t best = k;
        double size = 0.0, scale = 0.0;
        for (size_t i = k; i < n; ++i) {
            const double re = a[2 * (i * n + k)], im = a[2 * (i * n + k) + 1];
            if (!(re * re + im * im <= size)) {
                size = re * re + im * im;
                best = i;
            }
        }
        for (size_t j = 0; j < n; ++j) {
            const double re = a[2 * (best * n + j)], im = a[2 * (best * n + j) + 1];
            if (re * re + im * im > scale) scale = re * re + im * im;
        }
        if (!(size > 1e-24 * scale)) return k;
        if (best != k) {
            const double row = order[k];
            order[k] = order[best];
            order[best] = row;
            for (size_t j = 0; j < 2 * n; ++j) {
                const double v = a[2 * k * n + j];
                a[2 * k * n + j] = a[2 * best * n + j];
                a[2 * best * n + j] = v;
            }
        }
        const double pr = a[2 * (k * n + k)] / size, pi = -a[2 * (k * n + k) + 1] / size;
        for (size_t i = k + 1; i < n; ++i) {
            double *row = a + 2 * i * n;
            const double re = row[2 * k], im = row[2 * k + 1];
            if (re == 0.0 && im == 0.0) continue;
            const double fr = re * pr - im * pi, fi = re * pi + im * pr;
            row[2 * k] = fr;
            row[2 * k + 1] = fi;
            for (size_t j = k + 1; j < n; ++j) {
                const double ur = a[2 * (k * n + j)], ui = a[2 * (k * n + j) + 1];
                row[2 * j] -= fr * ur - fi * ui;
                row[2 * j + 1] -= fr * ui + fi * ur;
            }
        }
    }
    return n;
}

/* Solves for the right-hand side with (re, im) at `source` and zero elsewhere. */
static void solve(const double *a, size_t n, const double *order, size_t source,
                  double re, double im, double *v)
{
    for (size_t i = 0; i < n; ++i) {
        const int is_source = (size_t)(ptrdiff_t)order[i] == source;
        double vr = is_source ? re : 0.0, vi = is_source ? im : 0.0;
        for (size_t j = 0; j < i; ++j) {
            const double ar = a[2 * (i * n + j)], ai = a[2 * (i * n + j) + 1];
            vr -= ar * v[2 * j] - ai * v[2 * j + 1];
            vi -= ar * v[2 * j + 1] + ai * v[2 * j];
        }
        v[2 * i] = vr;
        v[2 * i + 1] = vi;
    }
    for (size_t i = n; i-- > 0;) {
        double vr = v[2 * i], vi = v[2 * i + 1];
        for (size_t j = i + 1; j < n; ++j) {
            const double ar = a[2 * (i * n + j)], ai = a[2 * (i * n + j) + 1];
            vr -= ar * v[2 * j] - ai * v[2 * j + 1];
            vi -= ar * v[2 * j + 1] + ai * v[2 * j];
        }
        const double ar = a[2 * (i * n + i)], ai = a[2 * (i * n + i) + 1];
        const double size = ar * ar + ai * ai;
        v[2 * i] = (vr * ar + vi * ai) / size;
        v[2 * i + 1] = (vi * ar - vr * ai) / size;
    }
}

/* First bus of the part of the network that bus k belongs to, paths halved on the way. */
static size_t part_of(double *part, size_t k)
{
    while (index_at(part, k) != k) {
        part[k] = part[index_at(part, k)];
        k = index_at(part, k);
    }
    return k;
}

/* Loads and devices at dead buses give nothing. */
static void silence_ports(double *memory, const Plan *plan, const Network *net, const double *dead)
{
    for (size_t k = 0; k < plan->n_port; ++k) {
        double *row = memory + plan->port + P_ROWS * k;
        if (port_is_machine(row) || !(dead[port_bus(net, row)] > 0.5)) continue;
        if (port_is_load(row)) row[P_P] = row[P_Q] = 0.0;
        else row[P_ON] = 0.0;
    }
}

/* Which buses hang together, and the first machine of each machine's and bus's part. A part where no machine runs is
 * dead: 1 in `dead` for its buses, and its loads draw nothing. part, first: a number for each bus. */
static void find_parts(double *memory, const Plan *plan, const Network *net, double *part, double *first, double *dead)
{
    double parts = 0.0, buses = 0.0;

    for (size_t k = 0; k < plan->n_bus; ++k) {
        part[k] = (double)k;
        first[k] = (double)plan->n_machine;
        dead[k] = 1.0;
    }
    for (size_t k = 0; k < plan->n_branch; ++k) {
        if (!(memory[plan->in_service + k] > 0.5)) continue;
        const size_t f = part_of(part, (size_t)net->branch_from[k]), t = part_of(part, (size_t)net->branch_to[k]);
        part[f > t ? f : t] = (double)(f > t ? t : f);
    }
    for (size_t k = 0; k < plan->n_machine; ++k) {
        const size_t of = part_of(part, index_at(memory + plan->machine_bus, k));
        if (!(first[of] < (double)plan->n_machine)) first[of] = (double)k;
        memory[plan->part + k] = first[of];
        if (!(memory[plan->running + k] > 0.5)) continue;
        if (dead[of] > 0.5) parts += 1.0;
        dead[of] = 0.0;
    }
    for (size_t k = 0; k < plan->n_bus; ++k) {
        dead[k] = dead[part_of(part, k)];
        buses += dead[k];
        memory[plan->bus_part + k] = dead[k] > 0.5 ? 0.0 : first[part_of(part, k)];
    }
    silence_ports(memory, plan, net, dead);
    memory[H_PARTS] = parts;
    memory[H_DEAD] = buses;
}

/* A remark where the network falls apart, or hangs together otherwise than before. */
static void tell_parts(const double *memory, const Plan *plan, const Network *net, const double *dead, double parts,
                       double buses, BlockMessage *message)
{
    char name[64], rest[64] = "";
    size_t k = 0, length;

    if (memory[H_PARTS] == parts && memory[H_DEAD] == buses) return;
    if (memory[H_DEAD] > 0.0) {
        while (k + 1 < plan->n_bus && !(dead[k] > 0.5)) ++k;
        if (memory[H_DEAD] > 1.0) (void)snprintf(rest, sizeof rest, " and %.0f more", memory[H_DEAD] - 1.0);
        (void)plant_fail(message, BLOCK_OK, "network: bus %s%s removed, no running machine is connected to it; ",
                         plant_name(net->bus_names, k, name), rest);
    } else {
        (void)plant_fail(message, BLOCK_OK, "network: ");
    }
    length = strlen(message->text);
    if (memory[H_PARTS] > 1.0)
        (void)snprintf(message->text + length, sizeof message->text - length,
                       "%.0f islands remain, each with its own centre of inertia", memory[H_PARTS]);
    else
        (void)snprintf(message->text + length, sizeof message->text - length, "%s",
                       memory[H_DEAD] > 0.0 ? "the rest remains connected" : "all buses are connected again");
}

static BlockStatus dense_stage(double *memory, const Plan *plan, const Network *net, const double *extra,
                               const double *dead, double *work, BlockMessage *message)
{
    const size_t n = plan->n_bus, m = plan->n_machine;
    double *a = work, *order = a + 2 * n * n, *v = order + n;
    char name[64];

    assemble(memory, plan, net, extra, dead, a);
    const size_t stuck = factor(a, n, order);
    if (stuck < n)
        return plant_fail(message, BLOCK_ERROR,
                          "network: the admittance matrix is singular at bus %s; "
                          "check branches, shunts and faults there",
                          plant_name(net->bus_names, stuck, name));

    for (size_t k = 0; k < plan->n_source; ++k) {
        double re, im;
        size_t machine;
        const size_t at = source_at(memory, plan, net, k, &re, &im, &machine);
        solve(a, n, order, at, re, im, v);
        for (size_t i = 0; i < n; ++i) {
            memory[plan->v_re + i * plan->n_source + k] = v[2 * i];
            memory[plan->v_im + i * plan->n_source + k] = v[2 * i + 1];
        }
        for (size_t j = 0; j < m; ++j) {
            const size_t bus = index_at(memory + plan->machine_bus, j);
            double gj, bj, er, ei;
            network_norton(memory, plan, j, &gj, &bj);
            own_emf(memory, plan, k, machine, j, &er, &ei);
            const double dr = er - v[2 * bus], di = ei - v[2 * bus + 1];
            memory[plan->y_re + k * m + j] = gj * dr - bj * di;
            memory[plan->y_im + k * m + j] = gj * di + bj * dr;
        }
        port_row(memory, plan, net, k, machine, v);
    }
    return BLOCK_OK;
}

BlockStatus topology_build(double *memory, const Plan *plan, const Network *net, size_t lanes, const double *extra,
                           double *work, BlockMessage *message)
{
    const size_t n = plan->n_bus;
    const double parts = memory[H_PARTS], buses = memory[H_DEAD];
    double *dead = work + n, *more = work + 2 * n;

    find_parts(memory, plan, net, work, more, dead);
    if (parts > 0.0 || memory[H_PARTS] > 1.0 || memory[H_DEAD] > 0.0)   /* at the start all in one is no news */
        tell_parts(memory, plan, net, dead, parts, buses, message);
    const BlockStatus status = is_sparse(plan) ? sparse_stage(memory, plan, net, lanes, extra, dead, more, message)
                                               : dense_stage(memory, plan, net, extra, dead, more, message);
    if (status == BLOCK_OK && plan->folded > 0) port_fold_at_rest(memory, plan, lanes, REST_AGAIN_S, more);
    return status;
}
