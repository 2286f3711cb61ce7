/* Instances stepped side by side (fmu_group.h) against twins that are stepped alone: random
 * parameters, events, inputs, steps, states put back, in changing company. After every
 * round twins have the same status, the same numbers to the bit, and have said the same. */
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "fmu_group.h"

enum { TWINS = 9, SLOT_REALS = 12, SLOT_INTEGERS = 4, EVENT_KINDS = 11, SLOTS = 8 };

typedef struct {
    uint64_t said;          /* hash of all messages */
    unsigned long lines;
} Log;

typedef struct {
    fmi2Component alone, beside;
    Log log[2];
    double time;
    fmi2FMUstate state[2];
    double state_time;
    int broken;
} Twin;

static const char *guid, *resources;
static size_t n_real, n_integer, n_x, n_u, n_y, n_w;
static uint64_t seed = 1;
static double *found[2], *slopes[2];
static fmi2ValueReference *every, *outputs, *inputs;
static fmi2Integer *first_order;

static uint64_t bits(void)
{
    seed ^= seed << 13;
    seed ^= seed >> 7;
    seed ^= seed << 17;
    return seed * UINT64_C(2685821657736338717);
}

static size_t below(size_t n) { return (size_t)(bits() >> 33) % n; }
static double unit(void) { return (double)(bits() >> 11) * 0x1p-53; }

static void fail(const char *what, size_t k)
{
    fprintf(stderr, "broken: %s (twin %zu)\n", what, k);
    abort();
}

static void listen(fmi2ComponentEnvironment environment, fmi2String name, fmi2Status status, fmi2String category,
                   fmi2String message, ...)
{
    Log *log = environment;

    (void)name;
    log->said = (log->said ^ (uint64_t)status) * UINT64_C(1099511628211);
    for (const char *s = category; *s != 0; ++s) log->said = (log->said ^ (unsigned char)*s) * UINT64_C(1099511628211);
    for (const char *s = message; *s != 0; ++s) log->said = (log->said ^ (unsigned char)*s) * UINT64_C(1099511628211);
    ++log->lines;
}

static void *give(size_t count, size_t size) { return calloc(count, size); }

static fmi2Component make(Log *log)
{
    const fmi2CallbackFunctions callbacks = {listen, give, free, NULL, log};
    return fmi2Instantiate("twin", fmi2CoSimulation, guid, resources, &callbacks, fmi2False, fmi2True);
}

static void both(Twin *t, size_t k, fmi2Status alone, fmi2Status beside, const char *what)
{
    if (alone != beside) fail(what, k);
    if (alone >= fmi2Error) t->broken = 1;
}

static void set_event(Twin *t, size_t k, size_t slot)
{
    const size_t at = n_real - SLOT_REALS * (SLOTS - slot);
    const double start = 0.05 * unit() + t->time, end = below(4) == 0 ? 1e30 : start + 0.05 * unit();
    const int kind = (int)below(EVENT_KINDS);
    const int changes = kind >= 4 && kind <= 6, wave = changes && below(3) == 0 ? 1 + (int)below(3) : 0;
    const double rise = changes && wave == 0 && below(2) == 0 ? 0.5 * (end - start < 0.1 ? end - start : 0.1) : 0.0;
    const double values[SLOT_REALS] = {start, end, 0.2 * unit() - 0.1, 0.1 * unit(), 0.0, 0.001 + 0.05 * unit(),
                                        rise, 59.99 + 0.05 * unit(), 0.01 * unit(), 0.01 * unit(), 0.01 * unit(),
                                        0.1 + 4.0 * unit()};
    const int codes[SLOT_INTEGERS] = {kind, 1 + (int)below(4), wave, (int)below(1000)};
    fmi2ValueReference real[SLOT_REALS], integer[SLOT_INTEGERS];

    for (size_t i = 0; i < SLOT_REALS; ++i) real[i] = (fmi2ValueReference)(at + i);
    for (size_t i = 0; i < SLOT_INTEGERS; ++i)
        integer[i] = (fmi2ValueReference)(n_integer - SLOT_INTEGERS * (SLOTS - slot) + i);
    both(t, k, fmi2SetReal(t->alone, real, SLOT_REALS, values), fmi2SetReal(t->beside, real, SLOT_REALS, values),
         "setting an event");
    both(t, k, fmi2SetInteger(t->alone, integer, SLOT_INTEGERS, codes),
         fmi2SetInteger(t->beside, integer, SLOT_INTEGERS, codes), "setting an event's kind");
}

static void begin(Twin *t, size_t k)
{
    t->time = 0.0;
    t->broken = 0;
    both(t, k, fmi2Reset(t->alone), fmi2Reset(t->beside), "fmi2Reset");
    both(t, k, fmi2SetupExperiment(t->alone, fmi2False, 0.0, 0.0, fmi2False, 0.0),
         fmi2SetupExperiment(t->beside, fmi2False, 0.0, 0.0, fmi2False, 0.0), "fmi2SetupExperiment");
    for (size_t i = below(4); i > 0; --i) set_event(t, k, below(SLOTS));
    if (below(12) == 0) {   /* a speed at which the sine of the angle is soon not known any more */
        const fmi2ValueReference slip = 4;
        const double fast = 1e15 * (1.0 + 9.0 * unit());
        both(t, k, fmi2SetReal(t->alone, &slip, 1, &fast), fmi2SetReal(t->beside, &slip, 1, &fast), "a speed");
    }
    both(t, k, fmi2EnterInitializationMode(t->alone), fmi2EnterInitializationMode(t->beside), "entering");
    both(t, k, fmi2ExitInitializationMode(t->alone), fmi2ExitInitializationMode(t->beside), "leaving");
}

static void send(Twin *t, size_t k)
{
    double value[64], slope[64];

    if (n_u > 64) fail("more inputs than the test has room for", k);
    for (size_t i = 0; i < n_u; ++i) {
        value[i] = 0.1 * unit() - 0.05;
        slope[i] = 2.0 * unit() - 1.0;
    }
    both(t, k, fmi2SetReal(t->alone, inputs, n_u, value), fmi2SetReal(t->beside, inputs, n_u, value), "inputs");
    if (below(3) == 0) return;
    both(t, k, fmi2SetRealInputDerivatives(t->alone, inputs, n_u, first_order, slope),
         fmi2SetRealInputDerivatives(t->beside, inputs, n_u, first_order, slope), "input slopes");
}

static void compare(Twin *t, size_t k)
{
    fmi2Component c[2] = {t->alone, t->beside};
    const size_t count = t->broken ? n_x : below(2) == 0 ? n_real : 2 * n_x + n_u + n_y;
    fmi2Status status[2];

    if (t->log[0].said != t->log[1].said || t->log[0].lines != t->log[1].lines) fail("they said something else", k);
    for (int i = 0; i < 2; ++i) status[i] = fmi2GetReal(c[i], every, count, found[i]);
    both(t, k, status[0], status[1], "fmi2GetReal");
    if (memcmp(found[0], found[1], count * sizeof(double)) != 0) fail("other numbers", k);
    if (t->broken || below(2) == 0) return;
    for (int i = 0; i < 2; ++i)
        status[i] = fmi2GetRealOutputDerivatives(c[i], outputs, n_y, first_order, slopes[i]);
    both(t, k, status[0], status[1], "fmi2GetRealOutputDerivatives");
    if (memcmp(slopes[0], slopes[1], n_y * sizeof(double)) != 0) fail("other slopes", k);
}

static void save_or_restore(Twin *t, size_t k)
{
    if (t->state[0] == NULL || below(2) == 0) {
        both(t, k, fmi2GetFMUstate(t->alone, &t->state[0]), fmi2GetFMUstate(t->beside, &t->state[1]), "saving");
        t->state_time = t->time;
        return;
    }
    both(t, k, fmi2SetFMUstate(t->alone, t->state[0]), fmi2SetFMUstate(t->beside, t->state[1]), "restoring");
    t->time = t->state_time;
}

static double some_step(void)
{
    const size_t kind = below(200);
    return kind == 0 ? -1.0 : kind == 1 ? 1e9 : kind < 60 ? 0.0001 + 0.02 * unit() : 0.01;
}

static fmi2ValueReference *references(size_t first, size_t count)
{
    fmi2ValueReference *list = malloc((count + 1) * sizeof *list);
    for (size_t i = 0; i < count; ++i) list[i] = (fmi2ValueReference)(first + i);
    return list;
}

/* Arguments: those of every driver (fuzz_build.py), then a seed, rounds and lanes. */
int main(int argc, char **argv)
{
    Twin twin[TWINS];
    unsigned long steps = 0, failed = 0, events = 0;
    void *work = NULL;
    size_t size, lanes;

    if (argc < 15) return 2;
    guid = argv[1];
    resources = argv[2];
    n_real = (size_t)atol(argv[6]);  n_integer = (size_t)atol(argv[7]);  n_x = (size_t)atol(argv[8]);
    n_u = (size_t)atol(argv[9]);     n_y = (size_t)atol(argv[10]);       n_w = (size_t)atol(argv[11]);
    seed = (uint64_t)atol(argv[12]) * 2 + 1;
    lanes = (size_t)atol(argv[14]);
    if (lanes > interarea_group_lanes()) {
        printf("%zu lanes at most\n", interarea_group_lanes());
        return 0;
    }
    every = references(0, n_real);
    inputs = references(2 * n_x, n_u);
    outputs = references(2 * n_x + n_u, n_y);
    first_order = malloc((n_u + n_y) * sizeof *first_order);
    for (size_t i = 0; i < n_u + n_y; ++i) first_order[i] = 1;
    for (int i = 0; i < 2; ++i) {
        found[i] = malloc(n_real * sizeof(double));
        slopes[i] = malloc(n_y * sizeof(double));
    }
    memset(twin, 0, sizeof twin);
    for (size_t k = 0; k < TWINS; ++k) {
        twin[k].alone = make(&twin[k].log[0]);
        twin[k].beside = make(&twin[k].log[1]);
        begin(&twin[k], k);
    }
    if (interarea_group_size(NULL, lanes) != 0 || interarea_group_size(twin[0].beside, 3) != 0) fail("size", 0);
    size = interarea_group_size(twin[0].beside, lanes);
    if (size == 0 || posix_memalign(&work, 64, size) != 0) fail("no work", 0);
    interarea_group_open(work, twin[0].beside, lanes);

    for (long round = atol(argv[13]); round > 0; --round) {
        fmi2Component c[TWINS];
        double point[TWINS], step[TWINS];
        fmi2Status status[TWINS];
        size_t who[TWINS], n = 0;
        const size_t leave_out = below(3) == 0 ? below(TWINS) : TWINS;

        for (size_t k = 0; k < TWINS; ++k) {
            Twin *t = &twin[k];
            if (t->broken && below(4) == 0) begin(t, k);
            if (below(40) == 0) begin(t, k);
            if (below(20) == 0 && !t->broken) save_or_restore(t, k);
            if (below(30) == 0) set_event(t, k, below(SLOTS));     /* refused once it runs */
            if (t->broken && below(4) != 0) continue;               /* a call that is not allowed */
            if (k == leave_out) continue;
            if (below(5) != 0) send(t, k);
            c[n] = t->beside;
            point[n] = t->time;
            step[n] = some_step();
            status[n] = fmi2DoStep(t->alone, point[n], step[n], fmi2True);
            who[n++] = k;
        }
        fmi2Status got[TWINS];
        interarea_group_step(work, n, c, point, step, (int)below(2), got);
        for (size_t i = 0; i < n; ++i) {
            Twin *t = &twin[who[i]];
            both(t, who[i], status[i], got[i], "fmi2DoStep");
            if (status[i] <= fmi2Warning) t->time += step[i];
            ++steps;
            failed += status[i] > fmi2Warning;
            compare(t, who[i]);
        }
    }
    for (size_t k = 0; k < TWINS; ++k) {
        Twin *t = &twin[k];
        events += t->log[0].lines;
        if (t->state[0] != NULL) {
            fmi2FreeFMUstate(t->alone, &t->state[0]);
            fmi2FreeFMUstate(t->beside, &t->state[1]);
        }
        fmi2FreeInstance(t->alone);
        fmi2FreeInstance(t->beside);
    }
    for (int i = 0; i < 2; ++i) {
        free(found[i]);
        free(slopes[i]);
    }
    free(every);
    free(inputs);
    free(outputs);
    free(first_order);
    free(work);
    printf("%lu steps %lu failed %lu lines\n", steps, failed, events);
    return 0;
}
