#ifndef INTERAREA_RECORD_H
#define INTERAREA_RECORD_H
/* A read-only set of named arrays in one piece of memory: the data of a block
 * as written by models/blocks/binary_table.py. Little-endian, 8-byte aligned:
 *   8 bytes  magic "IAREC001"
 *   u64      total size in bytes, this header included
 *   u64      CRC-32 (zlib) of every byte from offset 24 to the end
 *   u64      number of entries
 *   entries  char name[40] (zero padded); u32 type; u32 zero; u64 count; u64 offset
 *   data     each array at its offset, 8-byte aligned
 * type: 1 = float64, 2 = int32, 3 = bytes                                     */
#include <stddef.h>
#include <stdint.h>

typedef struct { const unsigned char *bytes; size_t size; size_t n_entries; } Record;

/* Checks everything once (magic, size, hash, entries inside the piece), so that
 * the look-ups below cannot leave it. `bytes` must be 8-byte aligned and stay
 * valid. Returns 0, or a nonzero code and a text saying what is wrong. */
int record_open(Record *record, const void *bytes, size_t size, const char **why);

/* Null with *count = 0 when there is no such array of that type. */
const double  *record_f64(const Record *record, const char *name, size_t *count);
const int32_t *record_i32(const Record *record, const char *name, size_t *count);
const char    *record_text(const Record *record, const char *name, size_t *count);
#endif
