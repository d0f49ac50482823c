"""Made by ground/message_stubs.py from fsw/msg; do not edit. Types of the LCM messages for mypy."""

from typing import Protocol

class LcmMessage(Protocol):
    """Any message."""

    def encode(self) -> bytes: ...

class Ack(LcmMessage, Protocol):
    """ack_t"""

    t_us: int
    source: int
    seq: int
    opcode: int
    status: int
    event_id: int

class ArmCmd(LcmMessage, Protocol):
    """arm_cmd_t"""

    t_us: int
    seq: int
    n_joints: int
    q_rad: list[float]
    speed_scale: float
    hold: int

class ArmState(LcmMessage, Protocol):
    """arm_state_t"""

    t_us: int
    seq: int
    n_joints: int
    q_rad: list[float]
    dq_rad_s: list[float]
    q_cmd_rad: list[float]
    dir: list[int]
    moving: int
    fault_mask: int
    temp_c: float
    payload_kg: float
    g_m_s2: list[float]

class Cmd(LcmMessage, Protocol):
    """cmd_t"""

    t_us: int
    seq: int
    source: int
    opcode: int
    arg_i: list[int]
    arg_u64: int
    arg_d: list[float]
    key_id: int
    counter: int
    mac: list[int]

class Detection(LcmMessage, Protocol):
    """detection_t"""

    t_us: int
    seq: int
    n_tags: int
    tag_id: list[int]
    p_cam_tool_m: list[float]
    q_cam_tool_wxyz: list[float]
    cov: list[float]
    p_alt_m: list[float]
    q_alt_wxyz: list[float]
    rms_px: float
    rms_alt_px: float
    range_m: float
    incid_rad: float
    u_px: float
    v_px: float
    corner_px: list[float]

class Event(LcmMessage, Protocol):
    """event_t"""

    t_us: int
    seq: int
    id: int
    severity: int
    got: float
    want: float
    index: int

class FrameRequest(LcmMessage, Protocol):
    """frame_request_t"""

    t_us: int
    seq: int

class Hk(LcmMessage, Protocol):
    """hk_t"""

    t_us: int
    seq: int
    state: int
    session: int
    n_poses: int
    n_poses_goal: int
    candidate: int
    servo_steps: int
    n_meas: int
    n_rejected: int
    n_cmd_ok: int
    n_cmd_refused: int
    n_events: int
    n_events_dropped: int
    last_event_id: int
    n_tx_errors: int
    n_rx_errors: int
    table_crc: list[int]
    staged_kind: int
    staged_bytes: int
    staged_state: int
    boot_state: int
    boot_pose: int
    boot_count: int
    proposal_crc: int
    energy_j: float
    mon_state: int
    mon_joint: int
    mon_suspects: int
    mon_n_obs: int
    mon_bias: float
    mon_sigma: float
    mon_p: float
    proposal_verdict: int
    approval_left_us: int

class Image(LcmMessage, Protocol):
    """image_t"""

    t_us: int
    seq: int
    width_px: int
    height_px: int
    n_bytes: int
    jpeg: bytes

class Meas(LcmMessage, Protocol):
    """meas_t"""

    t_us: int
    session: int
    pose: int
    candidate: int
    replicate: int
    n_joints: int
    q_rad: list[float]
    q_cmd_rad: list[float]
    dq_rad_s: list[float]
    dir: list[int]
    temp_c: float
    payload_kg: float
    g_m_s2: list[float]
    p_m: list[float]
    q_wxyz: list[float]
    cov: list[float]
    p_cam_m: list[float]
    q_cam_wxyz: list[float]
    pan_rad: float
    tilt_rad: float
    p_cam_tool_m: list[float]
    q_cam_tool_wxyz: list[float]
    n_frames: int
    n_tags: int
    tag_id: list[int]
    p_alt_m: list[float]
    q_alt_wxyz: list[float]
    range_m: float
    incid_rad: float
    u_px: float
    v_px: float
    rms_px: float
    corner_px: list[float]
    crc_arm: int
    crc_camera: int
    crc_terms: int
    crc_kin: int

class PantiltCmd(LcmMessage, Protocol):
    """pantilt_cmd_t"""

    t_us: int
    seq: int
    pan_rad: float
    tilt_rad: float

class PantiltState(LcmMessage, Protocol):
    """pantilt_state_t"""

    t_us: int
    seq: int
    pan_rad: float
    tilt_rad: float
    moving: int

class Progress(LcmMessage, Protocol):
    """progress_t"""

    t_us: int
    session: int
    pose: int
    n_goal: int
    candidate: int
    replicate: int
    servo_steps: int
    acquisition: int
    acquisition_value: float
    res_pos_m: float
    res_rot_rad: float
    f: float
    gp_mean: float
    gp_sigma: float
    pred_pos_m: float
    pred_rot_rad: float
    rank: int
    n_free: int
    dof: int
    chi2: float
    est_status: int
    fit_pos_m: float
    fit_rot_rad: float
    energy_j: float
    coef: list[float]

class Proposal(LcmMessage, Protocol):
    """proposal_t"""

    t_us: int
    session: int
    crc: int
    verdict: int
    n_poses: int
    n_outliers: int
    n_coef: int
    value: list[float]
    sigma: list[float]
    status: list[int]
    confounded: list[int]
    cov: list[float]
    rank: int
    n_free: int
    dof: int
    chi2: float
    noise_scale: float
    p_fit: float
    p_no_change: float
    kkt: float
    cond: float
    fit_pos_m: float
    fit_rot_rad: float
    before_pos_m: float
    before_rot_rad: float
    pred_pos_m: float
    pred_rot_rad: float
    crc_arm: int
    crc_terms: int
    crc_kin_before: int
    frame: int
    pred_noise_pos_m: float
    pred_noise_rot_rad: float
    pred_camera_pos_m: float
    pred_camera_rot_rad: float
    pred_lander_pos_m: float
    pred_lander_rot_rad: float

class SimTruth(LcmMessage, Protocol):
    """sim_truth_t"""

    t_us: int
    n_joints: int
    q_true_rad: list[float]
    p_m: list[float]
    q_wxyz: list[float]

class TableChunk(LcmMessage, Protocol):
    """table_chunk_t"""

    t_us: int
    source: int
    kind: int
    total_bytes: int
    offset: int
    n: int
    data: bytes
    key_id: int
    counter: int
    mac: list[int]

class TickDone(LcmMessage, Protocol):
    """tick_done_t"""

    tick: int
    who: int
    n_published: int

class Time(LcmMessage, Protocol):
    """time_t"""

    tick: int
    now_us: int
