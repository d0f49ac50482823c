/* kc_files.c: the store through torn writes, damage and kills; the directory of tables. */
#define _GNU_SOURCE /* NOLINT: mkdtemp, syscall */

#include <errno.h>
#include <fcntl.h>
#include <setjmp.h>
#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/stat.h>
#include <sys/syscall.h>
#include <unistd.h>

#include "given_tables.h"
#include "given_world.h"
#include "kc_files.h"
#include "unity.h"

#define APP (&kc_app_instance)

static kc_files_t s_f;
static char s_root[64], s_dir[128], s_tables[128], s_path[256];
static uint8_t s_image[KC_IMAGE_MAX];
static uint32_t s_n;

/* ---- a medium that fails, or loses power, at any change of a file ----
 *
 * These take the place of the C library's for kc_files.c. Changes are counted from 1 while s_count is on. */

typedef enum { HOLDS, KILLS, FAILS_ONCE, FAILS_FROM, FAILS_ALL_BUT_DELETING, FLIPS } harm_t;

static struct {
    bool on;
    harm_t harm;
    long at, n;    /* change that suffers, changes so far */
    double torn;   /* KILLS: part of a write that is done first */
    int fd;        /* open for writing */
    bool reached;   /* the change was reached */
    int write_errno, n_odd; /* the next n_odd writes write nothing: 0, or -1 with this errno */
    bool close_fails;       /* of what was written */
    jmp_buf power; /* gone */
} s_m = {.fd = -1};

static bool suffers(bool deleting)
{
    if (!s_m.on) { return false; }
    s_m.n++;
    bool hit = s_m.n == s_m.at || (s_m.n > s_m.at && s_m.harm >= FAILS_FROM && s_m.harm != FLIPS);
    if (!hit || s_m.harm == HOLDS || (deleting && s_m.harm == FAILS_ALL_BUT_DELETING)) { return false; }
    s_m.reached = true;
    if (s_m.harm == FLIPS) { return false; }
    errno = s_m.at % 2 == 0 ? ENOSPC : EROFS;
    return true;
}

static void die(void)
{
    if (s_m.harm != KILLS) { return; }
    if (s_m.fd >= 0) { (void)syscall(SYS_close, s_m.fd); }
    s_m.fd = -1;
    s_m.on = false;
    longjmp(s_m.power, 1);
}

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
        if (s_m.harm == KILLS) { (void)syscall(SYS_write, fd, buf, part); }
        die();
        return -1;
    }
    if (s_m.on && s_m.harm == FLIPS && s_m.n == s_m.at) {
        memcpy(flipped, buf, n);
        flipped[n / 2u] ^= 4u;
        return syscall(SYS_write, fd, flipped, n);
    }
    return syscall(SYS_write, fd, buf, n);
}

int openat(int dir, const char *name, int flags, ...)
{
    va_list va;
    va_start(va, flags);
    unsigned mode = (flags & O_CREAT) != 0 ? va_arg(va, unsigned) : 0u;
    va_end(va);
    bool writing = (flags & O_CREAT) != 0;
    if (writing && suffers(false)) {
        die();
        return -1;
    }
    int fd = (int)syscall(SYS_openat, dir, name, flags, mode);
    if (writing) { s_m.fd = fd; }
    return fd;
}

int close(int fd)
{
    bool fails = s_m.close_fails && fd >= 0 && fd == s_m.fd;
    int done = (int)syscall(SYS_close, fd);
    if (fails) { errno = EIO; }
    return fails ? -1 : done;
}

int fsync(int fd)
{
    if (!suffers(false)) { return fcntl(fd, F_GETFD) < 0 ? -1 : 0; } /* nothing here outlives the test */
    die();
    return -1;
}

int renameat(int from_dir, const char *from, int to_dir, const char *to)
{
    s_m.fd = -1; /* closed */
    if (!suffers(false)) { return (int)syscall(SYS_renameat2, from_dir, from, to_dir, to, 0u); }
    die();
    return -1;
}

int unlinkat(int dir, const char *name, int flags)
{
    if (!suffers(true)) { return (int)syscall(SYS_unlinkat, dir, name, flags); }
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

void setUp(void);
void setUp(void)
{
    memset(&s_m, 0, sizeof s_m);
    s_m.fd = -1;
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

void tearDown(void);
void tearDown(void)
{
    char cmd[192];
    close_store();
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
        TEST_ASSERT_EQUAL_INT(which, reloaded());
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

void test_left_overs_of_a_write_that_was_cut_off_are_removed(void)
{
    (void)store_arm(1);
    write_file(s_dir, "k01.tmp", "half a tab", 10u);
    TEST_ASSERT_EQUAL_INT(1, reloaded());
    TEST_ASSERT_FALSE(exists(s_dir, "k01.tmp"));
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

static int s_heard, s_stderr;

static void listen(void)
{
    s_heard = (int)syscall(SYS_memfd_create, "stderr", 0u);
    s_stderr = dup(2);
    (void)dup2(s_heard, 2);
}

static void expect_said(const char *what)
{
    char text[2048] = {0};
    (void)dup2(s_stderr, 2);
    (void)close(s_stderr);
    TEST_ASSERT_TRUE(pread(s_heard, text, sizeof text - 1u, 0) >= 0);
    (void)close(s_heard);
    TEST_ASSERT_NOT_NULL_MESSAGE(strstr(text, what), what);
}

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
        listen();
        kc_status_t st = store_arm(3);
        expect_said(changes[i].said);
        TEST_ASSERT_TRUE(st != KC_OK);
        TEST_ASSERT_EQUAL_INT(2, reloaded());
    }
    s_m.at = 2; /* the second slot that is deleted */
    s_m.n = 0;
    s_m.harm = FAILS_ONCE;
    listen();
    kc_status_t st = kc_files_store(&s_f, &gone);
    expect_said("can't delete k01.b");
    TEST_ASSERT_EQUAL_INT(KC_ERR_NUM, st);
    s_m.at = 3; /* both are gone, but not for certain */
    s_m.n = 0;
    listen();
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
}

void test_a_table_that_is_refused_is_named_with_the_reason(void)
{
    given_arm_image(6);
    s_image[50] ^= 1u;
    write_file(s_tables, "a.tbl", s_image, s_n);
    listen();
    TEST_ASSERT_EQUAL_INT(0, reloaded());
    expect_said("kincal-fsw: table a.tbl refused: ");
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
    TEST_ASSERT_TRUE(kc_files_load(&s_f, s_tables, APP) >= 0);
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
}

void test_a_tables_directory_that_is_not_there_is_refused(void)
{
    listen();
    int n = kc_files_load(&s_f, "/nowhere", APP);
    expect_said("can't read the tables /nowhere");
    TEST_ASSERT_EQUAL_INT(-1, n);
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

static const uint16_t s_small[] = {KC_TBL_KIN, KC_STORE_PREV, KC_STORE_PROPOSAL, KC_STORE_JOURNAL};

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
    given_kin(&kin);
    kin.arm_crc = kc_app_active(APP)->crc[KC_TBL_ARM];
    kin.terms_crc = kc_app_active(APP)->crc[KC_TBL_TERMS];
    kin.value[3] = 0.01;
    s_n = given_image(KC_TBL_KIN, &kin, s_image);
    int32_t crc = (int32_t)kc_tbl_image_crc(s_image, s_n);
    for (uint32_t at = 0u; at < s_n; at += KC_CHUNK_BYTES) {
        kc_chunk_t *c = &world.in.chunk[world.in.n_chunk++];
        *c = (kc_chunk_t){.kind = KC_TBL_KIN, .total = s_n, .offset = at};
        c->n = s_n - at < KC_CHUNK_BYTES ? s_n - at : KC_CHUNK_BYTES;
        memcpy(c->data, &s_image[at], c->n);
    }
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
