/* A calibration that starts from the monitor's suspects (METHOD.md 5.3).
 *
 * The chance that the encoder of a joint slipped becomes the prior of its offset: with it the offset lies anywhere
 * between its bounds, else, as every other coefficient, it is near the correction in force, by the sigma of KIN and at
 * least rest_part of its scale. The prior counts as an observation of each coefficient, in the fit and in what is
 * chosen next.
 *
 * No such sigma is larger than that of the bounds, so whatever casts doubt on an arm inside its bounds casts doubt on
 * the suspicion before. Then it is dropped, for good: the observations stay, and the calibration goes on as one that
 * was started without. What is predicted safe is always predicted by the bounds (kc_select.c). */
#ifndef KC_SUSPICION_H
#define KC_SUSPICION_H

#include "kc_channels.h"
#include "kc_suspects.h"
#include "kc_view.h"

/* Coefficients that are the offset of the encoder of one of these joints (bit per joint), of those in mask. */
uint64_t kc_suspicion_offsets(const kc_active_t *tables, uint32_t joints, uint64_t mask);
/* After kc_update_start: est gets the prior. */
void kc_suspicion_begin(kc_est_t *est, const kc_view_t *view, const kc_suspects_t *suspects, kc_out_t *out);
/* Whether the solved estimate casts doubt on the suspicion; it is dropped then, and the estimate to be repeated. */
bool kc_suspicion_fails(kc_est_t *est, const kc_view_t *view, kc_out_t *out);

#endif
