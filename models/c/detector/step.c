#include <math.h>
#include <stdio.h>

#include "../block/sampled.h"
#include "pattern.h"
#include "stamps.h"

BlockStatus block_needs(const Record *record, const BlockLayout *l, BlockNeeds *needs, BlockMessage *message)
{
    const size_t n = l->n_iu;
    Patterns patterns;

    if (n < 1 || n > DETECTOR_SIGNALS || l->n_u != 2 * n || l->n_x + l->n_y + l->n_w + l->n_iw != 0
        || l->n_p != P_SIGNAL + PER_SIGNAL * n || l->n_iy != 3 * n + 1 || l->n_ip != IP_COUNT || !patterns_of(record, n, &patterns)) {
        snprintf(message->text, sizeof message->text,
                 "detector: the variables or the patterns of the record do not fit this binary");
        return BLOCK_ERROR;
    }
    needs->n_memory = M_SIGNALS + DM_COUNT * n;
    needs->n_scratch = n + (patterns.frames > 0 ? n * patterns.samples : 0);
    return BLOCK_OK;
}

static const char *wrong(const Block *b)
{
    const double *p = b->p;

    if (!(p[P_INTERVAL] >= 1e-4 && p[P_INTERVAL] <= 1e3)) return "interval must lie in 1e-4 to 1e3 s";
    if (!(p[P_AVERAGE] >= p[P_INTERVAL] && p[P_AVERAGE] <= p[P_INTERVAL] * (double)DETECTOR_STAMPS + SLACK))
        return "average must lie in 1 to 256 intervals";
    if (!(p[P_WAIT] >= 0.0 && p[P_RETURN] >= 0.0 && p[P_MOVING] >= 0.0 && p[P_SHARE] >= 0.0))
        return "wait, return_time, moving and share must not be negative";
    for (int k = P_PATTERN; k <= P_STANDING_TIME; ++k)
        if (!(p[k] > 0.0)) return "pattern, lasting, floor, alone, standing and standing_time must be positive";
    if (!(b->ip[IP_REPEATS] >= 1)) return "repeats must be at least 1";
    for (size_t i = 0; i < count_of(b); ++i)
        for (int k = 0; k < PER_SIGNAL; ++k)
            if (!(limits_of(b, i)[k] > 0.0)) return "range, jump, apart and rough of a signal must be positive";
    return NULL;
}

BlockStatus block_start(Block *b, double t, BlockMessage *message)
{
    const char *bad = wrong(b);

    if (bad != NULL) {
        snprintf(message->text, sizeof message->text, "detector: %s", bad);
        return BLOCK_ERROR;
    }
    for (size_t k = 0; k < M_SIGNALS + DM_COUNT * count_of(b); ++k) b->memory[k] = 0.0;
    b->memory[M_STOPPED] = b->memory[M_UNTIL] = NEVER;
    b->memory[M_LEVEL] = -NEVER; /* no swing before the first is known */
    b->memory[M_STAMP] = ceil((t - SLACK) / b->p[P_INTERVAL]);
    for (size_t k = 0; k < b->layout.n_iy; ++k) b->iy[k] = k < 2 * count_of(b);
    return BLOCK_OK;
}

static int another_moves(const Block *b, size_t i)
{
    for (size_t j = 0; j < count_of(b); ++j)
        if (j != i && trusted(b, j) && memory_of(b, j)[DM_MOVES] != 0.0) return 1;
    return 0;
}

/* Tests the newest frame of signal i. */
static void test_frame(Block *b, size_t i, double t)
{
    double *m = memory_of(b, i);
    const double *now = frame(m, 0), *limits = limits_of(b, i);

    if (!(fabs(now[1]) <= limits[S_RANGE])) detector_fail(b, i, t, REASON_RANGE);
    if (frames(m) < 2) return;
    const double *before = frame(m, 1);
    const double passed = now[0] - before[0], change = fabs(now[1] - before[1]);

    if (passed <= (double)DETECTOR_GAP * b->p[P_INTERVAL] + SLACK && !(change <= limits[S_JUMP] * passed))
        detector_fail(b, i, t, REASON_JUMP);
    m[DM_MOVES] = change > b->p[P_MOVING] ? 1.0 : 0.0;
    if (change > 0.0) m[DM_REPEATS] = 0.0;
    else if (another_moves(b, i)) m[DM_REPEATS] += 1.0;
    if (m[DM_REPEATS] >= (double)b->ip[IP_REPEATS]) detector_fail(b, i, t, REASON_REPEAT);
}

/* Takes the value that signal i has at time t, if it is a new frame. */
static void receive(Block *b, size_t i, double t, const double *u_poly)
{
    const double stamp = t - u_poly[4 * (count_of(b) + i)];
    double *m = memory_of(b, i), *slot;

    if (!b->iu[i] || (m[DM_FRAMES] > 0.0 && !(stamp > frame(m, 0)[0] + SLACK))) return;
    slot = m + DM_FRAME + 2 * ((size_t)m[DM_FRAMES] % DETECTOR_FRAMES);
    slot[0] = stamp;
    slot[1] = u_poly[4 * i];
    m[DM_FRAMES] += 1.0;
    test_frame(b, i, t);
}

/* Whether signal i takes part in what is compared at time t. */
static int present(const Block *b, size_t i, double t)
{
    const double *m = memory_of(b, i);
    return b->iu[i] && m[DM_FRAMES] > 0.0 && t - frame(m, 0)[0] <= b->p[P_WAIT] + SLACK;
}

/* The value of a signal at stamp c on the line between its frames; NAN where they are not there. */
static double value_at(const Block *b, const double *m, double c)
{
    const size_t count = frames(m);

    for (size_t back = 0; back < count; ++back) {
        const double *f = frame(m, back), *after;
        if (f[0] > c + SLACK) continue;
        if (back == 0 || f[0] >= c - SLACK) return f[0] >= c - SLACK ? f[1] : NAN;
        after = frame(m, back - 1);
        if (after[0] - f[0] > (double)DETECTOR_GAP * b->p[P_INTERVAL] + SLACK) return NAN;
        return f[1] + (after[1] - f[1]) * (c - f[0]) / (after[0] - f[0]);
    }
    return NAN;
}

/* The mean over `count` stamps, the newest of them `back` before the newest. */
static double block_mean(const Block *b, size_t i, size_t back, size_t count)
{
    const double *aligned = memory_of(b, i) + DM_ALIGNED;
    const size_t newest = (size_t)b->memory[M_STAMPS] - back;
    double sum = 0.0;

    for (size_t k = 0; k < count; ++k) sum += aligned[(newest - k) % DETECTOR_STAMPS];
    return sum / (double)count;
}

/* Counts a window in which a signal left more than `lasting`, if it did; how many there were in a row of this one. */
static double lasts(Block *b, size_t named, int more)
{
    for (size_t i = 0; i < count_of(b); ++i)
        memory_of(b, i)[DM_PATTERN] = more && i == named ? memory_of(b, i)[DM_PATTERN] + 1.0 : 0.0;
    return more ? memory_of(b, named)[DM_PATTERN] : 0.0;
}

/* Compares the last window of all signals with the patterns of the record; the newest stamp is in memory. */
static void compare_patterns(Block *b, const Patterns *patterns, double t)
{
    const size_t n = count_of(b), L = patterns->samples, frames = patterns->frames;
    double *x = b->scratch + n, whole, score, least = INFINITY;
    size_t isolated = 0, named = n;

    if (b->memory[M_STAMPS] + 1.0 < (double)(frames * L)) return;
    for (size_t i = 0; i < n; ++i) {
        if (!trusted(b, i)) {
            named = i;
            ++isolated;
        }
        for (size_t s = 0; s < L; ++s) x[i * L + s] = block_mean(b, i, (L - 1 - s) * frames, frames);
    }
    whole = pattern_left(patterns, x, n);
    if (isnan(whole) || isolated > 1) { /* a value is missing, or too few are left to compare */
        lasts(b, n, 0);
        return;
    }
    for (size_t i = 0; i < n; ++i) {
        const double left = pattern_left(patterns, x, i);
        if (isolated == 1 ? i != named : left >= least) continue;
        least = left;
        named = i;
    }
    score = sqrt(fmax(whole * whole - least * least, 0.0)) / (b->p[P_FLOOR] + 3.0 * least);
    if (lasts(b, named, score > b->p[P_LASTING]) >= (double)(L + DETECTOR_EVENT) || score > b->p[P_PATTERN])
        detector_fail(b, named, t, REASON_PATTERN);
}

/* How many frames of a signal are newer than stamp c. */
static size_t newer(const double *m, double c)
{
    const size_t count = frames(m);
    size_t back = 0;

    while (back < count && frame(m, back)[0] > c + SLACK) ++back;
    return back;
}

/* Whether `count` frames, the newest of them `back` before the newest, differ by no more from those `lag` earlier. */
static int comes_again(const double *m, size_t back, size_t count, size_t lag, double most)
{
    if (back + lag + count > frames(m)) return 0;
    for (size_t k = back; k < back + count; ++k)
        if (!(fabs(frame(m, k)[1] - frame(m, k + lag)[1]) <= most)) return 0;
    return 1;
}

/* Whether these frames move enough to be known again. */
static int moved(const Block *b, const double *m, size_t back, size_t count)
{
    double least = INFINITY, most = -INFINITY;

    if (back + count > frames(m)) return 0;
    for (size_t k = back; k < back + count; ++k) {
        least = fmin(least, frame(m, k)[1]);
        most = fmax(most, frame(m, k)[1]);
    }
    return most - least > (double)count * b->p[P_MOVING];
}

/* Whether frame `number` of a signal has the bits of an earlier one. Each such frame is looked for once. */
static int comes_from_before(double *m, size_t number)
{
    const double *ring = m + DM_FRAME + 1, value = ring[2 * (number % DETECTOR_FRAMES)];
    const size_t oldest = (size_t)m[DM_FRAMES] - frames(m);

    if (m[DM_LOOKED] == (double)number) return m[DM_REPEATED] != 0.0;
    m[DM_LOOKED] = (double)number;
    m[DM_REPEATED] = 0.0;
    for (size_t k = oldest; k < number; ++k)
        if (ring[2 * (k % DETECTOR_FRAMES)] == value) m[DM_REPEATED] = 1.0;
    return m[DM_REPEATED] != 0.0;
}

/* Whether the frames of signal i up to stamp c are those of some time before, and those of another signal not. */
static int replayed(const Block *b, size_t i, double c)
{
    double *m = memory_of(b, i);
    const double *ring = m + DM_FRAME + 1;
    const size_t count = (size_t)b->ip[IP_REPEATS], back = newer(m, c), stored = frames(m);

    if (!moved(b, m, back, count)) return 0;
    const size_t first = (size_t)m[DM_FRAMES] - 1 - back;
    if (!comes_from_before(m, first - first % count)) return 0; /* one of `count` in a row has such a number */
    const double value = ring[2 * (first % DETECTOR_FRAMES)];
    for (size_t lag = 1; back + lag + count <= stored; ++lag) {
        if (ring[2 * ((first - lag) % DETECTOR_FRAMES)] != value) continue;   /* most lags end here */
        if (!comes_again(m, back, count, lag, 0.0)) continue;
        for (size_t j = 0; j < count_of(b); ++j) {
            const double *other = memory_of(b, j);
            const size_t start = newer(other, c);
            if (j != i && trusted(b, j) && moved(b, other, start, count)
                && !comes_again(other, start, count, lag, b->p[P_MOVING]))
                return 1;
        }
    }
    return 0;
}

/* Looks in every signal for frames that come again, up to the newest stamp that all have reached. */
static void compare_frames(Block *b, double t)
{
    const double c = (b->memory[M_STAMP] - 1.0) * b->p[P_INTERVAL];

    for (size_t i = 0; i < count_of(b); ++i)
        if (present(b, i, t) && replayed(b, i, c)) detector_fail(b, i, t, REASON_REPLAY);
}

/* Compares the signals at every stamp that all of them have reached by time t. */
static void compare(Block *b, double t)
{
    const double interval = b->p[P_INTERVAL];
    double *m = b->memory, reached = INFINITY;
    Patterns patterns;

    for (size_t i = 0; i < count_of(b); ++i)
        if (present(b, i, t)) reached = fmin(reached, frame(memory_of(b, i), 0)[0]);
    if (isinf(reached)) return;
    reached = floor((reached + SLACK) / interval);
    if (reached < m[M_STAMP]) return; /* no new stamp */
    if (reached - m[M_STAMP] >= (double)DETECTOR_FRAMES) { /* after a pause of all of them */
        m[M_STAMP] = reached;
        m[M_STAMPS] = m[M_SINCE] = m[M_COMPARED] = m[M_GROWN] = m[M_DISTURBED] = 0.0;
        for (size_t i = 0; i < count_of(b); ++i)
            memory_of(b, i)[DM_ALONE] = memory_of(b, i)[DM_BENDS] = memory_of(b, i)[DM_BEND_COUNT] = 0.0;
    }
    (void)patterns_of(b->record, count_of(b), &patterns);
    for (; m[M_STAMP] <= reached; m[M_STAMP] += 1.0, m[M_STAMPS] += 1.0) {
        for (size_t i = 0; i < count_of(b); ++i) {
            double *own = memory_of(b, i);
            own[DM_ALIGNED + (size_t)m[M_STAMPS] % DETECTOR_STAMPS] =
                present(b, i, t) ? value_at(b, own, m[M_STAMP] * interval) : NAN;
        }
        note_bends(b, (size_t)m[M_STAMPS]);
        if (patterns.frames > 0 && fmod(m[M_STAMP] + 1.0, (double)patterns.frames) == 0.0)
            compare_patterns(b, &patterns, t);
    }
    compare_means(b, t);
    compare_bends(b, t);
    compare_frames(b, t);
}

/* Why signal i cannot be used: its own reason before that of all. */
static int reason_of(const Block *b, size_t i, int stopped)
{
    const double *m = memory_of(b, i);

    if (m[DM_ISOLATED] != 0.0) return (int)m[DM_REASON];
    if (!b->iu[i]) return REASON_LOST;
    return stopped ? REASON_STANDING : REASON_NONE;
}

BlockStatus block_step(Block *b, double t, double h, const double *u_poly, double *dy, BlockMessage *message)
{
    const size_t n = count_of(b);
    int stopped;

    (void)h, (void)dy, (void)message;
    for (size_t i = 0; i < n; ++i) receive(b, i, t, u_poly);
    compare(b, t);
    if (t >= b->memory[M_UNTIL] - SLACK) b->memory[M_STOPPED] = NEVER;
    stopped = b->memory[M_STOPPED] > NEVER;
    for (size_t i = 0; i < n; ++i) {
        double *m = memory_of(b, i);
        const double passed = t - m[DM_FAILED_AT];
        if (m[DM_ISOLATED] != 0.0 && passed >= b->p[P_RETURN] * ldexp(1.0, (int)m[DM_FAILURES] - 1) - SLACK)
            m[DM_ISOLATED] = m[DM_REPEATS] = 0.0;
        b->iy[i] = trusted(b, i) && !stopped;
        b->iy[n + i] = m[DM_ISOLATED] == 0.0 && !stopped;
        b->iy[2 * n + i] = reason_of(b, i, stopped);
    }
    b->iy[3 * n] = (int)b->memory[M_ALARMS];
    return BLOCK_OK;
}

BlockStatus block_directional(Block *b, double t, const double *x, const double *u, const double *vx,
                              const double *vu, double *vdx, double *vy, BlockMessage *message)
{
    (void)b, (void)t, (void)x, (void)u, (void)vx, (void)vu, (void)vdx, (void)vy, (void)message;
    return BLOCK_OK;
}
