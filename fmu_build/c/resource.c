/* Reading resources/model.bin from the URI that fmi2Instantiate is given: the
 * only file access of the whole FMU. */
#include <errno.h>
#include <limits.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "instance.h"
#include "resource.h"

enum { PATH_SIZE = 4096 };
static const size_t LARGEST_RECORD = (size_t)256 << 20;

static int hex_digit(char c)
{
    if (c >= '0' && c <= '9') return c - '0';
    if (c >= 'a' && c <= 'f') return c - 'a' + 10;
    if (c >= 'A' && c <= 'F') return c - 'A' + 10;
    return -1;
}

static int starts_with_file_scheme(const char *s)
{
    static const char scheme[] = "file:";
    for (int i = 0; i < 5; ++i) {
        const char c = s[i] >= 'A' && s[i] <= 'Z' ? (char)(s[i] - 'A' + 'a') : s[i];
        if (c != scheme[i]) return 0;
    }
    return 1;
}

/* What follows "file:" and an authority; a server's name goes into `path`, where its length is `n`. */
static const char *after_authority(const char *s, char *path, size_t *n)
{
    if (s[0] == '/' && s[1] == '/') {
        s += 2;
        if (strncmp(s, "localhost/", 10) == 0) s += 9;
        else if (*s != '/' && *s != 0) { path[(*n)++] = '/'; path[(*n)++] = '/'; }
    }
    /* file:///C:/x names C:/x, not /C:/x */
    return s[0] == '/' && s[1] != 0 && (s[2] == ':' || s[2] == '|') ? s + 1 : s;
}

/* The byte that %XX stands for; 0 when that is none. */
static char escaped(const char *s)
{
    const int high = hex_digit(s[1]), low = high < 0 ? -1 : hex_digit(s[2]);
    return low < 0 ? 0 : (char)(high * 16 + low);
}

/* Writes the folder's path (UTF-8) for file:/p, file:///p, file://localhost/p,
 * file://server/share, file:///C:/p, or a plain path. Returns 0, or 1 when the
 * location is malformed or too long. */
static int path_of(const char *location, char *path)
{
    const char *s = location;
    const int is_uri = starts_with_file_scheme(s);
    size_t n = 0;

    if (is_uri) s = after_authority(s + 5, path, &n);
    for (; *s != 0; ++s) {
        char c = *s;
        if (is_uri && c == '%') {
            c = escaped(s);
            if (c == 0) return 1;
            s += 2;
        }
        if (n + 16 >= PATH_SIZE) return 1;
        path[n++] = c;
    }
    while (n > 1 && (path[n - 1] == '/' || path[n - 1] == '\\')) --n;
    if (n == 0) return 1;
    memcpy(path + n, "/model.bin", 11);
    return 0;
}

#ifdef _WIN32
/* UTF-8 to UTF-16, because fopen would take the bytes for the ANSI code page. */
static FILE *open_utf8(const char *path)
{
    static const unsigned char lead[] = {0x00, 0xC0, 0xE0, 0xF0};
    wchar_t wide[PATH_SIZE];
    size_t n = 0;
    const unsigned char *s = (const unsigned char *)path;

    while (*s != 0) {
        const int more = *s < 0x80 ? 0 : *s >= 0xF0 ? 3 : *s >= 0xE0 ? 2 : *s >= 0xC0 ? 1 : -1;
        if (more < 0) return NULL;
        unsigned long code = (unsigned long)(*s - lead[more]);
        ++s;
        for (int i = 0; i < more; ++i, ++s) {
            if ((*s & 0xC0) != 0x80) return NULL;
            code = (code << 6) | (*s & 0x3Fu);
        }
        if (code >= 0x10000) {
            code -= 0x10000;
            wide[n++] = (wchar_t)(0xD800 + (code >> 10));
            wide[n++] = (wchar_t)(0xDC00 + (code & 0x3FF));
        } else {
            wide[n++] = (wchar_t)code;
        }
    }
    wide[n] = 0;
    return _wfopen(wide, L"rb");
}
#else
static FILE *open_utf8(const char *path)
{
    return fopen(path, "rb");
}
#endif

static const char *reason(int error)
{
    switch (error) {
    case ENOENT: return "no such file";
    case EACCES: return "permission denied";
    case EMFILE: return "too many open files in this process";
    default: return "the system refused";
    }
}

unsigned char *resource_read(const char *location, const fmi2CallbackFunctions *callbacks,
                             size_t *size, char *why, size_t why_size)
{
    char path[PATH_SIZE];
    unsigned char *bytes = NULL;
    FILE *file;
    long end;

    *size = 0;
    if (location == NULL || location[0] == 0) {
        snprintf(why, why_size, "fmuResourceLocation is empty; give the URI of the extracted "
                 "resources folder, e.g. file:///tmp/fmu/resources");
        return NULL;
    }
    if (path_of(location, path) != 0) {
        snprintf(why, why_size, "fmuResourceLocation \"%.200s\" is not a file URI that can be read "
                 "(bad percent code, empty or too long)", location);
        return NULL;
    }
    errno = 0;
    file = open_utf8(path);
    if (file == NULL) {
        snprintf(why, why_size, "cannot open \"%.300s\" (from fmuResourceLocation): %s; extract the whole "
                 "FMU and pass the URI of its resources folder", path, reason(errno));
        return NULL;
    }
    if (fseek(file, 0, SEEK_END) != 0 || (end = ftell(file)) < 0 || fseek(file, 0, SEEK_SET) != 0) {
        snprintf(why, why_size, "cannot read \"%.300s\"", path);
    } else if (end == LONG_MAX) {
        snprintf(why, why_size, "\"%.300s\" is a folder, not a file; extract the FMU again", path);
    } else if ((size_t)end > LARGEST_RECORD) {
        snprintf(why, why_size, "\"%.300s\" has %ld bytes, more than any block of this FMU needs", path, end);
    } else if ((bytes = instance_allocate(callbacks, (size_t)end + 8)) == NULL) {
        snprintf(why, why_size, "out of memory reading \"%.300s\" (%ld bytes)", path, end);
    } else if (fread(bytes, 1, (size_t)end, file) != (size_t)end) {
        snprintf(why, why_size, "\"%.300s\" could not be read to its end", path);
        instance_release(callbacks, bytes);
        bytes = NULL;
    } else {
        *size = (size_t)end;
    }
    fclose(file);
    return bytes;
}
