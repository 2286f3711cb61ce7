#ifndef PAGE_STDLIB_H
#define PAGE_STDLIB_H
#include <stddef.h>
void *malloc(size_t bytes);
void *calloc(size_t count, size_t bytes);
void free(void *memory);
#endif
