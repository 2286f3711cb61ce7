/* The closed loop as a block (block.h): reads the record, lays out the members. */
#include "closed_loop_step.h"

#include <math.h>
#include <stdio.h>
#include <string.h>

#include "../block/sampled.h"

static const double MOST_COARSE = 5.0;   /* times a tenth of the controllers' fastest time constant: stable, and exact to 1e-4 */

static const MemberKind *const KINDS[KIND_COUNT] = {&plant_member, &controller_member, &channel_member,
                                                   &supervisor_member};

static BlockStatus unfit(BlockMessage *message, const char *what)
{
    snprintf(message->text, sizeof message->text, "loop: %s of the record does not fit this binary", what);
    return BLOCK_ERROR;
}

/* A member's record lies in the outer one, which has been checked by its hash; `check` also walks the inner one. */
static int find_inner(LoopMemberPlan *m, const Record *outer, size_t k, int check)
{
    char name[24];
    const char *bytes, *why;
    uint64_t entries;
    Record inner;

    snprintf(name, sizeof name, "member.%u.record", (unsigned)k);
    bytes = record_text(outer, name, &m->size);
    if (bytes == NULL || m->size < 32) return 1;
    memcpy(&entries, bytes + 24, sizeof entries);
    m->record = (size_t)((const unsigned char *)bytes - outer->bytes);
    m->entries = (size_t)entries;
    return check ? record_open(&inner, bytes, m->size, &why) : 0;
}

static Record inner_record(const LoopMemberPlan *m, const Record *outer)
{
    return (Record){outer->bytes + m->record, m->size, m->entries};
}

static int layout_of(const Record *record, BlockLayout *n)
{
    size_t count;
    const int32_t *k = record_i32(record, "layout", &count);

    if (k == NULL || count != 9) return 1;
    for (int i = 0; i < 9; ++i)
        if (k[i] < 0 || k[i] > 1000000) return 1;
    n->n_x = (size_t)k[0];  n->n_u = (size_t)k[1];  n->n_y = (size_t)k[2];
    n->n_w = (size_t)k[3];  n->n_p = (size_t)k[4];  n->n_iu = (size_t)k[5];
    n->n_iy = (size_t)k[6]; n->n_iw = (size_t)k[7]; n->n_ip = (size_t)k[8];
    return 0;
}

/* One member: its kind, its record, its layout and needs. */
static BlockStatus read_member(LoopMemberPlan *m, const Record *record, size_t k, int kind, int check, size_t *n_scratch,
                               BlockMessage *message)
{
    BlockNeeds needs = {0};
    BlockStatus status;

    if (kind < 0 || kind >= KIND_COUNT) return unfit(message, "`loop.kinds`");
    m->kind = kind;
    if (find_inner(m, record, k, check) != 0) return unfit(message, "a member");
    const Record inner = inner_record(m, record);
    if (layout_of(&inner, &m->layout) != 0) return unfit(message, "a member");
    if (kind == KIND_CHANNEL && (m->layout.n_u != 1 || m->layout.n_x != 0)) return unfit(message, "a channel");
    if ((status = KINDS[kind]->needs(&inner, &m->layout, &needs, message)) != BLOCK_OK) return status;
    if (needs.n_memory > 1u << 24 || needs.n_scratch > 1u << 24 || needs.n_notes > 1u << 24
        || needs.n_decisions > 1u << 24)
        return unfit(message, "a member");
    m->n_memory = needs.n_memory;
    m->n_notes = needs.n_notes;
    m->n_decisions = needs.n_decisions;
    if (needs.n_scratch > *n_scratch) *n_scratch = needs.n_scratch;
    return BLOCK_OK;
}

/* Places of the members, one after the other. */
static void lay_out(ClosedLoop *l, const LoopPlan *plan)
{
    l->plan = plan;
    l->limits = NULL;
    l->count = plan->count;
    l->n_x = l->n_u = l->n_y = l->n_iu = l->n_iy = l->n_members = l->n_notes = l->n_decisions = 0;
    for (size_t k = 0; k < plan->count; ++k) {
        const LoopMemberPlan *m = &plan->member[k];

        l->kind[k] = m->kind;
        l->member[k] = KINDS[m->kind];
        l->block[k].layout = m->layout;
        l->first_x[k] = l->n_x;
        l->first_u[k] = l->n_u;
        l->first_y[k] = l->n_y;
        l->first_iu[k] = l->n_iu;
        l->first_note[k] = l->n_notes;
        l->first_decision[k] = l->n_decisions;
        l->n_x += m->layout.n_x;
        l->n_u += m->layout.n_u;
        l->n_y += m->layout.n_y;
        l->n_iu += m->layout.n_iu;
        l->n_iy += m->layout.n_iy;
        l->n_members += m->layout.n_u + m->layout.n_iu + m->n_memory;
        l->n_notes += m->n_notes;
        l->n_decisions += m->n_decisions;
    }
    l->n_memory = LOOP_SAVED + 3 * l->n_y + l->n_x + l->n_members;
    l->n_scratch = l->n_members + l->n_x + l->n_iy + 6 * l->n_y + LOOP_ARRAYS * l->n_x + l->n_u + l->n_y + l->n_notes
                   + LIMITED_POINTS * l->n_decisions + plan->n_scratch;
}

/* What the members have together must be the outer layout. */
static int outer_fits(const ClosedLoop *l, const BlockLayout *outer)
{
    size_t n_p = 0, n_ip = 0;

    for (size_t k = 0; k < l->count; ++k) {
        n_p += l->block[k].layout.n_p;
        n_ip += l->block[k].layout.n_ip;
    }
    return outer->n_x == 0 && outer->n_u == 0 && outer->n_y == l->n_y && outer->n_w == 0 && outer->n_p == n_p
           && outer->n_iu == 0 && outer->n_iy == l->n_iy && outer->n_iw == 0 && outer->n_ip == n_ip;
}

/* Whether a list of `count` outputs is there, each one of `outputs` or -1 for none. */
static int wires_fit(const int32_t *wire, size_t length, size_t count, size_t outputs)
{
    if (length != count || (wire == NULL && count > 0)) return 0;
    for (size_t i = 0; i < count; ++i)
        if (wire[i] < -1 || wire[i] >= (int32_t)outputs) return 0;
    return 1;
}

/* A channel hears its source at communication points only. */
static void find_direct(LoopPlan *plan, const ClosedLoop *l, const int32_t *wires)
{
    for (size_t k = 0; k < plan->count; ++k) plan->member[k].direct = 0;
    for (size_t k = 0; k < plan->count; ++k)
        for (size_t i = 0; l->kind[k] != KIND_CHANNEL && i < l->block[k].layout.n_u; ++i)
            for (size_t from = 0; from < plan->count; ++from) {
                const int32_t wire = wires[l->first_u[k] + i];
                if (wire >= (int32_t)l->first_y[from]
                    && (size_t)wire < l->first_y[from] + l->block[from].layout.n_y) plan->member[from].direct = 1;
            }
}

/* Which parameter is the longest step of the plant, and the steps that the loop was made with. */
static BlockStatus read_steps(LoopPlan *plan, const ClosedLoop *l, const Record *record, size_t n_p,
                              BlockMessage *message)
{
    size_t n_step, n_internal, n_solver, n_start;
    const double *step = record_f64(record, "loop.step", &n_step);
    const double *internal = record_f64(record, "loop.internal", &n_internal);
    const int32_t *solver = record_i32(record, "loop.solver", &n_solver);
    const double *start = record_f64(record, "start.real", &n_start);

    if (solver == NULL || n_solver != 1 || solver[0] < 0 || (size_t)solver[0] >= n_p)
        return unfit(message, "`loop.solver`");
    plan->solver = (size_t)solver[0];
    if (start == NULL || n_start != l->n_y + n_p || !(start[l->n_y + plan->solver] >= 1e-7))
        return unfit(message, "`start.real`");
    plan->plants_step = start[l->n_y + plan->solver];
    if (step == NULL || n_step != 1 || !(step[0] >= 1e-6 && step[0] <= 1e3)) return unfit(message, "`loop.step`");
    if (internal == NULL || n_internal != 1 || !(internal[0] >= 1e-7)) return unfit(message, "`loop.internal`");
    plan->step = (int64_t)floor(step[0] * 1e9 + 0.5);
    plan->internal_step = internal[0];
    return BLOCK_OK;
}

static BlockStatus read_wiring(LoopPlan *plan, const ClosedLoop *l, const Record *record, size_t n_p,
                               BlockMessage *message)
{
    size_t n_wire, n_flag;
    const int32_t *wire = record_i32(record, "loop.wire", &n_wire), *flag = record_i32(record, "loop.flag", &n_flag);
    const BlockStatus status = read_steps(plan, l, record, n_p, message);

    if (status != BLOCK_OK) return status;
    if (!wires_fit(wire, n_wire, l->n_u, l->n_y)) return unfit(message, "`loop.wire`");
    if (!wires_fit(flag, n_flag, l->n_iu, l->n_iy)) return unfit(message, "`loop.flag`");
    plan->wire = wire == NULL ? 0 : (size_t)((const unsigned char *)wire - record->bytes);
    plan->flag = flag == NULL ? 0 : (size_t)((const unsigned char *)flag - record->bytes);
    if (wire != NULL) find_direct(plan, l, wire);
    return BLOCK_OK;
}

/* Reads the record; `l` then knows where everything is to lie. */
static BlockStatus read_loop(LoopPlan *plan, ClosedLoop *l, const Record *record, const BlockLayout *n, int check,
                             BlockMessage *message)
{
    size_t count;
    const int32_t *kinds = record_i32(record, "loop.kinds", &count);

    if (kinds == NULL || count == 0 || count > LOOP_MEMBERS) return unfit(message, "`loop.kinds`");
    memset(plan, 0, sizeof *plan);
    for (size_t k = 0; k < count; ++k) {
        const BlockStatus status = read_member(&plan->member[k], record, k, kinds[k], check, &plan->n_scratch, message);
        if (status != BLOCK_OK) return status;
    }
    plan->count = count;
    lay_out(l, plan);
    return outer_fits(l, n) ? read_wiring(plan, l, record, n->n_p, message) : unfit(message, "`layout`");
}

static LoopPlan *plan_in(const Block *b) { return (LoopPlan *)(void *)(b->memory + LOOP_PLAN); }

/* The shortest of the members' longest steps. Who sets the plant's longer than the record has it wants speed
 * for accuracy: the controllers' grows in the same proportion. */
static double longest_step(const LoopPlan *plan, double plants)
{
    const double coarse = fmin(fmax(plants / plan->plants_step, 1.0), MOST_COARSE);
    return fmin(plants, coarse * plan->internal_step);
}

/* Takes a block apart whose memory holds the plan. */
static BlockStatus open_loop(ClosedLoop *l, Block *b, BlockMessage *message)
{
    const LoopPlan *plan = plan_in(b);
    double *next, *notes;
    size_t p = 0, iy = 0, ip = 0;

    if (plan->count == 0) return unfit(message, "used before block_start; the plan");
    if (!(b->p[plan->solver] >= 1e-7)) return unfit(message, "the plant's longest step");
    lay_out(l, plan);
    l->outer = b;
    l->wire = (const int32_t *)(const void *)(b->record->bytes + plan->wire);
    l->flag = (const int32_t *)(const void *)(b->record->bytes + plan->flag);
    l->step = plan->step;
    l->internal_step = longest_step(plan, b->p[plan->solver]);
    l->settled = l->plain = l->between = 0;
    l->slope = b->memory + LOOP_SAVED;
    l->bend = l->slope + l->n_y;
    l->state = l->bend + 2 * l->n_y;
    l->members = l->state + l->n_x;
    l->saved = b->scratch;
    l->saved_state = l->saved + l->n_members;
    l->saved_iy = l->saved_state + l->n_x;
    l->poly = l->saved_iy + l->n_iy;
    l->y0 = l->poly + 4 * l->n_y;
    l->slope0 = l->y0 + l->n_y;
    l->work = l->slope0 + l->n_y;
    notes = l->work + LOOP_ARRAYS * l->n_x + l->n_u + l->n_y;
    l->overruns = notes + l->n_notes;
    next = l->members;
    for (size_t k = 0; k < l->count; ++k) {
        Block *inner = &l->block[k];

        l->record[k] = inner_record(&plan->member[k], b->record);
        inner->record = &l->record[k];
        inner->lanes = b->lanes;
        inner->x = l->state + l->first_x[k];
        inner->dx = NULL;
        inner->w = NULL;
        inner->iw = NULL;
        inner->u = next;
        inner->iu = (int *)(next + inner->layout.n_u);  /* a double's room each */
        inner->memory = next + inner->layout.n_u + inner->layout.n_iu;
        next = inner->memory + plan->member[k].n_memory;
        inner->y = b->y + l->first_y[k];
        inner->p = b->p + p;
        inner->iy = b->iy + iy;
        inner->ip = b->ip + ip;
        p += inner->layout.n_p;
        iy += inner->layout.n_iy;
        ip += inner->layout.n_ip;
        inner->u_order = &l->u_order[k];
        l->u_order[k] = 0;
        inner->notes = notes + l->first_note[k];
        inner->limits = NULL;
        inner->scratch = l->overruns + LIMITED_POINTS * l->n_decisions;
    }
    return BLOCK_OK;
}

BlockStatus block_needs(const Record *record, const BlockLayout *layout, BlockNeeds *needs,
                        BlockMessage *message)
{
    ClosedLoop l;
    LoopPlan plan;
    const BlockStatus status = read_loop(&plan, &l, record, layout, 1, message);

    if (status != BLOCK_OK) return status;
    needs->n_memory = l.n_memory;
    needs->n_scratch = l.n_scratch;
    return BLOCK_OK;
}

/* Adds an instant after the start and, through every channel, its echo. */
static int add_mark(const ClosedLoop *l, double t)
{
    double *m = l->outer->memory;

    if (!(t < 9e6)) return 0;
    for (size_t k = 0; k <= l->count; ++k) {
        const int echo = k < l->count;
        double at;

        if (echo && l->kind[k] != KIND_CHANNEL) continue;
        at = floor((echo ? t + channel_member_latency(&l->block[k]) : t) * 1e9 + 0.5);
        if (!(at > floor(m[M_ORIGIN] * 1e9 + 0.5))) continue;
        if (m[M_MARK_COUNT] >= (double)LOOP_MARKS) return 1;
        m[M_MARKS + (size_t)m[M_MARK_COUNT]] = at;
        m[M_MARK_COUNT] += 1.0;
    }
    return 0;
}

static BlockStatus collect_marks(const ClosedLoop *l, double t, BlockMessage *message)
{
    double at[CHANNEL_MEMBER_JUMPS];
    int full = 0;

    for (size_t k = 0; k < l->count; ++k) {
        const Block *inner = &l->block[k];
        if (l->kind[k] == KIND_SUPERVISOR) continue;
        if (l->kind[k] == KIND_CHANNEL) {
            const size_t count = channel_member_jumps(inner, at);
            for (size_t i = 0; i < count; ++i) full |= add_mark(l, at[i]);
            continue;
        }
        double event = l->member[k]->next_event(inner, t);
        for (int i = 0; isfinite(event) && event < 9e6; ++i) {
            if (i == LOOP_EVENTS) full = 1;
            if (full) break;
            full = add_mark(l, event);
            event = l->member[k]->next_event(inner, event);
        }
    }
    if (!full) return BLOCK_OK;
    snprintf(message->text, sizeof message->text, "loop: more than %d events, or %d with their echoes through "
             "the channels", LOOP_EVENTS, LOOP_MARKS);
    return BLOCK_ERROR;
}

static BlockStatus start_member(ClosedLoop *l, size_t k, double t, BlockMessage *message)
{
    size_t count;
    const double *start = record_f64(&l->record[k], "start.real", &count);

    if (start == NULL || count < l->block[k].layout.n_x) return unfit(message, "a member's `start.real`");
    memset(l->block[k].memory, 0, l->plan->member[k].n_memory * sizeof(double));
    memcpy(l->block[k].x, start, l->block[k].layout.n_x * sizeof(double));
    if (l->block[k].layout.n_iu > 0) {
        const int32_t *flags = record_i32(&l->record[k], "start.integer", &count);
        if (flags == NULL || count < l->block[k].layout.n_iu) return unfit(message, "a member's `start.integer`");
        for (size_t i = 0; i < l->block[k].layout.n_iu; ++i) l->block[k].iu[i] = flags[i];
    }
    return l->member[k]->start(&l->block[k], t, message);
}

/* Whether a controller starts from what it sees at rest. */
static int starts_from_rest(const ClosedLoop *l)
{
    size_t count;

    for (size_t k = 0; k < l->count; ++k)
        if (l->kind[k] == KIND_CONTROLLER && record_i32(&l->record[k], "guard.follows", &count) != NULL) return 1;
    return 0;
}

BlockStatus block_start(Block *b, double t, BlockMessage *message)
{
    ClosedLoop l;
    LoopPlan plan;
    BlockStatus status = read_loop(&plan, &l, b->record, &b->layout, 0, message);

    if (status != BLOCK_OK) return status;
    if (!(fabs(t) < 9e6)) {
        snprintf(message->text, sizeof message->text, "loop: start time %g s, allowed: less than 9e6 s", t);
        return BLOCK_ERROR;
    }
    memset(b->memory, 0, l.n_memory * sizeof(double));
    memcpy(plan_in(b), &plan, sizeof plan);
    if ((status = open_loop(&l, b, message)) != BLOCK_OK) return status;
    b->memory[M_ORIGIN] = b->memory[M_LAST_EVENT] = t;
    for (size_t k = 0; k < l.count; ++k) {
        if ((status = start_member(&l, k, t, message)) != BLOCK_OK) return status;
        if (l.kind[k] == KIND_PLANT) b->lanes = l.block[k].lanes;
    }
    if (starts_from_rest(&l)) {
        if ((status = closed_loop_refresh(&l, t, message)) != BLOCK_OK) return status;
        for (size_t k = 0; k < l.count; ++k)
            if (l.kind[k] != KIND_PLANT && (status = start_member(&l, k, t, message)) != BLOCK_OK) return status;
    }
    return collect_marks(&l, t, message);
}

BlockStatus block_step(Block *b, double t, double h, const double *u_poly, double *dy, BlockMessage *message)
{
    ClosedLoop l;
    BlockStatus status = open_loop(&l, b, message);

    (void)u_poly;
    if (status != BLOCK_OK) return status;
    if (!(fabs(t) < 9e6 && h < 9e6)) {
        snprintf(message->text, sizeof message->text, "loop: step of %g s at %g s, allowed: up to 9e6 s", h, t);
        return BLOCK_ERROR;
    }
    status = h > 0.0 ? closed_loop_advance(&l, t, t + h, message) : closed_loop_refresh(&l, t, message);
    memcpy(dy, l.slope, l.n_y * sizeof(double));
    return status;
}

BlockStatus block_directional(Block *b, double t, const double *x, const double *u, const double *vx,
                              const double *vu, double *vdx, double *vy, BlockMessage *message)
{
    (void)t, (void)x, (void)u, (void)vx, (void)vu, (void)vdx, (void)message;
    if (vy != NULL) memset(vy, 0, b->layout.n_y * sizeof(double));
    return BLOCK_OK;
}
