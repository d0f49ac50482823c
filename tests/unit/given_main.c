/* Runs all tests of a program, or the one that is named. */
#include "given_main.h"

#include <stdlib.h>
#include <string.h>

#include "unity.h"

static int s_ended;

/* A test that leaves the program early would pass unseen. */
static void check_end(void)
{
    if (!s_ended) { _Exit(70); }
}

int main(int argc, char **argv)
{
    if (atexit(check_end) != 0) { return 71; }
    UnityBegin(given_source);
    for (const given_test_t *test = given_tests; test->name != NULL; test++) {
        if (argc < 2 || strcmp(argv[1], test->name) == 0) { UnityDefaultTestRun(test->run, test->name, 0); }
    }
    s_ended = 1;
    int failed = UnityEnd();
    return Unity.NumberOfTests == 0u ? 72 : failed;
}
