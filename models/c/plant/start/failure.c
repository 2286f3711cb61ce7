#include "failure.h"

#include <stdarg.h>
#include <stdio.h>

BlockStatus plant_fail(BlockMessage *message, BlockStatus status, const char *format, ...)
{
    va_list args;
    va_start(args, format);
    (void)vsnprintf(message->text, sizeof message->text, format, args);
    va_end(args);
    return status;
}

const char *plant_name(const char *names, size_t k, char text[64])
{
    size_t length = 0;
    while (k > 0 && *names != '\0')
        if (*names++ == '\n') --k;
    while (length < 63 && names[length] != '\0' && names[length] != '\n') {
        text[length] = names[length];
        ++length;
    }
    text[length] = '\0';
    return text;
}
