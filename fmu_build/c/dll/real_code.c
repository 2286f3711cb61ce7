/* A block, or a chain of them, as an IEEE/CIGRE DLL (real_code.h), over the same functions that an FMU offers.
 *
 * Called at time t with inputs u(t), Model_Outputs goes from the time of the last call to t, inputs along the
 * straight line between the two calls, and gives the outputs at t: no sample late. Called again at the same
 * time it does not go on. The members of a chain go one after the other, each with the outputs that those before
 * it have at t, as if a tool called their DLLs in that order. What changes during a run lies in the arrays of the
 * tool, nothing anywhere else:
 *   double states   of each member the piece that an FMU state carries; room to take a step back; scratch
 *   int states      a tag that says whose arrays they are; the text of the last message
 * Tables below are written while the library is loaded and only read afterwards.                          */
#include <math.h>
#include <stdarg.h>
#include <stdio.h>
#include <string.h>

#include "instance.h"
#include "placement.h"
#include "real_code.h"

#define EXPORTED FMI2_Export    /* of FMI's header; its own functions have lost it, see write/real_code.py */
/* Refuse the call, or say something beside it; a printf format and what it names. */
#define REFUSE(call, ...) say(call, NULL, fmi2Error, NULL, __VA_ARGS__)
#define REMARK(call, ...) say(call, NULL, fmi2Warning, NULL, __VA_ARGS__)

enum { MARK = 16, MOST_MEMBERS = 24, TEXT_INTS = 128, TEXT_SIZE = 4 * TEXT_INTS };
enum { I_TAG, I_TEXT, I_COUNT = I_TEXT + TEXT_INTS };
enum { LOG_DISCARDED = 1 << 2 };        /* of instance.c: errors it logs always */

/* What an export writes into a copy of the library: a mark to find the place by, then a record (record.h) of at most
 * CAPACITY bytes (write/real_code.py defines it). Read through a volatile pointer: no compiler may take it for the
 * zeros that it has here. */
static const unsigned char place[MARK + CAPACITY] __attribute__((aligned(16))) = "interarea-record";
static const unsigned char *volatile const exported = place + MARK;

/* A port: variable of a member, Real or integer; `fixed`: set at the start only. What feeds an input: an output of
 * a member before it, or where `from.member` is below 0 the tool's input number `from.reference`. */
typedef struct { int32_t integer, reference, fixed, member; } Port;
typedef struct { Port from, to; } Feed;

typedef struct {
    Instance instance;          /* as described by its record, without memory */
    BlockNeeds needs;
    size_t memory;              /* where its part of the double states begins, bytes */
} Member;

enum { MOST_PORTS = CAPACITY / sizeof(Port), MOST_TEXTS = 4 + 4 * MOST_PORTS }; /* more do not fit into a record */
static struct {
    int32_t tag;                /* of the record; 0 where no export has completed the library */
    int32_t n_members;
    Member member[MOST_MEMBERS];
    size_t n_feeds;
    const Feed *feeds;          /* first of the tool's inputs, in their order */
    const Port *outputs, *parameters;
    const char *text[MOST_TEXTS];
    RealCodeInfo info;
    RealCodeSignal signal[MOST_PORTS];
    RealCodeParameter parameter[MOST_PORTS];
} model = {.info = {.version = {1, 1, 0, 0}, .created = "", .creator = "interarea", .modified = "",
                    .modified_by = "interarea", .comment = "", .history = "", .mode = REAL_CODE_EMT_AND_RMS,
                    .inputs = model.signal, .parameters = model.parameter, .n_int = I_COUNT}};

/* Everything that Model_GetInfo gives, of a record whose check sum says that it is what an export has written. */
static void describe(const Record *record)
{
    RealCodeInfo *const info = &model.info;
    size_t size;
    const int32_t *n = record_i32(record, "dll.counts", &size);
    const double *range = record_f64(record, "dll.range", &size);
    const char *text = record_text(record, "dll.text", &size), *const end = text + size, **t = model.text;

    model.outputs = (const Port *)record_i32(record, "dll.ports", &size);
    model.feeds = (const Feed *)record_i32(record, "dll.feeds", &size);
    model.n_feeds = size * sizeof(int32_t) / sizeof(Feed);
    info->n_inputs = n[0], info->n_outputs = n[1], info->n_parameters = n[2], model.n_members = n[3];
    info->outputs = model.signal + n[0];
    model.parameters = model.outputs + n[1];
    info->sample_time = *range++;
    for (size_t k = 0; k < MOST_TEXTS && text < end; ++k, text += strlen(text) + 1) t[k] = text;
    info->name = t[0], info->model_version = t[1], info->description = t[2], info->general = t[3];
    t += 4;
    for (int32_t k = 0; k < n[0] + n[1]; ++k, t += 3)
        model.signal[k] = (RealCodeSignal){t[0], t[1], t[2], REAL_CODE_REAL64, 1};
    for (int32_t k = 0; k < n[2]; ++k, t += 4, range += 3)
        model.parameter[k] = (RealCodeParameter){t[0], t[1], t[2], t[3], REAL_CODE_REAL64, model.parameters[k].fixed,
                                                 range[0], range[1], range[2]};
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
    m->instance.log_categories = LOG_DISCARDED;
    if (instance_describe(&m->instance, &m->needs, why) != 0) return 0;
    m->memory = (size_t)model.info.n_double * sizeof(double);
    const size_t work = instance_sizes(&m->instance, &m->needs);
    model.info.n_double += (int32_t)((2 * m->instance.saved_size + work) / sizeof(double));
    return 1;
}

__attribute__((constructor)) static void load(void)
{
    const unsigned char *const bytes = exported;
    Record record;
    const char *reason;
    uint64_t size;

    memcpy(&size, bytes + 8, sizeof size);
    if (size > CAPACITY || record_open(&record, bytes, (size_t)size, &reason) != 0) return;
    describe(&record);
    for (int32_t k = 0; k < model.n_members; ++k)
        if (!take_in(&record, k)) return;
    memcpy(&model.tag, bytes + 16, sizeof model.tag);   /* of the check sum; never that of zeroed states */
    model.tag |= 1;
}

/* A call under way. */
typedef struct {
    RealCodeInstance *tool;
    Instance instance[MOST_MEMBERS];
    int32_t worst;              /* what the call returns */
} Call;

/* The FMI layer's logger: keeps the first text of the worst kind, in the tool's int states. The layer's own texts
 * begin with the name of a function that nobody here has called. */
static void say(fmi2ComponentEnvironment environment, fmi2String name, fmi2Status status, fmi2String category,
                fmi2String format, ...)
{
    Call *const call = environment;
    const int32_t rank = status >= fmi2Discard ? REAL_CODE_ERROR : REAL_CODE_MESSAGE;
    const char *const colon = strncmp(format, "fmi2", 4) == 0 ? strstr(format, ": ") : NULL;
    char *const text = (char *)(call->tool->int_states + I_TEXT);
    va_list arguments;

    (void)name, (void)category;
    if (rank <= call->worst) return;
    va_start(arguments, format);
    vsnprintf(text, TEXT_SIZE, colon != NULL ? colon + 2 : format, arguments);
    va_end(arguments);
    call->tool->message = "";   /* a remark that an error has overwritten */
    *(rank == REAL_CODE_ERROR ? &call->tool->error : &call->tool->message) = text;
    call->worst = rank;
}

/* The instances in the tool's arrays; `trial`: in the room for steps taken back. */
static void enter(Call *call, RealCodeInstance *tool, int trial)
{
    call->tool = tool;
    call->worst = REAL_CODE_OK;
    tool->error = tool->message = "";
    for (int32_t k = 0; k < model.n_members; ++k) {
        const Member *m = &model.member[k];
        Instance *c = &call->instance[k];
        char *const memory = (char *)tool->double_states + m->memory;

        *c = m->instance;
        c->callbacks.logger = say;
        c->callbacks.componentEnvironment = call;
        c->run = (RunState *)(memory + (trial ? c->saved_size : 0));
        c->undo = (RunState *)(memory + (trial ? 0 : c->saved_size));
        c->work = (double *)(memory + 2 * c->saved_size);
        instance_place(c, &m->needs);
    }
}

/* Sets the variable of a port; an integer must be whole, a flag 0 or 1. */
static void set(Call *call, const Port *port, const char *name, double value)
{
    Instance *c = &call->instance[port->member];
    const fmi2ValueReference r = (fmi2ValueReference)port->reference;
    const int whole = (int)fmax(-2147483648.0, fmin(value, 2147483647.0));      /* NaN too becomes one */
    const int flag = port->integer && c->type_integer[r] == TYPE_BOOLEAN;

    if (!port->integer)
        (void)fmi2SetReal(c, &r, 1, &value);
    else if ((double)whole != value || (flag && whole != 0 && whole != 1))
        REFUSE(call, "%s is %.9g at time %.9g s; %s is needed", name, value, call->tool->time,
               flag ? "0 or 1" : "a whole number");
    else
        (void)(flag ? fmi2SetBoolean : fmi2SetInteger)(c, &r, 1, &whole);
}

/* A parameter, or an output as the last start or step of its member has left it. */
static double held(const Call *call, const Port *port)
{
    const Instance *c = &call->instance[port->member];
    return port->integer ? (double)c->integer[port->reference] : c->real[port->reference];
}

/* Gives the inputs of member k what feeds them at the time of the call; with a length, s, above 0 the slopes instead
 * that lead them there. */
static void feed(Call *call, int32_t k, double length)
{
    Instance *c = &call->instance[k];
    const double *u = call->tool->inputs;
    const int order = 1;

    for (const Feed *f = model.feeds; f < model.feeds + model.n_feeds && call->worst < REAL_CODE_ERROR; ++f) {
        if (f->to.member != k || (length > 0.0 && f->to.integer)) continue;
        const int of_tool = f->from.member < 0;
        const double value = of_tool ? u[f->from.reference] : held(call, &f->from);
        const fmi2ValueReference r = (fmi2ValueReference)f->to.reference;
        if (length > 0.0) {
            const double slope = (value - c->real[r]) / length;
            (void)fmi2SetRealInputDerivatives(c, &r, 1, &order, &slope);
        } else {
            set(call, &f->to, of_tool ? model.signal[f->from.reference].name : "a wire", value);
        }
    }
}

/* Parameters that the tool has changed; once a member runs, only those that may be. */
static void set_parameters(Call *call)
{
    const double *p = call->tool->parameters;

    for (int32_t k = 0; k < model.info.n_parameters && call->worst < REAL_CODE_ERROR; ++k) {
        const Port *port = &model.parameters[k];
        const char *name = model.parameter[k].name;
        if (p[k] == held(call, port)) continue;
        if (port->fixed && call->instance[port->member].run->mode != MODE_INSTANTIATED)
            REMARK(call, "%s was changed to %.9g during the run and stays at %.9g: it counts at the start only", name,
                   p[k], held(call, port));
        else
            set(call, port, name, p[k]);
    }
}

/* From the parameters and inputs of the tool to the begin of a run; `trial`: inputs may not be there yet. */
static void start(Call *call, int trial)
{
    for (int32_t k = 0; k < model.n_members; ++k) {
        instance_reset_values(&call->instance[k]);
        (void)fmi2SetupExperiment(&call->instance[k], fmi2False, 0.0, call->tool->time, fmi2False, 0.0);
    }
    set_parameters(call);
    for (int32_t k = 0; k < model.n_members && call->worst < REAL_CODE_ERROR; ++k) {
        (void)fmi2EnterInitializationMode(&call->instance[k]);
        if (!trial) feed(call, k, 0.0);
        if (call->worst < REAL_CODE_ERROR) (void)fmi2ExitInitializationMode(&call->instance[k]);
    }
}

/* Of the functions with nothing to do. */
static int32_t agree(RealCodeInstance *tool)
{
    tool->error = tool->message = "";
    return REAL_CODE_OK;
}

EXPORTED const RealCodeInfo *Model_GetInfo(void) { return model.tag != 0 ? &model.info : NULL; }
EXPORTED int32_t Model_FirstCall(RealCodeInstance *tool) { return agree(tool); }
EXPORTED int32_t Model_Terminate(RealCodeInstance *tool) { return agree(tool); }
/* Of RMS tools, after Model_Outputs: the outputs are right already. */
EXPORTED int32_t Model_Iterate(RealCodeInstance *tool) { return agree(tool); }

EXPORTED int32_t Model_CheckParameters(RealCodeInstance *tool)
{
    Call call;

    enter(&call, tool, 1);
    start(&call, 1);
    return call.worst;
}

EXPORTED int32_t Model_Initialize(RealCodeInstance *tool)
{
    const double *y = tool->outputs;
    Call call;

    enter(&call, tool, 0);
    memset(tool->double_states, 0, (size_t)model.info.n_double * sizeof(double));
    start(&call, 0);
    for (int32_t k = 0; k < model.info.n_outputs && call.worst < REAL_CODE_ERROR; ++k) {
        const double own = held(&call, &model.outputs[k]);
        if (!model.outputs[k].integer && !(fabs(y[k] - own) <= 1e-6 * fmax(1.0, fabs(own))))
            REMARK(&call, "output %s starts at %.9g, not at the %.9g that the tool has given it",
                   model.info.outputs[k].name, own, y[k]);
    }
    tool->int_states[I_TAG] = call.worst < REAL_CODE_ERROR ? model.tag : 0;
    return call.worst;
}

static void give_outputs(Call *call)
{
    double *y = call->tool->outputs;

    for (int32_t k = 0; k < model.info.n_outputs && call->worst < REAL_CODE_ERROR; ++k) {
        const double value = held(call, &model.outputs[k]);
        if (!isfinite(value))
            REFUSE(call, "output %s is %g at time %.9g s; give smaller inputs", model.info.outputs[k].name, value,
                   call->tool->time);
        else
            y[k] = value;
    }
}

EXPORTED int32_t Model_Outputs(RealCodeInstance *tool)
{
    const double *u = tool->inputs, slack = 1e-6 * model.info.sample_time;
    Call call;

    enter(&call, tool, 0);
    if (tool->int_states[I_TAG] != model.tag)
        REFUSE(&call, "Model_Initialize was not called, a call failed since, or the states are of another model");
    const double before = call.instance[0].run->time, length = tool->time - before;
    for (int32_t k = 0; k < model.info.n_inputs; ++k)
        if (!isfinite(u[k]))
            REFUSE(&call, "input %s is %g at time %.9g s; a finite value is needed", model.signal[k].name, u[k],
                   tool->time);
    if (!(length >= -slack))
        REFUSE(&call, "time is %.9g s, before the %.9g s of the last call", tool->time, before);
    if (call.worst == REAL_CODE_ERROR) return call.worst;   /* the states are as they were */
    set_parameters(&call);
    for (int32_t k = 0; k < model.n_members && call.worst < REAL_CODE_ERROR; ++k) {
        Instance *c = &call.instance[k];
        if (length > slack && !instance_is_sampled(c)) feed(&call, k, length);
        if (length > slack && call.worst < REAL_CODE_ERROR) (void)fmi2DoStep(c, c->run->time, length, fmi2True);
        feed(&call, k, 0.0);
        if (call.worst < REAL_CODE_ERROR) (void)instance_refresh_outputs(c, 0, "fmi2GetReal");
    }
    give_outputs(&call);
    if (call.worst == REAL_CODE_ERROR) tool->int_states[I_TAG] = 0;
    return call.worst;
}

EXPORTED int32_t Model_PrintInfo(void)
{
    const RealCodeInfo *info = &model.info;

    if (model.tag != 0) (void)printf("%s %s: %s\n", info->name, info->model_version, info->description);
    return REAL_CODE_OK;
}
