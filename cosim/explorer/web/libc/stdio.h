#ifndef PAGE_STDIO_H
#define PAGE_STDIO_H
#include <stdarg.h>
#include <stddef.h>
/* %s %d %u %zu %lx %g %f and %%, with a precision where the standard has one (print.c). */
int snprintf(char *to, size_t size, const char *format, ...);
int vsnprintf(char *to, size_t size, const char *format, va_list arguments);
#endif
