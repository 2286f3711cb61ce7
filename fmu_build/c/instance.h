#ifndef INTERAREA_INSTANCE_H
#define INTERAREA_INSTANCE_H
/* One FMI 2.0 component: a block, its variables in one piece of memory that can
 * be saved by copying, and where it stands in the standard's call sequence.  */
#include <stdint.h>

#include "block.h"
#include "fmi2Functions.h"

typedef enum {
    MODE_INSTANTIATED = 1,
    MODE_INITIALIZATION = 2,
    MODE_EVENT = 4,             /* model exchange                              */
    MODE_CONTINUOUS = 8,        /* model exchange                              */
    MODE_STEP_COMPLETE = 16,    /* co-simulation                               */
    MODE_STEP_FAILED = 32,      /* co-simulation, after fmi2Discard            */
    MODE_TERMINATED = 64,
    MODE_ERROR = 128
} Mode;

enum {
    MODES_ALL = 255,
    MODES_RUNNING = MODE_EVENT | MODE_CONTINUOUS | MODE_STEP_COMPLETE,
    MODES_READ = MODE_INITIALIZATION | MODES_RUNNING | MODE_STEP_FAILED | MODE_TERMINATED | MODE_ERROR
};

/* Whether computed values belong to the present states and inputs. */
typedef enum { STALE = 0, FRESH = 1, FRESH_BUT_LOCALS = 2 } Fresh;

/* The scalars of a run that an FMU state carries; the arrays follow it in the
 * same piece of memory. */
typedef struct {
    double time, start_time, stop_time;
    double last_event;          /* events up to this time have been handled    */
    double step_failed_at;      /* last successful time of a discarded step    */
    double switches_cost;       /* evaluations for finding where limiters switch */
    int32_t mode, stop_defined;
    int32_t outputs_fresh, derivatives_fresh;   /* Fresh                       */
    int32_t indicated, unused;  /* model exchange: limiters switch in event mode only, as the
                                 * importer has asked for event indicators       */
} RunState;

/* When a variable may be set: `flags.real`, `flags.integer` of the record. */
enum { SET_NEVER = 0, SET_START = 1, SET_ANY_TIME = 2 };
/* `type.integer` of the record. */
enum { TYPE_INTEGER = 0, TYPE_BOOLEAN = 1, TYPE_ENUMERATION = 2 };

typedef struct {
    fmi2CallbackFunctions callbacks;
    fmi2Type type;
    char *name;
    int log_categories;         /* bit k: the k-th of LOG_CATEGORIES is on     */

    unsigned char *record_bytes;
    Record record;
    Block block;
    size_t n_real, n_integer;
    int sampled;                /* `sampled` of the record, see instance_is_sampled */

    RunState *run;              /* start of the saved piece                    */
    size_t saved_size;
    double *real;               /* by value reference; block.x ... block.p lie in it */
    int *integer;               /* by value reference; block.iu ... block.ip lie in it */
    double *x_start;            /* states as set before initialization ends    */
    double *u_slope;            /* du/dt at the current time                   */
    double *u_poly;             /* [4*i+k]: k-th derivative of input i over the coming step */
    double *y_slope;            /* dy/dt, sampled blocks                       */
    double *overrun;            /* model exchange: of each of n_indicators, with the derivatives */
    size_t n_indicators, n_decisions;

    RunState *undo;             /* copy of the saved piece: a step to take back */
    size_t front_size;          /* of the saved piece before block.memory, which only events and starts change ... */
    size_t warm_size;           /* ... but for its last part, which evaluations change */
    int undo_whole;             /* whether `undo` holds all of the memory            */
    double *work;               /* solver: SOLVER_ARRAYS n_x + n_u, directional: 2 n_x + n_u + n_y */
    double *overruns;           /* solver: LIMITED_POINTS n_decisions          */

    const double *start_real, *min_real, *max_real, *nominal_x;
    const int32_t *start_integer, *min_integer, *max_integer;
    const int32_t *flags_real, *flags_integer, *type_integer;
    const int32_t *output_state;    /* the state that an output is, -1 where it is none; or null */
    const double *internal_step;  /* longest substep, s: in the record, or a parameter's value in `real` */
    size_t step_parameter;        /* that parameter's value reference, n_real if there is none */
    unsigned long memory_written;   /* how often block.memory was: for those who keep copies */
} Instance;

int instance_allowed(Instance *c, int modes, const char *call);
/* Logs the text, and with fmi2Error puts the instance into its error mode.
 * Returns `status`. */
fmi2Status instance_report(Instance *c, fmi2Status status, const char *call,
                           const char *format, ...);
fmi2Status instance_report_block(Instance *c, BlockStatus status, const char *call,
                                 const BlockMessage *message);
/* Logs what a block said of itself with BLOCK_OK, and empties it. */
void instance_remark(Instance *c, BlockMessage *message);
void instance_log_event(Instance *c, const char *format, ...);
const char *instance_real_name(const Instance *c, size_t reference);
const char *instance_integer_name(const Instance *c, size_t reference);
void *instance_allocate(const fmi2CallbackFunctions *callbacks, size_t bytes);
void instance_release(const fmi2CallbackFunctions *callbacks, void *memory);
void instance_reset_values(Instance *c);
fmi2Status instance_initialise(Instance *c, const char *call);
/* y, and unless `locals` is 0 w. */
fmi2Status instance_refresh_outputs(Instance *c, int locals, const char *call);
fmi2Status instance_refresh_derivatives(Instance *c, const char *call);
/* Takes the decisions of limiters as they are where the instance now is, its states onto those limits. */
fmi2Status instance_decide(Instance *c, const char *call);
/* Keeps what a step may have to be taken back to: at its begin, before its events; and goes back there. */
void instance_undo_begin(Instance *c);
void instance_undo_event(Instance *c);
void instance_undo(Instance *c);
fmi2Status instance_check_finite(Instance *c, const char *call);

/* Whether a block steps itself. Its code says so; where one library holds blocks of both kinds (the members of a
 * chain), each record does. Elsewhere the compiler leaves out what is never reached. */
#ifdef RECORDS_SAY_SAMPLED
#define instance_is_sampled(c) ((c)->sampled)
#else
#define instance_is_sampled(c) (block_is_sampled)
#endif

#endif
