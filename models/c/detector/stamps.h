#ifndef INTERAREA_DETECTOR_STAMPS_H
#define INTERAREA_DETECTOR_STAMPS_H
/* Tests of a detector that compare signals over the last stamps. */
#include "detector.h"

void note_bends(Block *b, size_t newest); /* how sharply all bend at the newest stamp */
void compare_bends(Block *b, double t); /* how rough the signals are */
void compare_means(Block *b, double t); /* means, spans, the swing of all */

#endif
