/* The flight process. */
#define _POSIX_C_SOURCE 200809L /* NOLINT: sigaction, clock_gettime, openat */

#include <signal.h>
#include <stdio.h>
#include <string.h>

#include "kc_args.h"
#include "kc_edge.h"
#include "kc_keys.h"

static volatile sig_atomic_t s_stop;
static kc_files_t s_files;
static kc_edge_t s_edge;

static void on_signal(int sig)
{
    (void)sig;
    s_stop = 1;
}

static void catch_signals(void)
{
    struct sigaction a;
    memset(&a, 0, sizeof a);
    a.sa_handler = on_signal;
    (void)sigaction(SIGINT, &a, NULL);
    (void)sigaction(SIGTERM, &a, NULL);
}

/* Everything that is kept, and the default tables, into the component. */
static bool load(const kc_args_t *args)
{
    kc_keys_t keys = {0};
    if (args->keys != NULL && !kc_keys_read(args->keys, &keys)) { return false; }
    if (!kc_files_open(&s_files, args->store)) { return false; }
    kc_app_init(&kc_app_instance);
    kc_app_keys(&kc_app_instance, &keys);
    if (keys.n == 0u) { (void)fprintf(stderr, "kincal-fsw: no --keys; nothing can be changed or started\n"); }
    int n = kc_files_load(&s_files, args->tables, &kc_app_instance);
    if (n < 0) { return false; }
    if (n == 0) { (void)fprintf(stderr, "kincal-fsw: no *.tbl in %s; waiting for uplink\n", args->tables); }
    kc_app_boot(&kc_app_instance);
    return true;
}

int main(int argc, char **argv)
{
    kc_args_t args;
    switch (kc_args_parse(argc, argv, &args)) {
    case KC_ARGS_DONE: return 0;
    case KC_ARGS_BAD: return 2;
    default: break;
    }
    catch_signals();
    if (!load(&args)) { return 2; }
    if (!kc_edge_open(&s_edge, args.url, &s_files, &kc_app_instance, args.live)) { return 1; }
    bool good = kc_edge_run(&s_edge, &s_stop);
    kc_edge_close(&s_edge);
    return good ? 0 : 1;
}
