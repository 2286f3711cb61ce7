#ifndef INTERAREA_SLOT_H
#define INTERAREA_SLOT_H
#include "../start/tables.h"

/* What the event slots ask for at one time. */
typedef enum {
    EVENT_NONE = 0, EVENT_BUS_FAULT, EVENT_BRANCH_TRIP, EVENT_BRANCH_RECLOSE, EVENT_VREF_PULSE,
    EVENT_LOAD_STEP, EVENT_PM_PULSE, EVENT_MACHINE_TRIP, EVENT_SHUNT_SWITCH, EVENT_FREQUENCY_SHED,
    EVENT_FREQUENCY_TRIP, EVENT_DEVICE_TRIP, EVENT_HVDC_BLOCK, EVENT_KINDS
} EventKind;
/* How what it asks for goes on in time (wave.h). */
typedef enum { WAVE_STEADY, WAVE_SINE, WAVE_SQUARE, WAVE_NOISE, WAVE_KINDS } WaveKind;

/* Whether a kind moves a set-point; whether it has a size that may change in time. */
static inline int slot_sets(int kind) { return kind == EVENT_VREF_PULSE || kind == EVENT_PM_PULSE; }
static inline int slot_changes(int kind) { return slot_sets(kind) || kind == EVENT_LOAD_STEP; }

static inline const double *slot_reals(const Block *b, const Plan *plan, size_t k)
{
    return b->p + b->layout.n_p - (plan->n_slot - k) * (size_t)SLOT_REALS;
}

static inline const int *slot_integers(const Block *b, const Plan *plan, size_t k)
{
    return b->ip + b->layout.n_ip - (plan->n_slot - k) * (size_t)SLOT_INTEGERS;
}
#endif
