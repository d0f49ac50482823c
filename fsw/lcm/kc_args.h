/* Command line of the flight process. */
#ifndef KC_ARGS_H
#define KC_ARGS_H

#include <stdbool.h>

#define KC_VERSION "0.1.0"
#define KC_URL_DEFAULT "udpm://239.255.76.67:7667?ttl=0"

typedef enum { KC_ARGS_RUN = 0, KC_ARGS_DONE = 1, KC_ARGS_BAD = 2 } kc_args_result_t;

typedef struct {
    const char *url, *tables, *store, *keys; /* keys NULL: none */
    bool live;                               /* false: lockstep, time comes with KC_TIME */
} kc_args_t;

/* Environment variable that names the key file, if no option does. */
#define KC_KEYS_VARIABLE "KINCAL_KEYS"

/* RUN: continue. DONE: --help or --version was answered on stdout. BAD: the problem was printed on stderr. */
kc_args_result_t kc_args_parse(int argc, char **argv, kc_args_t *args);

#endif
