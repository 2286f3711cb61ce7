/* Newton's method at the ports. Unknowns lie port by port, real then imaginary. */
#include "port.h"

static const size_t MOST_STEPS = 40;
static const double ACCURACY = 1e-13;     /* residual, relative to the largest voltage */
static const double STALLED = 1e-11;      /* a residual that rounding keeps from falling */
static const double MOST_FLUX = 1.2;      /* where an iteration may start: psi_I grows exponentially */
static const double WORTH_KEEPING = 0.03; /* contraction above which the inverse is renewed */

static double larger(double a, double b) { return a > b ? a : b; }

/* In place, Gauss-Jordan with partial pivoting; order: n doubles. */
static int invert(double *a, size_t n, double *order)
{
    for (size_t k = 0; k < n; ++k) {
        size_t best = k;
        for (size_t i = k + 1; i < n; ++i)
            if (fabs(a[i * n + k]) > fabs(a[best * n + k])) best = i;
        order[k] = (double)best;
        if (best != k)
            for (size_t j = 0; j < n; ++j) {
                const double v = a[k * n + j];
                a[k * n + j] = a[best * n + j];
                a[best * n + j] = v;
            }
        const double pivot = a[k * n + k];
        if (!(fabs(pivot) > 1e-14)) return 0;
        a[k * n + k] = 1.0;
        for (size_t j = 0; j < n; ++j) a[k * n + j] /= pivot;
        for (size_t i = 0; i < n; ++i) {
            const double f = a[i * n + k];
            if (i == k || f == 0.0) continue;
            a[i * n + k] = 0.0;
            for (size_t j = 0; j < n; ++j) a[i * n + j] -= f * a[k * n + j];
        }
    }
    for (size_t k = n; k-- > 0;) {   /* row swaps become column swaps, backwards */
        const size_t other = (size_t)(ptrdiff_t)order[k];
        if (other == k) continue;
        for (size_t i = 0; i < n; ++i) {
            const double v = a[i * n + k];
            a[i * n + k] = a[i * n + other];
            a[i * n + other] = v;
        }
    }
    return 1;
}

void port_slope_at(const double *memory, const Plan *plan, size_t p, double v_re, double v_im, const double *x,
                   size_t stride, const double *sine, const double *cosine, double d[4])
{
    const double *row = memory + plan->port + P_ROWS * p;
    const size_t k = index_at(row, P_DEVICE);

    if (port_is_load(row)) load_slope(row, v_re, v_im, d);
    else if (port_is_device(row))
        bus_device_slope(row, x, stride, sine + plan->n_machine + k, cosine + plan->n_machine + k, v_re, v_im, d);
    else if (row[P_ON] > 0.5) saturation_slope(row, v_re, v_im, sine[k], cosine[k], d);
    else d[0] = d[1] = d[2] = d[3] = 0.0;
}

int port_inverse(const double *memory, const Plan *plan, const double *v_re, const double *v_im,
                 const double *x, size_t stride, const double *sine, const double *cosine, double *inverse,
                 double *work)
{
    const size_t n = plan->n_port;

    for (size_t k = 0; k < 4 * n * n; ++k) inverse[k] = 0.0;
    for (size_t q = 0; q < n; ++q) {
        const double *g = memory + plan->port_own_re + q * n, *b = memory + plan->port_own_im + q * n;
        double d[4];
        port_slope_at(memory, plan, q, v_re[q], v_im[q], x, stride, sine, cosine, d);
        for (size_t p = 0; p < n; ++p) {
            double *real = inverse + 4 * n * p + 2 * q, *imaginary = real + 2 * n;
            real[0] = -(g[p] * d[0] - b[p] * d[2]);
            real[1] = -(g[p] * d[1] - b[p] * d[3]);
            imaginary[0] = -(g[p] * d[2] + b[p] * d[0]);
            imaginary[1] = -(g[p] * d[3] + b[p] * d[1]);
        }
    }
    for (size_t k = 0; k < 2 * n; ++k) inverse[2 * n * k + k] += 1.0;
    return invert(inverse, 2 * n, work);
}

/* One problem: everything that stays the same while it is solved. */
typedef struct {
    double *memory;
    const Plan *plan;
    size_t lanes;
    const double *x, *sine, *cosine;
    double *e_re, *e_im;
    PortWork at;
    const double *linear;
    double *inverse;   /* and its columns */
} Problem;

/* r = v - W E - Z J(v); returns its largest part, -1 when it is not finite. */
static double residual(const Problem *s, double *r)
{
    const size_t n = s->plan->n_port;
    double *re = r, *im = r + n, worst = 0.0;

    port_inject(s->memory, s->plan, 0, DC_NOTHING, NULL, flag_all(), s->x, s->sine, s->cosine, s->at, s->e_re, s->e_im);
    for (size_t p = 0; p < 2 * n; ++p) r[p] = s->linear[p];
    port_voltages(s->memory + s->plan->port_own_re, s->memory + s->plan->port_own_im, n, n,
                  s->e_re + s->plan->n_machine, s->e_im + s->plan->n_machine, re, im);
    for (size_t p = 0; p < n; ++p) {
        re[p] = s->at.v_re[p] - re[p];
        im[p] = s->at.v_im[p] - im[p];
        if (!(fabs(re[p]) < 1e6 && fabs(im[p]) < 1e6)) return -1.0;
        worst = larger(worst, larger(fabs(re[p]), fabs(im[p])));
    }
    return worst;
}

static int invert_at(const Problem *s, double *work)
{
    return port_inverse(s->memory, s->plan, s->at.v_re, s->at.v_im, s->x, 1, s->sine, s->cosine, s->inverse, work);
}

static void copy_voltages(const Problem *s, double *to)
{
    const size_t n = s->plan->n_port;
    memcpy(to, s->at.v_re, n * sizeof(double));
    memcpy(to + n, s->at.v_im, n * sizeof(double));
}

/* The voltages a `share` of a Newton step away from `from`, with the residual r there. */
static void take_step(const Problem *s, const double *from, const double *r, double share)
{
    const size_t n = s->plan->n_port;

    for (size_t p = 0; p < n; ++p) {
        const double *a = s->inverse + 4 * n * p, *b = a + 2 * n;
        double re = 0.0, im = 0.0;
        for (size_t q = 0; q < n; ++q) {
            re += a[2 * q] * r[q] + a[2 * q + 1] * r[n + q];
            im += b[2 * q] * r[q] + b[2 * q + 1] * r[n + q];
        }
        s->at.v_re[p] = from[p] - share * re;
        s->at.v_im[p] = from[n + p] - share * im;
    }
}

/* The longest of 12 halved steps that is good enough, or the first one with slopes that
 * are not `fresh`. Returns the residual there, -1 where there is none. */
static double search(const Problem *s, int free, int fresh, double size, double scale, const double *from,
                     const double *r, double *r_next, double *share)
{
    double next = -1.0;

    *share = 1.0;
    for (int tries = 0; tries < 12; ++tries, *share *= 0.5) {
        take_step(s, from, r, *share);
        next = residual(s, r_next);
        if (next >= 0.0 && (free || next < (1.0 - 0.1 * *share) * size)) break;
        if (!fresh || size <= STALLED * scale) break;
    }
    return next;
}

/* The port whose residual is largest. */
static size_t farthest(const double *r, size_t n)
{
    size_t worst = 0;

    for (size_t p = 1; p < n; ++p)
        if (!(fabs(r[p]) + fabs(r[n + p]) <= fabs(r[worst]) + fabs(r[n + worst]))) worst = p;
    return worst;
}

/* What residuals are measured against. */
static double scale_of(const Problem *s)
{
    double scale = 1.0;

    for (size_t p = 0; p < 2 * s->plan->n_port; ++p) scale = larger(scale, fabs(s->linear[p]));
    return scale;
}

/* Newton steps from the voltages in s->at: damped so that the residual falls, or
 * `free` to rise, which passes the slope discontinuities where a load becomes an impedance. Returns
 * n_port, or the port farthest from a solution. work: 8 n_port. */
static size_t newton(const Problem *s, int free, double *work)
{
    const size_t n = s->plan->n_port;
    double *r = work, *r_next = work + 2 * n, *from = work + 4 * n, *order = work + 6 * n;
    const double scale = scale_of(s);
    double size;
    int fresh = 0, ready = 0;

    size = residual(s, r);
    for (size_t count = 0; count < MOST_STEPS && size >= 0.0; ++count) {
        double share;
        if (size <= ACCURACY * scale) return n;
        if (!ready) {
            if (!invert_at(s, order)) break;
            ready = fresh = 1;
        }
        copy_voltages(s, from);
        const double next = search(s, free, fresh, size, scale, from, r, r_next, &share);
        const int better = next >= 0.0 && (free || next < size);
        if (!better) {   /* back to the best voltages so far */
            memcpy(s->at.v_re, from, n * sizeof(double));
            memcpy(s->at.v_im, from + n, n * sizeof(double));
            (void)residual(s, r);
            if (size <= STALLED * scale) return n;
            if (fresh) break;
        }
        if (!better || next > WORTH_KEEPING * size || share < 1.0) ready = fresh = 0;
        if (better) {
            double *t = r;
            r = r_next;
            r_next = t;
            size = next;
        }
    }
    return farthest(r, n);
}

/* Columns of an inverse that has the parts of each port in turn: all real parts, then all imaginary ones. */
static void columns_of(const double *inverse, size_t n, double *columns)
{
    for (size_t c = 0; c < 2 * n; ++c)
        for (size_t r = 0; r < 2 * n; ++r)
            columns[2 * n * c + r] = inverse[2 * n * (r < n ? 2 * r : 2 * (r - n) + 1) + (c < n ? 2 * c : 2 * (c - n) + 1)];
}

/* Columns `turned` = 0: W times the columns g + j b of n numbers, 1: W times j (g + j b). work: 4 n^2. */
static void fold_columns(const Plan *plan, size_t lanes, const double *W, size_t count, const double *g, const double *b,
                         int turned, double *to, double *work)
{
    const size_t n = plan->n_port, most = 2 * n;

    for (size_t first = 0; first < count; first += most, to += 2 * n * most) {
        const size_t taken = count - first < most ? count - first : most;
        double *column = work;
        for (size_t k = 0; k < taken; ++k, g += n, b += n, column += 2 * n)
            for (size_t p = 0; p < n; ++p) {
                column[p] = turned ? -b[p] : g[p];
                column[n + p] = turned ? g[p] : b[p];
            }
        TILED(num_products, lanes, 2 * n, W, 2 * n, 2 * n, taken, work, to);
    }
}

/* Folds the network with the slopes at the voltages v and states x, null: at rest. 0: singular. space: 8 n_port^2; work: 4 n_port. */
static int fold(double *memory, const Plan *plan, size_t lanes, const double *v, const double *x, const double *sine,
                const double *cosine, double *space, double *work)
{
    const size_t n = plan->n_port, m = plan->n_machine;
    double *columns = space + 4 * n * n, *last = memory + plan->port_b, *z = memory + plan->port_z;

    memory[H_PORT_READY] = 0.0;
    if (!port_inverse(memory, plan, v, v + n, x, 1, sine, cosine, space, work)) return 0;
    for (size_t p = 0; p < n; ++p)
        port_slope_at(memory, plan, p, v[p], v[n + p], x, 1, sine, cosine, memory + plan->port_slope + 4 * p);
    columns_of(space, n, plan->few > 0 ? last : columns);
    if (plan->few == 0) {
        const double *g = memory + plan->port_w_re, *b = memory + plan->port_w_im;
        fold_columns(plan, lanes, columns, m, g, b, 0, last, space);
        fold_columns(plan, lanes, columns, m, g, b, 1, last + 2 * n * m, space);
    } else {
        columns = last;
    }
    fold_columns(plan, lanes, columns, n, memory + plan->port_own_re, memory + plan->port_own_im, 0, z, space);
    fold_columns(plan, lanes, columns, n, memory + plan->port_own_re, memory + plan->port_own_im, 1, z + 2 * n * n, space);
    for (size_t k = W_FIRST; k <= W_THIRD; ++k) memory[plan->warm + k] = INFINITY;
    for (size_t k = 0; k < DC_HELD * n; ++k) memory[plan->warm + W_V + 8 * n + k] = INFINITY;
    for (size_t k = 0; k < 2 * PORT_STAGES * n; ++k) memory[plan->warm + W_V + 12 * n + k] = 0.0;
    memory[plan->warm + W_RATIO] = memory[H_PORT_READY] = 1.0;
    return 1;
}

void port_fold_at_rest(double *memory, const Plan *plan, size_t lanes, double wait, double *work)
{
    const size_t m = plan->n_machine;
    double *sine = work, *cosine = sine + m, *more = cosine + m;

    for (size_t k = 0; k < m; ++k) real_sincos(memory[plan->delta_rest + k], &sine[k], &cosine[k]);
    (void)fold(memory, plan, lanes, memory + plan->port_rest, NULL, sine, cosine, more + 6 * plan->n_port, more);
    memory[H_PORT_FOLDS] = 0.0;
    memory[plan->warm + W_REST] = INFINITY;
    memory[plan->warm + W_WAIT] = wait;
}

/* The same with those at v: an iteration from there. */
static int fold_at(const Problem *s, const double *v, double *work)
{
    double *rest = s->memory + s->plan->warm + W_REST;

    s->memory[H_PORT_FOLDS] += 1.0;
    if (!(*rest < INFINITY)) *rest = s->memory[s->plan->warm + W_TIME] + s->memory[s->plan->warm + W_WAIT];
    return fold(s->memory, s->plan, s->lanes, v, s->x, s->sine, s->cosine, s->inverse, work);
}

/* From the last voltages, then from those of the linear network, then from low ones: near collapse
 * the solution lies among the impedances of low voltage, of all loads or of one. Returns n_port, or
 * the port farthest from a solution. */
static size_t newton_from_many(const Problem *s, const double *last, double *work)
{
    const size_t n = s->plan->n_port;
    size_t stuck = n;

    for (size_t tries = 0; tries < 8 + n; ++tries) {
        const double *start = tries % 4 == 0 && tries < 8 ? last : s->linear;
        const double share = tries >= 8 || tries % 4 < 2 ? 1.0 : tries % 4 == 2 ? 0.6 : 0.2;
        for (size_t p = 0; p < n; ++p) {
            const double size = sqrt(start[p] * start[p] + start[n + p] * start[n + p]);
            const double own = (tries == 8 + p ? 0.5 : share) * (size > MOST_FLUX ? MOST_FLUX / size : 1.0);
            s->at.v_re[p] = own * start[p];
            s->at.v_im[p] = own * start[n + p];
        }
        stuck = newton(s, tries >= 4, work);
        if (stuck == n) break;
    }
    return stuck;
}

/* Where the iteration with the slopes at rest has failed; as port_solve. */
static size_t solve_otherwise(const Problem *problem, PortCare care, int stage, const double *linear, double *b, double *work)
{
    double *memory = problem->memory, *e_re = problem->e_re, *e_im = problem->e_im, *own = work + 8 * problem->plan->n_port;
    double *last = memory + problem->plan->port_v;
    const Plan *plan = problem->plan;
    const size_t n = plan->n_port;
    int failed = 1;

    if (fold_at(problem, last, work)) {
        port_linear(memory, plan, problem->lanes, e_re, e_im, linear, b, work);
        failed = port_iterate(memory, plan, problem->lanes, care, stage, memory + plan->warm, care == PORT_STEP, b, problem->x,
                              problem->sine, problem->cosine, e_re, e_im, problem->at, work);
    }
    if (!failed) return n;
    if (linear == NULL) {
        for (size_t p = 0; p < 2 * n; ++p) own[p] = 0.0;
        port_voltages(memory + plan->port_w_re, memory + plan->port_w_im, n, plan->n_machine, e_re, e_im, own, own + n);
    }
    const size_t stuck = newton_from_many(problem, last, work);
    memory[H_PORT_READY] = 0.0;
    if (stuck < n) return stuck;
    /* e and w are those of the solution: what follows only prepares the next call */
    memcpy(last, problem->at.v_re, 2 * n * sizeof(double));
    (void)fold_at(problem, last, work);
    return n;
}

size_t port_solve(double *memory, const Plan *plan, size_t lanes, PortCare care, int stage, const double *x,
                  const double *sine, const double *cosine, double *e_re, double *e_im, const double *linear, PortWork w, double *work)
{
    const size_t n = plan->n_port;
    double *b = work, *more = b + 2 * n;

    port_linear(memory, plan, lanes, e_re, e_im, linear, b, more);
    if (port_iterate(memory, plan, lanes, care, stage, memory + plan->warm, care == PORT_STEP, b, x, sine, cosine, e_re, e_im,
                     w, more)) {
        const Problem problem = { memory, plan, lanes, x, sine, cosine, e_re, e_im, w, linear == NULL ? more + 8 * n : linear,
                                  work + PORT_NEWTON * n };
        const size_t stuck = solve_otherwise(&problem, care, stage, linear, b, more);
        if (stuck < n) return stuck;
    }
    if (care == PORT_EXACT) memcpy(memory + plan->port_v, w.v_re, 2 * n * sizeof(double));
    return n;
}
