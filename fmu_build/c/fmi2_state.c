/* Saving, restoring and serialising an instance: the saved piece of memory,
 * with a head that says whose it is and a check sum over the rest. */
#include <string.h>

#include "instance.h"

typedef struct {
    char magic[8];
    uint64_t size;      /* of head and saved piece                             */
    uint64_t model;     /* which FMU: hash of its GUID and kind (ME, CS)       */
    uint64_t checksum;  /* of the saved piece; serialised states only          */
} StateHead;

static const char MAGIC[8] = {'I', 'A', 'S', 'T', 'A', 'T', 'E', '1'};

/* Fowler-Noll-Vo, 64 bit. */
static uint64_t hash_of(const void *bytes, size_t size, uint64_t hash)
{
    const unsigned char *p = bytes;
    for (size_t i = 0; i < size; ++i) hash = (hash ^ p[i]) * UINT64_C(1099511628211);
    return hash;
}

static uint64_t model_of(const Instance *c)
{
    size_t size;
    const char *guid = record_text(&c->record, "guid", &size);
    return hash_of(guid, size, UINT64_C(14695981039346656037) ^ (uint64_t)c->type);
}

static size_t state_size(const Instance *c)
{
    return sizeof(StateHead) + c->saved_size;
}

fmi2Status fmi2GetFMUstate(fmi2Component component, fmi2FMUstate *state)
{
    static const char call[] = "fmi2GetFMUstate";
    Instance *c = component;
    StateHead *head;

    if (!instance_allowed(c, MODES_ALL & ~MODE_ERROR, call)) return fmi2Error;
    if (state == NULL) return instance_report(c, fmi2Error, call, "FMUstate is null");
    head = *state;
    if (head == NULL) {
        head = instance_allocate(&c->callbacks, state_size(c));
        if (head == NULL) return instance_report(c, fmi2Error, call, "out of memory");
    } else if (memcmp(head->magic, MAGIC, 8) != 0 || head->size != state_size(c)) {
        return instance_report(c, fmi2Error, call, "FMUstate is neither null nor a state of this FMU");
    }
    memcpy(head->magic, MAGIC, 8);
    head->size = state_size(c);
    head->model = model_of(c);
    head->checksum = 0;
    memcpy(head + 1, c->run, c->saved_size);
    *state = head;
    return fmi2OK;
}

fmi2Status fmi2SetFMUstate(fmi2Component component, fmi2FMUstate state)
{
    static const char call[] = "fmi2SetFMUstate";
    Instance *c = component;
    const StateHead *head = state;

    if (!instance_allowed(c, MODES_ALL, call)) return fmi2Error;
    if (head == NULL || memcmp(head->magic, MAGIC, 8) != 0 || head->size != state_size(c)
        || head->model != model_of(c))
        return instance_report(c, fmi2Error, call, "the state was not saved by an instance of this FMU");
    memcpy(c->run, head + 1, c->saved_size);
    ++c->memory_written;
    return fmi2OK;
}

fmi2Status fmi2FreeFMUstate(fmi2Component component, fmi2FMUstate *state)
{
    static const char call[] = "fmi2FreeFMUstate";
    Instance *c = component;

    if (!instance_allowed(c, MODES_ALL, call)) return fmi2Error;
    if (state == NULL || *state == NULL) return fmi2OK;
    if (memcmp(((StateHead *)*state)->magic, MAGIC, 8) != 0)
        return instance_report(c, fmi2Error, call, "FMUstate was not made by fmi2GetFMUstate");
    memset(*state, 0, sizeof(StateHead));
    instance_release(&c->callbacks, *state);
    *state = NULL;
    return fmi2OK;
}

fmi2Status fmi2SerializedFMUstateSize(fmi2Component component, fmi2FMUstate state, size_t *size)
{
    static const char call[] = "fmi2SerializedFMUstateSize";
    Instance *c = component;

    if (!instance_allowed(c, MODES_ALL, call)) return fmi2Error;
    if (size == NULL || state == NULL) return instance_report(c, fmi2Error, call, "a null pointer was given");
    *size = state_size(c);
    return fmi2OK;
}

fmi2Status fmi2SerializeFMUstate(fmi2Component component, fmi2FMUstate state, fmi2Byte bytes[], size_t size)
{
    static const char call[] = "fmi2SerializeFMUstate";
    Instance *c = component;
    StateHead head;

    if (!instance_allowed(c, MODES_ALL, call)) return fmi2Error;
    if (state == NULL || bytes == NULL) return instance_report(c, fmi2Error, call, "a null pointer was given");
    memcpy(&head, state, sizeof head);
    if (memcmp(head.magic, MAGIC, 8) != 0 || head.size != state_size(c) || size < state_size(c))
        return instance_report(c, fmi2Error, call, "not a state of this FMU, or only %zu bytes given where "
                               "%zu are needed", size, state_size(c));
    head.checksum = hash_of((const StateHead *)state + 1, c->saved_size, head.model);
    memcpy(bytes, &head, sizeof head);
    memcpy(bytes + sizeof head, (const StateHead *)state + 1, c->saved_size);
    return fmi2OK;
}

/* What a state must satisfy beyond its check sum, so that a forged one cannot
 * lead to calls that the checks elsewhere exclude. */
static int usable(const Instance *c, const StateHead *head)
{
    RunState run;
    const int both = MODE_INSTANTIATED | MODE_INITIALIZATION | MODE_TERMINATED;
    const int own = c->type == fmi2ModelExchange ? MODE_EVENT | MODE_CONTINUOUS
                                                 : MODE_STEP_COMPLETE | MODE_STEP_FAILED;
    memcpy(&run, head + 1, sizeof run);
    if (c->step_parameter < c->n_real) {
        double step;
        memcpy(&step, (const unsigned char *)(head + 1) + sizeof run + c->step_parameter * sizeof step, sizeof step);
        if (!(step >= c->min_real[c->step_parameter] && step <= c->max_real[c->step_parameter])) return 0;
    }
    return (run.mode & (both | own)) != 0 && (run.mode & (run.mode - 1)) == 0;
}

fmi2Status fmi2DeSerializeFMUstate(fmi2Component component, const fmi2Byte bytes[], size_t size,
                                   fmi2FMUstate *state)
{
    static const char call[] = "fmi2DeSerializeFMUstate";
    Instance *c = component;
    StateHead *head;

    if (!instance_allowed(c, MODES_ALL, call)) return fmi2Error;
    if (state == NULL || bytes == NULL) return instance_report(c, fmi2Error, call, "a null pointer was given");
    if (size != state_size(c))
        return instance_report(c, fmi2Error, call, "got %zu bytes, a state of this FMU has %zu", size,
                               state_size(c));
    head = instance_allocate(&c->callbacks, size);
    if (head == NULL) return instance_report(c, fmi2Error, call, "out of memory");
    memcpy(head, bytes, size);
    if (memcmp(head->magic, MAGIC, 8) != 0 || head->size != size || head->model != model_of(c)
        || head->checksum != hash_of(head + 1, c->saved_size, head->model) || !usable(c, head)) {
        instance_release(&c->callbacks, head);
        return instance_report(c, fmi2Error, call,
                               "the bytes are damaged or come from another FMU; the instance is unchanged");
    }
    *state = head;
    return fmi2OK;
}
