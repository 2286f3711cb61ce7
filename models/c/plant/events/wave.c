/* What slots ask for over time (wave.h). */
#include "wave.h"

#include <math.h>

#include "../../block/random.h"
#include "../start/failure.h"

static const double STAIR_S = 0.02, LEAST_STAIRS = 24.0; /* longest stair; of a sine, a period */
static const double TURN = 6.28318530717958648;
static const double APART = 20.0; /* exponents after which noise is another one: exp(-20) of it is left */

static double span(const double *p, int wave)
{
    if (wave == WAVE_STEADY) return p[SLOT_RISE];
    return wave == WAVE_NOISE ? STAIR_S : 1.0 / p[SLOT_FREQUENCY];
}

/* In a span. */
static double stairs(const double *p, int wave)
{
    if (wave == WAVE_SQUARE) return 2.0;
    if (wave == WAVE_NOISE) return 1.0;
    const double n = ceil(span(p, wave) / STAIR_S);
    return wave == WAVE_SINE && n < LEAST_STAIRS ? LEAST_STAIRS : n;
}

static double stair_time(const double *p, int wave, double k)
{
    return p[SLOT_START] + span(p, wave) * (k / stairs(p, wave));
}

/* The stair that t lies on, from 0; of a ramp the number of stairs beyond the last. */
static double stair_at(const double *p, int wave, double t)
{
    const double n = stairs(p, wave), last = wave == WAVE_STEADY ? n : INFINITY;
    double k = floor((t - p[SLOT_START]) / span(p, wave) * n);

    if (!(k >= 0.0)) return 0.0;
    if (k < last && stair_time(p, wave, k + 1.0) <= t) k += 1.0;   /* rounding */
    if (k > 0.0 && stair_time(p, wave, k) > t) k -= 1.0;
    return k < last ? k : last;
}

BlockStatus wave_check(const double *p, const int *i, size_t slot, const char *kind, BlockMessage *message)
{
    const int wave = i[SLOT_WAVE], changes = slot_changes(i[SLOT_KIND]);
    const double most = changes && wave == WAVE_STEADY ? p[SLOT_END] - p[SLOT_START] : 0.0;
    const double low = wave == WAVE_NOISE ? 1e-3 : 1e-4, high = wave == WAVE_NOISE ? 5.0 : 10.0;

    if (!(wave >= 0 && wave < (changes ? (int)WAVE_KINDS : 1)))
        return plant_fail(message, BLOCK_ERROR, "event[%zu] (%s): wave = %d, allowed: 0 to %d", slot, kind, wave,
                          changes ? (int)WAVE_KINDS - 1 : 0);
    if (!(p[SLOT_RISE] >= 0.0 && p[SLOT_RISE] <= most))
        return plant_fail(message, BLOCK_ERROR, "event[%zu] (%s): rise = %g s, allowed: 0 to %g", slot, kind,
                          p[SLOT_RISE], most);
    if (wave != WAVE_STEADY && !(p[SLOT_FREQUENCY] >= low && p[SLOT_FREQUENCY] <= high))
        return plant_fail(message, BLOCK_ERROR, "event[%zu] (%s): frequency = %g Hz, allowed: %g to %g", slot, kind,
                          p[SLOT_FREQUENCY], low, high);
    return BLOCK_OK;
}

double wave_next(const double *p, const int *i, double t)
{
    const int wave = i[SLOT_WAVE];
    double next = p[SLOT_END] < 1e29 ? p[SLOT_END] : INFINITY;

    if (p[SLOT_START] > t) return p[SLOT_START];
    if (!(p[SLOT_END] > t)) return INFINITY;
    if (span(p, wave) > 0.0) {
        const double k = stair_at(p, wave, t);
        const double stair = wave == WAVE_STEADY && !(k < stairs(p, wave)) ? INFINITY : stair_time(p, wave, k + 1.0);
        if (stair < next) next = stair;
    }
    return next;
}

int wave_acts(const double *p, const int *i, double t)
{
    const int wave = i[SLOT_WAVE];

    if (t == p[SLOT_START] || t == p[SLOT_END]) return 1;
    if (!(span(p, wave) > 0.0 && t > p[SLOT_START] && t < p[SLOT_END])) return 0;
    return stair_time(p, wave, stair_at(p, wave, t)) == t;
}

/* Of mean 0 and variance 1 (Box and Muller). */
static double normal(int seed, double number, unsigned stream)
{
    double sine, cosine;

    real_sincos(TURN * packet_random(seed, number, 2 * stream), &sine, &cosine);
    return sqrt(-2.0 * real_log(1.0 - packet_random(seed, number, 2 * stream + 1))) * cosine;
}

/* decay: exponent of a stair. */
static double noise(int seed, double k, unsigned stream, double decay)
{
    double width = 1.0;

    while (width * decay < APART) width *= 2.0;
    double first = width * floor(k / width);
    double a = normal(seed, first, stream), b = normal(seed, first + width, stream);
    while (first < k) {
        width *= 0.5;
        const double r = real_exp(-width * decay), q = 1.0 + r * r;
        const double middle = r / q * (a + b) + sqrt((1.0 - r * r) / q) * normal(seed, first + width, stream);
        if (k < first + width) {
            b = middle;
        } else {
            first += width;
            a = middle;
        }
    }
    return a;
}

double wave_at(const double *p, const int *i, size_t target, double t)
{
    const int wave = i[SLOT_WAVE];
    const double n = stairs(p, wave);

    if (!(span(p, wave) > 0.0)) return 1.0;
    const double k = stair_at(p, wave, t), part = k - n * floor(k / n);
    if (wave == WAVE_SQUARE) return part > 0.5 ? -1.0 : 1.0;
    if (wave == WAVE_NOISE) return noise(i[SLOT_SEED], k, (unsigned)target, TURN * p[SLOT_FREQUENCY] * STAIR_S);
    if (wave == WAVE_STEADY) return k < n ? (k + 0.5) / n : 1.0;
    double sine, smaller, cosine;
    real_sincos(TURN * ((part + 0.5) / n), &sine, &cosine);
    real_sincos(TURN / 2.0 / n, &smaller, &cosine);
    return sine * (TURN / 2.0 / n / smaller);
}
