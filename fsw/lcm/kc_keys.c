#define _POSIX_C_SOURCE 200809L /* NOLINT: open, fstat */

#include "kc_keys.h"

#include <errno.h>
#include <fcntl.h>
#include <stdio.h>
#include <string.h>
#include <sys/stat.h>
#include <unistd.h>

#define TEXT_MAX 512u
#define ID_MAX 0x7fffffffu

static const char s_head[] = "kincal-keys 1\n";

static bool complain(const char *path, const char *what)
{
    (void)fprintf(stderr, "kincal-fsw: keys %s: %s\n", path, what);
    return false;
}

/* Only its owner may read it, and that is who runs this process. */
static const char *unsafe(const struct stat *st)
{
    if (!S_ISREG(st->st_mode)) { return "not a file"; }
    if (st->st_uid != geteuid()) { return "belongs to another user; make keys as the user of this process"; }
    if ((st->st_mode & 0077u) != 0u) {
        return "others may read or change it: `chmod 600`, and make new keys";
    }
    return NULL;
}

static ssize_t read_all(int fd, char *text, size_t room)
{
    size_t n = 0u;
    while (n < room) {
        ssize_t got = read(fd, &text[n], room - n);
        if (got < 0 && errno == EINTR) { continue; }
        if (got < 0) { return -1; }
        if (got == 0) { break; }
        n += (size_t)got;
    }
    return (ssize_t)n;
}

/* ---- text ---- */

static const char *take_id(const char *at, uint32_t *id)
{
    uint64_t x = 0u;
    uint32_t n = 0u;
    for (; *at >= '0' && *at <= '9' && x <= ID_MAX; at++, n++) { x = 10u * x + (uint64_t)(*at - '0'); }
    *id = (uint32_t)x;
    return n > 0u && x > 0u && x <= ID_MAX && *at == ' ' ? at + 1 : NULL;
}

static int digit(char c)
{
    if (c >= '0' && c <= '9') { return c - '0'; }
    if (c >= 'a' && c <= 'f') { return c - 'a' + 10; }
    return -1;
}

static const char *take_secret(const char *at, uint8_t *secret)
{
    uint8_t ones = 0u; /* a secret of zeros is none */
    for (uint32_t i = 0u; i < KC_KEY_BYTES; i++, at += 2) {
        int high = digit(at[0]);
        int low = high < 0 ? -1 : digit(at[1]); /* the text ends with a zero */
        if (low < 0) { return NULL; }
        secret[i] = (uint8_t)(16 * high + low);
        ones = (uint8_t)(ones | secret[i]);
    }
    return ones != 0u && *at == '\n' ? at + 1 : NULL;
}

static bool known(const kc_keys_t *keys, uint32_t id)
{
    for (uint32_t i = 0u; i < keys->n; i++) {
        if (keys->key[i].id == id) { return true; }
    }
    return false;
}

static const char *take_keys(const char *at, kc_keys_t *keys)
{
    while (*at != '\0') {
        if (keys->n == KC_KEY_MAX) { return "more than four keys; `kincal key retire` takes the oldest out"; }
        kc_key_t *key = &keys->key[keys->n];
        at = take_id(at, &key->id);
        if (at == NULL) { return "a line does not begin with the number of a key and a space"; }
        if (known(keys, key->id)) { return "two keys have the same number"; }
        at = take_secret(at, key->secret);
        if (at == NULL) { return "a key has not 64 hexadecimal digits, or is zero"; }
        keys->n++;
    }
    return keys->n > 0u ? NULL : "no key in it; `kincal key new` makes one";
}

static const char *parse(const char *text, kc_keys_t *keys)
{
    size_t n = sizeof s_head - 1u;
    if (strncmp(text, s_head, n) != 0) { return "its first line is not `kincal-keys 1`"; }
    return take_keys(&text[n], keys);
}

static const char *read_keys(int fd, kc_keys_t *keys)
{
    struct stat st;
    char text[TEXT_MAX + 1u];
    if (fstat(fd, &st) != 0) { return strerror(errno); }
    const char *wrong = unsafe(&st);
    if (wrong != NULL) { return wrong; }
    ssize_t n = read_all(fd, text, TEXT_MAX);
    if (n < 0) { return strerror(errno); }
    text[n] = '\0';
    wrong = (size_t)n == TEXT_MAX || strlen(text) != (size_t)n ? "not a key file" : parse(text, keys);
    memset(text, 0, sizeof text);
    return wrong;
}

bool kc_keys_read(const char *path, kc_keys_t *keys)
{
    memset(keys, 0, sizeof *keys);
    int fd = open(path, O_RDONLY | O_CLOEXEC | O_NONBLOCK);
    if (fd < 0) { return complain(path, strerror(errno)); }
    const char *wrong = read_keys(fd, keys);
    (void)close(fd);
    if (wrong == NULL) { return true; }
    memset(keys, 0, sizeof *keys);
    return complain(path, wrong);
}
