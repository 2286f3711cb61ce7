#ifndef INTERAREA_PLANT_H
#define INTERAREA_PLANT_H
#include "plan.h"
#include "scalar.h"

/* The read-only network of the record; pointers live for one call only. */
typedef struct {
    const int32_t *machine_bus, *branch_from, *branch_to, *branch_status, *load_bus;
    const double *branch, *shunt, *load;   /* B_ROWS x n_branch, 2 x n_bus, L_ROWS x n_load */
    const int32_t *item_bus, *item_status; /* switchable shunts */
    const double *item;                    /* 2 x n_item: conductance, susceptance */
    size_t n_item;
    const char *bus_names, *branch_names, *machine_names;  /* one a line */
} Network;

/* What the event slots ask for at one time. */
typedef enum {
    EVENT_NONE = 0, EVENT_BUS_FAULT, EVENT_BRANCH_TRIP, EVENT_BRANCH_RECLOSE, EVENT_VREF_PULSE,
    EVENT_LOAD_STEP, EVENT_PM_PULSE, EVENT_MACHINE_TRIP, EVENT_SHUNT_SWITCH, EVENT_KINDS
} EventKind;

/* FMI parameters of a slot: Reals start, end, size, size_q, r, x; integers kind, target. */
enum { SLOT_START, SLOT_END, SLOT_SIZE, SLOT_SIZE_Q, SLOT_R, SLOT_X, SLOT_REALS };
enum { SLOT_KIND, SLOT_TARGET, SLOT_INTEGERS };

#if defined(__GNUC__)
__attribute__((format(printf, 3, 4)))
#endif
BlockStatus plant_fail(BlockMessage *message, BlockStatus status, const char *format, ...);
/* Name number `k` (0-based) of a list with one name a line, into text. */
const char *plant_name(const char *names, size_t k, char text[64]);

/* tables.c. plant_read: the counts and the network; plant_check: every other array, by
 * its length and what it refers to; plant_tables: numbers and parameters into memory. */
BlockStatus plant_read(const Record *record, const BlockLayout *layout, Plan *plan, Network *network,
                       BlockMessage *message);
BlockStatus plant_check(const Record *record, const BlockLayout *layout, const Plan *plan,
                        BlockMessage *message);
BlockStatus plant_tables(Block *b, const Plan *plan, const Network *network, BlockMessage *message);

/* rest.c: what is computed once from the tables; set-points and states of devices whose
 * parameters are not those of the record, so that the operating point stays at rest. */
void rest_prepare(double *memory, const Plan *plan);
BlockStatus rest_settle(Block *b, const Plan *plan, const Network *network, BlockMessage *message);

/* event.c */
BlockStatus event_check(const Block *b, const Plan *plan, const Network *network, BlockMessage *message);
double event_next(const Block *b, const Plan *plan, double t);
/* Puts what is active at t into memory (steps, switches) and rebuilds the stage. */
BlockStatus event_apply(Block *b, const Plan *plan, const Network *network, double t,
                        BlockMessage *message);

/* stage.c: the reduced network for the switches in memory and `extra` (2 x n_bus:
 * conductance and susceptance added by events). work: stage_work(...) doubles. */
size_t stage_work(size_t n_bus);
BlockStatus stage_build(double *memory, const Plan *plan, const Network *network,
                        const double *extra, double *work, BlockMessage *message);

/* flow.c. Each returns 0, or 1 + the port where Newton's method fails. Of memory
 * they change only the ports' warm start. scratch: flow_work(plan) numbers. */
size_t plant_flow(double *memory, const double *x, const double *u, double *dx, double *scratch);
size_t plant_outputs(double *memory, const double *x, double *y, double *scratch);
size_t plant_locals(double *memory, const double *x, const double *u, double *locals,
                    double *scratch, double *dx);
size_t plant_settle(double *memory, const double *x, double *scratch);

#ifdef PLANT_TANGENT
size_t plant_flow_tangent(double *memory, const num *x, const num *u, num *dx, num *scratch);
size_t plant_outputs_tangent(double *memory, const num *x, num *y, num *scratch);
#endif
/* The complex step itself; scratch as for the functions above, complex. */
size_t plant_directional(double *memory, const BlockLayout *layout, const double *x, const double *u,
                         const double *vx, const double *vu, double *vdx, double *vy, double *scratch);

static inline size_t flow_work(const Plan *plan)
{
    return 18 * plan->n_machine + (16 + 4 * plan->n_port) * plan->n_port;
}
#endif
