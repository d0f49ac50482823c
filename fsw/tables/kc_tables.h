/* Tables: staged, validated entry by entry, activated whole, dumped; images with CRC and version.
 *
 * Image: magic "KCT1", u16 kind, u16 layout version of that kind, u32 payload bytes, u32 CRC-32 (IEEE) of the
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
    KC_TBL_KIN = 4, /* values of the coefficients: what calibration changes */
    KC_TBL_SPACE = 5,
    KC_TBL_KERNEL = 6,
    KC_TBL_CONFIG = 7,
    KC_TBL_COUNT = 8
} kc_tbl_kind_t;

#define KC_TBL_HDR_BYTES 16u

/* The correction in force. */
typedef struct {
    uint32_t n_coef;
    double value[KC_COEF_MAX];
    double sigma[KC_COEF_MAX];
    uint32_t arm_crc, terms_crc; /* tables it belongs to; 0 in a nominal (all zero) table */
    uint32_t prev_crc;           /* kinematics table it replaced */
    uint32_t session, n_poses;
    uint64_t made_us;
} kc_kin_t;

typedef struct {
    uint32_t crc[KC_TBL_COUNT]; /* payload CRC by kind, 0 = none */
    kc_arm_t arm;
    kc_camera_t camera;
    kc_terms_t terms;
    kc_kin_t kin;
    kc_kin_t kin_prev; /* for rollback */
    uint32_t kin_prev_crc;
    kc_space_t space;
    kc_kernel_t kernel;
    kc_config_t config;
    /* CRC of each struct above as it lies in memory, by kind; [0]: kin_prev. Set with every change of it */
    uint32_t seal[KC_TBL_COUNT];
} kc_active_t;

typedef enum {
    KC_STAGE_NONE = 0,
    KC_STAGE_LOADING = 1,
    KC_STAGE_COMPLETE = 2,
    KC_STAGE_VALID = 3
} kc_stage_t;

typedef struct {
    kc_stage_t state;
    uint16_t kind;
    uint32_t n, total;
    uint8_t *image; /* the owner's, KC_IMAGE_MAX bytes; kept only while something is staged */
} kc_staging_t;

/* A staged image decoded, before it may become active. */
typedef union {
    kc_arm_t arm;
    kc_camera_t camera;
    kc_terms_t terms;
    kc_kin_t kin;
    kc_space_t space;
    kc_kernel_t kernel;
    kc_config_t config;
} kc_tbl_scratch_t;

typedef struct {
    kc_active_t active;
    kc_staging_t staging;
    kc_tbl_scratch_t *scratch; /* the owner's; used inside one call of kc_tbl_activate, kc_tbl_validate,
                                  kc_tbl_load or kc_tbl_load_prev */
} kc_tables_t;

/* Write table `src` (the struct of that kind) as an image. Only bytes [from, from + cap) are written, so
 * a dump needs no second image. *n: bytes of the whole image, also when the window does not reach its
 * end (KC_ERR_FULL). KC_ERR_ARG: unknown kind or an impossible count, *n = 0 and nothing written. */
kc_status_t kc_tbl_encode(uint16_t kind, const void *src, uint32_t from, uint8_t *buf, uint32_t cap,
                          uint32_t *n);
/* Check header, size, CRC, then read all fields into `dst` (the struct of that kind) and validate every
 * entry. On error dst is undefined; the first problem is one event (TBL_FORMAT, TBL_CRC, TBL_RANGE,
 * TBL_NOT_FINITE, TBL_NOT_UNIT), the number of bad values another (TBL_BAD_TOTAL). Rules that need
 * another table are checked by kc_tbl_validate. */
kc_status_t kc_tbl_decode(uint16_t kind, const uint8_t *image, uint32_t n, void *dst, kc_events_t *ev);
/* Payload CRC stated in an image header, 0 if there is no header. */
uint32_t kc_tbl_image_crc(const uint8_t *image, uint32_t n);

/* Take a chunk; a chunk at offset 0 starts over. KC_ERR_FORMAT / KC_ERR_FULL drop what was staged;
 * the active tables never change here. TBL_STAGED when the last byte is in. */
kc_status_t kc_tbl_chunk(kc_tables_t *tables, uint16_t kind, uint32_t total, uint32_t offset,
                         const uint8_t *data, uint32_t n, kc_events_t *ev);
/* Validate the staged image (kind and CRC must be the ones named: KC_ERR_STATE, KC_ERR_CRC), also against
 * the active tables it depends on (KC_ERR_STATE, TBL_DEPENDS or TBL_MISSING):
 *   TERMS needs an ARM; KIN needs ARM and TERMS, the CRCs it was made for (none in a nominal table) and
 *   values inside the bounds; SPACE needs the ARM it was built for, by CRC. SPACE and TERMS have to agree,
 *   whichever comes second is refused: what TERMS can describe is what SPACE was verified for (kc_bounds.h;
 *   TBL_TERMS_WIDE, TBL_SPACE_NARROW).
 * The image stays staged when it is refused. */
uint64_t kc_tbl_cost(const kc_tables_t *tables); /* bound of the instructions for what is staged */
kc_status_t kc_tbl_validate(kc_tables_t *tables, uint16_t kind, uint32_t crc, kc_events_t *ev);
/* Activate what was validated: all or nothing (it is decoded again, since the scratch is shared and other
 * tables may have changed). Tables that depend on it and no longer fit are dropped, TBL_DROPPED each:
 * KIN falls back to a nominal table of zeros, which has a CRC like any other; the rest to none. A new KIN
 * keeps the old one as kin_prev. Nothing is staged afterwards. */
kc_status_t kc_tbl_activate(kc_tables_t *tables, uint16_t kind, uint32_t crc, kc_events_t *ev);
/* Whether kc_tbl_activate would: the same checks, the same events; nothing changes. */
kc_status_t kc_tbl_ready(kc_tables_t *tables, uint16_t kind, uint32_t crc, kc_events_t *ev);
void kc_tbl_discard(kc_tables_t *tables, kc_events_t *ev);

/* Boot: decode, check and activate an image that was stored; kin_prev stays. In order of kinds. Errors as
 * above, the active tables unchanged. */
kc_status_t kc_tbl_load(kc_tables_t *tables, uint16_t kind, const uint8_t *image, uint32_t n,
                        kc_events_t *ev);
/* Boot: the KIN image to roll back to, checked as an active one would be. */
kc_status_t kc_tbl_load_prev(kc_tables_t *tables, const uint8_t *image, uint32_t n, kc_events_t *ev);

/* Would this correction fit the active ARM and TERMS? KC_OK or the error with its event. */
kc_status_t kc_tbl_kin_fits(const kc_tables_t *tables, const kc_kin_t *kin, kc_events_t *ev);
/* Put a correction in force and keep the one before; KC_ERR_* as kc_tbl_kin_fits, nothing changed.
 * Its CRC is then active.crc[KC_TBL_KIN]. `kin` may not point into t. */
kc_status_t kc_tbl_set_kin(kc_tables_t *tables, const kc_kin_t *kin, kc_events_t *ev);
/* Back to kin_prev; there is none afterwards. KC_ERR_STATE and COR_NO_PREVIOUS if there is none. */
kc_status_t kc_tbl_rollback(kc_tables_t *tables, kc_events_t *ev);

/* The active struct of a kind, NULL for an unknown kind; meaningful only while crc[kind] != 0. */
const void *kc_tbl_active_ptr(const kc_active_t *active, uint16_t kind);
/* Bytes of the struct of a kind, 0: of kin_prev; 0 for an unknown kind. */
uint32_t kc_tbl_active_bytes(uint16_t kind);

#endif
