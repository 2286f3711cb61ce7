/* One network stage of a sparse network: its matrix put into the places of the factors,
 * then factored there. Done at the start and at events only. */
#include "sparse_stage.h"

#include "../start/failure.h"
#include "../network/network.h"
#include "../network/sparse_factor.h"
#include "../network/sparse_few.h"

static const double RESIDUAL = 1e-6;   /* most by which a solution may miss */

size_t sparse_stage_work(const Plan *plan)
{
    const size_t factor = 6 * plan->n_node, reduce = 2 * plan->n_node + 2 * plan->n_machine;
    return factor > reduce ? factor : reduce;
}

/* The linear matrix: its entries below and above the diagonal, and the diagonal. */
typedef struct { double *entry, *diagonal; } Matrix;

static Matrix matrix_of(double *memory, const Plan *plan)
{
    return (Matrix){ memory + plan->linear, memory + plan->linear + 4 * plan->n_fill };
}

static void add(double *at, double re, double im)
{
    at[0] += re;
    at[1] += im;
}

static void add_row(double *at, const double *table, size_t row, size_t count, size_t k)
{
    add(at, table[row * count + k], table[(row + 1) * count + k]);
}

/* A machine with a port: its EMF acts at the air gap, Ra + j Xl lead to the bus. Tripped, the gap is left
 * to itself at zero volts. */
static void add_gap(double *memory, const Plan *plan, const Pattern *s, Matrix a, size_t port, size_t gap)
{
    const size_t n = plan->n_machine, k = index_at(memory + plan->port + P_ROWS * port, P_DEVICE);
    const double *table = memory + plan->machine;
    const double ratio = table[M_RATIO * n + k] * memory[plan->running + k];
    const double r = table[M_RA * n + k], x = table[M_XL * n + k], size = r * r + x * x;
    const double g = size > 0.0 ? ratio * r / size : 0.0, b = size > 0.0 ? -ratio * x / size : 0.0;
    double *at = a.diagonal + 2 * s->machine[k];

    memory[plan->norton + k] = 0.0;
    memory[plan->norton + n + k] = -ratio / memory[plan->port + P_ROWS * port + P_X2];
    add(at, g, b + memory[plan->norton + n + k]);
    if (!(ratio > 0.0)) at[0] = 1.0;
    add(a.diagonal + 2 * s->row[index_at(memory + plan->machine_bus, k)], g, b);
    add(a.entry + 2 * s->gap[2 * gap], -g, -b);
    add(a.entry + 2 * s->gap[2 * gap + 1], -g, -b);
}

/* Machines with and without a port. */
static void add_machines(double *memory, const Plan *plan, const Pattern *s, Matrix a)
{
    const size_t m = plan->n_machine;
    double *g = memory + plan->norton, *b = g + m;
    size_t gap = 0;

    for (size_t k = 0; k < m; ++k) {
        network_norton(memory, plan, k, &g[k], &b[k]);
        if (s->machine[k] == s->row[index_at(memory + plan->machine_bus, k)])
            add(a.diagonal + 2 * s->machine[k], g[k], b[k]);
    }
    for (size_t p = 0; p < plan->n_port; ++p)
        if (port_is_machine(memory + plan->port + P_ROWS * p)) add_gap(memory, plan, s, a, p, gap++);
}

/* What hangs on the diagonal besides branches. */
static void add_diagonal(double *memory, const Plan *plan, const Network *net, const Pattern *s, const double *extra,
                         const double *dead, Matrix a)
{
    const size_t n = plan->n_bus, n_load = plan->n_load;

    for (size_t k = 0; k < n; ++k)
        if (dead[k] > 0.5) add(a.diagonal + 2 * s->row[k], 1.0, 0.0);   /* V = 0 */
        else add(a.diagonal + 2 * s->row[k], net->shunt[k] + extra[k], net->shunt[n + k] + extra[n + k]);
    for (size_t k = 0; k < n_load; ++k) {
        const double v = net->load[L_V0 * n_load + k];
        if (dead[net->load_bus[k]] > 0.5) continue;
        add(a.diagonal + 2 * s->row[net->load_bus[k]], net->load[L_P * n_load + k] / (v * v),
            -net->load[L_Q * n_load + k] / (v * v));
    }
    add_machines(memory, plan, s, a);
}

/* The matrix in the places of the factors, and its row sums: what it gives for 1 at every node. */
static void assemble(double *memory, const Plan *plan, const Network *net, const Pattern *s,
                     const double *extra, const double *dead, double *sum)
{
    const size_t m = plan->n_branch, fill = plan->n_fill;
    const Matrix a = matrix_of(memory, plan);

    for (size_t k = 0; k < 2 * (2 * fill + plan->n_node); ++k) a.entry[k] = 0.0;
    add_diagonal(memory, plan, net, s, extra, dead, a);
    for (size_t k = 0; k < m; ++k) {
        if (!(memory[plan->in_service + k] > 0.5) || dead[net->branch_from[k]] > 0.5) continue;
        add_row(a.diagonal + 2 * s->row[net->branch_from[k]], net->branch, B_FF_RE, m, k);
        add_row(a.diagonal + 2 * s->row[net->branch_to[k]], net->branch, B_TT_RE, m, k);
        add_row(a.entry + 2 * s->branch[2 * k], net->branch, B_FT_RE, m, k);
        add_row(a.entry + 2 * s->branch[2 * k + 1], net->branch, B_TF_RE, m, k);
    }
    for (size_t k = 0; k < 2 * plan->n_node; ++k) sum[k] = a.diagonal[k];
    for (size_t k = 0; k < plan->n_node; ++k) {
        for (int32_t j = s->lower[k]; j < s->lower[k + 1]; ++j)
            add(sum + 2 * k, a.entry[2 * (size_t)j], a.entry[2 * (size_t)j + 1]);
        for (size_t j = fill + (size_t)s->upper[k]; j < fill + (size_t)s->upper[k + 1]; ++j)
            add(sum + 2 * k, a.entry[2 * j], a.entry[2 * j + 1]);
    }
}

/* Row where the solution for the row sums is farthest from 1; how far into `worst`. */
static size_t farthest(const double *memory, const Plan *plan, const Pattern *s, size_t lanes, double *v, double *worst)
{
    size_t row = 0;

    sparse_forward(memory, plan, s, lanes, 0, v);
    sparse_backward(memory, plan, s, lanes, 0, plan->n_node, v);
    *worst = 0.0;
    for (size_t k = 0; k < plan->n_node; ++k) {
        const double off = fabs(v[2 * k] - 1.0) + fabs(v[2 * k + 1]);
        if (!(off <= *worst)) {
            *worst = off;
            row = k;
        }
    }
    return row;
}

/* The rows from the ports to the last one: all that what they inject or their slopes change. work: n_node. */
static void port_path(double *memory, const Plan *plan, const Pattern *s, double *work)
{
    double *rows = memory + plan->port_path;
    size_t count = 0;

    for (size_t k = 0; k < plan->n_node; ++k) work[k] = 0.0;
    for (size_t p = 0; p < plan->n_port; ++p) work[s->port[p]] = 1.0;
    for (size_t k = 0; k < plan->n_node; ++k) {
        if (!(work[k] > 0.5)) continue;
        rows[count++] = (double)k;
        for (int32_t e = s->upper[k]; e < s->upper[k + 1]; ++e) work[s->upper_column[e]] = 1.0;
    }
    memory[H_PORT_PATH] = (double)count;
}

/* What the injections of few ports give among them. work: 4 n_node. */
static void few_ports(double *memory, const Plan *plan, const Pattern *s, double *work)
{
    const size_t n = plan->n_port;
    const double *ratio = memory + plan->machine + M_RATIO * plan->n_machine;
    double *at = work, *v = at + 2 * plan->n_node;

    for (size_t k = 0; k < 4 * plan->n_node; ++k) work[k] = 0.0;
    for (size_t q = 0; q < n; ++q) {
        const double *row = memory + plan->port + P_ROWS * q;
        const double of = port_is_machine(row) ? ratio[index_at(row, P_DEVICE)] : 1.0;
        at[2 * s->port[q]] = of;
        sparse_few_forward(memory, plan, s, at, v);
        at[2 * s->port[q]] = 0.0;
        sparse_few_backward(memory, plan, s, v, v);
        for (size_t p = 0; p < n; ++p) {
            memory[plan->port_own_re + q * n + p] = v[2 * s->port[p]];
            memory[plan->port_own_im + q * n + p] = v[2 * s->port[p] + 1];
        }
    }
}

/* Machine currents from the EMFs, by columns, for rates, which ask for nothing else. work: 2 n_node + 2 n_machine. */
static void reduce(double *memory, const Plan *plan, const Pattern *s, size_t lanes, double *work)
{
    const size_t n = plan->n_machine;
    double *v = work, *e_re = v + 2 * plan->n_node, *e_im = e_re + n;

    for (size_t k = 0; k < 2 * n; ++k) e_re[k] = 0.0;
    for (size_t k = 0; k < n; ++k) {
        e_re[k] = 1.0;
        network_inject(memory, plan, s, e_re, e_im, v);
        network_solve(memory, plan, s, lanes, v);
        network_machines(memory, plan, s, e_re, e_im, v, memory + plan->y_re + k * n, memory + plan->y_im + k * n);
        e_re[k] = 0.0;
    }
}

/* n_bus: an air gap, whose pivot cannot vanish. */
static size_t bus_at(const Plan *plan, const Pattern *s, size_t row)
{
    for (size_t k = 0; k < plan->n_bus; ++k)
        if ((size_t)s->row[k] == row) return k;
    return plan->n_bus;
}

BlockStatus sparse_stage(double *memory, const Plan *plan, const Network *net, size_t lanes, const double *extra,
                         const double *dead, double *work, BlockMessage *message)
{
    const Pattern s = pattern_of(net->places, plan);
    double *sum = work, *w = sum + 2 * plan->n_node, worst = 0.0;
    char name[64];

    memory[H_PORT_READY] = 0.0;
    for (size_t k = 0; k < 4 * plan->n_port; ++k) memory[plan->port_slope + k] = 0.0;
    assemble(memory, plan, net, &s, extra, dead, sum);
    if (plan->n_port > 0) port_path(memory, plan, &s, w);
    size_t row = sparse_factor(memory, plan, &s, lanes, SPARSE_ALL, w);
    if (plan->width == 4) sparse_port_forget(memory, plan);
    if (row == plan->n_node) {
        row = farthest(memory, plan, &s, lanes, sum, &worst);
        if (worst <= RESIDUAL) {
            if (plan->few > 0) few_ports(memory, plan, &s, work);
            if (plan->reduced > 0) reduce(memory, plan, &s, lanes, work);
            return BLOCK_OK;
        }
    }
    return plant_fail(message, BLOCK_ERROR,
                      "network: the admittance matrix is singular at bus %s; "
                      "check branches, shunts and faults there",
                      plant_name(net->bus_names, bus_at(plan, &s, row), name));
}
