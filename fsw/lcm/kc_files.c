#define _POSIX_C_SOURCE 200809L /* NOLINT: sigaction, clock_gettime, openat */

#include "kc_files.h"

#include <dirent.h>
#include <errno.h>
#include <fcntl.h>
#include <stdbool.h>
#include <stdio.h>
#include <string.h>
#include <sys/file.h>
#include <sys/mman.h>
#include <sys/stat.h>
#include <unistd.h>

#include "kc_crc.h"

#define NAME_MAX_ 16
#define CRC_AT 20u

static const char s_magic[4] = {'K', 'C', 'S', '1'};
/* Order in which the component wants them. */
static const uint16_t s_kinds[] = {KC_STORE_JOURNAL, 1, 2, 3, 4, 5, 6, 7, KC_STORE_PREV, KC_STORE_PROPOSAL};
#define N_KINDS (sizeof s_kinds / sizeof s_kinds[0])

/* false, so that it can be returned */
static bool complain(const char *what, const char *name)
{
    (void)fprintf(stderr, "kincal-fsw: %s %s: %s\n", what, name, strerror(errno));
    return false;
}

static void slot_name(uint16_t kind, unsigned slot, char name[NAME_MAX_])
{
    (void)snprintf(name, NAME_MAX_, "k%02u.%c", (unsigned)kind, slot == 0u ? 'a' : 'b');
}

/* ---- reading: a file is mapped, not copied ---- */

typedef struct {
    void *base;
    const uint8_t *data;
    size_t n;
} map_t;

/* MAP_BAD: it can't be read or is empty. */
typedef enum { MAP_OK = 0, MAP_NO_FILE, MAP_BAD } map_result_t;
static map_result_t map_file(int dir_fd, const char *name, map_t *m)
{
    struct stat st;
    int fd = openat(dir_fd, name, O_RDONLY | O_CLOEXEC);
    if (fd < 0) { return errno == ENOENT ? MAP_NO_FILE : MAP_BAD; }
    void *p = MAP_FAILED;
    if (fstat(fd, &st) == 0 && S_ISREG(st.st_mode) && st.st_size > 0) {
        p = mmap(NULL, (size_t)st.st_size, PROT_READ, MAP_PRIVATE, fd, 0);
    }
    (void)close(fd);
    if (p == MAP_FAILED) { return MAP_BAD; }
    m->base = p;
    m->data = p;
    m->n = (size_t)st.st_size;
    return MAP_OK;
}

static void unmap(const map_t *m) { (void)munmap(m->base, m->n); }

static uint64_t get_le(const uint8_t *b, uint32_t n)
{
    uint64_t v = 0u;
    for (uint32_t i = 0u; i < n; i++) { v |= (uint64_t)b[i] << (8u * i); }
    return v;
}

static void put_le(uint8_t *b, uint64_t v, uint32_t n)
{
    for (uint32_t i = 0u; i < n; i++) { b[i] = (uint8_t)(v >> (8u * i)); }
}

static uint32_t slot_crc(const uint8_t *hdr, const uint8_t *data, uint32_t n)
{
    return kc_crc32(kc_crc32(0u, hdr, CRC_AT), data, n);
}

/* Number of a whole slot of this kind, 0 if anything about it is wrong. */
static uint64_t slot_number(const map_t *m, uint16_t kind)
{
    if (m->n < KC_SLOT_HDR_BYTES || memcmp(m->data, s_magic, sizeof s_magic) != 0) { return 0u; }
    uint64_t n = get_le(&m->data[16], 4u);
    if (get_le(&m->data[4], 2u) != kind || n != m->n - KC_SLOT_HDR_BYTES) { return 0u; }
    uint32_t crc = slot_crc(m->data, &m->data[KC_SLOT_HDR_BYTES], (uint32_t)n);
    return crc == get_le(&m->data[CRC_AT], 4u) ? get_le(&m->data[8], 8u) : 0u;
}

/* ---- opening ---- */

static void look_at(kc_files_t *f, uint16_t kind, unsigned slot)
{
    char name[NAME_MAX_];
    map_t m = {NULL, NULL, 0u};
    slot_name(kind, slot, name);
    map_result_t r = map_file(f->dir_fd, name, &m);
    f->there[kind][slot] = r != MAP_NO_FILE;
    f->number[kind][slot] = r == MAP_OK ? slot_number(&m, kind) : 0u;
    if (r == MAP_OK) { unmap(&m); }
}

static void tmp_name(uint16_t kind, char name[NAME_MAX_])
{
    (void)snprintf(name, NAME_MAX_, "k%02u.tmp", (unsigned)kind);
}

bool kc_files_open(kc_files_t *f, const char *dir)
{
    memset(f, 0, sizeof *f);
    f->dir_fd = -1;
    if (strlen(dir) >= sizeof f->dir) {
        errno = ENAMETOOLONG;
        return complain("store", "directory");
    }
    memcpy(f->dir, dir, strlen(dir) + 1u);
    if (mkdir(dir, 0777) != 0 && errno != EEXIST) { return complain("can't make the store", dir); }
    f->dir_fd = open(dir, O_RDONLY | O_DIRECTORY | O_CLOEXEC);
    if (f->dir_fd < 0) { return complain("can't open the store", dir); }
    if (flock(f->dir_fd, LOCK_EX | LOCK_NB) != 0) {
        (void)fprintf(stderr, "kincal-fsw: another flight process uses the store %s\n", dir);
        (void)close(f->dir_fd);
        return false;
    }
    for (size_t i = 0u; i < N_KINDS; i++) {
        char name[NAME_MAX_];
        tmp_name(s_kinds[i], name);
        (void)unlinkat(f->dir_fd, name, 0);
        look_at(f, s_kinds[i], 0u);
        look_at(f, s_kinds[i], 1u);
    }
    return true;
}

/* ---- offering ---- */

static void offer_slot(const kc_files_t *f, uint16_t kind, unsigned slot, kc_app_t *app)
{
    char name[NAME_MAX_];
    map_t m = {NULL, NULL, 0u};
    slot_name(kind, slot, name);
    if (map_file(f->dir_fd, name, &m) != MAP_OK) { return; }
    (void)kc_app_load(app, kind, &m.data[KC_SLOT_HDR_BYTES], (uint32_t)(m.n - KC_SLOT_HDR_BYTES));
    unmap(&m);
}

static void offer_slots(const kc_files_t *f, uint16_t kind, kc_app_t *app)
{
    static const uint8_t nothing[1] = {0};
    const uint64_t *num = f->number[kind];
    for (unsigned s = 0u; s < 2u; s++) {
        if (f->there[kind][s] && num[s] == 0u) { (void)kc_app_load(app, kind, nothing, 0u); }
    }
    unsigned newest = num[1] > num[0] ? 1u : 0u;
    if (num[newest] > 0u) { offer_slot(f, kind, newest, app); }
    if (num[1u - newest] > 0u) { offer_slot(f, kind, 1u - newest, app); }
}

/* Table files by name, so that the order is that of every run. Start-up only: readdir uses the heap. */
typedef struct {
    uint32_t n;
    char name[KC_FILES_TABLES][64];
} list_t;

static void insert(list_t *l, const char *name)
{
    uint32_t i = l->n++;
    for (; i > 0u && strcmp(l->name[i - 1u], name) > 0; i--) {
        memcpy(l->name[i], l->name[i - 1u], sizeof l->name[i]);
    }
    memset(l->name[i], 0, sizeof l->name[i]);
    memcpy(l->name[i], name, strlen(name));
}

static bool is_table(const char *name)
{
    size_t n = strlen(name);
    return n > 4u && n < 64u && strcmp(&name[n - 4u], ".tbl") == 0;
}

static bool list_tables(const char *dir, list_t *l)
{
    const struct dirent *e;
    DIR *d = opendir(dir);
    if (d == NULL) { return complain("can't read the tables", dir); }
    while ((e = readdir(d)) != NULL) {
        if (is_table(e->d_name) && l->n < KC_FILES_TABLES) { insert(l, e->d_name); }
    }
    (void)closedir(d);
    return true;
}

/* Those of this kind; the kind is in the image's header. */
static void offer_tables(int dir_fd, const list_t *l, uint16_t kind, kc_app_t *app)
{
    for (uint32_t i = 0u; i < l->n; i++) {
        map_t m = {NULL, NULL, 0u};
        if (map_file(dir_fd, l->name[i], &m) != MAP_OK) { continue; }
        if (m.n >= KC_TBL_HDR_BYTES && m.n <= KC_IMAGE_MAX && get_le(&m.data[4], 2u) == kind) {
            kc_status_t st = kc_app_load(app, kind, m.data, (uint32_t)m.n);
            if (st != KC_OK && st != KC_ERR_STATE) {
                (void)fprintf(stderr, "kincal-fsw: table %s refused: %s\n", l->name[i], kc_status_name(st));
            }
        }
        unmap(&m);
    }
}

int kc_files_load(kc_files_t *f, const char *tables, kc_app_t *app)
{
    static list_t list;
    memset(&list, 0, sizeof list);
    if (!list_tables(tables, &list)) { return -1; }
    int dir_fd = open(tables, O_RDONLY | O_DIRECTORY | O_CLOEXEC);
    if (dir_fd < 0) {
        (void)complain("can't read the tables", tables);
        return -1;
    }
    for (size_t i = 0u; i < N_KINDS; i++) {
        offer_slots(f, s_kinds[i], app);
        if (s_kinds[i] < KC_TBL_COUNT) { offer_tables(dir_fd, &list, s_kinds[i], app); }
    }
    (void)close(dir_fd);
    return (int)list.n;
}

/* ---- writing ---- */

static bool write_all(int fd, const uint8_t *data, size_t n)
{
    while (n > 0u) {
        ssize_t w = write(fd, data, n);
        if (w < 0 && errno == EINTR) { continue; }
        if (w <= 0) { return false; }
        data += w;
        n -= (size_t)w;
    }
    return true;
}

/* Its pages are dropped at the end, so that it is read back from the medium. */
static bool write_tmp(const kc_files_t *f, const char *name, const uint8_t *hdr, const kc_store_t *s)
{
    int fd = openat(f->dir_fd, name, O_WRONLY | O_CREAT | O_TRUNC | O_CLOEXEC, 0666);
    if (fd < 0) { return false; }
    bool good = write_all(fd, hdr, KC_SLOT_HDR_BYTES) && write_all(fd, s->data, s->n) && fsync(fd) == 0;
    (void)posix_fadvise(fd, 0, 0, POSIX_FADV_DONTNEED);
    return close(fd) == 0 && good;
}

/* Whether the slot holds this data under this number. */
static bool holds(const kc_files_t *f, const char *name, const kc_store_t *s, uint64_t number)
{
    map_t m = {NULL, NULL, 0u};
    if (map_file(f->dir_fd, name, &m) != MAP_OK) { return false; }
    bool same = slot_number(&m, s->kind) == number && m.n == KC_SLOT_HDR_BYTES + s->n &&
                memcmp(&m.data[KC_SLOT_HDR_BYTES], s->data, s->n) == 0;
    unmap(&m);
    return same;
}

static void make_header(uint8_t *hdr, const kc_store_t *s, uint64_t number)
{
    memset(hdr, 0, KC_SLOT_HDR_BYTES);
    memcpy(hdr, s_magic, sizeof s_magic);
    put_le(&hdr[4], s->kind, 2u);
    put_le(&hdr[8], number, 8u);
    put_le(&hdr[16], s->n, 4u);
    put_le(&hdr[CRC_AT], slot_crc(hdr, s->data, s->n), 4u);
}

static kc_status_t bad_tmp(const kc_files_t *f, const char *tmp, kc_status_t st)
{
    (void)unlinkat(f->dir_fd, tmp, 0); /* it may be what fills the store */
    return st;
}

/* In place of a slot, and only what reads back as it was written: a kill at any point leaves the old or the new
 * one. */
static kc_status_t put_slot(const kc_files_t *f, const char *name, const kc_store_t *s, uint64_t number)
{
    char tmp[NAME_MAX_];
    uint8_t hdr[KC_SLOT_HDR_BYTES];
    make_header(hdr, s, number);
    tmp_name(s->kind, tmp);
    if (!write_tmp(f, tmp, hdr, s)) {
        (void)complain("can't write", name);
        return bad_tmp(f, tmp, KC_ERR_NUM);
    }
    if (!holds(f, tmp, s, number)) {
        (void)fprintf(stderr, "kincal-fsw: %s does not read back as it was written\n", name);
        return bad_tmp(f, tmp, KC_ERR_CRC);
    }
    if (renameat(f->dir_fd, tmp, f->dir_fd, name) != 0) {
        (void)complain("can't replace", name);
        return bad_tmp(f, tmp, KC_ERR_NUM);
    }
    if (fsync(f->dir_fd) == 0) { return KC_OK; }
    (void)complain("can't sync", f->dir);
    return KC_ERR_NUM;
}

static kc_status_t write_slot(kc_files_t *f, const kc_store_t *s)
{
    uint64_t *num = f->number[s->kind];
    unsigned slot = num[1] < num[0] ? 1u : 0u; /* the older one, or the bad one */
    char name[NAME_MAX_];
    slot_name(s->kind, 1u - slot, name);
    if (num[1u - slot] > 0u && holds(f, name, s, num[1u - slot])) { return KC_OK; }
    slot_name(s->kind, slot, name);
    bool same = num[slot] > 0u && holds(f, name, s, num[slot]);
    uint64_t next = num[1u - slot] + 1u;
    kc_status_t st = put_slot(f, name, s, next);
    look_at(f, s->kind, slot);
    /* Half done: the newest before is so again. But this may be the only copy of what was here already. */
    if (st != KC_OK && num[slot] == next && !same) {
        (void)unlinkat(f->dir_fd, name, 0);
        (void)fsync(f->dir_fd);
        look_at(f, s->kind, slot);
    }
    return st;
}

/* The older slot first: a kill between the two must not bring it back. */
static kc_status_t delete_slots(kc_files_t *f, uint16_t kind)
{
    uint64_t *num = f->number[kind];
    unsigned older = num[1] < num[0] ? 1u : 0u;
    for (unsigned k = 0u; k < 2u; k++) {
        unsigned slot = k == 0u ? older : 1u - older;
        char name[NAME_MAX_];
        slot_name(kind, slot, name);
        if (unlinkat(f->dir_fd, name, 0) != 0 && errno != ENOENT) {
            (void)complain("can't delete", name);
            return KC_ERR_NUM;
        }
        f->there[kind][slot] = 0u;
        num[slot] = 0u;
    }
    return KC_OK;
}

kc_status_t kc_files_store(kc_files_t *f, const kc_store_t *s)
{
    if (s->n > 0u) { return write_slot(f, s); }
    kc_status_t st = delete_slots(f, s->kind);
    if (st == KC_OK && fsync(f->dir_fd) != 0) {
        (void)complain("can't sync", f->dir);
        st = KC_ERR_NUM;
    }
    return st;
}
