#include "record.h"

#include <string.h>

enum { HEADER = 32, ENTRY = 64, NAME = 40, F64 = 1, I32 = 2, TEXT = 3 };

static uint64_t read_u64(const unsigned char *p)
{
    uint64_t v = 0;
    for (int i = 7; i >= 0; --i) v = (v << 8) | p[i];
    return v;
}

static uint32_t read_u32(const unsigned char *p)
{
    return (uint32_t)p[0] | (uint32_t)p[1] << 8 | (uint32_t)p[2] << 16 | (uint32_t)p[3] << 24;
}

static size_t width_of(uint32_t type)
{
    return type == F64 ? 8u : type == I32 ? 4u : type == TEXT ? 1u : 0u;
}

static uint32_t crc32_of(const unsigned char *p, size_t n)
{
    uint32_t crc = 0xFFFFFFFFu;
    for (size_t i = 0; i < n; ++i) {
        crc ^= p[i];
        for (int bit = 0; bit < 8; ++bit)
            crc = (crc >> 1) ^ (0xEDB88320u & (0u - (crc & 1u)));
    }
    return ~crc;
}

int record_open(Record *record, const void *bytes, size_t size, const char **why)
{
    const unsigned char *p = bytes;

    record->bytes = NULL;
    record->size = 0;
    record->n_entries = 0;
    *why = "";
    if (size < HEADER || memcmp(p, "IAREC001", 8) != 0) {
        *why = "not an interarea record (wrong first bytes, or truncated)";
        return 1;
    }
    if (read_u64(p + 8) != size) {
        *why = "the record is truncated or has bytes appended";
        return 2;
    }
    if (read_u64(p + 16) != crc32_of(p + 24, size - 24)) {
        *why = "the checksum of the record is wrong: its content was changed or damaged";
        return 3;
    }
    const uint64_t n = read_u64(p + 24);
    if (n > (size - HEADER) / ENTRY) {
        *why = "the table of entries is larger than the record";
        return 4;
    }
    for (size_t k = 0; k < n; ++k) {
        const unsigned char *e = p + HEADER + k * ENTRY;
        const size_t width = width_of(read_u32(e + NAME));
        const uint64_t count = read_u64(e + 48), offset = read_u64(e + 56);
        if (e[NAME - 1] != 0 || width == 0 || offset % 8 != 0 || offset > size
            || count > (size - offset) / width) {
            *why = "an entry of the record is malformed";
            return 5;
        }
    }
    record->bytes = p;
    record->size = size;
    record->n_entries = (size_t)n;
    return 0;
}

static const void *find(const Record *record, const char *name, uint32_t type, size_t *count)
{
    *count = 0;
    for (size_t k = 0; k < record->n_entries; ++k) {
        const unsigned char *e = record->bytes + HEADER + k * ENTRY;
        if (e[0] == (unsigned char)name[0] && read_u32(e + NAME) == type && strcmp((const char *)e, name) == 0) {
            *count = (size_t)read_u64(e + 48);
            return record->bytes + read_u64(e + 56);
        }
    }
    return NULL;
}

const double *record_f64(const Record *record, const char *name, size_t *count)
{
    return find(record, name, F64, count);
}

const int32_t *record_i32(const Record *record, const char *name, size_t *count)
{
    return find(record, name, I32, count);
}

const char *record_text(const Record *record, const char *name, size_t *count)
{
    return find(record, name, TEXT, count);
}
