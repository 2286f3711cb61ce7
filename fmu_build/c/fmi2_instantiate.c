/* fmi2Instantiate, fmi2FreeInstance: the record of resources/model.bin turned
 * into an instance, everything checked before the first use. */
#include <stdio.h>
#include <string.h>

#include "instance.h"
#include "resource.h"
#include "solver.h"

enum { FORMAT = 1, WHY_SIZE = 512 };
static const size_t LARGEST_COUNT = 1u << 24;

const char *fmi2GetTypesPlatform(void)
{
    return fmi2TypesPlatform;
}

const char *fmi2GetVersion(void)
{
    return fmi2Version;
}

static int count_is(const void *array, size_t got, size_t wanted)
{
    return got == wanted && (array != NULL || wanted == 0);
}

static int unfit(char *why, const char *what)
{
    snprintf(why, WHY_SIZE, "resources/model.bin%s", what);
    return 1;
}

/* The counts of the variables and the longest substep. */
static int read_layout(Instance *c, char *why)
{
    BlockLayout *n = &c->block.layout;
    size_t k[3];
    const int32_t *layout = record_i32(&c->record, "layout", &k[0]);
    const int32_t *format = record_i32(&c->record, "format", &k[1]);
    const double *step = record_f64(&c->record, "internal_step", &k[2]);

    if (format == NULL || k[1] != 1 || format[0] != FORMAT) {
        snprintf(why, WHY_SIZE, "resources/model.bin has format %d, this binary reads %d",
                 format != NULL && k[1] == 1 ? (int)format[0] : -1, FORMAT);
        return 1;
    }
    if (layout == NULL || k[0] != 9 || step == NULL || k[2] != 1 || !(step[0] > 0.0))
        return unfit(why, " lacks `layout` or `internal_step`");
    for (int i = 0; i < 9; ++i)
        if (layout[i] < 0 || (size_t)layout[i] > LARGEST_COUNT) {
            snprintf(why, WHY_SIZE, "resources/model.bin: impossible count %d in `layout`", (int)layout[i]);
            return 1;
        }
    n->n_x = (size_t)layout[0];  n->n_u = (size_t)layout[1];  n->n_y = (size_t)layout[2];
    n->n_w = (size_t)layout[3];  n->n_p = (size_t)layout[4];  n->n_iu = (size_t)layout[5];
    n->n_iy = (size_t)layout[6]; n->n_iw = (size_t)layout[7]; n->n_ip = (size_t)layout[8];
    c->n_real = 2 * n->n_x + n->n_u + n->n_y + n->n_w + n->n_p;
    c->n_integer = n->n_iu + n->n_iy + n->n_iw + n->n_ip;
    c->internal_step = step;
    return 0;
}

/* Start values, limits and flags of all variables. */
static int read_variables(Instance *c, char *why)
{
    size_t k[9];

    c->start_real = record_f64(&c->record, "start.real", &k[0]);
    c->min_real = record_f64(&c->record, "min.real", &k[1]);
    c->max_real = record_f64(&c->record, "max.real", &k[2]);
    c->flags_real = record_i32(&c->record, "flags.real", &k[3]);
    c->start_integer = record_i32(&c->record, "start.integer", &k[4]);
    c->min_integer = record_i32(&c->record, "min.integer", &k[5]);
    c->max_integer = record_i32(&c->record, "max.integer", &k[6]);
    c->flags_integer = record_i32(&c->record, "flags.integer", &k[7]);
    c->type_integer = record_i32(&c->record, "type.integer", &k[8]);
    const void *const array[] = {c->start_real, c->min_real, c->max_real, c->flags_real, c->start_integer,
                                 c->min_integer, c->max_integer, c->flags_integer, c->type_integer};
    for (int i = 0; i < 9; ++i)
        if (!count_is(array[i], k[i], i < 4 ? c->n_real : c->n_integer))
            return unfit(why, ": an array of variables does not fit `layout`");
    return 0;
}

/* Finds the arrays that every record carries and checks their sizes. */
static int read_tables(Instance *c, char *why)
{
    const BlockLayout *n = &c->block.layout;
    size_t count;

    if (read_layout(c, why) != 0 || read_variables(c, why) != 0) return 1;
    const int32_t *parameter = record_i32(&c->record, "internal_step.parameter", &count);
    c->step_parameter = count == 1 && parameter[0] >= 0 ? (size_t)parameter[0] : c->n_real;
    if (count > 0 && !(c->step_parameter < c->n_real)) return unfit(why, ": `internal_step.parameter` is no variable");
    c->output_state = record_i32(&c->record, "output.state", &count);
    if (count > 0 && count != n->n_y) return unfit(why, ": `output.state` does not fit `layout`");
    for (size_t i = 0; i < count; ++i)
        if (c->output_state[i] >= 0 && (size_t)c->output_state[i] >= n->n_x)
            return unfit(why, ": `output.state` points outside the states");
    c->nominal_x = record_f64(&c->record, "nominal.x", &count);
    return count_is(c->nominal_x, count, n->n_x) ? 0 : unfit(why, ": `nominal.x` does not fit `layout`");
}

/* One piece for everything that an FMU state carries, pointers into it. */
static int allocate(Instance *c, const BlockNeeds *needs)
{
    const BlockLayout *n = &c->block.layout;
    const int exchange = c->type == fmi2ModelExchange;   /* there what limiters decided is part of the state */
    const size_t decided = exchange ? needs->n_notes + needs->n_decisions : 0;
    const size_t doubles = c->n_real + n->n_x + 5 * n->n_u + n->n_y + decided;
    const size_t integers = (c->n_integer + n->n_u + 1) / 2;   /* two to a double */
    const size_t work = SOLVER_ARRAYS * n->n_x + 2 * n->n_u + n->n_y;
    Block *b = &c->block;
    double *d;

    c->front_size = sizeof(RunState) + (doubles + integers) * sizeof(double);
    c->saved_size = c->front_size + needs->n_memory * sizeof(double);
    c->warm_size = needs->n_warm * sizeof(double);
    c->run = instance_allocate(&c->callbacks, c->saved_size);
    if (!block_is_sampled) c->undo = instance_allocate(&c->callbacks, c->saved_size);
    c->work = instance_allocate(&c->callbacks,
                                (work + needs->n_scratch + needs->n_notes) * sizeof(double));
    if (c->run == NULL || c->work == NULL || (c->undo == NULL && !block_is_sampled)) return 1;

    d = (double *)(c->run + 1);
    c->real = d;
    b->x = d;
    b->dx = b->x + n->n_x;
    b->u = b->dx + n->n_x;
    b->y = b->u + n->n_u;
    b->w = b->y + n->n_y;
    b->p = b->w + n->n_w;
    c->x_start = d + c->n_real;
    c->u_slope = c->x_start + n->n_x;
    c->u_poly = c->u_slope + n->n_u;
    c->y_slope = c->u_poly + 4 * n->n_u;
    c->overrun = c->y_slope + n->n_y;
    c->n_decisions = exchange ? needs->n_decisions : 0;
    c->integer = (int *)(c->overrun + decided);
    b->memory = c->overrun + decided + integers;
    b->iu = c->integer;
    b->iy = b->iu + n->n_iu;
    b->iw = b->iy + n->n_iy;
    b->ip = b->iw + n->n_iw;
    b->u_order = c->integer + c->n_integer;
    b->scratch = c->work + work;
    b->notes = exchange ? c->overrun + needs->n_decisions : b->scratch + needs->n_scratch;
    b->record = &c->record;
    if (c->step_parameter < c->n_real) c->internal_step = c->real + c->step_parameter;
    return 0;
}

/* The record of the FMU that has this GUID. */
static int read_record(Instance *c, fmi2String location, fmi2String guid, char *why)
{
    const char *reason, *own;
    size_t size, length;

    c->record_bytes = resource_read(location, &c->callbacks, &size, why, WHY_SIZE);
    if (c->record_bytes == NULL) return 1;
    if (record_open(&c->record, c->record_bytes, size, &reason) != 0) {
        snprintf(why, WHY_SIZE, "resources/model.bin: %s; extract the FMU again", reason);
        return 1;
    }
    own = record_text(&c->record, "guid", &length);
    if (own == NULL || length == 0 || own[length - 1] != 0) return unfit(why, " has no GUID");
    if (guid != NULL && strcmp(guid, own) == 0) return 0;
    snprintf(why, WHY_SIZE, "the GUID %.64s asked for is not that of resources/model.bin, %.64s; "
             "modelDescription.xml and resources come from different FMUs",
             guid != NULL ? guid : "(null)", own);
    return 1;
}

static int prepare(Instance *c, fmi2String location, fmi2String guid, char *why)
{
    BlockMessage message = {{0}};
    BlockNeeds needs = {0};

    if (block_is_sampled && c->type == fmi2ModelExchange) {
        snprintf(why, WHY_SIZE, "this FMU offers co-simulation only");
        return 1;
    }
    if (read_record(c, location, guid, why) != 0 || read_tables(c, why) != 0) return 1;
    if (block_needs(&c->record, &c->block.layout, &needs, &message) != BLOCK_OK) {
        snprintf(why, WHY_SIZE, "resources/model.bin: %s", message.text);
        return 1;
    }
    if (needs.n_memory > LARGEST_COUNT || needs.n_scratch > LARGEST_COUNT || needs.n_notes > LARGEST_COUNT
        || needs.n_decisions > LARGEST_COUNT
        || allocate(c, &needs) != 0) {
        snprintf(why, WHY_SIZE, "out of memory");
        return 1;
    }
    return 0;
}

static void release(Instance *c)
{
    const fmi2CallbackFunctions callbacks = c->callbacks;

    instance_release(&callbacks, c->run);
    instance_release(&callbacks, c->undo);
    instance_release(&callbacks, c->work);
    instance_release(&callbacks, c->record_bytes);
    instance_release(&callbacks, c->name);
    instance_release(&callbacks, c);
}

fmi2Component fmi2Instantiate(fmi2String instance_name, fmi2Type type, fmi2String guid,
                              fmi2String resource_location, const fmi2CallbackFunctions *functions,
                              fmi2Boolean visible, fmi2Boolean logging_on)
{
    char why[WHY_SIZE] = "";
    const char *name = instance_name != NULL && instance_name[0] != 0 ? instance_name : "unnamed";
    Instance *c;

    (void)visible;
    if (functions == NULL) return NULL;
    c = instance_allocate(functions, sizeof *c);
    if (c == NULL) return NULL;
    memset(c, 0, sizeof *c);
    c->callbacks = *functions;
    c->type = type;
    c->name = instance_allocate(functions, strlen(name) + 1);
    if (c->name == NULL) {
        release(c);
        return NULL;
    }
    memcpy(c->name, name, strlen(name) + 1);
    if (instance_name == NULL || instance_name[0] == 0)
        snprintf(why, sizeof why, "the instance name is empty");
    else if (type != fmi2ModelExchange && type != fmi2CoSimulation)
        snprintf(why, sizeof why, "unknown FMU type %d", (int)type);
    else if (prepare(c, resource_location, guid, why) == 0) {
        instance_reset_values(c);
        if (logging_on) fmi2SetDebugLogging(c, fmi2True, 0, NULL);
        return c;
    }
    instance_report(c, fmi2Error, "fmi2Instantiate", "%s", why);
    release(c);
    return NULL;
}

void fmi2FreeInstance(fmi2Component component)
{
    if (component != NULL) release(component);
}
