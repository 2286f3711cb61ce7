/* The place of the record, apart from the code that reads it: no compiler may take it for the zeros it has here. */
#include "real_code_data.h"
#include "real_code_size.h"

const unsigned long real_code_capacity = REAL_CODE_CAPACITY;
#if defined __GNUC__
__attribute__((aligned(16)))
#endif
const unsigned char real_code_data[REAL_CODE_MARK + REAL_CODE_CAPACITY] = "interarea-record";
