#ifndef INTERAREA_REAL_CODE_DATA_H
#define INTERAREA_REAL_CODE_DATA_H
/* What the export writes into a copy of the library: a mark to find it by, then a record (record.h). */
enum { REAL_CODE_MARK = 16 };
extern const unsigned char real_code_data[];
extern const unsigned long real_code_capacity;  /* bytes of the record at most */

#endif
