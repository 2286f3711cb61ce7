/* The arrays of the record: their lengths and references checked once, their numbers
 * copied into memory, the FMI parameters over them. */
#include "tables.h"

#include "devices.h"
#include "failure.h"
#include "../machine/machine.h"
#include "../network/sparse.h"

enum {
    C_MACHINE, C_SIXTH, C_BUS, C_BRANCH, C_LOAD, C_GROUP, C_EXCITERS,
    C_TIE, C_SLOT, C_ITEM, C_PARAMETER, C_PORT, C_NODE, C_FILL, C_FIRST, C_REDUCED, C_LINE, C_AT_BUS, C_COUNTS
};

/* Everything the record must hold; `bad` keeps the first array that does not fit. */
typedef struct { const Record *record; const char *bad; } Reader;

static const double *reals(Reader *r, const char *name, size_t expected)
{
    size_t count;
    const double *data = record_f64(r->record, name, &count);
    if (count != expected && r->bad == NULL) r->bad = name;
    return data;
}

static const int32_t *integers(Reader *r, const char *name, size_t expected, size_t below)
{
    size_t count;
    const int32_t *data = record_i32(r->record, name, &count);
    int fits = count == expected;
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

/* Rows and devices of all groups; 0: the groups do not fit together. */
static int count_devices(const Record *record, Plan *plan)
{
    size_t count, same;
    const int32_t *device = record_i32(record, "group.device", &count), *n = record_i32(record, "group.count", &same);
    if (count != plan->n_group || same != count) return 0;
    plan->n_device = plan->n_decision = plan->n_table = plan->wide = 0;
    for (size_t k = 0; k < count; ++k) {
        if (device[k] < 0 || device[k] >= DEVICE_COUNT || n[k] < 1 || n[k] > 100000) return 0;
        plan->n_device += (size_t)n[k];
        plan->n_decision += (size_t)n[k] * device_decisions((size_t)device[k]);
        plan->n_table += (size_t)n[k] * device_rows((size_t)device[k]);
        if (device_decisions((size_t)device[k]) > 64) plan->wide = 1;
    }
    return 1;
}

/* Counts that can belong together. */
static int counts_fit(const int32_t *c)
{
    for (size_t k = 0; k < C_COUNTS; ++k)
        if (c[k] < 0 || c[k] > 100000000) return 0;
    if (c[C_NODE] > 0 && c[C_NODE] < c[C_BUS]) return 0;
    if (c[C_REDUCED] > 0 && (c[C_NODE] == 0 || c[C_PORT] > 0)) return 0;
    return c[C_MACHINE] >= 1 && c[C_SIXTH] <= c[C_MACHINE] && c[C_BUS] >= 1;
}

static const int32_t *read_plan(const Record *record, const BlockLayout *layout, Plan *plan)
{
    size_t count;
    const int32_t *c = record_i32(record, "plant.counts", &count);
    if (count != C_COUNTS || !counts_fit(c)) return NULL;
    plan->n_machine = (size_t)c[C_MACHINE];
    plan->n_sixth = (size_t)c[C_SIXTH];
    plan->n_bus = (size_t)c[C_BUS];
    plan->n_branch = (size_t)c[C_BRANCH];
    plan->n_load = (size_t)c[C_LOAD];
    plan->n_group = (size_t)c[C_GROUP];
    plan->exciters = (size_t)c[C_EXCITERS];
    plan->n_input = layout->n_u;
    plan->n_tie = (size_t)c[C_TIE];
    plan->n_slot = (size_t)c[C_SLOT];
    plan->n_port = (size_t)c[C_PORT];
    plan->n_state = layout->n_x;
    plan->n_node = (size_t)c[C_NODE];
    plan->n_fill = (size_t)c[C_FILL];
    plan->first = (size_t)c[C_FIRST];
    plan->reduced = c[C_REDUCED] > 0 ? 1 : 0;
    plan->n_line = (size_t)c[C_LINE];
    plan->n_at_bus = (size_t)c[C_AT_BUS];
    plan->n_y = layout->n_y;
    plan->n_w = layout->n_w;
    if (plan->exciters > plan->n_group || !count_devices(record, plan)) return NULL;
    if (plan->n_node > 0 && !is_sparse(plan)) return NULL;
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
    net->places = integers(r, "network.pattern", is_sparse(plan) ? pattern_size(plan) : 0, SIZE_MAX);
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

/* Starts of rows: from 0, never falling, to `fill`. */
static int rising(const int32_t *start, size_t n, size_t fill)
{
    int fits = start[0] == 0 && (size_t)start[n] == fill;
    for (size_t k = 0; fits && k < n; ++k) fits = start[k] <= start[k + 1];
    return fits;
}

/* Every place lies from `least` to before `end`. */
static int within(const int32_t *place, size_t count, size_t least, size_t end)
{
    for (size_t k = 0; k < count; ++k)
        if ((size_t)place[k] < least || (size_t)place[k] >= end) return 0;
    return 1;
}

/* Every place lies in its array: L strictly below the diagonal, U strictly above. */
static int pattern_fits(const Pattern *s, const Plan *plan)
{
    const size_t n = plan->n_node, fill = plan->n_fill;
    int fits = rising(s->lower, n, fill) && rising(s->upper, n, fill)
               && within(s->row, plan->n_bus, 0, n) && within(s->machine, plan->n_machine, plan->first, n)
               && within(s->port, plan->n_port, plan->first, n)
               && within(s->gap, 2 * (n - plan->n_bus), 0, 2 * fill)
               && within(s->branch, 2 * plan->n_branch, 0, 2 * fill);

    for (size_t k = 0; fits && k < n; ++k) {
        const size_t lower = (size_t)s->lower[k], upper = (size_t)s->upper[k];
        fits = s->needed[k] >= s->lower[k] && s->needed[k] <= s->lower[k + 1]
               && within(s->lower_column + lower, (size_t)s->lower[k + 1] - lower, 0, k)
               && within(s->upper_column + upper, (size_t)s->upper[k + 1] - upper, k + 1, n);
    }
    return fits;
}

/* Whether value is a whole number's place in `below` ones. */
static int is_place(double value, size_t below) { return value >= 0.0 && value < (double)below; }

/* What the row of a device at a bus points to is there. */
static int device_port_fits(const Plan *plan, const double *row)
{
    return is_place(row[P_BUS], plan->n_bus) && is_place(row[P_STATE], plan->n_state)
           && is_place(row[P_COUPLING], COUPLING_KINDS) && is_place(row[P_STATE_Q], plan->n_state) && is_place(row[P_SEES], plan->n_at_bus + 1)
           && (row[P_COUPLING] > 0.0 || (is_place(row[P_MEASURES], MEASURE_KINDS) && is_place(row[P_BRANCH], plan->n_branch > 0 ? plan->n_branch : 1)))
           && (row[P_COUPLING] < (double)COUPLING_RECTIFIER || row[P_COUPLING] == (double)COUPLING_SOURCE
               || is_place(row[P_ORDER], plan->n_state));
}

/* The ports' table, its references checked. */
static const double *read_ports(Reader *r, const Plan *plan)
{
    const double *table = reals(r, "port.table", P_ROWS * plan->n_port);
    for (size_t k = 0; r->bad == NULL && k < plan->n_port; ++k) {
        const double *row = table + P_ROWS * k;
        const size_t below[PORT_KINDS] = { 0, plan->n_load, plan->n_machine, plan->n_at_bus };
        const size_t kind = is_place(row[P_KIND], PORT_KINDS) ? (size_t)row[P_KIND] : 0;
        if (!is_place(row[P_DEVICE], below[kind]) || (kind == PORT_DEVICE && !(port_is_device(row) && device_port_fits(plan, row))))
            r->bad = "port.table";
    }
    return table;
}

static void check_pattern(Reader *r, const Plan *plan, const int32_t *places)
{
    const double *table = read_ports(r, plan);
    size_t gaps = 0;

    if (r->bad != NULL || !is_sparse(plan)) return;
    const Pattern s = pattern_of(places, plan);
    for (size_t p = 0; p < plan->n_port; ++p) gaps += port_is_machine(table + P_ROWS * p) ? 1 : 0;
    if (plan->n_node != plan->n_bus + gaps || plan->first >= plan->n_node || !pattern_fits(&s, plan))
        r->bad = "network.pattern";
}

/* Every group: its device is one of this binary, its states and tables lie inside. */
static void check_groups(Reader *r, const BlockLayout *layout, const Plan *plan)
{
    const size_t n = plan->n_group;
    const int32_t *device = integers(r, "group.device", n, DEVICE_COUNT), *count = integers(r, "group.count", n, 100001);
    const int32_t *state = integers(r, "group.state", n, layout->n_x + 1), *known;
    const double *has = reals(r, "group.has", n);
    size_t parameters = 0, length;

    (void)integers(r, "device.machine", plan->n_device, plan->n_place);
    known = record_i32(r->record, "device.signature", &length);
    if (r->bad == NULL && (length != 1 || (uint32_t)known[0] != DEVICE_SIGNATURE)) r->bad = "device.signature";
    for (size_t k = 0; r->bad == NULL && k < n; ++k) {
        const size_t number = (size_t)count[k];
        parameters += number * device_parameters((size_t)device[k]);
        if (!(has[k] >= 0.0 && has[k] < MOST_HAS))
            r->bad = "group.has";
        else if ((size_t)state[k] + number * device_states((size_t)device[k], (uint64_t)has[k]) > layout->n_x)
            r->bad = "group.state";
    }
    if (r->bad == NULL) (void)reals(r, "device.table", parameters);
}

/* What is shown exists; Efd and Pm, for which the devices must have run, are locals only. */
static void check_show(Reader *r, const Plan *plan)
{
    const size_t n = plan->n_y + plan->n_w;
    const int32_t *kind = integers(r, "show.kind", n, SHOW_KINDS), *of = integers(r, "show.of", n, SIZE_MAX);

    for (size_t k = 0; r->bad == NULL && k < n; ++k) {
        const int line = kind[k] >= SHOW_LINE_P && kind[k] <= SHOW_LINE_I;
        const int bus = kind[k] == SHOW_BUS_V || (kind[k] >= SHOW_BUS_ANGLE && kind[k] <= SHOW_BUS_IM);
        const size_t count = line ? plan->n_line : bus ? plan->n_bus
                           : kind[k] >= SHOW_DEVICE_Q ? plan->n_port : plan->n_machine;
        const int device = kind[k] == SHOW_EFD || kind[k] == SHOW_PM;
        if ((size_t)of[k] >= count || (device && k < plan->n_y)) r->bad = "show.of";
    }
}

BlockStatus plant_check(const Record *record, const BlockLayout *layout, const Plan *plan, const Network *net,
                        BlockMessage *message)
{
    Reader r = { record, NULL };
    const size_t n = plan->n_machine, n_parameter = layout->n_p - SLOT_REALS * plan->n_slot;
    size_t count;

    if (layout->n_p < SLOT_REALS * plan->n_slot
        || n_parameter != (size_t)record_i32(record, "plant.counts", &count)[C_PARAMETER]
        || layout->n_ip != SLOT_INTEGERS * plan->n_slot || layout->n_x < 2 * n + 4 * plan->n_sixth)
        return plant_fail(message, BLOCK_ERROR, "record: its counts disagree with the list of variables");
    (void)reals(&r, "plant.base", 2);
    (void)reals(&r, "machine.table", M_PARAMETERS * n);
    (void)reals(&r, "machine.rest", R_ROWS * plan->n_place);
    (void)reals(&r, "state.rest", layout->n_x);
    (void)reals(&r, "port.rest", 2 * plan->n_port);
    check_groups(&r, layout, plan);
    (void)integers(&r, "input.machine", plan->n_input, PLACE_INPUTS * plan->n_place);
    check_pattern(&r, plan, net->places);
    (void)integers(&r, "state.machine", layout->n_x, plan->n_place);
    (void)integers(&r, "tie.branch", plan->n_tie + plan->n_line, plan->n_branch);
    (void)integers(&r, "tie.end", plan->n_tie + plan->n_line, 2);
    check_show(&r, plan);
    (void)integers(&r, "parameter.table", n_parameter, plan->n_group + 1);
    (void)integers(&r, "parameter.row", n_parameter, 1000);
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

/* Groups, their machines, and the rows of their tables that the case gives. */
static void read_groups(Reader *r, const Plan *plan, double *memory)
{
    const size_t n = plan->n_group;
    const int32_t *device = integers(r, "group.device", n, DEVICE_COUNT), *count = integers(r, "group.count", n, 100001);
    const int32_t *state = integers(r, "group.state", n, SIZE_MAX);
    const double *has = reals(r, "group.has", n);
    size_t length, table = plan->device_table, machine = plan->device_machine;
    const double *parameters = record_f64(r->record, "device.table", &length);

    copy_integers(memory + machine, integers(r, "device.machine", plan->n_device, plan->n_place), plan->n_device);
    for (size_t k = 0; k < n; ++k) {
        double *row = memory + plan->group + G_ROWS * k;
        const size_t number = (size_t)count[k], rows = device_parameters((size_t)device[k]) * number;
        row[G_DEVICE] = (double)device[k];
        row[G_COUNT] = (double)number;
        row[G_HAS] = has[k];
        row[G_STATE] = (double)state[k];
        row[G_TABLE] = (double)table;
        row[G_MACHINE] = (double)machine;
        copy_reals(memory + table, parameters, rows);
        parameters += rows;
        table += device_rows((size_t)device[k]) * number;
        machine += number;
    }
}

static void read_tables(const Record *record, const Plan *plan, const Network *net, double *memory)
{
    Reader r = { record, NULL };
    const size_t n = plan->n_machine;

    copy_reals(memory + plan->machine, reals(&r, "machine.table", M_PARAMETERS * n), M_PARAMETERS * n);
    machine_prepare(memory + plan->machine, n, plan->n_sixth);
    copy_integers(memory + plan->machine_bus, net->machine_bus, n);
    copy_reals(memory + plan->rest, reals(&r, "machine.rest", R_ROWS * plan->n_place), R_ROWS * plan->n_place);
    copy_integers(memory + plan->input_machine, integers(&r, "input.machine", plan->n_input, PLACE_INPUTS * plan->n_place), plan->n_input);
    read_groups(&r, plan, memory);
    copy_integers(memory + plan->state_machine, integers(&r, "state.machine", plan->n_state, plan->n_place), plan->n_state);
    copy_integers(memory + plan->show, integers(&r, "show.kind", plan->n_y + plan->n_w, SHOW_KINDS), plan->n_y + plan->n_w);
    copy_integers(memory + plan->show + plan->n_y + plan->n_w,
                  integers(&r, "show.of", plan->n_y + plan->n_w, SIZE_MAX), plan->n_y + plan->n_w);
    copy_reals(memory + plan->port, read_ports(&r, plan), P_ROWS * plan->n_port);
    memory[H_SOURCES] = 0.0;
    for (size_t p = 0; p < plan->n_port; ++p) {
        const double *row = memory + plan->port + P_ROWS * p;
        if (port_is_device(row) && index_at(row, P_COUPLING) == COUPLING_SOURCE) memory[H_SOURCES] += 1.0;
    }
    const double *volts = reals(&r, "port.rest", 2 * plan->n_port);
    copy_reals(memory + plan->port_v, volts, 2 * plan->n_port);
    if (plan->folded == 0) return;
    copy_reals(memory + plan->port_rest, volts, 2 * plan->n_port);
    copy_reals(memory + plan->delta_rest, reals(&r, "state.rest", plan->n_state), n);
    for (size_t k = W_FIRST; k <= W_THIRD; ++k) memory[plan->warm + k] = INFINITY;
    for (size_t k = 0; k < DC_HELD * plan->n_port; ++k) memory[plan->warm + W_V + 8 * plan->n_port + k] = INFINITY;
}

static void read_tie(const Record *record, const Plan *plan, const Network *net, double *memory)
{
    Reader r = { record, NULL };
    const size_t n = plan->n_tie + plan->n_line, m = plan->n_branch;
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
    const int32_t *table = integers(&r, "parameter.table", n, plan->n_group + 1);
    const int32_t *row = integers(&r, "parameter.row", n, 1000);
    const int32_t *device = integers(&r, "parameter.device", n, 100000);
    const double *range = reals(&r, "parameter.range", 2 * n);
    const char *names = text_of(&r, "parameter.names");
    char name[64];

    for (size_t k = 0; k < n; ++k) {
        const double value = b->p[k];
        if (!(value >= range[k] && value <= range[n + k]))
            return plant_fail(message, BLOCK_ERROR, "parameter %s = %g, allowed: %g to %g",
                              plant_name(names, k, name), value, range[k], range[n + k]);
        if (table[k] == 0) continue;   /* the FMI layer's own */
        const double *group = memory + plan->group + G_ROWS * ((size_t)table[k] - 1);
        const size_t count = index_at(group, G_COUNT);
        if ((size_t)row[k] >= device_parameters(index_at(group, G_DEVICE)) || (size_t)device[k] >= count)
            return plant_fail(message, BLOCK_ERROR, "record: parameter %s points outside its table",
                              plant_name(names, k, name));
        memory[index_at(group, G_TABLE) + (size_t)row[k] * count + (size_t)device[k]] = value;
    }
    return BLOCK_OK;
}

BlockStatus plant_tables(Block *b, const Plan *plan, const Network *net, BlockMessage *message)
{
    read_tables(b->record, plan, net, b->memory);
    read_tie(b->record, plan, net, b->memory);
    return read_parameters(b, plan, b->memory, message);
}
