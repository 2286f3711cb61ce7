/* fmi2Instantiate, fmi2FreeInstance: the record of resources/model.bin turned
 * into an instance, everything checked before the first use. */
#include <stdio.h>
#include <string.h>

#include "instance.h"
#include "placement.h"
#include "resource.h"

const char *fmi2GetTypesPlatform(void)
{
    return fmi2TypesPlatform;
}

const char *fmi2GetVersion(void)
{
    return fmi2Version;
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
    if (own == NULL || length == 0 || own[length - 1] != 0) {
        snprintf(why, WHY_SIZE, "resources/model.bin has no GUID");
        return 1;
    }
    if (guid != NULL && strcmp(guid, own) == 0) return 0;
    snprintf(why, WHY_SIZE, "the GUID %.64s asked for is not that of resources/model.bin, %.64s; "
             "modelDescription.xml and resources come from different FMUs",
             guid != NULL ? guid : "(null)", own);
    return 1;
}

static int allocate(Instance *c, const BlockNeeds *needs)
{
    const size_t work = instance_sizes(c, needs);

    c->run = instance_allocate(&c->callbacks, c->saved_size);
    if (!block_is_sampled) c->undo = instance_allocate(&c->callbacks, c->saved_size);
    c->work = instance_allocate(&c->callbacks, work);
    if (c->run == NULL || c->work == NULL || (c->undo == NULL && !block_is_sampled)) return 1;
    instance_place(c, needs);
    return 0;
}

static int prepare(Instance *c, fmi2String location, fmi2String guid, char *why)
{
    BlockNeeds needs;

    if (block_is_sampled && c->type == fmi2ModelExchange) {
        snprintf(why, WHY_SIZE, "this FMU offers co-simulation only");
        return 1;
    }
    if (read_record(c, location, guid, why) != 0 || instance_describe(c, &needs, why) != 0) return 1;
    if (allocate(c, &needs) == 0) return 0;
    snprintf(why, WHY_SIZE, "out of memory");
    return 1;
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
