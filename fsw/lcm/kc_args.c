#include "kc_args.h"

#include <stdio.h>
#include <stdlib.h>
#include <string.h>

static const char s_usage[] =
    "usage: kincal-fsw --tables DIR --store DIR [--keys FILE] [--url URL] [--lockstep | --live]\n"
    "\n"
    "KinCal flight process: recalibrates the arm on command, over LCM.\n"
    "\n"
    "  --url URL      LCM network (default " KC_URL_DEFAULT ")\n"
    "  --tables DIR   default tables, *.tbl\n"
    "  --store DIR    what is kept through power loss; created if it does not exist\n"
    "  --keys FILE    whose signed commands are taken (default: $" KC_KEYS_VARIABLE
    "); without it nothing can be\n"
    "                 changed, and no calibration started. `kincal key new` makes one\n"
    "  --lockstep     time comes with KC_TIME from the simulator (default)\n"
    "  --live         real clock, 10 steps a second\n"
    "  --help         this text\n"
    "  --version      version\n"
    "\n"
    "Exit status: 0 stopped on request, 1 the network failed, 2 bad arguments, directories or keys.\n";

static kc_args_result_t bad(const char *what, const char *arg)
{
    (void)fprintf(stderr, "kincal-fsw: %s%s\nTry kincal-fsw --help.\n", what, arg);
    return KC_ARGS_BAD;
}

/* Where the value of this option goes; NULL if it takes none or is not known. */
static const char **value_of(kc_args_t *args, const char *option)
{
    if (strcmp(option, "--url") == 0) { return &args->url; }
    if (strcmp(option, "--tables") == 0) { return &args->tables; }
    if (strcmp(option, "--store") == 0) { return &args->store; }
    if (strcmp(option, "--keys") == 0) { return &args->keys; }
    return NULL;
}

/* An empty variable is none. */
static const char *keys_of_environment(void)
{
    const char *keys = getenv(KC_KEYS_VARIABLE); // NOLINT(concurrency-mt-unsafe): there is one thread yet
    return keys != NULL && keys[0] != '\0' ? keys : NULL;
}

static kc_args_result_t complete(const kc_args_t *args)
{
    if (args->tables == NULL) { return bad("--tables is missing", ""); }
    if (args->store == NULL) { return bad("--store is missing", ""); }
    return KC_ARGS_RUN;
}

kc_args_result_t kc_args_parse(int argc, char **argv, kc_args_t *args)
{
    bool lockstep = false;
    *args = (kc_args_t){KC_URL_DEFAULT, NULL, NULL, keys_of_environment(), false};
    for (int i = 1; i < argc; i++) {
        const char **value = value_of(args, argv[i]);
        if (value != NULL) {
            if (i + 1 >= argc) { return bad("no value after ", argv[i]); }
            *value = argv[++i];
        } else if (strcmp(argv[i], "--live") == 0) {
            args->live = true;
        } else if (strcmp(argv[i], "--lockstep") == 0) {
            lockstep = true;
        } else if (strcmp(argv[i], "--help") == 0) {
            (void)fputs(s_usage, stdout);
            return KC_ARGS_DONE;
        } else if (strcmp(argv[i], "--version") == 0) {
            (void)puts("kincal-fsw " KC_VERSION);
            return KC_ARGS_DONE;
        } else {
            return bad("unknown argument ", argv[i]);
        }
    }
    if (lockstep && args->live) { return bad("--lockstep and --live exclude each other", ""); }
    return complete(args);
}
