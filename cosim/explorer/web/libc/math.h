#ifndef PAGE_MATH_H
#define PAGE_MATH_H
#define INFINITY __builtin_inff()
#define NAN __builtin_nanf("")
#define isfinite(x) __builtin_isfinite(x)
#define isinf(x) __builtin_isinf(x)
#define isnan(x) __builtin_isnan(x)
/* Instructions of WebAssembly: rounded as IEEE 754 says. */
double ceil(double x);
double copysign(double x, double sign);
double fabs(double x);
double floor(double x);
double sqrt(double x);
double fmax(double x, double y);
double fmin(double x, double y);
double nextafter(double x, double y);
#endif
