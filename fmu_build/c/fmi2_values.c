/* Getting and setting variables by value reference. Outputs, locals and
 * derivatives are computed when they are read after something they may depend
 * on was set. */
#include <math.h>

#include "instance.h"

/* Makes computed values current before a read. In initialization mode this is
 * a full start, since parameters may decide the states. */
static fmi2Status refresh(Instance *c, int outputs, int locals, int derivatives, const char *call)
{
    fmi2Status status = fmi2OK;

    if (locals && c->run->outputs_fresh == FRESH_BUT_LOCALS && c->run->mode != MODE_ERROR) {
        c->run->outputs_fresh = STALE;
        status = instance_refresh_outputs(c, 1, call);
    }
    if (status != fmi2OK || c->run->mode == MODE_TERMINATED || c->run->mode == MODE_ERROR) return status;
    if (c->run->mode == MODE_INITIALIZATION && !c->run->outputs_fresh)
        status = instance_initialise(c, call);
    else if (outputs)
        status = instance_refresh_outputs(c, locals, call);
    if (status == fmi2OK && derivatives) status = instance_refresh_derivatives(c, call);
    return status;
}

static fmi2Status unknown(Instance *c, const char *call, fmi2ValueReference reference, const char *type)
{
    return instance_report(c, fmi2Error, call, "there is no %s variable with value reference %u", type,
                           reference);
}

static fmi2Status null_array(Instance *c, const char *call)
{
    return instance_report(c, fmi2Error, call, "a null pointer was given for an array that is not empty");
}

fmi2Status fmi2GetReal(fmi2Component component, const fmi2ValueReference references[], size_t count,
                       fmi2Real values[])
{
    static const char call[] = "fmi2GetReal";
    Instance *c = component;
    int outputs = 0, locals = 0, derivatives = 0;
    size_t first_output, first_local, first_parameter;
    fmi2Status status;

    if (!instance_allowed(c, MODES_READ, call)) return fmi2Error;
    if (count > 0 && (references == NULL || values == NULL)) return null_array(c, call);
    first_output = 2 * c->block.layout.n_x + c->block.layout.n_u;
    first_local = first_output + c->block.layout.n_y;
    first_parameter = c->n_real - c->block.layout.n_p;
    for (size_t i = 0; i < count; ++i) {
        if (references[i] >= c->n_real) return unknown(c, call, references[i], "Real");
        if (references[i] >= first_local) locals |= references[i] < first_parameter;
        else if (references[i] >= first_output) outputs = 1;
        else derivatives |= references[i] >= c->block.layout.n_x
                            && references[i] < 2 * c->block.layout.n_x;
    }
    status = refresh(c, outputs | locals, locals, derivatives, call);
    for (size_t i = 0; i < count; ++i) values[i] = c->real[references[i]];
    for (size_t i = 0; i < count && status == fmi2OK; ++i)
        if (references[i] < first_parameter && !isfinite(values[i]))
            status = instance_report(c, fmi2Discard, call, "at time %.9g s %s is %g", c->run->time,
                                     instance_real_name(c, references[i]), values[i]);
    return status;
}

static fmi2Status get_integers(Instance *c, const fmi2ValueReference references[], size_t count,
                               int values[], int booleans, const char *call)
{
    fmi2Status status;

    if (!instance_allowed(c, MODES_READ, call)) return fmi2Error;
    if (count > 0 && (references == NULL || values == NULL)) return null_array(c, call);
    for (size_t i = 0; i < count; ++i)
        if (references[i] >= c->n_integer
            || (c->type_integer[references[i]] == TYPE_BOOLEAN) != booleans)
            return unknown(c, call, references[i], booleans ? "Boolean" : "Integer or Enumeration");
    status = refresh(c, count > 0, count > 0, 0, call);
    for (size_t i = 0; i < count; ++i) values[i] = c->integer[references[i]];
    return status;
}

fmi2Status fmi2GetInteger(fmi2Component component, const fmi2ValueReference references[], size_t count,
                          fmi2Integer values[])
{
    return get_integers(component, references, count, values, 0, "fmi2GetInteger");
}

fmi2Status fmi2GetBoolean(fmi2Component component, const fmi2ValueReference references[], size_t count,
                          fmi2Boolean values[])
{
    return get_integers(component, references, count, values, 1, "fmi2GetBoolean");
}

fmi2Status fmi2GetString(fmi2Component component, const fmi2ValueReference references[], size_t count,
                         fmi2String values[])
{
    Instance *c = component;

    (void)values;
    if (!instance_allowed(c, MODES_READ, "fmi2GetString")) return fmi2Error;
    if (count == 0) return fmi2OK;
    return unknown(c, "fmi2GetString", references != NULL ? references[0] : 0, "String");
}

/* Whether a variable with this flag may be set now. */
static int settable(const Instance *c, int flag)
{
    if (c->run->mode == MODE_INSTANTIATED || c->run->mode == MODE_INITIALIZATION)
        return flag >= SET_START;
    return flag >= SET_ANY_TIME;
}

static void values_changed(Instance *c)
{
    c->run->outputs_fresh = 0;
    c->run->derivatives_fresh = 0;
}

static fmi2Status check_real(Instance *c, fmi2ValueReference r, double value, const char *call)
{
    const size_t first_parameter = c->n_real - c->block.layout.n_p;

    if (r >= c->n_real) return unknown(c, call, r, "Real");
    if (!settable(c, c->flags_real[r]) || (r >= first_parameter && c->run->mode == MODE_CONTINUOUS))
        return instance_report(c, fmi2Error, call, "%s cannot be set in this state", instance_real_name(c, r));
    if (!isfinite(value))
        return instance_report(c, fmi2Error, call, "%s was set to %g at time %.9g s; a finite value is needed",
                               instance_real_name(c, r), value, c->run->time);
    if (!(value >= c->min_real[r] && value <= c->max_real[r]))
        return instance_report(c, fmi2Error, call, "%s was set to %.9g; allowed are %.9g to %.9g",
                               instance_real_name(c, r), value, c->min_real[r], c->max_real[r]);
    return fmi2OK;
}

fmi2Status fmi2SetReal(fmi2Component component, const fmi2ValueReference references[], size_t count,
                       const fmi2Real values[])
{
    static const char call[] = "fmi2SetReal";
    Instance *c = component;
    size_t n_x, n_u;

    if (!instance_allowed(c, MODE_INSTANTIATED | MODE_INITIALIZATION | MODES_RUNNING, call)) return fmi2Error;
    if (count > 0 && (references == NULL || values == NULL)) return null_array(c, call);
    n_x = c->block.layout.n_x;
    n_u = c->block.layout.n_u;
    for (size_t i = 0; i < count; ++i)
        if (check_real(c, references[i], values[i], call) != fmi2OK) return fmi2Error;
    for (size_t i = 0; i < count; ++i) {
        const size_t r = references[i];
        c->real[r] = values[i];
        if (r < n_x) c->x_start[r] = values[i];
        if (r >= 2 * n_x && r < 2 * n_x + n_u) {
            /* a new value: the derivatives given for the old one are void */
            const size_t k = r - 2 * n_x;
            c->u_slope[k] = 0.0;
            c->u_poly[4 * k + 1] = c->u_poly[4 * k + 2] = c->u_poly[4 * k + 3] = 0.0;
            c->block.u_order[k] = 0;
        }
    }
    values_changed(c);
    return fmi2OK;
}

static fmi2Status set_integers(Instance *c, const fmi2ValueReference references[], size_t count,
                               const int values[], int booleans, const char *call)
{
    if (!instance_allowed(c, MODE_INSTANTIATED | MODE_INITIALIZATION | MODE_EVENT | MODE_STEP_COMPLETE, call))
        return fmi2Error;
    if (count > 0 && (references == NULL || values == NULL)) return null_array(c, call);
    for (size_t i = 0; i < count; ++i) {
        const fmi2ValueReference r = references[i];
        if (r >= c->n_integer || (c->type_integer[r] == TYPE_BOOLEAN) != booleans)
            return unknown(c, call, r, booleans ? "Boolean" : "Integer or Enumeration");
        if (!settable(c, c->flags_integer[r]))
            return instance_report(c, fmi2Error, call, "%s cannot be set in this state",
                                   instance_integer_name(c, r));
        if (!booleans && (values[i] < c->min_integer[r] || values[i] > c->max_integer[r]))
            return instance_report(c, fmi2Error, call, "%s was set to %d; allowed are %d to %d",
                                   instance_integer_name(c, r), values[i], (int)c->min_integer[r],
                                   (int)c->max_integer[r]);
    }
    for (size_t i = 0; i < count; ++i)
        c->integer[references[i]] = booleans ? values[i] != 0 : values[i];
    values_changed(c);
    return fmi2OK;
}

fmi2Status fmi2SetInteger(fmi2Component component, const fmi2ValueReference references[], size_t count,
                          const fmi2Integer values[])
{
    return set_integers(component, references, count, values, 0, "fmi2SetInteger");
}

fmi2Status fmi2SetBoolean(fmi2Component component, const fmi2ValueReference references[], size_t count,
                          const fmi2Boolean values[])
{
    return set_integers(component, references, count, values, 1, "fmi2SetBoolean");
}

fmi2Status fmi2SetString(fmi2Component component, const fmi2ValueReference references[], size_t count,
                         const fmi2String values[])
{
    Instance *c = component;

    (void)values;
    if (!instance_allowed(c, MODE_INSTANTIATED | MODE_INITIALIZATION | MODES_RUNNING, "fmi2SetString"))
        return fmi2Error;
    if (count == 0) return fmi2OK;
    return unknown(c, "fmi2SetString", references != NULL ? references[0] : 0, "String");
}
