#ifndef INTERAREA_DETECTOR_H
#define INTERAREA_DETECTOR_H
/* Which of several measured frequencies are to be trusted.
 *
 * Input i is what a channel or a concentrator hands over: value, age and flag. A frame is a value with a new
 * stamp, stamp = t - age, while the flag is up. Tests of each frame of signal i, which need no model:
 *
 *     range   |u| > range[i]
 *     jump    |u - u'| > jump[i] (stamp - stamp'), u' the frame before, not more than GAP intervals older
 *     repeat  `repeats` frames in a row have the same bits, while another trusted signal moves by more than
 *             `moving` from frame to frame
 *
 * and of all signals at the same stamps c = k interval, which the slowest of them has reached (one that lags by
 * more than `wait` is left out); between frames u is a straight line:
 *
 *     apart   |mean(u_i) - median of mean(u_j)| > apart[i] + share max(span(u_j)),   j another trusted signal,
 *
 * mean and span (largest less smallest) over the last `average` seconds: all frequencies of one network agree when
 * averaged over the period of its slowest swing. The first half wave of a swing has a mean too, hence the span.
 * The test needs two others, and only the signal that is furthest beyond its limit is named at a stamp.
 *
 *     rough   the median of |u_i(c) - 2 u_i(c - interval) + u_i(c - 2 interval)| over the last ROUGH stamps
 *             > rough[i] + 2 max(mean of the same of u_j),   j another trusted signal
 *     alone   swing(u_i) > alone (3 floor + max(swing(u_j))), at every stamp of the last 1.5 `average` seconds, in
 *             which its least value stays above STEADY of its largest
 *
 *     replay  the last `repeats` frames up to c have the same bits as those some number of frames before (the search
 *             goes back over DETECTOR_FRAMES) and span more than `repeats` times `moving`, while those of another
 *             trusted signal span as much and differ by more than `moving` from those as many frames before
 *
 * A swing that has become a cycle comes again, or nearly, in every signal: none is named.
 *
 * A swing is the span of u less its trend, the line that least squares lay through the last STAMPS values, so that a
 * drift of frequency is none and hides none; this line takes less of a slow swing than one through `average` seconds
 * would.
 *
 * A swing bends little from frame to frame and a disturbance bends few frames: noise bends all of them. What moves
 * one machine alone, and by how much, depends on the grid: `alone` comes with the patterns. What a fault near a
 * machine leaves dies out; so `alone` outlasts the swings that contain the fault, and asks for one that stays.
 *
 * With patterns in the record (pattern.h) a third test of all signals at the same stamps:
 *
 *     pattern sqrt(r^2 - r_i^2) / (floor + 3 r_i) > pattern, r_i the least, or > lasting at EVENT more windows in a
 *             row than a window has samples, all of the same i; while one signal is isolated it alone is tested,
 *             while more are, or a flag is down, none
 *
 * A fault near a machine moves that machine alone, but only windows that contain the fault differ much from the
 * patterns: `lasting` is for what follows it, and much less than `pattern`.
 *
 * What no test can name shows in the end: a wrong signal keeps a swing alive. With level the second largest of the
 * swings of the signals that are present and pass (of two or more; one of them may be the wrong one),
 *
 *     standing  level > standing for standing_time, its least value above STEADY of its largest; or
 *               level(t) > RISES level(t - average / 2) at GROWTHS halves of an average in a row, from where it
 *               exceeds standing, and level(t) > GROWS level(t - average) at all of them but the first.
 *
 * The halves are counted anew after each disturbance: a stamp at which two trusted signals or more bend by more than
 * `moving` and SHARP times the mean of the last bends of each. A fault, a trip or a step of a load changes the torques of
 * all machines at once, but an unstable loop turns the slope of a speed gradually, and a wrong signal bends alone. Noise
 * hides a small disturbance; the swing after it stands or falls in one of the halves.
 *
 * It takes all signals out at once, as if each were isolated: the grid is left to its own damping. They come back when
 * return 2^(n-1) has passed, n the number of such stops, or as soon as the swings of all signals but one have risen to
 * WORSE of what they were two averages after the stop, which is a disturbance itself: then the controller was not the
 * cause, and it is not stopped again before that time.
 *
 * A signal that fails is isolated. It comes back when it has passed every test for return 2^(n - 1), n the number
 * of times it was isolated so far, at most 2^6 return. Of each signal
 *
 *     usable   its flag is up and it is not isolated: for a bank, which fades a signal out and chooses by the rest
 *     trusted  it is not isolated: for a controller without a bank, which takes 0 in place of the signal
 *     reason   one of REASON_
 *
 * Outputs of a step follow from the inputs where it begins.                                                 */
#include <math.h>

#include "../block/block.h"

enum { DETECTOR_SIGNALS = 32, DETECTOR_FRAMES = 512, DETECTOR_STAMPS = 256, DETECTOR_GAP = 5, DETECTOR_ROUGH = 50 };
enum { DETECTOR_TREND = 4 }; /* of so many stamps one serves for the trend, which is much slower */
enum { DETECTOR_EVENT = 3 }; /* samples of a window that a fault of .16 s takes part in, beyond those of one instant */
/* Real inputs: the values, then the ages. */
/* Real parameters: the common ones, then PER_SIGNAL of each signal. Integer parameter: IP_REPEATS. */
enum {
    P_INTERVAL, P_WAIT, P_AVERAGE, P_RETURN, P_MOVING, P_SHARE, P_PATTERN, P_LASTING, P_FLOOR, P_ALONE,
    P_STANDING, P_STANDING_TIME, P_SIGNAL
};
enum { S_RANGE, S_JUMP, S_APART, S_ROUGH, PER_SIGNAL };
enum { IP_REPEATS, IP_COUNT };
/* Integer outputs: usable of each, trusted of each, reason of each, then the number of isolations so far. */
enum {
    REASON_NONE, REASON_LOST, REASON_RANGE, REASON_JUMP, REASON_REPEAT, REASON_APART, REASON_PATTERN, REASON_ROUGH,
    REASON_ALONE, REASON_REPLAY, REASON_STANDING
};

/* Discrete state: a head, then of each signal DM_COUNT numbers. */
/* M_SINCE: stamps since which level is above `standing`, M_LEAST and M_MOST its range from there; M_STOPPED: time
 * from which all signals are out or NEVER, M_STOPS how often so far, M_UNTIL the time that ends the last. M_COMPARED,
 * M_LEVEL: stamp and level of the last comparison for growth, M_BEFORE the level of the one before, M_GROWN how many in
 * a row have found it; M_DISTURBED: stamps up to the last disturbance. */
enum {
    M_STAMP, M_STAMPS, M_ALARMS, M_SINCE, M_LEAST, M_MOST, M_STOPPED, M_STOPS, M_UNTIL, M_COMPARED, M_LEVEL, M_BEFORE,
    M_GROWN, M_DISTURBED, M_SIGNALS
};
enum {
    DM_ISOLATED, DM_REASON, DM_FAILED_AT, DM_FAILURES, DM_REPEATS, DM_MOVES, DM_FRAMES, DM_MEAN, DM_SPAN, DM_BEND,
    DM_BENDS, DM_BEND_COUNT, /* sum and number of the last bends, of which DM_BEND is the mean */
    DM_LOOKED, DM_REPEATED, /* a frame that was looked for among those before it, and whether it is there */
    DM_PATTERN, /* windows in a row that left more than `lasting` */
    DM_ALONE, DM_LEAST, DM_MOST, /* stamp since which a signal swings alone, and the range of its swing from there */
    DM_SWING, DM_AT_STOP, /* span less the trend; the same two averages after all were taken out */
    DM_FRAME, /* stamp and value of each of the last frames */
    DM_ALIGNED = DM_FRAME + 2 * DETECTOR_FRAMES,
    DM_COUNT = DM_ALIGNED + DETECTOR_STAMPS
};

#define SLACK 1e-9 /* s; instants closer than this count as equal */
#define MOST_FAILURES 7.0
#define NEVER (-1e300)

static inline double *memory_of(const Block *b, size_t i) { return b->memory + M_SIGNALS + DM_COUNT * i; }
static inline const double *limits_of(const Block *b, size_t i) { return b->p + P_SIGNAL + PER_SIGNAL * i; }
static inline size_t count_of(const Block *b) { return b->layout.n_iu; }
static inline int trusted(const Block *b, size_t i) { return b->iu[i] && memory_of(b, i)[DM_ISOLATED] == 0.0; }

/* Stamp and value of the frame that is `back` before the newest. */
static inline const double *frame(const double *m, size_t back)
{
    const size_t number = (size_t)m[DM_FRAMES] - 1 - back;
    return m + DM_FRAME + 2 * (number % DETECTOR_FRAMES);
}

static inline size_t frames(const double *m)
{
    return m[DM_FRAMES] < (double)DETECTOR_FRAMES ? (size_t)m[DM_FRAMES] : DETECTOR_FRAMES;
}

/* Signal i fails a test at time t. */
static inline void detector_fail(Block *b, size_t i, double t, int reason)
{
    double *m = memory_of(b, i);

    m[DM_FAILED_AT] = t;
    if (m[DM_ISOLATED] != 0.0) return;
    m[DM_ISOLATED] = 1.0;
    m[DM_REASON] = (double)reason;
    m[DM_FAILURES] = fmin(m[DM_FAILURES] + 1.0, MOST_FAILURES);
    b->memory[M_ALARMS] += 1.0;
}

#endif
