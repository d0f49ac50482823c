/* What the harnesses share: the input read as a stream of choices, tables spoiled at a few places, and what has to
 * hold after every step of the component. */
#ifndef FUZZ_H
#define FUZZ_H

#include <stddef.h>
#include <stdint.h>

#include "kc_app_parts.h"

/* A property that no input may break: libFuzzer keeps the input. */
#define MUST(holds) ((holds) ? (void)0 : fuzz_broken(#holds, __FILE__, __LINE__))
void fuzz_broken(const char *what, const char *file, int line);

/* The input; past its end all is zero. */
typedef struct {
    const uint8_t *at;
    size_t left;
} fuzz_t;

uint8_t fuzz_u8(fuzz_t *f);
uint16_t fuzz_u16(fuzz_t *f);
uint32_t fuzz_u32(fuzz_t *f);
/* One of the numbers at which checks fail (NaN, infinities, largest, smallest), or 8 bytes of the input. */
double fuzz_f64(fuzz_t *f);

/* Change bytes or numbers of data at up to 7 places. */
void fuzz_spoil(fuzz_t *f, uint8_t *data, uint32_t n);
/* Magic, kind, version, size and CRC of a table image made right, so that what is behind them is reached. */
void fuzz_seal_image(uint16_t kind, uint8_t *image, uint32_t n);

/* The tables of the unit tests, as images by kind; 8 candidates, poses and frames few, so that steps are quick. */
typedef struct {
    uint8_t data[16u * 1024u];
    uint32_t n;
} fuzz_image_t;
extern fuzz_image_t fuzz_image[KC_TBL_COUNT];
/* given_world with them, n_local of the candidates local initial poses; fills fuzz_image. */
void fuzz_given_world(uint32_t n_local);

/* After a step: counts within their limits, no number that is not finite, no pointer moved, memory as sealed; the
 * arm is sent only to places inside its limits and inside the bound of a node, and only during a calibration; the
 * correction changes only by a change that was stored. before, kin_crc: state and correction before the step. */
void fuzz_check_step(const kc_app_t *app, const kc_out_t *out, kc_state_t before, uint32_t kin_crc);
/* Costly, so at the end of an input: every active table encodes to its CRC, and its memory is as it was sealed. */
void fuzz_check_tables(const kc_active_t *a);

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size);
int LLVMFuzzerInitialize(int *argc, char ***argv);

#endif
