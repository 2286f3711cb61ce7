/* One network stage of a sparse network: its matrix put into the places of the factors,
 * then factored there. Done at the start and at events only. */
#include "sparse_stage.h"

#include "failure.h"
#include "network.h"

static const double SINGULAR = 1e-24;  /* squared pivot against the squared largest entry of its row */
static const double RESIDUAL = 1e-6;   /* most by which a solution may miss */

size_t sparse_stage_work(const Plan *plan) { return 4 * plan->n_node; }

static void add(double *at, const double *table, size_t row, size_t count, size_t k)
{
    at[0] += table[row * count + k];
    at[1] += table[(row + 1) * count + k];
}

/* Where entry `place` of the factors is. */
static double *entry(double *memory, const Plan *plan, int32_t place)
{
    const size_t k = (size_t)place;
    return k < plan->n_fill ? memory + plan->lower + 2 * k : memory + plan->upper + 2 * (k - plan->n_fill);
}

/* What hangs on the diagonal besides branches, by bus. */
static void diagonal(double *memory, const Plan *plan, const Network *net, const Pattern *s, const double *extra)
{
    const size_t n = plan->n_bus, m = plan->n_machine, n_load = plan->n_load;
    double *d = memory + plan->pivot, *g = memory + plan->norton;

    for (size_t k = 0; k < n; ++k) {
        d[2 * s->row[k]] = net->shunt[k] + extra[k];
        d[2 * s->row[k] + 1] = net->shunt[n + k] + extra[n + k];
    }
    for (size_t k = 0; k < n_load; ++k) {
        const double v = net->load[L_V0 * n_load + k];
        double *at = d + 2 * s->row[net->load_bus[k]];
        at[0] += net->load[L_P * n_load + k] / (v * v);
        at[1] -= net->load[L_Q * n_load + k] / (v * v);
    }
    for (size_t k = 0; k < m; ++k) {
        network_norton(memory, plan, k, &g[k], &g[m + k]);
        d[2 * s->machine[k]] += g[k];
        d[2 * s->machine[k] + 1] += g[m + k];
    }
}

/* The matrix in the places of the factors, and its row sums: what it gives for 1 at every bus. */
static void assemble(double *memory, const Plan *plan, const Network *net, const Pattern *s,
                     const double *extra, double *sum)
{
    const size_t m = plan->n_branch;
    double *d = memory + plan->pivot;

    for (size_t k = 0; k < 2 * plan->n_fill; ++k) memory[plan->lower + k] = memory[plan->upper + k] = 0.0;
    diagonal(memory, plan, net, s, extra);
    for (size_t k = 0; k < m; ++k) {
        if (!(memory[plan->in_service + k] > 0.5)) continue;
        add(d + 2 * s->row[net->branch_from[k]], net->branch, B_FF_RE, m, k);
        add(d + 2 * s->row[net->branch_to[k]], net->branch, B_TT_RE, m, k);
        add(entry(memory, plan, s->branch[2 * k]), net->branch, B_FT_RE, m, k);
        add(entry(memory, plan, s->branch[2 * k + 1]), net->branch, B_TF_RE, m, k);
    }
    for (size_t k = 0; k < 2 * plan->n_node; ++k) sum[k] = d[k];
    for (size_t k = 0; k < plan->n_node; ++k) {
        for (int32_t j = s->lower[k]; j < s->lower[k + 1]; ++j) {
            sum[2 * k] += memory[plan->lower + 2 * (size_t)j];
            sum[2 * k + 1] += memory[plan->lower + 2 * (size_t)j + 1];
        }
        for (int32_t j = s->upper[k]; j < s->upper[k + 1]; ++j) {
            sum[2 * k] += memory[plan->upper + 2 * (size_t)j];
            sum[2 * k + 1] += memory[plan->upper + 2 * (size_t)j + 1];
        }
    }
}

static double size_of(const double *a) { return a[0] * a[0] + a[1] * a[1]; }

static void copy(double *to, const double *from) { to[0] = from[0]; to[1] = from[1]; }

/* Row by row: row k less its multiples of the rows above. Returns n_node, or the row whose pivot
 * vanishes. w: 2 n_node. */
static size_t factor(double *memory, const Plan *plan, const Pattern *s, double *w)
{
    double *lower = memory + plan->lower, *upper = memory + plan->upper, *pivot = memory + plan->pivot;

    for (size_t k = 0; k < plan->n_node; ++k) {
        double scale = size_of(pivot + 2 * k);
        copy(w + 2 * k, pivot + 2 * k);
        for (int32_t e = s->lower[k]; e < s->lower[k + 1]; ++e) {
            const double *from = lower + 2 * (size_t)e;
            if (size_of(from) > scale) scale = size_of(from);
            copy(w + 2 * s->lower_column[e], from);
        }
        for (int32_t e = s->upper[k]; e < s->upper[k + 1]; ++e) {
            const double *from = upper + 2 * (size_t)e;
            if (size_of(from) > scale) scale = size_of(from);
            copy(w + 2 * s->upper_column[e], from);
        }
        for (int32_t e = s->lower[k]; e < s->lower[k + 1]; ++e) {
            const size_t j = (size_t)s->lower_column[e];
            const double re = w[2 * j], im = w[2 * j + 1];
            copy(lower + 2 * (size_t)e, w + 2 * j);
            for (int32_t c = s->upper[j]; c < s->upper[j + 1]; ++c) {
                const double ur = upper[2 * (size_t)c], ui = upper[2 * (size_t)c + 1];
                double *at = w + 2 * s->upper_column[c];
                at[0] -= re * ur - im * ui;
                at[1] -= re * ui + im * ur;
            }
        }
        const double size = size_of(w + 2 * k);
        if (!(size > SINGULAR * scale)) return k;
        const double pr = w[2 * k] / size, pi = -w[2 * k + 1] / size;
        pivot[2 * k] = pr;
        pivot[2 * k + 1] = pi;
        for (int32_t e = s->upper[k]; e < s->upper[k + 1]; ++e) {
            const double *at = w + 2 * s->upper_column[e];
            upper[2 * (size_t)e] = at[0] * pr - at[1] * pi;
            upper[2 * (size_t)e + 1] = at[0] * pi + at[1] * pr;
        }
    }
    return plan->n_node;
}

/* Row where the solution for the row sums is farthest from 1; how far into `worst`. */
static size_t farthest(const double *memory, const Plan *plan, const Pattern *s, double *v, double *worst)
{
    size_t row = 0;

    sparse_forward(memory, plan, s, 0, v);
    sparse_backward(memory, plan, s, 0, plan->n_node, v);
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

static size_t bus_at(const Plan *plan, const Pattern *s, size_t row)
{
    size_t bus = 0;
    while (bus + 1 < plan->n_bus && (size_t)s->row[bus] != row) ++bus;
    return bus;
}

BlockStatus sparse_stage(double *memory, const Plan *plan, const Network *net, const double *extra,
                         double *work, BlockMessage *message)
{
    const Pattern s = pattern_of(net->places, plan);
    double *sum = work, *w = sum + 2 * plan->n_node, worst = 0.0;
    char name[64];

    assemble(memory, plan, net, &s, extra, sum);
    size_t row = factor(memory, plan, &s, w);
    if (row == plan->n_node) {
        row = farthest(memory, plan, &s, sum, &worst);
        if (worst <= RESIDUAL) return BLOCK_OK;
    }
    return plant_fail(message, BLOCK_ERROR,
                      "network: the admittance matrix is singular at bus %s; "
                      "check branches, shunts and faults there",
                      plant_name(net->bus_names, bus_at(plan, &s, row), name));
}
