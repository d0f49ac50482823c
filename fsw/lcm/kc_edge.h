/* The LCM process around the component: subscriptions, one step, publishing, the two ways of keeping time.
 * After kc_edge_open none of our code uses the heap (LCM itself does, inside). */
#ifndef KC_EDGE_H
#define KC_EDGE_H

#include <lcm/lcm.h>
#include <signal.h>
#include <stdbool.h>

#include "kc_files.h"
#include "kc_queue.h"

#define KC_EDGE_TICK_US 100000
/* MACs computed in a step to see whose room a message takes: 0.8 million instructions, 1.4 for chunks. A message beyond
 * them is one that nobody vouches for. */
#define KC_EDGE_MACS_CMD 64u
#define KC_EDGE_MACS_CHUNK 24u

typedef struct {
    lcm_t *lcm;
    const char *url;
    kc_files_t *files;
    kc_app_t *app;
    kc_queue_t queue;
    kc_in_t in; /* sensor messages of the next step collect here */
    kc_out_t out;
    bool live;
    int64_t now_us; /* of the last step */
    int64_t tick; /* last tick done, 0 = none yet */
    int64_t due_tick, due_us; /* KC_TIME received, to be done when due_tick != tick */
    int32_t n_done; /* published in the last tick, before its DONE */
    int32_t n_sent, n_tx_errors, event_seq;
    uint32_t n_rx_errors;
    uint32_t macs_cmd, macs_chunk; /* that may still be computed before the next step */
    bool repeat; /* the last tick was announced again */
} kc_edge_t;

/* Subscribe. false with the reason on stderr. */
bool kc_edge_open(kc_edge_t *edge, const char *url, kc_files_t *files, kc_app_t *app, bool live);
/* Run until *stop is set; false if the network fails before, with the reason on stderr. */
bool kc_edge_run(kc_edge_t *edge, const volatile sig_atomic_t *stop);
/* One step of the component at now_us, its store requests written, its messages published. */
void kc_edge_step(kc_edge_t *edge, int64_t now_us);
/* Parts of a step: the component's store requests, up to the first failure; its telemetry. */
void kc_edge_store(kc_edge_t *edge);
void kc_edge_publish(kc_edge_t *e);
/* Handle the KC_TIME received, if any: a new tick is stepped and answered, a repeated one answered. */
void kc_edge_tick(kc_edge_t *edge);
void kc_edge_close(kc_edge_t *edge);

#endif
