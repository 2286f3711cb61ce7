#ifndef INTERAREA_STRETCH_H
#define INTERAREA_STRETCH_H
/* The way through a communication step: stretches between events, each a whole number of equal
 * Runge-Kutta steps. They depend on the interval only, so a run that is saved, restored and continued
 * gives the same bits.                                                                     */
#include "runge_kutta.h"

enum { STRETCH_MOST_EVENTS = 1000000 };

typedef struct {
    double begin, end;      /* of the communication step                          */
    double longest;         /* Runge-Kutta step, s                                */
    double time;            /* reached                                            */
    double last_event;      /* events up to this time have been handled           */
    double from, to, event; /* stretch under way, the event at its end or INFINITY */
    long count, done;       /* Runge-Kutta steps of the stretch                   */
    long events;            /* on the way so far                                  */
} Stretch;

/* The last time at which nothing is to be expected any more. */
static inline double stretch_after(const Stretch *s)
{
    return s->last_event > s->time ? s->last_event : s->time;
}

/* From s->time to the next event of the block or to the end; 0 when that event does not lie ahead. */
static inline int stretch_next(Stretch *s, const Block *b)
{
    /* An event this close to the end counts as reached: masters round. */
    const double slack = 1e-9 * (s->end - s->begin), after = stretch_after(s);
    const double event = block_next_event(b, after);
    const int reached = event <= s->end + slack;

    if (reached && (!(event > after) || s->events > STRETCH_MOST_EVENTS)) return 0;
    s->events += reached;
    s->event = reached ? event : INFINITY;
    s->from = s->time;
    s->to = reached && event < s->end ? event : s->end;
    s->count = s->to > s->from ? runge_kutta_count(s->to - s->from, s->longest) : 0;
    s->done = 0;
    return 1;
}

/* Length and start of the present Runge-Kutta step. */
static inline double stretch_h(const Stretch *s)
{
    return (s->to - s->from) / (double)s->count;
}

static inline double stretch_t(const Stretch *s)
{
    return s->from + (s->to - s->from) * ((double)s->done / (double)s->count);
}
#endif
