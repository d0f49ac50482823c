/* Events: what happened, for operators. The core records, the edge sends.
 *
 * One line per event: id, name, severity, and its text with {got}, {want}, {index}. docs/EVENTS.md and
 * the ground's dictionary are made from this list. Ids never change meaning. */
#ifndef KC_EVENTS_H
#define KC_EVENTS_H

#include <stdint.h>

#include "kc_limits.h"

typedef enum { KC_SEV_DEBUG = 0, KC_SEV_INFO = 1, KC_SEV_WARN = 2, KC_SEV_ERROR = 3 } kc_severity_t;

/* X(id, NAME, severity, "text") */
#define KC_EVENT_LIST(X)                                                                                  \
    X(1, BOOT, INFO, "started; boot {index}")                                                             \
    X(2, BOOT_INTERRUPTED, WARN, "was killed in state {got} at pose {want}; that calibration is lost")    \
    X(3, BOOT_SLOT_BAD, WARN, "stored table kind {index} unreadable, status {got}; other slot used")      \
    X(4, BOOT_REVIEW, INFO, "correction {got} still waits for review")                                    \
    X(10, CMD_ACCEPTED, INFO, "command {got} accepted")                                                   \
    X(11, CMD_UNKNOWN, ERROR, "unknown command {got}")                                                    \
    X(12, CMD_STALE, ERROR, "command sequence {got}, newer than {want} expected")                         \
    X(13, CMD_STATE, ERROR, "command {index} refused in state {got}")                                     \
    X(14, CMD_ARG, ERROR, "command argument {index} is {got}, allowed up to {want}")                      \
    X(15, CMD_CRC, ERROR, "command names CRC {got}, it is {want}")                                        \
    X(16, CMD_SOURCE, ERROR, "command from unknown source {got}")                                         \
    X(20, TBL_STAGED, INFO, "table kind {index} staged, {got} bytes")                                     \
    X(21, TBL_FORMAT, ERROR, "table image refused: header field {index} is {got}, expected {want}")       \
    X(22, TBL_CRC, ERROR, "table image CRC {got}, header says {want}")                                    \
    X(23, TBL_RANGE, ERROR, "table entry {index} out of range: {got} (field {want})")                     \
    X(24, TBL_BAD_TOTAL, ERROR, "table kind {index} refused: {got} bad entries")                          \
    X(25, TBL_CHUNK, ERROR, "table chunk at offset {got}, expected {want}")                               \
    X(26, TBL_ACTIVATED, INFO, "table kind {index} active, CRC {got}")                                    \
    X(27, TBL_NOT_READY, ERROR, "nothing staged of kind {index} that could be activated")                 \
    X(28, TBL_DEPENDS, ERROR, "table kind {index} was built for CRC {got}, active is {want}")             \
    X(29, TBL_MISSING, ERROR, "table kind {index} is missing")                                            \
    X(30, TBL_DISCARDED, INFO, "staged table of kind {index} discarded")                                  \
    X(31, TBL_BUSY, ERROR, "tables cannot change in state {got}")                                         \
    X(32, TBL_NOT_FINITE, ERROR, "table entry {index} is not a finite number: {got} (field {want})")      \
    X(33, TBL_NOT_UNIT, ERROR, "table entry {index} quaternion norm {got} (field {want})")                \
    X(34, TBL_DROPPED, WARN, "table kind {index} dropped: built for CRC {got}, active is {want}")         \
    X(40, IN_RANGE, ERROR, "input {index} out of range: {got}, allowed {want}")                           \
    X(41, IN_STALE, WARN, "input {index} has sequence {got}, newer than {want} expected")                 \
    X(42, IN_NOT_UNIT, ERROR, "input {index} quaternion norm {got}")                                      \
    X(43, IN_COUNT, ERROR, "input {index} has {got} joints, arm has {want}")                              \
    X(44, DET_OLD, WARN, "frame is {got} us old, allowed {want}")                                         \
    X(45, DET_UNKNOWN_TAG, WARN, "detection names unknown tag {got}")                                     \
    X(46, DET_JUMP, WARN, "detection jumps by {got}, allowed {want}")                                     \
    X(47, DET_UNCERTAIN, WARN, "detection sigma {got}, allowed {want}")                                   \
    X(48, DET_NONE, DEBUG, "no tag in frame {got}")                                                       \
    X(49, DET_UNASKED, WARN, "detection of frame {got}, asked for {want}")                                \
    X(50, ARM_FAULT, ERROR, "arm controller fault mask {got}")                                            \
    X(51, IN_SILENT, ERROR, "input {index} silent for {got} us, allowed {want}")                          \
    X(60, CAL_START, INFO, "calibration {index}: {got} poses, acquisition {want}")                        \
    X(61, CAL_POSE, INFO, "pose {index} measured: {got} m, {want} rad off")                               \
    X(62, CAL_MOVE_TIMEOUT, ERROR, "arm not there after {got} us")                                        \
    X(63, CAL_LOOK_TIMEOUT, WARN, "no frame after {got} us")                                              \
    X(64, CAL_TAGS_LOST, WARN, "tags not found at candidate {index} after {got} looks")                   \
    X(65, CAL_SERVO_LIMIT, WARN, "servo stopped at candidate {index} after {got} steps, {want} m off")    \
    X(66, CAL_CAND_SKIPPED, WARN, "candidate {index} marked unusable")                                    \
    X(67, CAL_NO_CANDIDATE, ERROR, "no usable candidate left")                                            \
    X(68, CAL_NO_PATH, ERROR, "no proven path to candidate {index}")                                      \
    X(69, CAL_OUTLIER, WARN, "pose {index} rejected as outlier")                                          \
    X(70, CAL_RANK, WARN, "rank {got} of {want}: dependent coefficients held")                            \
    X(71, CAL_HELD, WARN, "coefficient {index} cannot be determined, held at {got}")                      \
    X(72, CAL_EST, WARN, "estimator status {got}")                                                        \
    X(73, CAL_BUDGET, WARN, "budget of {want} us used up after {got} us")                                 \
    X(74, CAL_CONVERGED, INFO, "predicted pose sigma {got} m meets {want} m")                             \
    X(75, CAL_ABORTED, WARN, "calibration aborted at pose {index}, cause {got}")                          \
    X(76, CAL_POOR, ERROR, "fit is poor: p {got}, noise scale {want}")                                    \
    X(77, CAL_ENERGY, WARN, "energy budget of {want} J used up: {got} J")                                 \
    X(78, CAL_STRAY, ERROR, "look {index} {got} m, {want} rad off the best correction within its bounds") \
    X(79, CAL_NOT_SEEN, ERROR, "tags seen in {got} of {want} first looks, a third is needed")             \
    X(80, COR_PROPOSED, INFO, "correction proposed, CRC {got}, {want} poses")                             \
    X(81, COR_NO_CHANGE, INFO, "nothing needs to change: p {got}")                                        \
    X(82, COR_ARMED, INFO, "approval armed for CRC {got}")                                                \
    X(83, COR_ACTIVE, INFO, "correction active, CRC {got}")                                               \
    X(84, COR_REJECTED, INFO, "correction {got} rejected")                                                \
    X(85, COR_ROLLBACK, INFO, "rolled back to CRC {got}")                                                 \
    X(86, COR_ON_BOARD, INFO, "correction {got} accepted on board by policy")                             \
    X(87, COR_NO_PREVIOUS, ERROR, "no previous correction to roll back to")                               \
    X(88, COR_EXPIRED, WARN, "approval of CRC {got} not confirmed in time, review goes on")               \
    X(89, GRD_LIMIT, WARN, "move refused: joint {index} would go to {got}, allowed {want}")               \
    X(90, STORE_FAIL, ERROR, "store of kind {index} failed, status {got}")                                \
    X(91, GRD_WAY, WARN, "move refused: joint {index} {got} beyond the proven {want}")                    \
    X(92, GRD_VOLUME, WARN, "move refused: body {index} {got} m inside volume {want}")                    \
    X(93, GRD_SELF, WARN, "move refused: body {index} {got} m inside body {want}")                        \
    X(95, MON_SUSPECT, WARN, "joint {index} reads wrong by {got}; joints that could be meant: {want}")    \
    X(96, MON_UNEXPLAINED, WARN, "tool {got} m, {want} rad off prediction; no single joint says why")     \
    X(97, MON_NOT_AT_REST, DEBUG, "look {got} not compared: arm or head had not settled")

#define KC_EVENT_ENUM_(id, name, sev, text) KC_EVT_##name = (id),
typedef enum { KC_EVENT_LIST(KC_EVENT_ENUM_) KC_EVT_NONE = 0 } kc_event_id_t;

typedef struct {
    uint16_t id;
    uint8_t severity;
    int32_t index; /* -1 if none */
    double got, want;
} kc_event_t;

typedef struct {
    uint32_t n, dropped;
    kc_event_t e[KC_EVENTS_MAX];
} kc_events_t;

/* Record; counts as dropped when full. A repeat of the same id and index within one step is
 * recorded once. */
void kc_event(kc_events_t *q, kc_event_id_t id, int32_t index, double got, double want);

const char *kc_event_name(uint16_t id);
const char *kc_event_text(uint16_t id);
int kc_event_severity(uint16_t id);

#endif
