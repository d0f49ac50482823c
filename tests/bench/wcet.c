/* Steps of the flight core with everything at its limits: tables of the largest sizes, 62 poses of which 13 are
 * outliers, then two more that are measured, the last update, the proposal and its approval. In one case the fits
 * converge and outliers are rejected; one pose more is measured there, as each takes seventy steps. What follows the
 * last pose depends on the acquisition no more: two cases show it, the others end there. tests/bench/wcet.py runs it
 * under valgrind, which counts the instructions of each kc_app_step.
 *
 * wcet CASE...: a line for each step in the order of the steps: case, state before, state after. */
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "given_largest.h"
#include "given_tables.h"
#include "given_world.h"

#define APP (&kc_app_instance)
#define STEPS_MAX 20000u

static const char *s_case;

static void tick(void)
{
    int before = (int)kc_app_state(APP);
    world_tick();
    (void)printf("%s %d %d\n", s_case, before, (int)kc_app_state(APP));
    for (uint32_t i = 0u; i < world.out.events.n && getenv("WCET_EVENTS") != NULL; i++) {
        const kc_event_t *e = &world.out.events.e[i];
        (void)fprintf(stderr, "  %s %d %g %g\n", kc_event_name(e->id), (int)e->index, e->got, e->want);
    }
}

static void ticks(uint32_t n)
{
    for (uint32_t i = 0u; i < n; i++) { tick(); }
}

/* ---- cases ---- */

/* Each outlier farther off than the one before, so that none hides another. */
static void spread_outliers(void)
{
    for (uint32_t i = 0u; i < APP->est.n_obs; i += 5u) {
        APP->est.obs[i].p_m[i % 3u] += 2e-4 * (double)(i * i);
    }
}

/* Whether the last pose is. */
static bool measured(void)
{
    return APP->plan.n_meas == KC_MEAS_MAX && kc_app_state(APP) == KC_ST_UPDATE;
}

static void calibrate(uint8_t acq)
{
    static const char *name[] = {"ucb", "random", "dopt", "vopt", "rate"};
    s_case = name[acq];
    given_largest(acq);
    world.config.rate_measure = (uint8_t)KC_ACQ_VOPT; /* of rate: what takes longer */
    bool converges = acq == KC_ACQ_VOPT;
    if (converges) { /* so that outliers are looked for */
        world.config.est.iter_max = 20u;
        world.config.est.outlier_max = 2u;
        world.config.est.tol_step = 0.1;
        for (uint32_t k = 0u; k < world.terms.n_term; k++) {
            if (world.terms.term[k].basis[0].var != KC_VAR_ONE) { world.terms.term[k].gain = 1e-2; }
        }
    }
    world_boot();
    tick();
    (void)world_cmd(KC_CMD_START, acq, (int32_t)KC_MEAS_MAX, 3);
    tick();
    given_poses(KC_MEAS_MAX - (converges ? 1u : 2u));
    if (converges) { spread_outliers(); }
    bool whole = converges || acq == KC_ACQ_RATE;
    for (uint32_t i = 0u; i < STEPS_MAX && world_calibrating() && (whole || !measured()); i++) { tick(); }
    if (whole) {
        int32_t crc = (int32_t)world.proposal.crc;
        (void)world_cmd(KC_CMD_APPROVE_ARM, crc, 0, 0);
        tick();
        (void)world_cmd(KC_CMD_APPROVE_GO, crc, 0, 0);
        ticks(2u);
    } else if (!measured()) {
        (void)fprintf(stderr, "%s: the last pose was not measured\n", s_case);
        exit(1);
    }
    (void)fprintf(stderr, "%s: state %d, %u poses, %u outliers, rank %u of %u, GP set %u\n", s_case,
                  (int)kc_app_state(APP), (unsigned)APP->plan.n_meas, (unsigned)APP->est.n_outliers,
                  (unsigned)APP->est.rank, (unsigned)APP->est.n_free,
                  (unsigned)APP->arena.calibration.gp.hyper);
    if (converges && APP->est.n_outliers == 0u) {
        (void)fprintf(stderr, "%s: no outlier was found, so their test is not in the count\n", s_case);
        exit(1);
    }
}

/* A calibration with tables as they fly: the small world of the unit tests. Its acquisition is the one whose moves
 * take the most. */
static void replay(void)
{
    s_case = "replay";
    given_world();
    world.truth.joint[6].phi_rad = 0.2;
    world.config.acquisition = (uint8_t)KC_ACQ_VOPT;
    world.config.n_poses = 8u;
    world.kernel.choose = 1u;
    world_boot();
    tick();
    (void)world_cmd(KC_CMD_START, -1, 0, 3);
    tick();
    for (uint32_t i = 0u; i < 4000u && world_calibrating(); i++) { tick(); }
}

static void send_table(uint16_t kind, const void *table)
{
    uint32_t n = given_image(kind, table, world.image), crc = kc_tbl_image_crc(world.image, n);
    for (uint32_t at = 0u; at < n;) {
        for (uint32_t i = 0u; i < KC_CHUNK_QUEUE_MAX && at < n; i++) {
            kc_table_chunk_t *c = &world.in.chunk[world.in.n_chunk++];
            *c = (kc_table_chunk_t){.kind = kind, .total = n, .offset = at};
            c->n = n - at < KC_CHUNK_BYTES ? n - at : KC_CHUNK_BYTES;
            memcpy(c->data, &world.image[at], c->n);
            at += c->n;
        }
        tick();
    }
    for (uint32_t i = 0u; i < KC_CMD_QUEUE_MAX; i++) {
        (void)world_cmd(KC_CMD_TABLE_VALIDATE, kind, (int32_t)crc, 0);
    }
    tick();
    (void)world_cmd(KC_CMD_TABLE_ACTIVATE, kind, (int32_t)crc, 0);
    tick();
    (void)world_cmd(KC_CMD_TABLE_DUMP, kind, 0, 0);
    ticks(3u);
    (void)fprintf(stderr, "table %u: %u bytes, active crc %08x of %08x\n", (unsigned)kind, (unsigned)n,
                  (unsigned)APP->tables.active.crc[kind], (unsigned)crc);
}

/* Idle: tables, and as many detections as a step takes for the monitor. */
static void idle(void)
{
    s_case = "tables";
    given_largest(KC_ACQ_RANDOM);
    world_boot();
    tick();
    send_table(KC_TBL_CONFIG, &world.config);
    send_table(KC_TBL_KERNEL, &world.kernel);
    send_table(KC_TBL_TERMS, &world.terms);
    send_table(KC_TBL_SPACE, &world.space);
    s_case = "monitor";
    world.truth = world.arm;
    world.bias[2] = 0.05; /* a joint that is named, so that the others are compared with it */
    world.frames_at_once = KC_DET_QUEUE_MAX;
    for (uint32_t i = 0u; i < 4u; i++) {
        for (uint32_t j = 0u; j < KC_JOINT_MAX; j++) {
            world.q_cmd[j] = world.q[j] = 0.3 + 0.17 * (double)((3u * i + 5u * j) % 7u);
        }
        ticks(20u);
        world.requested = true;
        tick();
    }
    (void)fprintf(stderr, "monitor: %u observations, state %d, suspects %x\n",
                  (unsigned)APP->arena.idle.monitor.n, (int)APP->monitoring.newest.state,
                  (unsigned)APP->monitoring.newest.suspects);
}

int main(int argc, char **argv)
{
    for (int i = 1; i < argc; i++) {
        const char *what = argv[i];
        if (strcmp(what, "idle") == 0) { idle(); }
        if (strcmp(what, "replay") == 0) { replay(); }
        if (strcmp(what, "ucb") == 0) { calibrate(KC_ACQ_UCB); }
        if (strcmp(what, "random") == 0) { calibrate(KC_ACQ_RANDOM); }
        if (strcmp(what, "dopt") == 0) { calibrate(KC_ACQ_DOPT); }
        if (strcmp(what, "vopt") == 0) { calibrate(KC_ACQ_VOPT); }
        if (strcmp(what, "rate") == 0) { calibrate(KC_ACQ_RATE); }
    }
    return 0;
}
