/* What the FMI functions share: memory, messages, legal call states, values at
 * the start, and values that are computed when they are read. */
#include "instance.h"

#include <math.h>
#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

enum { LOG_EVENTS = 0, LOG_WARNING, LOG_DISCARD, LOG_ERROR, LOG_FATAL, LOG_ALL, LOG_COUNT };
static const char *const LOG_CATEGORIES[LOG_COUNT] = {
    "logEvents", "logStatusWarning", "logStatusDiscard", "logStatusError", "logStatusFatal", "logAll"};

enum { TEXT_SIZE = 1024 };

void *instance_allocate(const fmi2CallbackFunctions *callbacks, size_t bytes)
{
    if (callbacks->allocateMemory != NULL && callbacks->freeMemory != NULL)
        return callbacks->allocateMemory(bytes > 0 ? bytes : 1, 1);
    return calloc(bytes > 0 ? bytes : 1, 1);
}

void instance_release(const fmi2CallbackFunctions *callbacks, void *memory)
{
    if (memory == NULL) return;
    if (callbacks->allocateMemory != NULL && callbacks->freeMemory != NULL)
        callbacks->freeMemory(memory);
    else
        free(memory);
}

/* The logger's message is a printf format: per cent signs are doubled, so that
 * the text needs no further arguments. */
static void send(const Instance *c, fmi2Status status, int category, const char *text)
{
    char safe[2 * TEXT_SIZE + 1];
    size_t n = 0;

    if (c->callbacks.logger == NULL) return;
    for (const char *s = text; *s != 0 && n < 2 * TEXT_SIZE - 1; ++s) {
        if (*s == '%') safe[n++] = '%';
        safe[n++] = *s;
    }
    safe[n] = 0;
    c->callbacks.logger(c->callbacks.componentEnvironment, c->name, status,
                        LOG_CATEGORIES[category], safe);
}

static int logs(const Instance *c, int category)
{
    return (c->log_categories & (1 << category | 1 << LOG_ALL)) != 0;
}

void instance_log_event(Instance *c, const char *format, ...)
{
    char text[TEXT_SIZE];
    va_list arguments;

    if (!logs(c, LOG_EVENTS)) return;
    va_start(arguments, format);
    vsnprintf(text, sizeof text, format, arguments);
    va_end(arguments);
    send(c, fmi2OK, LOG_EVENTS, text);
}

fmi2Status instance_report(Instance *c, fmi2Status status, const char *call, const char *format, ...)
{
    char text[TEXT_SIZE];
    const int category = status == fmi2Warning ? LOG_WARNING : status == fmi2Discard ? LOG_DISCARD
                         : status == fmi2Fatal ? LOG_FATAL : LOG_ERROR;
    int used = snprintf(text, sizeof text, "%s: ", call);
    va_list arguments;

    va_start(arguments, format);
    vsnprintf(text + used, sizeof text - (size_t)used, format, arguments);
    va_end(arguments);
    /* Errors are reported even when debug logging is off. */
    if (status >= fmi2Error || logs(c, category)) send(c, status, category, text);
    if (status >= fmi2Error && c->run != NULL) c->run->mode = MODE_ERROR;
    return status;
}

fmi2Status instance_report_block(Instance *c, BlockStatus status, const char *call,
                                 const BlockMessage *message)
{
    if (status == BLOCK_OK) return fmi2OK;
    return instance_report(c, status == BLOCK_DISCARD ? fmi2Discard : fmi2Error, call, "%s",
                           message->text);
}

void instance_remark(Instance *c, BlockMessage *message)
{
    /* As errors: what it says was not asked for, and nothing else tells it. */
    if (message->text[0] != 0) send(c, fmi2Warning, LOG_WARNING, message->text);
    message->text[0] = 0;
}

fmi2Status fmi2SetDebugLogging(fmi2Component component, fmi2Boolean logging_on, size_t n_categories,
                               const fmi2String categories[])
{
    Instance *c = component;
    int mask = 0;

    if (!instance_allowed(c, MODES_ALL, "fmi2SetDebugLogging")) return fmi2Error;
    if (n_categories > 0 && categories == NULL)
        return instance_report(c, fmi2Error, "fmi2SetDebugLogging", "categories is null");
    if (n_categories == 0) mask = 1 << LOG_ALL;
    for (size_t i = 0; i < n_categories; ++i) {
        int k = 0;
        while (k < LOG_COUNT && (categories[i] == NULL || strcmp(categories[i], LOG_CATEGORIES[k]) != 0)) ++k;
        if (k == LOG_COUNT)
            return instance_report(c, fmi2Error, "fmi2SetDebugLogging",
                                   "there is no log category \"%.60s\"; see LogCategories in modelDescription.xml",
                                   categories[i] != NULL ? categories[i] : "(null)");
        mask |= 1 << k;
    }
    c->log_categories = logging_on ? c->log_categories | mask
                        : n_categories == 0 ? 0 : c->log_categories & ~mask;
    return fmi2OK;
}

static const char *mode_name(int mode)
{
    switch (mode) {
    case MODE_INSTANTIATED: return "instantiated";
    case MODE_INITIALIZATION: return "initialization mode";
    case MODE_EVENT: return "event mode";
    case MODE_CONTINUOUS: return "continuous-time mode";
    case MODE_STEP_COMPLETE: return "step complete";
    case MODE_STEP_FAILED: return "step discarded";
    case MODE_TERMINATED: return "terminated";
    default: return "error";
    }
}

int instance_allowed(Instance *c, int modes, const char *call)
{
    if (c == NULL) return 0;
    if ((c->run->mode & modes) != 0) return 1;
    instance_report(c, fmi2Error, call, "not allowed in state \"%s\" of the FMI call sequence",
                    mode_name(c->run->mode));
    return 0;
}

static const char *name_of(const Instance *c, const char *list, size_t reference, size_t count)
{
    size_t size;
    const char *text = record_text(&c->record, list, &size), *end = text + size;

    if (text == NULL || reference >= count) return "(unknown)";
    for (; reference > 0 && text < end; --reference) {
        while (text < end && *text != 0) ++text;
        ++text;
    }
    return text < end ? text : "(unnamed)";
}

const char *instance_real_name(const Instance *c, size_t reference)
{
    return name_of(c, "names.real", reference, c->n_real);
}

const char *instance_integer_name(const Instance *c, size_t reference)
{
    return name_of(c, "names.integer", reference, c->n_integer);
}

/* As after fmi2Instantiate. */
void instance_reset_values(Instance *c)
{
    memset(c->run, 0, c->saved_size);
    ++c->memory_written;
    c->run->mode = MODE_INSTANTIATED;
    c->run->last_event = -INFINITY;
    for (size_t i = 0; i < c->n_real; ++i) c->real[i] = c->start_real[i];
    for (size_t i = 0; i < c->n_integer; ++i) c->integer[i] = c->start_integer[i];
    memcpy(c->x_start, c->block.x, c->block.layout.n_x * sizeof(double));
}

void instance_undo_begin(Instance *c)
{
    const size_t cold = c->saved_size - c->warm_size;

    memcpy(c->undo, c->run, c->front_size);
    if (c->warm_size > 0) memcpy((char *)c->undo + cold, (const char *)c->run + cold, c->warm_size);
    c->undo_whole = 0;
}

void instance_undo_event(Instance *c)
{
    const size_t at = c->front_size;

    if (!c->undo_whole) memcpy((char *)c->undo + at, (const char *)c->run + at, c->saved_size - c->warm_size - at);
    c->undo_whole = 1;
}

void instance_undo(Instance *c)
{
    const size_t cold = c->saved_size - c->warm_size;

    memcpy(c->run, c->undo, c->undo_whole ? c->saved_size : c->front_size);
    if (c->warm_size > 0) memcpy((char *)c->run + cold, (const char *)c->undo + cold, c->warm_size);
    ++c->memory_written;
}

/* Start of the run from the values set so far; may be repeated. */
fmi2Status instance_initialise(Instance *c, const char *call)
{
    Block *b = &c->block;
    BlockMessage message = {{0}};
    BlockStatus status;
    BlockNeeds needs = {0};

    memcpy(b->x, c->x_start, b->layout.n_x * sizeof(double));
    if ((status = block_needs(b->record, &b->layout, &needs, &message)) != BLOCK_OK)
        return instance_report_block(c, BLOCK_ERROR, call, &message);
    memset(b->memory, 0, needs.n_memory * sizeof(double));
    ++c->memory_written;
    c->run->time = c->run->start_time;
    c->run->last_event = -INFINITY;
    status = block_start(b, c->run->time, &message);
    if (status != BLOCK_OK) return instance_report_block(c, BLOCK_ERROR, call, &message);
    instance_remark(c, &message);
    c->run->last_event = c->run->time;
    c->run->outputs_fresh = c->run->derivatives_fresh = c->run->indicated = 0;
    return instance_refresh_outputs(c, 1, call);
}

fmi2Status instance_refresh_outputs(Instance *c, int locals, const char *call)
{
    Block *b = &c->block;
    BlockMessage message = {{0}};
    BlockStatus status;
    double *const w = b->w;

    if (c->run->outputs_fresh) return fmi2OK;
    if (instance_is_sampled(c)) {
        for (size_t i = 0; i < b->layout.n_u; ++i) c->u_poly[4 * i] = b->u[i];
        status = block_step(b, c->run->time, 0.0, c->u_poly, c->y_slope, &message);
    } else {
        if (!locals) b->w = NULL;
        status = block_outputs(b, c->run->time, b->x, b->u, b->y, &message);
        b->w = w;
    }
    if (status != BLOCK_OK) return instance_report_block(c, status, call, &message);
    c->run->outputs_fresh = locals || instance_is_sampled(c) ? FRESH : FRESH_BUT_LOCALS;
    return fmi2OK;
}

/* dx/dt with limiters noted, watched or held (block.h). */
static BlockStatus limited_derivatives(Instance *c, LimitMode mode, double *onto, BlockMessage *message)
{
    Block *b = &c->block;
    BlockLimits limits = {.mode = mode, .onto = onto, .each = c->overrun};

    for (size_t i = 0; i < c->n_indicators; ++i) c->overrun[i] = -1.0;
    b->limits = &limits;
    const BlockStatus status = block_derivatives(b, c->run->time, b->x, b->u, b->dx, message);
    b->limits = NULL;
    return status;
}

fmi2Status instance_refresh_derivatives(Instance *c, const char *call)
{
    Block *b = &c->block;
    BlockMessage message = {{0}};
    BlockStatus status;

    if (c->run->derivatives_fresh || b->layout.n_x == 0) return fmi2OK;
    status = c->run->indicated ? limited_derivatives(c, LIMITS_HOLD, NULL, &message)
                               : block_derivatives(b, c->run->time, b->x, b->u, b->dx, &message);
    if (status != BLOCK_OK) return instance_report_block(c, status, call, &message);
    c->run->derivatives_fresh = 1;
    return fmi2OK;
}

fmi2Status instance_decide(Instance *c, const char *call)
{
    BlockMessage message = {{0}};
    BlockStatus status = BLOCK_OK;
    double *x = c->block.x;

    /* a state that was held at a limit that moves is there before it is asked whether it still is */
    if (c->run->indicated) status = limited_derivatives(c, LIMITS_HOLD, x, &message);
    if (status == BLOCK_OK) status = limited_derivatives(c, LIMITS_NOTE, NULL, &message);
    if (status == BLOCK_OK && c->run->indicated) status = limited_derivatives(c, LIMITS_HOLD, x, &message);
    c->run->outputs_fresh = c->run->derivatives_fresh = 0;
    if (status == BLOCK_OK) c->run->indicated = 1;
    return instance_report_block(c, status, call, &message);
}

/* Names the first state, input or output that is not finite. */
fmi2Status instance_check_finite(Instance *c, const char *call)
{
    const BlockLayout *n = &c->block.layout;
    const size_t inputs = 2 * n->n_x, outputs = inputs + n->n_u;

    for (size_t i = 0; i < n->n_x; ++i)
        if (!isfinite(c->real[i]))
            return instance_report(c, fmi2Error, call, "at time %.9g s state %s became %g%s",
                                   c->run->time, instance_real_name(c, i), c->real[i],
                                   c->step_parameter < c->n_real ? "; try a shorter solver.step" : "");
    for (size_t i = inputs; i < outputs + n->n_y; ++i)
        if (!isfinite(c->real[i]))
            return instance_report(c, fmi2Error, call, "at time %.9g s %s %s became %g", c->run->time,
                                   i < outputs ? "input" : "output", instance_real_name(c, i), c->real[i]);
    return fmi2OK;
}
