/* What a record says of an instance, and where an instance's numbers lie in the memory that it is given. */
#include <stdio.h>

#include "instance.h"
#include "limited_step.h"
#include "placement.h"
#include "solver.h"

enum { FORMAT = 1 };
static const size_t LARGEST_COUNT = 1u << 24;

static int count_is(const void *array, size_t got, size_t expected)
{
    return got == expected && (array != NULL || expected == 0);
}

static int unfit(char *why, const char *what)
{
    snprintf(why, WHY_SIZE, "resources/model.bin%s", what);
    return 1;
}

/* The counts of the variables and the longest substep. */
static int read_layout(Instance *c, char *why)
{
    BlockLayout *n = &c->block.layout;
    size_t k[3];
    const int32_t *layout = record_i32(&c->record, "layout", &k[0]);
    const int32_t *format = record_i32(&c->record, "format", &k[1]);
    const double *step = record_f64(&c->record, "internal_step", &k[2]);

    if (format == NULL || k[1] != 1 || format[0] != FORMAT) {
        snprintf(why, WHY_SIZE, "resources/model.bin has format %d, this binary reads %d",
                 format != NULL && k[1] == 1 ? (int)format[0] : -1, FORMAT);
        return 1;
    }
    if (layout == NULL || k[0] != 9 || step == NULL || k[2] != 1 || !(step[0] > 0.0))
        return unfit(why, " lacks `layout` or `internal_step`");
    for (int i = 0; i < 9; ++i)
        if (layout[i] < 0 || (size_t)layout[i] > LARGEST_COUNT) {
            snprintf(why, WHY_SIZE, "resources/model.bin: impossible count %d in `layout`", (int)layout[i]);
            return 1;
        }
    n->n_x = (size_t)layout[0];  n->n_u = (size_t)layout[1];  n->n_y = (size_t)layout[2];
    n->n_w = (size_t)layout[3];  n->n_p = (size_t)layout[4];  n->n_iu = (size_t)layout[5];
    n->n_iy = (size_t)layout[6]; n->n_iw = (size_t)layout[7]; n->n_ip = (size_t)layout[8];
    c->n_real = 2 * n->n_x + n->n_u + n->n_y + n->n_w + n->n_p;
    c->n_integer = n->n_iu + n->n_iy + n->n_iw + n->n_ip;
    c->internal_step = step;
    return 0;
}

/* Start values, limits and flags of all variables. */
static int read_variables(Instance *c, char *why)
{
    size_t k[9];

    c->start_real = record_f64(&c->record, "start.real", &k[0]);
    c->min_real = record_f64(&c->record, "min.real", &k[1]);
    c->max_real = record_f64(&c->record, "max.real", &k[2]);
    c->flags_real = record_i32(&c->record, "flags.real", &k[3]);
    c->start_integer = record_i32(&c->record, "start.integer", &k[4]);
    c->min_integer = record_i32(&c->record, "min.integer", &k[5]);
    c->max_integer = record_i32(&c->record, "max.integer", &k[6]);
    c->flags_integer = record_i32(&c->record, "flags.integer", &k[7]);
    c->type_integer = record_i32(&c->record, "type.integer", &k[8]);
    const void *const array[] = {c->start_real, c->min_real, c->max_real, c->flags_real, c->start_integer,
                                 c->min_integer, c->max_integer, c->flags_integer, c->type_integer};
    for (int i = 0; i < 9; ++i)
        if (!count_is(array[i], k[i], i < 4 ? c->n_real : c->n_integer))
            return unfit(why, ": an array of variables does not fit `layout`");
    return 0;
}

/* Finds the arrays that every record carries and checks their sizes. */
static int read_tables(Instance *c, char *why)
{
    const BlockLayout *n = &c->block.layout;
    size_t count;

    if (read_layout(c, why) != 0 || read_variables(c, why) != 0) return 1;
    const int32_t *sampled = record_i32(&c->record, "sampled", &count);
    c->sampled = count == 1 ? sampled[0] : block_is_sampled;
    const int32_t *parameter = record_i32(&c->record, "internal_step.parameter", &count);
    c->step_parameter = count == 1 && parameter[0] >= 0 ? (size_t)parameter[0] : c->n_real;
    if (count > 0 && !(c->step_parameter < c->n_real)) return unfit(why, ": `internal_step.parameter` is no variable");
    c->output_state = record_i32(&c->record, "output.state", &count);
    if (count > 0 && count != n->n_y) return unfit(why, ": `output.state` does not fit `layout`");
    for (size_t i = 0; i < count; ++i)
        if (c->output_state[i] >= 0 && (size_t)c->output_state[i] >= n->n_x)
            return unfit(why, ": `output.state` points outside the states");
    c->nominal_x = record_f64(&c->record, "nominal.x", &count);
    return count_is(c->nominal_x, count, n->n_x) ? 0 : unfit(why, ": `nominal.x` does not fit `layout`");
}

int instance_describe(Instance *c, BlockNeeds *needs, char *why)
{
    BlockMessage message = {{0}};

    *needs = (BlockNeeds){0};
    if (read_tables(c, why) != 0) return 1;
    if (block_needs(&c->record, &c->block.layout, needs, &message) != BLOCK_OK) {
        snprintf(why, WHY_SIZE, "resources/model.bin: %s", message.text);
        return 1;
    }
    if (needs->n_memory > LARGEST_COUNT || needs->n_scratch > LARGEST_COUNT || needs->n_notes > LARGEST_COUNT
        || needs->n_decisions > LARGEST_COUNT) {
        snprintf(why, WHY_SIZE, "out of memory");
        return 1;
    }
    return 0;
}

/* Doubles of the saved piece by what they hold; in model exchange what limiters decided is part of the state. */
typedef struct { size_t decided, integers, work; } Parts;

static Parts parts_of(const Instance *c, const BlockNeeds *needs)
{
    const BlockLayout *n = &c->block.layout;
    const int exchange = c->type == fmi2ModelExchange;

    return (Parts){exchange ? needs->n_notes + needs->n_decisions : 0,
                   (c->n_integer + n->n_u + 1) / 2,   /* two to a double */
                   SOLVER_ARRAYS * n->n_x + 2 * n->n_u + n->n_y
                   + (exchange ? 0 : LIMITED_POINTS * needs->n_decisions)};
}

size_t instance_sizes(Instance *c, const BlockNeeds *needs)
{
    const BlockLayout *n = &c->block.layout;
    const Parts parts = parts_of(c, needs);
    const size_t doubles = c->n_real + n->n_x + 5 * n->n_u + n->n_y + parts.decided;

    c->front_size = sizeof(RunState) + (doubles + parts.integers) * sizeof(double);
    c->saved_size = c->front_size + needs->n_memory * sizeof(double);
    c->warm_size = needs->n_warm * sizeof(double);
    return (parts.work + needs->n_scratch + needs->n_notes) * sizeof(double);
}

void instance_place(Instance *c, const BlockNeeds *needs)
{
    const BlockLayout *n = &c->block.layout;
    const int exchange = c->type == fmi2ModelExchange;
    const Parts parts = parts_of(c, needs);
    Block *b = &c->block;
    double *d = (double *)(c->run + 1);

    c->real = d;
    b->x = d;
    b->dx = b->x + n->n_x;
    b->u = b->dx + n->n_x;
    b->y = b->u + n->n_u;
    b->w = b->y + n->n_y;
    b->p = b->w + n->n_w;
    c->x_start = d + c->n_real;
    c->u_slope = c->x_start + n->n_x;
    c->u_poly = c->u_slope + n->n_u;
    c->y_slope = c->u_poly + 4 * n->n_u;
    c->overrun = c->y_slope + n->n_y;
    c->n_indicators = exchange ? needs->n_decisions : 0;
    c->n_decisions = exchange ? 0 : needs->n_decisions;
    c->overruns = c->work + SOLVER_ARRAYS * n->n_x + 2 * n->n_u + n->n_y;
    c->integer = (int *)(c->overrun + parts.decided);
    b->memory = c->overrun + parts.decided + parts.integers;
    b->iu = c->integer;
    b->iy = b->iu + n->n_iu;
    b->iw = b->iy + n->n_iy;
    b->ip = b->iw + n->n_iw;
    b->u_order = c->integer + c->n_integer;
    b->scratch = c->work + parts.work;
    b->notes = exchange ? c->overrun + needs->n_decisions : b->scratch + needs->n_scratch;
    b->record = &c->record;
    if (c->step_parameter < c->n_real) c->internal_step = c->real + c->step_parameter;
}
