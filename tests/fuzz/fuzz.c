/* fuzz GUID GOOD_URI BAD_URI SOUND_FILE BAD_FILE n_real n_integer n_x n_u n_y n_w seed calls
 * Ends with code 0 and one line of counts, or aborts with what broke.         */
#include "fuzz.h"

#include <float.h>
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>
#include <signal.h>

static uint64_t state;
static const Fuzz *running;
long fuzz_live;
int fuzz_out_of_memory;

/* splitmix64 [Steele, Lea and Flood 2014] */
uint64_t random_bits(void)
{
    uint64_t z = state += UINT64_C(0x9E3779B97F4A7C15);
    z = (z ^ (z >> 30)) * UINT64_C(0xBF58476D1CE4E5B9);
    z = (z ^ (z >> 27)) * UINT64_C(0x94D049BB133111EB);
    return z ^ (z >> 31);
}

void random_seed(uint64_t seed)
{
    state = seed;
}

size_t random_below(size_t n)
{
    return n > 0 ? (size_t)(random_bits() % n) : 0;
}

int chance(int percent)
{
    return (int)random_below(100) < percent;
}

double plausible(void)
{
    return ((double)(random_bits() >> 11) / 9007199254740992.0 - 0.5) * (chance(80) ? 0.1 : 10.0);
}

double absurd(void)
{
    static const double VALUES[] = {0.0, -0.0, 1.0, -1.0, 1e300, -1e300, DBL_MAX, -DBL_MAX, DBL_MIN, 4.9e-324,
                                    1e-300, 1e12, 1e16, -1e-9, 0.5, 1e6, 3e9, -3e9, 1e20};
    const size_t k = random_below(sizeof VALUES / sizeof VALUES[0] + 5);
    double value;
    uint64_t bits;

    switch (k) {
    case 0: return NAN;
    case 1: return INFINITY;
    case 2: return -INFINITY;
    case 3: return nextafter(VALUES[random_below(19)], INFINITY);
    case 4:
        bits = random_bits();
        memcpy(&value, &bits, sizeof value);
        return value;
    default: return VALUES[k - 5];
    }
}

void fuzz_broken(const Fuzz *f, const char *what)
{
    fprintf(stderr, "broken after %lu calls: %s\n", f->calls, what);
    abort();
}

/* The message is a printf format without arguments: every per cent sign must be doubled. */
static void logger(fmi2ComponentEnvironment e, fmi2String name, fmi2Status status, fmi2String category,
                   fmi2String message, ...)
{
    (void)e;
    if (name == NULL || category == NULL || message == NULL) fuzz_broken(running, "the logger was given a null");
    if (status < fmi2OK || status > fmi2Fatal) fuzz_broken(running, "the logger was given an unknown status");
    for (const char *s = message; *s != 0; ++s)
        if (*s == '%') {
            if (s[1] != '%') fuzz_broken(running, "a message has a per cent sign that printf would read");
            ++s;
        }
}

static void *allocate(size_t count, size_t size)
{
    void *memory;

    if ((int)random_below(1000) < fuzz_out_of_memory) return NULL;
    memory = calloc(count, size);
    fuzz_live += memory != NULL;
    return memory;
}

static void release(void *memory)
{
    fuzz_live -= memory != NULL;
    free(memory);
}

const fmi2CallbackFunctions FUZZ_CALLBACKS = {logger, allocate, release, NULL, NULL};

static void late(int signal)
{
    static const char text[] = "broken: a call takes longer than 60 s\n";
    (void)signal;
    if (write(2, text, sizeof text - 1) < 0) _exit(8);
    abort();
}

int main(int argc, char **argv)
{
    static Fuzz f;
    unsigned long wanted;

    if (argc != 14) {
        fprintf(stderr, "usage: fuzz GUID GOOD BAD SOUND_FILE BAD_FILE n_real n_integer n_x n_u n_y n_w seed calls\n");
        return 2;
    }
    f.guid = argv[1];
    f.good = argv[2];
    f.bad = argv[3];
    f.sound_file = argv[4];
    f.bad_file = argv[5];
    f.n_real = strtoul(argv[6], NULL, 10);
    f.n_integer = strtoul(argv[7], NULL, 10);
    f.n_x = strtoul(argv[8], NULL, 10);
    f.n_u = strtoul(argv[9], NULL, 10);
    f.n_y = strtoul(argv[10], NULL, 10);
    f.n_w = strtoul(argv[11], NULL, 10);
    random_seed(strtoul(argv[12], NULL, 10));
    wanted = strtoul(argv[13], NULL, 10);
    running = &f;
    signal(SIGALRM, late);
    while (f.calls < wanted) {
        if (f.calls % 64 == 0) alarm(60);
        fuzz_call(&f);
    }
    for (int k = 0; k < SLOTS; ++k) fuzz_free(&f, k);
    for (int k = 0; k < KEPT; ++k) free(f.kept[k]);
    if (fuzz_live != 0) fuzz_broken(&f, "memory taken through the callbacks was not given back");
    printf("%lu calls, %lu ok, %lu refused; %lu steps, %lu event iterations, %lu states restored\n", f.calls, f.ok,
           f.refused, f.steps, f.events, f.restored);
    return 0;
}
