#ifndef INTERAREA_KERNEL_NODE_H
#define INTERAREA_KERNEL_NODE_H
/* One node: what it is sent, what is read from it, its state saved and put back. */
#include <math.h>

#include "signals.h"

/* Looks at what a call returned: a warning is counted, what is worse is a failure. */
static int call_failed(Kernel *k, KernelNode *node, int call, fmi2Status status)
{
    if (status == fmi2OK) return 0;
    if (status == fmi2Warning) {
        int64_t before = 0;
        for (int i = 0; i < CALL_COUNT; ++i) before += node->warnings[i];
        if (before == 0) node->first_warning = node->time;
        ++node->warnings[call];
        return 0;
    }
    k->node = (int32_t)(node - k->nodes);
    k->call = call;
    k->status = (int32_t)status;
    return 1;
}

/* Sets the inputs from u (Reals) and the others' signals, and derivatives up to `order` from du. */
static int send(Kernel *k, KernelNode *node, int order)
{
    fmi2Status status;

    if (node->n_u_real > 0) {
        const size_t n = (size_t)node->n_u_real;
        status = node->set_real(node->component, node->u_reference, n, node->u);
        if (call_failed(k, node, CALL_SET_REAL, status)) return KERNEL_CALL_FAILED;
        if (order > 0) {
            status = node->set_derivatives(node->component, node->du_reference, n * (size_t)order,
                                           node->du_order, node->du);
            if (call_failed(k, node, CALL_SET_DERIVATIVES, status)) return KERNEL_CALL_FAILED;
        }
    }
    for (int i = node->n_u_real; i < node->n_u; ++i) {
        const KernelFeed *feed = node->feeds + i;
        const int value = (int)(feed->gain * k->signals[feed->signal].d[0] + feed->offset);
        status = feed->type == TYPE_BOOLEAN
                     ? node->set_boolean(node->component, node->u_reference + i, 1, &value)
                     : node->set_integer(node->component, node->u_reference + i, 1, &value);
        if (call_failed(k, node, CALL_SET_INTEGER, status)) return KERNEL_CALL_FAILED;
    }
    return KERNEL_OK;
}

/* The node's inputs over the whole step as polynomials (order 0: held). */
static int send_whole(Kernel *k, KernelNode *node)
{
    const int order = node->order;
    double *du = node->du;

    for (int i = 0; i < node->n_u_real; ++i) {
        const KernelFeed *feed = node->feeds + i;
        const double *d = k->signals[feed->signal].d;
        node->u[i] = feed->gain == 1.0 && feed->offset == 0.0 ? d[0] : feed->gain * d[0] + feed->offset;
        for (int m = 1; m <= order; ++m) *du++ = feed->gain * d[m];
    }
    return send(k, node, order);
}

/* The mean of the inputs between a and b seconds into the step. */
static int send_mean(Kernel *k, KernelNode *node, double a, double b)
{
    for (int i = 0; i < node->n_u_real; ++i) {
        const KernelFeed *feed = node->feeds + i;
        node->u[i] = feed->gain * mean_between(k->signals[feed->signal].d, a, b) + feed->offset;
    }
    return send(k, node, 0);
}

/* The inputs at the end of the step. */
static int send_end(Kernel *k, KernelNode *node, double length_s)
{
    for (int i = 0; i < node->n_u_real; ++i) {
        const KernelFeed *feed = node->feeds + i;
        node->u[i] = feed->gain * value_at(k->signals[feed->signal].d, length_s) + feed->offset;
    }
    return send(k, node, 0);
}

/* Reads the outputs into their columns of `row`, and the slopes. */
static int receive(Kernel *k, KernelNode *node, double *row)
{
    double *y = node->y = row + node->column;
    const int n_real = node->n_real, n_integer = node->n_integer, n_boolean = node->n_boolean;
    const int32_t *place = node->y_place;
    fmi2Status status;

    if (n_real > 0) {
        const int direct = n_real == node->n_y;
        status = node->get_real(node->component, node->y_reference, (size_t)n_real, direct ? y : node->y_real);
        if (call_failed(k, node, CALL_GET_REAL, status)) return KERNEL_CALL_FAILED;
        if (!direct)
            for (int i = 0; i < n_real; ++i) y[place[i]] = node->y_real[i];
    }
    if (n_integer > 0) {
        status = node->get_integer(node->component, node->y_reference + n_real, (size_t)n_integer,
                                   node->y_integer);
        if (call_failed(k, node, CALL_GET_INTEGER, status)) return KERNEL_CALL_FAILED;
    }
    if (n_boolean > 0) {
        status = node->get_boolean(node->component, node->y_reference + n_real + n_integer,
                                   (size_t)n_boolean, node->y_integer + n_integer);
        if (call_failed(k, node, CALL_GET_INTEGER, status)) return KERNEL_CALL_FAILED;
    }
    for (int i = 0; i < n_integer + n_boolean; ++i) y[place[n_real + i]] = (double)node->y_integer[i];
    if (node->n_dy > 0) {
        status = node->get_derivatives(node->component, node->dy_reference, (size_t)node->n_dy,
                                       node->dy_order, node->dy);
        if (call_failed(k, node, CALL_GET_DERIVATIVES, status)) return KERNEL_CALL_FAILED;
    }
    const KernelSignal *sent = k->signals + node->first_signal;   /* what nobody takes harms nobody */
    for (int i = 0; i < node->n_signals; ++i)
        if (!isfinite(y[sent[i].index])) {
            k->node = (int32_t)(node - k->nodes);
            return KERNEL_NOT_FINITE;
        }
    return KERNEL_OK;
}

static int save_members(Kernel *k, const KernelGroup *group)
{
    for (int i = 0; i < group->count; ++i) {
        KernelNode *node = k->nodes + k->members[group->first + i];
        const fmi2Status status = node->get_state(node->component, &node->state);
        if (call_failed(k, node, CALL_GET_STATE, status)) return KERNEL_CALL_FAILED;
    }
    return KERNEL_OK;
}

static int restore_members(Kernel *k, const KernelGroup *group)
{
    for (int i = 0; i < group->count; ++i) {
        KernelNode *node = k->nodes + k->members[group->first + i];
        const fmi2Status status = node->set_state(node->component, node->state);
        if (call_failed(k, node, CALL_SET_STATE, status)) return KERNEL_CALL_FAILED;
    }
    return KERNEL_OK;
}

#endif
