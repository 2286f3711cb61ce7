/* The physics over double complex: exact directional derivatives by the complex
 * step, f(x + i h v) = f(x) + i h f'(x) v + O(h^2), where h^2 vanishes against
 * rounding.                                        [Squire and Trapp, 1998] */
#define PLANT_TANGENT
#include "flow.h"

void plant_directional(const double *memory, const BlockLayout *layout,
                       const double *x, const double *u, const double *vx, const double *vu,
                       double *vdx, double *vy, double *scratch)
{
    const double h = 0x1p-100;
    num *z = (num *)(void *)scratch;
    num *input = z + layout->n_x, *rates = input + layout->n_u, *outputs = rates + layout->n_x;
    num *work = outputs + layout->n_y;

    for (size_t k = 0; k < layout->n_x; ++k) z[k] = with_slope(x[k], h * vx[k]);
    for (size_t k = 0; k < layout->n_u; ++k) input[k] = with_slope(u[k], h * vu[k]);
    if (vdx != NULL) {
        plant_flow_tangent(memory, z, input, rates, work);
        for (size_t k = 0; k < layout->n_x; ++k) vdx[k] = cimag(rates[k]) / h;
    }
    if (vy != NULL) {
        plant_outputs_tangent(memory, z, outputs, work);
        for (size_t k = 0; k < layout->n_y; ++k) vy[k] = cimag(outputs[k]) / h;
    }
}
