#ifndef INTERAREA_TILES_H
#define INTERAREA_TILES_H
/* The equations of one plant's machines and devices, 4 (AVX2; WebAssembly's two pairs) or 8 (AVX-512) of them in
 * one operation, where the processor can and there are as many: the same operations in the same order as one at a time,
 * hence the same bits. */
#include "elements.h"
#include "../machine/machine.h"
#include "../numbers/tiled.h"

typedef void MachineRange(const Machines *m, size_t first, size_t last);
typedef void MachineRateRange(const Machines *m, MachineRates dx, size_t first, size_t last);
typedef void DeviceRun(size_t device, const DeviceGroup *g, const DeviceSignals *in, const cell *x, cell *dx);

MachineRange machine_emf_4, machine_emf_8, machine_terminal_4, machine_terminal_8;
MachineRange machine_field_currents_4, machine_field_currents_8;
MachineRateRange machine_derivatives_4, machine_derivatives_8;
DeviceRun device_run_4, device_run_8;

/* Runs devices with the decisions that they make; whether those are the noted ones (flow.c). */
int devices_fit(size_t lanes, size_t device, const DeviceGroup *g, const DeviceSignals *in, const cell *x, cell *dx);
#endif
