/* Runs one FMI 2.0 co-simulation FMU and prints the bits of its variables.
 *
 * driver LIBRARY GUID RESOURCES STEP COUNT VR[,VR...] [VR=VALUE ...]
 *
 * Sets the Real inputs VR to VALUE with slope VALUE over every step, and prints
 * after each step the 64 bits of each variable in hexadecimal.                 */
#include <inttypes.h>
#include <stdarg.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "fmi2Functions.h"

#ifdef _WIN32
#include <windows.h>
static void *library;
static void *symbol(const char *name) { return (void *)(uintptr_t)GetProcAddress((HMODULE)library, name); }
static void *open_library(const char *path) { return (void *)LoadLibraryA(path); }
#else
#include <dlfcn.h>
static void *library;
static void *symbol(const char *name) { return dlsym(library, name); }
static void *open_library(const char *path) { return dlopen(path, RTLD_NOW); }
#endif

enum { MOST = 2000 };

static void logger(void *environment, fmi2String instance, fmi2Status status, fmi2String category,
                   fmi2String message, ...)
{
    va_list args;
    (void)environment, (void)category;
    va_start(args, message);
    fprintf(stderr, "%s: status %d: ", instance, (int)status);
    vfprintf(stderr, message, args);
    fputc('\n', stderr);
    va_end(args);
}

static size_t numbers(const char *text, fmi2ValueReference *to)
{
    size_t count = 0;
    for (; *text != 0 && count < MOST; ++count) {
        char *end;
        to[count] = (fmi2ValueReference)strtoul(text, &end, 10);
        text = *end == ',' ? end + 1 : end;
    }
    return count;
}

#define LOAD(type, name) type *name##_ = (type *)(uintptr_t)symbol(#name)
#define CHECK(call) do { if ((call) != fmi2OK) { fprintf(stderr, "%s failed\n", #call); return 2; } } while (0)

int main(int argc, char **argv)
{
    static fmi2ValueReference shown[MOST], inputs[MOST];
    static fmi2Real values[MOST], given[MOST], slopes[MOST];
    static fmi2Integer orders[MOST];
    fmi2CallbackFunctions callbacks = {logger, calloc, free, NULL, NULL};
    size_t n, n_in = 0;

    if (argc < 7) return 1;
    library = open_library(argv[1]);
    if (library == NULL) {
        fprintf(stderr, "cannot load %s\n", argv[1]);
        return 1;
    }
    LOAD(fmi2InstantiateTYPE, fmi2Instantiate);
    LOAD(fmi2SetupExperimentTYPE, fmi2SetupExperiment);
    LOAD(fmi2EnterInitializationModeTYPE, fmi2EnterInitializationMode);
    LOAD(fmi2ExitInitializationModeTYPE, fmi2ExitInitializationMode);
    LOAD(fmi2SetRealTYPE, fmi2SetReal);
    LOAD(fmi2SetRealInputDerivativesTYPE, fmi2SetRealInputDerivatives);
    LOAD(fmi2DoStepTYPE, fmi2DoStep);
    LOAD(fmi2GetRealTYPE, fmi2GetReal);
    LOAD(fmi2FreeInstanceTYPE, fmi2FreeInstance);

    const double step = strtod(argv[4], NULL);
    const long count = strtol(argv[5], NULL, 10);
    n = numbers(argv[6], shown);
    for (int i = 7; i < argc; ++i, ++n_in) {
        inputs[n_in] = (fmi2ValueReference)strtoul(argv[i], NULL, 10);
        given[n_in] = slopes[n_in] = strtod(strchr(argv[i], '=') + 1, NULL);
        orders[n_in] = 1;
    }
    fmi2Component c = fmi2Instantiate_("it", fmi2CoSimulation, argv[2], argv[3], &callbacks, fmi2False, fmi2False);
    if (c == NULL) return 1;
    CHECK(fmi2SetupExperiment_(c, fmi2False, 0.0, 0.0, fmi2False, 0.0));
    CHECK(fmi2EnterInitializationMode_(c));
    CHECK(fmi2ExitInitializationMode_(c));
    for (long k = 0; k <= count; ++k) {
        CHECK(fmi2GetReal_(c, shown, n, values));
        for (size_t i = 0; i < n; ++i) {
            uint64_t bits;
            memcpy(&bits, &values[i], sizeof bits);
            printf("%016" PRIx64 "%c", bits, i + 1 < n ? ' ' : '\n');
        }
        if (k == count) break;
        if (n_in > 0) {
            CHECK(fmi2SetReal_(c, inputs, n_in, given));
            CHECK(fmi2SetRealInputDerivatives_(c, inputs, n_in, orders, slopes));
        }
        CHECK(fmi2DoStep_(c, (double)k * step, step, fmi2True));
    }
    fmi2FreeInstance_(c);
    return 0;
}
