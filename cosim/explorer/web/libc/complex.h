#ifndef PAGE_COMPLEX_H
#define PAGE_COMPLEX_H
#define complex _Complex
double creal(double complex z);
double cimag(double complex z);
#endif
