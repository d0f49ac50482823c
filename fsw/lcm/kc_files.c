#define _POSIX_C_SOURCE 200809L /* NOLINT: sigaction, clock_gettime, openat */

#include "kc_files.h"

#include <dirent.h>
#include <errno.h>
#include <fcntl.h>
#include <stdbool.h>
#include <stdio.h>
#include <string.h>
#include <sys/file.h>
#include <sys/stat.h>
#include <unistd.h>

#include "kc_crc.h"

#define NAME_MAX_ 16
#define CRC_AT 20u
#define PART_BYTES 2048u /* read and compared at a time */

static const char s_magic[4] = {'K', 'C', 'S', '1'};
/* Order in which the component wants them. */
static const uint16_t s_kinds[] = {KC_STORE_JOURNAL, 1, 2, 3, 4, 5, 6, 7, KC_STORE_PREV, KC_STORE_PROPOSAL};
#define N_KINDS (sizeof s_kinds / sizeof s_kinds[0])

/* false, so that it can be returned */
static bool say(const char *what, const char *name, const char *why)
{
    (void)fprintf(stderr, "kincal-fsw: %s %s: %s\n", what, name, why);
    return false;
}

static bool complain(const char *what, const char *name) { return say(what, name, strerror(errno)); }

static void slot_name(uint16_t kind, unsigned slot, char name[NAME_MAX_])
{
    (void)snprintf(name, NAME_MAX_, "k%02u.%c", (unsigned)kind, slot == 0u ? 'a' : 'b');
}

/* ---- reading: by read() into buffers of our own, so that a sector that cannot be read is an error like any other
 *      (in a mapped file it is a signal that ends the process). These return why it failed, or NULL. ---- */

/* Whatever stands under that name, this does not wait: without O_NONBLOCK a FIFO without a writer would hold us. */
static const char *open_file(int dir_fd, const char *name, int flags, uint32_t most, int *fd, uint32_t *n)
{
    struct stat st = {0};
    const char *wrong = NULL;
    *fd = openat(dir_fd, name, O_RDONLY | O_CLOEXEC | O_NONBLOCK | O_NOCTTY | flags);
    if (*fd < 0) { return strerror(errno); }
    if (fstat(*fd, &st) != 0) {
        wrong = strerror(errno);
    } else if (!S_ISREG(st.st_mode)) {
        wrong = "not a file";
    } else if (st.st_size > (off_t)most) {
        wrong = "too large";
    }
    *n = (uint32_t)st.st_size;
    if (wrong != NULL) { (void)close(*fd); }
    return wrong;
}

static const char *read_all(int fd, uint8_t *data, uint32_t n)
{
    while (n > 0u) {
        ssize_t got = read(fd, data, n);
        if (got < 0 && errno == EINTR) { continue; }
        if (got < 0) { return strerror(errno); }
        if (got == 0) { return "cut short"; }
        data += got;
        n -= (uint32_t)got;
    }
    return NULL;
}

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

/* A slot that is read. */
typedef struct {
    uint32_t most; /* bytes of content that it may have */
    uint8_t *into; /* a place for them, or NULL */
    const uint8_t *same; /* what they have to be, or NULL */
    uint32_t n; /* bytes of content that it has */
    uint64_t number; /* 0: it is not whole */
} slot_t;

static const char *read_content(int fd, const slot_t *slot, uint32_t *crc)
{
    uint8_t part[PART_BYTES];
    uint32_t n;
    for (uint32_t at = 0u; at < slot->n; at += n) {
        n = slot->n - at < PART_BYTES ? slot->n - at : PART_BYTES;
        const char *wrong = read_all(fd, part, n);
        if (wrong != NULL) { return wrong; }
        *crc = kc_crc32(*crc, part, n);
        if (slot->into != NULL) { memcpy(&slot->into[at], part, n); }
        if (slot->same != NULL && memcmp(&slot->same[at], part, n) != 0) { return "other content"; }
    }
    return NULL;
}

static const char *read_open_slot(int fd, uint32_t n, uint16_t kind, slot_t *slot)
{
    uint8_t hdr[KC_SLOT_HDR_BYTES];
    if (n < KC_SLOT_HDR_BYTES) { return "cut short"; }
    const char *wrong = read_all(fd, hdr, KC_SLOT_HDR_BYTES);
    if (wrong != NULL) { return wrong; }
    slot->n = n - KC_SLOT_HDR_BYTES;
    if (memcmp(hdr, s_magic, sizeof s_magic) != 0) { return "not a slot"; }
    if (get_le(&hdr[4], 2u) != kind) { return "of another kind"; }
    if (get_le(&hdr[16], 4u) != slot->n) { return "not of the size that it states"; }
    uint32_t crc = kc_crc32(0u, hdr, CRC_AT);
    wrong = read_content(fd, slot, &crc);
    if (wrong != NULL) { return wrong; }
    if (get_le(&hdr[CRC_AT], 4u) != crc) { return "damaged: its CRC is wrong"; }
    slot->number = get_le(&hdr[8], 8u);
    return slot->number != 0u ? NULL : "number 0";
}

/* Whole, or number 0 and why. A link is no slot: it would lead out of the store. */
static const char *read_slot(int dir_fd, const char *name, uint16_t kind, slot_t *slot)
{
    int fd = -1;
    uint32_t n = 0u;
    slot->number = 0u;
    const char *wrong = open_file(dir_fd, name, O_NOFOLLOW, KC_SLOT_HDR_BYTES + slot->most, &fd, &n);
    if (wrong != NULL) { return wrong; }
    wrong = read_open_slot(fd, n, kind, slot);
    (void)close(fd);
    return wrong;
}

/* ---- numbers of slots: they grow by one, and after the largest comes 1. Newer is what the other reaches by less than
 *      half of all numbers, so what is written next is newer than all that is there, whatever that is. ---- */

static uint64_t after(uint64_t number) { return number == UINT64_MAX ? 1u : number + 1u; }

/* The one that is written next: a bad one, or the older. */
static unsigned older(const uint64_t number[2])
{
    if (number[0] == 0u || number[1] == 0u) { return number[0] == 0u ? 0u : 1u; }
    return number[1] - number[0] > UINT64_MAX / 2u ? 1u : 0u;
}

/* ---- opening ---- */

static bool missing(const kc_files_t *files, const char *name)
{
    struct stat st;
    return fstatat(files->dir_fd, name, &st, AT_SYMLINK_NOFOLLOW) != 0 && errno == ENOENT;
}

static void look_at(kc_files_t *files, uint16_t kind, unsigned slot)
{
    char name[NAME_MAX_];
    slot_t s = {.most = KC_IMAGE_MAX};
    slot_name(kind, slot, name);
    files->there[kind][slot] = !missing(files, name);
    files->number[kind][slot] = 0u;
    if (files->there[kind][slot] == 0u) { return; }
    const char *wrong = read_slot(files->dir_fd, name, kind, &s);
    files->number[kind][slot] = s.number;
    if (wrong != NULL) { (void)say("can't use the stored copy", name, wrong); }
}

static void tmp_name(uint16_t kind, char name[NAME_MAX_])
{
    (void)snprintf(name, NAME_MAX_, "k%02u.tmp", (unsigned)kind);
}

static bool sync_dir(const kc_files_t *files)
{
    if (fsync(files->dir_fd) != 0) { return complain("can't sync the store", files->dir); }
    return true;
}

/* A store that was just made has an entry in its parent, which has to survive too. */
static bool sync_parent(const kc_files_t *files)
{
    int fd = openat(files->dir_fd, "..", O_RDONLY | O_DIRECTORY | O_CLOEXEC);
    bool good = fd >= 0 && fsync(fd) == 0;
    if (!good) { (void)complain("can't sync the folder of the store", files->dir); }
    if (fd >= 0) { (void)close(fd); }
    return good;
}

static bool lock(const kc_files_t *files)
{
    if (flock(files->dir_fd, LOCK_EX | LOCK_NB) == 0) { return true; }
    if (errno != EWOULDBLOCK) { return complain("can't lock the store", files->dir); }
    return say("can't use the store", files->dir, "another flight process uses it");
}

/* What a write that was cut off has left. */
static void remove_tmp(const kc_files_t *files, uint16_t kind)
{
    char name[NAME_MAX_];
    tmp_name(kind, name);
    if (unlinkat(files->dir_fd, name, 0) != 0 && errno != ENOENT) { (void)complain("can't remove", name); }
}

/* What is read here counts from now on, so it is made to last: the process before may have ended between a change of
 * the folder and its sync. A medium that cannot be written can still be read. */
static bool settle(const kc_files_t *files, bool made)
{
    (void)sync_dir(files);
    return sync_parent(files) || !made;
}

static bool take_over(kc_files_t *files, bool made)
{
    if (!lock(files) || !settle(files, made)) { return false; }
    for (size_t i = 0u; i < N_KINDS; i++) {
        remove_tmp(files, s_kinds[i]);
        look_at(files, s_kinds[i], 0u);
        look_at(files, s_kinds[i], 1u);
    }
    return true;
}

bool kc_files_open(kc_files_t *files, const char *dir)
{
    memset(files, 0, sizeof *files);
    files->dir_fd = -1;
    if (strlen(dir) >= sizeof files->dir) { return say("store", "directory", strerror(ENAMETOOLONG)); }
    memcpy(files->dir, dir, strlen(dir) + 1u);
    bool made = mkdir(dir, 0777) == 0;
    if (!made && errno != EEXIST) { return complain("can't make the store", dir); }
    files->dir_fd = open(dir, O_RDONLY | O_DIRECTORY | O_CLOEXEC);
    if (files->dir_fd < 0) { return complain("can't open the store", dir); }
    if (take_over(files, made)) { return true; }
    (void)close(files->dir_fd);
    files->dir_fd = -1;
    return false;
}

/* ---- offering ---- */

/* One that cannot be read (any more) is offered as empty, so that the component reports it. */
static void offer_slot(const kc_files_t *files, uint16_t kind, unsigned slot, kc_app_t *app)
{
    char name[NAME_MAX_];
    slot_t s = {.most = KC_IMAGE_MAX, .into = kc_app_image_room(app)};
    slot_name(kind, slot, name);
    const char *wrong = read_slot(files->dir_fd, name, kind, &s);
    if (wrong != NULL) { (void)say("can't use the stored copy", name, wrong); }
    (void)kc_app_load(app, kind, s.into, wrong == NULL ? s.n : 0u);
}

static void offer_slots(const kc_files_t *files, uint16_t kind, kc_app_t *app)
{
    const uint64_t *num = files->number[kind];
    for (unsigned s = 0u; s < 2u; s++) {
        if (files->there[kind][s] != 0u && num[s] == 0u) {
            (void)kc_app_load(app, kind, kc_app_image_room(app), 0u);
        }
    }
    unsigned newest = 1u - older(num);
    if (num[newest] > 0u) { offer_slot(files, kind, newest, app); }
    if (num[1u - newest] > 0u) { offer_slot(files, kind, 1u - newest, app); }
}

/* Table files by name, so that the order is that of every run. Start-up only: readdir uses the heap. */
typedef struct {
    uint32_t n;
    char name[KC_FILES_TABLES][64];
    bool said[KC_FILES_TABLES]; /* that it can't be used: they are read once for each kind */
} list_t;

static void insert(list_t *list, const char *name)
{
    uint32_t i = list->n++;
    for (; i > 0u && strcmp(list->name[i - 1u], name) > 0; i--) {
        memcpy(list->name[i], list->name[i - 1u], sizeof list->name[i]);
    }
    memset(list->name[i], 0, sizeof list->name[i]);
    memcpy(list->name[i], name, strlen(name));
}

static bool is_table(const char *name)
{
    size_t n = strlen(name);
    return n > 4u && n < 64u && strcmp(&name[n - 4u], ".tbl") == 0;
}

/* Of a list that could not be read to its end nothing is used: another table of the same kind might come first. */
static bool list_tables(const char *dir, list_t *list)
{
    const struct dirent *e;
    DIR *d = opendir(dir);
    if (d == NULL) { return complain("can't read the tables", dir); }
    errno = 0;
    while ((e = readdir(d)) != NULL) {
        if (is_table(e->d_name) && list->n < KC_FILES_TABLES) { insert(list, e->d_name); }
        errno = 0;
    }
    if (errno != 0) {
        (void)complain("can't read the tables to their end, so none is used:", dir);
        list->n = 0u;
    }
    (void)closedir(d);
    return true;
}

/* A table into the component's room, if it is of this kind, which is in the image's header; *n: its bytes, 0 if not. */
static const char *read_table(int dir_fd, const char *name, uint16_t kind, uint8_t *image, uint32_t *n)
{
    int fd = -1;
    uint32_t size = 0u;
    *n = 0u;
    const char *wrong = open_file(dir_fd, name, 0, KC_IMAGE_MAX, &fd, &size);
    if (wrong != NULL) { return wrong; }
    wrong = size < KC_TBL_HDR_BYTES ? "cut short" : read_all(fd, image, KC_TBL_HDR_BYTES);
    if (wrong == NULL && get_le(&image[4], 2u) == kind) {
        wrong = read_all(fd, &image[KC_TBL_HDR_BYTES], size - KC_TBL_HDR_BYTES);
        *n = wrong == NULL ? size : 0u;
    }
    (void)close(fd);
    return wrong;
}

static void refuse_table(list_t *list, uint32_t i, const char *why)
{
    if (!list->said[i]) { (void)say("can't use the table", list->name[i], why); }
    list->said[i] = true;
}

static void offer_tables(int dir_fd, list_t *list, uint16_t kind, kc_app_t *app)
{
    uint8_t *image = kc_app_image_room(app);
    for (uint32_t i = 0u; i < list->n; i++) {
        uint32_t n = 0u;
        const char *wrong = read_table(dir_fd, list->name[i], kind, image, &n);
        if (wrong != NULL) { refuse_table(list, i, wrong); }
        if (n == 0u) { continue; }
        kc_status_t st = kc_app_load(app, kind, image, n);
        if (st != KC_OK && st != KC_ERR_STATE) { refuse_table(list, i, kc_status_name(st)); }
    }
}

int kc_files_load(kc_files_t *files, const char *tables, kc_app_t *app)
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
        offer_slots(files, s_kinds[i], app);
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

/* Made new: what stands there already is nothing to write to (a FIFO would hold us, a link lead elsewhere). */
static int make_tmp(const kc_files_t *files, const char *name)
{
    const int how = O_WRONLY | O_CREAT | O_EXCL | O_CLOEXEC;
    int fd = openat(files->dir_fd, name, how, 0666);
    if (fd >= 0 || errno != EEXIST || unlinkat(files->dir_fd, name, 0) != 0) { return fd; }
    return openat(files->dir_fd, name, how, 0666);
}

/* Its pages are dropped at the end, so that it is read back from the medium. */
static bool write_tmp(const kc_files_t *files, const char *name, const uint8_t *hdr,
                      const kc_store_t *request)
{
    int fd = make_tmp(files, name);
    if (fd < 0) { return false; }
    bool good = write_all(fd, hdr, KC_SLOT_HDR_BYTES) && write_all(fd, request->data, request->n) &&
                fsync(fd) == 0;
    (void)posix_fadvise(fd, 0, 0, POSIX_FADV_DONTNEED);
    return close(fd) == 0 && good;
}

/* Whether the slot holds this data under this number. */
static bool holds(const kc_files_t *files, const char *name, const kc_store_t *request, uint64_t number)
{
    slot_t slot = {.most = request->n, .same = request->data};
    return read_slot(files->dir_fd, name, request->kind, &slot) == NULL && slot.number == number &&
           slot.n == request->n;
}

static void make_header(uint8_t *hdr, const kc_store_t *request, uint64_t number)
{
    memset(hdr, 0, KC_SLOT_HDR_BYTES);
    memcpy(hdr, s_magic, sizeof s_magic);
    put_le(&hdr[4], request->kind, 2u);
    put_le(&hdr[8], number, 8u);
    put_le(&hdr[16], request->n, 4u);
    put_le(&hdr[CRC_AT], kc_crc32(kc_crc32(0u, hdr, CRC_AT), request->data, request->n), 4u);
}

static kc_status_t bad_tmp(const kc_files_t *files, const char *tmp, kc_status_t st)
{
    (void)unlinkat(files->dir_fd, tmp, 0); /* it may be what fills the store */
    return st;
}

/* In place of a slot, and only what reads back as it was written: a kill at any point leaves the old or the new
 * one. *there: the new one is, though perhaps not for certain. */
static kc_status_t put_slot(const kc_files_t *files, const char *name, const kc_store_t *request,
                            uint64_t number, bool *there)
{
    char tmp[NAME_MAX_];
    uint8_t hdr[KC_SLOT_HDR_BYTES];
    make_header(hdr, request, number);
    tmp_name(request->kind, tmp);
    *there = false;
    if (!write_tmp(files, tmp, hdr, request)) {
        (void)complain("can't write", name);
        return bad_tmp(files, tmp, KC_ERR_NUM);
    }
    if (!holds(files, tmp, request, number)) {
        (void)fprintf(stderr, "kincal-fsw: %s does not read back as it was written\n", name);
        return bad_tmp(files, tmp, KC_ERR_CRC);
    }
    if (renameat(files->dir_fd, tmp, files->dir_fd, name) != 0) {
        (void)complain("can't replace", name);
        return bad_tmp(files, tmp, KC_ERR_NUM);
    }
    *there = true;
    return sync_dir(files) ? KC_OK : KC_ERR_NUM;
}

/* Numbers are those of what was written, not read again: a slot that could not be read for once would make the older
 * one the newest. */
static kc_status_t write_slot(kc_files_t *files, const kc_store_t *request)
{
    uint64_t *num = files->number[request->kind];
    unsigned slot = older(num);
    char name[NAME_MAX_];
    bool there = false;
    slot_name(request->kind, 1u - slot, name);
    if (num[1u - slot] > 0u && holds(files, name, request, num[1u - slot])) {
        return sync_dir(files) ? KC_OK : KC_ERR_NUM;
    }
    slot_name(request->kind, slot, name);
    bool same = num[slot] > 0u && holds(files, name, request, num[slot]);
    uint64_t next = after(num[1u - slot]);
    kc_status_t st = put_slot(files, name, request, next, &there);
    if (!there) { return st; }
    num[slot] = next;
    files->there[request->kind][slot] = 1u;
    /* Half done: the newest before is so again. But this may be the only copy of what was here already. */
    if (st != KC_OK && !same && unlinkat(files->dir_fd, name, 0) == 0) {
        num[slot] = 0u;
        files->there[request->kind][slot] = 0u;
        (void)sync_dir(files);
    }
    return st;
}

/* One after the other, the older first: neither a kill between the two nor a loss of power, before which the medium
 * may have done the later change alone, brings the older one back. */
static kc_status_t delete_slots(kc_files_t *files, uint16_t kind)
{
    uint64_t *num = files->number[kind];
    unsigned first = older(num);
    for (unsigned k = 0u; k < 2u; k++) {
        unsigned slot = k == 0u ? first : 1u - first;
        char name[NAME_MAX_];
        slot_name(kind, slot, name);
        if (unlinkat(files->dir_fd, name, 0) != 0 && errno != ENOENT) {
            (void)complain("can't delete", name);
            return KC_ERR_NUM;
        }
        files->there[kind][slot] = 0u;
        num[slot] = 0u;
        if (!sync_dir(files)) { return KC_ERR_NUM; }
    }
    return KC_OK;
}

kc_status_t kc_files_store(kc_files_t *files, const kc_store_t *request)
{
    return request->n > 0u ? write_slot(files, request) : delete_slots(files, request->kind);
}
