#ifndef INTERAREA_PHYSICS_H
#define INTERAREA_PHYSICS_H
#include "../numbers/layout.h"
#include "notes.h"

/* The right-hand side and the outputs (flow.h), by flow.c and tangent.c. Each returns 0, or 1 + the port
 * where Newton's method fails. Of memory they change only the ports' warm start. places: the pattern of a
 * sparse network (sparse.h). lanes: width of the tiles (tiles.h), 0 for none. scratch: flow_work(plan) numbers. */
size_t plant_flow(double *memory, const int32_t *places, size_t lanes, const double *x, const double *u, double *dx,
                  double *scratch, Notes notes, const Warm *own);
/* With the devices' decisions as they were noted. */
size_t plant_flow_held(double *memory, const int32_t *places, size_t lanes, const double *x, const double *u, double *dx,
                       double *scratch, Notes notes, const Warm *own);
size_t plant_outputs(double *memory, const int32_t *places, size_t lanes, const double *x, double *y, double *scratch,
                     const Warm *own);
size_t plant_locals(double *memory, const int32_t *places, size_t lanes, const double *x, const double *u,
                    double *locals, double *scratch, double *dx);
/* Voltages of all buses, n_bus real parts, then imaginary ones. */
size_t plant_voltages(double *memory, const int32_t *places, size_t lanes, const double *x, double *volts,
                      double *scratch);
size_t plant_settle(double *memory, const int32_t *places, size_t lanes, const double *x, double *scratch);

#ifdef PLANT_TANGENT
size_t plant_flow_tangent(double *memory, const int32_t *places, size_t lanes, const num *x, const num *u, num *dx,
                          num *scratch, Notes notes, const Warm *own);
size_t plant_outputs_tangent(double *memory, const int32_t *places, size_t lanes, const num *x, num *y, num *scratch,
                             const Warm *own);
#endif
/* The complex step itself; scratch as for the functions above, complex. */
size_t plant_directional(double *memory, const int32_t *places, const BlockLayout *layout, const double *x, const double *u,
                         const double *vx, const double *vu, double *vdx, double *vy, double *scratch);
/* The devices without the network between them: the derivative of dx/dt and of the currents that machines and
 * ports inject (system base) when states, inputs and the voltages of their buses move by vx, vu, vv at the rest
 * that `settle` finds. vv, vi: n_source real parts (machines, then ports), then as many imaginary ones; a machine's
 * port follows its machine, so its entries are not read and 0. Scratch as for plant_directional. */
size_t plant_device_slopes(double *memory, const int32_t *places, const BlockLayout *layout, const double *x,
                           const double *u, const double *vx, const double *vu, const double *vv, double *vdx,
                           double *vi, double *scratch);

static inline size_t flow_work(const Plan *plan)
{
    const size_t ports = plan->folded == 0 ? 16 : 26 + 8 * plan->n_port;
    const size_t nodes = is_sparse(plan) && plan->n_port > 0 ? 8 : 2;
    return 24 * plan->n_place + nodes * plan->n_node + ports * plan->n_port;
}
#endif
