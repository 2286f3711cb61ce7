#ifndef INTERAREA_FUZZ_H
#define INTERAREA_FUZZ_H
/* Random calls on the FMI functions of one block kind, linked in statically.
 * Most calls are what a master would do next, so that deep states are reached;
 * the others are anything with anything.                                      */
#include <stddef.h>
#include <stdint.h>

#include "fmi2Functions.h"

enum { SLOTS = 4, STATES = 6, KEPT = 4 };

typedef enum { NONE, INSTANTIATED, INITIALIZATION, EVENT, CONTINUOUS, STEPPING, FAILED, ENDED, BROKEN } Phase;

typedef struct {
    fmi2Component c;
    fmi2Type type;
    Phase phase;
} Slot;

typedef struct {
    const char *guid, *good, *bad;      /* URIs of a sound and of a damaged resources folder */
    const char *sound_file, *bad_file;  /* model.bin of both                               */
    size_t n_real, n_integer, n_x, n_u, n_y, n_w;
    Slot slots[SLOTS];
    fmi2FMUstate states[STATES];        /* never freed twice, never given after free        */
    int owner[STATES];                  /* slot whose instance allocated it                 */
    Phase phase_of[STATES];             /* of that instance when it was saved               */
    unsigned char *kept[KEPT];
    size_t kept_size[KEPT];
    int kept_damaged[KEPT];
    Phase kept_phase[KEPT];
    unsigned long calls, ok, refused, steps, events, restored;
} Fuzz;

/* random.c part */
uint64_t random_bits(void);
void random_seed(uint64_t seed);
size_t random_below(size_t n);
int chance(int percent);
double plausible(void);
double absurd(void);

/* Makes one call and checks what must hold of it whatever the call was. */
void fuzz_call(Fuzz *f);
/* A promise of the FMI layer does not hold: prints it and aborts. */
void fuzz_broken(const Fuzz *f, const char *what);
void fuzz_free(Fuzz *f, int slot);

/* Parts of fuzz_call. */
#define OR_NULL(pointer) (natural || chance(98) ? (pointer) : NULL)
/* Counts a call, notes an instance that an error broke, and gives the status back. */
fmi2Status fuzz_told(Fuzz *f, Slot *s, fmi2Status status);
/* A call on the state of the instance in a slot. */
void fuzz_save(Fuzz *f, int slot, int natural);

extern const fmi2CallbackFunctions FUZZ_CALLBACKS;
extern long fuzz_live;              /* pieces of memory now held through the callbacks */
extern int fuzz_out_of_memory;      /* per mille of allocations that fail               */

#endif
