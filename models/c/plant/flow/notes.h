#ifndef INTERAREA_NOTES_H
#define INTERAREA_NOTES_H
#include "../numbers/scalar.h"
/* What the devices' limiters, gates and other slope discontinuities decided at the begin of a step (elements.h), a
 * word of 64 for each device and `second` further a second one where a device has more, and what becomes of it at other
 * points of the step. All zero: nothing is noted. */
typedef struct {
    cell *words;      /* a word for each device, or null                                     */
    cell *switched;   /* null: words are noted; else 1 where one is another than it was      */
    double *worst;    /* held: by how much the decision that fits least is overrun           */
    double *onto;     /* held: states, of which those at a limit are put onto it             */
    double *each;     /* held: by how much each decision is overrun, `most` of every device, or null */
    size_t most;
    size_t second;
    int stage;        /* from 1, a stage of a step asks, whose own error is larger than what ports leave (PORT_STEP) */
} Notes;
/* Of several scenarios side by side: what their ports keep (port.h), and in which it is brought up to date. Alone that
 * lies in memory, and this is null. */
typedef struct { cell *warm; flag keep; } Warm;
#define NO_NOTES ((Notes){ NULL, NULL, NULL, NULL, NULL, 0, 0, 0 })

/* Those of the devices from `device` on, of `devices`, whose states begin at `state`. */
static inline Notes notes_of(const Notes *all, size_t device, size_t devices, size_t state)
{
    Notes n = *all;
    n.second = devices;
    if (n.words != NULL) n.words += device;
    if (n.onto != NULL) n.onto += state;
    return n;
}
#endif
