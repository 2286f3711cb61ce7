#ifndef INTERAREA_TILED_H
#define INTERAREA_TILED_H
#include "products.h"
/* What is compiled for tiles as well (flow/tile.h): as wide as the processor can and as there are entries. */

typedef void Product(const double *from, const double *M, size_t rows, size_t columns, const double *s, double *to);
typedef void Products(const double *M, size_t rows, size_t columns, size_t count, const double *s, double *to);
typedef void ProductComplex(const double *g, const double *b, size_t rows, size_t columns, const double *s_re,
                            const double *s_im, double *to_re, double *to_im);
Product num_product_4, num_product_8;
Products num_products_4, num_products_8;
ProductComplex num_product_complex_4, num_product_complex_8;

/* f over `count` entries, as wide as that and the processor allow. */
#if defined __x86_64__ && !defined PLANT_TANGENT && !defined PLANT_LANES
#define TILED(f, lanes, count, ...) \
    ((lanes) >= 8 && (count) >= 8 ? f##_8(__VA_ARGS__) \
     : (lanes) >= 4 && (count) >= 4 ? f##_4(__VA_ARGS__) : f(__VA_ARGS__))
#elif defined __wasm_simd128__ && !defined PLANT_TANGENT && !defined PLANT_LANES
#define TILED(f, lanes, count, ...) \
    ((lanes) >= 4 && (count) >= 4 ? f##_4(__VA_ARGS__) : f(__VA_ARGS__))
#else
#define TILED(f, lanes, count, ...) ((void)(lanes), f(__VA_ARGS__))
#endif
#endif
