/* What a basis may depend on: the one list of variables (METHOD.md 9).
 *
 * Enumeration, values, index limits, what has to be computed first, and ranges are made from it, and by `make stubs`
 * the names and units that people write (ground/kincal_shared/schema/variables.csv). Numbers go into tables and never
 * change meaning. */
#ifndef KC_VARIABLES_H
#define KC_VARIABLES_H

#include <stdint.h>

/* Index of a variable. */
typedef enum {
    KC_INDEX_NONE = 0,   /* 0 */
    KC_INDEX_JOINT = 1,  /* joint 1 .. n */
    KC_INDEX_LINK = 2,   /* link 0 .. n, 0: the whole arm about frame 0 */
    KC_INDEX_LEVER = 3,  /* KC_LEVER_INDEX(link, body) */
    KC_INDEX_COLUMN = 4, /* column 1 .. KC_PNP_MAX of a PnP pose */
    KC_INDEX_MOVE = 5    /* joint 1 .. KC_MOVE_MAX */
} kc_var_index_t;

/* What a variable is computed from. POINTS: twist of a PnP pose per unit of a fault of camera or target; the ground
 * computes it for targets of many points, flight's tables hold none. */
typedef enum {
    KC_FROM_RECORD = 0, /* read or measured with the pose: stays whatever the coefficients are */
    KC_FROM_LOADS = 1, /* gravity on the arm (kc_loads_t) */
    KC_FROM_VIEW = 2, /* where the tool is in the camera frame: on the ground, where the model expects it */
    KC_FROM_POINTS = 3
} kc_var_from_t;

/* X(number, NAME, INDEX, FROM, "name people write", "unit", "meaning", range, value)
 * INDEX, FROM: KC_INDEX_*, KC_FROM_*. range: what the variable can be on board, an expression of kc_bounds.c in arm and
 * b, the kc_basis_t; unbounded() if that is not known: flight then refuses uplinked terms of it. value: an expression
 * of kc_basis.c in ctx, loads and b; finite for finite input and any index. */
#define KC_VAR_LIST(X)                                                                                      \
    X(1, Q, JOINT, RECORD, "q", "rad or m", "encoder reading",                                              \
      between(joint_of(arm, b)->q_min, joint_of(arm, b)->q_max), of_joint(ctx->q, b->index))                \
    X(2, TAU, JOINT, LOADS, "tau", "N m", "gravity torque about joint; force [N] of a prismatic one",       \
      within(torque(arm, b->index, false)), of_joint(loads->tau, b->index))                                 \
    X(3, MX, LINK, LOADS, "Mx", "N m", "gravity moment at link, about x of its frame",                      \
      within(moment(arm, b->index)), of_moment(loads, b->index, 0u))                                        \
    X(4, MY, LINK, LOADS, "My", "N m", "gravity moment at link, about y", within(moment(arm, b->index)),    \
      of_moment(loads, b->index, 1u))                                                                       \
    X(5, MZ, LINK, LOADS, "Mz", "N m", "gravity moment at link, about z", within(moment(arm, b->index)),    \
      of_moment(loads, b->index, 2u))                                                                       \
    X(6, DIR, JOINT, RECORD, "dir", "-1, 0, 1", "sign of the last motion of each joint", within(1.0),       \
      of_joint(ctx->dir, b->index))                                                                         \
    X(7, TEMP, NONE, RECORD, "temp", "deg C", "temperature of the arm",                                     \
      between(KC_BOUNDS_TEMP_MIN_C, KC_BOUNDS_TEMP_MAX_C), ctx->temp_c)                                     \
    X(8, T, NONE, RECORD, "t", "s", "time, as in the measurements",                                         \
      between(b->c0 - KC_BOUNDS_TIME_S, b->c0 + KC_BOUNDS_TIME_S), ctx->t_s)                                \
    X(9, PAYLOAD, NONE, RECORD, "payload", "kg", "extra mass at the tool",                                  \
      between(0.0, KC_BOUNDS_PAYLOAD_KG), ctx->payload_kg)                                                  \
    X(10, RANGE, NONE, RECORD, "range", "m", "range from camera to target",                                 \
      between(0.0, KC_BOUNDS_DISTANCE_M), ctx->range_m)                                                     \
    X(11, INCID, NONE, RECORD, "incid", "rad", "angle of incidence at the target",                          \
      between(0.0, 0.5 * KC_PI), ctx->incid_rad)                                                            \
    X(12, U, NONE, VIEW, "u", "1", "image position, normalised: (u - cx)/fx", within(1.0), ctx->u_norm)     \
    X(13, V, NONE, VIEW, "v", "1", "image position, normalised: (v - cy)/fy", within(1.0), ctx->v_norm)     \
    X(14, R2, NONE, VIEW, "r2", "1", "u^2 + v^2, normalised", between(0.0, 2.0),                            \
      ctx->u_norm * ctx->u_norm + ctx->v_norm * ctx->v_norm)                                                \
    X(15, PAN, NONE, RECORD, "pan", "rad", "pan encoder of the camera", within(KC_PI), ctx->pan_rad)        \
    X(16, TILT, NONE, RECORD, "tilt", "rad", "tilt encoder of the camera", within(KC_PI), ctx->tilt_rad)    \
    X(17, QDOT, JOINT, RECORD, "qdot", "rad/s or m/s", "joint speed", within(joint_of(arm, b)->speed_max),  \
      of_joint(ctx->qdot, b->index))                                                                        \
    X(18, TAU_PAYLOAD, JOINT, LOADS, "taup", "N m",                                                         \
      "gravity torque about joint of 1 kg at the tool, times payload_kg",                                   \
      within(torque(arm, b->index, true)), of_joint(loads->tau_payload, b->index))                          \
    X(19, XCAM, NONE, VIEW, "xcam", "m", "measured tool position in the camera frame, x",                   \
      within(KC_BOUNDS_DISTANCE_M), ctx->p_cam_tool_m[0])                                                   \
    X(20, YCAM, NONE, VIEW, "ycam", "m", "measured tool position in the camera frame, y",                   \
      within(KC_BOUNDS_DISTANCE_M), ctx->p_cam_tool_m[1])                                                   \
    X(21, ZCAM, NONE, VIEW, "zcam", "m", "measured tool position in the camera frame, z",                   \
      within(KC_BOUNDS_DISTANCE_M), ctx->p_cam_tool_m[2])                                                   \
    X(22, TAG, NONE, RECORD, "tag", "0, 0.5, 1", "target seen: first, both, second", within(1.0), ctx->tag) \
    X(23, GX, LINK, LOADS, "gx", "m/s^2", "gravity in the frame of a link, x", within(gravity(arm)),        \
      of_gravity(loads, b->index, 0u))                                                                      \
    X(24, GY, LINK, LOADS, "gy", "m/s^2", "gravity in the frame of a link, y", within(gravity(arm)),        \
      of_gravity(loads, b->index, 1u))                                                                      \
    X(25, GZ, LINK, LOADS, "gz", "m/s^2", "gravity in the frame of a link, z", within(gravity(arm)),        \
      of_gravity(loads, b->index, 2u))                                                                      \
    X(26, LEVX, LEVER, LOADS, "levx", "N m/kg",                                                             \
      "gravity lever: moment of 1 kg at a body's origin about the origin of a link's frame, about x",       \
      within(lever(arm, b->index)), of_lever(loads, b->index, 0u))                                          \
    X(27, LEVY, LEVER, LOADS, "levy", "N m/kg", "gravity lever, about y", within(lever(arm, b->index)),     \
      of_lever(loads, b->index, 1u))                                                                        \
    X(28, LEVZ, LEVER, LOADS, "levz", "N m/kg", "gravity lever, about z", within(lever(arm, b->index)),     \
      of_lever(loads, b->index, 2u))                                                                        \
    X(29, PNP_TX, COLUMN, POINTS, "ptx", "m or rad", "column of a PnP pose, shift along x", unbounded(),    \
      of_pnp(ctx, 0u, b->index))                                                                            \
    X(30, PNP_TY, COLUMN, POINTS, "pty", "m or rad", "column of a PnP pose, shift along y", unbounded(),    \
      of_pnp(ctx, 1u, b->index))                                                                            \
    X(31, PNP_TZ, COLUMN, POINTS, "ptz", "m or rad", "column of a PnP pose, shift along z", unbounded(),    \
      of_pnp(ctx, 2u, b->index))                                                                            \
    X(32, PNP_RX, COLUMN, POINTS, "prx", "m or rad", "column of a PnP pose, turn about x", unbounded(),     \
      of_pnp(ctx, 3u, b->index))                                                                            \
    X(33, PNP_RY, COLUMN, POINTS, "pry", "m or rad", "column of a PnP pose, turn about y", unbounded(),     \
      of_pnp(ctx, 4u, b->index))                                                                            \
    X(34, PNP_RZ, COLUMN, POINTS, "prz", "m or rad", "column of a PnP pose, turn about z", unbounded(),     \
      of_pnp(ctx, 5u, b->index))                                                                            \
    X(35, MOVE, MOVE, RECORD, "move", "rad or m",                                                           \
      "change of each joint since the pose before; 0 for an arm that waited until it was at rest",          \
      unbounded(), of_move(ctx, b->index))

#define KC_VAR_ENUM_(number, NAME, index, from, name, unit, meaning, range, value) KC_VAR_##NAME = (number),
/* ONE is no variable: the basis is 1 whatever its function is. */
typedef enum { KC_VAR_ONE = 0, KC_VAR_LIST(KC_VAR_ENUM_) KC_VAR_COUNT = KC_VAR_MOVE + 1 } kc_var_t;

/* Index of a gravity lever: link 0 .. n-1 (its z axis is that of joint link + 1), and a body beyond it: link
 * body = link + 1 .. n (at most 15), or KC_LEVER_TOOL. */
#define KC_LEVER_TOOL 0u
#define KC_LEVER_INDEX(link, body) (16u * (link) + (body))
#define KC_LEVER_LINK(index) ((uint32_t)(index) / 16u)
#define KC_LEVER_BODY(index) ((uint32_t)(index) % 16u)

/* What the list says of a variable; of a number that is none, KC_INDEX_NONE and KC_FROM_RECORD. */
kc_var_index_t kc_var_index(uint32_t var);
kc_var_from_t kc_var_from(uint32_t var);

#endif
