/* The container FMU for a page: the few calls that a web worker makes, each
 * crossing the border once. The record comes from memory, not from a file, so
 * resource.c of the FMI layer is left out: the location is the address. */
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "closed_loop.h"
#include "instance.h"
#include "resource.h"

#define EXPORT(name) __attribute__((export_name(#name)))

enum { FIRST_MESSAGE_SIZE = 1024 };
#define BOOLEAN 0x80000000u     /* marks the reference of a Boolean, which fmi2GetInteger refuses */

/* One model that the page has opened. */
typedef struct {
    fmi2Component component;
    const unsigned char *record;
    size_t record_size;
    char message[FIRST_MESSAGE_SIZE];   /* the first after a reset: later ones only say "not allowed" */
} Session;

static void keep_first(fmi2ComponentEnvironment environment, fmi2String instance, fmi2Status status,
                       fmi2String category, fmi2String message, ...)
{
    Session *s = environment;
    size_t n = 0;

    (void)instance;
    (void)category;
    if (status < fmi2Discard || s->message[0] != 0) return;   /* remarks do not end a run */
    for (; *message != 0 && n + 1 < FIRST_MESSAGE_SIZE; ++message) {
        if (message[0] == '%' && message[1] == '%') ++message;   /* it comes as a printf format */
        s->message[n++] = *message;
    }
    s->message[n] = 0;
}

unsigned char *resource_read(const char *location, const fmi2CallbackFunctions *callbacks, size_t *size,
                             char *why, size_t why_size)
{
    uintptr_t address = 0;

    for (; *location != 0; ++location) address = 10 * address + (uintptr_t)(*location - '0');
    const Session *s = (const Session *)address;
    unsigned char *bytes = instance_allocate(callbacks, s->record_size);

    *size = s->record_size;
    if (bytes == NULL) snprintf(why, why_size, "out of memory");
    else memcpy(bytes, s->record, s->record_size);
    return bytes;
}

void *page_allocate(size_t bytes);
EXPORT(allocate) void *page_allocate(size_t bytes)
{
    return malloc(bytes);
}

void page_release(void *memory);
EXPORT(release) void page_release(void *memory)
{
    free(memory);
}

/* Opens the model of `record`, which the caller may release afterwards; null and a message on failure. */
Session *page_open(const unsigned char *record, size_t size, const char *guid);
EXPORT(open) Session *page_open(const unsigned char *record, size_t size, const char *guid)
{
    Session *s = calloc(1, sizeof *s);
    char location[3 * sizeof s + 1];

    if (s == NULL) return NULL;
    const fmi2CallbackFunctions callbacks = {keep_first, NULL, NULL, NULL, s};
    s->record = record;
    s->record_size = size;
    snprintf(location, sizeof location, "%zu", (size_t)(uintptr_t)s);
    s->component = fmi2Instantiate("page", fmi2CoSimulation, guid, location, &callbacks, fmi2False, fmi2False);
    s->record = NULL;
    return s;
}

void page_close(Session *s);
EXPORT(close) void page_close(Session *s)
{
    fmi2FreeInstance(s->component);
    free(s);
}

/* The first message since the last reset; empty if there was none. */
const char *page_message(const Session *s);
EXPORT(message) const char *page_message(const Session *s)
{
    return s->message;
}

int page_is_open(const Session *s);
EXPORT(is_open) int page_is_open(const Session *s)
{
    return s->component != NULL;
}

/* Back to the start with other parameters; 0, or the FMI status. drawn: longest step, s, of a run that is only
 * looked at (drawn_step.h); 0: the run that the FMU makes. */
int page_start(Session *s, const fmi2ValueReference *real_references, const double *reals, size_t n_reals,
               const fmi2ValueReference *integer_references, const int *integers, size_t n_integers, double stop,
               double drawn);
EXPORT(start) int page_start(Session *s, const fmi2ValueReference *real_references, const double *reals,
                             size_t n_reals, const fmi2ValueReference *integer_references, const int *integers,
                             size_t n_integers, double stop, double drawn)
{
    fmi2Status status = fmi2Reset(s->component);

    s->message[0] = 0;
    if (status == fmi2OK) status = fmi2SetReal(s->component, real_references, n_reals, reals);
    if (status == fmi2OK) status = fmi2SetInteger(s->component, integer_references, n_integers, integers);
    if (status == fmi2OK) status = fmi2SetupExperiment(s->component, fmi2False, 0.0, 0.0, fmi2True, stop);
    if (status == fmi2OK) status = fmi2EnterInitializationMode(s->component);
    if (status == fmi2OK) status = fmi2ExitInitializationMode(s->component);
    if (status == fmi2OK) ((Instance *)s->component)->block.memory[M_DRAWN] = drawn;
    return (int)status;
}

static fmi2Status read_row(Session *s, const fmi2ValueReference *real_references, size_t n_reals,
                           const fmi2ValueReference *integer_references, size_t n_integers, double *row)
{
    fmi2Status status = fmi2GetReal(s->component, real_references, n_reals, row);

    for (size_t i = 0; i < n_integers && status == fmi2OK; ++i) {
        const fmi2ValueReference reference = integer_references[i] & ~BOOLEAN;
        int value = 0;
        status = (integer_references[i] & BOOLEAN) != 0 ? fmi2GetBoolean(s->component, &reference, 1, &value)
                                                        : fmi2GetInteger(s->component, &reference, 1, &value);
        row[n_reals + i] = (double)value;
    }
    return status;
}

/* Rows `first` to `last` of a run, `h` s apart, into `rows`, one after the other, Reals before integers; row 0
 * is the start. Returns how many were written: fewer than asked for where a step failed. */
size_t page_run(Session *s, size_t first, size_t last, double h, const fmi2ValueReference *real_references,
                size_t n_reals, const fmi2ValueReference *integer_references, size_t n_integers, double *rows);
EXPORT(run) size_t page_run(Session *s, size_t first, size_t last, double h,
                            const fmi2ValueReference *real_references, size_t n_reals,
                            const fmi2ValueReference *integer_references, size_t n_integers, double *rows)
{
    for (size_t k = first; k <= last; ++k) {
        double *row = rows + (k - first) * (n_reals + n_integers);
        fmi2Status status = fmi2OK;

        if (k > 0) status = fmi2DoStep(s->component, (double)(k - 1) * h, h, fmi2True);
        if (status == fmi2OK)
            status = read_row(s, real_references, n_reals, integer_references, n_integers, row);
        if (status != fmi2OK) return k - first;
    }
    return last - first + 1;
}
