/* Events: what happened, for operators. The core records, the edge sends.
 *
 * One line per event: id, name, severity, text, and what the operator does next ("" if nothing).
 * docs/EVENTS.md and the ground's dictionary are made from this list. Ids never change meaning.
 *
 * A text names its values as {field:type}: field is index, got or want, type one of KC_EVENT_TYPE_LIST.
 * The type says how the ground shows the number (names, units, digits); alternatives such as mm/mrad are
 * chosen by index. ground/kincal/flight/event_format.py formats them. */
#ifndef KC_EVENTS_H
#define KC_EVENTS_H

#include <stdint.h>

#include "kc_limits.h"

typedef enum { KC_SEV_DEBUG = 0, KC_SEV_INFO = 1, KC_SEV_WARN = 2, KC_SEV_ERROR = 3 } kc_severity_t;

/* X("type", "how it is shown") */
#define KC_EVENT_TYPE_LIST(X)                                                 \
    X("count", "whole number; negative: none")                                \
    X("number", "number without unit")                                        \
    X("mm", "length or distance: in m, shown in mm")                          \
    X("mrad", "angle: in rad, shown in mrad")                                 \
    X("mm/mrad", "index 0: as mm; 1: as mrad")                                \
    X("mm/mrad/px", "index 0: as mm; 1: as mrad; 2: pixels")                  \
    X("s", "time: in us, shown in s")                                         \
    X("ago", "time since it happened, as s; negative: never")                 \
    X("before_now", "age of a time stamp, as s; negative: after now")         \
    X("time", "mission time: in us, shown in s, or as UTC from 1970 on")      \
    X("stopped", "poses measured by what was stopped; negative: nothing ran") \
    X("J", "energy [J]")                                                      \
    X("crc", "CRC-32, eight hexadecimal digits")                              \
    X("mask", "bit mask, hexadecimal")                                        \
    X("store", "kc_tbl_kind_t or KC_STORE_*: what is stored")                 \
    X("state", "kc_state_t")                                                  \
    X("command", "kc_opcode_t")                                               \
    X("source", "who commands: cmd_t.SRC_*")                                  \
    X("argument", "command argument: 0 to 3 arg_i, 4 arg_u64")                \
    X("input", "kc_input_t")                                                  \
    X("input_field", "field of an input message, kc_input_field")             \
    X("status", "kc_status_t")                                                \
    X("cause", "kc_cause_t, as a sentence")                                   \
    X("acquisition", "kc_acq_t")                                              \
    X("entry", "entry of a table: number from 0, with what it is")            \
    X("field", "field number of docs/TABLES.md; 0: a rule between entries")   \
    X("pose", "pose of this calibration, from 1")                             \
    X("candidate", "index in the SPACE table, from 0")                        \
    X("candidate_or_any", "the same; negative: any candidate")                \
    X("coefficient", "name by the TERMS table, or index from 0")              \
    X("joint", "joint, from 1")                                               \
    X("joint_value", "joint coordinate or difference [rad; m if prismatic]")  \
    X("joints", "bit per joint (bit 0 = joint 1), shown as a list")           \
    X("body", "body of the SPACE table, from 0")                              \
    X("volume", "keep-out volume of the SPACE table, from 0")

/* X(id, NAME, severity, "text", "operator's next step") */
#define KC_EVENT_LIST(X)                                                                                     \
    X(1, BOOT, INFO, "flight software started, boot {index:count}", "")                                      \
    X(2, BOOT_INTERRUPTED, WARN,                                                                             \
      "the last run ended in state {got:state} after {want:count} measured poses; that calibration is lost", \
      "Check where the arm stands, then send START.")                                                        \
    X(3, BOOT_SLOT_BAD, WARN,                                                                                \
      "stored copy of {index:store} cannot be read ({got:status}); the other copy is used",                  \
      "None, unless TBL_MISSING follows: then upload that table.")                                           \
    X(4, BOOT_REVIEW, INFO, "correction CRC {got:crc} still waits for review",                               \
      "Review it: APPROVE_ARM or REJECT.")                                                                   \
    X(5, BOOT_LOST, ERROR,                                                                                   \
      "{index:store} CRC {want:crc} was in force and is not in the store; CRC {got:crc} is in force now",    \
      "CRC 00000000: none. Upload the KIN table that shall be active, or calibrate again.")                  \
    X(6, BOOT_NO_KEYS, WARN, "no keys: only NOOP and ABORT are accepted",                                    \
      "Start kincal-fsw with --keys FILE; `kincal key new` makes the file.")                                 \
    X(7, CMD_KEY, ERROR, "message from {index:source} refused: flight has no key {got:count}",               \
      "Give sender and flight the same key file; flight reads it when it starts.")                           \
    X(8, CMD_FORGED, ERROR, "message from {index:source} refused: its MAC does not match key {got:count}",   \
      "The sender does not hold flight's key, or the message was changed on the way. If it was not you, "    \
      "find out who sends on this network.")                                                                 \
    X(9, CMD_REPLAYED, ERROR,                                                                                \
      "message from {index:source} refused: its counter {got:count} is not above {want:count}",              \
      "Repeated, or a later command arrived first: send it again. After the loss of FILE.count*: "           \
      "docs/INTERFACES.md, Keys.")                                                                           \
    X(10, CMD_ACCEPTED, INFO, "command {got:command} accepted", "")                                          \
    X(11, CMD_UNKNOWN, ERROR, "command refused: unknown opcode {got:count}",                                 \
      "Check that sender and flight have the same message definitions.")                                     \
    X(12, CMD_STALE, ERROR,                                                                                  \
      "command from {index:source} refused: sequence number {got:count} does not follow {want:count}",       \
      "Send it again with the next number; a sender that lost its count waits 10 s.")                        \
    X(13, CMD_STATE, ERROR, "command {index:command} refused in state {got:state}",                          \
      "See docs/STATES.md, Commands by state.")                                                              \
    X(14, CMD_ARG, ERROR,                                                                                    \
      "command refused: {index:argument} is {got:number}, largest allowed {want:number}",                    \
      "Correct the argument and send the command again.")                                                    \
    X(15, CMD_CRC, ERROR, "command refused: it names CRC {got:crc}, the one on board is {want:crc}",         \
      "Review what is on board before you repeat the command with its CRC.")                                 \
    X(16, CMD_SOURCE, ERROR, "command refused: unknown source {got:count}",                                  \
      "Set the source to 1 (executive) or 2 (ground).")                                                      \
    X(18, CMD_WORK, ERROR,                                                                                   \
      "command {index:command} refused: earlier commands left no time for it in this step",                  \
      "Send it again.")                                                                                      \
    X(19, CMD_UNSIGNED, ERROR, "message from {index:source} refused: it has to be signed, and is not",       \
      "Sign it: docs/INTERFACES.md, Signed commands. `kincal` does, with --keys FILE.")                      \
    X(20, TBL_STAGED, INFO, "{index:store} staged, {got:count} bytes",                                       \
      "Next: TABLE_VALIDATE, then TABLE_ACTIVATE.")                                                          \
    X(21, TBL_FORMAT, ERROR,                                                                                 \
      "table image refused: header field {index:count} is {got:count}, expected {want:count}",               \
      "Rebuild the image for this version of flight and this kind of table.")                                \
    X(22, TBL_CRC, ERROR,                                                                                    \
      "{index:store} refused: its content has CRC {got:crc}, its header says {want:crc}",                    \
      "Upload it again; if that does not help, rebuild it.")                                                 \
    X(23, TBL_RANGE, ERROR, "table refused: {index:entry}, {want:field}: value {got:number} is not allowed", \
      "Correct this value (limits: docs/TABLES.md) and build the table again.")                              \
    X(24, TBL_BAD_TOTAL, ERROR, "{index:store} refused: {got:count} values are not allowed",                 \
      "The event before names the first one; `kincal table check` lists them on the ground.")                \
    X(25, TBL_CHUNK, ERROR,                                                                                  \
      "upload of {index:store} refused: chunk starts at byte {got:count}, expected {want:count}",            \
      "Upload the whole image again, in order.")                                                             \
    X(26, TBL_ACTIVATED, INFO, "{index:store} active, CRC {got:crc}", "")                                    \
    X(27, TBL_NOT_READY, ERROR, "command refused: no {index:store} is staged, or it is not validated",       \
      "Upload it, then TABLE_VALIDATE, then TABLE_ACTIVATE.")                                                \
    X(28, TBL_DEPENDS, ERROR,                                                                                \
      "{index:store} refused: built for a table with CRC {got:crc}, active is {want:crc}",                   \
      "Build it for the active tables, or activate those first.")                                            \
    X(29, TBL_MISSING, ERROR, "no {index:store} on board", "Upload and activate it.")                        \
    X(30, TBL_DISCARDED, INFO, "staged {index:store} discarded", "")                                         \
    X(31, TBL_BUSY, ERROR, "tables cannot change in state {got:state}",                                      \
      "Wait for IDLE or SAFE, or send ABORT.")                                                               \
    X(32, TBL_NOT_FINITE, ERROR,                                                                             \
      "table refused: {index:entry}, {want:field}: value {got:number} is not a finite number",               \
      "Correct this value and build the table again.")                                                       \
    X(33, TBL_NOT_UNIT, ERROR,                                                                               \
      "table refused: {index:entry}, {want:field}: quaternion has norm {got:number}, must be 1",             \
      "Normalise the quaternion and build the table again.")                                                 \
    X(34, TBL_DROPPED, WARN,                                                                                 \
      "{index:store} dropped: built for a table with CRC {got:crc}, active is {want:crc}",                   \
      "Upload one that was built for the active tables.")                                                    \
    X(35, TBL_ARM_DIFFERS, ERROR,                                                                            \
      "{index:store} refused: made for an arm with kinematics CRC {got:crc}, the active one has {want:crc}", \
      "Build it for the arm of the ARM table, or activate the ARM table of that arm first.")                 \
    X(40, IN_RANGE, ERROR, "message refused: {index:input_field} is {got:number}, limit {want:number}",      \
      "Check the sender; a joint reading beyond its limit points to an encoder fault.")                      \
    X(41, IN_STALE, WARN, "{index:input} message refused: {got:count} is not newer than {want:count}",       \
      "None if it happens once; otherwise two senders are active.")                                          \
    X(42, IN_NOT_UNIT, ERROR, "{index:input} message refused: quaternion has norm {got:number}",             \
      "Check the sender.")                                                                                   \
    X(43, IN_COUNT, ERROR,                                                                                   \
      "{index:input} message refused: {got:count} joints, the ARM table has {want:count}",                   \
      "Load the ARM table of this arm.")                                                                     \
    X(44, DET_OLD, WARN, "detection refused: frame is {got:s} old, allowed {want:s}",                        \
      "Check the load of the detector and the clocks.")                                                      \
    X(45, DET_UNKNOWN_TAG, WARN, "detection refused: tag {got:count} is unknown or listed twice",            \
      "Check the tags of the CAMERA table.")                                                                 \
    X(46, DET_JUMP, WARN,                                                                                    \
      "detection refused: {got:mm/mrad} from the frames before it, allowed {want:mm/mrad}",                  \
      "None if rare; otherwise the arm or the mast was not at rest.")                                        \
    X(47, DET_UNCERTAIN, WARN, "detection refused: uncertainty {got:mm/mrad/px}, allowed {want:mm/mrad/px}", \
      "None if rare; otherwise check lighting, focus and the limits in CONFIG.")                             \
    X(48, DET_NONE, DEBUG, "no tag in frame {got:count}", "")                                                \
    X(49, DET_UNREQUESTED, WARN, "detection of frame {got:count} refused: waiting for frame {want:count}",   \
      "None if rare; otherwise a second program requests frames.")                                           \
    X(50, ARM_FAULT, ERROR, "arm controller reports a fault, mask {got:mask}",                               \
      "Clear the fault at the arm controller.")                                                              \
    X(51, IN_SILENT, ERROR, "{index:input} silent, last message: {got:ago} (allowed {want:s})",              \
      "Check that the sender runs and that its messages arrive.")                                            \
    X(52, TIME_STEP, WARN, "mission clock changed from {want:time} to {got:time} within one step",           \
      "Check the clock source. Messages are refused until the clocks of their senders agree again.")         \
    X(53, MEMORY_TABLE, ERROR, "{index:store} CRC {got:crc} has changed in memory; it is not used any more", \
      "Restart flight: it loads what is stored. Or upload and activate that table.")                         \
    X(54, MEMORY_OBSERVATIONS, ERROR, "the {got:count} observations have changed in memory",                 \
      "None: that calibration is lost, START begins a new one.")                                             \
    X(55, IN_JUMP, WARN,                                                                                     \
      "{index:input} message numbered {got:count} after {want:count}: taken, its time stamp is newer",       \
      "None if its sender was started again; otherwise find out who else sends.")                            \
    X(60, CAL_START, INFO,                                                                                   \
      "calibration {index:count} started: {got:count} poses, chosen by {want:acquisition}", "")              \
    X(61, CAL_POSE, INFO, "pose {index:pose} measured: {got:mm}, {want:mrad} from the prediction", "")       \
    X(62, CAL_MOVE_TIMEOUT, ERROR, "{index:input} did not arrive or come to rest within {got:s}",            \
      "Look for an obstacle or a fault before the next START.")                                              \
    X(63, CAL_FRAME_TIMEOUT, WARN, "no frame within {got:s}",                                                \
      "None if rare; CAL_ABORTED follows when retries do not help. Check camera and detector.")              \
    X(64, CAL_TAGS_LOST, WARN,                                                                               \
      "tags not detected at candidate {index:candidate} after {got:count} search positions",                 \
      "None: the candidate is skipped.")                                                                     \
    X(65, CAL_SERVO_LIMIT, WARN,                                                                             \
      "servo stopped at candidate {index:candidate} after {got:count} steps, {want:mm} from its goal",       \
      "None: the pose is measured where the arm stands.")                                                    \
    X(66, CAL_CAND_SKIPPED, WARN, "candidate {index:candidate} skipped for the rest of this calibration",    \
      "None: another one is chosen. The event before says why.")                                             \
    X(67, CAL_NO_CANDIDATE, ERROR, "no usable candidate left",                                               \
      "If poses are missing, uplink a SPACE table with more candidates.")                                    \
    X(68, CAL_NO_PATH, ERROR,                                                                                \
      "no verified path to {index:candidate_or_any}: nearest node is {got:number} servo bounds away, "       \
      "allowed {want:number}",                                                                               \
      "Bring the arm to the park pose, then START again.")                                                   \
    X(69, CAL_OUTLIER, WARN, "pose {index:pose} rejected as an outlier",                                     \
      "None if rare; otherwise diagnose the log (kincal model diagnose).")                                   \
    X(70, CAL_RANK, WARN, "data determine {got:count} of {want:count} coefficients; the others are held",    \
      "Ask for more poses, or for fewer coefficients.")                                                      \
    X(71, CAL_HELD, WARN, "coefficient {index:coefficient} cannot be determined, held at {got:number}",      \
      "See CAL_RANK.")                                                                                       \
    X(72, CAL_EST, WARN, "estimator did not finish: {got:status}",                                           \
      "None if rare: the correction before stays in use. Otherwise check the TERMS bounds.")                 \
    X(73, CAL_BUDGET, WARN, "time budget of {want:s} used up after {got:s}",                                 \
      "None: what was measured is used.")                                                                    \
    X(74, CAL_CONVERGED, INFO,                                                                               \
      "predicted error of the tool position {got:mm} meets the requirement of {want:mm}", "")                \
    X(75, CAL_ABORTED, WARN, "arm held, {index:stopped}: {got:cause}",                                       \
      "Remove the cause. START begins a new calibration from SAFE.")                                         \
    X(76, CAL_POOR, ERROR, "fit is poor: probability {got:number}, noise {want:number} times as stated",     \
      "Do not approve. Diagnose the log (kincal model diagnose): the model lacks an effect, or the noise "   \
      "is understated.")                                                                                     \
    X(77, CAL_ENERGY, WARN, "energy budget of {want:J} used up: {got:J}",                                    \
      "None: what was measured is used.")                                                                    \
    X(78, CAL_MODEL_MISMATCH, ERROR,                                                                         \
      "pose {index:pose} is {got:mm}, {want:mrad} from the best correction within its bounds",               \
      "Do not move the arm on. Its errors exceed the bounds of TERMS, or the model lacks an effect: "        \
      "diagnose the log, then verify a SPACE table for wider bounds.")                                       \
    X(79, CAL_TAGS_NOT_DETECTED, ERROR,                                                                      \
      "tags detected at {got:count} of {want:count} local initial poses, at least a third is needed",        \
      "Do not move the arm on. Check camera, lighting and tags; then uplink other local initial poses.")     \
    X(80, COR_PROPOSED, INFO, "correction CRC {got:crc} proposed from {want:count} poses",                   \
      "Review it: APPROVE_ARM and APPROVE_GO, or REJECT.")                                                   \
    X(81, COR_NO_CHANGE, INFO,                                                                               \
      "no change needed: the probability of a correction this large is {got:number} if the active one "      \
      "is right",                                                                                            \
      "")                                                                                                    \
    X(82, COR_ARMED, INFO, "approval of correction CRC {got:crc} armed",                                     \
      "Send APPROVE_GO within approval_timeout_us of CONFIG.")                                               \
    X(83, COR_ACTIVE, INFO, "correction CRC {got:crc} active", "")                                           \
    X(84, COR_REJECTED, INFO, "correction CRC {got:crc} rejected", "")                                       \
    X(85, COR_ROLLBACK, INFO, "rolled back to correction CRC {got:crc}", "")                                 \
    X(86, COR_ON_BOARD, INFO, "correction CRC {got:crc} accepted on board by the policy of CONFIG", "")      \
    X(87, COR_NO_PREVIOUS, ERROR, "command refused: no previous correction to roll back to",                 \
      "Uplink the KIN table that shall be active.")                                                          \
    X(88, COR_EXPIRED, WARN,                                                                                 \
      "approval of correction CRC {got:crc} expired; the correction still waits for review",                 \
      "Send APPROVE_ARM and APPROVE_GO again.")                                                              \
    X(89, GRD_LIMIT, WARN,                                                                                   \
      "move refused: joint {index:joint} would go to {got:joint_value}, limit {want:joint_value}",           \
      "None if rare: the candidate is skipped.")                                                             \
    X(90, STORE_FAIL, ERROR, "{index:store} could not be stored ({got:status})",                             \
      "None at first: flight tries again. If it repeats, check free space and health of the store. Until "   \
      "it succeeds, a power cut loses this data.")                                                           \
    X(91, GRD_PATH, WARN,                                                                                    \
      "move refused: joint {index:joint} would be {got:joint_value} beyond the verified {want:joint_value}", \
      "None if rare: the candidate is skipped. Joint 0: no verified segment joins the two nodes.")           \
    X(92, GRD_VOLUME, WARN,                                                                                  \
      "move refused: body {index:body} would be {got:mm} inside keep-out volume {want:volume} (negative: "   \
      "too near)",                                                                                           \
      "None if rare: the candidate is skipped. If all moves are refused, look at the arm before the next "   \
      "START.")                                                                                              \
    X(93, GRD_SELF, WARN,                                                                                    \
      "move refused: body {index:body} would be {got:mm} inside body {want:body} (negative: too near)",      \
      "As GRD_VOLUME.")                                                                                      \
    X(95, MON_SUSPECT, WARN,                                                                                 \
      "joint {index:joint} appears to be off by {got:joint_value}; joints that explain it as well: "         \
      "{want:joints}",                                                                                       \
      "Take observations at other postures if several joints are named; then START limited to them.")        \
    X(96, MON_UNEXPLAINED, WARN,                                                                             \
      "tool is {got:mm}, {want:mrad} from its prediction; no single joint explains it",                      \
      "START with all coefficients.")                                                                        \
    X(97, MON_NOT_AT_REST, DEBUG,                                                                            \
      "detection of frame {got:count} not compared: arm or pan-tilt unit had not settled", "")               \
    X(98, CAL_OUTLIER_ACCEPTED, INFO, "pose {index:pose} fits again: no longer rejected as an outlier", "")  \
    X(99, STORE_REFUSED, ERROR,                                                                              \
      "the change is refused: {index:store} could not be stored in {want:count} tries ({got:status})",       \
      "What was in force remains, and a correction that waited still waits. Repair the store, then send "    \
      "the command again (a correction: APPROVE_ARM and APPROVE_GO). Until then do not switch off.")         \
    X(100, COR_POOR, ERROR,                                                                                  \
      "approval of correction CRC {got:crc} refused: its fit is poor, and the command has no override",      \
      "REJECT it, and diagnose the log (kincal model diagnose). To fly it all the same: APPROVE_ARM with "   \
      "arg_i[1] = 1.")                                                                                       \
    X(101, COR_NO_VERDICT, ERROR,                                                                            \
      "approval of correction CRC {got:crc} refused: its verdict was lost with the journal, and the "        \
      "command has no override",                                                                             \
      "Read the verdict in its log. If it was CHANGE: APPROVE_ARM with arg_i[1] = 1; else REJECT.")          \
    X(102, COR_OVERRIDE, WARN,                                                                               \
      "override: approval of correction CRC {got:crc} proceeds although its fit is poor or unknown",         \
      "If nobody decided this: REJECT it at once, or ROLLBACK after APPROVE_GO.")                            \
    X(110, TBL_TERMS_WIDE, ERROR,                                                                            \
      "TERMS refused: with its coefficient {index:count} (from 0) the arm may be off by {got:number} (rad "  \
      "or m) at one place; the active SPACE was verified for {want:number} there",                           \
      "Build TERMS with bounds inside those of SPACE and a tenth; or activate a SPACE verified for more "    \
      "first.")                                                                                              \
    X(111, TBL_SPACE_NARROW, ERROR,                                                                          \
      "SPACE refused: with coefficient {index:coefficient} of the active TERMS the arm may be off by "       \
      "{got:number} (rad or m) at one place; this SPACE was verified for {want:number} there",               \
      "Activate TERMS with bounds inside those of this SPACE and a tenth first; or verify it for more.")     \
    X(130, BOOT_NO_JOURNAL, INFO,                                                                            \
      "no journal in the store: signed messages made before this start are refused",                         \
      "None at the very first start. Otherwise the store was lost: check which tables are in force.")        \
    X(131, BOOT_JOURNAL_LOST, ERROR,                                                                         \
      "no copy of the journal can be read: signed messages made before this start are refused",              \
      "Check which correction is in force. If flight's clock may have been wrong, change the key as well.")  \
    X(132, CMD_OLD, ERROR,                                                                                   \
      "message from {index:source} refused: made {got:before_now}, allowed {want:s} before or after",        \
      "Send it again, stamped with the time of flight's newest housekeeping; compare both clocks.")          \
    X(133, CMD_BEFORE, ERROR,                                                                                \
      "message from {index:source} refused: made at {got:time}; flight accepts messages of this key only "   \
      "from {want:time} on",                                                                                 \
      "An old recording: made before the journal was lost or before flight knew this key. If you sent it "   \
      "just now, send it again.")                                                                            \
    X(134, CMD_COUNTER, ERROR,                                                                               \
      "message from {index:source} refused: its counter {got:count} is too large, largest allowed "          \
      "{want:count}",                                                                                        \
      "The sender's counter file is damaged: delete FILE.count*; it then starts from the clock.")            \
    X(135, CHANGE_FAILED, ERROR,                                                                             \
      "{index:store} was stored but could not be activated ({got:status}); nothing has changed",             \
      "Its copy in memory is damaged. Upload it again; if that fails too, restart flight.")                  \
    X(136, CMD_ABORTED, ERROR, "command {index:command} refused: ABORT arrived in the same step",            \
      "None if ABORT is what you want. Otherwise send it again.")                                            \
    X(137, ARM_NOT_HELD, ERROR,                                                                              \
      "the arm still moves to flight's last target {got:s} after flight commanded hold",                     \
      "Stop it at its controller. Find out why KC_ARM_CMD does not reach it or is ignored.")                 \
    X(140, CAL_LEAVES_PARK, INFO,                                                                            \
      "the arm leaves the park pose after {index:count} local initial poses: an arm outside its bounds "     \
      "would have shown with probability {got:number}; tool known to {want:mm} at the next pose",            \
      "")                                                                                                    \
    X(141, CAL_DOUBT, WARN,                                                                                  \
      "the first {index:count} observations have probability {got:number}, required {want:number}: the "     \
      "calibration begins again, with all local initial poses",                                              \
      "None: CAL_MODEL_MISMATCH follows if no correction within its bounds explains them.")                  \
    X(142, CAL_UNREACHABLE, WARN,                                                                            \
      "the stated errors of the camera chain alone leave the tool uncertain by {got:mm/mrad}, required "     \
      "{want:mm/mrad}",                                                                                      \
      "The calibration goes on. Measure tags and camera better, or require less.")                           \
    X(143, CAL_NEWEST_REJECTED, WARN,                                                                        \
      "pose {index:pose} would be the last one and is rejected as an outlier: one more is measured",         \
      "None: the next poses show whether the arm has changed (CAL_CHANGED).")                                \
    X(144, CAL_CHANGED, ERROR,                                                                               \
      "the newest pose, {index:pose}, is rejected as an outlier: the arm or its camera may have changed "    \
      "during the calibration",                                                                              \
      "Reject the correction, find out what moved or slipped, and calibrate again.")                         \
    X(145, TIME_SLOW, WARN, "mission clock is {got:s} behind the steps of the process, 100 ms each",         \
      "Check the clock source. Elapsed time was corrected; messages are refused while clocks disagree.")     \
    X(150, CAL_EXTRA_OUTLIER, WARN,                                                                          \
      "observation {got:count}, on the way to pose {index:pose}, rejected as an outlier",                    \
      "None if rare; otherwise diagnose the log (kincal model diagnose).")                                   \
    X(151, CAL_EXTRA_OUTLIER_ACCEPTED, INFO,                                                                 \
      "observation {got:count}, on the way to pose {index:pose}, fits again: no longer rejected", "")        \
    X(170, MON_SEVERAL, WARN,                                                                                \
      "joints {got:joints} appear to be off together, joint {index:joint} most certainly; joints that may "  \
      "be meant: {want:joints}",                                                                             \
      "START with the suspects of the monitor (docs/STATES.md).")                                            \
    X(171, CAL_NO_SUSPECTS, ERROR,                                                                           \
      "START refused: the monitor names no joint whose encoder offset would be estimated, or a START since " \
      "has used it (named: {got:joints})",                                                                   \
      "START without suspects, or take observations until MON_SUSPECT or MON_SEVERAL.")                      \
    X(172, CAL_SUSPECTS, INFO,                                                                               \
      "the calibration starts from what the monitor suspects: joints {got:joints}; that may be meant: "      \
      "{want:joints}",                                                                                       \
      "")                                                                                                    \
    X(173, CAL_SUSPECTS_DROPPED, WARN,                                                                       \
      "after {index:count} poses the suspicion alone does not explain the observations (p = {got:number}, "  \
      "at least {want:number}); the calibration goes on as without it",                                      \
      "None: it takes as many poses as without suspects. Something else than the monitor named is wrong.")   \
    X(176, CAL_AGREES, INFO,                                                                                 \
      "after pose {index:count} the arm agrees with its table, probability {got:number}; an error of one "   \
      "coefficient as large as required would have shown with probability {want:number}",                    \
      "")                                                                                                    \
    X(177, CAL_DISAGREES, INFO,                                                                              \
      "after pose {index:count} the arm does not agree with its table, probability {got:number}, level "     \
      "{want:number}: the calibration goes on",                                                              \
      "")                                                                                                    \
    X(178, CAL_CHAIN_LIMIT, WARN,                                                                            \
      "at the measured poses the camera chain alone leaves the tool uncertain by {got:mm/mrad}, "            \
      "required {want:mm/mrad}",                                                                             \
      "The bound in the proposal says how good it is. Measure tags and camera better, or require less.")     \
    X(182, CMD_SAME_KEY, ERROR,                                                                              \
      "command {index:command} by key {got:count} refused: the step before it was signed by key "            \
      "{want:count}, of the same holder",                                                                    \
      "CONFIG asks for a second person: who holds a key of other hundreds sends it, with his own key file. " \
      "A correction can be rejected by anybody with a key.")                                                 \
    X(183, KEYS_ONE_HOLDER, ERROR,                                                                           \
      "no correction can be approved: CONFIG asks for two holders of keys, all {got:count} keys of flight "  \
      "belong to one",                                                                                       \
      "Start flight with the keys of both holders (kincal key join), or uplink a CONFIG with "               \
      "go_by_other_key = 0.")                                                                                \
    X(184, COR_OTHER_KEY, INFO,                                                                              \
      "approval armed by key {got:count}: APPROVE_GO has to come from another holder within {want:s}",       \
      "A second person with a key file of his own gives APPROVE_GO.")

#define KC_EVENT_ENUM_(id, name, sev, text, action) KC_EVT_##name = (id),
typedef enum { KC_EVENT_LIST(KC_EVENT_ENUM_) KC_EVT_NONE = 0 } kc_event_id_t;

/* Why a calibration was stopped (CAL_ABORTED). X(number, NAME, "text") */
#define KC_CAUSE_LIST(X)                                                                              \
    X(0, COMMAND, "command ABORT")                                                                    \
    X(1, ARM_FAULT, "the arm controller reports a fault")                                             \
    X(2, ARM_LATE, "the arm did not reach its target in time, or did not come to rest")               \
    X(3, PANTILT_LATE, "the pan-tilt unit did not reach its target in time, or did not come to rest") \
    X(4, CAMERA, "no frame in spite of all retries")                                                  \
    X(5, NO_CANDIDATE, "no usable candidate left before enough was measured")                         \
    X(6, NO_PATH, "no verified path begins where the arm stands")                                     \
    X(7, BUDGET, "time or energy used up before enough was measured")                                 \
    X(8, SILENT, "no state messages from the arm or the pan-tilt unit")                               \
    X(9, MODEL_MISMATCH, "no correction within its bounds explains the observations")                 \
    X(10, TAGS_NOT_DETECTED, "tags detected at fewer than a third of the local initial poses")        \
    X(11, MEMORY, "tables or observations have changed in memory")

#define KC_CAUSE_ENUM_(number, name, text) KC_CAUSE_##name = (number),
typedef enum { KC_CAUSE_LIST(KC_CAUSE_ENUM_) KC_CAUSE_COUNT = KC_CAUSE_MEMORY + 1 } kc_cause_t;

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
void kc_event(kc_events_t *events, kc_event_id_t id, int32_t index, double got, double want);

/* The dictionary. An unknown id: "UNKNOWN", "", "", KC_SEV_ERROR; never NULL. */
const char *kc_event_name(uint16_t id);
const char *kc_event_text(uint16_t id);
const char *kc_event_action(uint16_t id);
kc_severity_t kc_event_severity(uint16_t id);
/* "" for a number that is no kc_cause_t; never NULL. */
const char *kc_cause_text(int32_t cause);

#endif
