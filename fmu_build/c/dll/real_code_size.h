/* Room for the record, bytes; the export chooses it (write/real_code.py). */
enum { REAL_CODE_CAPACITY = 16384 };
