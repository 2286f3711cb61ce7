/* Random calls of an IEEE/CIGRE DLL, as a tool in disorder might make them: LIBRARY CALLS SEED.
 * All memory is as long as Model_GetInfo says, to the byte. Ends with 1 where a call returns 0 with an output that is
 * not finite, or a refused input changes the states; a sanitizer ends it otherwise. Prints how many calls succeeded. */
#include <dlfcn.h>
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "real_code.h"

typedef int32_t Act(RealCodeInstance *);
enum { INSTANCES = 4 };
static const RealCodeInfo *info;
static uint64_t seed;

static uint32_t draw(uint32_t below)
{
    seed = seed * 6364136223846793005u + 1442695040888963407u;
    return (uint32_t)(seed >> 33) % below;
}

static double odd(void)
{
    static const double odd[] = {NAN, INFINITY, -INFINITY, 1e308, -1e308, 1e-320, 0.5, -1.0, 2147483648.0};
    return odd[draw(sizeof odd / sizeof *odd)];
}

static double small(void) { return ((double)draw(2000001) - 1e6) * 1e-9; }

/* A usual value of an input: small, or a flag. */
static double usual(int32_t k) { return strstr(info->inputs[k].name, "_valid") != NULL ? (double)draw(2) : small(); }

static RealCodeInstance instance(void)
{
    return (RealCodeInstance){malloc(8 * (size_t)info->n_inputs), malloc(8 * (size_t)info->n_outputs),
                              malloc(8 * (size_t)info->n_parameters), 0.0, 3, "", "", malloc(4 * (size_t)info->n_int),
                              NULL, malloc(8 * (size_t)info->n_double)};
}

static void defaults(RealCodeInstance *it)
{
    double *u = it->inputs, *p = it->parameters;

    for (int32_t k = 0; k < info->n_inputs; ++k) u[k] = usual(k);
    for (int32_t k = 0; k < info->n_parameters; ++k) p[k] = info->parameters[k].start;
}

static void parameter(RealCodeInstance *it)
{
    double *p = it->parameters;

    if (info->n_parameters == 0) return;
    const uint32_t k = draw((uint32_t)info->n_parameters), what = draw(5);
    const RealCodeParameter *told = &info->parameters[k];
    p[k] = what == 0 ? odd() : what == 1 ? told->min : what == 2 ? told->max
           : what == 3 ? told->start : told->start + floor(10.0 * (small() * 1e3));
}

static int finite_outputs(const RealCodeInstance *it)
{
    for (int32_t k = 0; k < info->n_outputs; ++k)
        if (!isfinite(((double *)it->outputs)[k])) return 0;
    return 1;
}

int main(int argc, char **argv)
{
    void *const library = argc == 4 ? dlopen(argv[1], RTLD_NOW) : NULL;
    RealCodeInstance tool[INSTANCES];
    long calls = argc == 4 ? atol(argv[2]) : 0, good = 0;

    if (library == NULL) return 2;
    seed = (uint64_t)atol(argv[3]);
    info = ((const RealCodeInfo *(*)(void))dlsym(library, "Model_GetInfo"))();
    Act *const outputs = (Act *)dlsym(library, "Model_Outputs"), *const start = (Act *)dlsym(library, "Model_Initialize");
    Act *const check = (Act *)dlsym(library, "Model_CheckParameters"), *const first = (Act *)dlsym(library, "Model_FirstCall");
    Act *const others[] = {(Act *)dlsym(library, "Model_Iterate"), (Act *)dlsym(library, "Model_Terminate"), check, first};
    const size_t n_double = 8 * (size_t)info->n_double, n_int = 4 * (size_t)info->n_int;
    char *const before = malloc(n_double);
    for (int i = 0; i < INSTANCES; ++i) {
        tool[i] = instance();
        defaults(&tool[i]);
        memset(tool[i].int_states, 0, n_int);   /* outputs before the start are refused by what lies there */
    }
    for (; calls > 0; --calls) {
        RealCodeInstance *it = &tool[draw(INSTANCES)];
        double *const u = it->inputs;
        const uint32_t what = draw(200);
        int32_t code;

        if (what == 0) {                        /* a snapshot goes on in another instance */
            const RealCodeInstance *other = &tool[draw(INSTANCES)];
            memmove(it->double_states, other->double_states, n_double);
            memmove(it->int_states, other->int_states, n_int);
            it->time = other->time;
        } else if (what <= 3) {                 /* begins anew */
            defaults(it);
            it->time = draw(3) * 0.25;
            (void)first(it);
            (void)check(it);
            (void)start(it);
        } else if (what <= 5) {
            parameter(it);
            (void)check(it);
            if (draw(2)) (void)start(it);
        } else if (what <= 9) {
            (void)others[draw(4)](it);
        } else if (what == 10) {                /* what must be refused leaves the states as they are */
            const double kept = info->n_inputs > 0 ? u[0] : 0.0, time = it->time;
            memcpy(before, it->double_states, n_double);
            if (info->n_inputs > 0 && draw(2)) u[0] = draw(2) ? NAN : INFINITY;
            else it->time -= 1.0;
            code = outputs(it);
            if (code != REAL_CODE_ERROR || memcmp(before, it->double_states, n_double) != 0) {
                fprintf(stderr, "seed %s: a wrong input or time returns %d or changes the states\n", argv[3], (int)code);
                return 1;
            }
            it->time = time;
            if (info->n_inputs > 0) u[0] = kept;
        } else {
            for (int32_t k = 0; k < info->n_inputs; ++k) u[k] = draw(1000) == 0 ? odd() : usual(k);
            it->time += info->sample_time * (what < 190 ? 1.0 : what < 195 ? 0.0 : 0.37 * draw(8));
            code = outputs(it);
            good += code != REAL_CODE_ERROR;
            if (code != REAL_CODE_ERROR && !finite_outputs(it)) {
                fprintf(stderr, "seed %s: an output is not finite with return code %d\n", argv[3], (int)code);
                return 1;
            }
        }
    }
    printf("%ld\n", good);
    for (int i = 0; i < INSTANCES; ++i) {
        void *const all[] = {tool[i].inputs, tool[i].outputs, tool[i].parameters, tool[i].int_states, tool[i].double_states};
        for (size_t k = 0; k < sizeof all / sizeof *all; ++k) free(all[k]);
    }
    free(before);
    return 0;
}
