/* The physics over double complex: exact directional derivatives by the complex
 * step, f(x + i h v) = f(x) + i h f'(x) v + O(h^2), where h^2 vanishes against
 * rounding.                                        [Squire and Trapp, 1998] */
#define PLANT_TANGENT
#include "flow.h"

static const double H = 0x1p-100;

/* Port voltages with their slopes: V fixed as solved, the step moves what the
 * linear network and the injections give; dV = (1 - Z dJ/dV)^-1 of that. */
static size_t port_solve_tangent(const double *memory, const Plan *plan, const num *x, Work *w)
{
    const size_t n = plan->n_port, m = plan->n_machine;
    const double *v = memory + plan->port_v;
    const MachineStates states = machine_states(x, m, plan->n_sixth);
    double *sine = (double *)(void *)w->newton, *cosine = sine + m, *inverse = cosine + m;
    double *order = inverse + 4 * n * n, *moved = order + 2 * n;

    for (size_t k = 0; k < m; ++k) {
        sine[k] = creal(w->sine[k]);
        cosine[k] = creal(w->cosine[k]);
    }
    if (!port_inverse(memory, plan, v, v + n, sine, cosine, inverse, order)) return 0;
    for (size_t p = 0; p < n; ++p) {
        w->port.v_re[p] = v[p];
        w->port.v_im[p] = v[n + p];
    }
    port_inject(memory, plan, states.ed2, w->sine, w->cosine, w->port, w->e_re, w->e_im);
    for (size_t p = 0; p < n; ++p) w->port.v_re[p] = w->port.v_im[p] = 0.0;
    port_voltages(memory, plan, 0, plan->n_source, w->e_re, w->e_im, w->port.v_re, w->port.v_im);
    for (size_t p = 0; p < n; ++p) {
        moved[2 * p] = cimag(w->port.v_re[p]);
        moved[2 * p + 1] = cimag(w->port.v_im[p]);
    }
    for (size_t p = 0; p < n; ++p) {
        double re = 0.0, im = 0.0;
        for (size_t q = 0; q < 2 * n; ++q) {
            re += inverse[4 * n * p + q] * moved[q];
            im += inverse[4 * n * p + 2 * n + q] * moved[q];
        }
        w->port.v_re[p] = with_slope(v[p], re);
        w->port.v_im[p] = with_slope(v[n + p], im);
    }
    port_inject(memory, plan, states.ed2, w->sine, w->cosine, w->port, w->e_re, w->e_im);
    return n;
}

/* The same on a sparse network, in whose factors the slopes are those at V: one step is exact. */
static void solve_sparse_tangent(const double *memory, const Plan *plan, const Pattern *pattern, const num *ed2,
                                 const num *base, Work *w)
{
    const size_t n = plan->n_port;
    const double *v = memory + plan->port_v;

    for (size_t p = 0; p < n; ++p) {
        w->port.v_re[p] = v[p];
        w->port.v_im[p] = v[n + p];
    }
    sparse_port_step(memory, plan, pattern, ed2, w->sine, w->cosine, base, w->e_re, w->e_im, w->port, w->v);
    for (size_t p = 0; p < n; ++p) {
        w->port.v_re[p] = w->v[2 * pattern->port[p]];
        w->port.v_im[p] = w->v[2 * pattern->port[p] + 1];
    }
    sparse_port_inject(memory, plan, ed2, w->sine, w->cosine, w->port, w->e_re, w->e_im);
}

size_t plant_directional(double *memory, const int32_t *places, const BlockLayout *layout, const double *x, const double *u,
                         const double *vx, const double *vu, double *vdx, double *vy, double *scratch)
{
    num *z = (num *)(void *)scratch;
    num *input = z + layout->n_x, *rates = input + layout->n_u, *outputs = rates + layout->n_x;
    num *work = outputs + layout->n_y;
    size_t stuck = plant_settle(memory, places, 0, x, scratch);

    if (stuck > 0) return stuck;
    for (size_t k = 0; k < layout->n_x; ++k) z[k] = with_slope(x[k], H * vx[k]);
    for (size_t k = 0; k < layout->n_u; ++k) input[k] = with_slope(u[k], H * vu[k]);
    if (vdx != NULL) {
        stuck = plant_flow_tangent(memory, places, 0, z, input, rates, work);
        for (size_t k = 0; k < layout->n_x; ++k) vdx[k] = cimag(rates[k]) / H;
    }
    if (vy != NULL && stuck == 0) {
        stuck = plant_outputs_tangent(memory, places, 0, z, outputs, work);
        for (size_t k = 0; k < layout->n_y; ++k) vy[k] = cimag(outputs[k]) / H;
    }
    return stuck;
}
