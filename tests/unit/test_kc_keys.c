/* kc_keys.c: the key file. */
#define _GNU_SOURCE /* NOLINT: mkdtemp, RTLD_NEXT */

#include "kc_keys.h"

#include <dlfcn.h>
#include <errno.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/stat.h>
#include <unistd.h>

#include "given_process.h"
#include "unity.h"

#define A "000102030405060708090a0b0c0d0e0f101112131415161718191a1b1c1d1e1f"
#define B "ff0102030405060708090a0b0c0d0e0f101112131415161718191a1b1c1d1eff"

static char s_dir[64], s_path[80];
static kc_keys_t s_keys;

/* ---- a file that cannot be read; these take the place of the C library's for kc_keys.c ---- */

static int s_read_errno, s_fstat_errno; /* of the next call */

ssize_t read(int fd, void *data, size_t n)
{
    errno = s_read_errno;
    s_read_errno = 0;
    return errno != 0 ? -1 : ((ssize_t(*)(int, void *, size_t))dlsym(RTLD_NEXT, "read"))(fd, data, n);
}

int fstat(int fd, struct stat *st)
{
    errno = s_fstat_errno;
    s_fstat_errno = 0;
    return errno != 0 ? -1 : ((int (*)(int, struct stat *))dlsym(RTLD_NEXT, "fstat"))(fd, st);
}

void setUp(void)
{
    memcpy(s_dir, "/tmp/kc_keys_XXXXXX", 20u);
    TEST_ASSERT_NOT_NULL(mkdtemp(s_dir));
    (void)snprintf(s_path, sizeof s_path, "%s/keys", s_dir);
}

void tearDown(void)
{
    (void)remove(s_path);
    (void)rmdir(s_dir);
}

static void given_file(const void *text, size_t n, mode_t mode)
{
    FILE *f = fopen(s_path, "wb");
    TEST_ASSERT_NOT_NULL(f);
    (void)fwrite(text, 1u, n, f);
    (void)fclose(f);
    TEST_ASSERT_EQUAL_INT(0, chmod(s_path, mode));
}

/* Refused by name and for a reason, and no key is left of it, nor an open file. */
static void refused(const char *why)
{
    static const kc_keys_t none;
    char said[256];
    const uint32_t n = open_files();
    memset(&s_keys, 0xff, sizeof s_keys);
    hear(2);
    bool taken = kc_keys_read(s_path, &s_keys);
    const char *text = heard();
    (void)snprintf(said, sizeof said, "kincal-fsw: keys %s: ", s_path);
    TEST_ASSERT_FALSE(taken);
    TEST_ASSERT_EQUAL_STRING_LEN(said, text, strlen(said));
    TEST_ASSERT_NOT_NULL_MESSAGE(strstr(text, why), text);
    TEST_ASSERT_EQUAL_MEMORY(&none, &s_keys, sizeof none);
    TEST_ASSERT_EQUAL_UINT32(n, open_files());
}

static void refused_text(const char *text, const char *why)
{
    given_file(text, strlen(text), 0600);
    refused(why);
}

#define NO_HEAD "its first line is not"
#define NO_NUMBER "does not begin with the number of a key"
#define NO_SECRET "has not 64 hexadecimal digits"

void test_one_or_two_keys_are_read(void)
{
    const char *one = "kincal-keys 1\n7 " A "\n", *two = "kincal-keys 1\n7 " A "\n2147483647 " B "\n";
    given_file(one, strlen(one), 0600);
    const uint32_t n = open_files();
    TEST_ASSERT_TRUE(kc_keys_read(s_path, &s_keys));
    TEST_ASSERT_EQUAL_UINT32(n, open_files());
    TEST_ASSERT_EQUAL_UINT32(1u, s_keys.n);
    TEST_ASSERT_EQUAL_UINT32(7u, s_keys.key[0].id);
    for (uint32_t i = 0u; i < KC_KEY_BYTES; i++) { TEST_ASSERT_EQUAL_UINT8(i, s_keys.key[0].secret[i]); }
    given_file(two, strlen(two), 0400);
    TEST_ASSERT_TRUE(kc_keys_read(s_path, &s_keys));
    TEST_ASSERT_EQUAL_UINT32(2u, s_keys.n);
    TEST_ASSERT_EQUAL_UINT32(0x7fffffffu, s_keys.key[1].id);
    TEST_ASSERT_EQUAL_UINT8(0xffu, s_keys.key[1].secret[31]);
}

void test_a_file_that_others_may_read_or_change_is_refused(void)
{
    const char *text = "kincal-keys 1\n7 " A "\n";
    static const mode_t modes[] = {0640, 0620, 0610, 0604, 0602, 0601, 0666};
    for (uint32_t i = 0u; i < sizeof modes / sizeof modes[0]; i++) {
        given_file(text, strlen(text), modes[i]);
        refused("others may read or change it");
    }
}

void test_a_file_of_another_user_is_refused(void)
{
    const char *text = "kincal-keys 1\n7 " A "\n";
    given_file(text, strlen(text), 0600);
    if (chown(s_path, 12345, 12345) != 0) { TEST_IGNORE_MESSAGE("only root can give files away"); }
    refused("belongs to another user");
}

void test_what_is_no_file_is_refused(void)
{
    refused("No such file"); /* there is none */
    TEST_ASSERT_FALSE(kc_keys_read(s_dir, &s_keys));
    TEST_ASSERT_EQUAL_INT(0, mkfifo(s_path, 0600));
    refused("not a file"); /* and does not wait for a writer */
}

void test_a_text_with_anything_wrong_is_refused(void)
{
    static char longer[2000] = "kincal-keys 1\n";
    refused_text("", NO_HEAD);
    refused_text("kincal-keys 1", NO_HEAD);
    refused_text("kincal-keys 1\n", "no key in it");
    refused_text("kincal-keys 2\n7 " A "\n", NO_HEAD);
    refused_text("7 " A "\n", NO_HEAD);
    refused_text("kincal-keys 1\n7 " A, NO_SECRET);       /* cut off */
    refused_text("kincal-keys 1\n7 " A "0\n", NO_SECRET); /* too long */
    refused_text("kincal-keys 1\n7 0102\n", NO_SECRET);
    refused_text("kincal-keys 1\n0 " A "\n", NO_NUMBER);
    refused_text("kincal-keys 1\n-7 " A "\n", NO_NUMBER);
    refused_text("kincal-keys 1\n2147483648 " A "\n", NO_NUMBER);
    refused_text("kincal-keys 1\n99999999999999999999999 " A "\n", NO_NUMBER);
    refused_text("kincal-keys 1\n " A "\n", NO_NUMBER);
    refused_text("kincal-keys 1\n7\t" A "\n", NO_NUMBER);
    refused_text("kincal-keys 1\n7 " A "\n7 " B "\n",
                 "two keys have the same number"); /* twice the same number */
    refused_text("kincal-keys 1\n7 " A "\n8 " B "\n107 " A "\n108 " B "\n9 " A "\n", "more than four keys");
    refused_text("kincal-keys 1\n7 " A "\n\n", NO_NUMBER);
    refused_text("kincal-keys 1\n7 0000000000000000000000000000000000000000000000000000000000000000\n",
                 NO_SECRET);
    refused_text("kincal-keys 1\n7 0g0102030405060708090a0b0c0d0e0f101112131415161718191a1b1c1d1e1\n",
                 NO_SECRET);
    given_file("kincal-keys 1\n7 " A "\n\0\n", 83u, 0600); /* a zero in the text */
    refused("not a key file");
    memset(&longer[14], '\n', sizeof longer - 15u);
    refused_text(longer, "not a key file");
}

void test_a_file_that_cannot_be_read_is_refused_and_a_signal_is_no_failure(void)
{
    static const char text[] = "kincal-keys 1\n7 " A "\n";
    given_file(text, sizeof text - 1u, 0600);
    s_fstat_errno = EIO;
    refused(strerror(EIO));
    s_read_errno = EIO;
    refused(strerror(EIO));
    s_read_errno = EINTR;
    TEST_ASSERT_TRUE(kc_keys_read(s_path, &s_keys));
    TEST_ASSERT_EQUAL_UINT32(7u, s_keys.key[0].id);
}

void test_a_number_has_every_digit(void)
{
    given_file("kincal-keys 1\n1234567890 " A "\n", strlen("kincal-keys 1\n1234567890 " A "\n"), 0600);
    TEST_ASSERT_TRUE(kc_keys_read(s_path, &s_keys));
    TEST_ASSERT_EQUAL_UINT32(1234567890u, s_keys.key[0].id);
}

void test_a_number_ends_at_what_is_no_digit(void)
{
    refused_text("kincal-keys 1\n7: " A "\n", NO_NUMBER);
    refused_text("kincal-keys 1\n7/ " A "\n", NO_NUMBER);
}

void test_a_digit_is_a_number_or_a_small_letter(void)
{
    static const char others[] = "/:`gAF@\x7f ";
    for (uint32_t i = 0u; i + 1u < sizeof others; i++) {
        for (uint32_t at = 0u; at < 2u; at++) {
            char text[] = "kincal-keys 1\n7 " A "\n";
            text[16u + at] = others[i];
            refused_text(text, NO_SECRET);
            text[16u + at] = '0';
            text[16u + 62u + at] = others[i]; /* the last byte */
            refused_text(text, NO_SECRET);
        }
    }
}
