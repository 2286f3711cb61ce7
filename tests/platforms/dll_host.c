/* A tool that runs an IEEE/CIGRE DLL whose ports are all real64: LIBRARY STEP COUNT [parameter=value ...].
 * Inputs come from whole numbers, the same on every platform. Prints a hash of all outputs after each hundredth. */
#include <inttypes.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "real_code.h"

#ifdef _WIN32
#include <windows.h>
#define OPEN(path) LoadLibraryA(path)
#define FIND(library, name) ((void (*)(void))GetProcAddress(library, name))
typedef HMODULE Handle;
#else
#include <dlfcn.h>
#define OPEN(path) dlopen(path, RTLD_NOW)
#define FIND(library, name) ((void (*)(void))dlsym(library, name))
typedef void *Handle;
#endif

typedef const RealCodeInfo *Tell(void);
typedef int32_t Act(RealCodeInstance *);

static void need(int32_t code, const RealCodeInstance *it, const char *call)
{
    if (code != REAL_CODE_ERROR) return;
    fprintf(stderr, "%s: %s\n", call, it->error);
    exit(1);
}

int main(int argc, char **argv)
{
    const Handle library = argc > 3 ? OPEN(argv[1]) : NULL;
    uint64_t hash = 1469598103934665603u;
    uint32_t random = 1;

    if (library == NULL) return 2;
    const RealCodeInfo *info = ((Tell *)FIND(library, "Model_GetInfo"))();
    Act *const check = (Act *)FIND(library, "Model_CheckParameters");
    Act *const initialise = (Act *)FIND(library, "Model_Initialize");
    Act *const outputs = (Act *)FIND(library, "Model_Outputs");
    double *u = calloc((size_t)info->n_inputs + 1, 8), *y = calloc((size_t)info->n_outputs + 1, 8);
    double *p = calloc((size_t)info->n_parameters + 1, 8);
    RealCodeInstance it = {u, y, p, 0.0, 1, "", "", calloc((size_t)info->n_int + 1, 4), NULL,
                           calloc((size_t)info->n_double + 1, 8)};
    const double step = strtod(argv[2], NULL);
    const long count = strtol(argv[3], NULL, 10);

    for (int32_t k = 0; k < info->n_parameters; ++k) {
        const size_t n = strlen(info->parameters[k].name);
        p[k] = info->parameters[k].start;
        for (int a = 4; a < argc; ++a)
            if (strncmp(argv[a], info->parameters[k].name, n) == 0 && argv[a][n] == '=') p[k] = strtod(argv[a] + n + 1, NULL);
    }
    need(check(&it), &it, "Model_CheckParameters");
    need(initialise(&it), &it, "Model_Initialize");
    for (long k = 1; k <= count; ++k) {
        for (int32_t i = 0; i < info->n_inputs; ++i) {
            random = random * 1664525u + 1013904223u;
            /* a triangle of 256 steps with noise: 2e-4 at most */
            const long way = (k + 37 * i) % 256;
            const int flag = strstr(info->inputs[i].name, "_valid") != NULL;   /* down for a third of the time */
            u[i] = flag ? (double)((k / 700 + i) % 3 != 0)
                        : (double)(way < 128 ? way - 64 : 192 - way) / 640000.0 + (double)(random >> 16) / 6.5536e8 - 5e-5;
        }
        it.time = (double)k * step;
        need(outputs(&it), &it, "Model_Outputs");
        for (int32_t i = 0; i < info->n_outputs; ++i) {
            uint64_t bits;
            memcpy(&bits, &y[i], 8);
            hash = (hash ^ bits) * 1099511628211u;
        }
        if (k % (count / 100) == 0) printf("%016" PRIx64 "\n", hash);
    }
    return 0;
}
