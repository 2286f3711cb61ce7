#ifndef INTERAREA_PMU_H
#define INTERAREA_PMU_H
/* A phasor measurement unit: the filters of IEC/IEEE 60255-118-1:2018, annex D, on the phasor of one bus.
 *
 * The input u = re + j im is a phasor in the frame that turns with nominal frequency, what the mixer of a real
 * device gives without the part at twice that frequency. With h = 1/(16 nominal_frequency) and M = half_window
 *
 *     X(c) = sum w(k) u(c + k h) / sum w(k),   k = -M .. M,
 *
 *     P class:  w(k) = 1 - |k| / (M + 1)
 *     M class:  w(k) = sinc(4 reference_frequency k h) (0.54 + 0.46 cos(pi k / M)),   sinc x = sin(pi x)/(pi x)
 *
 * The standard differentiates the angle over the neighbours of a sample, so that the report of the instant
 * c = t - (M + 1) h is the first that is complete at t, when it comes out:
 *
 *     frequency - nominal_frequency = (arg X(c + h) - arg X(c - h)) / (4 pi h)
 *     rocof = (arg X(c + h) - 2 arg X(c) + arg X(c - h)) / (2 pi h h)
 *     v = |X(c)|, in the P class over sin(pi (f0 + 1.625 (frequency - f0)) / (2 f0)), which makes up for what its
 *         window takes from a phasor that turns;  angle = arg X(c), of the instant c.
 *
 * There is a report for every t: whoever sends packets takes those at his instants. Between communication
 * points u is what channel_variables.h says; before the start it is u(start). Slopes of outputs are exact. */
#include "../block/block.h"

enum { PMU_SAMPLES = 16 };   /* of a cycle */
enum { PMU_HALF = 512 };     /* the longest window: twice that and one */
enum { P_NOMINAL, P_REFERENCE, P_COUNT };
enum { IP_CLASS, IP_HALF, IP_COUNT };
enum { CLASS_P = 0, CLASS_M = 1 };
enum { Y_V, Y_ANGLE, Y_DEVIATION, Y_FREQUENCY, Y_ROCOF, Y_COUNT };

/* Discrete state: weights over their sum by |k|, then the rings of samples of re and im. */
enum { M_WEIGHTS, M_HISTORY = M_WEIGHTS + PMU_HALF + 1 };

#endif
