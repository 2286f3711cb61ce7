/* The physics over double complex: exact directional derivatives by the complex
 * step, f(x + i h v) = f(x) + i h f'(x) v + O(h^2), where h^2 vanishes against
 * rounding.                                        [Squire and Trapp, 1998] */
#define PLANT_TANGENT
#include "flow.h"

static const double H = 0x1p-100;

/* Port voltages with their slopes: V fixed as solved, the step moves what the
 * linear network and the injections give; dV = (1 - Z dJ/dV)^-1 of that. linear: what the network gives without the
 * ports, or null where the columns of all sources are kept. space: 2 n_place + 4 n_port^2 + 4 n_port doubles. */
static size_t port_solve_tangent(const double *memory, const Plan *plan, const num *x, const num *linear, double *space,
                                 Work *w)
{
    const size_t n = plan->n_port, m = plan->n_machine, all = plan->n_place;
    const double *v = memory + plan->port_v;
    double *sine = space, *cosine = sine + all, *inverse = cosine + all;
    double *order = inverse + 4 * n * n, *moved = order + 2 * n;

    for (size_t k = 0; k < all; ++k) {
        sine[k] = creal(w->sine[k]);
        cosine[k] = creal(w->cosine[k]);
    }
    if (!port_inverse(memory, plan, v, v + n, (const double *)(const void *)x, 2, sine, cosine, inverse, order)) return 0;
    for (size_t p = 0; p < n; ++p) {
        w->port.v_re[p] = v[p];
        w->port.v_im[p] = v[n + p];
    }
    port_inject(memory, plan, 0, DC_NOTHING, NULL, flag_all(), x, w->sine, w->cosine, w->port, w->e_re, w->e_im);
    for (size_t p = 0; p < n; ++p) {
        w->port.v_re[p] = linear == NULL ? 0.0 : linear[p];
        w->port.v_im[p] = linear == NULL ? 0.0 : linear[n + p];
    }
    if (linear == NULL)
        port_voltages(memory + plan->port_w_re, memory + plan->port_w_im, n, plan->n_source, w->e_re, w->e_im,
                      w->port.v_re, w->port.v_im);
    else
        port_voltages(memory + plan->port_own_re, memory + plan->port_own_im, n, n, w->e_re + m, w->e_im + m,
                      w->port.v_re, w->port.v_im);
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
    port_inject(memory, plan, 0, DC_NOTHING, NULL, flag_all(), x, w->sine, w->cosine, w->port, w->e_re, w->e_im);
    return n;
}

/* The same on a sparse network, in whose factors the slopes are those at V: one step is exact. */
static void solve_sparse_tangent(const double *memory, const Plan *plan, const Pattern *pattern, const num *x,
                                 const num *base, Work *w)
{
    const size_t n = plan->n_port;
    const double *v = memory + plan->port_v;

    for (size_t p = 0; p < n; ++p) {
        w->port.v_re[p] = v[p];
        w->port.v_im[p] = v[n + p];
    }
    sparse_port_step(memory, plan, pattern, 0, x, w->sine, w->cosine, base, w->e_re, w->e_im, w->port, w->v);
    for (size_t p = 0; p < n; ++p) {
        w->port.v_re[p] = w->v[2 * pattern->port[p]];
        w->port.v_im[p] = w->v[2 * pattern->port[p] + 1];
    }
    sparse_port_inject(memory, plan, 0, x, w->sine, w->cosine, w->port, w->e_re, w->e_im);
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
        stuck = plant_flow_tangent(memory, places, 0, z, input, rates, work, NO_NOTES, NULL);
        for (size_t k = 0; k < layout->n_x; ++k) vdx[k] = cimag(rates[k]) / H;
    }
    if (vy != NULL && stuck == 0) {
        stuck = plant_outputs_tangent(memory, places, 0, z, outputs, work, NULL);
        for (size_t k = 0; k < layout->n_y; ++k) vy[k] = cimag(outputs[k]) / H;
    }
    return stuck;
}

/* dJ/dV of the machine's port in `row` at its voltage, row by row, machine base. */
static void gap_slope(const double *row, const Work *w, size_t k, num ed2, double v_re, double v_im, double d[4])
{
    num re, im, isd, isq;
    const num sine = with_slope(creal(w->sine[k]), 0.0), cosine = with_slope(creal(w->cosine[k]), 0.0);
    const num rest = with_slope(creal(ed2), 0.0);

    saturation_injection(row, with_slope(v_re, H), with_slope(v_im, 0.0), sine, cosine, rest, &re, &im, &isd, &isq);
    d[0] = cimag(re) / H;
    d[2] = cimag(im) / H;
    saturation_injection(row, with_slope(v_re, 0.0), with_slope(v_im, H), sine, cosine, rest, &re, &im, &isd, &isq);
    d[1] = cimag(re) / H;
    d[3] = cimag(im) / H;
}

/* How the air gap of a machine with a port moves with its EMF e and the voltage v of its bus. With z = Ra + j Xl
 * and x = Xd2 - Xl, V_gap (j x + z) - z j x J(V_gap) = j x V + z E, in real and imaginary parts. */
static void move_gap(const double *memory, const Plan *plan, size_t p, num ed2, num v_re, num v_im, Work *w)
{
    const size_t n = plan->n_machine;
    const double *row = memory + plan->port + P_ROWS * p, *table = memory + plan->machine;
    const size_t k = index_at(row, P_DEVICE);
    const double r = table[M_RA * n + k], xl = table[M_XL * n + k], x = row[P_X2];
    const double re = creal(w->port.v_re[p]), im = creal(w->port.v_im[p]);
    const double zx_re = -xl * x, zx_im = r * x;
    double d[4];
    num j_re, j_im, isd, isq;

    gap_slope(row, w, k, ed2, re, im, d);
    saturation_injection(row, with_slope(re, 0.0), with_slope(im, 0.0), w->sine[k], w->cosine[k], ed2, &j_re, &j_im,
                         &isd, &isq);
    const double e_re = cimag(w->e_re[k]), e_im = cimag(w->e_im[k]), jr = cimag(j_re), ji = cimag(j_im);
    const double b_re = -x * cimag(v_im) + r * e_re - xl * e_im + zx_re * jr - zx_im * ji;
    const double b_im = x * cimag(v_re) + r * e_im + xl * e_re + zx_re * ji + zx_im * jr;
    const double a = r - zx_re * d[0] + zx_im * d[2], b = -(x + xl) - zx_re * d[1] + zx_im * d[3];
    const double c = (x + xl) - zx_re * d[2] - zx_im * d[0], e = r - zx_re * d[3] - zx_im * d[1];
    const double size = a * e - b * c;
    w->port.v_re[p] = with_slope(re, (e * b_re - b * b_im) / size);
    w->port.v_im[p] = with_slope(im, (a * b_im - c * b_re) / size);
}

/* Currents of machines and ports when the voltages of their buses are given (n_source each). */
static void inject_apart(const double *memory, const Plan *plan, const num *x, const num *v_re, const num *v_im, Work *w)
{
    const size_t n = plan->n_machine;
    const num *ed2 = machine_states(x, n, plan->n_sixth).ed2;

    for (size_t p = 0; p < plan->n_port; ++p) {
        const double *row = memory + plan->port + P_ROWS * p;
        const size_t k = index_at(row, P_DEVICE);
        if (!port_is_machine(row)) {
            w->port.v_re[p] = v_re[n + p];
            w->port.v_im[p] = v_im[n + p];
        } else {
            move_gap(memory, plan, p, ed2[k], v_re[k], v_im[k], w);
        }
    }
    if (plan->n_port > 0) port_inject(memory, plan, 0, DC_NOTHING, NULL, flag_all(), x, w->sine, w->cosine, w->port, w->e_re, w->e_im);
    for (size_t p = 0; p < plan->n_port; ++p) {   /* a machine's acts like j x J in its EMF */
        const double *row = memory + plan->port + P_ROWS * p;
        const size_t k = index_at(row, P_DEVICE);
        if (!port_is_machine(row)) continue;
        w->e_re[k] -= row[P_X2] * w->e_im[n + p];
        w->e_im[k] += row[P_X2] * w->e_re[n + p];
    }
    for (size_t k = 0; k < n; ++k) {
        double g, b;
        network_norton(memory, plan, k, &g, &b);
        const num re = w->e_re[k] - v_re[k], im = w->e_im[k] - v_im[k];
        w->i_re[k] = g * re - b * im;
        w->i_im[k] = g * im + b * re;
    }
}

size_t plant_device_slopes(double *memory, const int32_t *places, const BlockLayout *layout, const double *x,
                           const double *u, const double *vx, const double *vu, const double *vv, double *vdx,
                           double *vi, double *scratch)
{
    Plan own;
    const Plan *plan = plan_in(memory, &own);
    const Pattern pattern = pattern_of(places, plan);
    const size_t n = plan->n_machine, sources = plan->n_source;
    num *z = (num *)(void *)scratch;
    num *input = z + layout->n_x, *rates = input + layout->n_u, *volts = rates + layout->n_x;
    num *work = volts + 2 * sources;
    Work w = work_arrays(work, plan, 0);
    const Machines machines = machines_of(memory, plan, z, &w);
    size_t stuck = plant_settle(memory, places, 0, x, scratch);

    if (stuck > 0) return stuck;
    for (size_t k = 0; k < layout->n_x; ++k) z[k] = with_slope(x[k], 0.0);
    stuck = solve_network(memory, plan, &pattern, z, &w);
    if (stuck > 0) return stuck;
    if (is_sparse(plan)) network_complete(memory, plan, &pattern, 0, w.v);
    for (size_t k = 0; k < n; ++k)
        network_voltage(memory, plan, &pattern, index_at(memory + plan->machine_bus, k), w.e_re, w.e_im, w.v,
                        &volts[k], &volts[sources + k]);
    for (size_t p = 0; p < plan->n_port; ++p) {
        volts[n + p] = w.port.v_re[p];
        volts[sources + n + p] = w.port.v_im[p];
    }
    for (size_t k = 0; k < 2 * sources; ++k) volts[k] = with_slope(creal(volts[k]), H * vv[k]);
    for (size_t k = 0; k < layout->n_x; ++k) z[k] = with_slope(x[k], H * vx[k]);
    for (size_t k = 0; k < layout->n_u; ++k) input[k] = with_slope(u[k], H * vu[k]);
    /* the frame has turned by nothing at rest, and stands while the states move */
    EVERY_MACHINE(machine_emf, plan, &w, &machines);
    turn_sources(memory, plan, z, &w);
    inject_apart(memory, plan, z, volts, volts + sources, &w);
    solve_terminals(memory, plan, &machines, z, &w);
    solve_rates(memory, plan, z, input, rates, &w);
    for (size_t k = 0; k < layout->n_x; ++k) vdx[k] = cimag(rates[k]) / H;
    for (size_t k = 0; k < n; ++k) {
        vi[k] = cimag(w.i_re[k]) / H;
        vi[sources + k] = cimag(w.i_im[k]) / H;
    }
    for (size_t p = 0; p < plan->n_port; ++p) {
        const int at_bus = !port_is_machine(memory + plan->port + P_ROWS * p);
        vi[n + p] = at_bus ? cimag(w.e_re[n + p]) / H : 0.0;
        vi[sources + n + p] = at_bus ? cimag(w.e_im[n + p]) / H : 0.0;
    }
    return 0;
}
