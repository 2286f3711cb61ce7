#ifndef INTERAREA_KERNEL_STRUCTURES_H
#define INTERAREA_KERNEL_STRUCTURES_H
/* The master's step (master.py) over FMI 2.0 function pointers.
 *
 * kernel.py fills these structures, which build.py mirrors field by field, and owns
 * all memory they point to; nothing is allocated while stepping and there are no
 * globals. The arithmetic is that of polynomials.py, signals.py, node.py,
 * algebraic_loop.py, operation by operation, so that the results are the
 * same bits.                                                                  */
#include <stddef.h>
#include <stdint.h>

#include "fmi2FunctionTypes.h"

enum { KIND_HERMITE = 0, KIND_POINTS, KIND_LINEAR, KIND_HELD, KIND_NEWEST };
enum { TYPE_REAL = 0, TYPE_INTEGER, TYPE_BOOLEAN };
enum { STEP_EDGE = 1, STEP_RECORDED = 2 };

/* What kernel_run returns. */
enum {
    KERNEL_OK = 0,
    KERNEL_STOPPED,         /* `stop` was set by another thread                 */
    KERNEL_CALL_FAILED,     /* node, call, status                               */
    KERNEL_NOT_FINITE,      /* node sends a value that is not finite            */
    KERNEL_NOT_SETTLED,     /* group does not settle; value = relative change   */
    KERNEL_PAUSED           /* `budget` is used up: look around and call again  */
};
enum {
    CALL_SET_REAL = 0, CALL_SET_DERIVATIVES, CALL_SET_INTEGER, CALL_DO_STEP, CALL_GET_REAL, CALL_GET_INTEGER,
    CALL_GET_DERIVATIVES, CALL_GET_STATE, CALL_SET_STATE, CALL_COUNT
};

/* One connected output over the present step: signals.py. Times in ticks of 1 ns. */
typedef struct {
    double v0, s0, v1, s1;
    double d[4];
    double h_last, peak, nominal;
    int64_t ticks[4];
    double values[4];
    int32_t n_past, kind;
    int32_t index;          /* place among the owner's outputs                  */
    int32_t slope;          /* place among the owner's slopes, or -1            */
} KernelSignal;

/* Input = gain * signal + offset. */
typedef struct {
    double gain, offset;
    int32_t signal, type;
} KernelFeed;

/* fmi2DoStep of several instances at once (fmu_group.h): status[i] for component c[i] from
 * time[i] over length[i]; slopes: output slopes will be read. */
typedef void KernelLanes(void *work, size_t n, const fmi2Component c[], const fmi2Real time[],
                         const fmi2Real length[], int slopes, fmi2Status status[]);

/* One FMU instance and its place in the graph: node.py, instances.py. */
typedef struct {
    fmi2Component component;
    fmi2SetRealTYPE *set_real;
    fmi2SetRealInputDerivativesTYPE *set_derivatives;
    fmi2SetIntegerTYPE *set_integer;
    fmi2SetBooleanTYPE *set_boolean;
    fmi2DoStepTYPE *do_step;
    fmi2GetRealTYPE *get_real;
    fmi2GetIntegerTYPE *get_integer;
    fmi2GetBooleanTYPE *get_boolean;
    fmi2GetRealOutputDerivativesTYPE *get_derivatives;
    fmi2GetFMUstateTYPE *get_state;
    fmi2SetFMUstateTYPE *set_state;
    KernelLanes *lanes;             /* or null: it is stepped alone             */
    void *work;                     /* of `lanes`; nodes with the same one are stepped at once */
    fmi2FMUstate state;             /* before the step, of a member of a loop   */
    double time;                    /* end of its last step, as the FMU was told */
    double first_warning;           /* its `time` at the first call that returned fmi2Warning */
    int64_t warnings[CALL_COUNT];   /* such calls, by call                      */

    const KernelFeed *feeds;        /* Real inputs first                        */
    const fmi2ValueReference *u_reference;      /* of the Real inputs, then of the others */
    double *u;                                  /* Real inputs                  */
    const fmi2ValueReference *du_reference;     /* each Real input `order` times */
    const fmi2Integer *du_order;
    double *du;

    double *y;                      /* all outputs, in the order of the description: in a row of records */
    double *y_home;                 /* where they are left when kernel_run returns */
    const int32_t *y_place;         /* of each Real, Integer, Boolean output in y */
    const fmi2ValueReference *y_reference;      /* Real, then Integer, then Boolean */
    double *y_real;                 /* unused when all outputs are Real         */
    int *y_integer;
    double *dy;
    const fmi2ValueReference *dy_reference;
    const fmi2Integer *dy_order;

    int32_t n_u_real, n_u;          /* Real inputs, all inputs                  */
    int32_t order, substeps;
    int32_t n_real, n_integer, n_boolean;       /* outputs by type              */
    int32_t n_y, n_dy;
    int32_t first_signal, n_signals;
    int32_t column;                 /* of its first output in a record          */
} KernelNode;

/* Nodes stepped together: k->members[first .. first + count). An iterated group
 * ends when the signals k->tearing[tearing .. tearing + n_tearing) end as supposed. */
typedef struct {
    int32_t first, count, tearing, n_tearing, iterated, unused;
} KernelGroup;

/* What to do when fmi2DoStep from `time` over `length` returns fmi2Discard: 0 when
 * the step has been completed after all. u and du of the node are as they were sent. */
typedef int32_t KernelDiscarded(int32_t node, double time, double length);

typedef struct {
    KernelDiscarded *discarded;     /* or null: it fails                        */
    KernelNode *nodes;
    KernelSignal *signals;
    const KernelGroup *groups;
    const int32_t *members, *tearing;
    const int64_t *points;          /* ends of the steps, before them the start */
    const unsigned char *flags;     /* of each step                             */
    double *times, *records;        /* one row for each recorded point          */
    double *spare;                  /* a row for points that are not            */
    double *work;                   /* broyden.h says how much                  */
    int64_t index, row, repeated;   /* next step, next row, loop steps done again */
    double tolerance;
    double budget;                  /* s of computing until KERNEL_PAUSED       */
    double value;                   /* with KERNEL_NOT_SETTLED                  */
    volatile int32_t stop;
    int32_t n_nodes, n_signals, n_groups, n_columns;
    int32_t node, group, call, status;          /* what failed                  */
} Kernel;

#endif
