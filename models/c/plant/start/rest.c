/* Devices at the operating point. The record holds their set-points and states at rest
 * for its own parameters; where a parameter of the FMU is another, Newton's method finds
 * those for which the device stands still with what it sees and gives there. */
#include "rest.h"

#include "devices.h"
#include "failure.h"

enum { MOST_ROWS = 128, MOST_STATES = 48, MOST_UNKNOWNS = MOST_STATES + 1, MOST_STEPS = 40 };

/* One device by itself. */
typedef struct {
    DeviceGroup group;
    DeviceSignals signals;
    size_t device, states, reference;   /* reference: its row, or 0 where it has none */
    double table[MOST_ROWS], machine, step, slip;
    double output, set_to, *seen;       /* seen: where others look for the output     */
} Alone;

void rest_prepare(double *memory, const Plan *plan)
{
    for (size_t k = 0; k < plan->n_group; ++k) {
        const double *row = memory + plan->group + G_ROWS * k;
        device_prepare(index_at(row, G_DEVICE), memory + index_at(row, G_TABLE), index_at(row, G_COUNT));
    }
}

/* Rates and what the output lacks at z: states, then the set-point. */
static void residual(Alone *a, const double *z, double *f)
{
    if (a->reference > 0) a->table[a->reference] = z[a->states];
    device_run(a->device, &a->group, &a->signals, z, f);
    if (a->reference > 0) f[a->states] = a->output - a->set_to;
}

/* Gauss with partial pivoting, in place; 0: singular. */
static int solve(double *A, double *f, size_t n)
{
    for (size_t k = 0; k < n; ++k) {
        size_t best = k;
        for (size_t i = k + 1; i < n; ++i)
            if (fabs(A[i * n + k]) > fabs(A[best * n + k])) best = i;
        if (!(fabs(A[best * n + k]) > 1e-300)) return 0;
        for (size_t j = 0; j < n; ++j) {
            const double swap = A[k * n + j];
            A[k * n + j] = A[best * n + j];
            A[best * n + j] = swap;
        }
        const double swap = f[k];
        f[k] = f[best];
        f[best] = swap;
        for (size_t i = k + 1; i < n; ++i) {
            const double share = A[i * n + k] / A[k * n + k];
            for (size_t j = k; j < n; ++j) A[i * n + j] -= share * A[k * n + j];
            f[i] -= share * f[k];
        }
    }
    for (size_t k = n; k-- > 0;) {
        for (size_t j = k + 1; j < n; ++j) f[k] -= A[k * n + j] * f[j];
        f[k] /= A[k * n + k];
        if (!(fabs(f[k]) < 1e12)) return 0;
    }
    return 1;
}

/* From the rest of the record to that of the parameters in use; 0: none found. */
static int settle(Alone *a, double *z)
{
    const size_t n = a->states + (a->reference > 0 ? 1u : 0u);
    double A[MOST_UNKNOWNS * MOST_UNKNOWNS], f[MOST_UNKNOWNS], moved[MOST_UNKNOWNS], before = 1e300;

    for (int count = 0; count < MOST_STEPS; ++count) {
        double size = 0.0;
        residual(a, z, f);
        for (size_t j = 0; j < n; ++j) {
            const double old = z[j], h = 1e-7 * (1.0 + fabs(old));
            z[j] = old + h;
            residual(a, z, moved);
            z[j] = old;
            for (size_t i = 0; i < n; ++i) A[i * n + j] = (moved[i] - f[i]) / h;
        }
        if (!solve(A, f, n)) return 0;
        for (size_t j = 0; j < n; ++j) {
            z[j] -= f[j];
            size += fabs(f[j]) / (1.0 + fabs(z[j]));
        }
        if (size < 1e-10 && !(size < 0.5 * before)) {
            residual(a, z, f);
            return 1;
        }
        before = size;
    }
    return 0;
}

/* Device k of a group, seeing what it sees at the operating point. */
static void take_out(Alone *a, double *memory, const Plan *plan, const double *row, size_t k)
{
    const size_t n = plan->n_place, count = index_at(row, G_COUNT);
    const double *table = memory + index_at(row, G_TABLE) + k;
    double *rest = memory + plan->rest + index_at(memory + index_at(row, G_MACHINE), k);

    a->device = index_at(row, G_DEVICE);
    a->group = (DeviceGroup){ a->table, &a->machine, 1, (uint64_t)row[G_HAS], NO_NOTES };
    a->states = device_states(a->device, a->group.has);
    a->reference = device_reference(a->device);
    a->machine = a->step = a->slip = 0.0;
    a->signals = (DeviceSignals){ rest + R_VT * n, rest + R_VD * n, rest + R_VQ * n, rest + R_ID * n,
                                  rest + R_IQ * n, rest + R_PE * n, &a->slip, rest + R_IFD * n, &a->step,
                                  rest + R_VC * n, rest + R_VS * n, rest + R_PM * n, rest + R_EFD * n, rest + R_OUT * n,
                                  rest + R_OUT * n, rest + R_OUT * n, rest + R_OUT * n, rest + R_OUT * n, rest + R_OUT * n,
                                  rest + R_OUT * n,
                                  rest + R_PE * n, rest + R_IFD * n, rest + R_VS * n, rest + R_VC * n,
                                  rest + R_VT * n, rest + R_PE * n, rest + R_VD * n, rest + R_VQ * n,
                                  rest + R_VT * n, rest + R_PE * n, rest + R_VD * n, rest + R_VQ * n,
                                  rest + R_ID * n, rest + R_IQ * n, rest + R_EFD * n, rest + R_PM * n, rest + R_ID * n,
                                  rest + R_IQ * n, rest + R_VC * n, rest + R_VC * n };
    double **const outputs[] = { &a->signals.pm, &a->signals.vc, &a->signals.vs, &a->signals.vl, &a->signals.efd,
                                &a->signals.b, &a->signals.i, &a->signals.ip, &a->signals.idc, &a->signals.delta,
                                &a->signals.ip1 };
    double **output = outputs[device_kind(a->device)];
    a->seen = *output;
    a->set_to = *a->seen;
    *output = &a->output;
    for (size_t i = 0; i < device_rows(a->device); ++i) a->table[i] = table[i * count];
}

/* Its set-point and start values, if a parameter differs from those `parameters`; 0: no rest found. */
static int settle_device(Block *b, const Plan *plan, const double *row, size_t k, const double *parameters,
                         const double *rest)
{
    const size_t count = index_at(row, G_COUNT), device = index_at(row, G_DEVICE), state = index_at(row, G_STATE);
    double *table = b->memory + index_at(row, G_TABLE) + k, z[MOST_UNKNOWNS];
    int same = 1;
    Alone a;

    for (size_t i = 0; i < device_parameters(device); ++i) same &= real_bits(table[i * count]) == real_bits(parameters[i * count + k]);
    if (same) return 1;
    if (device_rows(device) > MOST_ROWS || device_states(device, UINT64_MAX) > MOST_STATES) return 0;
    take_out(&a, b->memory, plan, row, k);
    for (size_t i = 0; i < a.states; ++i) z[i] = rest[state + i * count + k];
    z[a.states] = a.table[a.reference];
    if (!settle(&a, z)) return 0;
    for (size_t i = 0; i < a.states; ++i) b->x[state + i * count + k] += z[i] - rest[state + i * count + k];
    if (a.reference > 0) table[a.reference * count] = z[a.states];
    *a.seen = a.output;   /* a stabilizer's or a compensator's may be another now */
    return 1;
}

BlockStatus rest_settle(Block *b, const Plan *plan, const Network *net, BlockMessage *message)
{
    static const char *const kinds[] = { ".governor", ".compensator", ".stabilizer", ".limiter", ".exciter",
                                        "", "", "", "", "", "" };
    size_t length;
    const double *parameters = record_f64(b->record, "device.table", &length);
    const double *rest = record_f64(b->record, "state.rest", &length);
    char name[64];

    for (size_t g = 0; g < plan->n_group; ++g) {
        const double *row = b->memory + plan->group + G_ROWS * g;
        const size_t count = index_at(row, G_COUNT), device = index_at(row, G_DEVICE);
        for (size_t k = 0; k < count; ++k)
            if (!settle_device(b, plan, row, k, parameters, rest)) {
                const size_t machine = index_at(b->memory + index_at(row, G_MACHINE), k);
                return plant_fail(message, BLOCK_ERROR,
                                  "%s%s: no equilibrium at the operating point: a limit excludes it with these parameters",
                                  plant_name(net->machine_names, machine, name), kinds[device_kind(device)]);
            }
        parameters += count * device_parameters(device);
    }
    return BLOCK_OK;
}
