/* A block, or a chain of them, as an IEEE/CIGRE DLL (real_code.h), over the same functions that an FMU offers.
 *
 * Called at time t with inputs u(t), Model_Outputs goes from the time of the last call to t, inputs along the
 * straight line between the two calls, and gives the outputs at t: no sample late. Called again at the same
 * time it does not go on. The members of a chain go one after the other, each with the outputs that those before
 * it have at t, as if a tool called their DLLs in that order. What changes during a run lies in the arrays of the
 * tool, nothing anywhere else:
 *   double states   of each member the piece that an FMU state carries; room to take a step back; scratch
 *   int states      a tag that says whose arrays they are; the text of the last message; integer variables
 * Tables below are written while the library is loaded and only read afterwards.                          */
#include <math.h>
#include <stdarg.h>
#include <stdio.h>
#include <string.h>

#include "instance.h"
#include "placement.h"
#include "real_code.h"
#include "real_code_data.h"

#if defined _WIN32
#define EXPORTED __declspec(dllexport)
#else
#define EXPORTED __attribute__((visibility("default")))
#endif

enum { MOST_MEMBERS = 24, MOST_SIGNALS = 256, MOST_PARAMETERS = 1024, TEXT_INTS = 128, TEXT_SIZE = 4 * TEXT_INTS };
enum { I_TAG, I_TEXT, I_INTEGERS = I_TEXT + TEXT_INTS };

/* A port: which variable, Real or integer, of which member. A wire: from an output to an input of a later member. */
typedef struct { int32_t integer, reference, fixed, member; } Port;
typedef struct { int32_t integer, source, from, target, to; } Wire;

typedef struct {
    Instance instance;          /* as described by its record, without memory */
    BlockNeeds needs;
    size_t memory, work;        /* in the double states: where its part begins, size of the scratch, bytes */
    size_t integers;            /* in the int states */
} Member;

static struct {
    int ready;
    int32_t tag, n_members;
    Member member[MOST_MEMBERS];
    size_t n_wires;
    const Wire *wires;
    RealCodeInfo info;
    RealCodeSignal inputs[MOST_SIGNALS], outputs[MOST_SIGNALS];
    RealCodeParameter parameters[MOST_PARAMETERS];
    const Port *ports;          /* of inputs, outputs, parameters */
} model;

/* Next of the zero-terminated texts. */
static const char *next(const char **text, const char *end)
{
    const char *const this = *text;
    const void *zero = this < end ? memchr(this, 0, (size_t)(end - this)) : NULL;

    if (zero == NULL) return "";
    *text = (const char *)zero + 1;
    return this;
}

static void tell_signals(RealCodeSignal *signal, int32_t count, const char **text, const char *end)
{
    for (int32_t k = 0; k < count; ++k) {
        signal[k].name = next(text, end);
        signal[k].description = next(text, end);
        signal[k].unit = next(text, end);
        signal[k].type = REAL_CODE_REAL64;
        signal[k].width = 1;
    }
}

static void tell_parameters(const double *range, const char **text, const char *end)
{
    for (int32_t k = 0; k < model.info.n_parameters; ++k) {
        RealCodeParameter *p = &model.parameters[k];
        p->name = next(text, end);
        p->group = next(text, end);
        p->description = next(text, end);
        p->unit = next(text, end);
        p->type = REAL_CODE_REAL64;
        p->fixed = model.ports[model.info.n_inputs + model.info.n_outputs + k].fixed;
        p->start.real64 = range[3 * k];
        p->min.real64 = range[3 * k + 1];
        p->max.real64 = range[3 * k + 2];
    }
}

/* Everything that Model_GetInfo gives. Returns 0 where the record has no such description. */
static int describe(const Record *record)
{
    size_t n_counts, n_ports, n_range, n_text, n_wires;
    const int32_t *counts = record_i32(record, "dll.counts", &n_counts);
    const int32_t *ports = record_i32(record, "dll.ports", &n_ports);
    const int32_t *wires = record_i32(record, "dll.wires", &n_wires);
    const double *range = record_f64(record, "dll.range", &n_range);
    const char *text = record_text(record, "dll.text", &n_text), *end = text + n_text;
    RealCodeInfo *info = &model.info;

    if (n_counts != 4 || n_range < 1 || text == NULL || counts[0] < 0 || counts[0] > MOST_SIGNALS || counts[1] < 0
        || counts[1] > MOST_SIGNALS || counts[2] < 0 || counts[2] > MOST_PARAMETERS
        || n_ports != 4 * (size_t)(counts[0] + counts[1] + counts[2]) || n_range != 1 + 3 * (size_t)counts[2]
        || counts[3] < 1 || counts[3] > MOST_MEMBERS)
        return 0;
    model.ports = (const Port *)ports;
    model.wires = (const Wire *)wires;
    model.n_wires = n_wires / 5;
    model.n_members = counts[3];
    *info = (RealCodeInfo){.version = {1, 1, 0, 0}, .sample_time = range[0], .mode = REAL_CODE_EMT_AND_RMS,
                           .n_inputs = counts[0], .inputs = model.inputs, .n_outputs = counts[1],
                           .outputs = model.outputs, .n_parameters = counts[2], .parameters = model.parameters};
    const char **const words[] = {&info->name, &info->model_version, &info->description, &info->general,
                                  &info->created, &info->creator, &info->modified, &info->modified_by,
                                  &info->comment, &info->history};
    for (size_t k = 0; k < sizeof words / sizeof *words; ++k) *words[k] = next(&text, end);
    tell_signals(model.inputs, counts[0], &text, end);
    tell_signals(model.outputs, counts[1], &text, end);
    tell_parameters(range + 1, &text, end);
    return 1;
}

/* Reads member k of the record and places it behind those before; returns 0 where it cannot be. */
static int take_in(const Record *record, int32_t k)
{
    Member *m = &model.member[k];
    char name[24], why[WHY_SIZE];
    const char *reason;
    size_t size;

    snprintf(name, sizeof name, "member.%d.record", (int)k);
    const char *bytes = record_text(record, name, &size);
    if (bytes == NULL || record_open(&m->instance.record, bytes, size, &reason) != 0) return 0;
    m->instance.type = fmi2CoSimulation;
    if (instance_describe(&m->instance, &m->needs, why) != 0) return 0;
    m->work = instance_sizes(&m->instance, &m->needs);
    m->memory = (size_t)model.info.n_double * sizeof(double);
    m->integers = (size_t)model.info.n_int;
    model.info.n_double += (int32_t)((2 * m->instance.saved_size + m->work) / sizeof(double));
    model.info.n_int += (int32_t)m->instance.n_integer;
    return 1;
}

__attribute__((constructor)) static void load(void)
{
    const unsigned char *bytes = real_code_data + REAL_CODE_MARK;
    Record record;
    const char *reason;
    uint64_t size;

    memcpy(&size, bytes + 8, sizeof size);
    if (size > real_code_capacity || record_open(&record, bytes, (size_t)size, &reason) != 0) return;
    if (!describe(&record)) return;
    model.info.n_int = I_INTEGERS;
    for (int32_t k = 0; k < model.n_members; ++k)
        if (!take_in(&record, k)) return;
    memcpy(&model.tag, bytes + 16, sizeof model.tag);   /* of the check sum */
    model.ready = 1;
}

/* A call under way. */
typedef struct {
    RealCodeInstance *tool;
    Instance instance[MOST_MEMBERS];
    char *text;                 /* of the tool's int states */
    int32_t worst;              /* what the call returns */
} Call;

/* Keeps the first text of the worst kind. */
static int32_t keep(Call *call, int32_t rank, const char *format, va_list arguments)
{
    if (rank <= call->worst) return call->worst;
    vsnprintf(call->text, TEXT_SIZE, format, arguments);
    if (rank == REAL_CODE_ERROR) call->tool->error = call->text;
    else call->tool->message = call->text;
    return call->worst = rank;
}

static int32_t say(Call *call, int32_t rank, const char *format, ...)
{
    va_list arguments;

    va_start(arguments, format);
    (void)keep(call, rank, format, arguments);
    va_end(arguments);
    return call->worst;
}

/* The FMI layer's logger. Its texts begin with the name of a function that nobody here has called. */
static void note(fmi2ComponentEnvironment environment, fmi2String name, fmi2Status status, fmi2String category,
                 fmi2String format, ...)
{
    const char *colon = strncmp(format, "fmi2", 4) == 0 ? strstr(format, ": ") : NULL;
    va_list arguments;

    (void)name, (void)category;
    va_start(arguments, format);
    (void)keep(environment, status >= fmi2Discard ? REAL_CODE_ERROR : REAL_CODE_MESSAGE,
               colon != NULL ? colon + 2 : format, arguments);
    va_end(arguments);
}

/* The instances in the tool's arrays; `trial`: in the room for steps taken back. */
static void enter(Call *call, RealCodeInstance *tool, int trial)
{
    call->tool = tool;
    call->text = (char *)(tool->int_states + I_TEXT);
    call->worst = REAL_CODE_OK;
    tool->error = tool->message = "";
    for (int32_t k = 0; k < model.n_members; ++k) {
        const Member *m = &model.member[k];
        Instance *c = &call->instance[k];
        char *const memory = (char *)tool->double_states + m->memory;

        *c = m->instance;
        c->callbacks.logger = note;
        c->callbacks.componentEnvironment = call;
        c->run = (RunState *)(memory + (trial ? c->saved_size : 0));
        c->undo = (RunState *)(memory + (trial ? 0 : c->saved_size));
        c->work = (double *)(memory + 2 * c->saved_size);
        instance_place(c, &m->needs);
    }
}

/* Integers go back and forth: as halves of a double they might not survive a tool that copies doubles. */
static void integers(Call *call, int into_tool)
{
    for (int32_t k = 0; k < model.n_members; ++k) {
        const Instance *c = &call->instance[k];
        int32_t *const kept = call->tool->int_states + model.member[k].integers;
        const size_t size = c->n_integer * sizeof(int);

        memcpy(into_tool ? (void *)kept : c->integer, into_tool ? (const void *)c->integer : kept, size);
        if (into_tool) memset(c->integer, 0, size);
    }
}

/* Sets the variable of a port; an integer must be whole. */
static void set(Call *call, const Port *port, const char *name, double value)
{
    Instance *c = &call->instance[port->member];
    const fmi2ValueReference r = (fmi2ValueReference)port->reference;

    if (!port->integer) {
        (void)fmi2SetReal(c, &r, 1, &value);
    } else if (!(value >= -2147483648.0 && value <= 2147483647.0 && value == floor(value))) {
        (void)say(call, REAL_CODE_ERROR, "%s is %.9g at time %.9g s; a whole number is needed", name, value,
                  call->tool->time);
    } else {
        const int whole = (int)value;
        if (c->type_integer[r] == TYPE_BOOLEAN) (void)fmi2SetBoolean(c, &r, 1, &whole);
        else (void)fmi2SetInteger(c, &r, 1, &whole);
    }
}

static double held(const Call *call, Port port)
{
    const Instance *c = &call->instance[port.member];
    return port.integer ? (double)c->integer[port.reference] : c->real[port.reference];
}

/* An output as it is at the time of the call. */
static double output(Call *call, Port port)
{
    (void)instance_refresh_outputs(&call->instance[port.member], 0, "");
    return held(call, port);
}

typedef struct { Port port; const char *name; double value; } Input;

/* An input of member k as it is at the time of the call: the i-th of the tool's, or, behind those, of the wires.
 * Returns 0 where that is none of its inputs. */
static int input(Call *call, int32_t k, size_t i, Input *input)
{
    const size_t n = (size_t)model.info.n_inputs;

    if (i < n) {
        *input = (Input){model.ports[i], model.inputs[i].name, ((const double *)call->tool->inputs)[i]};
        return input->port.member == k;
    }
    const Wire *wire = &model.wires[i - n];
    if (wire->target != k) return 0;
    const Port from = {wire->integer, wire->from, 0, wire->source}, to = {wire->integer, wire->to, 0, k};
    *input = (Input){to, "a wire", output(call, from)};
    return 1;
}

static void set_inputs(Call *call, int32_t k)
{
    const size_t n = (size_t)model.info.n_inputs + model.n_wires;
    Input in;

    for (size_t i = 0; i < n && call->worst < REAL_CODE_ERROR; ++i)
        if (input(call, k, i, &in)) set(call, &in.port, in.name, in.value);
}

/* Parameters of member k that the tool has changed; once it runs, only those that may be. */
static void set_parameters(Call *call, int32_t m)
{
    const Port *port = model.ports + model.info.n_inputs + model.info.n_outputs;
    const double *p = call->tool->parameters;
    for (int32_t k = 0; k < model.info.n_parameters && call->worst < REAL_CODE_ERROR; ++k) {
        if (port[k].member != m) continue;
        const double is = held(call, port[k]);
        if (p[k] == is) continue;
        if (port[k].fixed && call->instance[m].run->mode != MODE_INSTANTIATED)
            (void)say(call, REAL_CODE_MESSAGE, "%s was changed to %.9g during the run and stays at %.9g: it counts "
                      "at the start only", model.parameters[k].name, p[k], is);
        else
            set(call, &port[k], model.parameters[k].name, p[k]);
    }
}

/* From the parameters and inputs of the tool to the begin of a run; `trial`: inputs may not be there yet. */
static void start(Call *call, int trial)
{
    for (int32_t k = 0; k < model.n_members && call->worst < REAL_CODE_ERROR; ++k) {
        Instance *c = &call->instance[k];

        instance_reset_values(c);
        (void)fmi2SetupExperiment(c, fmi2False, 0.0, call->tool->time, fmi2False, 0.0);
        if (call->worst < REAL_CODE_ERROR) set_parameters(call, k);
        if (call->worst < REAL_CODE_ERROR) (void)fmi2EnterInitializationMode(c);
        if (!trial) set_inputs(call, k);
        if (call->worst < REAL_CODE_ERROR) (void)fmi2ExitInitializationMode(c);
    }
}

static int32_t answer(RealCodeInstance *tool, int32_t code, const char *error)
{
    tool->message = "";
    tool->error = error;
    return code;
}

EXPORTED const RealCodeInfo *Model_GetInfo(void)
{
    return model.ready ? &model.info : NULL;
}

EXPORTED int32_t Model_FirstCall(RealCodeInstance *tool)
{
    return answer(tool, REAL_CODE_OK, "");
}

EXPORTED int32_t Model_CheckParameters(RealCodeInstance *tool)
{
    Call call;

    if (!model.ready) return answer(tool, REAL_CODE_ERROR, "this library was not completed by an export");
    enter(&call, tool, 1);
    start(&call, 1);
    return call.worst;
}

EXPORTED int32_t Model_Initialize(RealCodeInstance *tool)
{
    const double *y = tool->outputs;
    Call call;

    if (!model.ready) return answer(tool, REAL_CODE_ERROR, "this library was not completed by an export");
    enter(&call, tool, 0);
    memset(tool->double_states, 0, (size_t)model.info.n_double * sizeof(double));
    start(&call, 0);
    for (int32_t k = 0; k < model.info.n_outputs && call.worst < REAL_CODE_ERROR; ++k) {
        const Port *port = &model.ports[model.info.n_inputs + k];
        const double own = output(&call, *port);
        if (!port->integer && !(fabs(y[k] - own) <= 1e-6 * fmax(1.0, fabs(own))))
            (void)say(&call, REAL_CODE_MESSAGE, "output %s starts at %.9g, not at the %.9g that the tool has given it",
                      model.outputs[k].name, own, y[k]);
    }
    integers(&call, 1);
    tool->int_states[I_TAG] = model.tag;
    return call.worst;
}

/* Inputs at the time of this call are the end of the straight line that began at the last one. */
static void advance(Call *call, int32_t k, double length)
{
    const size_t n = (size_t)model.info.n_inputs + model.n_wires;
    Instance *c = &call->instance[k];
    Input in;
    for (size_t i = 0; i < n && !instance_is_sampled(c) && call->worst < REAL_CODE_ERROR; ++i) {
        if (!input(call, k, i, &in) || in.port.integer) continue;
        const fmi2ValueReference r = (fmi2ValueReference)in.port.reference;
        const double slope = (in.value - c->real[r]) / length;
        const int order = 1;
        (void)fmi2SetRealInputDerivatives(c, &r, 1, &order, &slope);
    }
    if (call->worst < REAL_CODE_ERROR) (void)fmi2DoStep(c, c->run->time, length, fmi2True);
}

static void give_outputs(Call *call)
{
    double *y = call->tool->outputs;
    for (int32_t k = 0; k < model.info.n_outputs && call->worst < REAL_CODE_ERROR; ++k) {
        const double value = output(call, model.ports[model.info.n_inputs + k]);
        if (!isfinite(value))
            (void)say(call, REAL_CODE_ERROR, "output %s is %g at time %.9g s; give smaller inputs",
                      model.outputs[k].name, value, call->tool->time);
        if (call->worst < REAL_CODE_ERROR) y[k] = value;
    }
}

EXPORTED int32_t Model_Outputs(RealCodeInstance *tool)
{
    const double *u = tool->inputs;
    Call call;

    if (!model.ready) return answer(tool, REAL_CODE_ERROR, "this library was not completed by an export");
    if (tool->int_states[I_TAG] != model.tag)
        return answer(tool, REAL_CODE_ERROR,
                      "Model_Initialize was not called, or the states are those of another model");
    enter(&call, tool, 0);
    integers(&call, 0);
    const double before = call.instance[0].run->time, length = tool->time - before;
    const double slack = 1e-6 * model.info.sample_time;
    for (int32_t k = 0; k < model.info.n_inputs; ++k)
        if (!isfinite(u[k]))
            (void)say(&call, REAL_CODE_ERROR, "input %s is %g at time %.9g s; a finite value is needed",
                      model.inputs[k].name, u[k], tool->time);
    if (!(length >= -slack))
        (void)say(&call, REAL_CODE_ERROR, "time is %.9g s, before the %.9g s of the last call", tool->time, before);
    for (int32_t k = 0; k < model.n_members && call.worst < REAL_CODE_ERROR; ++k) set_parameters(&call, k);
    for (int32_t k = 0; k < model.n_members && call.worst < REAL_CODE_ERROR; ++k) {
        if (length > slack) advance(&call, k, length);
        set_inputs(&call, k);
    }
    give_outputs(&call);
    integers(&call, 1);
    return call.worst;
}

/* Of RMS tools, after Model_Outputs: the outputs are right already. */
EXPORTED int32_t Model_Iterate(RealCodeInstance *tool)
{
    return answer(tool, REAL_CODE_OK, "");
}

EXPORTED int32_t Model_Terminate(RealCodeInstance *tool)
{
    return answer(tool, REAL_CODE_OK, "");
}

EXPORTED int32_t Model_PrintInfo(void)
{
    if (model.ready) (void)printf("%s %s: %s\n", model.info.name, model.info.model_version, model.info.description);
    return REAL_CODE_OK;
}
