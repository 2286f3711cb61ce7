#ifndef INTERAREA_STRETCH_H
#define INTERAREA_STRETCH_H
/* The way through a communication step: stretches between events, each a whole number of equal
 * Runge-Kutta steps. They depend on the interval only, so a run that is saved, restored and continued
 * gives the same bits. Lengths are counted from the begin of the communication step: far from t = 0 a
 * difference of two times has lost the digits that the step's own length still has.          */
#include "runge_kutta.h"

enum { STRETCH_MOST_EVENTS = 1000000 };

typedef struct {
    double begin, stop;     /* times between which the communication step goes    */
    double length;          /* of it, s                                           */
    double longest;         /* Runge-Kutta step, s                                */
    double time;            /* reached                                            */
    double last_event;      /* events up to this time have been handled           */
    double from, to;        /* stretch under way, s after `begin`                 */
    double end, event;      /* time at its end, the event there or INFINITY       */
    long count, done;       /* Runge-Kutta steps of the stretch                   */
    long events;            /* on the way so far                                  */
} Stretch;

/* At the begin of a communication step. */
static inline Stretch stretch_begin(double begin, double stop, double length, double longest, double last_event)
{
    return (Stretch){.begin = begin, .stop = stop, .length = length, .longest = longest, .time = begin,
                     .last_event = last_event, .event = INFINITY};
}

/* The last time at which nothing is to be expected any more. */
static inline double stretch_after(const Stretch *s)
{
    return s->last_event > s->time ? s->last_event : s->time;
}

/* From where the last stretch ended to the next event of the block or to the end; 0 when that event
 * does not lie ahead. Which step an event belongs to follows from times alone, so that none is lost. */
static inline int stretch_next(Stretch *s, const Block *b)
{
    /* An event this close to the end counts as reached: masters round. */
    const double slack = 1e-9 * s->length, after = stretch_after(s);
    const double event = block_next_event(b, after), ahead = event - s->begin;
    const int reached = event <= s->stop + slack, before = event < s->stop;

    if (reached && (!(event > after) || s->events > STRETCH_MOST_EVENTS)) return 0;
    s->events += reached;
    s->event = reached ? event : INFINITY;
    s->from = s->to;
    s->to = before && ahead < s->length ? ahead : s->length;
    s->end = before ? event : s->stop;
    s->count = s->to > s->from ? runge_kutta_count(s->to - s->from, s->longest) : 0;
    s->done = 0;
    return 1;
}

/* Length of the present Runge-Kutta step, and its begin in seconds into the communication step. */
static inline double stretch_h(const Stretch *s)
{
    return (s->to - s->from) / (double)s->count;
}

static inline double stretch_elapsed(const Stretch *s)
{
    return s->from + (s->to - s->from) * ((double)s->done / (double)s->count);
}
#endif
