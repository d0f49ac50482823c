/* Normal operation: detections outside calibrations feed the miscalibration monitor. */
#ifndef KC_MONITORING_H
#define KC_MONITORING_H

#include <stdbool.h>

#include "kc_channels.h"
#include "kc_monitor.h"
#include "kc_suspects.h"
#include "kc_view.h"
#include "kc_work.h"

typedef struct {
    kc_mon_verdict_t reported;           /* last verdict that was reported */
    kc_mon_verdict_t newest;             /* verdict on the observations held */
    kc_suspects_t suspects;              /* joints behind it, and how sure; nothing while it is quiet */
    kc_mon_verdict_t found;              /* a verdict that is weighed next */
    uint32_t crc[KC_TBL_COUNT], session; /* tables and calibration of the observations */
    uint64_t rest_us, t_us;              /* elapsed: at rest since; newest observation */
    bool resting;
    bool due; /* there are observations that `newest` does not know */
    bool weigh; /* `found` is to be weighed */
} kc_monitoring_t;

/* Whether a detection that no calibration waits for is passed to the monitor. */
bool kc_monitoring_wants(const kc_view_t *view);
/* Whether the newest verdict names joints, by the tables in force and since the last calibration. */
bool kc_monitoring_names(const kc_monitoring_t *monitoring, const kc_view_t *view);
/* Record since when arm and pan-tilt unit are at rest; call after every step's telemetry. */
void kc_monitoring_rest(kc_monitoring_t *monitoring, const kc_view_t *view);
/* Take a checked detection into `monitor`, which starts anew after a calibration or a change of tables. It is
 * not compared, with an event, unless arm and pan-tilt unit had settled before. */
void kc_monitoring_observe(kc_monitoring_t *monitoring, kc_monitor_t *monitor, const kc_view_t *view,
                           const kc_detection_t *det, kc_work_t *work, kc_out_t *out);
/* The verdict on new observations, as soon as steps have room for it: what is found in one, the joints behind it
 * in the next. Reported with an event. */
void kc_monitoring_evaluate(kc_monitoring_t *monitoring, const kc_monitor_t *monitor, const kc_view_t *view,
                            kc_work_t *work, kc_out_t *out);

#endif
