/* The least FMI 2.0 co-simulation FMU that does something: dx/dt = u - x, y = x.
 * One Euler step per doStep with the input at its middle; input derivatives,
 * output slopes and states are offered. Nothing is checked: what is timed is
 * the master. */
#include <stdlib.h>

#include "fmi2Functions.h"

enum { X, U, Y, SLOPE, COUNT }; /* value references of u and y are U and Y */

typedef struct {
    double v[COUNT];
    double du[4];
} Instance;

const char *fmi2GetTypesPlatform(void) { return fmi2TypesPlatform; }
const char *fmi2GetVersion(void) { return fmi2Version; }

fmi2Component fmi2Instantiate(fmi2String name, fmi2Type type, fmi2String guid, fmi2String location,
                              const fmi2CallbackFunctions *callbacks, fmi2Boolean visible, fmi2Boolean logging)
{
    Instance *c = calloc(1, sizeof *c);

    (void)name, (void)type, (void)guid, (void)location, (void)callbacks, (void)visible, (void)logging;
    if (c != NULL) c->v[X] = c->v[Y] = 1.0;
    return c;
}

void fmi2FreeInstance(fmi2Component c) { free(c); }

fmi2Status fmi2Reset(fmi2Component component)
{
    Instance *c = component;
    const Instance fresh = {{1.0, 0.0, 1.0, 0.0}, {0.0}};

    *c = fresh;
    return fmi2OK;
}

fmi2Status fmi2SetupExperiment(fmi2Component c, fmi2Boolean t, fmi2Real e, fmi2Real a, fmi2Boolean s, fmi2Real b)
{
    (void)c, (void)t, (void)e, (void)a, (void)s, (void)b;
    return fmi2OK;
}

fmi2Status fmi2EnterInitializationMode(fmi2Component c) { return c != NULL ? fmi2OK : fmi2Error; }
fmi2Status fmi2ExitInitializationMode(fmi2Component c) { return c != NULL ? fmi2OK : fmi2Error; }
fmi2Status fmi2Terminate(fmi2Component c) { return c != NULL ? fmi2OK : fmi2Error; }

fmi2Status fmi2SetReal(fmi2Component component, const fmi2ValueReference r[], size_t n, const fmi2Real values[])
{
    Instance *c = component;

    for (size_t i = 0; i < n; ++i) c->v[r[i]] = values[i];
    return fmi2OK;
}

fmi2Status fmi2GetReal(fmi2Component component, const fmi2ValueReference r[], size_t n, fmi2Real values[])
{
    const Instance *c = component;

    for (size_t i = 0; i < n; ++i) values[i] = c->v[r[i]];
    return fmi2OK;
}

fmi2Status fmi2SetRealInputDerivatives(fmi2Component component, const fmi2ValueReference r[], size_t n,
                                       const fmi2Integer order[], const fmi2Real values[])
{
    Instance *c = component;

    (void)r;
    for (size_t i = 0; i < n; ++i) c->du[order[i]] = values[i];
    return fmi2OK;
}

fmi2Status fmi2GetRealOutputDerivatives(fmi2Component component, const fmi2ValueReference r[], size_t n,
                                        const fmi2Integer order[], fmi2Real values[])
{
    const Instance *c = component;

    (void)r, (void)order;
    for (size_t i = 0; i < n; ++i) values[i] = c->v[SLOPE];
    return fmi2OK;
}

fmi2Status fmi2DoStep(fmi2Component component, fmi2Real time, fmi2Real h, fmi2Boolean no_set_state_prior)
{
    Instance *c = component;
    const double middle = 0.5 * h;

    (void)time, (void)no_set_state_prior;
    c->v[SLOPE] = c->v[U] + middle * (c->du[1] + middle * (0.5 * c->du[2] + middle * c->du[3] / 6.0)) - c->v[X];
    c->v[X] += h * c->v[SLOPE];
    c->v[Y] = c->v[X];
    c->du[1] = c->du[2] = c->du[3] = 0.0;
    return fmi2OK;
}

fmi2Status fmi2GetFMUstate(fmi2Component component, fmi2FMUstate *state)
{
    if (*state == NULL) *state = malloc(sizeof(Instance));
    if (*state == NULL) return fmi2Error;
    *(Instance *)*state = *(const Instance *)component;
    return fmi2OK;
}

fmi2Status fmi2SetFMUstate(fmi2Component component, fmi2FMUstate state)
{
    *(Instance *)component = *(const Instance *)state;
    return fmi2OK;
}

fmi2Status fmi2FreeFMUstate(fmi2Component component, fmi2FMUstate *state)
{
    (void)component;
    free(*state);
    *state = NULL;
    return fmi2OK;
}

/* What a loader looks for and no master of a chain calls. */
fmi2Status fmi2SetDebugLogging(fmi2Component c, fmi2Boolean on, size_t n, const fmi2String k[])
{ (void)c, (void)on, (void)n, (void)k; return fmi2OK; }
fmi2Status fmi2GetInteger(fmi2Component c, const fmi2ValueReference r[], size_t n, fmi2Integer v[])
{ (void)c, (void)r, (void)v; return n == 0 ? fmi2OK : fmi2Error; }
fmi2Status fmi2GetBoolean(fmi2Component c, const fmi2ValueReference r[], size_t n, fmi2Boolean v[])
{ (void)c, (void)r, (void)v; return n == 0 ? fmi2OK : fmi2Error; }
fmi2Status fmi2GetString(fmi2Component c, const fmi2ValueReference r[], size_t n, fmi2String v[])
{ (void)c, (void)r, (void)v; return n == 0 ? fmi2OK : fmi2Error; }
fmi2Status fmi2SetInteger(fmi2Component c, const fmi2ValueReference r[], size_t n, const fmi2Integer v[])
{ (void)c, (void)r, (void)v; return n == 0 ? fmi2OK : fmi2Error; }
fmi2Status fmi2SetBoolean(fmi2Component c, const fmi2ValueReference r[], size_t n, const fmi2Boolean v[])
{ (void)c, (void)r, (void)v; return n == 0 ? fmi2OK : fmi2Error; }
fmi2Status fmi2SetString(fmi2Component c, const fmi2ValueReference r[], size_t n, const fmi2String v[])
{ (void)c, (void)r, (void)v; return n == 0 ? fmi2OK : fmi2Error; }
fmi2Status fmi2SerializedFMUstateSize(fmi2Component c, fmi2FMUstate s, size_t *n)
{ (void)c, (void)s, (void)n; return fmi2Error; }
fmi2Status fmi2SerializeFMUstate(fmi2Component c, fmi2FMUstate s, fmi2Byte b[], size_t n)
{ (void)c, (void)s, (void)b, (void)n; return fmi2Error; }
fmi2Status fmi2DeSerializeFMUstate(fmi2Component c, const fmi2Byte b[], size_t n, fmi2FMUstate *s)
{ (void)c, (void)b, (void)n, (void)s; return fmi2Error; }
fmi2Status fmi2GetDirectionalDerivative(fmi2Component c, const fmi2ValueReference a[], size_t n,
                                        const fmi2ValueReference b[], size_t m, const fmi2Real v[], fmi2Real w[])
{ (void)c, (void)a, (void)n, (void)b, (void)m, (void)v, (void)w; return fmi2Error; }
fmi2Status fmi2CancelStep(fmi2Component c) { (void)c; return fmi2Error; }
fmi2Status fmi2GetStatus(fmi2Component c, const fmi2StatusKind k, fmi2Status *v)
{ (void)c, (void)k, (void)v; return fmi2Discard; }
fmi2Status fmi2GetRealStatus(fmi2Component c, const fmi2StatusKind k, fmi2Real *v)
{ (void)c, (void)k, (void)v; return fmi2Discard; }
fmi2Status fmi2GetIntegerStatus(fmi2Component c, const fmi2StatusKind k, fmi2Integer *v)
{ (void)c, (void)k, (void)v; return fmi2Discard; }
fmi2Status fmi2GetBooleanStatus(fmi2Component c, const fmi2StatusKind k, fmi2Boolean *v)
{ (void)c, (void)k, (void)v; return fmi2Discard; }
fmi2Status fmi2GetStringStatus(fmi2Component c, const fmi2StatusKind k, fmi2String *v)
{ (void)c, (void)k, (void)v; return fmi2Discard; }
