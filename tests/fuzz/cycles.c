/* cycles GUID GOOD_URI ... CYCLES: creates, runs, saves and frees instances, half of them through
 * the callbacks' memory, and prints the growth of written memory (kB) and of open files between
 * the end of a warm-up and the end.                                              */
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <dirent.h>
#include <unistd.h>

#include "fmi2Functions.h"

static long live;

static void logger(fmi2ComponentEnvironment e, fmi2String n, fmi2Status s, fmi2String c, fmi2String m, ...)
{
    (void)e, (void)n, (void)s, (void)c, (void)m;
}

static void *allocate(size_t count, size_t size)
{
    void *memory = calloc(count, size);
    live += memory != NULL;
    return memory;
}

static void release(void *memory)
{
    live -= memory != NULL;
    free(memory);
}

/* Private pages that were written to. Not statm: the kernel keeps that figure in parts per processor
 * and adds them up late, some hundred kB off on machines with many.                            */
static long resident_kb(void)
{
    char line[256];
    long kb = 0, found = -1;
    FILE *file = fopen("/proc/self/smaps_rollup", "r");
    if (file == NULL) return -1;
    while (fgets(line, sizeof line, file) != NULL)
        if (sscanf(line, "Private_Dirty: %ld", &kb) == 1) found = kb;
    fclose(file);
    return found;
}

static long open_files(void)
{
    long count = 0;
    DIR *folder = opendir("/proc/self/fd");
    if (folder == NULL) return 0;
    while (readdir(folder) != NULL) ++count;
    closedir(folder);
    return count;
}

static int cycle(const char *guid, const char *place, long k)
{
    static const fmi2CallbackFunctions own = {logger, allocate, release, NULL, NULL};
    static const fmi2CallbackFunctions none = {logger, NULL, NULL, NULL, NULL};
    fmi2FMUstate state = NULL;
    size_t size = 0;
    fmi2Byte *bytes;
    int failed = 0;
    fmi2Component c = fmi2Instantiate("cycle", fmi2CoSimulation, guid, place, k % 2 ? &own : &none, fmi2False, k % 3 == 0);

    if (c == NULL) return 1;
    failed |= fmi2SetupExperiment(c, fmi2False, 0.0, 0.0, fmi2False, 0.0);
    failed |= fmi2EnterInitializationMode(c);
    failed |= fmi2ExitInitializationMode(c);
    failed |= fmi2DoStep(c, 0.0, 0.01, fmi2True);
    failed |= fmi2GetFMUstate(c, &state);
    failed |= fmi2SerializedFMUstateSize(c, state, &size);
    bytes = malloc(size);
    failed |= fmi2SerializeFMUstate(c, state, bytes, size);
    failed |= fmi2FreeFMUstate(c, &state);
    failed |= fmi2DeSerializeFMUstate(c, bytes, size, &state);
    failed |= fmi2SetFMUstate(c, state);
    failed |= fmi2DoStep(c, 0.01, 0.01, fmi2True);
    failed |= fmi2FreeFMUstate(c, &state);
    if (k % 5 == 0) failed |= fmi2Reset(c);
    else if (k % 5 == 1) failed |= fmi2Terminate(c);
    fmi2FreeInstance(c);
    free(bytes);
    /* a failing instantiation must give everything back too */
    if (fmi2Instantiate("cycle", fmi2CoSimulation, "{other}", place, &own, fmi2False, fmi2False) != NULL) return 1;
    return failed;
}

int main(int argc, char **argv)
{
    const long cycles = argc > 3 ? strtol(argv[argc - 1], NULL, 10) : 0, warm = cycles / 10;
    long memory = 0, files = 0;

    for (long k = 0; k < cycles; ++k) {
        if (k == warm) {
            memory = resident_kb();
            files = open_files();
        }
        if (cycle(argv[1], argv[2], k) != 0) {
            fprintf(stderr, "cycle %ld failed\n", k);
            return 1;
        }
    }
    printf("%ld cycles, growth %ld kB, %ld files, %ld pieces\n", cycles, resident_kb() - memory,
           open_files() - files, live);
    return 0;
}
