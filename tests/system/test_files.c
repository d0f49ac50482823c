/* kc_files.c: the store through torn writes, damage and kills; the directory of tables. */
#define _GNU_SOURCE /* NOLINT: mkdtemp, syscall, RTLD_NEXT */

#include <dirent.h>
#include <dlfcn.h>
#include <errno.h>
#include <fcntl.h>
#include <setjmp.h>
#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/file.h>
#include <sys/socket.h>
#include <sys/stat.h>
#include <sys/syscall.h>
#include <sys/un.h>
#include <unistd.h>

#include "given_process.h"
#include "given_tables.h"
#include "given_world.h"
#include "kc_crc.h"
#include "kc_files.h"
#include "unity.h"

#define APP (&kc_app_instance)

static kc_files_t s_f;
static char s_root[64], s_dir[128], s_tables[128], s_path[256];
static uint8_t s_image[KC_IMAGE_MAX];
static uint32_t s_n, s_n_open;

/* ---- a medium that fails, or loses power, at any call ----
 *
 * These take the place of the C library's for kc_files.c. Calls are counted from 1 while s_m.on is set: those that
 * change files, and, with s_m.reads, those that read too. */

typedef enum {
    HOLDS,
    KILLS,
    INTERRUPTS, /* read and write, by a signal */
    SHORTENS,   /* read and write: some of it is done */
    ENDS,       /* read: the file ends here; the others fail */
    FAILS_ONCE,
    FAILS_FROM,
    FAILS_ALL_BUT_DELETING,
    FLIPS
} harm_t;

static struct {
    bool on, reads;
    harm_t harm;
    long at, n;    /* call that suffers, calls so far */
    double torn;   /* KILLS: part of a write that is done first */
    int fd;        /* open for writing */
    bool reached;   /* the call was reached */
    int write_errno, n_odd; /* the next n_odd writes write nothing: 0, or -1 with this errno */
    bool close_fails;       /* of what was written */
    bool cuts;              /* files that are read become empty after their size was asked for */
    ino_t synced[8];        /* files and folders that were synced, a ring */
    unsigned n_synced;
    jmp_buf power; /* gone */
} s_m = {.fd = -1};

/* The C library's. */
#define NEXT(type, name, ...) \
    ((type(*)(__VA_ARGS__))dlsym(RTLD_NEXT, name))  // NOLINT(bugprone-macro-parentheses)

static bool suffers(bool deleting)
{
    if (!s_m.on) { return false; }
    s_m.n++;
    bool hit = s_m.n == s_m.at || (s_m.n > s_m.at && s_m.harm >= FAILS_FROM && s_m.harm != FLIPS);
    if (!hit || s_m.harm == HOLDS || (deleting && s_m.harm == FAILS_ALL_BUT_DELETING)) { return false; }
    s_m.reached = true;
    if (s_m.harm == FLIPS || s_m.harm == INTERRUPTS || s_m.harm == SHORTENS) { return false; }
    errno = s_m.at % 2 == 0 ? ENOSPC : EROFS;
    return true;
}

/* Of a call that only reads. */
static bool misreads(void)
{
    if (!s_m.reads || !suffers(false)) { return false; }
    errno = EIO;
    return true;
}

static bool hit(harm_t harm) { return s_m.on && s_m.harm == harm && s_m.n == s_m.at; }

static bool s_killed; /* in this test */

static void die(void)
{
    if (s_m.harm != KILLS) { return; }
    s_killed = true;
    if (s_m.fd >= 0) { (void)syscall(SYS_close, s_m.fd); }
    s_m.fd = -1;
    s_m.on = false;
    longjmp(s_m.power, 1);
}

/* ---- what a loss of power may leave ----
 *
 * As the test VFS of SQLite has it: what was not synced is lost, torn or done, each on its own and in any order. A file
 * that was not synced may have any content; a name stands for any of the files that it stood for since its folder was
 * synced. */

#define NAMES 12u
#define INODES 512u
#define VERSIONS 32u

typedef struct {
    uint8_t data[KC_SLOT_HDR_BYTES + KC_KIN_IMAGE_MAX];
    uint32_t n;
    bool synced;
} inode_t;

static struct {
    bool on;
    uint32_t n_inodes;
    inode_t inode[INODES];
    uint32_t n[NAMES];
    int file[NAMES][VERSIONS]; /* inodes that the name may stand for, the newest last; -1: none */
    int writing;
    uint32_t random;
} s_power;

static const uint16_t s_small[] = {KC_TBL_KIN, KC_STORE_PREV, KC_STORE_PROPOSAL, KC_STORE_JOURNAL};

static void power_name(uint32_t i, char name[16])
{
    static const char *const ends[] = {"a", "b", "tmp"};
    (void)snprintf(name, 16u, "k%02u.%s", (unsigned)s_small[i / 3u], ends[i % 3u]);
}

/* NAMES if it is none of them. */
static uint32_t power_index(const char *name)
{
    char other[16];
    uint32_t i = 0u;
    for (; i < NAMES; i++) {
        power_name(i, other);
        if (strcmp(name, other) == 0) { break; }
    }
    return i;
}

static void stands_for(const char *name, int inode)
{
    uint32_t i = power_index(name);
    if (!s_power.on || i == NAMES) { return; }
    TEST_ASSERT_TRUE(s_power.n[i] < VERSIONS);
    s_power.file[i][s_power.n[i]++] = inode;
}

static int newest_of(const char *name)
{
    uint32_t i = power_index(name);
    return s_power.on && i < NAMES ? s_power.file[i][s_power.n[i] - 1u] : -1;
}

static void power_creates(const char *name)
{
    if (!s_power.on) { return; }
    TEST_ASSERT_TRUE(s_power.n_inodes < INODES);
    s_power.writing = (int)s_power.n_inodes++;
    memset(&s_power.inode[s_power.writing], 0, sizeof s_power.inode[0]);
    stands_for(name, s_power.writing);
}

static void power_writes(const void *data, size_t n)
{
    if (!s_power.on) { return; }
    inode_t *i = &s_power.inode[s_power.writing];
    TEST_ASSERT_TRUE(i->n + n <= sizeof i->data);
    memcpy(&i->data[i->n], data, n);
    i->n += (uint32_t)n;
    i->synced = false;
}

static void power_syncs(int fd)
{
    if (!s_power.on) { return; }
    if (fd == s_m.fd) {
        s_power.inode[s_power.writing].synced = true;
    } else if (fd == s_f.dir_fd) {
        for (uint32_t i = 0u; i < NAMES; i++) {
            s_power.file[i][0] = s_power.file[i][s_power.n[i] - 1u];
            s_power.n[i] = 1u;
        }
    }
}

static uint32_t power_draws(uint32_t below)
{
    s_power.random = 1664525u * s_power.random + 1013904223u;
    return (s_power.random >> 8u) % below;
}

/* ---- the calls ---- */

ssize_t write(int fd, const void *buf, size_t n)
{
    static uint8_t flipped[KC_IMAGE_MAX];
    if (fd != s_m.fd) { return syscall(SYS_write, fd, buf, n); }
    if (s_m.n_odd > 0) {
        s_m.n_odd--;
        errno = s_m.write_errno;
        return s_m.write_errno == 0 ? 0 : -1;
    }
    if (suffers(false)) {
        size_t part = (size_t)((double)n * s_m.torn);
        if (s_m.harm == KILLS) {
            power_writes(buf, part);
            (void)syscall(SYS_write, fd, buf, part);
        }
        die();
        return -1;
    }
    if (hit(INTERRUPTS)) {
        errno = EINTR;
        return -1;
    }
    size_t most = hit(SHORTENS) ? (n + 1u) / 2u : n;
    power_writes(buf, most);
    if (hit(FLIPS)) {
        memcpy(flipped, buf, n);
        flipped[n / 2u] ^= 4u;
        return syscall(SYS_write, fd, flipped, n);
    }
    return syscall(SYS_write, fd, buf, most);
}

ssize_t read(int fd, void *buf, size_t n)
{
    if (misreads()) { return s_m.harm == ENDS ? 0 : -1; }
    if (s_m.reads && hit(INTERRUPTS)) {
        errno = EINTR;
        return -1;
    }
    return syscall(SYS_read, fd, buf, s_m.reads && hit(SHORTENS) ? (n + 1u) / 2u : n);
}

int openat(int dir, const char *name, int flags, ...)
{
    va_list va;
    va_start(va, flags);
    unsigned mode = (flags & O_CREAT) != 0 ? va_arg(va, unsigned) : 0u;
    va_end(va);
    bool writing = (flags & O_CREAT) != 0;
    if (writing ? suffers(false) : misreads()) {
        die();
        return -1;
    }
    int fd = (int)syscall(SYS_openat, dir, name, flags, mode);
    if (writing && fd >= 0) {
        s_m.fd = fd;
        power_creates(name);
    }
    return fd;
}

int open(const char *name, int flags, ...)
{
    va_list va;
    va_start(va, flags);
    unsigned mode = (flags & O_CREAT) != 0 ? va_arg(va, unsigned) : 0u;
    va_end(va);
    return misreads() ? -1 : (int)syscall(SYS_openat, AT_FDCWD, name, flags, mode);
}

int fstat(int fd, struct stat *st)
{
    char name[32];
    if (misreads()) { return -1; }
    int done = NEXT(int, "fstat", int, struct stat *)(fd, st);
    (void)snprintf(name, sizeof name, "/proc/self/fd/%d", fd);
    if (s_m.cuts) { (void)truncate(name, 0); }
    return done;
}

int fstatat(int dir, const char *name, struct stat *st, int flags)
{
    return misreads() ? -1
                      : NEXT(int, "fstatat", int, const char *, struct stat *, int)(dir, name, st, flags);
}

DIR *opendir(const char *name) { return misreads() ? NULL : NEXT(DIR *, "opendir", const char *)(name); }

struct dirent *readdir(DIR *dir) { return misreads() ? NULL : NEXT(struct dirent *, "readdir", DIR *)(dir); }

int mkdir(const char *name, mode_t mode)
{
    return suffers(false) ? -1 : (int)syscall(SYS_mkdirat, AT_FDCWD, name, mode);
}

int flock(int fd, int how) { return misreads() ? -1 : (int)syscall(SYS_flock, fd, how); }

int close(int fd)
{
    bool fails = s_m.close_fails && fd >= 0 && fd == s_m.fd;
    int done = (int)syscall(SYS_close, fd);
    if (fd == s_m.fd) { s_m.fd = -1; }
    if (fails) { errno = EIO; }
    return fails ? -1 : done;
}

int fsync(int fd)
{
    struct stat st = {0};
    if (!suffers(false)) { /* on a real medium nothing here outlives the test */
        power_syncs(fd);
        int done = NEXT(int, "fstat", int, struct stat *)(fd, &st);
        s_m.synced[s_m.n_synced++ % 8u] = st.st_ino;
        return done;
    }
    die();
    return -1;
}

int renameat(int from_dir, const char *from, int to_dir, const char *to)
{
    if (!suffers(false)) {
        stands_for(to, newest_of(from));
        stands_for(from, -1);
        return (int)syscall(SYS_renameat2, from_dir, from, to_dir, to, 0u);
    }
    die();
    return -1;
}

int unlinkat(int dir, const char *name, int flags)
{
    if (!suffers(true)) {
        int done = (int)syscall(SYS_unlinkat, dir, name, flags);
        if (done == 0) { stands_for(name, -1); }
        return done;
    }
    die();
    return -1;
}

static const char *path(const char *dir, const char *name)
{
    (void)snprintf(s_path, sizeof s_path, "%s/%s", dir, name);
    return s_path;
}

static void write_file(const char *dir, const char *name, const void *data, size_t n)
{
    FILE *f = fopen(path(dir, name), "wb");
    TEST_ASSERT_NOT_NULL(f);
    TEST_ASSERT_EQUAL_UINT64(n, fwrite(data, 1u, n, f));
    (void)fclose(f);
}

static bool exists(const char *dir, const char *name)
{
    struct stat st;
    return stat(path(dir, name), &st) == 0;
}

static void open_store(void) { TEST_ASSERT_TRUE(kc_files_open(&s_f, s_dir)); }

static void close_store(void)
{
    if (s_f.dir_fd >= 0) { (void)close(s_f.dir_fd); }
    s_f.dir_fd = -1;
}

void setUp(void)
{
    s_n_open = open_files();
    memset(&s_m, 0, sizeof s_m);
    s_m.fd = -1;
    s_power.on = false;
    given_world();
    /* In memory where there is such a folder: a file system on a disk waits for it when a file is replaced. */
    const char *in = access("/dev/shm", W_OK) == 0 ? "/dev/shm" : "/tmp";
    (void)snprintf(s_root, sizeof s_root, "%s/kc_files_XXXXXX", in);
    TEST_ASSERT_NOT_NULL(mkdtemp(s_root));
    (void)snprintf(s_dir, sizeof s_dir, "%s/store", s_root);
    (void)snprintf(s_tables, sizeof s_tables, "%s/tables", s_root);
    TEST_ASSERT_EQUAL_INT(0, mkdir(s_tables, 0777));
    open_store();
    kc_app_init(APP);
    kc_app_keys(APP, &world.keys);
}

void tearDown(void)
{
    char cmd[192];
    close_store();
    /* whatever failed; a process that was killed leaves none, but its place is taken by this one */
    if (!s_killed) { TEST_ASSERT_EQUAL_UINT32(s_n_open, open_files()); }
    s_killed = false;
    (void)snprintf(cmd, sizeof cmd, "chmod -R u+rwx %s; rm -rf %s", s_root, s_root);
    TEST_ASSERT_EQUAL_INT(0, system(cmd));  // NOLINT(cert-env33-c): the folder is our own
}

/* ARM tables that differ in the length of the tool: 0.01 m times `which`. */
static void given_arm_image(int which)
{
    world.arm.tool_xyz_m[2] = 0.01 * which;
    s_n = given_image(KC_TBL_ARM, &world.arm, s_image);
}

static kc_status_t store_arm(int which)
{
    given_arm_image(which);
    const kc_store_t s = {KC_TBL_ARM, s_n, s_image};
    return kc_files_store(&s_f, &s);
}

/* Which ARM table a new life of the process would have; 0 for none. */
static int reloaded(void)
{
    close_store();
    open_store();
    kc_app_init(APP);
    kc_app_keys(APP, &world.keys);
    TEST_ASSERT_TRUE(kc_files_load(&s_f, s_tables, APP) >= 0);
    kc_app_boot(APP);
    if (kc_app_active(APP)->crc[KC_TBL_ARM] == 0u) { return 0; }
    return (int)(kc_app_active(APP)->arm.tool_xyz_m[2] * 100.0 + 0.5);
}

void test_what_was_stored_last_comes_back(void)
{
    for (int which = 1; which <= 5; which++) {
        TEST_ASSERT_EQUAL_INT(KC_OK, store_arm(which));
        hear(2);
        TEST_ASSERT_EQUAL_INT(which, reloaded());
        TEST_ASSERT_EQUAL_STRING("", heard());
    }
    TEST_ASSERT_TRUE(exists(s_dir, "k01.a") && exists(s_dir, "k01.b"));
    TEST_ASSERT_FALSE(exists(s_dir, "k01.tmp"));
}

void test_the_other_slot_is_taken_when_the_newest_is_damaged_at_any_byte(void)
{
    static uint8_t whole[KC_IMAGE_MAX + KC_SLOT_HDR_BYTES];
    (void)store_arm(1);
    (void)store_arm(2);
    FILE *f = fopen(path(s_dir, "k01.b"), "rb");
    TEST_ASSERT_NOT_NULL(f);
    size_t n = fread(whole, 1u, sizeof whole, f);
    (void)fclose(f);
    for (size_t at = 0u; at < n; at += 7u) {
        whole[at] ^= 0x10u;
        write_file(s_dir, "k01.b", whole, n);
        TEST_ASSERT_EQUAL_INT(1, reloaded());
        TEST_ASSERT_TRUE(event_at(&APP->boot_events, KC_EVT_BOOT_SLOT_BAD) >= 0);
        whole[at] ^= 0x10u;
    }
    for (size_t cut = 0u; cut < n; cut += 11u) { /* torn: only the first bytes are there */
        write_file(s_dir, "k01.b", whole, cut);
        TEST_ASSERT_EQUAL_INT(1, reloaded());
    }
    write_file(s_dir, "k01.b", whole, n);
    TEST_ASSERT_EQUAL_INT(2, reloaded());
}

void test_a_damaged_slot_is_the_one_that_is_written_next(void)
{
    (void)store_arm(1);
    (void)store_arm(2);
    write_file(s_dir, "k01.b", "rubbish", 7u);
    TEST_ASSERT_EQUAL_INT(1, reloaded());
    TEST_ASSERT_EQUAL_INT(KC_OK, store_arm(3));
    TEST_ASSERT_EQUAL_INT(3, reloaded());
    write_file(s_dir, "k01.b", "rubbish", 7u); /* slot a still holds the first one */
    TEST_ASSERT_EQUAL_INT(1, reloaded());
}

void test_a_slot_of_another_kind_is_damage(void)
{
    (void)store_arm(1);
    TEST_ASSERT_EQUAL_INT(0, rename(path(s_dir, "k01.a"), "/dev/null/x") == 0);
    char to[256];
    (void)snprintf(to, sizeof to, "%s/k02.a", s_dir);
    TEST_ASSERT_EQUAL_INT(0, rename(path(s_dir, "k01.a"), to));
    TEST_ASSERT_EQUAL_INT(0, reloaded());
    TEST_ASSERT_TRUE(event_at(&APP->boot_events, KC_EVT_BOOT_SLOT_BAD) >= 0);
}

static void overhear(void) { hear(2); }

static void expect_said(const char *what) { TEST_ASSERT_NOT_NULL_MESSAGE(strstr(heard(), what), what); }

void test_left_overs_of_a_write_that_was_cut_off_are_removed(void)
{
    (void)store_arm(1);
    write_file(s_dir, "k01.tmp", "half a tab", 10u);
    errno = EIO; /* of a call before */
    overhear();
    TEST_ASSERT_EQUAL_INT(1, reloaded());
    TEST_ASSERT_EQUAL_STRING("", heard());
    TEST_ASSERT_FALSE(exists(s_dir, "k01.tmp"));
}

/* Every kind of copy that there is, found again with its number, and deleted. */
void test_every_kind_is_found_again_and_deleted(void)
{
    static const uint16_t kinds[] = {
        KC_TBL_ARM,    KC_TBL_CAMERA, KC_TBL_TERMS,  KC_TBL_KIN,        KC_TBL_SPACE,
        KC_TBL_KERNEL, KC_TBL_CONFIG, KC_STORE_PREV, KC_STORE_PROPOSAL, KC_STORE_JOURNAL,
    };
    for (uint32_t i = 0u; i < sizeof kinds / sizeof kinds[0]; i++) {
        const kc_store_t s = {kinds[i], 10u + i, s_image}, gone = {kinds[i], 0u, s_image};
        TEST_ASSERT_EQUAL_INT(KC_OK, kc_files_store(&s_f, &s));
        close_store();
        open_store();
        TEST_ASSERT_EQUAL_UINT8(1u, s_f.there[kinds[i]][0]);
        TEST_ASSERT_EQUAL_UINT64(1u, s_f.number[kinds[i]][0]);
        errno = EIO; /* of a call before */
        TEST_ASSERT_EQUAL_INT(KC_OK, kc_files_store(&s_f, &gone));
        for (uint32_t k = 0u; k < 2u; k++) {
            TEST_ASSERT_EQUAL_UINT8(0u, s_f.there[kinds[i]][k]);
            TEST_ASSERT_EQUAL_UINT64(0u, s_f.number[kinds[i]][k]);
        }
    }
}

void test_a_copy_may_be_read_and_written_by_whom_the_mask_lets(void)
{
    struct stat st;
    const mode_t mask = umask(S_IWOTH);
    (void)store_arm(1);
    (void)umask(mask);
    TEST_ASSERT_EQUAL_INT(0, stat(path(s_dir, "k01.a"), &st));
    TEST_ASSERT_EQUAL_HEX32(0664, st.st_mode & 0777);
}

void test_what_was_deleted_does_not_come_back(void)
{
    (void)store_arm(1);
    (void)store_arm(2);
    const kc_store_t gone = {KC_TBL_ARM, 0u, s_image};
    TEST_ASSERT_EQUAL_INT(KC_OK, kc_files_store(&s_f, &gone));
    TEST_ASSERT_EQUAL_INT(0, reloaded());
    TEST_ASSERT_EQUAL_INT(KC_OK, kc_files_store(&s_f, &gone)); /* again: nothing to do */
    TEST_ASSERT_EQUAL_INT(KC_OK, store_arm(3));
    TEST_ASSERT_EQUAL_INT(3, reloaded());
}

void test_only_one_process_may_use_a_store(void)
{
    static kc_files_t other;
    TEST_ASSERT_FALSE(kc_files_open(&other, s_dir));
    close_store();
    TEST_ASSERT_TRUE(kc_files_open(&other, s_dir));
    TEST_ASSERT_EQUAL_STRING(s_dir, other.dir);
    (void)close(other.dir_fd);
}

void test_a_store_that_cannot_be_made_or_opened_is_refused(void)
{
    static kc_files_t other;
    static char longer[KC_FILES_PATH_MAX + 2];
    memset(longer, 'x', sizeof longer - 1u);
    TEST_ASSERT_FALSE(kc_files_open(&other, longer));
    TEST_ASSERT_FALSE(kc_files_open(&other, "/dev/null/store"));
    write_file(s_root, "file", "x", 1u);
    TEST_ASSERT_FALSE(kc_files_open(&other, path(s_root, "file")));
}

void test_failed_writes_are_reported(void)
{
    char cmd[192];
    (void)store_arm(1);
    /* a folder in the way of the temporary file, of the slot, of the deletion */
    (void)snprintf(cmd, sizeof cmd, "%s/k01.tmp", s_dir);
    TEST_ASSERT_EQUAL_INT(0, mkdir(cmd, 0777));
    TEST_ASSERT_EQUAL_INT(KC_ERR_NUM, store_arm(2));
    TEST_ASSERT_EQUAL_INT(0, rmdir(cmd));
    (void)snprintf(cmd, sizeof cmd, "%s/k01.b", s_dir);
    TEST_ASSERT_EQUAL_INT(0, mkdir(cmd, 0777));
    TEST_ASSERT_EQUAL_INT(KC_ERR_NUM, store_arm(2));
    const kc_store_t gone = {KC_TBL_ARM, 0u, s_image};
    TEST_ASSERT_EQUAL_INT(KC_ERR_NUM, kc_files_store(&s_f, &gone));
    TEST_ASSERT_EQUAL_INT(0, rmdir(cmd));
    TEST_ASSERT_EQUAL_INT(KC_OK, store_arm(2));
    TEST_ASSERT_EQUAL_INT(2, reloaded());
    int fd = s_f.dir_fd;
    s_f.dir_fd = open("/dev/null", O_RDONLY); /* no folder: neither written nor synced */
    TEST_ASSERT_EQUAL_INT(KC_ERR_NUM, store_arm(3));
    (void)close(s_f.dir_fd);
    s_f.dir_fd = fd;
}

/* ---- what is said on standard error ---- */

void test_what_the_store_cannot_do_is_said(void)
{
    const kc_store_t gone = {KC_TBL_ARM, 0u, s_image};
    const struct {
        long at;
        harm_t harm;
        const char *said;
    } changes[] = {{1, FAILS_ONCE, "can't write k01.a"},
                   {3, FLIPS, "k01.a does not read back as it was written"},
                   {5, FAILS_ONCE, "can't replace k01.a"},
                   {6, FAILS_ONCE, "can't sync"}};
    (void)store_arm(1);
    (void)store_arm(2);
    for (uint32_t i = 0u; i < 4u; i++) {
        s_m.on = true;
        s_m.n = 0;
        s_m.at = changes[i].at;
        s_m.harm = changes[i].harm;
        overhear();
        kc_status_t st = store_arm(3);
        expect_said(changes[i].said);
        TEST_ASSERT_TRUE(st != KC_OK);
        TEST_ASSERT_EQUAL_INT(2, reloaded());
    }
    s_m.at = 2; /* of the two, the older one is gone, but not for certain */
    s_m.n = 0;
    s_m.harm = FAILS_ONCE;
    overhear();
    kc_status_t st = kc_files_store(&s_f, &gone);
    expect_said("can't sync");
    TEST_ASSERT_EQUAL_INT(KC_ERR_NUM, st);
    s_m.at = 3; /* the second slot that is deleted */
    s_m.n = 0;
    overhear();
    st = kc_files_store(&s_f, &gone);
    expect_said("can't delete k01.b");
    TEST_ASSERT_EQUAL_INT(KC_ERR_NUM, st);
    s_m.at = 4; /* both are gone, but not for certain */
    s_m.n = 0;
    overhear();
    st = kc_files_store(&s_f, &gone);
    expect_said("can't sync");
    TEST_ASSERT_EQUAL_INT(KC_ERR_NUM, st);
}

/* Without standard input the store's folder may get its number. */
void test_a_process_without_standard_input_has_a_store_too(void)
{
    int input = dup(0);
    close_store();
    (void)close(0);
    bool opened = kc_files_open(&s_f, s_dir);
    int fd = s_f.dir_fd;
    s_f.dir_fd = dup(fd);
    (void)dup2(input, 0);
    (void)close(input);
    TEST_ASSERT_TRUE(opened);
    TEST_ASSERT_EQUAL_INT(0, fd);
    TEST_ASSERT_EQUAL_INT(KC_OK, store_arm(4));
    input = dup(0); /* and so may that of the tables */
    (void)close(0);
    int n = kc_files_load(&s_f, s_tables, APP);
    (void)dup2(input, 0);
    (void)close(input);
    TEST_ASSERT_EQUAL_INT(0, n);
}

void test_a_table_that_is_refused_is_named_with_the_reason(void)
{
    given_arm_image(6);
    s_image[50] ^= 1u;
    write_file(s_tables, "a.tbl", s_image, s_n);
    overhear();
    TEST_ASSERT_EQUAL_INT(0, reloaded());
    expect_said("kincal-fsw: can't use the table a.tbl: ");
}

/* ---- default tables ---- */

void test_a_write_that_a_signal_interrupts_is_repeated(void)
{
    s_m.write_errno = EINTR;
    s_m.n_odd = 3;
    TEST_ASSERT_EQUAL_INT(KC_OK, store_arm(1));
    TEST_ASSERT_EQUAL_INT(0, s_m.n_odd);
    TEST_ASSERT_EQUAL_INT(1, reloaded());
}

void test_a_write_that_writes_nothing_or_fails_at_its_end_is_refused(void)
{
    TEST_ASSERT_EQUAL_INT(KC_OK, store_arm(1));
    s_m.n_odd = 1;
    TEST_ASSERT_EQUAL_INT(KC_ERR_NUM, store_arm(2));
    s_m.write_errno = EIO;
    s_m.n_odd = 1;
    TEST_ASSERT_EQUAL_INT(KC_ERR_NUM, store_arm(2));
    s_m.close_fails = true;
    TEST_ASSERT_EQUAL_INT(KC_ERR_NUM, store_arm(2));
    s_m.close_fails = false;
    TEST_ASSERT_EQUAL_INT(1, reloaded());
}

void test_a_table_of_another_size_is_another_table(void)
{
    static kc_space_t space;
    given_space(&space, 12u, 1u);
    const kc_store_t longer = {KC_TBL_SPACE, given_image(KC_TBL_SPACE, &space, s_image), s_image};
    TEST_ASSERT_EQUAL_INT(KC_OK, kc_files_store(&s_f, &longer));
    const kc_store_t shorter = {KC_TBL_SPACE, longer.n - 1u, s_image}; /* the same bytes, but for the last */
    TEST_ASSERT_EQUAL_INT(KC_OK, kc_files_store(&s_f, &shorter));
    TEST_ASSERT_EQUAL_UINT64(2u, s_f.number[KC_TBL_SPACE][0] > s_f.number[KC_TBL_SPACE][1]
                                     ? s_f.number[KC_TBL_SPACE][0]
                                     : s_f.number[KC_TBL_SPACE][1]);
}

void test_a_slot_that_is_gone_when_it_is_loaded_does_no_harm(void)
{
    TEST_ASSERT_EQUAL_INT(KC_OK, store_arm(1));
    TEST_ASSERT_EQUAL_INT(KC_OK, store_arm(2));
    const uint64_t *num = s_f.number[KC_TBL_ARM];
    (void)snprintf(s_path, sizeof s_path, "%s/%s", s_dir, num[1] > num[0] ? "k01.b" : "k01.a");
    TEST_ASSERT_EQUAL_INT(0, unlink(s_path));
    overhear();
    TEST_ASSERT_TRUE(kc_files_load(&s_f, s_tables, APP) >= 0);
    expect_said("can't use the stored copy k01.b: No such file");
    kc_app_boot(APP);
    TEST_ASSERT_DOUBLE_WITHIN(1e-9, 0.01, kc_app_active(APP)->arm.tool_xyz_m[2]); /* the one before */
}

void test_default_tables_fill_what_the_store_does_not_have(void)
{
    given_arm_image(7);
    write_file(s_tables, "arm.tbl", s_image, s_n);
    TEST_ASSERT_EQUAL_INT(7, reloaded());
    (void)store_arm(2);
    TEST_ASSERT_EQUAL_INT(2, reloaded());
}

void test_the_first_good_table_by_name_is_taken_and_the_rest_is_passed_over(void)
{
    static uint8_t huge[KC_IMAGE_MAX + 1u];
    char name[80];
    given_arm_image(5);
    write_file(s_tables, "b.tbl", s_image, s_n);
    given_arm_image(6);
    write_file(s_tables, "c.tbl", s_image, s_n);
    write_file(s_tables, "a.txt", s_image, s_n);
    write_file(s_tables, ".tbl", s_image, s_n);
    memset(name, 'a', sizeof name);
    memcpy(&name[60], ".tbl", 5u); /* a name too long for us */
    write_file(s_tables, name, s_image, s_n);
    s_image[50] ^= 1u;
    write_file(s_tables, "a.tbl", s_image, s_n); /* damaged */
    write_file(s_tables, "a0.tbl", s_image, 0u);
    write_file(s_tables, "a9.tbl", s_image, 9u);
    memcpy(huge, s_image, KC_TBL_HDR_BYTES);
    write_file(s_tables, "ah.tbl", huge, sizeof huge);
    TEST_ASSERT_EQUAL_INT(5, reloaded());
    memcpy(&name[59], ".tbl", 5u); /* one letter less */
    given_arm_image(6);
    write_file(s_tables, name, s_image, s_n);
    TEST_ASSERT_EQUAL_INT(6, reloaded());
}

/* Whatever the order in which the directory has them. */
void test_of_many_good_tables_the_first_by_name_is_taken(void)
{
    char name[24];
    for (int i = 20; i > 0; i--) {
        given_arm_image(i);
        (void)snprintf(name, sizeof name, "t%02d.tbl", i);
        write_file(s_tables, name, s_image, s_n);
    }
    TEST_ASSERT_EQUAL_INT(1, reloaded());
}

void test_more_table_files_than_there_is_room_for_do_no_harm(void)
{
    char name[24];
    given_arm_image(4);
    for (int i = 0; i < 70; i++) {
        (void)snprintf(name, sizeof name, "t%02d.tbl", i);
        write_file(s_tables, name, s_image, s_n);
    }
    TEST_ASSERT_EQUAL_INT(4, reloaded());
    TEST_ASSERT_EQUAL_INT(KC_FILES_TABLES, kc_files_load(&s_f, s_tables, APP));
}

void test_a_tables_directory_that_is_not_there_is_refused(void)
{
    overhear();
    int n = kc_files_load(&s_f, "/nowhere", APP);
    expect_said("can't read the tables /nowhere");
    TEST_ASSERT_EQUAL_INT(-1, n);
}

/* ---- what stands in place of a file; numbers; starts on a medium that fails ---- */

/* Things that are no files, at s_path. */
typedef enum { A_FIFO, A_SOCKET, A_FOLDER, A_LOOP, A_LINK_OUT, A_DEVICE, N_THINGS } thing_t;

static void put_thing(thing_t thing)
{
    struct sockaddr_un to = {.sun_family = AF_UNIX};
    (void)remove(s_path);
    switch (thing) {
    case A_FIFO: TEST_ASSERT_EQUAL_INT(0, mkfifo(s_path, 0600)); break;
    case A_SOCKET: {
        int fd = socket(AF_UNIX, SOCK_STREAM, 0);
        memcpy(to.sun_path, s_path, strlen(s_path) + 1u);
        TEST_ASSERT_EQUAL_INT(0, bind(fd, (const struct sockaddr *)&to, sizeof to));
        (void)close(fd);
        break;
    }
    case A_FOLDER: TEST_ASSERT_EQUAL_INT(0, mkdir(s_path, 0700)); break;
    case A_LOOP: TEST_ASSERT_EQUAL_INT(0, symlink(s_path, s_path)); break;
    case A_LINK_OUT: TEST_ASSERT_EQUAL_INT(0, symlink("/proc/self/exe", s_path)); break;
    default: TEST_ASSERT_EQUAL_INT(0, symlink("/dev/zero", s_path)); break;
    }
}

void test_what_is_no_file_in_place_of_a_stored_copy_is_a_bad_copy(void)
{
    for (thing_t thing = 0; thing < N_THINGS; thing++) {
        (void)store_arm(1);
        (void)store_arm(2);
        (void)path(s_dir, s_f.number[KC_TBL_ARM][1] > s_f.number[KC_TBL_ARM][0] ? "k01.b" : "k01.a");
        put_thing(thing);
        TEST_ASSERT_EQUAL_INT(1, reloaded());
        TEST_ASSERT_TRUE(event_at(&APP->boot_events, KC_EVT_BOOT_SLOT_BAD) >= 0);
        if (thing != A_FOLDER) { /* replaced by what is written next */
            TEST_ASSERT_EQUAL_INT(KC_OK, store_arm(3));
            TEST_ASSERT_EQUAL_INT(3, reloaded());
        }
        (void)remove(s_path);
    }
}

void test_what_is_no_file_in_place_of_the_temporary_file_is_not_written_to(void)
{
    for (thing_t thing = 0; thing < N_THINGS; thing++) {
        (void)store_arm(1);
        (void)path(s_dir, "k01.tmp");
        put_thing(thing);
        TEST_ASSERT_EQUAL_INT(thing == A_FOLDER ? KC_ERR_NUM : KC_OK, store_arm(2 + (int)thing));
        overhear();
        TEST_ASSERT_EQUAL_INT(thing == A_FOLDER ? 1 : 2 + (int)thing, reloaded());
        if (thing == A_FOLDER) {
            expect_said("can't remove k01.tmp");
        } else {
            TEST_ASSERT_EQUAL_STRING("", heard());
        }
        (void)path(s_dir, "k01.tmp");
        (void)remove(s_path);
    }
}

void test_what_is_no_file_among_the_tables_is_passed_over_and_named(void)
{
    given_arm_image(5);
    write_file(s_tables, "b.tbl", s_image, s_n);
    for (thing_t thing = 0; thing < N_THINGS; thing++) {
        (void)path(s_tables, "a.tbl");
        put_thing(thing);
        overhear();
        TEST_ASSERT_EQUAL_INT(5, reloaded());
        expect_said("can't use the table a.tbl: ");
        (void)path(s_tables, "a.tbl");
        (void)remove(s_path);
    }
}

/* Read through a mapping, this is SIGBUS, as a sector is that cannot be read. */
void test_files_that_are_cut_off_while_they_are_read_are_bad_copies(void)
{
    (void)store_arm(1);
    (void)store_arm(2);
    given_arm_image(5);
    write_file(s_tables, "b.tbl", s_image, s_n);
    s_m.cuts = true;
    overhear();
    TEST_ASSERT_EQUAL_INT(0, reloaded());
    expect_said("can't use the stored copy k01.a: cut short");
    TEST_ASSERT_TRUE(event_at(&APP->boot_events, KC_EVT_BOOT_SLOT_BAD) >= 0);
}

/* An ARM table in a slot under a number. */
static void put_numbered(unsigned slot, int which, uint64_t number)
{
    static uint8_t whole[KC_SLOT_HDR_BYTES + KC_IMAGE_MAX];
    given_arm_image(which);
    memset(whole, 0, KC_SLOT_HDR_BYTES);
    memcpy(whole, "KCS1", 4u);
    whole[4] = KC_TBL_ARM;
    for (unsigned i = 0u; i < 8u; i++) { whole[8u + i] = (uint8_t)(number >> (8u * i)); }
    for (unsigned i = 0u; i < 4u; i++) { whole[16u + i] = (uint8_t)(s_n >> (8u * i)); }
    uint32_t crc = kc_crc32(kc_crc32(0u, whole, 20u), s_image, s_n);
    for (unsigned i = 0u; i < 4u; i++) { whole[20u + i] = (uint8_t)(crc >> (8u * i)); }
    memcpy(&whole[KC_SLOT_HDR_BYTES], s_image, s_n);
    write_file(s_dir, slot == 0u ? "k01.a" : "k01.b", whole, KC_SLOT_HDR_BYTES + s_n);
}

void test_whatever_the_numbers_of_slots_are_the_next_write_counts(void)
{
    static const uint64_t numbers[] = {0u,
                                       1u,
                                       2u,
                                       5u,
                                       INT64_MAX - 1u,
                                       INT64_MAX,
                                       1u + (uint64_t)INT64_MAX,
                                       2u + (uint64_t)INT64_MAX,
                                       UINT64_MAX - 1u,
                                       UINT64_MAX};
    const unsigned n = sizeof numbers / sizeof numbers[0];
    for (unsigned i = 0u; i < n * n; i++) {
        put_numbered(0u, 1, numbers[i / n]);
        put_numbered(1u, 2, numbers[i % n]);
        (void)reloaded();
        for (int which = 3; which <= 6; which++) {
            TEST_ASSERT_EQUAL_INT(KC_OK, store_arm(which));
            TEST_ASSERT_EQUAL_INT(which, reloaded());
        }
    }
}

void test_the_number_after_the_largest_is_newer(void)
{
    put_numbered(0u, 1, UINT64_MAX);
    put_numbered(1u, 2, 1u);
    TEST_ASSERT_EQUAL_INT(2, reloaded());
    put_numbered(1u, 2, UINT64_MAX - 1u);
    TEST_ASSERT_EQUAL_INT(1, reloaded());
    put_numbered(1u, 2, UINT64_MAX / 2u); /* by one more than half of all numbers: the other way round */
    TEST_ASSERT_EQUAL_INT(1, reloaded());
    put_numbered(1u, 2, UINT64_MAX / 2u - 1u);
    TEST_ASSERT_EQUAL_INT(2, reloaded());
}

static bool was_synced(const char *what)
{
    struct stat st;
    TEST_ASSERT_EQUAL_INT(0, stat(what, &st));
    for (unsigned i = 0u; i < 8u; i++) {
        if (s_m.synced[i] == st.st_ino) { return true; }
    }
    return false;
}

void test_a_store_and_its_entry_in_the_folder_around_it_are_synced_at_the_start(void)
{
    TEST_ASSERT_TRUE(was_synced(s_root) && was_synced(s_dir));
    memset(s_m.synced, 0, sizeof s_m.synced);
    TEST_ASSERT_EQUAL_INT(0, reloaded());
    TEST_ASSERT_TRUE(was_synced(s_root) && was_synced(s_dir));
}

/* A new one would be gone with all that was said to be stored; an old one is readable on a medium that is not
 * writable any more. */
void test_a_new_store_that_cannot_be_synced_is_refused_and_an_old_one_used(void)
{
    for (int made = 1; made >= 0; made--) {
        close_store();
        if (made == 1) { TEST_ASSERT_EQUAL_INT(0, rmdir(s_dir)); }
        s_m.on = true;
        s_m.n = 0;
        s_m.at = 2; /* after mkdir */
        s_m.harm = FAILS_FROM;
        if (made == 0) {
            s_m.n = 1;
            s_m.at = 3;
        }
        overhear();
        bool opened = kc_files_open(&s_f, s_dir);
        s_m.on = false;
        expect_said("can't sync the folder of the store");
        TEST_ASSERT_TRUE(opened == (made == 0));
        TEST_ASSERT_TRUE(opened == (s_f.dir_fd >= 0));
        if (made == 1) { open_store(); }
    }
}

/* ---- approval, rejection, rollback, a correction from the ground: killed or refused anywhere ---- */

typedef struct {
    uint32_t n[KC_FILES_KINDS][2];
    uint8_t data[KC_FILES_KINDS][2][KC_SLOT_HDR_BYTES + KC_KIN_IMAGE_MAX];
} stored_t;

/* What is in force. */
typedef struct {
    uint32_t kin, prev, proposal;
} in_force_t;

static stored_t s_begin;
static long s_kills, s_failures, s_replays;

static kc_status_t keep_in_files(const kc_store_t *s) { return kc_files_store(&s_f, s); }

static void slot_path(uint16_t kind, unsigned slot)
{
    char name[16];
    (void)snprintf(name, sizeof name, "k%02u.%c", (unsigned)kind, slot == 0u ? 'a' : 'b');
    (void)path(s_dir, name);
}

static void save(stored_t *to)
{
    memset(to, 0, sizeof *to);
    for (unsigned i = 0u; i < 8u; i++) {
        uint16_t k = s_small[i / 2u];
        slot_path(k, i % 2u);
        FILE *f = fopen(s_path, "rb");
        if (f == NULL) { continue; }
        to->n[k][i % 2u] = (uint32_t)fread(to->data[k][i % 2u], 1u, sizeof to->data[k][0], f);
        (void)fclose(f);
    }
}

static void restore(const stored_t *from)
{
    for (unsigned i = 0u; i < 8u; i++) {
        uint16_t k = s_small[i / 2u];
        slot_path(k, i % 2u);
        (void)remove(s_path);
        if (from->n[k][i % 2u] == 0u) { continue; }
        FILE *f = fopen(s_path, "wb");
        TEST_ASSERT_NOT_NULL(f);
        (void)fwrite(from->data[k][i % 2u], 1u, from->n[k][i % 2u], f);
        (void)fclose(f);
    }
}

/* The default tables as files, once; later starts load them and what is stored. */
static void given_default_tables(void)
{
    static const uint16_t kinds[] = {1, 2, 3, 5, 6, 7};
    world_boot();
    for (unsigned i = 0u; i < 6u; i++) {
        char name[16];
        (void)snprintf(name, sizeof name, "t%u.tbl", (unsigned)kinds[i]);
        s_n = given_image(kinds[i], kc_tbl_active_ptr(kc_app_active(APP), kinds[i]), s_image);
        write_file(s_tables, name, s_image, s_n);
    }
}

static void power_up(void)
{
    close_store();
    open_store();
    world.requested = false;
    memset(&world.in, 0, sizeof world.in);
    memset(world.events, 0, sizeof world.events);
    world.cmd_seq[1] = world.cmd_seq[2] = 0;
    kc_app_init(APP);
    kc_app_keys(APP, &world.keys);
    (void)kc_files_load(&s_f, s_tables, APP);
    kc_app_boot(APP);
    world_tick();
}

static in_force_t in_force(void)
{
    const kc_active_t *a = kc_app_active(APP);
    return (in_force_t){a->crc[KC_TBL_KIN], a->kin_prev_crc, APP->review.crc};
}

static bool same(in_force_t a, in_force_t b)
{
    return a.kin == b.kin && a.prev == b.prev && a.proposal == b.proposal;
}

static int32_t approve(void)
{
    int32_t crc = (int32_t)APP->review.crc;
    int32_t st = world_do(KC_CMD_APPROVE_ARM, crc, 0, 0);
    return st == KC_OK ? world_do(KC_CMD_APPROVE_GO, crc, 0, 0) : st;
}

static int32_t reject(void) { return world_do(KC_CMD_REJECT, (int32_t)APP->review.crc, 0, 0); }

static int32_t roll_back(void)
{
    return world_do(KC_CMD_ROLLBACK, (int32_t)kc_app_active(APP)->crc[KC_TBL_KIN], 0, 0);
}

static int32_t from_ground(void)
{
    static kc_kin_t kin;
    world_kin(&kin);
    kin.value[3] = 0.01;
    s_n = given_image(KC_TBL_KIN, &kin, s_image);
    int32_t crc = world_upload(KC_TBL_KIN, s_image, s_n);
    int32_t st = world_do(KC_CMD_TABLE_VALIDATE, KC_TBL_KIN, crc, 0);
    return st == KC_OK ? world_do(KC_CMD_TABLE_ACTIVATE, KC_TBL_KIN, crc, 0) : st;
}

/* A calibration, up to a proposal that waits. */
static void proposed(double phi_rad)
{
    world.truth.joint[6].phi_rad = phi_rad;
    memset(world.q, 0, sizeof world.q);
    memset(world.q_cmd, 0, sizeof world.q_cmd);
    world_ticks(2u);
    TEST_ASSERT_EQUAL_INT(KC_OK, world_do(KC_CMD_START, -1, 8, 3));
    for (uint32_t i = 0u; i < 4000u && world_calibrating(); i++) { world_tick(); }
    TEST_ASSERT_TRUE(world_stored(10u));
    TEST_ASSERT_EQUAL_INT(KC_ST_REVIEW, kc_app_state(APP));
}

/* n_before approvals, and a proposal that waits (or was rejected). */
static void given_history(int n_before, bool waits)
{
    given_default_tables();
    world.keep = keep_in_files;
    power_up();
    for (int i = 0; i <= n_before; i++) {
        proposed(0.1 * (i + 1));
        if (i < n_before) { TEST_ASSERT_EQUAL_INT(KC_OK, approve()); }
    }
    if (!waits) { TEST_ASSERT_EQUAL_INT(KC_OK, reject()); }
    world_ticks(3u);
    save(&s_begin);
}

static int32_t s_acked; /* answer of the change; 1: none came */

/* From the saved store: power up and make the change on a medium that does harm. True if power was lost. */
static bool harmed(int32_t (*change)(void), harm_t harm, long at, double torn)
{
    s_acked = 1;
    s_m.harm = harm;
    s_m.at = at;
    s_m.torn = torn;
    s_m.n = 0;
    s_m.reached = false;
    memset(world.sent, 0, sizeof world.sent);
    memset(&world.answered, 0, sizeof world.answered);
    if (setjmp(s_m.power) != 0) { return true; }
    power_up();
    s_m.on = true;
    world.ack.status = 1;
    s_acked = change();
    world_ticks(3u);
    s_m.on = false;
    return false;
}

/* What is in force after a restart, with nothing missed and nothing left half-written. */
static in_force_t restarted(void)
{
    s_m.on = false;
    power_up();
    TEST_ASSERT_EQUAL_UINT32(0u, world_events(KC_EVT_BOOT_LOST));
    TEST_ASSERT_EQUAL_UINT32(0u, world_events(KC_EVT_BOOT_SLOT_BAD));
    TEST_ASSERT_EQUAL_UINT32(0u, world_events(KC_EVT_TBL_DEPENDS));
    TEST_ASSERT_EQUAL_INT(APP->review.crc != 0u ? KC_ST_REVIEW : KC_ST_IDLE, kc_app_state(APP));
    return in_force();
}

typedef struct {
    int32_t (*change)(void);
    in_force_t before, after;
    long n; /* changes of files that it takes */
} case_t;

static case_t given_case(int32_t (*change)(void))
{
    case_t c = {.change = change};
    restore(&s_begin);
    power_up();
    c.before = in_force();
    restore(&s_begin);
    TEST_ASSERT_FALSE(harmed(change, HOLDS, 0, 0.0));
    TEST_ASSERT_EQUAL_INT(KC_OK, s_acked);
    c.n = s_m.n;
    c.after = in_force();
    TEST_ASSERT_FALSE(same(c.before, c.after));
    TEST_ASSERT_TRUE(same(c.after, restarted()));
    return c;
}

/* What was answered as accepted is refused when somebody sends it again. */
static void check_replay(const char *what)
{
    in_force_t now = in_force();
    uint32_t before = world_events(KC_EVT_CMD_REPLAYED);
    if (world.answered.auth.key_id == 0u) { return; }
    s_replays++;
    world.as_sent = true;
    world.in.cmd[world.in.n_cmd++] = world.answered;
    world_tick();
    world.as_sent = false;
    TEST_ASSERT_EQUAL_UINT32_MESSAGE(before + 1u, world_events(KC_EVT_CMD_REPLAYED), what);
    TEST_ASSERT_TRUE_MESSAGE(same(now, in_force()), what);
}

/* Old or new, never a mixture; new for certain if it was answered. */
static void check_kill(const case_t *c, long at, double torn)
{
    char what[64];
    (void)snprintf(what, sizeof what, "kill at change %ld, %.2f of it done", at, torn);
    in_force_t now = restarted();
    TEST_ASSERT_TRUE_MESSAGE(same(now, c->before) || same(now, c->after), what);
    TEST_ASSERT_TRUE_MESSAGE(s_acked != KC_OK || same(now, c->after), what);
    check_replay(what);
    s_kills++;
}

/* Killed at every change of a file, a write torn in several places; then made again, and killed again. */
static void killed_everywhere(int32_t (*change)(void))
{
    static const double torn[] = {0.0, 0.02, 0.5, 0.99, 1.0};
    case_t c = given_case(change);
    int old = 0, new = 0;
    for (long at = 1; at <= c.n; at++) {
        for (unsigned t = 0u; t < sizeof torn / sizeof torn[0]; t++) {
            restore(&s_begin);
            TEST_ASSERT_TRUE(harmed(change, KILLS, at, torn[t]));
            check_kill(&c, at, torn[t]);
            if (same(in_force(), c.after)) {
                new ++;
                continue;
            }
            old++;
            for (long k = 0; k < 2 && same(in_force(), c.before); k++) {
                long again = (at * 7 + (long)t * 3 + k * 11) % c.n + 1;
                if (harmed(change, KILLS, again, 0.5)) { check_kill(&c, again, 0.5); }
            }
            if (same(in_force(), c.before)) { TEST_ASSERT_EQUAL_INT(KC_OK, c.change()); }
            TEST_ASSERT_TRUE(same(restarted(), c.after));
        }
    }
    TEST_ASSERT_TRUE(old > 0 && new > 0);
}

/* Answered as made: it is, and stays so. Answered as refused: nothing has changed, an event says so, and later
 * it can be made. */
static void check_failure(const case_t *c, harm_t harm)
{
    char what[64];
    (void)snprintf(what, sizeof what, "harm %d at change %ld", (int)harm, s_m.at);
    in_force_t now = in_force();
    TEST_ASSERT_TRUE_MESSAGE(same(now, s_acked == KC_OK ? c->after : c->before), what);
    TEST_ASSERT_TRUE_MESSAGE(s_acked == KC_OK || world_events(KC_EVT_STORE_REFUSED) > 0u, what);
    if (s_acked != KC_OK) { TEST_ASSERT_EQUAL_INT(KC_EVT_STORE_REFUSED, world.ack.event_id); }
    TEST_ASSERT_TRUE_MESSAGE(!s_m.reached || world_events(KC_EVT_STORE_FAIL) > 0u || harm == FLIPS, what);
    TEST_ASSERT_TRUE_MESSAGE(same(restarted(), now), what);
    if (s_acked != KC_OK) { TEST_ASSERT_EQUAL_INT(KC_OK, c->change()); }
    TEST_ASSERT_TRUE_MESSAGE(same(restarted(), c->after), what);
    s_failures++;
}

/* Every change of a file fails: once, or it and all after it; every write reads back otherwise. */
static void refused_everywhere(int32_t (*change)(void))
{
    static const harm_t harms[] = {FAILS_ONCE, FAILS_ALL_BUT_DELETING, FLIPS};
    case_t c = given_case(change);
    for (long at = 1; at <= c.n; at++) {
        for (unsigned h = 0u; h < sizeof harms / sizeof harms[0]; h++) {
            restore(&s_begin);
            TEST_ASSERT_FALSE(harmed(change, harms[h], at, 0.0));
            if (harms[h] != FAILS_ALL_BUT_DELETING) {
                TEST_ASSERT_EQUAL_INT(KC_OK, s_acked);
            } /* tried again */
            check_failure(&c, harms[h]);
        }
    }
}

static void given_first(void) { given_history(0, true); }
static void given_second(void) { given_history(1, true); }
static void given_none_waiting(void) { given_history(2, false); }

static void killed_and_refused(void (*given)(void), int32_t (*change)(void))
{
    given();
    killed_everywhere(change);
    refused_everywhere(change);
    (void)printf("%ld kills, %ld failures, %ld repetitions\n", s_kills, s_failures, s_replays);
}

void test_the_first_approval_is_made_or_not_wherever_it_is_killed_or_refused(void)
{
    killed_and_refused(given_first, approve);
    TEST_ASSERT_TRUE(s_kills >= 350 && s_failures >= 100);
    TEST_ASSERT_TRUE(s_replays >= 200); /* of the first step of the approval, or of both */
}

void test_a_later_approval_is_made_or_not_wherever_it_is_killed_or_refused(void)
{
    killed_and_refused(given_second, approve);
    TEST_ASSERT_TRUE(s_kills >= 330 && s_failures >= 90);
}

void test_a_rejection_is_made_or_not_wherever_it_is_killed_or_refused(void)
{
    killed_and_refused(given_second, reject);
    TEST_ASSERT_TRUE(s_kills >= 100 && s_failures >= 40);
}

void test_a_rollback_is_made_or_not_wherever_it_is_killed_or_refused(void)
{
    killed_and_refused(given_none_waiting, roll_back);
    TEST_ASSERT_TRUE(s_kills >= 180 && s_failures >= 60);
}

void test_a_correction_from_the_ground_is_made_or_not_wherever_it_is_killed_or_refused(void)
{
    killed_and_refused(given_none_waiting, from_ground);
    TEST_ASSERT_TRUE(s_kills >= 260 && s_failures >= 70);
}

/* An approval that lost power as late as it could without being made, and is rejected then: the newest copies
 * are not those in force, and the next change must not write over the last copy of what is. */
static void given_left_overs(void)
{
    given_second();
    case_t c = given_case(approve);
    long at = c.n;
    do {
        restore(&s_begin);
        TEST_ASSERT_TRUE(harmed(approve, KILLS, at--, 1.0));
    } while (!same(restarted(), c.before));
    TEST_ASSERT_EQUAL_INT(KC_OK, reject());
    world_ticks(3u);
    save(&s_begin);
}

void test_a_correction_after_an_approval_that_was_cut_off_is_made_or_not(void)
{
    killed_and_refused(given_left_overs, from_ground);
    TEST_ASSERT_TRUE(s_kills >= 260 && s_failures >= 70);
}

/* The medium dies for good at any change. What was answered as made stays; what was answered as refused may
 * be found made only if the medium died between the write that makes it and its confirmation. */
void test_on_a_medium_that_dies_for_good_at_most_the_last_write_is_uncertain(void)
{
    int uncertain = 0;
    given_second();
    case_t c = given_case(approve);
    for (long at = 1; at <= c.n; at++) {
        restore(&s_begin);
        TEST_ASSERT_FALSE(harmed(approve, FAILS_FROM, at, 0.0));
        in_force_t now = in_force(), later = restarted();
        TEST_ASSERT_TRUE(same(now, s_acked == KC_OK ? c.after : c.before));
        TEST_ASSERT_TRUE(same(later, c.before) || same(later, c.after));
        uncertain += !same(now, later);
        TEST_ASSERT_TRUE(s_acked != KC_OK || same(later, now));
    }
    TEST_ASSERT_EQUAL_INT(1, uncertain);
}

/* ---- a start with a fault at any call; a change with a fault at any call, reads too ---- */

static long s_starts, s_refused_starts, s_changed_starts;

/* False if there is no such call any more. It succeeds, with all that is stored or with an event about the copy that
 * is not used; or it says what is wrong. */
static bool started_with(harm_t harm, long at, in_force_t stored)
{
    char what[64];
    (void)snprintf(what, sizeof what, "harm %d at call %ld", (int)harm, at);
    restore(&s_begin);
    close_store();
    s_m.on = s_m.reads = true;
    s_m.harm = harm;
    s_m.at = at;
    s_m.n = 0;
    s_m.reached = false;
    memset(world.events, 0, sizeof world.events);
    overhear();
    kc_app_init(APP);
    kc_app_keys(APP, &world.keys);
    bool started = kc_files_open(&s_f, s_dir) && kc_files_load(&s_f, s_tables, APP) >= 0;
    s_m.on = s_m.reads = false;
    bool said = heard()[0] != '\0';
    if (!s_m.reached) { return false; }
    s_starts++;
    bool failed = harm == FAILS_ONCE || harm == ENDS;
    TEST_ASSERT_TRUE_MESSAGE(failed || !said, what);
    TEST_ASSERT_TRUE_MESSAGE(started || said, what);
    s_refused_starts += !started;
    if (!started) { return true; }
    kc_app_boot(APP);
    world.requested = false;
    memset(&world.in, 0, sizeof world.in);
    world_tick();
    in_force_t now = in_force();
    s_changed_starts += !same(now, stored);
    bool reported = world_events(KC_EVT_BOOT_SLOT_BAD) > 0u || world_events(KC_EVT_TBL_MISSING) > 0u;
    TEST_ASSERT_TRUE_MESSAGE(same(now, stored) || reported, what);
    TEST_ASSERT_TRUE_MESSAGE(said || !reported, what);
    TEST_ASSERT_TRUE_MESSAGE(failed || !reported, what);
    bool lost = world_events(KC_EVT_BOOT_LOST) > 0u;
    power_up(); /* on a medium that is well again: what was said last, or all that was stored */
    TEST_ASSERT_TRUE_MESSAGE(lost || same(in_force(), now) || same(in_force(), stored), what);
    return true;
}

void test_a_start_with_a_fault_at_any_call_succeeds_or_says_what_is_wrong(void)
{
    static const harm_t harms[] = {FAILS_ONCE, ENDS, INTERRUPTS, SHORTENS};
    given_second();
    restore(&s_begin);
    power_up();
    in_force_t stored = in_force();
    for (unsigned h = 0u; h < sizeof harms / sizeof harms[0]; h++) {
        for (long at = 1; started_with(harms[h], at, stored); at++) {}
    }
    (void)printf("%ld starts, %ld refused, %ld with an older copy\n", s_starts, s_refused_starts,
                 s_changed_starts);
    TEST_ASSERT_TRUE(s_starts >= 500 && s_refused_starts >= 4 && s_changed_starts >= 4);
}

/* Answered as made: it is, and stays so. Answered as refused: nothing has changed. A read that fails is no failure of the store
 * where it only was to save a write. */
static void misread_everywhere(int32_t (*change)(void))
{
    static const harm_t harms[] = {FAILS_ONCE, ENDS, INTERRUPTS, SHORTENS};
    case_t c = given_case(change);
    s_m.reads = true;
    restore(&s_begin);
    TEST_ASSERT_FALSE(harmed(change, HOLDS, 0, 0.0));
    long n = s_m.n;
    for (long at = 1; at <= n; at++) {
        for (unsigned h = 0u; h < sizeof harms / sizeof harms[0]; h++) {
            char what[64];
            (void)snprintf(what, sizeof what, "harm %d at call %ld", (int)harms[h], at);
            restore(&s_begin);
            TEST_ASSERT_FALSE(harmed(change, harms[h], at, 0.0));
            in_force_t now = in_force();
            TEST_ASSERT_EQUAL_INT_MESSAGE(KC_OK, s_acked, what); /* tried again where it failed */
            TEST_ASSERT_TRUE_MESSAGE(same(now, c.after), what);
            TEST_ASSERT_TRUE_MESSAGE(same(restarted(), now), what);
            TEST_ASSERT_TRUE(harms[h] < ENDS || s_m.reached);
            s_failures++;
        }
    }
    s_m.reads = false;
}

void test_an_approval_or_rejection_with_a_fault_at_any_call_is_made_and_stays(void)
{
    given_second();
    misread_everywhere(approve);
    misread_everywhere(reject);
    TEST_ASSERT_TRUE(s_failures >= 500);
}

void test_a_rollback_or_correction_with_a_fault_at_any_call_is_made_and_stays(void)
{
    given_none_waiting();
    misread_everywhere(from_ground);
    misread_everywhere(roll_back);
    TEST_ASSERT_TRUE(s_failures >= 500);
}

/* ---- power lost at any call, what was not synced in any order ---- */

/* The files as they are, all synced. */
static void power_on(void)
{
    s_power.on = true;
    s_power.n_inodes = 0u;
    for (uint32_t i = 0u; i < NAMES; i++) {
        char name[16];
        power_name(i, name);
        inode_t *to = &s_power.inode[s_power.n_inodes];
        FILE *f = fopen(path(s_dir, name), "rb");
        s_power.n[i] = 1u;
        s_power.file[i][0] = f != NULL ? (int)s_power.n_inodes++ : -1;
        if (f == NULL) { continue; }
        to->n = (uint32_t)fread(to->data, 1u, sizeof to->data, f);
        to->synced = true;
        (void)fclose(f);
    }
}

/* What a file has that was not synced: nothing, its beginning, zeros, sectors of it, all. */
static void lose_content(inode_t *i)
{
    uint32_t how = power_draws(5u);
    if (how == 0u) { i->n = 0u; }
    if (how == 1u) { i->n = power_draws(i->n + 1u); }
    if (how == 2u) { memset(i->data, 0, i->n); }
    for (uint32_t at = 0u; how == 3u && at < i->n; at += 512u) {
        uint32_t n = i->n - at < 512u ? i->n - at : 512u;
        if (power_draws(2u) == 0u) { memset(&i->data[at], 0, n); }
    }
}

/* Which of its files a name stands for: with draw 0 the oldest, with 1 the newest, else any. */
static void lose_power(uint32_t draw, uint32_t seed)
{
    s_power.random = seed;
    for (uint32_t i = 0u; i < s_power.n_inodes; i++) {
        if (!s_power.inode[i].synced) { lose_content(&s_power.inode[i]); }
    }
    for (uint32_t i = 0u; i < NAMES; i++) {
        char name[16];
        uint32_t k = draw == 0u ? 0u : draw == 1u ? s_power.n[i] - 1u : power_draws(s_power.n[i]);
        int inode = s_power.file[i][k];
        power_name(i, name);
        (void)remove(path(s_dir, name));
        if (inode >= 0) { write_file(s_dir, name, s_power.inode[inode].data, s_power.inode[inode].n); }
    }
    s_power.on = false;
}

#define DRAWS 12u

/* Power is lost at every change of a file, or after the last; before it perhaps the process, which was started again
 * and has said what is in force. */
static void lost_everywhere(int32_t (*change)(void))
{
    case_t c = given_case(change);
    int old = 0, new = 0;
    for (long at = 1; at <= c.n + 1; at++) {
        for (uint32_t draw = 0u; draw < DRAWS; draw++) {
            char what[64];
            (void)snprintf(what, sizeof what, "power lost at change %ld, draw %u", at, (unsigned)draw);
            restore(&s_begin);
            power_on();
            TEST_ASSERT_TRUE(harmed(change, KILLS, at, 0.5) == (at <= c.n));
            bool again = draw % 3u == 2u;
            in_force_t said = again ? restarted() : c.before;
            lose_power(draw / 3u, (uint32_t)at * 1000u + draw);
            check_kill(&c, at, (double)draw);
            TEST_ASSERT_TRUE_MESSAGE(!again || same(said, in_force()), what);
            old += same(in_force(), c.before);
            new += same(in_force(), c.after);
        }
    }
    TEST_ASSERT_TRUE(old > 0 && new > 0);
}

void test_an_approval_is_made_or_not_whatever_a_loss_of_power_leaves(void)
{
    given_second();
    lost_everywhere(approve);
}

void test_a_rejection_is_made_or_not_whatever_a_loss_of_power_leaves(void)
{
    given_second();
    lost_everywhere(reject);
}

void test_a_rollback_is_made_or_not_whatever_a_loss_of_power_leaves(void)
{
    given_none_waiting();
    lost_everywhere(roll_back);
}

void test_a_correction_from_the_ground_is_made_or_not_whatever_a_loss_of_power_leaves(void)
{
    given_none_waiting();
    lost_everywhere(from_ground);
}

/* ---- found missing by mutants ---- */

static size_t read_slot(const char *name, uint8_t *whole, size_t most)
{
    FILE *f = fopen(path(s_dir, name), "rb");
    TEST_ASSERT_NOT_NULL(f);
    size_t n = fread(whole, 1u, most, f);
    (void)fclose(f);
    return n;
}

/* A slot that cannot be read holds nothing, though its content is what has to be stored. */
void test_a_damaged_slot_with_the_right_content_is_no_copy(void)
{
    static uint8_t whole[KC_IMAGE_MAX + KC_SLOT_HDR_BYTES];
    (void)store_arm(1);
    (void)store_arm(2);
    size_t n = read_slot("k01.b", whole, sizeof whole);
    whole[20] ^= 1u; /* its CRC */
    write_file(s_dir, "k01.b", whole, n);
    TEST_ASSERT_EQUAL_INT(0, unlink(path(s_dir, "k01.a")));
    TEST_ASSERT_EQUAL_INT(0, reloaded());
    TEST_ASSERT_EQUAL_INT(KC_OK, store_arm(2));
    TEST_ASSERT_EQUAL_INT(2, reloaded());
}

void test_the_reserved_bytes_of_a_slot_are_zero(void)
{
    uint8_t header[KC_SLOT_HDR_BYTES];
    for (int which = 1; which <= 4; which++) {
        TEST_ASSERT_EQUAL_INT(KC_OK, store_arm(which));
        TEST_ASSERT_EQUAL_UINT64(sizeof header,
                                 read_slot((which & 1) != 0 ? "k01.a" : "k01.b", header, sizeof header));
        TEST_ASSERT_EQUAL_HEX8(0u, header[6]);
        TEST_ASSERT_EQUAL_HEX8(0u, header[7]);
        TEST_ASSERT_EQUAL_HEX8(which, header[8]);
    }
}

/* What is behind a part that is read at a time counts too. */
void test_a_large_copy_is_read_to_its_last_byte(void)
{
    static uint8_t whole[KC_SLOT_HDR_BYTES + 5000u];
    for (uint32_t i = 0u; i < 5000u; i++) { s_image[i] = (uint8_t)(i * 7u + i / 251u); }
    const kc_store_t large = {KC_TBL_SPACE, 5000u, s_image};
    TEST_ASSERT_EQUAL_INT(KC_OK, kc_files_store(&s_f, &large));
    size_t n = read_slot("k05.a", whole, sizeof whole);
    TEST_ASSERT_EQUAL_UINT64(sizeof whole, n);
    for (size_t at = 23u; at < n; at += 711u) {
        whole[at] ^= 1u;
        write_file(s_dir, "k05.a", whole, n);
        close_store();
        open_store();
        TEST_ASSERT_EQUAL_UINT64(0u, s_f.number[KC_TBL_SPACE][0]);
        TEST_ASSERT_EQUAL_UINT8(1u, s_f.there[KC_TBL_SPACE][0]);
        whole[at] ^= 1u;
    }
    write_file(s_dir, "k05.a", whole, n);
    close_store();
    open_store();
    TEST_ASSERT_EQUAL_UINT64(1u, s_f.number[KC_TBL_SPACE][0]);
}

/* A copy is one if its number and its size are those expected: it is not written again. */
void test_a_copy_under_another_number_or_of_another_size_is_no_copy(void)
{
    for (uint32_t i = 0u; i < 100u; i++) { s_image[i] = (uint8_t)i; }
    const kc_store_t shorter = {KC_TBL_SPACE, 99u, s_image}, longer = {KC_TBL_SPACE, 100u, s_image};
    TEST_ASSERT_EQUAL_INT(KC_OK, kc_files_store(&s_f, &shorter));
    TEST_ASSERT_EQUAL_INT(KC_OK, kc_files_store(&s_f, &shorter));
    TEST_ASSERT_FALSE(exists(s_dir, "k05.b"));
    TEST_ASSERT_EQUAL_INT(KC_OK, kc_files_store(&s_f, &longer));
    TEST_ASSERT_TRUE(exists(s_dir, "k05.b"));
    TEST_ASSERT_EQUAL_INT(KC_OK, store_arm(1));
    put_numbered(0u, 1, 9u); /* behind our back */
    TEST_ASSERT_EQUAL_INT(KC_OK, store_arm(1));
    TEST_ASSERT_TRUE(exists(s_dir, "k01.b"));
}

/* The slot that was taken back is the one that is written next: the other one holds the only copy. */
void test_after_a_write_that_was_taken_back_the_only_copy_is_not_written_over(void)
{
    uint8_t before[KC_SLOT_HDR_BYTES], after[KC_SLOT_HDR_BYTES];
    (void)store_arm(1);
    (void)store_arm(2);
    (void)read_slot("k01.b", before, sizeof before);
    s_m.on = true;
    s_m.at = 6; /* the sync of the folder */
    s_m.harm = FAILS_ONCE;
    TEST_ASSERT_EQUAL_INT(KC_ERR_NUM, store_arm(3));
    s_m.on = false;
    struct stat st;
    TEST_ASSERT_EQUAL_INT(0, stat(s_dir, &st));
    TEST_ASSERT_TRUE(s_m.n_synced > 0u &&
                     s_m.synced[(s_m.n_synced - 1u) % 8u] == st.st_ino); /* what was undone */
    TEST_ASSERT_FALSE(exists(s_dir, "k01.a"));
    TEST_ASSERT_EQUAL_UINT64(0u, s_f.number[KC_TBL_ARM][0]);
    TEST_ASSERT_EQUAL_UINT8(0u, s_f.there[KC_TBL_ARM][0]);
    TEST_ASSERT_EQUAL_INT(KC_OK, store_arm(4));
    (void)read_slot("k01.b", after, sizeof after);
    TEST_ASSERT_EQUAL_MEMORY(before, after, sizeof before);
    TEST_ASSERT_EQUAL_INT(4, reloaded());
}
