/* Three devices as they were written by hand before they were files (dc1, st1a, tgov1), beside what
 * models/devices/emit.py makes of their files, for bench_devices.py. Compiled together with the
 * plant's sources, with the flags of the FMU. */
#include <stdlib.h>
#include <string.h>
#include <time.h>

#include "devices.h"
#include "processor.h"
#include "tiles.h"

#pragma GCC visibility push(default)

static double lag(double u, double T, const double **x, double **dx)
{
    if (!(T > 0.0)) return u;
    const double state = *(*x)++;
    *(*dx)++ = (u - state) / T;
    return state;
}

static double lead_lag(double u, double T1, double T2, const double **x, double **dx)
{
    if (!(T2 > 0.0)) return u;
    const double state = *(*x)++;
    *(*dx)++ = (u - state) / T2;
    return state + (u - state) * (T1 / T2);
}

static double limited_lag(double u, double T, double low, double high, const double **x, double **dx)
{
    const int lags = T > 0.0;
    const double state = lags ? *(*x)++ : u;
    const int above = (u > high) & (state >= high), below = (low > u) & (low >= state);
    if (lags) *(*dx)++ = ((above ? high : below ? low : u) - state) / T;
    return low > state ? low : state > high ? high : state;
}

static double plain_dc1(const double *p, size_t n, double vt, double signal, const double *x, double *dx)
{
    const size_t before = (p[DC1__TR * n] > 0.0 ? 1u : 0u) + (p[DC1__TB * n] > 0.0 ? 1u : 0u)
                        + (p[DC1__TA * n] > 0.0 ? 1u : 0u);
    const double efd = x[before], slow = x[before + 1];
    const double feedback = p[DC1__KF * n] / p[DC1__TF * n] * (efd - slow);
    const double loss = p[DC1__KE * n] + p[DC1__Aex * n] * real_exp(p[DC1__Bex * n] * efd);

    const double v = lag(vt, p[DC1__TR * n], &x, &dx);
    const double e = p[DC1__vref * n] + signal - v - feedback;
    const double y = lead_lag(e, p[DC1__TC * n], p[DC1__TB * n], &x, &dx);
    const double r = limited_lag(p[DC1__KA * n] * y, p[DC1__TA * n], p[DC1__VRmin * n],
                                 p[DC1__VRmax * n], &x, &dx);
    dx[0] = (r - loss * efd) / p[DC1__TE * n];
    dx[1] = (efd - slow) / p[DC1__TF * n];
    return efd;
}

static double plain_st1a(const double *p, size_t n, double vt, double ifd, double signal,
                         const double *x, double *dx)
{
    const double v = lag(vt, p[ST1A__TR * n], &x, &dx);
    const double e = p[ST1A__vref * n] + signal - v;
    const double y = lead_lag(e, p[ST1A__TC * n], p[ST1A__TB * n], &x, &dx);
    const double low = vt * p[ST1A__VRmin * n], drooped = vt * p[ST1A__VRmax * n] - p[ST1A__KC * n] * ifd;
    return limited_lag(p[ST1A__KA * n] * y, p[ST1A__TA * n], low, low > drooped ? low : drooped, &x, &dx);
}

static double plain_tgov1(const double *p, size_t n, double pref, double slip, const double *x, double *dx)
{
    const double valve = limited_lag(pref - slip / p[TGOV1__R * n], p[TGOV1__T1 * n], p[TGOV1__Vmin * n],
                                     p[TGOV1__Vmax * n], &x, &dx);
    const double power = lead_lag(valve, p[TGOV1__T2 * n], p[TGOV1__T3 * n], &x, &dx);
    return power - p[TGOV1__Dt * n] * slip;
}

/* What is evaluated: `count` machines with one device each, states of a device one after the other by
 * hand, quantity by quantity as generated. */
typedef struct {
    size_t device, n, states, rows;
    uint64_t has;
    double *machine, *table, *x, *turned, *dx, *vt, *vs, *slip, *ifd, *step, *number;
} Bench;

static double *room(size_t n) { return calloc(n + 1, sizeof(double)); }

/* Device `which` of dc1, st1a, tgov1 at `n` machines: its parameters in the order of its file, its states. */
void *devices_open(size_t which, size_t n, size_t number, size_t states, uint64_t has,
                   const double *parameters, const double *x)
{
    static const size_t devices[] = { DEVICE_NUMBER_DC1, DEVICE_NUMBER_ST1A, DEVICE_NUMBER_TGOV1 };
    const size_t device = devices[which];
    Bench *b = calloc(1, sizeof *b);
    if (b == NULL) return NULL;
    b->device = device, b->n = n, b->states = states, b->has = has, b->rows = device_rows(device);
    b->table = room(b->rows * n), b->machine = room(n);
    b->x = room(states * n), b->turned = room(states * n), b->dx = room(states * n);
    b->vt = room(n), b->vs = room(n), b->slip = room(n), b->ifd = room(n), b->step = room(n), b->number = room(n);
    for (size_t k = 0; k < n; ++k) {
        const double off = 1.0 + 1e-3 * (double)(k % 7);   /* neighbours differ */
        b->machine[k] = (double)k, b->vt[k] = 1.02 * off, b->ifd[k] = 1.8 * off, b->slip[k] = 1e-3 * off;
        for (size_t i = 0; i < number; ++i) b->table[i * n + k] = parameters[i];
        for (size_t i = 0; i < states; ++i) b->x[k * states + i] = b->turned[i * n + k] = x[i] * off;
    }
    device_prepare(device, b->table, n);
    return b;
}

static void by_hand(const Bench *b)
{
    for (size_t k = 0; k < b->n; ++k) {
        const double *p = b->table + k, *x = b->x + k * b->states;
        double *dx = b->dx + k * b->states;
        b->number[k] = b->device == DEVICE_NUMBER_DC1  ? plain_dc1(p, b->n, b->vt[k], b->vs[k], x, dx)
                    : b->device == DEVICE_NUMBER_ST1A ? plain_st1a(p, b->n, b->vt[k], b->ifd[k], b->vs[k], x, dx)
                    : plain_tgov1(p, b->n, p[TGOV1__pref * b->n] + b->step[k], b->slip[k], x, dx);
    }
}

static void generated(const Bench *b, size_t lanes)
{
    const DeviceGroup g = { b->table, b->machine, b->n, b->has, NO_NOTES };
    const DeviceSignals in = { .vt = b->vt, .vc = b->vt, .vs = b->vs, .slip = b->slip, .ifd = b->ifd,
                               .pref_step = b->step, .pm = b->number, .efd = b->number };
    TILED(device_run, lanes, b->n, b->device, &g, &in, b->turned, b->dx);
}

/* CPU ns a device in `rounds` evaluations by hand, or generated for one device at a time or for as many as
 * the processor does together, as the plant does it; `rates`: what each gives and its states' rates. */
double devices_ns(void *bench, int hand, int together, long rounds, double *rates)
{
    const Bench *b = bench;
    const size_t lanes = together ? processor_lanes() : 1;
    const clock_t begin = clock();
    for (long i = 0; i < rounds; ++i) {
        b->vs[i % (long)b->n] = 1e-9 * (double)i;   /* or nothing would have to be done again */
        if (hand) by_hand(b);
        else generated(b, lanes);
    }
    const double spent = (double)(clock() - begin) / CLOCKS_PER_SEC;
    for (size_t k = 0; k < b->n; ++k) {
        *rates++ = b->number[k];
        for (size_t i = 0; i < b->states; ++i) *rates++ = hand ? b->dx[k * b->states + i] : b->dx[i * b->n + k];
    }
    return 1e9 * spent / ((double)rounds * (double)b->n);
}
