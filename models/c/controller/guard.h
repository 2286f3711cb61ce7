/* Guards: which side of the limit of an output falls while a first swing lasts.
 *
 * An output with a guard watches s, a weighted sum of inputs: how far s has left
 * its slow course says that a first swing lasts, and meanwhile the side that would
 * add to that swing falls towards zero:
 *
 *     dw/dt = (s - w) / washout,   dl/dt = (s - w - l) / lowpass,
 *     q = min(1, max(|s - w|, |l|) / threshold),
 *     high = limit (1 - q side) where side > 0,   low = limit (1 + q side) where side < 0
 *
 * The record has the weights as `guard`, a row of all inputs for each output (zeros:
 * no guard). The states w, l of each guarded output follow each other.          */
#ifndef GUARD_H
#define GUARD_H

#include <math.h>

#include "../block/block.h"

typedef struct {
    size_t guards, inputs;
    const double *weights;              /* per output a row of inputs; NULL: no guards */
    const double *side;                 /* per guard */
    double threshold, washout, lowpass;
} Guards;

/* What a guard sees: signal behind the washout and its low pass, and their share of the threshold. */
typedef struct { double fast, slow, share; } Swing;

static inline int guards_watch(const Guards *g, size_t output)
{
    if (g->weights == NULL) return 0;
    for (size_t j = 0; j < g->inputs; ++j)
        if (g->weights[output * g->inputs + j] != 0.0) return 1;
    return 0;
}

static inline double guards_seen(const Guards *g, size_t output, const double *u)
{
    double sum = 0.0;

    for (size_t j = 0; j < g->inputs; ++j) sum += g->weights[output * g->inputs + j] * u[j];
    return sum;
}

/* Weights of the record, and how many outputs have a guard. */
static inline Guards guards_of(const Record *record, size_t outputs, size_t inputs)
{
    Guards g = {0, inputs, NULL, NULL, 1.0, 1.0, 1.0};
    size_t count;

    g.weights = record_f64(record, "guard", &count);
    if (g.weights == NULL || count != outputs * inputs) return g.weights = NULL, g;
    for (size_t i = 0; i < outputs; ++i) g.guards += guards_watch(&g, i) ? 1u : 0u;
    return g;
}

/* p: side of each guarded output, threshold, washout, lowpass. */
static inline void guards_set(Guards *g, const double *p)
{
    if (g->guards == 0) return;
    g->side = p;
    g->threshold = p[g->guards];
    g->washout = p[g->guards + 1];
    g->lowpass = p[g->guards + 2];
}

static inline int guards_can_act(const Guards *g)
{
    return g->threshold > 0.0 && g->washout > 0.0 && g->lowpass > 0.0;
}

/* x: the two states of this guard. */
static inline Swing guards_swing(const Guards *g, const double *x, double seen)
{
    Swing s;

    s.fast = seen - x[0];
    s.slow = x[1];
    s.share = fmin(1.0, fmax(fabs(s.fast), fabs(s.slow)) / g->threshold);
    return s;
}

static inline void guards_derivatives(const Guards *g, double fast, double slow, double *dx)
{
    dx[0] = fast / g->washout;
    dx[1] = (fast - slow) / g->lowpass;
}

/* Derivative of limit (1 - |share side turn|) on the side that falls; vturn: of the turn. */
static inline double guards_slope(const Guards *g, const Swing *s, size_t guard, double limit, double turn,
                                  double vfast, double vslow, double vturn)
{
    const double moved = fabs(s->fast) >= fabs(s->slow) ? copysign(vfast, s->fast * vfast)
                                                        : copysign(vslow, s->slow * vslow);
    const double vshare = s->share < 1.0 ? moved / g->threshold : 0.0;

    return -limit * fabs(g->side[guard]) * (fabs(turn) * vshare + s->share * copysign(vturn, turn * vturn));
}

#endif
