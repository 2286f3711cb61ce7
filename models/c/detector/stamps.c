#include "stamps.h"

#include <stdint.h>

/* A swing whose span falls by less than this in `standing_time` stands: at 0.6 Hz and 15 s a damping of 0.9 %. One of
 * a signal alone in 1.5 `average`: at 1.2 Hz and 3 s a damping of 2.3 %. */
static const double STEADY = 0.6;
static const double WORSE = 1.5; /* rise of the swing after a stop that beats and noise do not make */
/* Rise of the second largest swing in an average, at 1.2 Hz and 2 s a damping of -5 %, least rise in each half of it,
 * and how many halves in a row. Of an exponential a half has 1.41, but a swing of .5 Hz rises unevenly. After a
 * disturbance the swing stands or falls in one of them. */
static const double GROWS = 2.0, RISES = 1.3, GROWTHS = 4.0;
/* A bend so many times the mean of those before it. A swing of .2 Hz or more that grows by e a second at most has 3.2
 * times the mean, noise has more than SHARP times it at one stamp in 15000. */
static const double SHARP = 5.0;
static const double UNIT = 1e-12; /* pu, of a bend; fifty bends of 1 pu are less than the 2^53 of an exact sum */

/* Rise from stamp to stamp of the line that least squares lay through every TREND-th of the stamps in memory; 0 where
 * more than a quarter of them lacks a value. */
static double trend_of(const double *m, size_t newest)
{
    double n, x = 0.0, y = 0.0, xx = 0.0, xy = 0.0;
    size_t known = 0;

    for (size_t back = 0; back <= newest && back < DETECTOR_STAMPS; back += DETECTOR_TREND) {
        const double value = m[DM_ALIGNED + (newest - back) % DETECTOR_STAMPS], at = -(double)back;
        if (isnan(value)) continue;
        ++known;
        x += at;
        y += value;
        xx += at * at;
        xy += at * value;
    }
    n = (double)known;
    return 4 * DETECTOR_TREND * known >= 3 * DETECTOR_STAMPS ? (n * xy - x * y) / (n * xx - x * x) : 0.0;
}

/* Mean, span and swing over the last `count` stamps; NAN where more than a quarter of them lacks a value. */
static void average(double *m, size_t newest, size_t count)
{
    const double trend = trend_of(m, newest);
    double sum = 0.0, least = INFINITY, most = -INFINITY, lowest = INFINITY, highest = -INFINITY;
    size_t known = 0;

    for (size_t back = 0; back < count; ++back) {
        const double value = m[DM_ALIGNED + (newest - back) % DETECTOR_STAMPS];
        const double swing = value + trend * (double)back;
        if (isnan(value)) continue;
        sum += value;
        if (value < least) least = value;
        if (value > most) most = value;
        if (swing < lowest) lowest = swing;
        if (swing > highest) highest = swing;
        ++known;
    }
    m[DM_MEAN] = 4 * known >= 3 * count && known > 0 ? sum / (double)known : NAN;
    m[DM_SPAN] = most - least;
    m[DM_SWING] = highest - lowest;
}

/* By how much the mean of signal i is apart from the others, over what is allowed; NAN: fewer than two others. */
static double apart(const Block *b, size_t i)
{
    double *sorted = b->scratch, span = 0.0;
    size_t count = 0;

    for (size_t j = 0; j < count_of(b); ++j) {
        const double mean = memory_of(b, j)[DM_MEAN];
        size_t k = count;
        if (j == i || !trusted(b, j) || isnan(mean)) continue;
        for (; k > 0 && sorted[k - 1] > mean; --k) sorted[k] = sorted[k - 1];
        sorted[k] = mean;
        span = fmax(span, memory_of(b, j)[DM_SPAN]);
        ++count;
    }
    if (count < 2) return NAN;
    return fabs(memory_of(b, i)[DM_MEAN] - 0.5 * (sorted[(count - 1) / 2] + sorted[count / 2]))
           / (limits_of(b, i)[S_APART] + b->p[P_SHARE] * span);
}

/* The largest number `what` of the memories of the other trusted signals; 0: there is none. */
static double most_of_others(const Block *b, size_t i, int what)
{
    double most = 0.0;

    for (size_t j = 0; j < count_of(b); ++j)
        if (j != i && trusted(b, j) && memory_of(b, j)[what] > most) most = memory_of(b, j)[what];
    return most;
}

/* By how much a signal bends at the stamp `back` before the newest; NAN where a value is missing. */
static double bend(const double *m, size_t newest, size_t back)
{
    const double *u = m + DM_ALIGNED;
    const size_t c = newest - back;

    return fabs(u[c % DETECTOR_STAMPS] - 2.0 * u[(c - 1) % DETECTOR_STAMPS] + u[(c - 2) % DETECTOR_STAMPS]);
}

/* Of the last bends the number that is known, and how many are larger than a limit. */
static size_t bends(const double *m, size_t newest, double limit, size_t *larger)
{
    size_t known = 0;

    *larger = 0;
    for (size_t back = 0; back < DETECTOR_ROUGH; ++back) {
        const double value = bend(m, newest, back);
        *larger += value > limit;
        if (!isnan(value)) ++known;
    }
    return known;
}

/* Adds a bend to those of which the mean is taken, or takes it away. Their sum is an integer number of UNIT, so that
 * what is taken away leaves nothing. */
static void add_bend(double *m, double value, double sign)
{
    if (isnan(value)) return;
    m[DM_BENDS] += sign * (double)(int64_t)(fmin(value, 1.0) / UNIT);
    m[DM_BEND_COUNT] += sign;
}

/* Compares how rough the signals are. */
void compare_bends(Block *b, double t)
{
    const size_t newest = (size_t)b->memory[M_STAMPS] - 1;
    size_t known, larger;

    if (newest + 1 < DETECTOR_ROUGH + 2) return;
    for (size_t i = 0; i < count_of(b); ++i) {
        const double limit = limits_of(b, i)[S_ROUGH] + 2.0 * most_of_others(b, i, DM_BEND);
        if (!b->iu[i] || 2.0 * memory_of(b, i)[DM_BEND] <= limit) continue; /* so is the median */
        known = bends(memory_of(b, i), newest, limit, &larger);
        if (4 * known >= 3 * DETECTOR_ROUGH && 2 * larger > known) detector_fail(b, i, t, REASON_ROUGH);
    }
}

/* Takes the bends at the newest stamp, whose number is `newest`, into their means. Notes a disturbance where two signals
 * or more bend sharply. */
void note_bends(Block *b, size_t newest)
{
    size_t sharp = 0;

    if (newest < 2) return;
    for (size_t i = 0; i < count_of(b); ++i) {
        double *m = memory_of(b, i);
        const double value = bend(m, newest, 0);
        sharp += trusted(b, i) && value > b->p[P_MOVING] + SHARP * m[DM_BEND];
        add_bend(m, value, 1.0);
        if (newest >= DETECTOR_ROUGH + 2) add_bend(m, bend(m, newest, DETECTOR_ROUGH), -1.0);
        m[DM_BEND] = m[DM_BEND_COUNT] > 0.0 ? UNIT * m[DM_BENDS] / m[DM_BEND_COUNT] : 0.0;
    }
    if (sharp > 1) b->memory[M_DISTURBED] = (double)newest + 1.0;
}

/* Starts to watch at the newest stamp whether a signal swings alone. */
static void alone_from(double *m, double stamps)
{
    m[DM_ALONE] = stamps;
    m[DM_LEAST] = m[DM_MOST] = m[DM_SWING];
}

/* Compares the swings over the last `count` stamps, which they have done for half as many more. */
static void compare_swings(Block *b, double t, size_t count)
{
    const double stamps = b->memory[M_STAMPS];
    size_t others = 0;

    for (size_t i = 0; i < count_of(b); ++i) others += trusted(b, i) && !isnan(memory_of(b, i)[DM_MEAN]);
    for (size_t i = 0; i < count_of(b); ++i) {
        double *m = memory_of(b, i);
        const double most = b->p[P_ALONE] * (3.0 * b->p[P_FLOOR] + most_of_others(b, i, DM_SWING));
        if (others < 3 || !b->iu[i] || isnan(m[DM_MEAN]) || !(m[DM_SWING] > most)) m[DM_ALONE] = 0.0;
        else if (m[DM_ALONE] == 0.0) alone_from(m, stamps);
        else {
            m[DM_LEAST] = fmin(m[DM_LEAST], m[DM_SWING]);
            m[DM_MOST] = fmax(m[DM_MOST], m[DM_SWING]);
            if (!(m[DM_LEAST] > STEADY * m[DM_MOST])) alone_from(m, stamps);
            else if (stamps - m[DM_ALONE] + 1.0 >= 1.5 * (double)count) detector_fail(b, i, t, REASON_ALONE);
        }
    }
}

/* The second largest swing of the signals that are present and pass; of one alone its own. */
static double level_of(const Block *b)
{
    double largest = 0.0, second = 0.0;
    size_t count = 0;

    for (size_t i = 0; i < count_of(b); ++i) {
        const double *m = memory_of(b, i);
        if (!trusted(b, i) || isnan(m[DM_MEAN])) continue;
        ++count;
        second = fmax(second, fmin(m[DM_SWING], largest));
        largest = fmax(largest, m[DM_SWING]);
    }
    return count > 1 ? second : largest;
}

/* What follows a stop: the swings of then, once the stop itself has left them; then whether they have grown since. */
static void watch_stop(Block *b, double t)
{
    const int waits = t < b->memory[M_STOPPED] + 2.0 * b->p[P_AVERAGE] - SLACK;
    size_t count = 0, larger = 0;

    for (size_t i = 0; i < count_of(b); ++i) {
        double *m = memory_of(b, i);
        if (waits) m[DM_AT_STOP] = m[DM_SWING];
        if (waits || !trusted(b, i) || isnan(m[DM_MEAN])) continue;
        ++count;
        larger += m[DM_SWING] > WORSE * m[DM_AT_STOP];
    }
    if (larger > 0 && larger + 1 >= count) b->memory[M_STOPPED] = NEVER; /* one of them may be wrong */
}

/* Starts to watch a swing at the newest stamp. */
static void watch_from(double *m, double level)
{
    m[M_SINCE] = m[M_STAMPS];
    m[M_LEAST] = m[M_MOST] = level;
}

/* Counts the halves of an average in a row in which the level has grown, from the stamp where it exceeds `standing`
 * and from the last disturbance on. */
static void watch_growth(Block *b, double level, int waits)
{
    double *m = b->memory;
    const int small = waits || !(level > b->p[P_STANDING]), disturbed = m[M_DISTURBED] > m[M_COMPARED];

    if (!small && !disturbed && 2.0 * (m[M_STAMPS] - m[M_COMPARED]) * b->p[P_INTERVAL] < b->p[P_AVERAGE] - SLACK) return;
    if (small || disturbed || !(level > RISES * m[M_LEVEL])) m[M_GROWN] = 0.0;
    else m[M_GROWN] = m[M_GROWN] == 0.0 || level > GROWS * m[M_BEFORE] ? m[M_GROWN] + 1.0 : 1.0;
    m[M_COMPARED] = m[M_STAMPS];
    m[M_BEFORE] = m[M_LEVEL];
    m[M_LEVEL] = level;
}

/* Takes all signals out while a swing stands or grows, and gives them back when it grows without them. */
static void watch_swing(Block *b, double t)
{
    const double level = level_of(b);
    double *m = b->memory;
    const int waits = t < m[M_UNTIL] - SLACK;
    int stands = 1;

    if (m[M_STOPPED] > NEVER) watch_stop(b, t);
    watch_growth(b, level, waits);
    m[M_LEAST] = fmin(m[M_LEAST], level);
    m[M_MOST] = fmax(m[M_MOST], level);
    if (!(level > b->p[P_STANDING]) || waits || !(m[M_LEAST] > STEADY * m[M_MOST])) {
        watch_from(m, level);
        stands = 0;
    }
    stands = stands && (m[M_STAMPS] - m[M_SINCE]) * b->p[P_INTERVAL] >= b->p[P_STANDING_TIME] - SLACK;
    if (!stands && m[M_GROWN] < GROWTHS) return;
    watch_from(m, level);
    m[M_STOPPED] = t;
    m[M_UNTIL] = t + b->p[P_RETURN] * ldexp(1.0, (int)m[M_STOPS]);
    m[M_STOPS] = fmin(m[M_STOPS] + 1.0, MOST_FAILURES - 1.0);
    m[M_ALARMS] += 1.0;
}

/* Compares the means over the last stamps. */
void compare_means(Block *b, double t)
{
    const size_t count = (size_t)(b->p[P_AVERAGE] / b->p[P_INTERVAL] + 0.5), newest = (size_t)b->memory[M_STAMPS] - 1;
    size_t furthest = 0;
    double most = 0.0;

    if (newest + 1 < count) return;
    for (size_t i = 0; i < count_of(b); ++i) average(memory_of(b, i), newest, count);
    for (size_t i = 0; i < count_of(b); ++i) {
        const double ratio = apart(b, i);
        if (!(ratio > 1.0)) continue;
        if (!trusted(b, i)) {
            if (b->iu[i]) detector_fail(b, i, t, REASON_APART);
        } else if (ratio > most) {
            most = ratio;
            furthest = i;
        }
    }
    if (most > 1.0) detector_fail(b, furthest, t, REASON_APART);
    compare_swings(b, t, count);
    watch_swing(b, t);
}
