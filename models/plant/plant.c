/* The plant as a block (block.h): reads the record, keeps the prepared numbers
 * in memory, hands the work to flow.c, tangent.c, event.c and stage.c. */
#include "plant.h"

#include "exciter.h"

#include <stdarg.h>
#include <stdio.h>

const int block_is_sampled = 0;

static const double READY = 20250101.0;

enum {
    C_MACHINE, C_SIXTH, C_BUS, C_BRANCH, C_LOAD, C_EXCITER, C_STABILIZER, C_GOVERNOR,
    C_TIE, C_SLOT, C_ITEM, C_PARAMETER, C_PORT, C_COUNTS
};
enum { TABLE_SOLVER, TABLE_EXCITER, TABLE_STABILIZER, TABLE_GOVERNOR };

BlockStatus plant_fail(BlockMessage *message, BlockStatus status, const char *format, ...)
{
    va_list args;
    va_start(args, format);
    (void)vsnprintf(message->text, sizeof message->text, format, args);
    va_end(args);
    return status;
}

const char *plant_name(const char *names, size_t k, char text[64])
{
    size_t length = 0;
    while (k > 0 && *names != '\0')
        if (*names++ == '\n') --k;
    while (length < 63 && names[length] != '\0' && names[length] != '\n') {
        text[length] = names[length];
        ++length;
    }
    text[length] = '\0';
    return text;
}

/* Everything the record must hold; `bad` keeps the first array that does not fit. */
typedef struct { const Record *record; const char *bad; } Reader;

static const double *reals(Reader *r, const char *name, size_t wanted)
{
    size_t count;
    const double *data = record_f64(r->record, name, &count);
    if (count != wanted && r->bad == NULL) r->bad = name;
    return data;
}

static const int32_t *integers(Reader *r, const char *name, size_t wanted, size_t below)
{
    size_t count;
    const int32_t *data = record_i32(r->record, name, &count);
    int fits = count == wanted;
    for (size_t k = 0; fits && k < count; ++k) fits = data[k] >= 0 && (size_t)data[k] < below;
    if (!fits && r->bad == NULL) r->bad = name;
    return data;
}

static const char *text_of(Reader *r, const char *name)
{
    size_t count;
    const char *data = record_text(r->record, name, &count);
    if ((data == NULL || count == 0 || data[count - 1] != '\0') && r->bad == NULL) r->bad = name;
    return data;
}

static const int32_t *read_plan(const Record *record, const BlockLayout *layout, Plan *plan)
{
    size_t count;
    const int32_t *c = record_i32(record, "plant.counts", &count);
    if (count != C_COUNTS) return NULL;
    for (size_t k = 0; k < C_COUNTS; ++k)
        if (c[k] < 0 || c[k] > 100000) return NULL;
    if (c[C_MACHINE] < 1 || c[C_SIXTH] > c[C_MACHINE] || c[C_BUS] < 1) return NULL;
    plan->n_machine = (size_t)c[C_MACHINE];
    plan->n_sixth = (size_t)c[C_SIXTH];
    plan->n_bus = (size_t)c[C_BUS];
    plan->n_branch = (size_t)c[C_BRANCH];
    plan->n_load = (size_t)c[C_LOAD];
    plan->n_exciter = (size_t)c[C_EXCITER];
    plan->n_stabilizer = (size_t)c[C_STABILIZER];
    plan->n_governor = (size_t)c[C_GOVERNOR];
    plan->n_tie = (size_t)c[C_TIE];
    plan->n_slot = (size_t)c[C_SLOT];
    plan->n_port = (size_t)c[C_PORT];
    plan->n_state = layout->n_x;
    plan_offsets(plan);
    return c;
}

static void read_network(Reader *r, const Plan *plan, const int32_t *counts, Network *net)
{
    const size_t n_bus = plan->n_bus, n_branch = plan->n_branch, n_load = plan->n_load;

    net->n_item = (size_t)counts[C_ITEM];
    net->machine_bus = integers(r, "machine.bus", plan->n_machine, n_bus);
    net->branch_from = integers(r, "branch.from", n_branch, n_bus);
    net->branch_to = integers(r, "branch.to", n_branch, n_bus);
    net->branch_status = integers(r, "branch.status", n_branch, 2);
    net->branch = reals(r, "branch.table", B_ROWS * n_branch);
    net->shunt = reals(r, "bus.shunt", 2 * n_bus);
    net->item_bus = integers(r, "shunt.bus", net->n_item, n_bus);
    net->item_status = integers(r, "shunt.status", net->n_item, 2);
    net->item = reals(r, "shunt.table", 2 * net->n_item);
    net->load_bus = integers(r, "load.bus", n_load, n_bus);
    net->load = reals(r, "load.table", L_ROWS * n_load);
    net->bus_names = text_of(r, "bus.names");
    net->branch_names = text_of(r, "branch.names");
    net->machine_names = text_of(r, "machine.names");
}

/* The prepared plan and network of a started block. */
static int prepared(const Block *b, Plan *plan, Network *net)
{
    Reader r = { b->record, NULL };
    const int32_t *counts;
    if (!(b->memory[H_READY] == READY)) return 0;
    counts = read_plan(b->record, &b->layout, plan);
    if (counts == NULL) return 0;
    read_network(&r, plan, counts, net);
    return r.bad == NULL;
}

/* The ports' table, its references checked. */
static const double *read_ports(Reader *r, const Plan *plan)
{
    const double *table = reals(r, "port.table", P_ROWS * plan->n_port);
    for (size_t k = 0; r->bad == NULL && k < plan->n_port; ++k) {
        const double *row = table + P_ROWS * k;
        const double below = (double)(port_is_load(row) ? plan->n_load : plan->n_machine);
        if (!(row[P_KIND] >= 1.0 && row[P_KIND] < 3.0
              && row[P_DEVICE] >= 0.0 && row[P_DEVICE] < below))
            r->bad = "port.table";
    }
    return table;
}

static size_t scratch_of(const Plan *plan, const BlockLayout *l)
{
    const size_t tangent = 2 * (2 * l->n_x + l->n_u + l->n_y + flow_work(plan)) + 2 * plan->n_machine;
    const size_t stage = 2 * plan->n_bus + stage_work(plan->n_bus);
    return tangent > stage ? tangent : stage;
}

BlockStatus block_needs(const Record *record, const BlockLayout *layout, BlockNeeds *needs,
                        BlockMessage *message)
{
    Plan plan;
    Network net;
    Reader r = { record, NULL };
    const int32_t *counts = read_plan(record, layout, &plan);

    if (counts == NULL)
        return plant_fail(message, BLOCK_ERROR, "record: plant.counts is missing or of another format");
    const size_t n = plan.n_machine, n_parameter = (size_t)counts[C_PARAMETER];
    read_network(&r, &plan, counts, &net);
    (void)reals(&r, "plant.base", 2);
    (void)reals(&r, "machine.table", M_GIVEN * n);
    (void)reals(&r, "exciter.table", E_ROWS * plan.n_exciter);
    (void)integers(&r, "exciter.kind", plan.n_exciter, 100);
    (void)integers(&r, "exciter.machine", plan.n_exciter, n);
    (void)integers(&r, "exciter.input", plan.n_exciter, layout->n_u);
    (void)integers(&r, "exciter.state", plan.n_exciter, layout->n_x);
    (void)reals(&r, "stabilizer.table", S_ROWS * plan.n_stabilizer);
    (void)integers(&r, "stabilizer.machine", plan.n_stabilizer, n);
    (void)integers(&r, "stabilizer.state", plan.n_stabilizer, layout->n_x);
    (void)reals(&r, "governor.table", G_ROWS * plan.n_governor);
    (void)integers(&r, "governor.kind", plan.n_governor, 100);
    (void)integers(&r, "governor.machine", plan.n_governor, n);
    (void)integers(&r, "governor.state", plan.n_governor, layout->n_x);
    read_ports(&r, &plan);
    (void)integers(&r, "state.machine", layout->n_x, n);
    (void)integers(&r, "tie.branch", plan.n_tie, plan.n_branch);
    (void)integers(&r, "tie.end", plan.n_tie, 2);
    (void)integers(&r, "parameter.table", n_parameter, 4);
    (void)integers(&r, "parameter.row", n_parameter, 100);
    (void)integers(&r, "parameter.device", n_parameter, 100000);
    (void)reals(&r, "parameter.range", 2 * n_parameter);
    (void)text_of(&r, "parameter.names");
    if (r.bad != NULL)
        return plant_fail(message, BLOCK_ERROR,
                          "record: array %s is missing, has another length, or points outside", r.bad);
    if (layout->n_y != 4 * n + (plan.n_tie > 0 ? 1u : 0u) || layout->n_w != plan.n_bus + 2 * n
        || layout->n_u != plan.n_exciter || layout->n_p != n_parameter + SLOT_REALS * plan.n_slot
        || layout->n_ip != SLOT_INTEGERS * plan.n_slot || layout->n_x < 2 * n + 4 * plan.n_sixth)
        return plant_fail(message, BLOCK_ERROR, "record: its counts disagree with the list of variables");
    needs->n_memory = plan.total;
    needs->n_scratch = scratch_of(&plan, layout);
    return BLOCK_OK;
}

static void copy_reals(double *to, const double *from, size_t n)
{
    for (size_t k = 0; k < n; ++k) to[k] = from[k];
}

static void copy_integers(double *to, const int32_t *from, size_t n)
{
    for (size_t k = 0; k < n; ++k) to[k] = (double)from[k];
}

static void read_tables(const Record *record, const Plan *plan, const Network *net, double *memory)
{
    Reader r = { record, NULL };
    const size_t n = plan->n_machine, e = plan->n_exciter, s = plan->n_stabilizer, g = plan->n_governor;

    copy_reals(memory + plan->machine, reals(&r, "machine.table", M_GIVEN * n), M_GIVEN * n);
    machine_prepare(memory + plan->machine, n, plan->n_sixth);
    copy_integers(memory + plan->machine_bus, net->machine_bus, n);
    copy_reals(memory + plan->exciter, reals(&r, "exciter.table", E_ROWS * e), E_ROWS * e);
    copy_integers(memory + plan->exciter_of, integers(&r, "exciter.kind", e, 100), e);
    copy_integers(memory + plan->exciter_of + e, integers(&r, "exciter.machine", e, n), e);
    copy_integers(memory + plan->exciter_of + 2 * e, integers(&r, "exciter.input", e, e), e);
    copy_integers(memory + plan->exciter_of + 3 * e, integers(&r, "exciter.state", e, SIZE_MAX), e);
    copy_reals(memory + plan->stabilizer, reals(&r, "stabilizer.table", S_ROWS * s), S_ROWS * s);
    copy_integers(memory + plan->stabilizer_of, integers(&r, "stabilizer.machine", s, n), s);
    copy_integers(memory + plan->stabilizer_of + s, integers(&r, "stabilizer.state", s, SIZE_MAX), s);
    copy_reals(memory + plan->governor, reals(&r, "governor.table", G_ROWS * g), G_ROWS * g);
    copy_integers(memory + plan->governor_of, integers(&r, "governor.kind", g, 100), g);
    copy_integers(memory + plan->governor_of + g, integers(&r, "governor.machine", g, n), g);
    copy_integers(memory + plan->governor_of + 2 * g, integers(&r, "governor.state", g, SIZE_MAX), g);
    copy_integers(memory + plan->state_machine, integers(&r, "state.machine", plan->n_state, n), plan->n_state);
    copy_reals(memory + plan->port, read_ports(&r, plan), P_ROWS * plan->n_port);
}

static void read_tie(const Record *record, const Plan *plan, const Network *net, double *memory)
{
    Reader r = { record, NULL };
    const size_t n = plan->n_tie, m = plan->n_branch;
    const int32_t *branch = integers(&r, "tie.branch", n, m), *end = integers(&r, "tie.end", n, 2);

    for (size_t k = 0; k < n; ++k) {
        const size_t line = (size_t)branch[k];
        const int far = end[k] != 0;
        const double *y = net->branch + line;
        double *row = memory + plan->tie + k;
        row[T_BRANCH * n] = (double)line;
        row[T_OWN * n] = (double)(far ? net->branch_to[line] : net->branch_from[line]);
        row[T_OTHER * n] = (double)(far ? net->branch_from[line] : net->branch_to[line]);
        row[T_OWN_RE * n] = y[(far ? B_TT_RE : B_FF_RE) * m];
        row[T_OWN_IM * n] = y[(far ? B_TT_IM : B_FF_IM) * m];
        row[T_MUTUAL_RE * n] = y[(far ? B_TF_RE : B_FT_RE) * m];
        row[T_MUTUAL_IM * n] = y[(far ? B_TF_IM : B_FT_IM) * m];
    }
}

/* FMI parameters over the tables, each checked against its range. */
static BlockStatus read_parameters(const Block *b, const Plan *plan, double *memory, BlockMessage *message)
{
    Reader r = { b->record, NULL };
    const size_t n = b->layout.n_p - SLOT_REALS * plan->n_slot;
    const int32_t *table = integers(&r, "parameter.table", n, 4);
    const int32_t *row = integers(&r, "parameter.row", n, 100);
    const int32_t *device = integers(&r, "parameter.device", n, 100000);
    const double *range = reals(&r, "parameter.range", 2 * n);
    const char *names = text_of(&r, "parameter.names");
    char name[64];

    for (size_t k = 0; k < n; ++k) {
        const double value = b->p[k];
        if (!(value >= range[k] && value <= range[n + k]))
            return plant_fail(message, BLOCK_ERROR, "parameter %s = %g, allowed: %g to %g",
                              plant_name(names, k, name), value, range[k], range[n + k]);
        if (table[k] == TABLE_SOLVER) continue;   /* the FMI layer's own */
        const size_t start = table[k] == TABLE_EXCITER ? plan->exciter
            : table[k] == TABLE_STABILIZER ? plan->stabilizer : plan->governor;
        const size_t rows = table[k] == TABLE_EXCITER ? (size_t)E_ROWS
            : table[k] == TABLE_STABILIZER ? (size_t)S_ROWS : (size_t)G_ROWS;
        const size_t count = table[k] == TABLE_EXCITER ? plan->n_exciter
            : table[k] == TABLE_STABILIZER ? plan->n_stabilizer : plan->n_governor;
        if ((size_t)row[k] >= rows || (size_t)device[k] >= count)
            return plant_fail(message, BLOCK_ERROR, "record: parameter %s points outside its table",
                              plant_name(names, k, name));
        memory[start + (size_t)row[k] * count + (size_t)device[k]] = value;
    }
    return BLOCK_OK;
}

/* Vref such that the operating point stays an equilibrium for the parameters in
 * use; the exciter's states at rest move with them. */
static BlockStatus set_references(Block *b, const Plan *plan, const Network *net, BlockMessage *message)
{
    const size_t n = plan->n_exciter, m = plan->n_machine;
    const double *machine = b->memory + plan->machine, *of = b->memory + plan->exciter_of;
    size_t count;
    const double *original = record_f64(b->record, "exciter.table", &count);
    char name[64];

    for (size_t k = 0; k < n; ++k) {
        double *p = b->memory + plan->exciter + k;
        const size_t kind = index_at(of, k), at = index_at(of, n + k), state = index_at(of, 3 * n + k);
        const double efd = machine[M_EFD0 * m + at], vt = machine[M_VT0 * m + at];
        double before[EXCITER_STATES], after[EXCITER_STATES], low, high;
        const double limited = exciter_limited(p, n, kind, efd, vt, &low, &high);
        if (!(limited >= low && limited <= high))
            return plant_fail(message, BLOCK_ERROR,
                              "%s.exciter: the %s at the operating point is %g, outside the limits %g to %g",
                              plant_name(net->machine_names, at, name),
                              kind == EXCITER_DC1 ? "regulator's output" : "field voltage", limited, low, high);
        p[E_VREF * n] = exciter_rest(p, n, kind, efd, vt, after);
        (void)exciter_rest(original + k, n, kind, efd, vt, before);
        for (size_t j = 0; j < EXCITER_STATES; ++j)
            if (after[j] != before[j]) b->x[state + j] += after[j] - before[j];
    }
    return BLOCK_OK;
}

BlockStatus block_start(Block *b, double t, BlockMessage *message)
{
    Plan plan;
    Network net;
    Reader r = { b->record, NULL };
    const int32_t *counts = read_plan(b->record, &b->layout, &plan);
    BlockStatus status;
    size_t count;

    if (counts == NULL) return plant_fail(message, BLOCK_ERROR, "record: plant.counts is missing");
    read_network(&r, &plan, counts, &net);
    if (r.bad != NULL) return plant_fail(message, BLOCK_ERROR, "record: array %s is missing", r.bad);

    double *memory = b->memory;
    for (size_t k = 0; k < plan.total; ++k) memory[k] = 0.0;
    memory[H_OMEGA_B] = record_f64(b->record, "plant.base", &count)[0];
    memory[H_N_MACHINE] = (double)plan.n_machine;
    memory[H_N_SIXTH] = (double)plan.n_sixth;
    memory[H_N_BUS] = (double)plan.n_bus;
    memory[H_N_BRANCH] = (double)plan.n_branch;
    memory[H_N_LOAD] = (double)plan.n_load;
    memory[H_N_EXCITER] = (double)plan.n_exciter;
    memory[H_N_STABILIZER] = (double)plan.n_stabilizer;
    memory[H_N_GOVERNOR] = (double)plan.n_governor;
    memory[H_N_TIE] = (double)plan.n_tie;
    memory[H_N_SLOT] = (double)plan.n_slot;
    memory[H_N_PORT] = (double)plan.n_port;
    memory[H_N_STATE] = (double)plan.n_state;
    read_tables(b->record, &plan, &net, memory);
    read_tie(b->record, &plan, &net, memory);
    status = read_parameters(b, &plan, memory, message);
    if (status == BLOCK_OK) status = set_references(b, &plan, &net, message);
    if (status == BLOCK_OK) status = event_check(b, &plan, &net, message);
    if (status == BLOCK_OK) status = event_apply(b, &plan, &net, t, message);
    if (status == BLOCK_OK) memory[H_READY] = READY;
    return status;
}

/* Newton's method failed at port `stuck` - 1. */
static BlockStatus unsolved(const Block *b, size_t stuck, double t, BlockMessage *message)
{
    Plan plan;
    Network net;
    char name[64];

    if (!prepared(b, &plan, &net))
        return plant_fail(message, BLOCK_ERROR, "plant: the network has no solution at t = %.9g s", t);
    const double *row = b->memory + plan.port + P_ROWS * (stuck - 1);
    const size_t k = index_at(row, P_DEVICE);
    const int load = port_is_load(row);
    return plant_fail(message, BLOCK_DISCARD,
                      "network: no voltage found at bus %s for %s at t = %.9g s (Newton's method, residual "
                      "still above 1e-11 pu); the voltage there has collapsed or a state is not finite",
                      plant_name(net.bus_names, (size_t)(load ? net.load_bus[k] : net.machine_bus[k]), name),
                      load ? "a load that is not constant impedance" : "the saturation of a machine", t);
}

static BlockStatus not_started(BlockMessage *message)
{
    return plant_fail(message, BLOCK_ERROR, "plant: used before block_start");
}

BlockStatus block_derivatives(Block *b, double t, const double *x, const double *u, double *dx,
                              BlockMessage *message)
{
    if (!(b->memory[H_READY] == READY)) return not_started(message);
    const size_t stuck = plant_flow(b->memory, x, u, dx, b->scratch);
    return stuck == 0 ? BLOCK_OK : unsolved(b, stuck, t, message);
}

BlockStatus block_outputs(Block *b, double t, const double *x, const double *u, double *y,
                          BlockMessage *message)
{
    Plan plan;

    if (!(b->memory[H_READY] == READY)) return not_started(message);
    plan_of(b->memory, &plan);
    size_t stuck = plant_outputs(b->memory, x, y, b->scratch);
    if (b->w != NULL && stuck == 0)
        stuck = plant_locals(b->memory, x, u, b->w, b->scratch, b->scratch + flow_work(&plan));
    return stuck == 0 ? BLOCK_OK : unsolved(b, stuck, t, message);
}

BlockStatus block_directional(Block *b, double t, const double *x, const double *u, const double *vx,
                              const double *vu, double *vdx, double *vy, BlockMessage *message)
{
    if (!(b->memory[H_READY] == READY)) return not_started(message);
    const size_t stuck = plant_directional(b->memory, &b->layout, x, u, vx, vu, vdx, vy, b->scratch);
    return stuck == 0 ? BLOCK_OK : unsolved(b, stuck, t, message);
}

double block_next_event(const Block *b, double t)
{
    Plan plan;
    if (!(b->memory[H_READY] == READY)) return INFINITY;
    plan_of(b->memory, &plan);
    return event_next(b, &plan, t);
}

BlockStatus block_event(Block *b, double t, double *x, BlockMessage *message)
{
    Plan plan;
    Network net;

    (void)x;
    if (!prepared(b, &plan, &net)) return not_started(message);
    /* the slots may have been set anew since the start */
    const BlockStatus status = event_check(b, &plan, &net, message);
    return status == BLOCK_OK ? event_apply(b, &plan, &net, t, message) : status;
}

BlockStatus block_step(Block *b, double t, double h, const double *u_poly, double *dy,
                       BlockMessage *message)
{
    (void)b;
    (void)t;
    (void)h;
    (void)u_poly;
    (void)dy;
    return plant_fail(message, BLOCK_ERROR, "plant: not a sampled block; integrate block_derivatives");
}
