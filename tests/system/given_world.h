/* A small world for the component: arm, pan-tilt unit, camera and a store, advanced by one tick at a time
 * through kc_app_step alone. The arm is the tables' arm with other DH parameters; what it measures is
 * noise-free unless requested. Settings make things fail. */
#ifndef GIVEN_WORLD_H
#define GIVEN_WORLD_H

#include <stdbool.h>

#include "kc_app_parts.h"
#include "kc_input_fields.h"

#define TICK_US 100000u
#define WORLD_KINDS 20u

/* Counts are kept by id: a new event that does not fit must not compile. */
#define EVENT_ID_MAX 255u
#define EVENT_FITS_(id, name, sev, text, action) _Static_assert((id) <= EVENT_ID_MAX, #name);
KC_EVENT_LIST(EVENT_FITS_)

typedef struct {
    kc_in_t in;
    kc_out_t out;
    uint64_t now_us;
    kc_arm_t truth;
    kc_camera_t camera;
    double q[KC_JOINT_MAX], q_cmd[KC_JOINT_MAX], bias[KC_JOINT_MAX]; /* reading = q, true joint = q + bias */
    double dir[KC_JOINT_MAX]; /* side from which each joint came last */
    double pan, tilt, pan_cmd, tilt_cmd;
    double tilt_bias_rad; /* true tilt minus reading */
    int32_t arm_seq, pantilt_seq, cmd_seq[3], frame_requested;
    bool requested;
    uint64_t rng;
    kc_keys_t keys; /* of flight, set at boot */
    uint32_t signer; /* which of them signs */
    uint64_t counter; /* of the last message that was signed */
    kc_cmd_t sent[KC_CMD_QUEUE_MAX]; /* the last signed commands, by counter modulo their number */
    kc_cmd_t answered; /* the last of them that was accepted; key 0: none was */
    /* settings */
    bool arm_silent, pantilt_silent, camera_silent; /* no messages */
    bool arm_slow; /* 2 mrad a tick */
    bool arm_frozen, pantilt_frozen; /* commands are echoed but nothing moves */
    uint32_t frames_at_once; /* detections that arrive together, each 1 us older than the next (0: one) */
    int arm_ignores, pantilt_ignores; /* number of commands lost */
    int arm_vibrates, pantilt_vibrates; /* ticks during which state says moving */
    int hide; /* number of frames without tags */
    double view_rad; /* tags are visible up to this angle off the axis, 0: always */
    double noise_m, noise_rad; /* of a detection */
    double jump_m; /* next detection is off by this */
    double hide_beyond; /* joint travel since START that hides the tags, 0 = off */
    double q_start[KC_JOINT_MAX];
    bool
        as_sent; /* commands and chunks go out as the test made them; otherwise those that have to be are signed */
    int32_t fault;
    int64_t skew_us; /* the component's clock less that of arm and camera */
    void (*spoil)(kc_detection_t *d); /* changes every detection */
    void (*spoil_in)(kc_in_t *in); /* changes the whole input of every step */
    kc_status_t (*keep)(const kc_store_t *s); /* the store, if not the one below */
    int store_fails; /* number of requests that the store refuses, -1: all */
    uint16_t store_fails_kind; /* of this kind only, 0: of any */
    /* outputs up to now */
    uint32_t events[EVENT_ID_MAX + 1u], n_acks;
    kc_event_t last[EVENT_ID_MAX + 1u]; /* newest event of each id */
    kc_ack_t ack;
    kc_meas_t meas[KC_MEAS_MAX];
    kc_progress_t progress[KC_MEAS_MAX];
    uint32_t n_meas, n_progress, n_proposal, n_frames, n_hk, n_pantilt_cmd;
    kc_proposal_t proposal;
    kc_hk_t hk;
    kc_arm_cmd_t arm_cmd;
    uint8_t store[WORLD_KINDS][2][KC_IMAGE_MAX]; /* newest, older */
    uint32_t stored[WORLD_KINDS][2];
    uint8_t image[KC_IMAGE_MAX];
    kc_config_t config; /* loaded at boot; tests change it before */
    kc_terms_t terms;
    kc_kernel_t kernel;
    kc_space_t space;
    kc_arm_t arm;
} world_t;

extern world_t world;

/* Good tables, no errors, everything at rest at hub 0; nothing loaded yet. */
void given_world(void);
/* The last n candidates become local initial poses, the last n_reserve of them in reserve, ahead of the
 * other initial poses: where the arm stands (at hub 0, no longer at zero) and LOCAL_STEP_RAD to one side
 * of it, joint by joint. */
#define LOCAL_STEP_RAD 0.2
/* The goal of a candidate is where the arm has the tool at its seed. */
void given_pose_of_seed(kc_cand_t *c);
void given_local_poses(uint32_t n, uint32_t n_reserve);
/* Detections with noise far above what they state; overstate is what is done to each. */
void given_overstated_detections(void);
void overstate(kc_detection_t *d);
/* Load the tables (what the store holds first) and boot. */
void world_boot(void);
void world_tick(void);
void world_ticks(uint32_t n);
/* Step until the state; false if it does not come within max ticks. */
bool world_until(kc_state_t state, uint32_t max);
/* Step until the event came once more than before. */
bool world_until_event(uint32_t id, uint32_t max);
/* Put a command into the next tick. */
kc_cmd_t *world_cmd(int32_t opcode, int32_t a0, int32_t a1, int32_t a2);
/* Sign a message with the next counter. */
void world_sign_cmd(kc_cmd_t *c);
void world_sign_chunk(kc_table_chunk_t *c);
/* Put a command into the next tick, then ticks until it is answered; returns the status of its answer. */
int32_t world_do(int32_t opcode, int32_t a0, int32_t a1, int32_t a2);
/* A nominal correction that names the active tables. */
void world_kin(kc_kin_t *kin);
/* Send an image in chunks, one a tick; its CRC. */
int32_t world_upload(uint16_t kind, const uint8_t *image, uint32_t n);
/* Step until no change is being stored. */
bool world_stored(uint32_t max);
/* Boot, one tick to hear the arm, START; then the first state. */
void world_started(void);
/* A calibration from START to its end. */
void world_calibrated(void);
/* The proposal approved in both steps; its CRC. CRC of the correction in force. */
uint32_t world_approve(void);
uint32_t world_kin_crc(void);
/* A test has changed the active table of this kind in memory on purpose: flight shall take it as it is. */
void world_seal(uint16_t kind);
/* Power loss: only the store remains. */
void world_restart(void);
/* Whether the state is one of a calibration. */
bool world_calibrating(void);
/* Whether the next frame belongs to a measurement: the one with which OBSERVE ends does. */
bool world_measuring(void);
uint32_t world_events(uint32_t id);
/* Remember what a refused input must not change: active tables, staging, state, calibration, frames, the last
 * accepted telemetry and the proposal; and ask whether it is all still the same. */
void world_remember(void);
bool world_unchanged(void);

#endif
