#include "history.h"

#include <math.h>

enum { TIME = 0, VALUE = 1, ORDER = 5 };

static double *sample(const History *history, size_t number)
{
    /* a ring that is not yet full needs no division */
    const size_t place = number < history->capacity ? number : number % history->capacity;

    return history->ring + SAMPLE_SIZE * place;
}

void history_add(const History *history, double t, const double *u, int order)
{
    size_t count = (size_t)*history->count;
    double *to;

    if (count > 0 && !(sample(history, count - 1)[TIME] < t)) --count;
    to = sample(history, count);
    to[TIME] = t;
    for (int k = 0; k < 4; ++k) to[VALUE + k] = u[k];
    to[ORDER] = order;
    *history->count = (double)(count + 1);
}

/* The polynomial that was given with a sample. */
static void extend(const double *a, double s, double *value, double *slope)
{
    const double e = s - a[TIME];

    *value = a[1] + e * (a[2] + e / 2.0 * (a[3] + e / 3.0 * a[4]));
    *slope = a[2] + e * (a[3] + e / 2.0 * a[4]);
}

/* Between samples a and b: cubic Hermite with both slopes, else a straight line. */
static void interpolate(const double *a, const double *b, double s, double *value, double *slope)
{
    const double h = b[TIME] - a[TIME], z = (s - a[TIME]) / h, rise = b[VALUE] - a[VALUE];

    if (a[ORDER] < 1.0 || b[ORDER] < 1.0) {
        *value = a[VALUE] + z * rise;
        *slope = rise / h;
    } else {
        const double p = h * a[2] - rise, q = rise - h * b[2];
        *value = a[VALUE] + z * (rise + (1.0 - z) * ((1.0 - z) * p + z * q));
        *slope = (rise + (1.0 - z) * ((1.0 - 3.0 * z) * p) + z * (2.0 - 3.0 * z) * q) / h;
    }
}

int history_at(const History *history, double s, double *value, double *slope)
{
    const size_t count = (size_t)*history->count;
    size_t low = count > history->capacity ? count - history->capacity : 0, high = count - 1;

    *value = *slope = 0.0;
    if (count == 0) return 1;
    if (s < sample(history, low)[TIME]) {
        *value = sample(history, low)[VALUE];
        return low > 0;
    }
    if (s >= sample(history, high)[TIME]) {
        extend(sample(history, high), s, value, slope);
        return 0;
    }
    /* samples come at even steps as a rule: look where s would then be */
    if (high > low) {
        const double newest = sample(history, high)[TIME];
        const double step = newest - sample(history, high - 1)[TIME];
        const double back = ceil((newest - s) / step);
        if (back >= 1.0 && back <= (double)(high - low)) {
            const size_t guess = high - (size_t)back;
            if (sample(history, guess)[TIME] <= s) {
                low = guess;
                if (s < sample(history, guess + 1)[TIME]) high = guess + 1;
            } else {
                high = guess;
            }
        }
    }
    while (high - low > 1) {
        const size_t middle = low + (high - low) / 2;
        if (sample(history, middle)[TIME] <= s) low = middle;
        else high = middle;
    }
    interpolate(sample(history, low), sample(history, high), s, value, slope);
    return 0;
}

int history_settled(const History *history, double s)
{
    const size_t count = (size_t)*history->count;

    return count >= 2 && s <= sample(history, count - 2)[TIME];
}

double history_weight(const History *history, double s, double t, int order)
{
    size_t count = (size_t)*history->count;
    const double *before;
    double z;

    if (count > 0 && !(sample(history, count - 1)[TIME] < t)) --count; /* u(t) replaces that one */
    if (count == 0 || s >= t) return 1.0;
    before = sample(history, count - 1);
    if (s <= before[TIME]) return 0.0;
    z = (s - before[TIME]) / (t - before[TIME]);
    return before[ORDER] < 1.0 || order < 1 ? z : z * (1.0 + (1.0 - z) * (2.0 * z - 1.0));
}
