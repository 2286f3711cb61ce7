/* See device_slopes.h. */
#include "device_slopes.h"

#include <string.h>

#include "physics.h"
#include "sparse.h"

typedef struct {
    Record record;
    Block block;
} Devices;

static int opened(Record *record, const void *bytes, size_t size, BlockMessage *message)
{
    const char *why = "";
    if (record_open(record, bytes, size, &why) == 0) return 1;
    strncpy(message->text, why, sizeof message->text - 1);
    message->text[sizeof message->text - 1] = '\0';
    return 0;
}

static size_t doubles_of(const BlockLayout *l, const BlockNeeds *needs)
{
    const size_t integers = l->n_iu + l->n_iy + l->n_iw + l->n_ip + l->n_u;
    return 2 * l->n_x + l->n_u + l->n_y + l->n_w + l->n_p + integers + needs->n_memory + needs->n_scratch;
}

size_t interarea_devices_size(const void *record, size_t bytes, const BlockLayout *layout, BlockMessage *message)
{
    Record opening;
    BlockNeeds needs = {0};

    if (!opened(&opening, record, bytes, message)) return 0;
    if (block_needs(&opening, layout, &needs, message) != BLOCK_OK) return 0;
    return sizeof(Devices) + doubles_of(layout, &needs) * sizeof(double);
}

static double *taken(double **at, size_t count, const double *from)
{
    double *place = *at;
    *at += count;
    for (size_t k = 0; k < count; ++k) place[k] = from == NULL ? 0.0 : from[k];
    return place;
}

static int *taken_integers(double **at, size_t count, const int *from)
{
    int *place = (int *)(void *)taken(at, count, NULL);
    for (size_t k = 0; k < count; ++k) place[k] = from == NULL ? 0 : from[k];
    return place;
}

int interarea_devices_open(void *work, const void *record, size_t bytes, const BlockLayout *layout, const double *x,
                           const double *u, const double *p, const int *ip, BlockMessage *message)
{
    Devices *d = work;
    Block *b = &d->block;
    double *at = (double *)(void *)(d + 1);
    BlockNeeds needs = {0};

    if (!opened(&d->record, record, bytes, message)) return 1;
    if (block_needs(&d->record, layout, &needs, message) != BLOCK_OK) return 1;
    b->record = &d->record;
    b->layout = *layout;
    b->x = taken(&at, layout->n_x, x);
    b->dx = taken(&at, layout->n_x, NULL);
    b->u = taken(&at, layout->n_u, u);
    b->y = taken(&at, layout->n_y, NULL);
    b->w = taken(&at, layout->n_w, NULL);
    b->p = taken(&at, layout->n_p, p);
    b->memory = taken(&at, needs.n_memory, NULL);
    b->scratch = taken(&at, needs.n_scratch, NULL);
    b->iu = taken_integers(&at, layout->n_iu, NULL);
    b->iy = taken_integers(&at, layout->n_iy, NULL);
    b->iw = taken_integers(&at, layout->n_iw, NULL);
    b->ip = taken_integers(&at, layout->n_ip, ip);
    b->u_order = taken_integers(&at, layout->n_u, NULL);
    return block_start(b, 0.0, message) == BLOCK_OK ? 0 : 1;
}

size_t interarea_devices_sources(const void *work)
{
    Plan own;
    return plan_in(((const Devices *)work)->block.memory, &own)->n_source;
}

int interarea_devices_slopes(void *work, const double *vx, const double *vu, const double *vv, double *vdx, double *vi)
{
    Devices *d = work;
    Block *b = &d->block;
    return plant_device_slopes(b->memory, plant_places(b->record, b->memory[H_PATTERN]), &b->layout, b->x, b->u, vx, vu,
                               vv, vdx, vi, b->scratch) == 0 ? 0 : 1;
}
