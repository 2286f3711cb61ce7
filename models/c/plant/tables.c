/* The arrays of the record: their lengths and references checked once, their numbers
 * copied into memory, the FMI parameters over them. */
#include "plant.h"

#include "machine.h"

enum {
    C_MACHINE, C_SIXTH, C_BUS, C_BRANCH, C_LOAD, C_EXCITER, C_STABILIZER, C_GOVERNOR,
    C_TIE, C_SLOT, C_ITEM, C_PARAMETER, C_PORT, C_COUNTS
};
enum { TABLE_SOLVER, TABLE_EXCITER, TABLE_STABILIZER, TABLE_GOVERNOR };

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

static BlockStatus unfit(const Reader *r, BlockMessage *message)
{
    return plant_fail(message, BLOCK_ERROR,
                      "record: array %s is missing, has another length, or points outside", r->bad);
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

BlockStatus plant_read(const Record *record, const BlockLayout *layout, Plan *plan, Network *net,
                       BlockMessage *message)
{
    Reader r = { record, NULL };
    const int32_t *counts = read_plan(record, layout, plan);

    if (counts == NULL)
        return plant_fail(message, BLOCK_ERROR, "record: plant.counts is missing or of another format");
    read_network(&r, plan, counts, net);
    return r.bad == NULL ? BLOCK_OK : unfit(&r, message);
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

BlockStatus plant_check(const Record *record, const BlockLayout *layout, const Plan *plan,
                        BlockMessage *message)
{
    Reader r = { record, NULL };
    const size_t n = plan->n_machine, n_parameter = layout->n_p - SLOT_REALS * plan->n_slot;
    size_t count;

    if (layout->n_y != 4 * n + (plan->n_tie > 0 ? 1u : 0u) || layout->n_w != plan->n_bus + 2 * n
        || layout->n_u != plan->n_exciter || layout->n_p < SLOT_REALS * plan->n_slot
        || n_parameter != (size_t)record_i32(record, "plant.counts", &count)[C_PARAMETER]
        || layout->n_ip != SLOT_INTEGERS * plan->n_slot || layout->n_x < 2 * n + 4 * plan->n_sixth)
        return plant_fail(message, BLOCK_ERROR, "record: its counts disagree with the list of variables");
    (void)reals(&r, "plant.base", 2);
    (void)reals(&r, "machine.table", M_GIVEN * n);
    (void)reals(&r, "exciter.table", E_ROWS * plan->n_exciter);
    (void)integers(&r, "exciter.kind", plan->n_exciter, 100);
    (void)integers(&r, "exciter.machine", plan->n_exciter, n);
    (void)integers(&r, "exciter.input", plan->n_exciter, layout->n_u);
    (void)integers(&r, "exciter.state", plan->n_exciter, layout->n_x);
    (void)reals(&r, "stabilizer.table", S_ROWS * plan->n_stabilizer);
    (void)integers(&r, "stabilizer.machine", plan->n_stabilizer, n);
    (void)integers(&r, "stabilizer.state", plan->n_stabilizer, layout->n_x);
    (void)reals(&r, "governor.table", G_ROWS * plan->n_governor);
    (void)integers(&r, "governor.kind", plan->n_governor, 100);
    (void)integers(&r, "governor.machine", plan->n_governor, n);
    (void)integers(&r, "governor.state", plan->n_governor, layout->n_x);
    (void)read_ports(&r, plan);
    (void)integers(&r, "state.machine", layout->n_x, n);
    (void)integers(&r, "tie.branch", plan->n_tie, plan->n_branch);
    (void)integers(&r, "tie.end", plan->n_tie, 2);
    (void)integers(&r, "parameter.table", n_parameter, 4);
    (void)integers(&r, "parameter.row", n_parameter, 100);
    (void)integers(&r, "parameter.device", n_parameter, 100000);
    (void)reals(&r, "parameter.range", 2 * n_parameter);
    (void)text_of(&r, "parameter.names");
    return r.bad == NULL ? BLOCK_OK : unfit(&r, message);
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

BlockStatus plant_tables(Block *b, const Plan *plan, const Network *net, BlockMessage *message)
{
    read_tables(b->record, plan, net, b->memory);
    read_tie(b->record, plan, net, b->memory);
    return read_parameters(b, plan, b->memory, message);
}
