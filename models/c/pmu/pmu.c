#include "pmu.h"

#include <math.h>
#include <stdio.h>

#include "../block/sampled.h"
#include "../channel/history.h"
#include "../plant/numbers/scalar.h"

static const double PI = 3.14159265358979312;

/* Phasors at c + h, c, c - h, and how they move. */
typedef struct { double re[3], im[3], d_re[3], d_im[3]; } Phasors;

static size_t capacity_of(const Record *record)
{
    size_t count;
    const int32_t *capacity = record_i32(record, "capacity", &count);
    return capacity != NULL && count == 1 && capacity[0] > 1 ? (size_t)capacity[0] : 0;
}

static History history_of(const Block *b, size_t i)
{
    const size_t capacity = capacity_of(b->record);
    double *memory = b->memory + M_HISTORY + i * (1 + SAMPLE_SIZE * capacity);
    const History history = {memory, memory + 1, capacity};
    return history;
}

static double between_samples(const Block *b) { return 1.0 / ((double)PMU_SAMPLES * b->p[P_NOMINAL]); }

BlockStatus block_needs(const Record *record, const BlockLayout *n, BlockNeeds *needs, BlockMessage *message)
{
    const size_t capacity = capacity_of(record);

    if (n->n_x != 0 || n->n_u != 2 || n->n_y != Y_COUNT || n->n_w != 0 || n->n_p != P_COUNT || n->n_iu != 0
        || n->n_iy != 0 || n->n_iw != 0 || n->n_ip != IP_COUNT || capacity == 0) {
        snprintf(message->text, sizeof message->text, "pmu: the variables or `capacity` of the record do not fit "
                 "this binary");
        return BLOCK_ERROR;
    }
    needs->n_memory = M_HISTORY + 2 * (1 + SAMPLE_SIZE * capacity);
    needs->n_scratch = 0;
    return BLOCK_OK;
}

/* w(k) before it is divided by the sum of all. */
static double weight(const Block *b, int k)
{
    const int half = b->ip[IP_HALF];
    double x, sine, cosine, unused;

    if (b->ip[IP_CLASS] == CLASS_P) return 1.0 - k / (half + 1.0);
    if (k == 0) return 1.0;
    x = 4.0 * PI * b->p[P_REFERENCE] * k * between_samples(b);
    real_sincos(x, &sine, &unused);
    real_sincos(PI * k / half, &unused, &cosine);
    return sine / x * (0.54 + 0.46 * cosine);
}

BlockStatus block_start(Block *b, double t, BlockMessage *message)
{
    const int half = b->ip[IP_HALF];
    double *w = b->memory + M_WEIGHTS, sum;

    (void)t;
    if (!(b->p[P_NOMINAL] >= 1.0 && b->p[P_NOMINAL] <= 1000.0) || !(b->p[P_REFERENCE] > 0.0)
        || !(b->p[P_REFERENCE] <= b->p[P_NOMINAL]) || half < 1 || half > PMU_HALF || b->ip[IP_CLASS] < CLASS_P
        || b->ip[IP_CLASS] > CLASS_M) {
        snprintf(message->text, sizeof message->text, "pmu: nominal_frequency %g Hz, reference_frequency %g Hz, "
                 "half_window %d; allowed: 1 to 1000, above 0 to nominal, 1 to %d", b->p[P_NOMINAL],
                 b->p[P_REFERENCE], half, PMU_HALF);
        return BLOCK_ERROR;
    }
    sum = w[0] = weight(b, 0);
    for (int k = 1; k <= half; ++k) {
        w[k] = weight(b, k);
        sum += 2.0 * w[k];
    }
    for (int k = 0; k <= half; ++k) w[k] /= sum;
    b->memory[M_HISTORY] = b->memory[M_HISTORY + 1 + SAMPLE_SIZE * capacity_of(b->record)] = 0.0;
    return BLOCK_OK;
}

/* Sample j back from t, whose value is (re, im) and slope (d_re, d_im), in the three windows. */
static void take(const Block *b, int j, double re, double im, double d_re, double d_im, Phasors *x)
{
    const int half = b->ip[IP_HALF];

    for (int c = 0; c < 3; ++c) {
        const int k = j > half + c ? j - half - c : half + c - j;
        if (k > half) continue;
        const double w = b->memory[M_WEIGHTS + k];
        x->re[c] += w * re;
        x->im[c] += w * im;
        x->d_re[c] += w * d_re;
        x->d_im[c] += w * d_im;
    }
}

/* Turn of phasor a against phasor c (the same: its angle), and how fast it grows. */
static void turn(const Phasors *x, int a, int c, double *angle, double *slope)
{
    const double size_a = x->re[a] * x->re[a] + x->im[a] * x->im[a];
    const double size_c = x->re[c] * x->re[c] + x->im[c] * x->im[c];
    const double fast_a = size_a > 0.0 ? (x->re[a] * x->d_im[a] - x->im[a] * x->d_re[a]) / size_a : 0.0;
    const double fast_c = size_c > 0.0 ? (x->re[c] * x->d_im[c] - x->im[c] * x->d_re[c]) / size_c : 0.0;

    *angle = num_angle(x->im[a] * x->re[c] - x->re[a] * x->im[c], x->re[a] * x->re[c] + x->im[a] * x->im[c]);
    *slope = fast_a - fast_c;
}

/* What is reported of three phasors, and its slopes. */
static void report(const Block *b, const Phasors *x, double *y, double *dy)
{
    const double h = between_samples(b), nominal = b->p[P_NOMINAL];
    const double size = sqrt(x->re[1] * x->re[1] + x->im[1] * x->im[1]);
    const double d_size = size > 0.0 ? (x->re[1] * x->d_re[1] + x->im[1] * x->d_im[1]) / size : 0.0;
    double after, before, d_after, d_before, sine = 0.0, cosine = 1.0, d_turn = 0.0;

    turn(x, 0, 1, &after, &d_after);
    turn(x, 1, 2, &before, &d_before);
    const double hertz = (after + before) / (4.0 * PI * h), d_hertz = (d_after + d_before) / (4.0 * PI * h);
    if (b->ip[IP_CLASS] == CLASS_P) {
        const double per_hertz = 1.625 * PI / (2.0 * nominal);
        real_sincos(per_hertz * hertz, &sine, &cosine);
        d_turn = per_hertz * d_hertz;
    }
    y[Y_V] = size / cosine;
    dy[Y_V] = (d_size + size * d_turn * sine / cosine) / cosine;
    y[Y_ANGLE] = num_angle(x->im[1], x->re[1]);
    dy[Y_ANGLE] = size > 0.0 ? (x->re[1] * x->d_im[1] - x->im[1] * x->d_re[1]) / (size * size) : 0.0;
    y[Y_DEVIATION] = hertz / nominal;
    dy[Y_DEVIATION] = d_hertz / nominal;
    y[Y_FREQUENCY] = nominal + hertz;
    dy[Y_FREQUENCY] = d_hertz;
    y[Y_ROCOF] = (after - before) / (2.0 * PI * h * h);
    dy[Y_ROCOF] = (d_after - d_before) / (2.0 * PI * h * h);
}

BlockStatus block_step(Block *b, double t, double h, const double *u_poly, double *dy, BlockMessage *message)
{
    const History re = history_of(b, 0), im = history_of(b, 1);
    const double end = t + h, apart = between_samples(b);
    Phasors x = {{0.0}, {0.0}, {0.0}, {0.0}};

    history_add(&re, t, u_poly, b->u_order[0]);
    history_add(&im, t, u_poly + 4, b->u_order[1]);
    for (int j = 0; j <= 2 * b->ip[IP_HALF] + 2; ++j) {
        double v_re, v_im, d_re, d_im;
        const int gone = history_at(&re, end - j * apart, &v_re, &d_re) + history_at(&im, end - j * apart, &v_im, &d_im);
        if (gone != 0) {
            snprintf(message->text, sizeof message->text,
                     "pmu: at time %.9g s the input of %g s ago is no longer among the last %zu communication points; "
                     "take longer steps or build the PMU with a larger capacity", end, j * apart, re.capacity);
            return BLOCK_ERROR;
        }
        take(b, j, v_re, v_im, d_re, d_im, &x);
    }
    report(b, &x, b->y, dy);
    return BLOCK_OK;
}

BlockStatus block_directional(Block *b, double t, const double *x, const double *u, const double *vx,
                              const double *vu, double *vdx, double *vy, BlockMessage *message)
{
    const History re = history_of(b, 0), im = history_of(b, 1);
    const double apart = between_samples(b);
    Phasors seen = {{0.0}, {0.0}, {0.0}, {0.0}};
    double y[Y_COUNT];

    (void)x, (void)u, (void)vx, (void)vdx, (void)message;
    if (vy == NULL) return BLOCK_OK;
    for (int j = 0; j <= 2 * b->ip[IP_HALF] + 2; ++j) {
        const double s = t - j * apart;
        double v_re, v_im, slope;
        (void)history_at(&re, s, &v_re, &slope);
        (void)history_at(&im, s, &v_im, &slope);
        take(b, j, v_re, v_im, vu[0] * history_weight(&re, s, t, b->u_order[0]),
             vu[1] * history_weight(&im, s, t, b->u_order[1]), &seen);
    }
    report(b, &seen, y, vy);
    return BLOCK_OK;
}
