#ifndef INTERAREA_REAL_CODE_H
#define INTERAREA_REAL_CODE_H
/* The binary interface of a real-code model as an IEEE/CIGRE DLL, second version of the interface (1.1.0.0)
 * [CIGRE958]: the structures that a simulation tool and a model exchange, in natural alignment. A tool calls
 * Model_GetInfo, allocates the arrays that it names, then for each instance Model_FirstCall,
 * Model_CheckParameters, Model_Initialize, Model_Outputs once every sample time, Model_Terminate.   */
#include <stdint.h>

enum { REAL_CODE_REAL64 = 9, REAL_CODE_EMT_AND_RMS = 3 };       /* type of data and mode that are used here */
enum { REAL_CODE_OK = 0, REAL_CODE_MESSAGE = 1, REAL_CODE_ERROR = 2 };  /* what the functions return */

typedef struct {
    const char *name, *description, *unit;      /* the name is a C identifier */
    int32_t type, width;
} RealCodeSignal;

typedef struct {
    const char *name, *group, *description, *unit;
    int32_t type, fixed;                        /* fixed: it counts at the start only */
    double start, min, max;                     /* of real64; other types share these bytes */
} RealCodeParameter;

typedef struct {
    uint8_t version[4];
    const char *name, *model_version, *description, *general;
    const char *created, *creator, *modified, *modified_by, *comment, *history;
    double sample_time;                         /* s */
    uint8_t mode;
    int32_t n_inputs;
    const RealCodeSignal *inputs;
    int32_t n_outputs;
    const RealCodeSignal *outputs;
    int32_t n_parameters;
    const RealCodeParameter *parameters;
    int32_t n_int, n_float, n_double;           /* states that the tool allocates */
} RealCodeInfo;

/* All memory is the tool's. */
typedef struct {
    void *inputs, *outputs, *parameters;        /* structures of the types that RealCodeInfo names */
    double time;                                /* s */
    uint8_t mode;
    const char *error, *message;
    int32_t *int_states;
    float *float_states;
    double *double_states;
} RealCodeInstance;

#endif
