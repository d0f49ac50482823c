/* kc_args.c: the command line. */
#define _POSIX_C_SOURCE 200809L /* NOLINT: setenv */

#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "given_process.h"
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

/* What is wrong, with the argument, and where help is. */
static void refused(const char *what, char **argv)
{
    char want[120];
    hear(2);
    kc_args_result_t result = parse(argv);
    const char *text = heard();
    (void)snprintf(want, sizeof want, "kincal-fsw: %s\nTry kincal-fsw --help.\n", what);
    TEST_ASSERT_EQUAL_INT(KC_ARGS_BAD, result);
    TEST_ASSERT_EQUAL_STRING(want, text);
}

#define REFUSED(what, ...) refused(what, (char *[]){"kincal-fsw", __VA_ARGS__, NULL})

void test_what_is_missing_wrong_or_contradicts_itself_is_refused(void)
{
    REFUSED("--tables is missing", "--store", "s");
    REFUSED("--store is missing", "--tables", "t");
    REFUSED("no value after --tables", "--tables");
    REFUSED("no value after --url", "--tables", "t", "--store", "s", "--url");
    REFUSED("no value after --keys", "--keys");
    REFUSED("unknown argument --tabels", "--tabels", "t");
    REFUSED("unknown argument x", "--tables", "t", "x");
    REFUSED("--lockstep and --live exclude each other", "--live", "--lockstep", "--tables", "t", "--store",
            "s");
    REFUSED("--lockstep and --live exclude each other", "--lockstep", "--live", "--tables", "t", "--store",
            "s");
}

static const char *answer(char *option)
{
    char *argv[] = {"kincal-fsw", option, NULL};
    hear(1);
    kc_args_result_t result = parse(argv);
    const char *text = heard();
    TEST_ASSERT_EQUAL_INT(KC_ARGS_DONE, result);
    return text;
}

void test_help_and_version_are_answered(void)
{
    static const char *const options[] = {"--url",        "--tables",      "--store", "--keys",
                                          "--lockstep",   "--live",        "--help",  "--version",
                                          KC_URL_DEFAULT, KC_KEYS_VARIABLE};
    const char *text = answer("--help");
    TEST_ASSERT_EQUAL_STRING_LEN("usage: kincal-fsw ", text, 18);
    for (uint32_t i = 0u; i < sizeof options / sizeof options[0]; i++) {
        TEST_ASSERT_NOT_NULL_MESSAGE(strstr(text, options[i]), options[i]);
    }
    TEST_ASSERT_EQUAL_STRING("kincal-fsw " KC_VERSION "\n", answer("--version"));
}
