/* Co-simulation: variable communication steps, inputs as polynomials over the
 * step, output slopes at its end. */
#include <float.h>
#include <math.h>
#include <string.h>

#include "fmi2_cs.h"
#include "solver.h"

fmi2Status fmi2SetRealInputDerivatives(fmi2Component component, const fmi2ValueReference references[],
                                       size_t count, const fmi2Integer orders[], const fmi2Real values[])
{
    static const char call[] = "fmi2SetRealInputDerivatives";
    Instance *c = component;
    size_t first, n_u;

    if (!instance_allowed(c, MODE_INSTANTIATED | MODE_INITIALIZATION | MODE_STEP_COMPLETE, call)) return fmi2Error;
    if (count > 0 && (references == NULL || orders == NULL || values == NULL))
        return instance_report(c, fmi2Error, call, "a null pointer was given for an array that is not empty");
    first = 2 * c->block.layout.n_x;
    n_u = c->block.layout.n_u;
    for (size_t i = 0; i < count; ++i) {
        if (references[i] < first || references[i] >= first + n_u)
            return instance_report(c, fmi2Error, call, "%s is not a Real input",
                                   instance_real_name(c, references[i]));
        if (orders[i] < 1 || orders[i] > BLOCK_INPUT_ORDER)
            return instance_report(c, fmi2Error, call, "order %d of %s; allowed are 1 to %d", orders[i],
                                   instance_real_name(c, references[i]), BLOCK_INPUT_ORDER);
        if (!isfinite(values[i]))
            return instance_report(c, fmi2Error, call, "derivative %d of %s was set to %g at time %.9g s",
                                   orders[i], instance_real_name(c, references[i]), values[i], c->run->time);
    }
    for (size_t i = 0; i < count; ++i) {
        const size_t k = references[i] - first;
        c->u_poly[4 * k + (size_t)orders[i]] = values[i];
        if (orders[i] == 1) c->u_slope[k] = values[i];
        if (orders[i] > c->block.u_order[k]) c->block.u_order[k] = orders[i];
    }
    return fmi2OK;
}

/* Whether each of these outputs, numbered from `first`, is a state: its slope is that state's. */
static int are_states(const Instance *c, const fmi2ValueReference references[], size_t count, size_t first)
{
    if (c->output_state == NULL) return 0;
    for (size_t i = 0; i < count; ++i)
        if (c->output_state[references[i] - first] < 0) return 0;
    return 1;
}

/* dy/dt along the solution and the inputs' slopes. */
static fmi2Status output_slopes(Instance *c, double *slopes, const char *call)
{
    Block *b = &c->block;
    BlockMessage message = {{0}};
    BlockStatus status;
    fmi2Status refreshed = instance_is_sampled(c) ? instance_refresh_outputs(c, 1, call)
                                            : instance_refresh_derivatives(c, call);
    if (refreshed != fmi2OK) return refreshed;
    if (instance_is_sampled(c)) {
        memcpy(slopes, c->y_slope, b->layout.n_y * sizeof(double));
        return fmi2OK;
    }
    status = block_directional(b, c->run->time, b->x, b->u, b->dx, c->u_slope, NULL, slopes, &message);
    return instance_report_block(c, status, call, &message);
}

static fmi2Status check_slopes(Instance *c, const fmi2ValueReference references[], size_t count,
                               const fmi2Real values[], const char *call)
{
    for (size_t i = 0; i < count; ++i)
        if (!isfinite(values[i]))
            return instance_report(c, fmi2Discard, call, "at time %.9g s the derivative of %s is %g", c->run->time,
                                   instance_real_name(c, references[i]), values[i]);
    return fmi2OK;
}

/* Whether each reference is an output, numbered from `first`, and each order 1. */
static fmi2Status check_first_orders(Instance *c, const fmi2ValueReference references[], size_t count,
                                     const fmi2Integer orders[], size_t first, const char *call)
{
    for (size_t i = 0; i < count; ++i) {
        if (references[i] < first || references[i] >= first + c->block.layout.n_y)
            return instance_report(c, fmi2Error, call, "%s is not a Real output",
                                   instance_real_name(c, references[i]));
        if (orders[i] != 1)
            return instance_report(c, fmi2Error, call, "order %d of %s; only order 1 is offered", orders[i],
                                   instance_real_name(c, references[i]));
    }
    return fmi2OK;
}

fmi2Status fmi2GetRealOutputDerivatives(fmi2Component component, const fmi2ValueReference references[],
                                        size_t count, const fmi2Integer orders[], fmi2Real values[])
{
    static const char call[] = "fmi2GetRealOutputDerivatives";
    Instance *c = component;
    size_t first;
    double *slopes;
    fmi2Status status;

    if (!instance_allowed(c, MODE_STEP_COMPLETE | MODE_STEP_FAILED | MODE_TERMINATED, call)) return fmi2Error;
    if (count > 0 && (references == NULL || orders == NULL || values == NULL))
        return instance_report(c, fmi2Error, call, "a null pointer was given for an array that is not empty");
    first = 2 * c->block.layout.n_x + c->block.layout.n_u;
    status = check_first_orders(c, references, count, orders, first, call);
    if (status != fmi2OK) return status;
    if (are_states(c, references, count, first)) {
        status = instance_refresh_derivatives(c, call);
        for (size_t i = 0; i < count && status == fmi2OK; ++i)
            values[i] = c->block.dx[c->output_state[references[i] - first]];
        return status == fmi2OK ? check_slopes(c, references, count, values, call) : status;
    }
    slopes = c->work + SOLVER_ARRAYS * c->block.layout.n_x + 2 * c->block.layout.n_u;
    status = output_slopes(c, slopes, call);
    if (status != fmi2OK) return status;
    for (size_t i = 0; i < count; ++i) values[i] = slopes[references[i] - first];
    return check_slopes(c, references, count, values, call);
}

/* What rounding makes of a time that is a sum or a product. */
static double rounding(double time)
{
    return 4.0 * DBL_EPSILON * fabs(time);
}

/* By how much the caller's communication point may differ from where the last step ended: never a good
 * part of the step. */
static double point_slack(double time, double step)
{
    return 1e-6 * step + rounding(time) + fmin(1e-9 * (1.0 + fabs(time)), 0.01 * step);
}

double step_length(const Instance *c, double begin, double step)
{
    const double off = begin - c->run->time;

    return fabs(off) <= rounding(c->run->time) ? step : step + off;
}

int step_is_sane(Instance *c, double begin, double step, const char *call)
{
    const RunState *run = c->run;
    const double slack = point_slack(run->time, step);
    const double longest = *c->internal_step * (double)SOLVER_MAX_SUBSTEPS;

    if (!isfinite(begin) || !isfinite(step) || !(step > 0.0))
        instance_report(c, fmi2Error, call, "communication point %g with step %g; a finite point and a "
                        "positive, finite step are needed", begin, step);
    else if (!(fabs(begin - run->time) <= slack))
        instance_report(c, fmi2Error, call, "communication point %.17g, but the last step ended at %.17g",
                        begin, run->time);
    else if (!(step <= longest))
        instance_report(c, fmi2Error, call, "a step of %g s at time %.9g s is longer than the allowed %g s",
                        step, run->time, longest);
    else if (run->stop_defined && !(begin + step <= run->stop_time + slack))
        instance_report(c, fmi2Error, call, "the step to %.17g passes the stop time %.17g", begin + step,
                        run->stop_time);
    else if (!(begin + step > run->time && step_length(c, begin, step) > 0.0))
        instance_report(c, fmi2Error, call, "a step of %g s is too small to change the time %.17g", step, run->time);
    else
        return 1;
    return 0;
}

void step_consume_inputs(Instance *c, double elapsed)
{
    for (size_t i = 0; i < c->block.layout.n_u; ++i) {
        double *p = c->u_poly + 4 * i;
        c->u_slope[i] = p[1] + elapsed * (p[2] + elapsed / 2.0 * p[3]);
        c->block.u[i] = p[0] + elapsed * (p[1] + elapsed / 2.0 * (p[2] + elapsed / 3.0 * p[3]));
        p[1] = p[2] = p[3] = 0.0;
        c->block.u_order[i] = 0;
    }
}

fmi2Status fmi2DoStep(fmi2Component component, fmi2Real communication_point, fmi2Real step,
                      fmi2Boolean no_set_state_prior)
{
    static const char call[] = "fmi2DoStep";
    Instance *c = component;
    Block *b;
    BlockMessage message = {{0}};
    BlockStatus status;
    fmi2Status result;
    double length;

    (void)no_set_state_prior;
    if (!instance_allowed(c, MODE_STEP_COMPLETE, call)) return fmi2Error;
    if (!step_is_sane(c, communication_point, step, call)) return fmi2Error;
    b = &c->block;
    length = step_length(c, communication_point, step);
    for (size_t i = 0; i < b->layout.n_u; ++i) c->u_poly[4 * i] = b->u[i];
    if (c->undo != NULL) instance_undo_begin(c);

    if (instance_is_sampled(c)) {
        status = block_step(b, c->run->time, length, c->u_poly, c->y_slope, &message);
    } else {
        status = solver_advance(c, communication_point + step, length, &message);
    }
    if (status == BLOCK_OK) c->run->time = communication_point + step;
    if (status == BLOCK_DISCARD) {
        if (c->undo != NULL) instance_undo(c);
        c->run->mode = MODE_STEP_FAILED;
    }
    if (status != BLOCK_OK) return instance_report_block(c, status, call, &message);
    instance_remark(c, &message);
    step_consume_inputs(c, step);
    c->run->outputs_fresh = instance_is_sampled(c);
    c->run->derivatives_fresh = 0;
    result = instance_refresh_outputs(c, 0, call);
    return result == fmi2OK ? instance_check_finite(c, call) : result;
}

/* Steps are never asynchronous: there is nothing to cancel. */
fmi2Status fmi2CancelStep(fmi2Component component)
{
    Instance *c = component;

    if (c == NULL) return fmi2Error;
    return instance_report(c, fmi2Error, "fmi2CancelStep", "steps of this FMU do not run asynchronously");
}

static const int MODES_STATUS = MODE_STEP_COMPLETE | MODE_STEP_FAILED | MODE_TERMINATED;

fmi2Status fmi2GetStatus(fmi2Component component, const fmi2StatusKind kind, fmi2Status *value)
{
    Instance *c = component;

    if (!instance_allowed(c, MODES_STATUS, "fmi2GetStatus")) return fmi2Error;
    if (kind != fmi2DoStepStatus || value == NULL)
        return instance_report(c, fmi2Discard, "fmi2GetStatus", "there is no status of kind %d", (int)kind);
    *value = c->run->mode == MODE_STEP_FAILED ? fmi2Discard : fmi2OK;
    return fmi2OK;
}

fmi2Status fmi2GetRealStatus(fmi2Component component, const fmi2StatusKind kind, fmi2Real *value)
{
    Instance *c = component;

    if (!instance_allowed(c, MODES_STATUS, "fmi2GetRealStatus")) return fmi2Error;
    if (kind != fmi2LastSuccessfulTime || value == NULL)
        return instance_report(c, fmi2Discard, "fmi2GetRealStatus", "there is no Real status of kind %d", (int)kind);
    *value = c->run->time;
    return fmi2OK;
}

fmi2Status fmi2GetIntegerStatus(fmi2Component component, const fmi2StatusKind kind, fmi2Integer *value)
{
    Instance *c = component;

    (void)value;
    if (!instance_allowed(c, MODES_STATUS, "fmi2GetIntegerStatus")) return fmi2Error;
    return instance_report(c, fmi2Discard, "fmi2GetIntegerStatus", "there is no Integer status of kind %d", (int)kind);
}

fmi2Status fmi2GetBooleanStatus(fmi2Component component, const fmi2StatusKind kind, fmi2Boolean *value)
{
    Instance *c = component;

    if (!instance_allowed(c, MODES_STATUS, "fmi2GetBooleanStatus")) return fmi2Error;
    if (kind != fmi2Terminated || value == NULL)
        return instance_report(c, fmi2Discard, "fmi2GetBooleanStatus", "there is no Boolean status of kind %d",
                               (int)kind);
    *value = fmi2False;
    return fmi2OK;
}

fmi2Status fmi2GetStringStatus(fmi2Component component, const fmi2StatusKind kind, fmi2String *value)
{
    Instance *c = component;

    (void)value;
    if (!instance_allowed(c, MODES_STATUS, "fmi2GetStringStatus")) return fmi2Error;
    return instance_report(c, fmi2Discard, "fmi2GetStringStatus", "there is no String status of kind %d", (int)kind);
}
