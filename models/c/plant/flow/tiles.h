#ifndef INTERAREA_TILES_H
#define INTERAREA_TILES_H
/* The equations of one plant's machines and devices, 4 (AVX2; WebAssembly's two pairs) or 8 (AVX-512) of them in
 * one operation, where the processor can and there are as many: the same operations in the same order as one at a time,
 * hence the same bits. */
#include "elements.h"
#include "../machine/machine.h"
#include "../numbers/products.h"

typedef void MachineRange(const Machines *m, size_t first, size_t last);
typedef void MachineRateRange(const Machines *m, MachineRates dx, size_t first, size_t last);
typedef void DeviceRun(size_t device, const DeviceGroup *g, const DeviceSignals *in, const cell *x, cell *dx);

MachineRange machine_emf_4, machine_emf_8, machine_terminal_4, machine_terminal_8;
MachineRange machine_field_currents_4, machine_field_currents_8;
MachineRateRange machine_derivatives_4, machine_derivatives_8;
DeviceRun device_run_4, device_run_8;
typedef void Product(const double *from, const double *M, size_t rows, size_t columns, const double *s, double *to);
typedef void ProductComplex(const double *g, const double *b, size_t rows, size_t columns, const double *s_re,
                            const double *s_im, double *to_re, double *to_im);
Product num_product_4, num_product_8;
ProductComplex num_product_complex_4, num_product_complex_8;

/* f over `count` entries, as wide as that and the processor allow. */
#if defined __x86_64__ && !defined PLANT_TANGENT && !defined PLANT_LANES
#define TILED(f, lanes, count, ...) \
    ((lanes) >= 8 && (count) >= 8 ? f##_8(__VA_ARGS__) \
     : (lanes) >= 4 && (count) >= 4 ? f##_4(__VA_ARGS__) : f(__VA_ARGS__))
#elif defined __wasm_simd128__ && !defined PLANT_TANGENT && !defined PLANT_LANES
#define TILED(f, lanes, count, ...) \
    ((lanes) >= 4 && (count) >= 4 ? f##_4(__VA_ARGS__) : f(__VA_ARGS__))
#else
#define TILED(f, lanes, count, ...) ((void)(lanes), f(__VA_ARGS__))
#endif
#ifdef PLANT_HELD   /* decisions are held one device at a time */
#define TILED_DEVICES(f, lanes, count, ...) ((void)(lanes), f(__VA_ARGS__))
#else
#define TILED_DEVICES TILED
#endif
#endif
