/* kc_args.c: the command line. */
#define _POSIX_C_SOURCE 200809L /* NOLINT: setenv */

#include <stdio.h>
#include <stdlib.h>

#include "kc_args.h"
#include "unity.h"

static kc_args_t s_a;

#define PARSE(...) parse((char *[]){"kincal-fsw", __VA_ARGS__, NULL})

static kc_args_result_t parse(char **argv)
{
    int n = 0;
    while (argv[n] != NULL) { n++; }
    return kc_args_parse(n, argv, &s_a);
}

void test_directories_are_all_it_needs(void)
{
    TEST_ASSERT_EQUAL_INT(KC_ARGS_RUN, PARSE("--tables", "t", "--store", "s"));
    TEST_ASSERT_EQUAL_STRING("t", s_a.tables);
    TEST_ASSERT_EQUAL_STRING("s", s_a.store);
    TEST_ASSERT_EQUAL_STRING(KC_URL_DEFAULT, s_a.url);
    TEST_ASSERT_EQUAL_INT(0, s_a.live);
}

void test_keys_come_by_option_or_environment(void)
{
    (void)unsetenv(KC_KEYS_VARIABLE);
    TEST_ASSERT_EQUAL_INT(KC_ARGS_RUN, PARSE("--tables", "t", "--store", "s"));
    TEST_ASSERT_NULL(s_a.keys);
    (void)setenv(KC_KEYS_VARIABLE, "", 1);
    TEST_ASSERT_EQUAL_INT(KC_ARGS_RUN, PARSE("--tables", "t", "--store", "s"));
    TEST_ASSERT_NULL(s_a.keys);
    (void)setenv(KC_KEYS_VARIABLE, "e", 1);
    TEST_ASSERT_EQUAL_INT(KC_ARGS_RUN, PARSE("--tables", "t", "--store", "s"));
    TEST_ASSERT_EQUAL_STRING("e", s_a.keys);
    TEST_ASSERT_EQUAL_INT(KC_ARGS_RUN, PARSE("--tables", "t", "--store", "s", "--keys", "k"));
    TEST_ASSERT_EQUAL_STRING("k", s_a.keys);
}

void test_everything_can_be_said(void)
{
    TEST_ASSERT_EQUAL_INT(KC_ARGS_RUN, PARSE("--live", "--url", "memq://", "--store", "s", "--tables", "t"));
    TEST_ASSERT_EQUAL_STRING("memq://", s_a.url);
    TEST_ASSERT_EQUAL_INT(1, s_a.live);
    TEST_ASSERT_EQUAL_INT(KC_ARGS_RUN, PARSE("--lockstep", "--store", "s", "--tables", "t"));
    TEST_ASSERT_EQUAL_INT(0, s_a.live);
}

void test_what_is_missing_wrong_or_contradicts_itself_is_refused(void)
{
    TEST_ASSERT_EQUAL_INT(KC_ARGS_BAD, PARSE("--store", "s"));
    TEST_ASSERT_EQUAL_INT(KC_ARGS_BAD, PARSE("--tables", "t"));
    TEST_ASSERT_EQUAL_INT(KC_ARGS_BAD, PARSE("--tables"));
    TEST_ASSERT_EQUAL_INT(KC_ARGS_BAD, PARSE("--tabels", "t"));
    TEST_ASSERT_EQUAL_INT(KC_ARGS_BAD, PARSE("--live", "--lockstep", "--tables", "t", "--store", "s"));
}

void test_help_and_version_are_answered(void)
{
    TEST_ASSERT_EQUAL_INT(KC_ARGS_DONE, PARSE("--help"));
    TEST_ASSERT_EQUAL_INT(KC_ARGS_DONE, PARSE("--version"));
    (void)fflush(stdout);
}
