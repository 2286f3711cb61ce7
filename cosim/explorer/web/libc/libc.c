/* What a container in a page needs of a C library, besides print.c: with wasi's, a compiler without it at hand
 * would first make all thousand files of that, which takes six times as long as the container itself. */
#include <stddef.h>
#include <stdint.h>

#include "math.h"
#include "stdlib.h"
#include "string.h"

enum { GRAIN = 16, PAGE = 65536 };

/* A piece of memory, given away or in the list of free ones, which goes by address. */
typedef struct Piece {
    size_t size;            /* with this head */
    struct Piece *next;
    size_t unused[2];       /* to GRAIN */
} Piece;

extern unsigned char __heap_base;   /* the linker's: where data and stack end */
static Piece first;                 /* head of the list */

static int join(Piece *piece)
{
    if ((unsigned char *)piece + piece->size != (unsigned char *)piece->next) return 0;
    piece->size += piece->next->size;
    piece->next = piece->next->next;
    return 1;
}

static void put_back(Piece *piece)
{
    Piece *before = &first;

    while (before->next != NULL && before->next < piece) before = before->next;
    piece->next = before->next;
    before->next = piece;
    (void)join(piece);
    if (before != &first) (void)join(before);
}

/* Another piece of at least `size` from the page's memory; 0 where there is no more. */
static int grow(size_t size)
{
    const size_t had = __builtin_wasm_memory_size(0), pages = (size + PAGE - 1) / PAGE;
    const uintptr_t from = ((uintptr_t)&__heap_base + GRAIN - 1) / GRAIN * GRAIN;
    static int begun;
    Piece *piece;

    if (!begun) {   /* what the module starts with */
        begun = 1;
        if (had * PAGE > from + sizeof(Piece)) {
            piece = (Piece *)from;
            piece->size = had * PAGE - from;
            put_back(piece);
            return 1;
        }
    }
    if (__builtin_wasm_memory_grow(0, pages) == SIZE_MAX) return 0;
    piece = (Piece *)(had * PAGE);
    piece->size = pages * PAGE;
    put_back(piece);
    return 1;
}

void *malloc(size_t bytes)
{
    if (bytes > SIZE_MAX / 4) return NULL;
    const size_t size = (bytes + sizeof(Piece) + GRAIN - 1) / GRAIN * GRAIN;

    do
        for (Piece *before = &first; before->next != NULL; before = before->next) {
            Piece *piece = before->next;

            if (piece->size < size) continue;
            before->next = piece->next;
            if (piece->size >= size + 2 * sizeof(Piece)) {
                Piece *rest = (Piece *)((unsigned char *)piece + size);
                rest->size = piece->size - size;
                rest->next = before->next;
                before->next = rest;
                piece->size = size;
            }
            return piece + 1;
        }
    while (grow(size));
    return NULL;
}

void free(void *memory)
{
    if (memory != NULL) put_back((Piece *)memory - 1);
}

void *calloc(size_t count, size_t bytes)
{
    if (bytes > 0 && count > SIZE_MAX / bytes) return NULL;
    void *memory = malloc(count * bytes);
    if (memory != NULL) memset(memory, 0, count * bytes);
    return memory;
}

int memcmp(const void *a, const void *b, size_t bytes)
{
    const unsigned char *p = a, *q = b;

    for (size_t k = 0; k < bytes; ++k)
        if (p[k] != q[k]) return p[k] < q[k] ? -1 : 1;
    return 0;
}

int strcmp(const char *a, const char *b)
{
    while (*a != 0 && *a == *b) ++a, ++b;
    return (unsigned char)*a - (unsigned char)*b;
}

size_t strlen(const char *text)
{
    const char *end = text;

    while (*end != 0) ++end;
    return (size_t)(end - text);
}

double fmax(double x, double y) { return isnan(x) || x < y ? y : x; }
double fmin(double x, double y) { return isnan(x) || y < x ? y : x; }

double nextafter(double x, double y)
{
    uint64_t bits;

    if (isnan(x) || isnan(y)) return x + y;
    if (x == y) return y;
    memcpy(&bits, &x, sizeof bits);
    if (x == 0.0) bits = 1u | (y < 0.0 ? (uint64_t)1 << 63 : 0u);
    else bits = (x < y) == (x > 0.0) ? bits + 1 : bits - 1;
    memcpy(&x, &bits, sizeof x);
    return x;
}

/* The compiler's own product of complex numbers, where all parts are finite. */
double _Complex __muldc3(double a, double b, double c, double d);
double _Complex __muldc3(double a, double b, double c, double d)
{
    const double parts[2] = {a * c - b * d, a * d + b * c};
    double _Complex z;

    memcpy(&z, parts, sizeof z);
    return z;
}
