#ifndef INTERAREA_LAYOUT_H
#define INTERAREA_LAYOUT_H
/* Where everything lies in `memory`. The record is read once, in block_start:
 * its numbers (and the FMI parameters over them) are copied here, so that the
 * right-hand side touches only memory, states and inputs. Tables are stored
 * quantity by quantity ("row" r, device k: table[r * count + k]).            */
#include <stddef.h>
#include "../../block/block.h"
#include "scalar.h"

/* Rows of the device tables; models/blocks/plant.py writes them in this order. */
enum {  /* machine, per unit on the machine base */
    M_RATIO,            /* machine base / system base                   */
    M_RA, M_XL, M_XD, M_XD1, M_XD2, M_XQ, M_XQ1, M_XQ2,
    M_TD01, M_TD02, M_TQ01, M_TQ02,  /* s                               */
    M_H,                /* s                                            */
    M_D,                /* pu torque / pu speed                         */
    M_BY_SPEED,         /* 1: Tm = (Pm - D slip)/(1 + slip), as PSS/E   */
    M_SATURATES, M_SAT_A, M_SAT_B, M_SAT_EMF,  /* explicit saturation (machine_saturation)         */
    M_SAT_Q1, M_SAT_Q2,                        /* its share on ed1, on ed2                         */
    M_EFD0, M_PM0, M_VT0,  /* at the operating point; classical: M_EFD0 is the EMF */
    M_PARAMETERS,            /* what follows from these (machine_prepare)    */
    M_A = M_PARAMETERS, M_B, /* (Xd2 - Xl)/(Xd1 - Xl), (Xq2 - Xl)/(Xq1 - Xl) */
    M_LEAK_D, M_LEAK_Q, /* 1/(Xd1 - Xl), 1/(Xq1 - Xl)                   */
    M_PER_TD01, M_PER_TD02, M_PER_TQ01, M_PER_TQ02, M_PER_2H, M_PER_RATIO,
    M_ROWS
};
enum {  /* group of devices of one kind and structure (devices.h)     */
    G_DEVICE, G_COUNT,  /* number in devices.h, how many                */
    G_HAS,              /* which optional parts are there               */
    G_STATE,            /* first state; quantity by quantity from there */
    G_TABLE, G_MACHINE, /* where in memory: its table, its machines     */
    G_ROWS
};
#define MOST_HAS 4503599627370496.0 /* 2^52: a double holds every whole number below */
enum {  /* what devices see at the operating point, for each place      */
    R_VT, R_VD, R_VQ, R_ID, R_IQ, R_PE, R_IFD, R_VC, R_VS, R_PM, R_EFD, R_OUT, R_ROWS
};
enum {  /* branch: its 2 x 2 admittance, system base */
    B_FF_RE, B_FF_IM, B_FT_RE, B_FT_IM, B_TF_RE, B_TF_IM, B_TT_RE, B_TT_IM, B_ROWS
};
enum {  /* load, drawn at voltage V0 */
    L_P, L_Q, L_V0, L_ROWS
};
/* Port: where a nonlinear element meets the linear network (port.h). Ports lie
 * one after the other, P_ROWS numbers each: loads', those of devices at buses, machines'.
 * A load's voltages are relative to V0. */
enum {
    P_KIND, P_DEVICE,   /* number of the load, machine, device at a bus */
    P_ON,               /* 0 when its machine or device is tripped      */
    P_LOAD,             /* first row of what only a load has            */
    P_P = P_LOAD, P_Q,  /* drawn at V0 now, load steps included         */
    P_PER_V0,           /* 1/V0                                         */
    P_LOW_I, P_LOW_P,   /* below: constant impedance in place of constant current, power */
    P_P_MIX,            /* constant-current share, constant-power share, share that    */
    P_Q_MIX = P_P_MIX + 5, /* follows an exponent, the exponent, voltage below which it
                           does not any more; the rest is constant impedance        */
    P_ROWS = P_Q_MIX + 10
};
enum {  /* the same rows at the port of a device at a bus (bus_device.h) */
    P_BUS = P_LOAD,     /* position of its bus                          */
    P_STATE,            /* state that couples                           */
    P_SCALE, P_BIAS,    /* what it makes of it, system base             */
    P_COUPLING,         /* CouplingKind                                 */
    P_REST,             /* that at rest                                 */
    P_SEES,             /* 1 + device whose input is the voltage here, 0: none */
    P_LOW,              /* voltage below which a current falls with it  */
    P_STATE_Q,          /* of a converter: state of its reactive current; P_STATE is that of the active one */
    P_REST_Q,           /* that at rest, system base                    */
    P_ZERO, P_FULL,     /* voltages between which its active current rises from 0 */
    P_HIGH,             /* voltage above which reactive current is taken off */
    P_TAKEN,            /* and how much by voltage, system base         */
    P_LEAST,            /* but not below this, system base              */
    P_DIRECTION,        /* sum of 1 where its device sees the direction of the voltage, 2 what a plant control measures,
                           4 voltage and current by components */
    P_FAR,              /* 1 at the second end of a dc link with such converters */
    P_SHUNT,            /* by how much the voltage takes active current off, system base: of a voltage behind an impedance */
    P_DROP_R, P_DROP_X  /* of the voltage that a plant control sees, by the current there, system base */
};
enum {  /* the same rows at a port that only measures for the converter whose port is before it, where a plant control
           does not see its own bus: at the bus that it regulates, then, with a branch, at both ends of that */
    P_MEASURES = P_ZERO, /* MeasureKind                                  */
    P_OWN_RE, P_OWN_IM, P_MUTUAL_RE, P_MUTUAL_IM, /* at the first end: admittances of the branch seen from there */
    P_BRANCH            /* its number                                   */
};
typedef enum { MEASURE_VOLTAGE, MEASURE_REGULATED, MEASURE_FLOW, MEASURE_END, MEASURE_KINDS } MeasureKind;
enum {  /* the same rows at a voltage source; P_STATE is that of its angle, P_STATE_Q that of its voltage */
    P_COND = P_ZERO,    /* 1/(R + jX) of its impedance, system base     */
    P_SUSC,
    P_MOST              /* largest current, system base; 0: no limit    */
};
enum {  /* the same rows at an end of a dc link, currents and dc voltages on its base, angles in rad (dc_link.h) */
    P_ORDER = P_ZERO,   /* state of the current order; P_STATE is that of the current, P_STATE_Q that of the angle */
    P_NO_LOAD,          /* dc voltage without current, angle 0, at an ac voltage of 1 pu; P_SCALE: ac current by the dc one */
    P_DROP,             /* commutation: fall of the dc voltage by the current */
    P_GAIN,             /* of the angle: by the current of a rectifier, by the dc voltage of an inverter */
    P_ANGLE_MIN, P_ANGLE_MAX,
    P_MARGIN, P_MARGIN_GAIN, /* inverter: share of the order below which its angle follows the current too, and how much */
    P_PER_VREF,         /* inverter: 1 over the dc voltage that it holds */
    P_DROP_SHARE        /* P_DROP over P_NO_LOAD                        */
};
enum {  /* the same rows at a machine's port */
    P_SATURATION = P_LOAD, /* SaturationKind                            */
    P_X2,               /* Xd2 - Xl                                     */
    P_XQ2,              /* Xq2 - Xl                                     */
    P_PER_LD, P_PER_LQ, /* 1/(Xd - Xl), 1/(Xq - Xl)                     */
    P_ASAT, P_BSAT, P_PSIT1,
    P_PSID0, P_PSIQ0, P_ISD0, P_ISQ0, /* at the operating point         */
    P_SLOPE,            /* incremental: Bsat psi_I there                */
    P_SALIENCY          /* 1/(Xd2 - Xl) - 1/(Xq2 - Xl)                  */
};
#define PLACE_INPUTS 3u   /* most inputs of a place: vs, vc, vm of flow.h */
/* Of a place: 1 it runs, 0 it is tripped, between them a dc link that is blocked. */
#define RUNNING_BLOCKED 0.25
typedef enum { PORT_LOAD = 1, PORT_MACHINE, PORT_DEVICE, PORT_KINDS } PortKind;
typedef enum { COUPLING_NONE, COUPLING_SUSCEPTANCE, COUPLING_CURRENT, COUPLING_CONVERTER, COUPLING_RECTIFIER,
               COUPLING_INVERTER, COUPLING_SOURCE, COUPLING_KINDS } CouplingKind;
typedef enum { SATURATION_NONE, SATURATION_TOTAL, SATURATION_INCREMENTAL } SaturationKind;

/* What is shown, outputs and then locals: its kind and which machine, bus or line. */
typedef enum {
    SHOW_DW, SHOW_DELTA, SHOW_PE, SHOW_VT, SHOW_TIE, SHOW_BUS_V, SHOW_EFD, SHOW_PM, SHOW_LINE_P, SHOW_LINE_Q,
    SHOW_LINE_I, SHOW_BUS_ANGLE, SHOW_BUS_RE, SHOW_BUS_IM, SHOW_DEVICE_Q, SHOW_DEVICE_P,
    SHOW_DEVICE_ANGLE, SHOW_KINDS
} ShowKind;
enum {  /* tie branch: buses of its measured and its other end, admittances seen from there */
    T_BRANCH, T_OWN, T_OTHER, T_OWN_RE, T_OWN_IM, T_MUTUAL_RE, T_MUTUAL_IM, T_ROWS
};

/* Header of memory; then the plan itself. */
enum {
    H_READY, H_OMEGA_B,
    H_TRIPPED,          /* machines and devices at buses that are tripped */
    H_PORT_READY,       /* folded: 1: port_b and port_z are good for this stage */
    H_PORT_FOLDS,       /* how often slopes other than those at rest were wanted since those were last folded (port.h) */
    H_PATTERN,          /* sparse network: where its pattern begins in the record */
    H_PARTS, H_DEAD,    /* parts of the network with a machine; buses in parts without one */
    H_FACTORS,          /* sparse: how many factors with slopes have been made */
    H_PORT_PATH,        /* sparse: rows of port_path                    */
    H_SOURCES,          /* ports at voltage sources                     */
    H_PLAN
};

/* What evaluations change where ports are folded (port.h): the time of the coming one, s; by how much the last
 * solution's steps brought it closer; when the slopes at rest are tried again, INFINITY: they are in use, and how long
 * others are kept, s; times of the last three solutions, newest first, INFINITY: none; then port voltages of the newest
 * and what they hold beyond `b` of all three, 2 n_port each; then what ends of dc links hold, DC_HELD n_port,
 * INFINITY: nothing; then of each stage of a step by how much its solution missed where those before pointed to, 2 n_port each. */
enum { W_TIME, W_RATIO, W_REST, W_WAIT, W_FIRST, W_SECOND, W_THIRD, W_V };
enum { PORT_STAGES = 4 };
/* An end of a dc link: its angle in the newest solution, then one nearby with its sine and cosine (dc_link.h). */
enum { DC_LAST, DC_NEARBY, DC_NEARBY_SINE, DC_NEARBY_COSINE, DC_HELD };
/* The same where slopes are in the factors (sparse_port.h): that time; by how much a step has brought the ports closer;
 * solutions with those slopes; 1: they are good for this stage; number of the factors with them, of H_FACTORS: where
 * others are there, a step has been undone. Then slopes and voltages of the ports. */
enum { F_TIME, F_RATIO, F_USED, F_READY, F_NUMBER, F_SLOPES };

/* FMI parameters of a slot: Reals start, end, size, size_q, r, x, rise, those of a relay, frequency;
 * integers kind, target, wave, seed. */
enum {
    SLOT_START, SLOT_END, SLOT_SIZE, SLOT_SIZE_Q, SLOT_R, SLOT_X, SLOT_RISE,
    SLOT_THRESHOLD, SLOT_DELAY, SLOT_BREAKER, SLOT_FILTER, SLOT_FREQUENCY, SLOT_REALS
};
enum { SLOT_KIND, SLOT_TARGET, SLOT_WAVE, SLOT_SEED, SLOT_INTEGERS };
enum {  /* relay of a slot: when it last looked (-INFINITY: never), the angle then, the frequency that it sees in pu of
           the rated one, since when that is beyond the threshold and when the breaker opens (INFINITY: not at all) */
    RELAY_TIME, RELAY_ANGLE, RELAY_FREQUENCY, RELAY_SINCE, RELAY_OPENS, RELAY_ROWS
};

typedef struct {
    size_t n_machine, n_sixth, n_bus, n_branch, n_load;
    size_t wide;          /* 1 where a device has more than 64 decisions */
    size_t n_group, n_device, n_decision, n_table, n_input, n_tie, n_slot, n_port, n_state;
    size_t n_at_bus;      /* devices at buses; of n_place, they come after the machines */
    size_t n_place;       /* n_machine + n_at_bus: where devices have their signals */
    size_t n_line;        /* branches whose power is shown, after the ties         */
    size_t n_y, n_w;      /* outputs, locals                                       */
    size_t n_node, n_fill, first;  /* sparse network: rows, entries of L and of U, first row a current enters;
                                      n_node is 0 where the network is dense */
    size_t reduced;       /* sparse, without ports: rates take the currents from a dense product, 1 or 0 */
    size_t exciters;      /* groups before this one run before the inputs are added */
    size_t n_source;      /* n_machine + n_port: EMFs, then what the ports inject  */
    /* offsets into memory, in doubles */
    size_t machine;       /* M_ROWS x n_machine                                    */
    size_t machine_bus;   /* n_machine                                             */
    size_t coi;           /* n_machine: weight in its part's centre of inertia     */
    size_t part;          /* n_machine: first machine of its part of the network   */
    size_t running;       /* n_place: 1, or 0 after a trip                         */
    size_t pm_step;       /* n_machine: added to the mechanical power, machine base */
    size_t vref_step;     /* n_place: added at the exciter's summing point       */
    size_t rest;          /* R_ROWS x n_place                                      */
    size_t group;         /* G_ROWS for each group, in the order in which they run */
    size_t device_machine; /* n_device: places, group by group                     */
    size_t device_table;  /* n_table: tables, group by group                       */
    size_t input_machine; /* n_input: the place an input acts on; n_place more for each further input of a place */
    size_t tie;           /* T_ROWS x (n_tie + n_line): branches whose power is the output tie_p, then lines */
    size_t show;          /* ShowKind of n_y + n_w, then of which                  */
    size_t bus_part;      /* n_bus: first machine of the part of the network       */
    size_t in_service;    /* n_branch: 1 or 0                                      */
    size_t relay;         /* RELAY_ROWS for each slot (relay.c)                    */
    size_t state_machine; /* n_state: the place a state belongs to                 */
    size_t norton;        /* sparse: 2 x n_machine, admittance of each machine     */
    size_t few;           /* sparse: ports so few that they are solved by themselves (sparse_few.h), 1 or 0 */
    size_t folded;        /* ports as port.h has them: of a dense network, or few of a sparse one, 1 or 0 */
    size_t width;         /* sparse: numbers of an entry, 2 (complex) or, with more ports, 4 (2 x 2 real) */
    size_t lower, upper;  /* sparse: width n_fill each, the factors (sparse.h)     */
    size_t pivot;         /* sparse: width n_node, 1 over the diagonal of L        */
    size_t linear;        /* sparse, with width 4: the matrix without them, complex: lower, upper, diagonal */
    size_t y_re, y_im;    /* dense or reduced, n_source x n_machine: machine currents from sources */
    size_t v_re, v_im;    /* dense, n_bus x n_source: bus voltages from sources    */
    size_t port;          /* P_ROWS for each port                                  */
    size_t port_w_re, port_w_im; /* dense, n_source x n_port: port voltages from sources */
    size_t port_own_re, port_own_im; /* n_port x n_port: from what the ports inject, the last columns of those */
    size_t port_path;     /* sparse: rows between the ports and the last one, rising */
    size_t port_rest;     /* folded: 2 n_port, voltages at rest                    */
    size_t delta_rest;    /* folded: n_machine, rotor angles at rest               */
    size_t port_slope;    /* 4 n_port: dJ/dV of the folded network                 */
    size_t port_fold;     /* not folded: 2 n_port, voltages of those slopes        */
    size_t port_past;     /* not folded: times of the last three solutions, newest first; voltages of the older two */
    size_t port_b;        /* folded, columns of 2 n_port: of the EMFs' real parts, then of their imaginary ones;
                             few: of the ports' voltages without what they inject  */
    size_t port_z;        /* folded: 2 n_port columns of 2 n_port, from what slopes leave */
    size_t warm;          /* what evaluations change: W_V + 20 n_port, or F_SLOPES and slopes; the last of memory */
    size_t port_v;        /* 2 n_port: port voltages as last solved                */
    size_t total;
} Plan;
enum { PLAN_ROOM = (sizeof(Plan) + sizeof(double) - 1) / sizeof(double) };   /* of it in memory */

/* Whether the network is solved by its factors (sparse.h). A web page of a dense one leaves their code out. */
static inline int is_sparse(const Plan *p)
{
#ifdef PLANT_DENSE
    (void)p;
    return 0;
#else
    return p->n_node > 0;
#endif
}

/* Offsets from the counts. */
static inline void plan_offsets(Plan *p)
{
    size_t at = H_PLAN + PLAN_ROOM;
    const size_t n = p->n_machine, ports = p->n_port, sources = n + ports;
    const size_t sparse = is_sparse(p) ? 1 : 0, dense = 1 - sparse;
    p->n_source = sources;
    p->n_place = n + p->n_at_bus;
    p->machine = at;       at += (size_t)M_ROWS * n;
    p->machine_bus = at;   at += n;
    p->coi = at;           at += n;
    p->part = at;          at += n;
    p->running = at;       at += p->n_place;
    p->pm_step = at;       at += n;
    p->vref_step = at;     at += p->n_place;
    p->rest = at;          at += (size_t)R_ROWS * p->n_place;
    p->group = at;         at += (size_t)G_ROWS * p->n_group;
    p->device_machine = at; at += p->n_device;
    p->device_table = at;  at += p->n_table;
    p->input_machine = at; at += p->n_input;
    p->tie = at;           at += (size_t)T_ROWS * (p->n_tie + p->n_line);
    p->show = at;          at += 2u * (p->n_y + p->n_w);
    p->bus_part = at;      at += p->n_bus;
    p->in_service = at;    at += p->n_branch;
    p->relay = at;         at += (size_t)RELAY_ROWS * p->n_slot;
    p->state_machine = at; at += p->n_state;
    p->norton = at;        at += 2u * n * sparse;
    /* with 98 ports on 2000 buses a screening takes 10 minutes folded, 8 with slopes in the factors */
    p->few = ports > 0 && 8u * ports * ports <= p->n_fill ? sparse : 0;
    p->folded = ports > 0 ? dense + p->few : 0;
    p->width = ports > 0 && p->few == 0 ? 4 : 2;
    p->lower = at;         at += p->width * p->n_fill;
    p->upper = at;         at += p->width * p->n_fill;
    p->pivot = at;         at += p->width * p->n_node;
    p->linear = p->width == 4 ? at : p->lower;
    at += p->width == 4 ? 2u * (2u * p->n_fill + p->n_node) : 0u;
    p->y_re = at;          at += n * sources * (dense + p->reduced);
    p->y_im = at;          at += n * sources * (dense + p->reduced);
    p->v_re = at;          at += p->n_bus * sources * dense;
    p->v_im = at;          at += p->n_bus * sources * dense;
    p->port = at;          at += (size_t)P_ROWS * ports;
    p->port_w_re = at;     at += ports * sources * dense;
    p->port_w_im = at;     at += ports * sources * dense;
    p->port_own_re = dense ? p->port_w_re + ports * n : at;
    at += p->few * ports * ports;
    p->port_own_im = dense ? p->port_w_im + ports * n : at;
    at += p->few * ports * ports;
    p->port_path = at;     at += ports > 0 ? sparse * p->n_node : 0u;
    p->port_rest = at;     at += 2u * ports * p->folded;
    p->delta_rest = at;    at += n * p->folded;
    p->port_slope = at;    at += 4u * ports * p->folded;
    p->port_b = at;        at += 4u * ports * (n * dense + ports * p->few);
    p->port_z = at;        at += 4u * ports * ports * p->folded;
    p->warm = p->port_fold = p->port_past = at;   /* the plan is part of a saved state: every offset is set */
    if (p->folded > 0) {
        at += W_V;
    } else if (ports > 0) {
        at += F_SLOPES;
        p->port_slope = at;    at += 4u * ports;
        p->port_fold = at;     at += 2u * ports;
        p->port_past = at;     at += 3u + 4u * ports;
    }
    p->port_v = at;        at += (2u + (6u + DC_HELD + 2u * PORT_STAGES) * p->folded) * ports;
    p->total = at;
}

static inline int port_is_load(const stored *row) { return index_at(row, P_KIND) == PORT_LOAD; }
static inline int port_is_machine(const stored *row) { return index_at(row, P_KIND) == PORT_MACHINE; }

/* Of a device at a bus (bus_device.h). A web page of a grid that has none leaves their code out. */
static inline int port_is_device(const stored *row)
{
#ifdef PLANT_NO_BUS_DEVICES
    (void)row;
    return 0;
#else
    return index_at(row, P_KIND) == PORT_DEVICE;
#endif
}

static inline void plan_keep(double *memory, const Plan *p) { memcpy(memory + H_PLAN, p, sizeof *p); }

static inline void plan_of(const stored *memory, Plan *p)
{
    double words[PLAN_ROOM];
    for (size_t k = 0; k < PLAN_ROOM; ++k) words[k] = first_at(memory, H_PLAN + k);
    memcpy(p, words, sizeof *p);
}

/* The plan in memory; of several scenarios it lies scattered there and is put together in `own`. */
static inline const Plan *plan_in(const stored *memory, Plan *own)
{
#ifdef PLANT_LANES
    plan_of(memory, own);
    return own;
#else
    (void)own;
    return (const Plan *)(const void *)(memory + H_PLAN);
#endif
}
#endif
