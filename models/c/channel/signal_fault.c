#include "signal_fault.h"

#include <math.h>

#include "../block/random.h"

static const double SLACK = 1e-10; /* s */
static const double TURN = 6.28318530717958647692;

/* sin(2 pi turns) by its series over a quarter turn: the same bits on every platform. */
static double sine(double turns)
{
    double z = turns - floor(turns + 0.5), x, sum, term;

    if (z > 0.25) z = 0.5 - z;
    if (z < -0.25) z = -0.5 - z;
    x = sum = term = TURN * z;
    for (int k = 2; k < 22; k += 2) {
        term *= -x * x / (double)(k * (k + 1));
        sum += term;
    }
    return sum;
}

/* exp(-x) of x >= 0 by its series below one half, squared as often as that was halved. */
static double decayed(double x)
{
    int halved = 0;
    double sum = 1.0, term = 1.0;

    if (x > 700.0) return 0.0;
    for (; x > 0.5; x /= 2.0) ++halved;
    for (int k = 1; k < 16; ++k) {
        term *= -x / (double)k;
        sum += term;
    }
    for (; halved > 0; --halved) sum *= sum;
    return sum;
}

/* gain * u(time) + offset, and how time and offset move with s. */
typedef struct {
    double time, time_rate, gain, offset, offset_slope;
} Sent;

/* Whether a replay is a number of packets that there is room for. */
static int fits(double length, double interval)
{
    return length >= interval - SLACK && length <= interval * (double)SIGNAL_FAULT_RECORD + SLACK;
}

/* Why size and detail cannot be those of the kind, or NULL. */
static const char *numbers_wrong(int kind, double size, double detail, const SignalFaults *faults)
{
    switch (kind) {
    case FAULT_DRIFT:
        return detail > 0.0 ? NULL : "fault.detail of a drift must be positive";
    case FAULT_SPIKE:
        return detail >= 0.0 && detail <= 1.0 ? NULL : "fault.detail of a spike must lie in 0 to 1";
    case FAULT_TIME_ERROR:
        return size >= 0.0 && detail >= 0.0 && detail < 1.0
                   ? NULL : "a time error must not be negative, and drift by less than 1 s a second";
    case FAULT_REPLAY:
        return fits(size, faults->interval) ? NULL : "a replay must be 1 to 1024 packets long";
    case FAULT_SWAP:
        return size >= 1.0 && size <= (double)faults->signals
                   ? NULL : "a swap needs another signal of the same concentrator";
    default:
        return NULL;
    }
}

static int needs_packets(int kind) { return kind == FAULT_NOISE || kind == FAULT_SPIKE || kind == FAULT_REPLAY; }

const char *signal_faults_wrong(const SignalFaults *faults)
{
    const char *wrong = NULL;

    for (int k = 0; k < SIGNAL_FAULTS && wrong == NULL; ++k) {
        const double *p = faults->p + FAULT_REALS * k;
        const int kind = faults->kind[k];

        if (kind == FAULT_NONE) continue;
        wrong = numbers_wrong(kind, p[FAULT_SIZE], p[FAULT_DETAIL], faults);
        if (kind < 0 || kind >= FAULT_KINDS) wrong = "fault.kind must be one of those listed";
        if (!(p[FAULT_START] <= p[FAULT_END])) wrong = "fault.end lies before fault.start";
        if (!isfinite(p[FAULT_SIZE] + p[FAULT_DETAIL])) wrong = "fault.size and fault.detail must be finite";
        if (needs_packets(kind) && !(faults->interval > 0.0))
            wrong = "noise, spike and replay act on packets: set reporting_interval";
    }
    return wrong;
}

/* The fault that acts at time s, or -1. */
static int active(const SignalFaults *faults, double s)
{
    for (int k = 0; k < SIGNAL_FAULTS; ++k) {
        const double *p = faults->p + FAULT_REALS * k;
        if (faults->kind[k] != FAULT_NONE && p[FAULT_START] <= s + SLACK && s < p[FAULT_END] - SLACK) return k;
    }
    return -1;
}

/* A random number of the packet stamped s: zero mean, variance 1. */
static double normal(const SignalFaults *faults, double s)
{
    const double number = floor(s / faults->interval + 0.5);
    double sum = -6.0;

    for (unsigned i = 0; i < 12; ++i) sum += packet_random(faults->seed, number, faults->stream + i);
    return sum;
}

/* -1, 0 or 1 of the packet stamped s. */
static double spike(const SignalFaults *faults, double s, double probability)
{
    const double number = floor(s / faults->interval + 0.5);

    if (!(packet_random(faults->seed, number, faults->stream + 12) < probability)) return 0.0;
    return packet_random(faults->seed, number, faults->stream + 13) < 0.5 ? -1.0 : 1.0;
}

/* What is added at time s, `since` the start, and its slope. */
static void add(const SignalFaults *faults, int k, double s, double since, Sent *sent)
{
    const double size = faults->p[FAULT_REALS * k + FAULT_SIZE], detail = faults->p[FAULT_REALS * k + FAULT_DETAIL];

    switch (faults->kind[k]) {
    case FAULT_BIAS:
        sent->offset = size;
        break;
    case FAULT_RAMP:
        sent->offset = size * since;
        sent->offset_slope = size;
        break;
    case FAULT_DRIFT:
        sent->offset = size * (1.0 - decayed(since / detail));
        sent->offset_slope = size / detail * decayed(since / detail);
        break;
    case FAULT_NOISE:
        sent->offset = size * normal(faults, s);
        break;
    case FAULT_SPIKE:
        sent->offset = size * spike(faults, s, detail);
        break;
    case FAULT_OSCILLATING:
        sent->offset = size * sine(detail * since);
        sent->offset_slope = TURN * detail * size * sine(detail * since + 0.25);
        break;
    default:
        break;
    }
}

static Sent sent_at(const SignalFaults *faults, int k, double s)
{
    const double *p = faults->p + FAULT_REALS * k;
    const double size = p[FAULT_SIZE], detail = p[FAULT_DETAIL];
    const double since = s > p[FAULT_START] ? s - p[FAULT_START] : 0.0;
    Sent sent = {s, 1.0, 1.0, 0.0, 0.0};

    switch (faults->kind[k]) {
    case FAULT_STUCK:
        sent.time = p[FAULT_START];
        sent.time_rate = 0.0;
        break;
    case FAULT_SCALE:
        sent.gain = size;
        break;
    case FAULT_POLARITY:
        sent.gain = -1.0;
        break;
    case FAULT_REPLAY:
        sent.time = s - size * (floor((since + SLACK) / size) + 1.0);
        break;
    case FAULT_TIME_ERROR:
        sent.time = s - size - detail * since;
        sent.time_rate = 1.0 - detail;
        break;
    default: /* a swap reads another history */
        add(faults, k, s, since, &sent);
    }
    return sent;
}

/* The packet of `time` among those that the replay k repeats: recorded once, when they can no longer change. */
static int replayed(const SignalFaults *faults, const History *history, int k, double time, double *value)
{
    const double *p = faults->p + FAULT_REALS * k;
    const double interval = faults->interval, length = p[FAULT_SIZE];
    const double first = ceil((p[FAULT_START] - length) / interval - 1e-6);
    const int count = (int)(length / interval + 0.5);
    const int at = (int)(floor(time / interval + 0.5) - first);
    double *m = faults->memory, slope;

    if (m[FM_RECORDED] != k + 1.0 && history_settled(history, p[FAULT_START])) {
        for (int i = 0; i < count; ++i)
            if (history_at(history, (first + i) * interval, &m[FM_RECORD + i], &slope) != 0) return 1;
        m[FM_RECORDED] = k + 1.0;
    }
    if (m[FM_RECORDED] != k + 1.0) return history_at(history, time, value, &slope);
    *value = m[FM_RECORD + (at < 0 ? 0 : at < count ? at : count - 1)];
    return 0;
}

/* A value that stays is remembered: the history forgets it. */
static int remembered(const SignalFaults *faults, const History *history, double time, double *value)
{
    double *m = faults->memory, slope;

    if (m[FM_KNOWN] != 0.0 && m[FM_TIME] == time) {
        *value = m[FM_VALUE];
        return 0;
    }
    if (history_at(history, time, value, &slope) != 0) return 1;
    if (history_settled(history, time)) {
        m[FM_KNOWN] = 1.0;
        m[FM_TIME] = time;
        m[FM_VALUE] = *value;
    }
    return 0;
}

size_t signal_fault_source(const SignalFaults *faults, double s, size_t own)
{
    const int k = active(faults, s);

    return k >= 0 && faults->kind[k] == FAULT_SWAP ? (size_t)faults->p[FAULT_REALS * k + FAULT_SIZE] - 1 : own;
}

int signal_fault_value(const SignalFaults *faults, const History *history, double s, double *value, double *slope)
{
    const int k = active(faults, s);
    double true_value = 0.0, true_slope = 0.0;
    int gone;
    Sent sent;

    if (k < 0) return history_at(history, s, value, slope);
    sent = sent_at(faults, k, s);
    if (faults->kind[k] == FAULT_STUCK) gone = remembered(faults, history, sent.time, &true_value);
    else if (faults->kind[k] == FAULT_REPLAY) gone = replayed(faults, history, k, sent.time, &true_value);
    else gone = history_at(history, sent.time, &true_value, &true_slope);
    *value = sent.gain * true_value + sent.offset;
    *slope = sent.gain * true_slope * sent.time_rate + sent.offset_slope;
    return gone;
}

double signal_fault_weight(const SignalFaults *faults, const History *history, double s, double t, int order)
{
    const int k = active(faults, s);
    Sent sent;

    if (k < 0) return history_weight(history, s, t, order);
    sent = sent_at(faults, k, s);
    return sent.gain * history_weight(history, sent.time, t, order);
}
