/* An integrator dx/dt = u, y = x, FMI 2.0 co-simulation, that does on demand what no FMU should or few do:
 * return early from a step, refuse long steps, ask to end, give NaN, abort, hang, warn, tolerate no other instance
 * in its process. All times in s, 1e30 = never. */
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "fmi2Functions.h"

enum { U, Y, EARLY_AT, KICK, LONGEST, END_AT, NAN_AT, ABORT_AT, BACK_AT, HANG_AT, WARN_AT, ALONE, X0, COUNT };
static int alive; /* instances in this process */

typedef struct {
    double v[COUNT], du[3], t, last;
    int ended, kicked;
    fmi2CallbackFunctions call;
} Whims;

const char *fmi2GetTypesPlatform(void) { return fmi2TypesPlatform; }
const char *fmi2GetVersion(void) { return fmi2Version; }

fmi2Component fmi2Instantiate(fmi2String name, fmi2Type type, fmi2String guid, fmi2String resources,
                              const fmi2CallbackFunctions *call, fmi2Boolean visible, fmi2Boolean logging)
{
    Whims *m = calloc(1, sizeof *m);
    (void)name, (void)guid, (void)resources, (void)visible, (void)logging;
    if (m == NULL || type != fmi2CoSimulation) return NULL;
    ++alive;
    m->call = *call;
    for (int k = EARLY_AT; k < X0; ++k) m->v[k] = 1e30;
    m->v[KICK] = 0.0;
    return m;
}

void fmi2FreeInstance(fmi2Component c)
{
    --alive;
    free(c);
}
fmi2Status fmi2SetDebugLogging(fmi2Component c, fmi2Boolean on, size_t n, const fmi2String names[])
{
    (void)c, (void)on, (void)n, (void)names;
    return fmi2OK;
}
fmi2Status fmi2SetupExperiment(fmi2Component c, fmi2Boolean has, fmi2Real tolerance, fmi2Real start,
                               fmi2Boolean ends, fmi2Real stop)
{
    (void)has, (void)tolerance, (void)ends, (void)stop;
    ((Whims *)c)->t = ((Whims *)c)->last = start;
    return fmi2OK;
}
fmi2Status fmi2EnterInitializationMode(fmi2Component c) { (void)c; return fmi2OK; }
fmi2Status fmi2ExitInitializationMode(fmi2Component c)
{
    Whims *m = c;
    m->v[Y] = m->v[X0];
    if (m->v[ALONE] < 1e30 && alive > 1) {
        m->call.logger(m->call.componentEnvironment, "misbehaving", fmi2Error, "logStatusError", "%d instances", alive);
        return fmi2Error;
    }
    return fmi2OK;
}
fmi2Status fmi2Terminate(fmi2Component c) { (void)c; return fmi2OK; }
fmi2Status fmi2Reset(fmi2Component c)
{
    Whims *m = c;
    const fmi2CallbackFunctions call = m->call;
    memset(m, 0, sizeof *m);
    m->call = call;
    for (int k = EARLY_AT; k < X0; ++k) m->v[k] = 1e30;
    m->v[KICK] = 0.0;
    return fmi2OK;
}

fmi2Status fmi2GetReal(fmi2Component c, const fmi2ValueReference r[], size_t n, fmi2Real value[])
{
    for (size_t k = 0; k < n; ++k) value[k] = ((Whims *)c)->v[r[k]];
    return fmi2OK;
}
fmi2Status fmi2SetReal(fmi2Component c, const fmi2ValueReference r[], size_t n, const fmi2Real value[])
{
    for (size_t k = 0; k < n; ++k) {
        ((Whims *)c)->v[r[k]] = value[k];
        if (r[k] == X0) ((Whims *)c)->v[Y] = value[k];
        if (r[k] == U) memset(((Whims *)c)->du, 0, sizeof ((Whims *)c)->du);
    }
    return fmi2OK;
}
fmi2Status fmi2SetRealInputDerivatives(fmi2Component c, const fmi2ValueReference r[], size_t n,
                                       const fmi2Integer order[], const fmi2Real value[])
{
    (void)r;
    for (size_t k = 0; k < n; ++k) ((Whims *)c)->du[order[k] - 1] = value[k];
    return fmi2OK;
}
fmi2Status fmi2GetRealOutputDerivatives(fmi2Component c, const fmi2ValueReference r[], size_t n,
                                        const fmi2Integer order[], fmi2Real value[])
{
    (void)r, (void)order;
    for (size_t k = 0; k < n; ++k) value[k] = ((Whims *)c)->v[U];
    return fmi2OK;
}

static void integrate(Whims *m, double to)
{
    const double h = to - m->t, u = m->v[U], *d = m->du;
    m->v[Y] += h * (u + h / 2 * (d[0] + h / 3 * (d[1] + h / 4 * d[2])));
    m->v[U] = u + h * (d[0] + h / 2 * (d[1] + h / 3 * d[2]));
    m->du[0] = d[0] + h * (d[1] + h / 2 * d[2]);
    m->du[1] = d[1] + h * d[2];
    m->t = m->last = to;
}

fmi2Status fmi2DoStep(fmi2Component c, fmi2Real t, fmi2Real h, fmi2Boolean no_set)
{
    Whims *m = c;
    const double *v = m->v, end = t + h;
    (void)no_set;

    if (v[ABORT_AT] < end) {
        m->call.logger(m->call.componentEnvironment, "misbehaving", fmi2Error, "logStatusError", "about to abort");
        abort();
    }
    while (v[HANG_AT] < end) {
        /* a memory barrier of sorts: the compiler must not assume that this ends */
        *(volatile double *)&m->last = t;
    }
    if (v[BACK_AT] < end) {
        m->last = t - 1.0;
        return fmi2Discard;
    }
    if (h > v[LONGEST]) {
        m->last = t;
        return fmi2Discard;
    }
    if (v[END_AT] < end) {
        integrate(m, v[END_AT]);
        m->ended = 1;
        return fmi2Discard;
    }
    if (!m->kicked && v[EARLY_AT] < end) {
        integrate(m, v[EARLY_AT]);
        m->v[Y] += v[KICK];
        m->kicked = 1;
        return fmi2Discard;
    }
    integrate(m, end);
    if (v[NAN_AT] < end) m->v[Y] = NAN;
    if (v[WARN_AT] < end) {
        m->call.logger(m->call.componentEnvironment, "misbehaving", fmi2Warning, "logStatusWarning",
                       "u = %.2f is odd at 100%% load", m->v[U]);
        return fmi2Warning;
    }
    return fmi2OK;
}

fmi2Status fmi2GetRealStatus(fmi2Component c, const fmi2StatusKind kind, fmi2Real *value)
{
    if (kind != fmi2LastSuccessfulTime) return fmi2Discard;
    *value = ((Whims *)c)->last;
    return fmi2OK;
}
fmi2Status fmi2GetBooleanStatus(fmi2Component c, const fmi2StatusKind kind, fmi2Boolean *value)
{
    if (kind != fmi2Terminated) return fmi2Discard;
    *value = ((Whims *)c)->ended;
    return fmi2OK;
}

fmi2Status fmi2GetFMUstate(fmi2Component c, fmi2FMUstate *state)
{
    if (*state == NULL && (*state = malloc(sizeof(Whims))) == NULL) return fmi2Error;
    memcpy(*state, c, sizeof(Whims));
    return fmi2OK;
}
fmi2Status fmi2SetFMUstate(fmi2Component c, fmi2FMUstate state)
{
    memcpy(c, state, sizeof(Whims));
    return fmi2OK;
}
fmi2Status fmi2FreeFMUstate(fmi2Component c, fmi2FMUstate *state)
{
    (void)c;
    free(*state);
    *state = NULL;
    return fmi2OK;
}

/* The standard asks for every function; this FMU has no use for these. */
fmi2Status fmi2GetInteger(fmi2Component c, const fmi2ValueReference r[], size_t n, fmi2Integer v[])
{
    (void)c, (void)r, (void)n, (void)v;
    return fmi2Error;
}
fmi2Status fmi2GetBoolean(fmi2Component c, const fmi2ValueReference r[], size_t n, fmi2Boolean v[])
{
    (void)c, (void)r, (void)n, (void)v;
    return fmi2Error;
}
fmi2Status fmi2GetString(fmi2Component c, const fmi2ValueReference r[], size_t n, fmi2String v[])
{
    (void)c, (void)r, (void)n, (void)v;
    return fmi2Error;
}
fmi2Status fmi2SetInteger(fmi2Component c, const fmi2ValueReference r[], size_t n, const fmi2Integer v[])
{
    (void)c, (void)r, (void)n, (void)v;
    return fmi2Error;
}
fmi2Status fmi2SetBoolean(fmi2Component c, const fmi2ValueReference r[], size_t n, const fmi2Boolean v[])
{
    (void)c, (void)r, (void)n, (void)v;
    return fmi2Error;
}
fmi2Status fmi2SetString(fmi2Component c, const fmi2ValueReference r[], size_t n, const fmi2String v[])
{
    (void)c, (void)r, (void)n, (void)v;
    return fmi2Error;
}
fmi2Status fmi2SerializedFMUstateSize(fmi2Component c, fmi2FMUstate s, size_t *n)
{
    (void)c, (void)s, (void)n;
    return fmi2Error;
}
fmi2Status fmi2SerializeFMUstate(fmi2Component c, fmi2FMUstate s, fmi2Byte b[], size_t n)
{
    (void)c, (void)s, (void)b, (void)n;
    return fmi2Error;
}
fmi2Status fmi2DeSerializeFMUstate(fmi2Component c, const fmi2Byte b[], size_t n, fmi2FMUstate *s)
{
    (void)c, (void)b, (void)n, (void)s;
    return fmi2Error;
}
fmi2Status fmi2GetDirectionalDerivative(fmi2Component c, const fmi2ValueReference u[], size_t n, const fmi2ValueReference k[], size_t m,
                                    const fmi2Real dk[], fmi2Real du[])
{
    (void)c, (void)u, (void)n, (void)k, (void)m, (void)dk, (void)du;
    return fmi2Error;
}
fmi2Status fmi2CancelStep(fmi2Component c)
{
    (void)c;
    return fmi2Error;
}
fmi2Status fmi2GetStatus(fmi2Component c, const fmi2StatusKind k, fmi2Status *v)
{
    (void)c, (void)k, (void)v;
    return fmi2Error;
}
fmi2Status fmi2GetIntegerStatus(fmi2Component c, const fmi2StatusKind k, fmi2Integer *v)
{
    (void)c, (void)k, (void)v;
    return fmi2Error;
}
fmi2Status fmi2GetStringStatus(fmi2Component c, const fmi2StatusKind k, fmi2String *v)
{
    (void)c, (void)k, (void)v;
    return fmi2Error;
}
