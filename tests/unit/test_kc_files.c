/* kc_files.c: the store through torn writes, damage and kills; the directory of tables. */
#define _DEFAULT_SOURCE /* NOLINT: mkdtemp */

#include <fcntl.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/stat.h>
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

static int exists(const char *dir, const char *name)
{
    struct stat st;
    return stat(path(dir, name), &st) == 0;
}

static void open_store(void) { TEST_ASSERT_EQUAL_INT(0, kc_files_open(&s_f, s_dir)); }

static void close_store(void)
{
    if (s_f.dir_fd >= 0) { (void)close(s_f.dir_fd); }
    s_f.dir_fd = -1;
}

void setUp(void);
void setUp(void)
{
    given_world();
    memcpy(s_root, "/tmp/kc_files_XXXXXX", 21u);
    TEST_ASSERT_NOT_NULL(mkdtemp(s_root));
    (void)snprintf(s_dir, sizeof s_dir, "%s/store", s_root);
    (void)snprintf(s_tables, sizeof s_tables, "%s/tables", s_root);
    TEST_ASSERT_EQUAL_INT(0, mkdir(s_tables, 0777));
    open_store();
    kc_app_init(APP);
}

void tearDown(void);
void tearDown(void)
{
    char cmd[192];
    close_store();
    (void)snprintf(cmd, sizeof cmd, "chmod -R u+rwx %s; rm -rf %s", s_root, s_root);
    TEST_ASSERT_EQUAL_INT(0, system(cmd)); // NOLINT(cert-env33-c): the folder is our own
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
    TEST_ASSERT_EQUAL_INT(-1, kc_files_open(&other, s_dir));
    close_store();
    TEST_ASSERT_EQUAL_INT(0, kc_files_open(&other, s_dir));
    (void)close(other.dir_fd);
}

void test_a_store_that_cannot_be_made_or_opened_is_refused(void)
{
    static kc_files_t other;
    static char longer[KC_FILES_PATH_MAX + 2];
    memset(longer, 'x', sizeof longer - 1u);
    TEST_ASSERT_EQUAL_INT(-1, kc_files_open(&other, longer));
    TEST_ASSERT_EQUAL_INT(-1, kc_files_open(&other, "/dev/null/store"));
    write_file(s_root, "file", "x", 1u);
    TEST_ASSERT_EQUAL_INT(-1, kc_files_open(&other, path(s_root, "file")));
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

/* ---- default tables ---- */

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
    s_image[50] ^= 1u;
    write_file(s_tables, "a.tbl", s_image, s_n); /* damaged */
    write_file(s_tables, "arm.txt", s_image, s_n);
    write_file(s_tables, ".tbl", s_image, s_n);
    write_file(s_tables, "empty.tbl", s_image, 0u);
    write_file(s_tables, "short.tbl", s_image, 9u);
    memcpy(huge, s_image, KC_TBL_HDR_BYTES);
    write_file(s_tables, "huge.tbl", huge, sizeof huge);
    memset(name, 'n', sizeof name);
    memcpy(&name[70], ".tbl", 5u); /* a name too long for us */
    write_file(s_tables, name, s_image, s_n);
    TEST_ASSERT_EQUAL_INT(5, reloaded());
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
    TEST_ASSERT_EQUAL_INT(-1, kc_files_load(&s_f, "/nowhere", APP));
}
