/* Devices and machines of one plant, PLANT_LANES neighbours in each arithmetic operation (tiles.h). */
#define PLANT_TILE
#include "devices.h"
#include "../machine/machine.h"
#include "tiles.h"

void NAME(machine_emf)(const Machines *m, size_t first, size_t last) { machine_emf(m, first, last); }
void NAME(machine_terminal)(const Machines *m, size_t first, size_t last) { machine_terminal(m, first, last); }
void NAME(machine_field_currents)(const Machines *m, size_t first, size_t last)
{
    machine_field_currents(m, first, last);
}

void NAME(machine_derivatives)(const Machines *m, MachineRates dx, size_t first, size_t last)
{
    machine_derivatives(m, dx, first, last);
}

void NAME(device_run)(size_t device, const DeviceGroup *g, const DeviceSignals *in, const double *x, double *dx)
{
    device_run(device, g, in, x, dx);
}

void NAME(num_product)(const double *from, const double *M, size_t rows, size_t columns, const double *s, double *to)
{
    num_product(from, M, rows, columns, s, to);
}

void NAME(num_products)(const double *M, size_t rows, size_t columns, size_t count, const double *s, double *to)
{
    num_products(M, rows, columns, count, s, to);
}

void NAME(num_product_complex)(const double *g, const double *b, size_t rows, size_t columns, const double *s_re,
                               const double *s_im, double *to_re, double *to_im)
{
    num_product_complex(g, b, rows, columns, s_re, s_im, to_re, to_im);
}
