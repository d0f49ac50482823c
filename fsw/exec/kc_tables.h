/* Tables: staged, validated entry by entry, activated whole, dumped; images with CRC and version.
 *
 * Image: magic "KCT1", u16 kind, u16 layout version, u32 payload bytes, u32 CRC-32 (IEEE) of the
 * payload, payload. Every field little-endian, doubles as IEEE 754 bits. One function per kind walks
 * the fields for reading, writing and sizing, so the three can't disagree. */
#ifndef KC_TABLES_H
#define KC_TABLES_H

#include <stdint.h>

#include "kc_arm.h"
#include "kc_camera.h"
#include "kc_config.h"
#include "kc_events.h"
#include "kc_kernel.h"
#include "kc_path.h"
#include "kc_terms.h"

typedef enum {
    KC_TBL_ARM = 1,
    KC_TBL_CAMERA = 2,
    KC_TBL_TERMS = 3,
    KC_TBL_KIN = 4,    /* values of the coefficients: what calibration changes */
    KC_TBL_SPACE = 5,
    KC_TBL_KERNEL = 6,
    KC_TBL_CONFIG = 7,
    KC_TBL_COUNT = 8
} kc_tbl_kind_t;

#define KC_TBL_HDR_BYTES 16u
#define KC_TBL_VERSION 1u

/* The correction in force. */
typedef struct {
    uint32_t n_coef;
    double value[KC_COEF_MAX];
    double sigma[KC_COEF_MAX];
    uint32_t arm_crc, terms_crc; /* tables it belongs to; 0 in a nominal (all zero) table */
    uint32_t prev_crc;           /* kinematics table it replaced                          */
    uint32_t session, n_poses;
    uint64_t made_us;
} kc_kin_t;

typedef struct {
    uint32_t crc[KC_TBL_COUNT]; /* payload CRC by kind, 0 = none */
    kc_arm_t arm;
    kc_camera_t camera;
    kc_terms_t terms;
    kc_kin_t kin;
    kc_kin_t kin_prev;          /* for rollback */
    uint32_t kin_prev_crc;
    kc_space_t space;
    kc_kernel_t kernel;
    kc_config_t config;
} kc_active_t;

typedef enum { KC_STAGE_NONE = 0, KC_STAGE_LOADING = 1, KC_STAGE_COMPLETE = 2, KC_STAGE_VALID = 3 } kc_stage_t;

typedef struct {
    kc_stage_t state;
    uint16_t kind;
    uint32_t n, total;
    uint8_t image[KC_IMAGE_MAX];
} kc_staging_t;

/* A staged image decoded, before it may become active. */
typedef union {
    kc_arm_t arm; kc_camera_t camera; kc_terms_t terms; kc_kin_t kin;
    kc_space_t space; kc_kernel_t kernel; kc_config_t config;
} kc_tbl_scratch_t;

typedef struct {
    kc_active_t active;
    kc_staging_t staging;
    kc_tbl_scratch_t *scratch; /* the owner's; may overlay the GP, because tables only change
                                  while no calibration runs                                  */
} kc_tables_t;

/* Write table `src` (the struct of that kind) as an image. *n: bytes needed, also when cap is too
 * small (KC_ERR_FULL). Only bytes [from, from + cap) are written, so a dump needs no second image. */
kc_status_t kc_tbl_encode(uint16_t kind, const void *src, uint32_t from, uint8_t *buf, uint32_t cap,
                          uint32_t *n);
/* Check header, size, CRC, then read all fields into `dst` (the struct of that kind) and validate every
 * entry. On error dst is undefined and the first problem is one event, the total another. */
kc_status_t kc_tbl_decode(uint16_t kind, const uint8_t *image, uint32_t n, void *dst, kc_events_t *ev);
/* Payload CRC stated in an image header, 0 if there is no header. */
uint32_t kc_tbl_image_crc(const uint8_t *image, uint32_t n);

/* Take a chunk; a chunk at offset 0 starts over. KC_ERR_FORMAT / KC_ERR_FULL drop what was staged;
 * the active tables never change here. */
kc_status_t kc_tbl_chunk(kc_tables_t *t, uint16_t kind, uint32_t total, uint32_t offset,
                         const uint8_t *data, uint32_t n, kc_events_t *ev);
/* Validate the staged image (kind and CRC must be the ones named), also against the active tables it
 * depends on. */
kc_status_t kc_tbl_validate(kc_tables_t *t, uint16_t kind, uint32_t crc, kc_events_t *ev);
/* Activate what was validated: all or nothing. Tables that depend on it and no longer fit are
 * dropped with an event. */
kc_status_t kc_tbl_activate(kc_tables_t *t, uint16_t kind, uint32_t crc, kc_events_t *ev);
void kc_tbl_discard(kc_tables_t *t, kc_events_t *ev);

#endif
