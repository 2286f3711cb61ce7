/* The call sequence that model exchange and co-simulation share, and
 * directional derivatives. */
#include <math.h>
#include <string.h>

#include "instance.h"

fmi2Status fmi2SetupExperiment(fmi2Component component, fmi2Boolean tolerance_defined, fmi2Real tolerance,
                               fmi2Real start_time, fmi2Boolean stop_time_defined, fmi2Real stop_time)
{
    static const char call[] = "fmi2SetupExperiment";
    Instance *c = component;

    /* The block's own integration has a fixed step: a tolerance changes nothing. */
    (void)tolerance_defined;
    (void)tolerance;
    if (!instance_allowed(c, MODE_INSTANTIATED, call)) return fmi2Error;
    if (!isfinite(start_time) || fabs(start_time) > 1e12)
        return instance_report(c, fmi2Error, call, "the start time %g is not usable", start_time);
    if (stop_time_defined && !(stop_time >= start_time))
        return instance_report(c, fmi2Error, call, "the stop time %g lies before the start time %g",
                               stop_time, start_time);
    c->run->start_time = c->run->time = start_time;
    c->run->stop_time = stop_time;
    c->run->stop_defined = stop_time_defined != fmi2False;
    return fmi2OK;
}

fmi2Status fmi2EnterInitializationMode(fmi2Component component)
{
    Instance *c = component;

    if (!instance_allowed(c, MODE_INSTANTIATED, "fmi2EnterInitializationMode")) return fmi2Error;
    c->run->mode = MODE_INITIALIZATION;
    c->run->outputs_fresh = c->run->derivatives_fresh = 0;
    return fmi2OK;
}

fmi2Status fmi2ExitInitializationMode(fmi2Component component)
{
    static const char call[] = "fmi2ExitInitializationMode";
    Instance *c = component;
    fmi2Status status;

    if (!instance_allowed(c, MODE_INITIALIZATION, call)) return fmi2Error;
    status = instance_initialise(c, call);
    if (status == fmi2OK) status = instance_check_finite(c, call);
    if (status != fmi2OK) return status;
    c->run->mode = c->type == fmi2ModelExchange ? MODE_EVENT : MODE_STEP_COMPLETE;
    return fmi2OK;
}

fmi2Status fmi2Terminate(fmi2Component component)
{
    Instance *c = component;

    if (!instance_allowed(c, MODES_RUNNING | MODE_STEP_FAILED, "fmi2Terminate")) return fmi2Error;
    c->run->mode = MODE_TERMINATED;
    return fmi2OK;
}

fmi2Status fmi2Reset(fmi2Component component)
{
    Instance *c = component;

    if (!instance_allowed(c, MODES_ALL, "fmi2Reset")) return fmi2Error;
    instance_reset_values(c);
    return fmi2OK;
}

static int null_passed(const void *references, const void *values, size_t count)
{
    return count > 0 && (references == NULL || values == NULL);
}

/* Puts a direction of states and inputs into v, the states first. */
static fmi2Status read_direction(Instance *c, const fmi2ValueReference knowns[], size_t n_knowns,
                                 const fmi2Real dv_known[], double *v, const char *call)
{
    const size_t n_x = c->block.layout.n_x, n_u = c->block.layout.n_u;

    memset(v, 0, (n_x + n_u) * sizeof(double));
    for (size_t i = 0; i < n_knowns; ++i) {
        const size_t r = knowns[i];
        if (!isfinite(dv_known[i]))
            return instance_report(c, fmi2Error, call, "the direction of %s is %g; a finite number is needed",
                                   instance_real_name(c, r), dv_known[i]);
        if (r < n_x) v[r] = dv_known[i];
        else if (r >= 2 * n_x && r < 2 * n_x + n_u) v[r - n_x] = dv_known[i];
        else return instance_report(c, fmi2Error, call, "%s is neither a continuous state nor a Real input",
                                    instance_real_name(c, r));
    }
    return fmi2OK;
}

static fmi2Status check_unknowns(Instance *c, const fmi2ValueReference unknowns[], size_t n_unknowns,
                                 const char *call)
{
    const size_t n_x = c->block.layout.n_x, first_y = 2 * n_x + c->block.layout.n_u;

    for (size_t i = 0; i < n_unknowns; ++i) {
        const size_t r = unknowns[i];
        if (!((r >= n_x && r < 2 * n_x) || (r >= first_y && r < first_y + c->block.layout.n_y)))
            return instance_report(c, fmi2Error, call, "%s is neither a derivative nor a Real output",
                                   instance_real_name(c, r));
    }
    return fmi2OK;
}

/* dz/dv in the direction dv, for z among derivatives and outputs and v among
 * states and inputs; exact, one pass through the block's own derivative code. */
fmi2Status fmi2GetDirectionalDerivative(fmi2Component component,
                                        const fmi2ValueReference unknowns[], size_t n_unknowns,
                                        const fmi2ValueReference knowns[], size_t n_knowns,
                                        const fmi2Real dv_known[], fmi2Real dv_unknown[])
{
    static const char call[] = "fmi2GetDirectionalDerivative";
    Instance *c = component;
    Block *b;
    BlockMessage message = {{0}};
    BlockStatus status;
    size_t n_x, n_u;
    double *vx, *vu, *vdx, *vy;

    if (!instance_allowed(c, MODES_READ & ~MODE_ERROR, call)) return fmi2Error;
    if (null_passed(unknowns, dv_unknown, n_unknowns) || null_passed(knowns, dv_known, n_knowns))
        return instance_report(c, fmi2Error, call, "a null pointer was given for an array that is not empty");
    b = &c->block;
    n_x = b->layout.n_x;
    n_u = b->layout.n_u;
    vx = c->work;
    vu = vx + n_x;
    vdx = vu + n_u;
    vy = vdx + n_x;
    if (read_direction(c, knowns, n_knowns, dv_known, vx, call) != fmi2OK
        || check_unknowns(c, unknowns, n_unknowns, call) != fmi2OK)
        return fmi2Error;
    if (c->run->mode == MODE_INITIALIZATION && !c->run->outputs_fresh
        && instance_initialise(c, call) != fmi2OK)
        return fmi2Error;
    status = block_directional(b, c->run->time, b->x, b->u, vx, vu, vdx, vy, &message);
    if (status != BLOCK_OK) return instance_report_block(c, status, call, &message);
    for (size_t i = 0; i < n_unknowns; ++i) {
        const size_t r = unknowns[i];
        dv_unknown[i] = r < 2 * n_x ? vdx[r - n_x] : vy[r - 2 * n_x - n_u];
        if (!isfinite(dv_unknown[i]))
            return instance_report(c, fmi2Discard, call, "at time %.9g s the derivative of %s is %g", c->run->time,
                                   instance_real_name(c, r), dv_unknown[i]);
    }
    return fmi2OK;
}
