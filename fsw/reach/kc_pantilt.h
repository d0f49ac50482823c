/* Pan-tilt commands: the camera points where the corrected arm is expected. */
#ifndef KC_PANTILT_H
#define KC_PANTILT_H

#include <stdbool.h>

#include "kc_channels.h"
#include "kc_view.h"

typedef struct {
    double pan_rad, tilt_rad; /* last command */
    uint64_t sent_us;
    int32_t seq;
} kc_pantilt_t;

/* Turn, inside the limits of the CAMERA table. */
void kc_pantilt_turn(kc_pantilt_t *pantilt, const kc_view_t *view, kc_out_t *out, double pan_rad,
                     double tilt_rad);
/* Turn to where the corrected arm is expected at joints q, moved by off_m (what was measured at this candidate
 * less what was predicted). */
void kc_pantilt_aim(kc_pantilt_t *pantilt, const kc_view_t *view, kc_out_t *out, const double *q,
                    const double off_m[3]);
/* Wait for the unit: DONE when it is there, sent again if the command was lost. */
kc_outcome_t kc_pantilt_wait(kc_pantilt_t *pantilt, const kc_view_t *view, kc_out_t *out);

#endif
