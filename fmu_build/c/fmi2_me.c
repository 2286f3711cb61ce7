/* Model exchange. The importer integrates; time events are announced exactly. */
#include <math.h>
#include <string.h>

#include "instance.h"
#include "solver.h"

fmi2Status fmi2EnterEventMode(fmi2Component component)
{
    Instance *c = component;

    if (!instance_allowed(c, MODE_CONTINUOUS, "fmi2EnterEventMode")) return fmi2Error;
    c->run->mode = MODE_EVENT;
    return fmi2OK;
}

fmi2Status fmi2NewDiscreteStates(fmi2Component component, fmi2EventInfo *info)
{
    static const char call[] = "fmi2NewDiscreteStates";
    Instance *c = component;
    RunState *run;
    Block *b;
    double next;
    int changed = 0;

    if (!instance_allowed(c, MODE_EVENT, call)) return fmi2Error;
    if (info == NULL) return instance_report(c, fmi2Error, call, "eventInfo is null");
    run = c->run;
    b = &c->block;
    /* Integrators stop a rounding error before or after the time they were told. */
    const double reached = run->time + 1e-12 * (1.0 + fabs(run->time));
    for (long n = 0; (next = block_next_event(b, run->last_event)) <= reached; ++n) {
        BlockMessage message = {{0}};
        const BlockStatus status = next > run->last_event && n < SOLVER_MAX_SUBSTEPS
                                       ? block_event(b, next, b->x, &message) : BLOCK_ERROR;
        if (status != BLOCK_OK) return instance_report_block(c, BLOCK_ERROR, call, &message);
        instance_log_event(c, "event at time %.9g s", next);
        instance_remark(c, &message);
        run->last_event = next;
        changed = 1;
    }
    if (changed) run->outputs_fresh = run->derivatives_fresh = 0;
    if (run->indicated) {
        const fmi2Status status = instance_decide(c, call);
        if (status != fmi2OK) return status;
        changed = 1;
    }
    info->newDiscreteStatesNeeded = fmi2False;
    info->terminateSimulation = fmi2False;
    info->nominalsOfContinuousStatesChanged = fmi2False;
    info->valuesOfContinuousStatesChanged = changed && b->layout.n_x > 0 ? fmi2True : fmi2False;
    info->nextEventTimeDefined = isfinite(next) ? fmi2True : fmi2False;
    info->nextEventTime = isfinite(next) ? next : 0.0;
    return fmi2OK;
}

fmi2Status fmi2EnterContinuousTimeMode(fmi2Component component)
{
    Instance *c = component;

    if (!instance_allowed(c, MODE_EVENT, "fmi2EnterContinuousTimeMode")) return fmi2Error;
    c->run->mode = MODE_CONTINUOUS;
    return fmi2OK;
}

fmi2Status fmi2CompletedIntegratorStep(fmi2Component component, fmi2Boolean no_set_state_prior,
                                       fmi2Boolean *enter_event_mode, fmi2Boolean *terminate)
{
    static const char call[] = "fmi2CompletedIntegratorStep";
    Instance *c = component;

    (void)no_set_state_prior;
    if (!instance_allowed(c, MODE_CONTINUOUS, call)) return fmi2Error;
    if (enter_event_mode == NULL || terminate == NULL)
        return instance_report(c, fmi2Error, call, "a null pointer was given");
    *enter_event_mode = fmi2False;
    *terminate = fmi2False;
    return instance_check_finite(c, call);
}

fmi2Status fmi2SetTime(fmi2Component component, fmi2Real time)
{
    static const char call[] = "fmi2SetTime";
    Instance *c = component;

    if (!instance_allowed(c, MODE_EVENT | MODE_CONTINUOUS, call)) return fmi2Error;
    if (!isfinite(time)) return instance_report(c, fmi2Error, call, "time %g is not finite", time);
    c->run->time = time;
    c->run->outputs_fresh = c->run->derivatives_fresh = 0;
    return fmi2OK;
}

static int vector_fits(Instance *c, const void *vector, size_t count, const char *call)
{
    if (count == c->block.layout.n_x && (vector != NULL || count == 0)) return 1;
    instance_report(c, fmi2Error, call, "a vector of %zu values was given, the block has %zu states", count,
                    c->block.layout.n_x);
    return 0;
}

fmi2Status fmi2SetContinuousStates(fmi2Component component, const fmi2Real x[], size_t count)
{
    static const char call[] = "fmi2SetContinuousStates";
    Instance *c = component;

    if (!instance_allowed(c, MODE_CONTINUOUS, call) || !vector_fits(c, x, count, call)) return fmi2Error;
    for (size_t i = 0; i < count; ++i)
        if (!isfinite(x[i]))
            return instance_report(c, fmi2Error, call, "state %s was set to %g at time %.9g s; a finite value is "
                                   "needed", instance_real_name(c, i), x[i], c->run->time);
    if (count > 0) memcpy(c->block.x, x, count * sizeof(double));
    c->run->outputs_fresh = c->run->derivatives_fresh = 0;
    return fmi2OK;
}

fmi2Status fmi2GetDerivatives(fmi2Component component, fmi2Real derivatives[], size_t count)
{
    static const char call[] = "fmi2GetDerivatives";
    Instance *c = component;
    fmi2Status status;

    if (!instance_allowed(c, MODES_READ, call) || !vector_fits(c, derivatives, count, call)) return fmi2Error;
    if (c->run->mode == MODE_INITIALIZATION && !c->run->outputs_fresh
        && (status = instance_initialise(c, call)) != fmi2OK)
        return status;
    if (c->run->mode != MODE_TERMINATED && c->run->mode != MODE_ERROR
        && (status = instance_refresh_derivatives(c, call)) != fmi2OK)
        return status;
    for (size_t i = 0; i < count; ++i) {
        derivatives[i] = c->block.dx[i];
        if (!isfinite(derivatives[i]))
            return instance_report(c, fmi2Discard, call, "at time %.9g s the derivative of %s is %g",
                                   c->run->time, instance_real_name(c, i), derivatives[i]);
    }
    return fmi2OK;
}

/* How far a decision is beyond its range before it is an event, pu or pu/s: after it, it is within. */
static const double HYSTERESIS = 1e-9;

/* Whoever asks for indicators once handles the events: from then on limiters switch in event mode only. */
static fmi2Status refresh_indicators(Instance *c, const char *call)
{
    fmi2Status status = fmi2OK;

    if (c->run->mode == MODE_INITIALIZATION && !c->run->outputs_fresh) status = instance_initialise(c, call);
    if (status == fmi2OK && !c->run->indicated) status = instance_decide(c, call);
    return status == fmi2OK ? instance_refresh_derivatives(c, call) : status;
}

fmi2Status fmi2GetEventIndicators(fmi2Component component, fmi2Real indicators[], size_t count)
{
    static const char call[] = "fmi2GetEventIndicators";
    Instance *c = component;

    if (!instance_allowed(c, MODES_READ, call)) return fmi2Error;
    if (count != c->n_indicators || (indicators == NULL && count > 0))
        return instance_report(c, fmi2Error, call, "%zu indicators were asked for, this FMU has %zu", count,
                               c->n_indicators);
    if (count > 0 && c->run->mode != MODE_TERMINATED && c->run->mode != MODE_ERROR) {
        const fmi2Status status = refresh_indicators(c, call);
        if (status != fmi2OK) return status;
    }
    for (size_t i = 0; i < count; ++i) indicators[i] = HYSTERESIS - c->overrun[i];
    return fmi2OK;
}

fmi2Status fmi2GetContinuousStates(fmi2Component component, fmi2Real x[], size_t count)
{
    static const char call[] = "fmi2GetContinuousStates";
    Instance *c = component;
    fmi2Status status;

    if (!instance_allowed(c, MODES_READ, call) || !vector_fits(c, x, count, call)) return fmi2Error;
    if (c->run->mode == MODE_INITIALIZATION && !c->run->outputs_fresh
        && (status = instance_initialise(c, call)) != fmi2OK)
        return status;
    for (size_t i = 0; i < count; ++i) {
        x[i] = c->block.x[i];
        if (!isfinite(x[i]))
            return instance_report(c, fmi2Discard, call, "at time %.9g s state %s is %g", c->run->time,
                                   instance_real_name(c, i), x[i]);
    }
    return fmi2OK;
}

fmi2Status fmi2GetNominalsOfContinuousStates(fmi2Component component, fmi2Real nominals[], size_t count)
{
    static const char call[] = "fmi2GetNominalsOfContinuousStates";
    Instance *c = component;

    if (!instance_allowed(c, MODE_INSTANTIATED | MODES_READ, call) || !vector_fits(c, nominals, count, call))
        return fmi2Error;
    if (count > 0) memcpy(nominals, c->nominal_x, count * sizeof(double));
    return fmi2OK;
}
