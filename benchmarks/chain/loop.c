/* The plain loop that no master can beat: set one input, step, get one output,
 * keep it. And the same around a container that holds the whole chain. */
#include <stddef.h>
#include <stdint.h>

#include "fmi2FunctionTypes.h"

#if defined _WIN32
#define EXPORT __declspec(dllexport)
#else
#define EXPORT __attribute__((visibility("default")))
#endif

EXPORT int chain_loop(const fmi2Component *instances, fmi2SetRealTYPE *set, fmi2DoStepTYPE *step,
                      fmi2GetRealTYPE *get, int n, int64_t steps, double h, double *times, double *records);
EXPORT int container_loop(fmi2Component container, fmi2DoStepTYPE *step, fmi2GetRealTYPE *get,
                          const fmi2ValueReference *outputs, int n, int64_t steps, double h, double *times,
                          double *records);

int chain_loop(const fmi2Component *instances, fmi2SetRealTYPE *set, fmi2DoStepTYPE *step, fmi2GetRealTYPE *get,
               int n, int64_t steps, double h, double *times, double *records)
{
    static const fmi2ValueReference input = 1, output = 2;
    double *row = records;

    for (int64_t k = 0; k < steps; ++k, row += n) {
        for (int i = 0; i < n; ++i) {
            const double u = i == 0 ? 0.0 : row[i - 1];
            if (i > 0 && set(instances[i], &input, 1, &u) > fmi2Warning) return 1;
            if (step(instances[i], (double)k * h, h, fmi2True) > fmi2Warning) return 1;
            if (get(instances[i], &output, 1, row + i) > fmi2Warning) return 1;
        }
        times[k] = (double)(k + 1) * h;
    }
    return 0;
}

int container_loop(fmi2Component container, fmi2DoStepTYPE *step, fmi2GetRealTYPE *get,
                   const fmi2ValueReference *outputs, int n, int64_t steps, double h, double *times,
                   double *records)
{
    for (int64_t k = 0; k < steps; ++k) {
        if (step(container, (double)k * h, h, fmi2True) > fmi2Warning) return 1;
        if (get(container, outputs, (size_t)n, records + k * n) > fmi2Warning) return 1;
        times[k] = (double)(k + 1) * h;
    }
    return 0;
}
