#ifndef INTERAREA_FAILURE_H
#define INTERAREA_FAILURE_H
#include "../../block/block.h"

#if defined(__GNUC__)
__attribute__((format(printf, 3, 4)))
#endif
BlockStatus plant_fail(BlockMessage *message, BlockStatus status, const char *format, ...);
/* Name number `k` (0-based) of a list with one name a line, into text. */
const char *plant_name(const char *names, size_t k, char text[64]);
#endif
