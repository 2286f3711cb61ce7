/* A first-order lag as an IEEE/CIGRE DLL, written apart from the package's own, with one defect that DEFECT chooses. */
#include <math.h>
#include <stdint.h>
#include <stdlib.h>

enum {
    NONE, PACKED, NAME, RANGE, GLOBAL, CALLS, TIME_BACK, NOT_A_NUMBER, NO_TERMINATE, LEAK, BITS, SHARED_TEXT,
    OUTSIDE_STATES, WRITES_TIME, BEYOND_STATES, CRASH, CRASH_ON_LOAD, NO_PARAMETERS, LEAK_STEP, HANG
};

typedef struct { const char *name, *description, *unit; int type; int32_t width; } Signal;
typedef union { double real; int32_t whole; } Value;
typedef struct {
    const char *name, *group, *description, *unit;
    int type;
    int32_t fixed;
    Value start, min, max;
} Parameter;
typedef struct {
    uint8_t version[4];
    const char *text[10];
    double step;
    uint8_t mode;
    int32_t n_in;
    const Signal *in;
    int32_t n_out;
    const Signal *out;
    int32_t n_parameters;
    const Parameter *parameters;
    int32_t n_int, n_float, n_double;
} Info;
typedef struct {
    double *in, *out;
    void *parameters;
    double time;
    uint8_t mode;
    const char *error, *message;
    int32_t *ints;
    float *floats;
    double *x;              /* state, time of the last call, what is left of a text */
} Instance;

#pragma pack(push, 1)
typedef struct { int32_t way; double rate; } Packed;
#pragma pack(pop)
typedef struct { int32_t way; double rate; } Natural;

static const Signal in[] = {{DEFECT == NAME ? "speed of G1" : "u", "Input", "pu", 9, 1}};
static const Signal out[] = {{"y", "Output", "pu", 9, 1}};
static const Parameter parameters[] = {
    {"way", "", "Which sign", "1", 6, 0, {.whole = 1}, {.whole = 0}, {.whole = 1}},
    {"rate", "", "Rate", "1/s", 9, 0, {.real = 2.0}, {.real = DEFECT == RANGE ? 3.0 : 0.0}, {.real = 10.0}},
};
static const Info info = {{1, 1, 0, 0}, {"lag", "1"}, 0.01, 3, 1, in, 1, out, DEFECT == NO_PARAMETERS ? 0 : 2, parameters,
                          0, 0, 3};
static double global, held[64];
static char text[100];
void *volatile taken;

#ifdef IS_CRASH_ON_LOAD
__attribute__((constructor)) static void load(void) { abort(); }
#endif

static double rate_of(const Instance *c)
{
    if (DEFECT == NO_PARAMETERS) return 2.0;
    return DEFECT == PACKED ? ((const Packed *)c->parameters)->rate : ((const Natural *)c->parameters)->rate;
}

static double *place(Instance *c)
{
    if (DEFECT == GLOBAL) return &global;
    if (DEFECT == OUTSIDE_STATES) return &held[((uintptr_t)c >> 4) % 64];   /* of each instance, not in its states */
    return c->x;
}

static int say(Instance *c)
{
    c->error = c->message = DEFECT == SHARED_TEXT ? text : "";
    return 0;
}

const Info *Model_GetInfo(void) { return &info; }

int Model_FirstCall(Instance *c)
{
    if (DEFECT == LEAK) taken = malloc(200);
    return say(c);
}

int Model_CheckParameters(Instance *c) { return say(c); }

int Model_Initialize(Instance *c)
{
    if (DEFECT == CALLS) *place(c) += 0.01 + 0.0 * (c->x[1] = 0.0);
    else *place(c) = 0.0;
    if (DEFECT != TIME_BACK) c->x[1] = c->time;
    return say(c);
}

int Model_Outputs(Instance *c)
{
    *place(c) += fmin(rate_of(c) * (c->time - c->x[1]), 1.0) * (c->in[0] - *place(c));
    c->out[0] = *place(c);
    c->x[1] = c->time;
    if (DEFECT == NOT_A_NUMBER) c->out[0] = sqrt(c->out[0] < 0.3 ? c->out[0] : -1.0);
    if (DEFECT == WRITES_TIME) c->time -= 0.01;
    if (DEFECT == BEYOND_STATES) c->x[3] = 1.0;
    if (DEFECT == LEAK_STEP) taken = malloc(50);
    if (DEFECT == CRASH) abort();
    if (DEFECT == HANG) for (;;) global += 1.0;
    return say(c);
}

#ifndef IS_NO_TERMINATE
int Model_Terminate(Instance *c) { return say(c); }
#endif
