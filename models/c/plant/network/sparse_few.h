#ifndef INTERAREA_SPARSE_FEW_H
#define INTERAREA_SPARSE_FEW_H
#include "network.h"
#include "port.h"
#include "sparse_port.h"
/* Few ports on a sparse network, as the ends of DC lines of a grid whose loads are impedances. The factors are those
 * of Y alone. With y = L^-1 y_E E the ports' voltages without what they inject follow from the rows on the ways from
 * the ports to the last row of the elimination tree; port.c finds the injections J by themselves, with Z = Y^-1 between
 * the ports; then y is renewed in those rows and the rest is one substitution, however often the ports iterate. */

/* v = L^-1 b in the ports' rows, where v is right in all others. */
static inline void sparse_few_forward(const real *memory, const Plan *plan, const Pattern *s, const num *b, num *v)
{
    const real *rows = memory + plan->port_path;
    const size_t count = index_at(memory, H_PORT_PATH);

    for (size_t i = 0; i < count; ++i)
        sparse_forward_row(memory, plan, s, plan->first == 0, index_at(rows, i), b, v);
}

/* z = U^-1 y in the ports' rows. */
static inline void sparse_few_backward(const real *memory, const Plan *plan, const Pattern *s, const num *y, num *z)
{
    const real *rows = memory + plan->port_path;

    for (size_t i = index_at(memory, H_PORT_PATH); i-- > 0;)
        sparse_backward_row(memory, plan, s, index_at(rows, i), y, z);
}

/* Voltages of the ports, real parts and then imaginary ones, without what they inject; y into v, which holds what the
 * EMFs inject. z: 2 n_node. */
static inline void sparse_few_begin(const real *memory, const Plan *plan, const Pattern *s, size_t lanes, num *v, num *z, num *linear)
{
    const size_t n = plan->n_port;

    sparse_forward(memory, plan, s, lanes, plan->first, v);
    sparse_few_backward(memory, plan, s, v, z);
    for (size_t p = 0; p < n; ++p) {
        linear[p] = z[2 * s->port[p]];
        linear[n + p] = z[2 * s->port[p] + 1];
    }
}

/* Node voltages with what the ports inject, e, into v; base: what the EMFs inject, and then all. */
static inline void sparse_few_end(const real *memory, const Plan *plan, const Pattern *s, size_t lanes, num *base, num *e_re, num *e_im,
                                  num *v)
{
    sparse_port_scale(memory, plan, 0, e_re, e_im);
    for (size_t p = 0; p < plan->n_port; ++p) {
        base[2 * s->port[p]] += e_re[plan->n_machine + p];
        base[2 * s->port[p] + 1] += e_im[plan->n_machine + p];
    }
    sparse_few_forward(memory, plan, s, base, v);
    sparse_backward(memory, plan, s, lanes, plan->first, plan->n_node, v);
}
#endif
