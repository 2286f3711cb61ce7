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
