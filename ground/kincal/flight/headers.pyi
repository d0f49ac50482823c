"""Made by ground/stubs.py from the public headers; do not edit. Types of the core for mypy."""

from collections.abc import Iterable, Iterator
from typing import Literal, Protocol, TypeAlias, TypeVar, overload

from cffi import FFI

CData: TypeAlias = FFI.CData
_T = TypeVar("_T")

class Array(Protocol[_T]):
    """Array field of a struct."""

    def __len__(self) -> int: ...
    def __iter__(self) -> Iterator[_T]: ...
    @overload
    def __getitem__(self, index: int) -> _T: ...
    @overload
    def __getitem__(self, index: slice) -> Array[_T]: ...
    @overload
    def __setitem__(self, index: int, value: _T) -> None: ...
    @overload
    def __setitem__(self, index: slice, value: Iterable[_T]) -> None: ...

class KcAck(Protocol):
    """kc_ack_t"""

    source: int
    seq: int
    opcode: int
    status: int
    event_id: int

class KcAcqWork(Protocol):
    """kc_acq_work_t"""

    M: Array[float]
    S: Array[float]
    J: Array[Array[float]]
    prior: Array[float]
    idx: Array[int]
    n: int
    eval: KcEval
    phase: int
    i: int
    kind: int
    W: Array[float]
    len_m: float
    total: float
    status: int
    best: int
    value: float

class KcActive(Protocol):
    """kc_active_t"""

    crc: Array[int]
    arm: KcArm
    camera: KcCamera
    terms: KcTerms
    kin: KcKin
    kin_prev: KcKin
    kin_prev_crc: int
    space: KcSpace
    kernel: KcKernel
    config: KcConfig
    seal: Array[int]

class KcAnswer(Protocol):
    """kc_answer_t"""

    status: int
    event: int
    outcome: KcOutcome

class KcApp(Protocol):
    """kc_app_t"""

    view: KcView
    arena: KcArena
    tables: KcTables
    clock: KcClock
    place: KcPlace
    input: KcInput
    cmd_log: KcCmdLog
    dump: KcDump
    cal: KcCal
    plan: KcPlan
    learned: KcLearned
    est: KcEst
    proposing: KcProposing
    rng: int
    move: KcMove
    pantilt: KcPantilt
    rest: KcRest
    request: KcRequest
    observe: KcObserve
    q_meas: Array[float]
    frames: KcFrames
    review: KcReview
    monitoring: KcMonitoring
    hk: KcHkState
    journal: KcJournalStore
    change: KcChange
    scrub: KcScrub
    boot_events: KcEvents
    boot_count: int
    loaded: int
    n_other: int
    boot_state: int
    boot_pose: int
    kept: bool
    n_rx_errors: int
    stepped: bool

class KcArenaCalibration(Protocol):
    """kc_arena_calibration_t"""

    gp: KcGp
    cand_pt: Array[KcPoint]
    cand_q: Array[float]
    choice: KcChoice
    acq: KcAcqWork

class KcArenaIdle(Protocol):
    """kc_arena_idle_t"""

    staged: Array[int]
    scratch: KcTblScratch
    monitor: KcMonitor
    images: KcJournalImages

class KcArena(Protocol):
    """kc_arena_t"""

    calibration: KcArenaCalibration
    proposal: KcConsider
    idle: KcArenaIdle

class KcArmCmd(Protocol):
    """kc_arm_cmd_t"""

    seq: int
    n_joints: int
    speed_scale: float
    hold: int
    q: Array[float]

class KcArmState(Protocol):
    """kc_arm_state_t"""

    t_us: int
    seq: int
    n_joints: int
    temp_c: float
    payload_kg: float
    g_m_s2: Array[float]
    q: Array[float]
    dq: Array[float]
    q_cmd: Array[float]
    dir: Array[float]
    moving: int
    fault_mask: int

class KcArm(Protocol):
    """kc_arm_t"""

    name: CData | bytes
    n_joints: int
    joint: Array[KcJoint]
    base_xyz_m: Array[float]
    base_quat_wxyz: Array[float]
    tool_xyz_m: Array[float]
    tool_quat_wxyz: Array[float]
    gravity_m_s2: Array[float]

class KcAuthKnown(Protocol):
    """kc_auth_known_t"""

    last: int
    since_us: int
    clock_us: int
    age_max_us: int

class KcAuth(Protocol):
    """kc_auth_t"""

    key_id: int
    counter: int
    mac: Array[int]

class KcAuthText(Protocol):
    """kc_auth_text_t"""

    head: CData
    body: CData
    n_head: int
    n_body: int

class KcBasis(Protocol):
    """kc_basis_t"""

    fn: int
    var: int
    index: int
    c0: float
    c1: float

class KcBody(Protocol):
    """kc_body_t"""

    frame: int
    start_m: Array[float]
    end_m: Array[float]
    radius_m: float
    collision_pairs: int

class KcBoundsBad(Protocol):
    """kc_bounds_bad_t"""

    coef: int
    frame: int
    comp: int
    sum: float
    verified: float

class KcCal(Protocol):
    """kc_cal_t"""

    session: int
    acq: int
    start_us: int
    energy_j: float
    energy_us: int
    candidate: int
    replicate: int
    acq_value: float
    chosen_by: int

class KcCamera(Protocol):
    """kc_camera_t"""

    mast_xyz_m: Array[float]
    mast_quat_wxyz: Array[float]
    pantilt_xyz_m: Array[float]
    pantilt_quat_wxyz: Array[float]
    pan_min_rad: float
    pan_max_rad: float
    tilt_min_rad: float
    tilt_max_rad: float
    fx_px: float
    fy_px: float
    cx_px: float
    cy_px: float
    width_px: int
    height_px: int
    mast_sigma_m: float
    mast_sigma_rad: float
    zero_sigma_rad: float
    axis_sigma_rad: float
    tag_size_sigma: float
    plate_sigma_m: float
    plate_sigma_rad: float
    drift_sigma_m_s: float
    drift_sigma_rad_s: float
    n_tags: int
    tag: Array[KcTag]

class KcCand(Protocol):
    """kc_cand_t"""

    p_m: Array[float]
    q_wxyz: Array[float]
    q_seed: Array[float]
    pan_rad: float
    tilt_rad: float
    tags: int
    hub: int
    why: int

class KcChangeParts(Protocol):
    """kc_change_parts_t"""

    view: CData
    tables: CData
    review: CData
    journal: CData
    images: CData
    log: CData
    now: KcJournal

class KcChange(Protocol):
    """kc_change_t"""

    kind: int
    safe: bool
    by_command: bool
    cmd: KcCmd
    tries: int
    asked: bool
    due_us: int
    failing: bool
    made: int

class KcCheck(Protocol):
    """kc_check_t"""

    st: int
    index: int
    got: float

class KcChoice(Protocol):
    """kc_choice_t"""

    part: int
    i: int
    cand: int

class KcChunk(Protocol):
    """kc_chunk_t"""

    source: int
    kind: int
    offset: int
    n: int
    data: Array[int]
    t_us: int
    total: int
    auth: KcAuth

class KcClock(Protocol):
    """kc_clock_t"""

    now_us: int
    clock_us: int

class KcCmdLog(Protocol):
    """kc_cmd_log_t"""

    keys: KcKeys
    counters: KcCounters
    seq: Array[int]
    seen: Array[bool]
    us: Array[int]
    n_ok: int
    n_refused: int

class KcCmd(Protocol):
    """kc_cmd_t"""

    t_us: int
    seq: int
    source: int
    opcode: int
    arg_i: Array[int]
    arg_u64: int
    arg_d: Array[float]
    auth: KcAuth

class KcCoef(Protocol):
    """kc_coef_t"""

    name: CData | bytes
    lb: float
    ub: float
    prior_sigma: float
    scale: float
    enabled: int

class KcConfig(Protocol):
    """kc_config_t"""

    acquisition: int
    n_poses: int
    replicate_every: int
    beta_scale: float
    a1: float
    sp_floor_m: float
    sq_floor_rad: float
    vopt_len_m: float
    stop_pos_m: float
    stop_rot_rad: float
    frames_per_meas: int
    frame_retries: int
    settle_us: int
    frame_timeout_us: int
    move_timeout_us: int
    frame_age_max_us: int
    search_steps: int
    search_step_rad: float
    jump_pos_m: float
    jump_rot_rad: float
    sigma_pos_max_m: float
    sigma_rot_max_rad: float
    sigma_pos_min_m: float
    sigma_rot_min_rad: float
    rms_max_px: float
    servo: KcServoOpt
    servo_steps_max: int
    speed_scale: float
    arrive_tol: float
    approach_rad: float
    est: KcEstOpt
    accept_on_board: int
    accept_change_max_pos_m: float
    accept_sigma_max_pos_m: float
    accept_p_fit_min: float
    frame: int
    no_change_p: float
    budget_us: int
    power_idle_w: float
    power_move_w: float
    energy_budget_j: float
    mismatch_pos_m: float
    mismatch_rot_rad: float
    flip_rms_ratio: float
    flip_trust_rad: float
    frame_shared: float
    search_safety: float
    poses_min: int
    tags_tried_min: int
    second_start_noise_scale: float
    mismatch_noise_scale: float
    mismatch_dof_min: int
    mismatch_outliers_min: int
    poor_noise_scale: float
    poor_noise_scale_unlikely: float
    poor_p_fit: float
    store_retries: int
    store_retry_us: int
    approval_timeout_us: int
    signed_age_max_us: int

class KcConsiderPose(Protocol):
    """kc_consider_pose_t"""

    before: CData
    after: CData
    W: CData
    eval: CData
    H: CData

class KcConsider(Protocol):
    """kc_consider_t"""

    S: Array[float]
    HH: Array[float]
    A: Array[float]
    L: Array[float]
    b_before: Array[float]
    b: Array[float]
    b_after: Array[float]
    mean: Array[float]

class KcCounted(Protocol):
    """kc_counted_t"""

    key_id: int
    since_us: int
    last: Array[Array[int]]

class KcCounters(Protocol):
    """kc_counters_t"""

    key: Array[KcCounted]

class KcCtx(Protocol):
    """kc_ctx_t"""

    q: Array[float]
    dir: Array[float]
    qdot: Array[float]
    g_m_s2: Array[float]
    temp_c: float
    t_s: float
    payload_kg: float
    range_m: float
    incid_rad: float
    u_norm: float
    v_norm: float
    pan_rad: float
    tilt_rad: float
    tag: float
    p_cam_tool_m: Array[float]
    pnp: Array[Array[float]]

class KcDetection(Protocol):
    """kc_detection_t"""

    t_us: int
    seq: int
    n_tags: int
    tag_id: Array[int]
    p_cam_tool_m: Array[float]
    q_cam_tool_wxyz: Array[float]
    p_alt_m: Array[float]
    q_alt_wxyz: Array[float]
    rms_px: float
    rms_alt_px: float
    range_m: float
    incid_rad: float
    u_px: float
    v_px: float
    corner_px: Array[float]
    cov: Array[float]

class KcDhBound(Protocol):
    """kc_dh_bound_t"""

    phi_rad: float
    alpha_rad: float
    a_m: float
    d_m: float

class KcDump(Protocol):
    """kc_dump_t"""

    kind: int
    at: int
    crc: int

class KcEstJob(Protocol):
    """kc_est_job_t"""

    phase: int
    i: int
    at: CData
    requested: int
    kept: int
    status: int
    sums: KcEstSums
    n_fits: int
    iter: int
    tries: int
    n_tested: int
    worst: int
    rank_all: int
    cost: float
    largest: float
    p_worst: float

class KcEstOpt(Protocol):
    """kc_est_opt_t"""

    free_mask: int
    iter_max: int
    tol_step: float
    rank_tol: float
    outlier_p: float
    outlier_max: int
    use_prior: int

class KcEstSums(Protocol):
    """kc_est_sums_t"""

    chi2: float
    prior: float
    pos2: float
    rot2: float
    n_pos: int
    n_rot: int
    rows: int

class KcEst(Protocol):
    """kc_est_t"""

    arm: CData
    terms: CData
    opt: KcEstOpt
    n_obs: int
    hold_none: int
    without: int
    obs: Array[KcObs]
    start: Array[float]
    coef: Array[float]
    sigma: Array[float]
    status: Array[int]
    confounded: Array[int]
    outlier: Array[int]
    n_outliers: int
    rank: int
    n_free: int
    dof: int
    iters: int
    chi2: float
    cost: float
    kkt: float
    cond: float
    noise_scale: float
    fit_pos_m: float
    fit_rot_rad: float
    before_pos_m: float
    before_rot_rad: float
    cov: Array[float]
    qp: KcQp
    job: KcEstJob
    eval: KcEval
    weak: int
    n_idx: int
    idx: Array[int]
    perm: Array[int]
    R: Array[float]
    blk: Array[float]
    pivot: Array[float]
    trial: Array[float]

class KcEval(Protocol):
    """kc_eval_t"""

    T: KcPose
    twist: Array[Array[float]]
    Jq: Array[Array[float]]
    J: Array[Array[float]]

class KcEvent(Protocol):
    """kc_event_t"""

    id: int
    severity: int
    index: int
    got: float
    want: float

class KcEvents(Protocol):
    """kc_events_t"""

    n: int
    dropped: int
    e: Array[KcEvent]

class KcFitQuality(Protocol):
    """kc_fit_quality_t"""

    status: int
    noise_scale: float
    cost: float
    n_outliers: int
    nothing_held: bool

class KcFrameRequest(Protocol):
    """kc_frame_request_t"""

    seq: int

class KcFrames(Protocol):
    """kc_frames_t"""

    n: int
    first: KcPose
    dp_m: Array[float]
    dw_rad: Array[float]
    cov: Array[float]
    q: Array[float]
    dq: Array[float]
    range_m: float
    incid_rad: float
    u_px: float
    v_px: float
    rms_px: float
    rms_alt_px: float
    pan_rad: float
    tilt_rad: float
    corner_px: Array[float]
    same_tags: bool
    det: KcDetection

class KcGpChoice(Protocol):
    """kc_gp_choice_t"""

    old: int
    best: int
    h: int
    i: int
    best_ml: float

class KcGp(Protocol):
    """kc_gp_t"""

    kernel: CData
    hyper: int
    n: int
    n_cand: int
    x: Array[KcPoint]
    y: Array[float]
    L: Array[float]
    z: Array[float]
    var: Array[float]
    v: Array[Array[float]]
    choice: KcGpChoice

class KcGuardArm(Protocol):
    """kc_guard_arm_t"""

    arm: CData
    space: CData
    frame: Array[KcPose]
    along_m: Array[float]
    across_m: Array[float]

class KcGuardJob(Protocol):
    """kc_guard_job_t"""

    first: KcGuardNear
    at: KcGuardNear
    part: float
    k: int
    over: bool
    verdict: int
    why: KcGuardReason

class KcGuardNear(Protocol):
    """kc_guard_near_t"""

    d: Array[float]
    why: Array[KcGuardReason]

class KcGuardReason(Protocol):
    """kc_guard_reason_t"""

    index: int
    got: float
    want: float

class KcGuardRequest(Protocol):
    """kc_guard_request_t"""

    arm: CData
    terms: CData
    coef: CData
    space: CData
    ctx: CData
    q_from: CData
    q_to: CData
    to: int
    bound: CData
    margin: float
    tol: float

class KcHkState(Protocol):
    """kc_hk_state_t"""

    due_us: int
    seq: int
    n_meas: int
    n_events: int
    n_dropped: int
    last_event_id: int

class KcHk(Protocol):
    """kc_hk_t"""

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
    table_crc: Array[int]
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

class KcHyper(Protocol):
    """kc_hyper_t"""

    sigma_s: float
    beta_m: float
    kappa: float
    nu: float
    n_w: int
    w: Array[float]
    trunc_err: float

class KcIkOpt(Protocol):
    """kc_ik_opt_t"""

    iter_max: int
    tol_pos_m: float
    tol_rot_rad: float
    margin: float
    step_max: float

class KcIn(Protocol):
    """kc_in_t"""

    n_cmd: int
    n_chunk: int
    n_det: int
    n_rx_errors: int
    cmd: Array[KcCmd]
    chunk: Array[KcChunk]
    det: Array[KcDetection]
    has_arm: int
    has_pantilt: int
    arm: KcArmState
    pantilt: KcPantiltState
    has_store_result: int
    store_kind: int
    store_status: int

class KcInput(Protocol):
    """kc_input_t"""

    telemetry: KcTelemetry
    fault_reported: int
    n_rejected: int

class KcJoint(Protocol):
    """kc_joint_t"""

    type: int
    has_mass: int
    phi_rad: float
    alpha_rad: float
    a_m: float
    d_m: float
    q_min: float
    q_max: float
    speed_max: float
    mass_kg: float
    com_m: Array[float]
    gear_ratio: float

class KcJournalImages(Protocol):
    """kc_journal_images_t"""

    kin: Array[int]
    prev: Array[int]
    n_kin: int
    n_prev: int

class KcJournalStore(Protocol):
    """kc_journal_store_t"""

    found: KcJournal
    last: KcJournal
    again: bool
    due_us: int
    bytes: Array[int]

class KcJournal(Protocol):
    """kc_journal_t"""

    state: int
    session: int
    pose: int
    boot_count: int
    kin_crc: int
    prev_crc: int
    proposal_crc: int
    proposal_verdict: int
    candidate: int
    seg_from: int
    seg_to: int
    t_us: int
    counters: KcCounters

class KcKernel(Protocol):
    """kc_kernel_t"""

    arg: int
    n_hyper: int
    sigma_eps: float
    choose: int
    hyper: Array[KcHyper]

class KcKey(Protocol):
    """kc_key_t"""

    id: int
    secret: Array[int]

class KcKeys(Protocol):
    """kc_keys_t"""

    n: int
    key: Array[KcKey]

class KcKin(Protocol):
    """kc_kin_t"""

    n_coef: int
    value: Array[float]
    sigma: Array[float]
    arm_crc: int
    terms_crc: int
    prev_crc: int
    session: int
    n_poses: int
    made_us: int

class KcLearned(Protocol):
    """kc_learned_t"""

    status: int
    coef: Array[float]
    gp_ok: bool
    trusted: bool
    converged: bool
    res: KcMiss
    f: float
    gp_mean: float
    gp_sigma: float
    pred: KcMiss
    leave_out: KcLeaveOut
    outlier_reported: Array[int]
    y: Array[float]
    dp_m: Array[float]
    dr_rad: Array[float]
    part: int
    i: int
    first: KcFitQuality
    sum2: KcMiss

class KcLeaveOut(Protocol):
    """kc_leave_out_t"""

    trial: int
    best: int
    best_cost: float
    decided: bool

class KcLoads(Protocol):
    """kc_loads_t"""

    tau: Array[float]
    tau_payload: Array[float]
    moment: Array[Array[float]]
    origin_m: Array[Array[float]]
    g_link_m_s2: Array[Array[float]]
    g_cross_m_s2: Array[Array[Array[float]]]

class KcMeas(Protocol):
    """kc_meas_t"""

    t_us: int
    session: int
    pose: int
    candidate: int
    replicate: int
    n_joints: int
    pan_rad: float
    tilt_rad: float
    n_frames: int
    arm: KcArmState
    obs: KcObs
    det: KcDetection
    crc: Array[int]

class KcMiss(Protocol):
    """kc_miss_t"""

    pos_m: float
    rot_rad: float

class KcMonObs(Protocol):
    """kc_mon_obs_t"""

    r: Array[float]
    W: Array[float]
    Jq: Array[Array[float]]

class KcMonVerdict(Protocol):
    """kc_mon_verdict_t"""

    state: int
    joint: int
    suspects: int
    n_obs: int
    bias: float
    sigma: float
    stat: float
    p: float
    rest: float
    p_rest: float
    off_m: float
    off_rad: float

class KcMonitor(Protocol):
    """kc_monitor_t"""

    n_joints: int
    prismatic: int
    floor2: Array[float]
    n: int
    next: int
    obs: Array[KcMonObs]

class KcMonitoring(Protocol):
    """kc_monitoring_t"""

    reported: KcMonVerdict
    newest: KcMonVerdict
    crc: Array[int]
    session: int
    rest_us: int
    t_us: int
    resting: bool
    due: bool

class KcMove(Protocol):
    """kc_move_t"""

    node: int
    path: Array[int]
    n_path: int
    i_path: int
    q_target: Array[float]
    q_final: Array[float]
    seg_from: int
    seg_to: int
    sent_us: int
    start_us: int
    seq: int
    checking: bool
    to: int
    q_from: Array[float]
    q_to: Array[float]
    check: KcGuardJob

class KcNext(Protocol):
    """kc_next_t"""

    state: int
    same_step: bool

class KcObs(Protocol):
    """kc_obs_t"""

    ctx: KcCtx
    p_m: Array[float]
    q_wxyz: Array[float]
    cov: Array[float]
    p_cam_m: Array[float]
    q_cam_wxyz: Array[float]
    has_rot: int
    has_cam: int

class KcObserve(Protocol):
    """kc_observe_t"""

    tried: KcTried
    servo_steps: int
    i_search: int
    middle_pan_rad: float
    middle_tilt_rad: float
    measured: KcPose
    predicted: KcPose
    off_m: Array[float]
    q_detected: Array[float]
    q_servo: Array[float]
    servo: KcServoMem

class KcOut(Protocol):
    """kc_out_t"""

    n_ack: int
    n_store: int
    ack: Array[KcAck]
    events: KcEvents
    store: Array[KcStore]
    has_arm_cmd: int
    has_pantilt_cmd: int
    has_frame_request: int
    has_meas: int
    has_progress: int
    has_proposal: int
    has_table_down: int
    has_hk: int
    arm_cmd: KcArmCmd
    pantilt_cmd: KcPantiltCmd
    frame_request: KcFrameRequest
    meas: KcMeas
    progress: KcProgress
    proposal: KcProposal
    table_down: KcChunk
    hk: KcHk

class KcOutcome(Protocol):
    """kc_outcome_t"""

    id: int
    cause: int

class KcPantiltCmd(Protocol):
    """kc_pantilt_cmd_t"""

    seq: int
    pan_rad: float
    tilt_rad: float

class KcPantiltState(Protocol):
    """kc_pantilt_state_t"""

    t_us: int
    seq: int
    pan_rad: float
    tilt_rad: float
    moving: int

class KcPantilt(Protocol):
    """kc_pantilt_t"""

    pan_rad: float
    tilt_rad: float
    sent_us: int
    seq: int

class KcPlace(Protocol):
    """kc_place_t"""

    state: int
    since_us: int

class KcPlan(Protocol):
    """kc_plan_t"""

    n_min: int
    n_own: int
    n_goal: int
    n_meas: int
    n_tried: int
    n_local: int
    i_initial: int
    again: int
    n_rep: int
    rep_at: int
    cand_of: Array[int]
    usable: Array[int]

class KcPoint(Protocol):
    """kc_point_t"""

    q_wxyz: Array[float]
    p_m: Array[float]

class KcPose(Protocol):
    """kc_pose_t"""

    p_m: Array[float]
    R: Array[float]

class KcPosture(Protocol):
    """kc_posture_t"""

    arm: CData
    pantilt: CData
    t_s: float

class KcProgress(Protocol):
    """kc_progress_t"""

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
    coef: Array[float]

class KcProposal(Protocol):
    """kc_proposal_t"""

    session: int
    crc: int
    verdict: int
    n_poses: int
    n_outliers: int
    status: Array[int]
    confounded: Array[int]
    cov: Array[float]
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
    crc_kin_before: int
    frame: int
    pred_noise_pos_m: float
    pred_noise_rot_rad: float
    pred_camera_pos_m: float
    pred_camera_rot_rad: float
    pred_lander_pos_m: float
    pred_lander_rot_rad: float
    kin: KcKin

class KcProposing(Protocol):
    """kc_proposing_t"""

    i_obs: int
    i_cand: int
    n: int
    considered: bool
    pos2: float
    rot2: float
    chi2_before: float
    chi2_after: float
    change2: float
    camera_pos2: float
    camera_rot2: float
    lander_pos2: float
    lander_rot2: float
    chi2: float
    fit: KcVerdictFit

class KcQp(Protocol):
    """kc_qp_t"""

    n: int
    H: Array[float]
    g: Array[float]
    lb: Array[float]
    ub: Array[float]
    x: Array[float]
    active: Array[int]
    kkt: float
    iters: int
    status: int
    g_max: float
    H_max: float
    floor_g: float
    newton: int
    at_minimum: bool
    m: int
    rows: int
    idx: Array[int]
    L: Array[float]
    inv_d: Array[float]
    grad: Array[float]
    d: Array[float]
    q: Array[float]
    until: Array[float]

class KcRequest(Protocol):
    """kc_request_t"""

    frame: int
    fails: int
    asked_us: int
    seq: int
    det: KcDetection

class KcRest(Protocol):
    """kc_rest_t"""

    resting: bool
    since_us: int

class KcReview(Protocol):
    """kc_review_t"""

    kin: KcKin
    image: Array[int]
    n: int
    crc: int
    verdict: int

class KcScrub(Protocol):
    """kc_scrub_t"""

    part: int
    at: int
    crc: int
    seal: int
    n_obs: int
    obs_seal: int
    lost: int

class KcServoMem(Protocol):
    """kc_servo_mem_t"""

    has_last: int
    q: Array[float]
    measured: KcPose
    B: Array[Array[float]]

class KcServoOpt(Protocol):
    """kc_servo_opt_t"""

    gain: float
    damping: float
    step_max: float
    bound: float
    tol_pos_m: float
    tol_rot_rad: float
    margin: float

class KcSpace(Protocol):
    """kc_space_t"""

    n_cand: int
    n_hub: int
    n_joints: int
    n_initial: int
    initial: Array[int]
    hub_q: Array[Array[float]]
    hub_edge: Array[int]
    servo_bound: Array[float]
    arm_crc: int
    cand: Array[KcCand]
    edge: Array[int]
    n_body: int
    n_volume: int
    body: Array[KcBody]
    volume: Array[KcVolume]
    verified: Array[KcDhBound]

class KcStaging(Protocol):
    """kc_staging_t"""

    state: int
    kind: int
    n: int
    total: int
    image: CData

class KcStart(Protocol):
    """kc_start_t"""

    acq: int
    n_goal: int
    seed: int
    free_mask: int

class KcStore(Protocol):
    """kc_store_t"""

    kind: int
    n: int
    data: CData

class KcTables(Protocol):
    """kc_tables_t"""

    active: KcActive
    staging: KcStaging
    scratch: CData

class KcTag(Protocol):
    """kc_tag_t"""

    id: int
    size_m: float
    xyz_m: Array[float]
    quat_wxyz: Array[float]

class KcTblScratch(Protocol):
    """kc_tbl_scratch_t"""

    arm: KcArm
    camera: KcCamera
    terms: KcTerms
    kin: KcKin
    space: KcSpace
    kernel: KcKernel
    config: KcConfig

class KcTelemetry(Protocol):
    """kc_telemetry_t"""

    arm: KcArmState
    pantilt: KcPantiltState
    has_arm: bool
    has_pantilt: bool
    arm_ok_us: int
    pantilt_ok_us: int

class KcTerm(Protocol):
    """kc_term_t"""

    coef: int
    frame: int
    comp: int
    gain: float
    basis: Array[KcBasis]

class KcTerms(Protocol):
    """kc_terms_t"""

    n_coef: int
    n_term: int
    coef: Array[KcCoef]
    term: Array[KcTerm]
    kinematics_crc: int

class KcTried(Protocol):
    """kc_tried_t"""

    detected: bool
    seed: bool
    searched: bool
    retreated: bool

class KcVerdictCase(Protocol):
    """kc_verdict_case_t"""

    determined: bool
    bounds_active: bool
    all_rejected: bool
    p_fit: float
    sigma_pos_m: float
    change_pos_m: float

class KcVerdictFit(Protocol):
    """kc_verdict_fit_t"""

    noise_scale: float
    p_fit: float
    p_no_change: float

class KcView(Protocol):
    """kc_view_t"""

    clock: CData
    place: CData
    tables: CData
    telemetry: CData
    cal: CData
    plan: CData
    learned: CData
    est: CData
    servo_steps: CData

class KcVolume(Protocol):
    """kc_volume_t"""

    kind: int
    p_m: Array[float]
    size_m: Array[float]
    radius_m: float
    excluded: int

class KcWalk(Protocol):
    """kc_walk_t"""

    mode: int
    want_crc: int
    lost: int
    overrun: int
    pos: int
    crc: int
    in_n: int
    out: CData
    cap: int
    index: int
    n_bad: int
    bad_id: int
    bad_index: int
    bad_field: int
    bad_got: float

class KcWork(Protocol):
    """kc_work_t"""

    most: int
    used: int

class FlightCore(Protocol):
    KC_AUTH_JUMP_MAX: int
    KC_BODY_MAX: int
    KC_CAMERA_CHAIN_COST: int
    KC_CAND_LOCAL: int
    KC_CAND_MAX: int
    KC_CAND_RESERVE: int
    KC_CHAIN_AXIS: int
    KC_CHAIN_COUNT: int
    KC_CHAIN_DRIFT: int
    KC_CHAIN_MAST: int
    KC_CHAIN_PLATE: int
    KC_CHAIN_SIZE: int
    KC_CHAIN_ZERO: int
    KC_CHANGE_BACK_COST: int
    KC_CHUNK_BYTES: int
    KC_CHUNK_QUEUE_MAX: int
    KC_CMD_QUEUE_MAX: int
    KC_COEF_MAX: int
    KC_CONSIDER_END_COST: int
    KC_DET_QUEUE_MAX: int
    KC_EST_PASSES: int
    KC_EVENTS_MAX: int
    KC_FRAME_CAMERA: int
    KC_FRAME_COUNT: int
    KC_FRAME_MEAS: int
    KC_FRAME_TOOL: int
    KC_GUARD_STEPS_MAX: int
    KC_HUB_MAX: int
    KC_HYPER_MAX: int
    KC_IMAGE_MAX: int
    KC_INITIAL_MAX: int
    KC_JOINT_MAX: int
    KC_JOURNAL_BYTES: int
    KC_KEY_BYTES: int
    KC_KEY_MAX: int
    KC_KIN_IMAGE_MAX: int
    KC_LEVER_TOOL: int
    KC_MAC_BYTES: int
    KC_MEAS_MAX: int
    KC_MON_OBS_MAX: int
    KC_MON_OBS_MIN: int
    KC_MON_OBS_OFF: int
    KC_NAME_LEN: int
    KC_NODE_NONE: int
    KC_OVERRIDE_FIT: int
    KC_OVERRIDE_NONE: int
    KC_PATH_MAX: int
    KC_PNP_MAX: int
    KC_QP_ITER_PER_VAR: int
    KC_SCRUB_BYTES: int
    KC_SIGNED_COUNT: int
    KC_SIGNED_HEAD_MAX: int
    KC_SILENT_US: int
    KC_SOURCE_MAX: int
    KC_SPACE_INDEX_BODY: int
    KC_SPACE_INDEX_HUB: int
    KC_SPACE_INDEX_INITIAL: int
    KC_SPACE_INDEX_VERIFIED: int
    KC_SPACE_INDEX_VOLUME: int
    KC_SPACE_SAMPLES: int
    KC_SPECTRUM_MAX: int
    KC_STEP_WORK: int
    KC_STORE_JOURNAL: int
    KC_STORE_PREV: int
    KC_STORE_PROPOSAL: int
    KC_STORE_QUEUE_MAX: int
    KC_TAG_MAX: int
    KC_TBL_HDR_BYTES: int
    KC_TERMS_INDEX_TERM: int
    KC_TERM_MAX: int
    KC_VOLUME_MAX: int
    KC_ERR_AUTH: int
    KC_ERR_PATH: int
    KC_ERR_REACH: int
    KC_ERR_RANK: int
    KC_ERR_STALE: int
    KC_ERR_STATE: int
    KC_ERR_RANGE: int
    KC_ERR_FORMAT: int
    KC_ERR_CRC: int
    KC_ERR_ITER: int
    KC_ERR_NUM: int
    KC_ERR_FULL: int
    KC_ERR_ARG: int
    KC_OK: int
    KC_QP_AT_UPPER: int
    KC_QP_AT_LOWER: int
    KC_QP_FREE: int
    KC_PRISMATIC: int
    KC_REVOLUTE: int
    KC_RZ: int
    KC_RY: int
    KC_RX: int
    KC_TZ: int
    KC_TY: int
    KC_TX: int
    KC_VAR_COUNT: int
    KC_VAR_PNP_RZ: int
    KC_VAR_PNP_RY: int
    KC_VAR_PNP_RX: int
    KC_VAR_PNP_TZ: int
    KC_VAR_PNP_TY: int
    KC_VAR_PNP_TX: int
    KC_VAR_LEVZ: int
    KC_VAR_LEVY: int
    KC_VAR_LEVX: int
    KC_VAR_GZ: int
    KC_VAR_GY: int
    KC_VAR_GX: int
    KC_VAR_TAG: int
    KC_VAR_ZCAM: int
    KC_VAR_YCAM: int
    KC_VAR_XCAM: int
    KC_VAR_TAU_PAYLOAD: int
    KC_VAR_QDOT: int
    KC_VAR_TILT: int
    KC_VAR_PAN: int
    KC_VAR_R2: int
    KC_VAR_V: int
    KC_VAR_U: int
    KC_VAR_INCID: int
    KC_VAR_RANGE: int
    KC_VAR_PAYLOAD: int
    KC_VAR_T: int
    KC_VAR_TEMP: int
    KC_VAR_DIR: int
    KC_VAR_MZ: int
    KC_VAR_MY: int
    KC_VAR_MX: int
    KC_VAR_TAU: int
    KC_VAR_Q: int
    KC_VAR_ONE: int
    KC_FN_COUNT: int
    KC_FN_ABS: int
    KC_FN_TAN2: int
    KC_FN_SQ: int
    KC_FN_STEP: int
    KC_FN_EXPN: int
    KC_FN_LN1P: int
    KC_FN_TANH: int
    KC_FN_COS: int
    KC_FN_SIN: int
    KC_FN_LIN: int
    KC_COEF_AT_UPPER: int
    KC_COEF_AT_LOWER: int
    KC_COEF_HELD: int
    KC_COEF_MASKED: int
    KC_COEF_ESTIMATED: int
    KC_MON_UNEXPLAINED: int
    KC_MON_NAMED: int
    KC_MON_QUIET: int
    KC_KERNEL_PAPER: int
    KC_KERNEL_SO3: int
    KC_ACQ_COUNT: int
    KC_ACQ_VOPT: int
    KC_ACQ_DOPT: int
    KC_ACQ_RANDOM: int
    KC_ACQ_UCB: int
    KC_VOL_SPHERE: int
    KC_VOL_CAPSULE: int
    KC_VOL_BOX: int
    KC_VOL_BELOW: int
    KC_GUARD_SELF: int
    KC_GUARD_VOLUME: int
    KC_GUARD_PATH: int
    KC_GUARD_LIMIT: int
    KC_GUARD_OK: int
    KC_SERVO_STUCK: int
    KC_SERVO_THERE: int
    KC_SERVO_MOVE: int
    KC_SEV_ERROR: int
    KC_SEV_WARN: int
    KC_SEV_INFO: int
    KC_SEV_DEBUG: int
    KC_EVT_NONE: int
    KC_EVT_CHANGE_FAILED: int
    KC_EVT_CMD_COUNTER: int
    KC_EVT_CMD_BEFORE: int
    KC_EVT_CMD_OLD: int
    KC_EVT_BOOT_JOURNAL_LOST: int
    KC_EVT_BOOT_NO_JOURNAL: int
    KC_EVT_TBL_SPACE_NARROW: int
    KC_EVT_TBL_TERMS_WIDE: int
    KC_EVT_COR_OVERRIDE: int
    KC_EVT_COR_NO_VERDICT: int
    KC_EVT_COR_POOR: int
    KC_EVT_STORE_REFUSED: int
    KC_EVT_CAL_OUTLIER_ACCEPTED: int
    KC_EVT_MON_NOT_AT_REST: int
    KC_EVT_MON_UNEXPLAINED: int
    KC_EVT_MON_SUSPECT: int
    KC_EVT_GRD_SELF: int
    KC_EVT_GRD_VOLUME: int
    KC_EVT_GRD_PATH: int
    KC_EVT_STORE_FAIL: int
    KC_EVT_GRD_LIMIT: int
    KC_EVT_COR_EXPIRED: int
    KC_EVT_COR_NO_PREVIOUS: int
    KC_EVT_COR_ON_BOARD: int
    KC_EVT_COR_ROLLBACK: int
    KC_EVT_COR_REJECTED: int
    KC_EVT_COR_ACTIVE: int
    KC_EVT_COR_ARMED: int
    KC_EVT_COR_NO_CHANGE: int
    KC_EVT_COR_PROPOSED: int
    KC_EVT_CAL_TAGS_NOT_DETECTED: int
    KC_EVT_CAL_MODEL_MISMATCH: int
    KC_EVT_CAL_ENERGY: int
    KC_EVT_CAL_POOR: int
    KC_EVT_CAL_ABORTED: int
    KC_EVT_CAL_CONVERGED: int
    KC_EVT_CAL_BUDGET: int
    KC_EVT_CAL_EST: int
    KC_EVT_CAL_HELD: int
    KC_EVT_CAL_RANK: int
    KC_EVT_CAL_OUTLIER: int
    KC_EVT_CAL_NO_PATH: int
    KC_EVT_CAL_NO_CANDIDATE: int
    KC_EVT_CAL_CAND_SKIPPED: int
    KC_EVT_CAL_SERVO_LIMIT: int
    KC_EVT_CAL_TAGS_LOST: int
    KC_EVT_CAL_FRAME_TIMEOUT: int
    KC_EVT_CAL_MOVE_TIMEOUT: int
    KC_EVT_CAL_POSE: int
    KC_EVT_CAL_START: int
    KC_EVT_IN_JUMP: int
    KC_EVT_MEMORY_OBSERVATIONS: int
    KC_EVT_MEMORY_TABLE: int
    KC_EVT_TIME_STEP: int
    KC_EVT_IN_SILENT: int
    KC_EVT_ARM_FAULT: int
    KC_EVT_DET_UNREQUESTED: int
    KC_EVT_DET_NONE: int
    KC_EVT_DET_UNCERTAIN: int
    KC_EVT_DET_JUMP: int
    KC_EVT_DET_UNKNOWN_TAG: int
    KC_EVT_DET_OLD: int
    KC_EVT_IN_COUNT: int
    KC_EVT_IN_NOT_UNIT: int
    KC_EVT_IN_STALE: int
    KC_EVT_IN_RANGE: int
    KC_EVT_TBL_ARM_DIFFERS: int
    KC_EVT_TBL_DROPPED: int
    KC_EVT_TBL_NOT_UNIT: int
    KC_EVT_TBL_NOT_FINITE: int
    KC_EVT_TBL_BUSY: int
    KC_EVT_TBL_DISCARDED: int
    KC_EVT_TBL_MISSING: int
    KC_EVT_TBL_DEPENDS: int
    KC_EVT_TBL_NOT_READY: int
    KC_EVT_TBL_ACTIVATED: int
    KC_EVT_TBL_CHUNK: int
    KC_EVT_TBL_BAD_TOTAL: int
    KC_EVT_TBL_RANGE: int
    KC_EVT_TBL_CRC: int
    KC_EVT_TBL_FORMAT: int
    KC_EVT_TBL_STAGED: int
    KC_EVT_CMD_UNSIGNED: int
    KC_EVT_CMD_WORK: int
    KC_EVT_CMD_SOURCE: int
    KC_EVT_CMD_CRC: int
    KC_EVT_CMD_ARG: int
    KC_EVT_CMD_STATE: int
    KC_EVT_CMD_STALE: int
    KC_EVT_CMD_UNKNOWN: int
    KC_EVT_CMD_ACCEPTED: int
    KC_EVT_CMD_REPLAYED: int
    KC_EVT_CMD_FORGED: int
    KC_EVT_CMD_KEY: int
    KC_EVT_BOOT_NO_KEYS: int
    KC_EVT_BOOT_LOST: int
    KC_EVT_BOOT_REVIEW: int
    KC_EVT_BOOT_SLOT_BAD: int
    KC_EVT_BOOT_INTERRUPTED: int
    KC_EVT_BOOT: int
    KC_CAUSE_COUNT: int
    KC_CAUSE_MEMORY: int
    KC_CAUSE_TAGS_NOT_DETECTED: int
    KC_CAUSE_MODEL_MISMATCH: int
    KC_CAUSE_SILENT: int
    KC_CAUSE_BUDGET: int
    KC_CAUSE_NO_PATH: int
    KC_CAUSE_NO_CANDIDATE: int
    KC_CAUSE_CAMERA: int
    KC_CAUSE_PANTILT_LATE: int
    KC_CAUSE_ARM_LATE: int
    KC_CAUSE_ARM_FAULT: int
    KC_CAUSE_COMMAND: int
    KC_WALK_CHECK: int
    KC_WALK_READ: int
    KC_WALK_WRITE: int
    KC_WALK_SIZE: int
    KC_RIGHT_IN_LANDER: int
    KC_RIGHT_IN_CAMERA: int
    KC_TBL_COUNT: int
    KC_TBL_CONFIG: int
    KC_TBL_KERNEL: int
    KC_TBL_SPACE: int
    KC_TBL_KIN: int
    KC_TBL_TERMS: int
    KC_TBL_CAMERA: int
    KC_TBL_ARM: int
    KC_STAGE_VALID: int
    KC_STAGE_COMPLETE: int
    KC_STAGE_LOADING: int
    KC_STAGE_NONE: int
    KC_AUTH_OLD: int
    KC_AUTH_BEFORE: int
    KC_AUTH_JUMPED: int
    KC_AUTH_REPLAYED: int
    KC_AUTH_FORGED: int
    KC_AUTH_UNKNOWN_KEY: int
    KC_AUTH_UNSIGNED: int
    KC_AUTH_GOOD: int
    KC_LEAVE_OUT_NONE: int
    KC_LEAVE_OUT_AGAIN: int
    KC_LEAVE_OUT_DONE: int
    KC_NO_TAGS_SKIP: int
    KC_NO_TAGS_RETREAT: int
    KC_NO_TAGS_SEARCH: int
    KC_NO_TAGS_SEED: int
    KC_STORING_REFUSE: int
    KC_STORING_AGAIN: int
    KC_STORING_DONE: int
    KC_VERDICT_POOR: int
    KC_VERDICT_CHANGE: int
    KC_VERDICT_NO_CHANGE: int
    KC_ST_STORE: int
    KC_ST_PROPOSE: int
    KC_ST_SELECT: int
    KC_ST_REPORT: int
    KC_ST_LEARN: int
    KC_ST_REFINE: int
    KC_ST_TURN: int
    KC_ST_REST: int
    KC_ST_APPROACH: int
    KC_ST_WITHDRAW: int
    KC_ST_RETREAT: int
    KC_ST_SEED: int
    KC_ST_SAFE: int
    KC_ST_ARMED: int
    KC_ST_REVIEW: int
    KC_ST_UPDATE: int
    KC_ST_MEASURE: int
    KC_ST_SEARCH: int
    KC_ST_SERVO: int
    KC_ST_OBSERVE: int
    KC_ST_SETTLE: int
    KC_ST_AIM: int
    KC_ST_MOVE: int
    KC_ST_IDLE: int
    KC_OC_SAFE: int
    KC_OC_STORE: int
    KC_OC_EXPIRE: int
    KC_OC_ARM: int
    KC_OC_START: int
    KC_OC_REVIEW: int
    KC_OC_FINISH: int
    KC_OC_AGAIN: int
    KC_OC_DISTURBED: int
    KC_OC_SEARCH: int
    KC_OC_RETREAT: int
    KC_OC_SEED: int
    KC_OC_APPROACH: int
    KC_OC_MEASURE: int
    KC_OC_SERVO: int
    KC_OC_ABORT: int
    KC_OC_SKIP: int
    KC_OC_DONE: int
    KC_OC_STAY: int
    KC_CMD_TABLE_DUMP: int
    KC_CMD_TABLE_DISCARD: int
    KC_CMD_TABLE_ACTIVATE: int
    KC_CMD_TABLE_VALIDATE: int
    KC_CMD_ROLLBACK: int
    KC_CMD_REJECT: int
    KC_CMD_APPROVE_GO: int
    KC_CMD_APPROVE_ARM: int
    KC_CMD_ABORT: int
    KC_CMD_START: int
    KC_CMD_NOOP: int
    KC_SRC_GROUND: int
    KC_SRC_EXECUTIVE: int
    KC_SIGNED_CHUNK: int
    KC_SIGNED_CMD: int
    KC_INPUT_DETECTION: int
    KC_INPUT_PANTILT: int
    KC_INPUT_ARM: int
    KC_FIELD_DET_COV: int
    KC_FIELD_DET_CORNER: int
    KC_FIELD_DET_COV_SHAPE: int
    KC_FIELD_DET_V: int
    KC_FIELD_DET_U: int
    KC_FIELD_DET_INCID: int
    KC_FIELD_DET_RANGE: int
    KC_FIELD_DET_RMS_ALT: int
    KC_FIELD_DET_RMS: int
    KC_FIELD_DET_P_ALT: int
    KC_FIELD_DET_P: int
    KC_FIELD_DET_N_TAGS: int
    KC_FIELD_DET_T: int
    KC_FIELD_PANTILT_TILT: int
    KC_FIELD_PANTILT_PAN: int
    KC_FIELD_PANTILT_T: int
    KC_FIELD_ARM_G: int
    KC_FIELD_ARM_PAYLOAD: int
    KC_FIELD_ARM_TEMP: int
    KC_FIELD_ARM_DIR: int
    KC_FIELD_ARM_Q_CMD: int
    KC_FIELD_ARM_DQ: int
    KC_FIELD_ARM_Q: int
    KC_FIELD_ARM_T: int
    KC_CHANGE_PUT_BACK: int
    KC_CHANGE_TABLE: int
    KC_CHANGE_ROLLBACK: int
    KC_CHANGE_REJECT: int
    KC_CHANGE_APPROVE: int
    KC_CHANGE_ACCEPT: int
    KC_CHANGE_PROPOSE: int
    KC_CHANGE_NONE: int
    KC_FRAME_TIMEOUT: int
    KC_FRAME_UNCERTAIN: int
    KC_FRAME_NO_TAGS: int
    KC_FRAME_DETECTED: int
    KC_FRAME_AWAITED: int
    KC_FRAME_NONE: int
    def kc_status_name(self, _0: int, /) -> CData: ...
    def kc_check_start(self, /) -> KcCheck: ...
    def kc_check(self, _0: KcCheck | CData, _1: bool, _2: int, _3: float, /) -> None: ...
    def kc_check_finite(self, _0: KcCheck | CData, _1: CData, _2: int, _3: int, /) -> None: ...
    def kc_check_positive(self, _0: KcCheck | CData, _1: float, _2: int, /) -> None: ...
    def kc_check_not_negative(self, _0: KcCheck | CData, _1: float, _2: int, /) -> None: ...
    def kc_check_frame(self, _0: KcCheck | CData, _1: CData, _2: CData, _3: int, /) -> None: ...
    def kc_check_end(self, _0: KcCheck | CData, _1: CData, _2: CData, /) -> int: ...
    def kc_name_ok(self, _0: CData | bytes, /) -> bool: ...
    def kc_chi2_sf(self, _0: float, _1: int, /) -> float: ...
    def kc_crc32(self, _0: int, _1: object, _2: int, /) -> int: ...
    def kc_acos(self, _0: float, /) -> float: ...
    def kc_atan2(self, _0: float, _1: float, /) -> float: ...
    def kc_exp(self, _0: float, /) -> float: ...
    def kc_log(self, _0: float, /) -> float: ...
    def kc_log1p(self, _0: float, /) -> float: ...
    def kc_tanh(self, _0: float, /) -> float: ...
    def kc_floor(self, _0: float, /) -> float: ...
    def kc_lgamma(self, _0: float, /) -> float: ...
    def kc_musl_sin(self, _0: float, /) -> float: ...
    def kc_musl_cos(self, _0: float, /) -> float: ...
    def kc_musl_tan(self, _0: float, /) -> float: ...
    def kc_qp_solve(self, _0: KcQp | CData, /) -> int: ...
    def kc_qp_begin(self, _0: KcQp | CData, /) -> None: ...
    def kc_qp_iterate(self, _0: KcQp | CData, /) -> bool: ...
    def kc_qp_cost(self, _0: int, /) -> int: ...
    def kc_rng_next(self, _0: CData, /) -> int: ...
    def kc_rng_uniform(self, _0: CData, /) -> float: ...
    def kc_rng_below(self, _0: CData, _1: int, /) -> int: ...
    def kc_pose_identity(self, _0: KcPose | CData, /) -> None: ...
    def kc_pose_mul(self, _0: KcPose | CData, _1: KcPose | CData, _2: KcPose | CData, /) -> None: ...
    def kc_pose_inv(self, _0: KcPose | CData, _1: KcPose | CData, /) -> None: ...
    def kc_pose_screw(self, _0: KcPose | CData, _1: int, _2: float, _3: float, /) -> None: ...
    def kc_pose_from_quat(self, _0: CData, _1: CData, _2: KcPose | CData, /) -> None: ...
    def kc_quat_dist_rad(self, _0: CData, _1: CData, /) -> float: ...
    def kc_quat_mul(self, _0: CData, _1: CData, _2: CData, /) -> None: ...
    def kc_quat_normalize(self, _0: CData, /) -> int: ...
    def kc_quat_to_R(self, _0: CData, _1: CData, /) -> None: ...
    def kc_R_to_quat(self, _0: CData, _1: CData, /) -> None: ...
    def kc_R_log(self, _0: CData, _1: CData, /) -> None: ...
    def kc_R_exp(self, _0: CData, _1: CData, /) -> None: ...
    def kc_pose_residual(self, _0: KcPose | CData, _1: KcPose | CData, _2: CData, /) -> None: ...
    def kc_la_chol(self, _0: CData, _1: int, _2: int, /) -> int: ...
    def kc_la_solve_lower(self, _0: CData, _1: int, _2: int, _3: CData, /) -> None: ...
    def kc_la_solve_lower_t(self, _0: CData, _1: int, _2: int, _3: CData, /) -> None: ...
    def kc_la_chol_solve(self, _0: CData, _1: int, _2: int, _3: CData, /) -> None: ...
    def kc_la_chol_inverse(self, _0: CData, _1: int, _2: int, _3: CData, _4: int, /) -> None: ...
    def kc_la_packed_append(self, _0: CData, _1: int, _2: CData, _3: float, /) -> int: ...
    def kc_la_packed_solve(self, _0: CData, _1: int, _2: CData, /) -> None: ...
    def kc_la_packed_solve_t(self, _0: CData, _1: int, _2: CData, /) -> None: ...
    def kc_la_fold(self, _0: CData, _1: int, _2: int, _3: CData, _4: int, _5: int, /) -> float: ...
    def kc_la_solve_upper(self, _0: CData, _1: int, _2: int, _3: CData, /) -> None: ...
    def kc_la_solve_upper_t(self, _0: CData, _1: int, _2: int, _3: CData, /) -> None: ...
    def kc_la_upper_gram(self, _0: CData, _1: int, _2: int, _3: CData, _4: int, /) -> None: ...
    def kc_la_upper_t_mul(self, _0: CData, _1: int, _2: int, _3: CData, _4: CData, /) -> None: ...
    def kc_la_upper_cov(self, _0: CData, _1: int, _2: int, _3: CData, _4: int, /) -> int: ...
    def kc_la_rank(self, _0: CData, _1: int, _2: int, _3: CData, _4: float, _5: CData, _6: CData, _7: CData, /) -> None: ...
    def kc_la_whiten(self, _0: CData, _1: int, _2: CData, /) -> int: ...
    def kc_la_whiten_apply(self, _0: CData, _1: int, _2: CData, _3: CData, /) -> None: ...
    def kc_la_rank_update(self, _0: CData, _1: int, _2: int, _3: CData, _4: int, _5: int, _6: float, /) -> None: ...
    def kc_la_congruence(self, _0: CData, _1: int, _2: int, _3: CData, _4: int, _5: int, _6: CData, /) -> None: ...
    def kc_la_mul(self, _0: CData, _1: int, _2: int, _3: CData, _4: int, _5: int, _6: CData, /) -> None: ...
    def kc_arm_fk(self, _0: KcArm | CData, _1: CData, _2: KcPose | CData, /) -> None: ...
    def kc_arm_link(self, _0: KcJoint | CData, _1: float, _2: KcPose | CData, /) -> None: ...
    def kc_arm_kinematics_crc(self, _0: KcArm | CData, /) -> int: ...
    def kc_arm_validate(self, _0: KcArm | CData, _1: CData, _2: CData, /) -> int: ...
    def kc_camera_pose(self, _0: KcCamera | CData, _1: float, _2: float, _3: KcPose | CData, /) -> None: ...
    def kc_camera_aim(self, _0: KcCamera | CData, _1: CData, _2: CData, _3: CData, /) -> int: ...
    def kc_camera_project(self, _0: KcCamera | CData, _1: CData, _2: CData, /) -> int: ...
    def kc_camera_visible(self, _0: KcCamera | CData, _1: KcPose | CData, _2: float, /) -> int: ...
    def kc_camera_chain(self, _0: KcCamera | CData, _1: float, _2: float, _3: KcPose | CData, _4: float, _5: CData, /) -> None: ...
    def kc_camera_validate(self, _0: KcCamera | CData, _1: CData, _2: CData, /) -> int: ...
    def kc_basis_eval(self, _0: KcBasis | CData, _1: KcCtx | CData, _2: KcLoads | CData, /) -> float: ...
    def kc_basis_needs_loads(self, _0: KcBasis | CData, /) -> bool: ...
    def kc_terms_validate(self, _0: KcTerms | CData, _1: int, _2: CData, _3: CData, /) -> int: ...
    def kc_terms_add_dh(self, _0: KcTerms | CData, _1: int, _2: CData, /) -> int: ...
    def kc_model_cost(self, _0: KcArm | CData, _1: KcTerms | CData, _2: bool, /) -> int: ...
    def kc_model_loads(self, _0: KcArm | CData, _1: KcTerms | CData, _2: CData, _3: KcCtx | CData, _4: KcLoads | CData, /) -> None: ...
    def kc_model_eval(self, _0: KcArm | CData, _1: KcTerms | CData, _2: CData, _3: KcCtx | CData, _4: KcLoads | CData, _5: bool, _6: KcEval | CData, /) -> None: ...
    def kc_model_frames(self, _0: KcArm | CData, _1: KcTerms | CData, _2: CData, _3: KcCtx | CData, _4: KcLoads | CData, _5: KcPose | CData, _6: CData, _7: CData, /) -> None: ...
    def kc_model_residual(self, _0: KcArm | CData, _1: KcTerms | CData, _2: CData, _3: KcObs | CData, _4: KcLoads | CData, _5: CData, _6: KcEval | CData, /) -> int: ...
    def kc_est_add(self, _0: KcEst | CData, _1: KcObs | CData, /) -> int: ...
    def kc_est_solve(self, _0: KcEst | CData, /) -> int: ...
    def kc_est_begin(self, _0: KcEst | CData, /) -> None: ...
    def kc_est_step(self, _0: KcEst | CData, _1: KcWork | CData, /) -> bool: ...
    def kc_est_pose_cov_cost(self, _0: KcEst | CData, /) -> int: ...
    def kc_est_pose_cov(self, _0: KcEst | CData, _1: KcCtx | CData, _2: KcEval | CData, _3: CData, /) -> None: ...
    def kc_consider_begin(self, _0: KcConsider | CData, /) -> None: ...
    def kc_consider_add(self, _0: KcConsider | CData, _1: KcEst | CData, _2: KcConsiderPose | CData, /) -> None: ...
    def kc_consider_add_cost(self, _0: KcEst | CData, /) -> int: ...
    def kc_consider_end(self, _0: KcConsider | CData, _1: KcEst | CData, /) -> None: ...
    def kc_consider_explains_before(self, _0: KcConsider | CData, _1: int, /) -> float: ...
    def kc_consider_explains_after(self, _0: KcConsider | CData, _1: int, /) -> float: ...
    def kc_consider_scale(self, _0: KcConsider | CData, _1: float, /) -> None: ...
    def kc_consider_cov(self, _0: KcConsider | CData, _1: int, _2: int, /) -> float: ...
    def kc_consider_pose(self, _0: KcConsider | CData, _1: KcEst | CData, _2: KcEval | CData, _3: CData, _4: CData, _5: CData, /) -> None: ...
    def kc_consider_pose_cost(self, _0: KcEst | CData, /) -> int: ...
    def kc_monitor_init(self, _0: KcMonitor | CData, _1: KcArm | CData, _2: float, _3: float, /) -> None: ...
    def kc_monitor_add(self, _0: KcMonitor | CData, _1: KcArm | CData, _2: KcTerms | CData, _3: CData, _4: KcObs | CData, _5: KcEval | CData, /) -> int: ...
    def kc_monitor_evaluate(self, _0: KcMonitor | CData, _1: KcMonVerdict | CData, /) -> None: ...
    def kc_monitor_evaluate_cost(self, _0: KcMonitor | CData, /) -> int: ...
    def kc_kernel_rot(self, _0: KcKernel | CData, _1: int, _2: CData, _3: CData, /) -> float: ...
    def kc_kernel_eval(self, _0: KcKernel | CData, _1: int, _2: KcPoint | CData, _3: KcPoint | CData, /) -> float: ...
    def kc_kernel_cost(self, _0: KcKernel | CData, /) -> int: ...
    def kc_kernel_validate(self, _0: KcKernel | CData, _1: CData, _2: CData, /) -> int: ...
    def kc_gp_init(self, _0: KcGp | CData, _1: KcKernel | CData, _2: int, _3: KcPoint | CData, _4: int, /) -> int: ...
    def kc_gp_add(self, _0: KcGp | CData, _1: KcPoint | CData, _2: float, _3: KcPoint | CData, /) -> int: ...
    def kc_gp_set_y(self, _0: KcGp | CData, _1: CData, /) -> None: ...
    def kc_gp_cand_mean(self, _0: KcGp | CData, _1: int, /) -> float: ...
    def kc_gp_predict(self, _0: KcGp | CData, _1: KcPoint | CData, _2: CData, _3: CData, /) -> None: ...
    def kc_gp_log_marginal(self, _0: KcGp | CData, /) -> float: ...
    def kc_gp_choose(self, _0: KcGp | CData, _1: KcPoint | CData, /) -> int: ...
    def kc_gp_choose_begin(self, _0: KcGp | CData, /) -> None: ...
    def kc_gp_choose_step(self, _0: KcGp | CData, _1: KcPoint | CData, _2: KcWork | CData, /) -> bool: ...
    def kc_gp_cost(self, _0: KcGp | CData, /) -> int: ...
    def kc_acq_beta(self, _0: int, _1: int, _2: float, /) -> float: ...
    def kc_acq_objective(self, _0: CData, _1: CData, _2: int, _3: float, _4: float, _5: float, _6: CData, /) -> None: ...
    def kc_acq_ucb(self, _0: KcGp | CData, _1: CData | bytes, _2: float, _3: CData, _4: CData, /) -> int: ...
    def kc_acq_random(self, _0: CData | bytes, _1: int, _2: CData, _3: CData, /) -> int: ...
    def kc_acq_info(self, _0: int, _1: KcEst | CData, _2: CData, _3: int, _4: CData | bytes, _5: CData, _6: float, _7: KcAcqWork | CData, _8: CData, _9: CData, /) -> int: ...
    def kc_acq_info_begin(self, _0: int, _1: KcEst | CData, _2: CData, _3: float, _4: KcAcqWork | CData, /) -> None: ...
    def kc_acq_info_step(self, _0: KcEst | CData, _1: CData, _2: int, _3: CData | bytes, _4: KcAcqWork | CData, _5: KcWork | CData, /) -> bool: ...
    def kc_space_edge(self, _0: KcSpace | CData, _1: int, _2: int, /) -> bool: ...
    def kc_space_local(self, _0: KcSpace | CData, _1: int, /) -> bool: ...
    def kc_space_reserve(self, _0: KcSpace | CData, _1: int, /) -> bool: ...
    def kc_space_n_local(self, _0: KcSpace | CData, /) -> int: ...
    def kc_space_validate(self, _0: KcSpace | CData, _1: KcArm | CData, _2: CData, _3: CData, /) -> int: ...
    def kc_bounds_verified(self, _0: KcSpace | CData, _1: int, _2: int, /) -> float: ...
    def kc_bounds_size(self, _0: KcArm | CData, _1: KcTerm | CData, /) -> float: ...
    def kc_bounds_check(self, _0: KcSpace | CData, _1: KcArm | CData, _2: KcTerms | CData, _3: KcBoundsBad | CData, /) -> int: ...
    def kc_bounds_cost(self, _0: int, /) -> int: ...
    def kc_dls_cost(self, _0: CData, /) -> float: ...
    def kc_dls_step(self, _0: CData, _1: int, _2: CData, _3: float, _4: CData, _5: CData, _6: CData, /) -> int: ...
    def kc_dls_predicted(self, _0: CData, _1: int, _2: CData, _3: CData, /) -> float: ...
    def kc_dls_limit(self, _0: CData, _1: int, _2: float, /) -> None: ...
    def kc_dls_eval(self, _0: KcArm | CData, _1: KcTerms | CData, _2: CData, _3: CData, _4: KcEval | CData, /) -> None: ...
    def kc_dls_box(self, _0: KcJoint | CData, _1: float, _2: float, _3: CData, _4: CData, /) -> None: ...
    def kc_path_is_node(self, _0: KcSpace | CData, _1: int, /) -> bool: ...
    def kc_path_plan(self, _0: KcSpace | CData, _1: int, _2: int, _3: CData, _4: CData, /) -> int: ...
    def kc_path_bound(self, _0: KcSpace | CData, _1: int, _2: float, /) -> float: ...
    def kc_path_joints(self, _0: KcSpace | CData, _1: int, _2: CData, /) -> None: ...
    def kc_path_nearest(self, _0: KcSpace | CData, _1: CData, _2: CData, _3: CData, /) -> int: ...
    def kc_path_on_segment(self, _0: KcSpace | CData, _1: CData, _2: float, /) -> int: ...
    def kc_path_on(self, _0: KcSpace | CData, _1: int, _2: int, _3: CData, _4: float, /) -> bool: ...
    def kc_path_leads_to(self, _0: KcSpace | CData, _1: int, _2: CData, _3: float, /) -> bool: ...
    def kc_guard_clearance(self, _0: KcGuardArm | CData, _1: CData, _2: CData, /) -> float: ...
    def kc_guard_self_clearance(self, _0: KcGuardArm | CData, _1: CData, _2: CData, /) -> float: ...
    def kc_guard_check(self, _0: KcGuardRequest | CData, _1: KcGuardReason | CData, /) -> int: ...
    def kc_guard_begin(self, _0: KcGuardRequest | CData, _1: KcGuardJob | CData, /) -> None: ...
    def kc_guard_step(self, _0: KcGuardRequest | CData, _1: KcGuardJob | CData, _2: KcWork | CData, /) -> bool: ...
    def kc_ik_solve(self, _0: KcArm | CData, _1: KcTerms | CData, _2: CData, _3: KcPose | CData, _4: KcIkOpt | CData, _5: CData, _6: KcEval | CData, _7: CData, /) -> int: ...
    def kc_servo_forget(self, _0: KcServoMem | CData, /) -> None: ...
    def kc_servo_step(self, _0: KcArm | CData, _1: KcTerms | CData, _2: CData, _3: KcPose | CData, _4: KcPose | CData, _5: CData, _6: CData, _7: CData, _8: KcServoOpt | CData, _9: CData, _10: KcEval | CData, _11: KcServoMem | CData, /) -> int: ...
    def kc_event(self, _0: KcEvents | CData, _1: int, _2: int, _3: float, _4: float, /) -> None: ...
    def kc_event_name(self, _0: int, /) -> CData: ...
    def kc_event_text(self, _0: int, /) -> CData: ...
    def kc_event_action(self, _0: int, /) -> CData: ...
    def kc_event_severity(self, _0: int, /) -> int: ...
    def kc_cause_text(self, _0: int, /) -> CData: ...
    def kc_walk_u8(self, _0: KcWalk | CData, _1: int, _2: CData | bytes, _3: int, _4: int, /) -> None: ...
    def kc_walk_u16(self, _0: KcWalk | CData, _1: int, _2: CData, _3: int, _4: int, /) -> None: ...
    def kc_walk_u32(self, _0: KcWalk | CData, _1: int, _2: CData, _3: int, _4: int, /) -> None: ...
    def kc_walk_i32(self, _0: KcWalk | CData, _1: int, _2: CData, _3: int, _4: int, /) -> None: ...
    def kc_walk_u64(self, _0: KcWalk | CData, _1: int, _2: CData, _3: int, _4: int, /) -> None: ...
    def kc_walk_f32(self, _0: KcWalk | CData, _1: int, _2: CData, _3: float, _4: float, /) -> None: ...
    def kc_walk_f64(self, _0: KcWalk | CData, _1: int, _2: CData, _3: float, _4: float, /) -> None: ...
    def kc_walk_vec(self, _0: KcWalk | CData, _1: int, _2: CData, _3: int, _4: float, _5: float, /) -> None: ...
    def kc_walk_quat(self, _0: KcWalk | CData, _1: int, _2: CData, /) -> None: ...
    def kc_walk_quatf(self, _0: KcWalk | CData, _1: int, _2: CData, /) -> None: ...
    def kc_walk_name(self, _0: KcWalk | CData, _1: int, _2: CData | bytes, /) -> None: ...
    def kc_walk_raw(self, _0: KcWalk | CData, _1: CData | bytes, _2: int, /) -> None: ...
    def kc_walk_count(self, _0: KcWalk | CData, _1: int, _2: CData, _3: int, _4: int, /) -> int: ...
    def kc_walk_rule(self, _0: KcWalk | CData, _1: int, _2: bool, _3: float, /) -> None: ...
    def kc_config_walk(self, _0: KcWalk | CData, _1: KcConfig | CData, /) -> None: ...
    def kc_config_validate(self, _0: KcConfig | CData, _1: CData, _2: CData, /) -> int: ...
    def kc_tbl_encode(self, _0: int, _1: object, _2: int, _3: CData | bytes, _4: int, _5: CData, /) -> int: ...
    def kc_tbl_decode(self, _0: int, _1: CData | bytes, _2: int, _3: object, _4: KcEvents | CData, /) -> int: ...
    def kc_tbl_image_crc(self, _0: CData | bytes, _1: int, /) -> int: ...
    def kc_tbl_chunk(self, _0: KcTables | CData, _1: int, _2: int, _3: int, _4: CData | bytes, _5: int, _6: KcEvents | CData, /) -> int: ...
    def kc_tbl_cost(self, _0: KcTables | CData, /) -> int: ...
    def kc_tbl_validate(self, _0: KcTables | CData, _1: int, _2: int, _3: KcEvents | CData, /) -> int: ...
    def kc_tbl_activate(self, _0: KcTables | CData, _1: int, _2: int, _3: KcEvents | CData, /) -> int: ...
    def kc_tbl_ready(self, _0: KcTables | CData, _1: int, _2: int, _3: KcEvents | CData, /) -> int: ...
    def kc_tbl_discard(self, _0: KcTables | CData, _1: KcEvents | CData, /) -> None: ...
    def kc_tbl_load(self, _0: KcTables | CData, _1: int, _2: CData | bytes, _3: int, _4: KcEvents | CData, /) -> int: ...
    def kc_tbl_load_prev(self, _0: KcTables | CData, _1: CData | bytes, _2: int, _3: KcEvents | CData, /) -> int: ...
    def kc_tbl_kin_fits(self, _0: KcTables | CData, _1: KcKin | CData, _2: KcEvents | CData, /) -> int: ...
    def kc_tbl_set_kin(self, _0: KcTables | CData, _1: KcKin | CData, _2: KcEvents | CData, /) -> int: ...
    def kc_tbl_rollback(self, _0: KcTables | CData, _1: KcEvents | CData, /) -> int: ...
    def kc_tbl_active_ptr(self, _0: KcActive | CData, _1: int, /) -> CData: ...
    def kc_tbl_active_bytes(self, _0: int, /) -> int: ...
    def kc_layout_walk(self, _0: KcWalk | CData, _1: int, _2: object, /) -> None: ...
    def kc_layout_version(self, _0: int, /) -> int: ...
    def kc_layout_struct_bytes(self, _0: int, /) -> int: ...
    def kc_auth_mac(self, _0: KcKey | CData, _1: KcAuthText | CData, _2: CData | bytes, /) -> None: ...
    def kc_auth_fresh(self, _0: KcAuthKnown | CData, _1: int, _2: int, /) -> int: ...
    def kc_auth_check(self, _0: KcKeys | CData, _1: KcAuth | CData, _2: KcAuthKnown | CData, _3: int, _4: KcAuthText | CData, /) -> int: ...
    def kc_auth_cost(self, _0: int, /) -> int: ...
    def kc_fit_solved(self, _0: int, /) -> bool: ...
    def kc_fit_quality(self, _0: KcEst | CData, _1: int, /) -> KcFitQuality: ...
    def kc_fit_needs_second_start(self, _0: KcConfig | CData, _1: KcFitQuality | CData, /) -> bool: ...
    def kc_fit_second_is_better(self, _0: KcFitQuality | CData, _1: KcFitQuality | CData, /) -> bool: ...
    def kc_fit_predicts_better(self, _0: KcConfig | CData, _1: KcMiss, _2: KcMiss, /) -> bool: ...
    def kc_fit_certain(self, _0: KcConfig | CData, _1: KcEst | CData, _2: int, _3: KcMiss, /) -> bool: ...
    def kc_fit_mismatch(self, _0: KcConfig | CData, _1: KcEst | CData, _2: KcMiss | CData, _3: int, _4: int, _5: CData, /) -> bool: ...
    def kc_frames_clear(self, _0: KcFrames | CData, /) -> None: ...
    def kc_frames_add(self, _0: KcFrames | CData, _1: KcDetection | CData, _2: KcArmState | CData, _3: KcPantiltState | CData, /) -> None: ...
    def kc_frames_jump(self, _0: KcFrames | CData, _1: KcDetection | CData, _2: CData, _3: CData, /) -> None: ...
    def kc_frames_mean(self, _0: KcFrames | CData, _1: KcConfig | CData, _2: KcDetection | CData, _3: KcArmState | CData, _4: KcPantiltState | CData, /) -> None: ...
    def kc_plan_start(self, _0: KcPlan | CData, _1: KcSpace | CData, _2: KcConfig | CData, _3: int, /) -> None: ...
    def kc_plan_no_tags(self, _0: KcPlan | CData, _1: KcSpace | CData, _2: KcConfig | CData, /) -> bool: ...
    def kc_plan_complete(self, _0: KcPlan | CData, _1: KcSpace | CData, /) -> bool: ...
    def kc_plan_enough(self, _0: KcPlan | CData, /) -> bool: ...
    def kc_plan_next(self, _0: KcPlan | CData, _1: KcSpace | CData, _2: int, _3: bool, _4: CData, /) -> bool: ...
    def kc_plan_again(self, _0: KcPlan | CData, _1: int, /) -> None: ...
    def kc_plan_choose(self, _0: KcPlan | CData, _1: KcSpace | CData, _2: int, /) -> int: ...
    def kc_plan_measured(self, _0: KcPlan | CData, _1: KcSpace | CData, _2: int, /) -> None: ...
    def kc_plan_skipped(self, _0: KcPlan | CData, _1: int, /) -> None: ...
    def kc_leave_out_repeated(self, _0: KcConfig | CData, _1: KcPlan | CData, _2: KcObs | CData, _3: int, /) -> bool: ...
    def kc_leave_out_next(self, _0: KcLeaveOut | CData, _1: KcConfig | CData, _2: KcPlan | CData, _3: KcObs | CData, _4: bool, _5: float, _6: CData, /) -> int: ...
    def kc_observation(self, _0: KcCamera | CData, _1: KcDetection | CData, _2: KcPosture | CData, _3: KcObs | CData, /) -> None: ...
    def kc_observation_residual(self, _0: KcActive | CData, _1: CData, _2: KcObs | CData, _3: CData, _4: KcPose | CData, /) -> None: ...
    def kc_observation_is_flipped(self, _0: KcConfig | CData, _1: float, _2: float, _3: float, _4: float, /) -> bool: ...
    def kc_observation_unflip(self, _0: KcActive | CData, _1: CData, _2: KcPosture | CData, _3: KcDetection | CData, /) -> None: ...
    def kc_reach_no_tags(self, _0: KcTried | CData, _1: bool, /) -> int: ...
    def kc_reach_spiral(self, _0: int, _1: CData, _2: CData, /) -> None: ...
    def kc_reach_search_limit(self, _0: KcCamera | CData, _1: KcConfig | CData, _2: int, _3: float, _4: float, /) -> int: ...
    def kc_reach_draw_back(self, _0: float, _1: float, _2: float, _3: float, _4: bool, /) -> float: ...
    def kc_storing_next(self, _0: int, _1: int, _2: int, /) -> int: ...
    def kc_storing_counts(self, _0: bool, _1: int, _2: int, /) -> bool: ...
    def kc_verdict_p_no_change(self, _0: float, _1: float, _2: int, /) -> float: ...
    def kc_verdict_all_rejected(self, _0: KcEst | CData, /) -> bool: ...
    def kc_verdict(self, _0: KcConfig | CData, _1: KcEst | CData, _2: int, _3: KcVerdictFit | CData, /) -> int: ...
    def kc_verdict_acceptable(self, _0: KcConfig | CData, _1: KcVerdictCase | CData, /) -> bool: ...
    def kc_states_calibrating(self, _0: int, /) -> bool: ...
    def kc_states_estimating(self, _0: int, /) -> bool: ...
    def kc_states_next(self, _0: int, _1: int, /) -> KcNext: ...
    def kc_answer_ok(self, _0: int, /) -> KcAnswer: ...
    def kc_answer_refuse(self, _0: KcEvents | CData, _1: int, _2: int, _3: float, _4: float, _5: int, /) -> KcAnswer: ...
    def kc_answer_by(self, _0: int, _1: KcEvents | CData, _2: int, _3: int, /) -> KcAnswer: ...
    def kc_input_field(self, _0: int, _1: CData, /) -> CData: ...
    def kc_app_init(self, _0: KcApp | CData, /) -> None: ...
    def kc_app_keys(self, _0: KcApp | CData, _1: KcKeys | CData, /) -> None: ...
    def kc_app_load(self, _0: KcApp | CData, _1: int, _2: CData | bytes, _3: int, /) -> int: ...
    def kc_app_image_room(self, _0: KcApp | CData, /) -> CData: ...
    def kc_app_boot(self, _0: KcApp | CData, /) -> None: ...
    def kc_app_step(self, _0: KcApp | CData, _1: int, _2: KcIn | CData, _3: KcOut | CData, /) -> None: ...
    def kc_app_vouches_cmd(self, _0: KcApp | CData, _1: KcCmd | CData, _2: CData, /) -> bool: ...
    def kc_app_vouches_chunk(self, _0: KcApp | CData, _1: KcChunk | CData, _2: CData, /) -> bool: ...
    def kc_app_active(self, _0: KcApp | CData, /) -> CData: ...
    def kc_app_state(self, _0: KcApp | CData, /) -> int: ...
    def kc_counters_begin(self, _0: KcCounters | CData, _1: KcKeys | CData, /) -> None: ...
    def kc_counters_clock(self, _0: KcCounters | CData, _1: int, /) -> None: ...
    def kc_counters_of(self, _0: KcCounters | CData, _1: int, /) -> CData: ...
    def kc_counters_take(self, _0: KcCounters | CData, _1: KcAuth | CData, _2: int, _3: int, /) -> None: ...
    def kc_journal_store(self, _0: KcOut | CData, _1: int, _2: CData | bytes, _3: int, /) -> None: ...
    def kc_journal_kin(self, _0: KcJournalImages | CData, _1: KcActive | CData, _2: KcOut | CData, /) -> None: ...
    def kc_journal_load(self, _0: KcJournalStore | CData, _1: CData | bytes, _2: int, /) -> int: ...
    def kc_journal_write(self, _0: KcJournalStore | CData, _1: KcJournal | CData, _2: KcOut | CData, /) -> None: ...
    def kc_journal_again(self, _0: KcJournalStore | CData, _1: int, /) -> None: ...
    def kc_journal_note(self, _0: KcJournalStore | CData, _1: KcJournal | CData, _2: int, _3: KcOut | CData, /) -> None: ...
    def kc_view_stride(self, _0: KcView | CData, /) -> int: ...
    def kc_view_elapsed(self, _0: KcView | CData, _1: int, /) -> int: ...
    def kc_view_in_state_us(self, _0: KcView | CData, /) -> int: ...
    def kc_view_at_rest(self, _0: KcView | CData, /) -> bool: ...
    def kc_view_ctx(self, _0: KcView | CData, _1: int, _2: KcCtx | CData, /) -> None: ...
    def kc_view_expect(self, _0: KcView | CData, _1: CData, _2: KcPose | CData, /) -> None: ...
    def kc_view_pose(self, _0: KcView | CData, _1: CData, _2: int, _3: KcPose | CData, /) -> None: ...
    def kc_view_distance(self, _0: KcView | CData, _1: CData, /) -> float: ...
    def kc_view_seed(self, _0: KcView | CData, _1: CData, /) -> None: ...
    def kc_view_local(self, _0: KcView | CData, /) -> bool: ...
    def kc_select_start(self, _0: KcCal | CData, _1: KcPlan | CData, _2: KcView | CData, _3: KcStart | CData, _4: KcOut | CData, /) -> None: ...
    def kc_select_begin(self, _0: KcArenaCalibration | CData, /) -> None: ...
    def kc_select_run(self, _0: KcCal | CData, _1: KcPlan | CData, _2: KcArenaCalibration | CData, _3: CData, _4: KcView | CData, _5: KcWork | CData, _6: KcOut | CData, /) -> KcOutcome: ...
    def kc_select_skip(self, _0: KcPlan | CData, _1: KcView | CData, _2: KcOut | CData, /) -> None: ...
    def kc_select_budget(self, _0: KcCal | CData, _1: KcView | CData, _2: KcOut | CData, /) -> KcOutcome: ...
    def kc_cmd_admit(self, _0: KcCmdLog | CData, _1: KcView | CData, _2: KcCmd | CData, _3: KcOut | CData, /) -> KcAnswer: ...
    def kc_cmd_vouches(self, _0: KcCmdLog | CData, _1: KcView | CData, _2: KcCmd | CData, _3: CData, /) -> bool: ...
    def kc_cmd_vouches_chunk(self, _0: KcCmdLog | CData, _1: KcView | CData, _2: KcChunk | CData, _3: CData, /) -> bool: ...
    def kc_cmd_answer(self, _0: KcCmdLog | CData, _1: KcCmd | CData, _2: KcAnswer | CData, _3: KcOut | CData, /) -> None: ...
    def kc_cmd_not_now(self, _0: KcView | CData, _1: KcCmd | CData, _2: KcOut | CData, /) -> KcAnswer: ...
    def kc_cmd_tables_free(self, _0: KcView | CData, /) -> bool: ...
    def kc_cmd_start(self, _0: KcView | CData, _1: KcCmd | CData, _2: KcStart | CData, _3: KcOut | CData, /) -> KcAnswer: ...
    def kc_cmd_table(self, _0: KcTables | CData, _1: KcView | CData, _2: KcCmd | CData, _3: KcOut | CData, /) -> KcAnswer: ...
    def kc_cmd_chunk(self, _0: KcCmdLog | CData, _1: KcTables | CData, _2: KcView | CData, _3: KcChunk | CData, _4: KcOut | CData, /) -> None: ...
    def kc_review_encode(self, _0: KcReview | CData, _1: KcKin | CData, _2: int, /) -> int: ...
    def kc_review_wait(self, _0: KcReview | CData, _1: KcOut | CData, /) -> None: ...
    def kc_review_activate(self, _0: KcReview | CData, _1: KcTables | CData, _2: KcOut | CData, /) -> int: ...
    def kc_review_drop(self, _0: KcReview | CData, _1: KcOut | CData, /) -> None: ...
    def kc_review_armed(self, _0: KcReview | CData, _1: KcView | CData, _2: KcOut | CData, /) -> KcOutcome: ...
    def kc_review_report(self, _0: KcReview | CData, _1: KcView | CData, _2: KcHk | CData, /) -> None: ...
    def kc_review_arm(self, _0: KcReview | CData, _1: int, _2: int, _3: KcOut | CData, /) -> KcAnswer: ...
    def kc_review_go(self, _0: KcReview | CData, _1: KcTables | CData, _2: int, _3: KcOut | CData, /) -> KcAnswer: ...
    def kc_review_reject(self, _0: KcReview | CData, _1: int, _2: KcOut | CData, /) -> KcAnswer: ...
    def kc_review_rollback(self, _0: KcTables | CData, _1: int, _2: KcOut | CData, /) -> KcAnswer: ...
    def kc_review_load(self, _0: KcReview | CData, _1: KcTables | CData, _2: int, _3: CData | bytes, _4: int, _5: KcEvents | CData, /) -> int: ...
    def kc_change_begin(self, _0: KcChange | CData, _1: int, _2: KcView | CData, _3: KcCmd | CData, /) -> None: ...
    def kc_change_run(self, _0: KcChange | CData, _1: KcChangeParts | CData, _2: KcOut | CData, /) -> None: ...
    def kc_change_stored(self, _0: KcChange | CData, _1: KcChangeParts | CData, _2: KcIn | CData, _3: KcOut | CData, /) -> KcOutcome: ...
    def kc_change_cancel(self, _0: KcChange | CData, _1: KcCmdLog | CData, _2: KcOut | CData, /) -> None: ...
    def kc_dump_begin(self, _0: KcDump | CData, _1: KcReview | CData, _2: KcView | CData, _3: KcCmd | CData, _4: KcOut | CData, /) -> KcAnswer: ...
    def kc_dump_run(self, _0: KcDump | CData, _1: KcReview | CData, _2: KcView | CData, _3: KcWork | CData, _4: KcOut | CData, /) -> None: ...
    def kc_hk_count(self, _0: KcHkState | CData, _1: int, _2: KcOut | CData, /) -> bool: ...
    def kc_hk_fill(self, _0: KcHkState | CData, _1: KcHk | CData, /) -> None: ...
    def kc_request_begin(self, _0: KcRequest | CData, /) -> None: ...
    def kc_request_drop(self, _0: KcRequest | CData, /) -> None: ...
    def kc_request_answer(self, _0: KcRequest | CData, _1: KcDetection | CData, _2: bool, /) -> None: ...
    def kc_request_poll(self, _0: KcRequest | CData, _1: KcView | CData, _2: KcOut | CData, /) -> int: ...
    def kc_request_retry(self, _0: KcRequest | CData, _1: KcView | CData, /) -> bool: ...
    def kc_input_telemetry(self, _0: KcInput | CData, _1: KcView | CData, _2: KcIn | CData, _3: KcOut | CData, /) -> None: ...
    def kc_input_detection(self, _0: KcInput | CData, _1: KcRequest | CData, _2: KcFrames | CData, _3: KcView | CData, _4: KcDetection | CData, _5: KcOut | CData, /) -> None: ...
    def kc_input_observation(self, _0: KcView | CData, _1: int, _2: KcDetection | CData, _3: KcOut | CData, /) -> bool: ...
    def kc_input_silence(self, _0: KcView | CData, _1: KcOut | CData, /) -> KcOutcome: ...
    def kc_monitoring_wants(self, _0: KcView | CData, /) -> bool: ...
    def kc_monitoring_rest(self, _0: KcMonitoring | CData, _1: KcView | CData, /) -> None: ...
    def kc_monitoring_observe(self, _0: KcMonitoring | CData, _1: KcMonitor | CData, _2: KcView | CData, _3: KcDetection | CData, _4: KcWork | CData, _5: KcOut | CData, /) -> None: ...
    def kc_monitoring_evaluate(self, _0: KcMonitoring | CData, _1: KcMonitor | CData, _2: KcView | CData, _3: KcWork | CData, _4: KcOut | CData, /) -> None: ...
    def kc_move_hold(self, _0: KcMove | CData, _1: KcView | CData, _2: KcOut | CData, /) -> None: ...
    def kc_move_send(self, _0: KcMove | CData, _1: KcView | CData, _2: KcWork | CData, _3: KcOut | CData, _4: int, _5: int, _6: CData, /) -> KcOutcome: ...
    def kc_move_near(self, _0: KcMove | CData, _1: KcView | CData, _2: KcWork | CData, _3: KcOut | CData, _4: CData, /) -> KcOutcome: ...
    def kc_move_begin(self, _0: KcMove | CData, _1: KcView | CData, _2: KcWork | CData, _3: KcOut | CData, /) -> KcOutcome: ...
    def kc_move_run(self, _0: KcMove | CData, _1: KcView | CData, _2: KcWork | CData, _3: KcOut | CData, /) -> KcOutcome: ...
    def kc_move_wait(self, _0: KcMove | CData, _1: KcView | CData, _2: KcWork | CData, _3: KcOut | CData, /) -> KcOutcome: ...
    def kc_move_node(self, _0: KcMove | CData, _1: KcView | CData, _2: CData, /) -> int: ...
    def kc_move_bound(self, _0: KcActive | CData, _1: CData, /) -> None: ...
    def kc_move_box(self, _0: KcActive | CData, _1: int, _2: CData, _3: CData, /) -> None: ...
    def kc_move_goal(self, _0: KcSpace | CData, _1: int, _2: KcPose | CData, /) -> None: ...
    def kc_move_joints(self, _0: KcView | CData, _1: int, _2: int, _3: CData, /) -> int: ...
    def kc_move_joints_cost(self, _0: KcView | CData, _1: int, /) -> int: ...
    def kc_move_begin_cost(self, _0: KcView | CData, /) -> int: ...
    def kc_pantilt_turn(self, _0: KcPantilt | CData, _1: KcView | CData, _2: KcOut | CData, _3: float, _4: float, /) -> None: ...
    def kc_pantilt_aim(self, _0: KcPantilt | CData, _1: KcView | CData, _2: KcOut | CData, _3: CData, _4: CData, /) -> None: ...
    def kc_pantilt_wait(self, _0: KcPantilt | CData, _1: KcView | CData, _2: KcOut | CData, /) -> KcOutcome: ...
    def kc_observe_begin(self, _0: KcObserve | CData, /) -> None: ...
    def kc_observe_aimed(self, _0: KcObserve | CData, _1: KcPantilt | CData, /) -> None: ...
    def kc_observe_run(self, _0: KcObserve | CData, _1: KcRequest | CData, _2: KcView | CData, _3: KcOut | CData, /) -> KcOutcome: ...
    def kc_observe_search(self, _0: KcObserve | CData, _1: KcRequest | CData, _2: KcView | CData, _3: KcOut | CData, /) -> KcOutcome: ...
    def kc_observe_turn(self, _0: KcObserve | CData, _1: KcPantilt | CData, _2: KcView | CData, _3: KcOut | CData, /) -> KcOutcome: ...
    def kc_propose_begin(self, _0: KcProposing | CData, _1: KcConsider | CData, /) -> None: ...
    def kc_propose_run(self, _0: KcProposing | CData, _1: KcConsider | CData, _2: KcReview | CData, _3: KcTables | CData, _4: KcView | CData, _5: CData, _6: KcWork | CData, _7: KcOut | CData, /) -> KcOutcome: ...
    def kc_rest_begin(self, _0: KcRest | CData, /) -> None: ...
    def kc_rest_run(self, _0: KcRest | CData, _1: KcView | CData, _2: KcOut | CData, /) -> KcOutcome: ...
    def kc_scrub_run(self, _0: KcScrub | CData, _1: KcTables | CData, _2: KcEst | CData, _3: KcEvents | CData, /) -> KcOutcome: ...
    def kc_approach_wanted(self, _0: KcView | CData, /) -> bool: ...
    def kc_approach_start(self, _0: KcView | CData, _1: CData, _2: CData, _3: CData, /) -> None: ...
    def kc_measure_run(self, _0: KcFrames | CData, _1: KcRequest | CData, _2: KcEst | CData, _3: KcView | CData, _4: KcOut | CData, /) -> KcOutcome: ...
    def kc_sequence_stored(self, _0: KcApp | CData, _1: KcWork | CData, _2: KcIn | CData, _3: KcOut | CData, /) -> None: ...
    def kc_sequence_scrub(self, _0: KcApp | CData, _1: KcWork | CData, _2: KcOut | CData, /) -> None: ...
    def kc_sequence_record(self, _0: KcApp | CData, /) -> KcJournal: ...
    def kc_sequence_commands(self, _0: KcApp | CData, _1: KcWork | CData, _2: KcIn | CData, _3: KcOut | CData, /) -> None: ...
    def kc_sequence_detections(self, _0: KcApp | CData, _1: KcWork | CData, _2: KcIn | CData, _3: KcOut | CData, /) -> None: ...
    def kc_sequence_run(self, _0: KcApp | CData, _1: KcWork | CData, _2: KcOut | CData, /) -> None: ...
    def kc_signed_cmd(self, _0: KcCmd | CData, _1: CData | bytes, /) -> KcAuthText: ...
    def kc_signed_chunk(self, _0: KcChunk | CData, _1: CData | bytes, /) -> KcAuthText: ...
    def kc_update_start(self, _0: KcLearned | CData, _1: KcEst | CData, _2: KcArenaCalibration | CData, _3: KcView | CData, _4: int, /) -> None: ...
    def kc_update_start_cost(self, _0: KcView | CData, /) -> int: ...
    def kc_update_begin(self, _0: KcLearned | CData, /) -> None: ...
    def kc_update_solve(self, _0: KcLearned | CData, _1: KcEst | CData, _2: KcGp | CData, _3: KcView | CData, _4: KcWork | CData, /) -> KcOutcome: ...
    def kc_update_refine(self, _0: KcLearned | CData, _1: KcEst | CData, _2: KcView | CData, _3: KcWork | CData, /) -> KcOutcome: ...
    def kc_update_learn(self, _0: KcLearned | CData, _1: KcEst | CData, _2: KcPlan | CData, _3: KcArenaCalibration | CData, _4: KcView | CData, _5: KcWork | CData, _6: KcOut | CData, /) -> KcOutcome: ...
    def kc_update_report(self, _0: KcLearned | CData, _1: KcView | CData, _2: KcWork | CData, _3: KcOut | CData, /) -> KcOutcome: ...

class GroundCore(Protocol):
    KC_BODY_MAX: int
    KC_CAMERA_CHAIN_COST: int
    KC_CAND_MAX: int
    KC_CHAIN_AXIS: int
    KC_CHAIN_COUNT: int
    KC_CHAIN_DRIFT: int
    KC_CHAIN_MAST: int
    KC_CHAIN_PLATE: int
    KC_CHAIN_SIZE: int
    KC_CHAIN_ZERO: int
    KC_CHUNK_BYTES: int
    KC_CHUNK_QUEUE_MAX: int
    KC_CMD_QUEUE_MAX: int
    KC_COEF_MAX: int
    KC_DET_QUEUE_MAX: int
    KC_EVENTS_MAX: int
    KC_FRAME_CAMERA: int
    KC_FRAME_COUNT: int
    KC_FRAME_MEAS: int
    KC_FRAME_TOOL: int
    KC_GROUND: int
    KC_HUB_MAX: int
    KC_HYPER_MAX: int
    KC_IMAGE_MAX: int
    KC_INITIAL_MAX: int
    KC_JOINT_MAX: int
    KC_KEY_MAX: int
    KC_LEVER_TOOL: int
    KC_MEAS_MAX: int
    KC_NAME_LEN: int
    KC_PNP_MAX: int
    KC_QP_ITER_PER_VAR: int
    KC_SCRUB_BYTES: int
    KC_SPECTRUM_MAX: int
    KC_STEP_WORK: int
    KC_TAG_MAX: int
    KC_TERMS_INDEX_TERM: int
    KC_TERM_MAX: int
    KC_VOLUME_MAX: int
    KG_VIEW_PASS_MAX: int
    KC_ERR_AUTH: int
    KC_ERR_PATH: int
    KC_ERR_REACH: int
    KC_ERR_RANK: int
    KC_ERR_STALE: int
    KC_ERR_STATE: int
    KC_ERR_RANGE: int
    KC_ERR_FORMAT: int
    KC_ERR_CRC: int
    KC_ERR_ITER: int
    KC_ERR_NUM: int
    KC_ERR_FULL: int
    KC_ERR_ARG: int
    KC_OK: int
    KC_QP_AT_UPPER: int
    KC_QP_AT_LOWER: int
    KC_QP_FREE: int
    KC_PRISMATIC: int
    KC_REVOLUTE: int
    KC_RZ: int
    KC_RY: int
    KC_RX: int
    KC_TZ: int
    KC_TY: int
    KC_TX: int
    KC_VAR_COUNT: int
    KC_VAR_PNP_RZ: int
    KC_VAR_PNP_RY: int
    KC_VAR_PNP_RX: int
    KC_VAR_PNP_TZ: int
    KC_VAR_PNP_TY: int
    KC_VAR_PNP_TX: int
    KC_VAR_LEVZ: int
    KC_VAR_LEVY: int
    KC_VAR_LEVX: int
    KC_VAR_GZ: int
    KC_VAR_GY: int
    KC_VAR_GX: int
    KC_VAR_TAG: int
    KC_VAR_ZCAM: int
    KC_VAR_YCAM: int
    KC_VAR_XCAM: int
    KC_VAR_TAU_PAYLOAD: int
    KC_VAR_QDOT: int
    KC_VAR_TILT: int
    KC_VAR_PAN: int
    KC_VAR_R2: int
    KC_VAR_V: int
    KC_VAR_U: int
    KC_VAR_INCID: int
    KC_VAR_RANGE: int
    KC_VAR_PAYLOAD: int
    KC_VAR_T: int
    KC_VAR_TEMP: int
    KC_VAR_DIR: int
    KC_VAR_MZ: int
    KC_VAR_MY: int
    KC_VAR_MX: int
    KC_VAR_TAU: int
    KC_VAR_Q: int
    KC_VAR_ONE: int
    KC_FN_COUNT: int
    KC_FN_ABS: int
    KC_FN_TAN2: int
    KC_FN_SQ: int
    KC_FN_STEP: int
    KC_FN_EXPN: int
    KC_FN_LN1P: int
    KC_FN_TANH: int
    KC_FN_COS: int
    KC_FN_SIN: int
    KC_FN_LIN: int
    def kc_status_name(self, _0: int, /) -> CData: ...
    def kc_check_start(self, /) -> KcCheck: ...
    def kc_check(self, _0: KcCheck | CData, _1: bool, _2: int, _3: float, /) -> None: ...
    def kc_check_finite(self, _0: KcCheck | CData, _1: CData, _2: int, _3: int, /) -> None: ...
    def kc_check_positive(self, _0: KcCheck | CData, _1: float, _2: int, /) -> None: ...
    def kc_check_not_negative(self, _0: KcCheck | CData, _1: float, _2: int, /) -> None: ...
    def kc_check_frame(self, _0: KcCheck | CData, _1: CData, _2: CData, _3: int, /) -> None: ...
    def kc_check_end(self, _0: KcCheck | CData, _1: CData, _2: CData, /) -> int: ...
    def kc_name_ok(self, _0: CData | bytes, /) -> bool: ...
    def kc_chi2_sf(self, _0: float, _1: int, /) -> float: ...
    def kc_crc32(self, _0: int, _1: object, _2: int, /) -> int: ...
    def kc_acos(self, _0: float, /) -> float: ...
    def kc_atan2(self, _0: float, _1: float, /) -> float: ...
    def kc_exp(self, _0: float, /) -> float: ...
    def kc_log(self, _0: float, /) -> float: ...
    def kc_log1p(self, _0: float, /) -> float: ...
    def kc_tanh(self, _0: float, /) -> float: ...
    def kc_floor(self, _0: float, /) -> float: ...
    def kc_lgamma(self, _0: float, /) -> float: ...
    def kc_musl_sin(self, _0: float, /) -> float: ...
    def kc_musl_cos(self, _0: float, /) -> float: ...
    def kc_musl_tan(self, _0: float, /) -> float: ...
    def kc_qp_solve(self, _0: KcQp | CData, /) -> int: ...
    def kc_qp_begin(self, _0: KcQp | CData, /) -> None: ...
    def kc_qp_iterate(self, _0: KcQp | CData, /) -> bool: ...
    def kc_qp_cost(self, _0: int, /) -> int: ...
    def kc_rng_next(self, _0: CData, /) -> int: ...
    def kc_rng_uniform(self, _0: CData, /) -> float: ...
    def kc_rng_below(self, _0: CData, _1: int, /) -> int: ...
    def kc_pose_identity(self, _0: KcPose | CData, /) -> None: ...
    def kc_pose_mul(self, _0: KcPose | CData, _1: KcPose | CData, _2: KcPose | CData, /) -> None: ...
    def kc_pose_inv(self, _0: KcPose | CData, _1: KcPose | CData, /) -> None: ...
    def kc_pose_screw(self, _0: KcPose | CData, _1: int, _2: float, _3: float, /) -> None: ...
    def kc_pose_from_quat(self, _0: CData, _1: CData, _2: KcPose | CData, /) -> None: ...
    def kc_quat_dist_rad(self, _0: CData, _1: CData, /) -> float: ...
    def kc_quat_mul(self, _0: CData, _1: CData, _2: CData, /) -> None: ...
    def kc_quat_normalize(self, _0: CData, /) -> int: ...
    def kc_quat_to_R(self, _0: CData, _1: CData, /) -> None: ...
    def kc_R_to_quat(self, _0: CData, _1: CData, /) -> None: ...
    def kc_R_log(self, _0: CData, _1: CData, /) -> None: ...
    def kc_R_exp(self, _0: CData, _1: CData, /) -> None: ...
    def kc_pose_residual(self, _0: KcPose | CData, _1: KcPose | CData, _2: CData, /) -> None: ...
    def kc_arm_fk(self, _0: KcArm | CData, _1: CData, _2: KcPose | CData, /) -> None: ...
    def kc_arm_link(self, _0: KcJoint | CData, _1: float, _2: KcPose | CData, /) -> None: ...
    def kc_arm_kinematics_crc(self, _0: KcArm | CData, /) -> int: ...
    def kc_arm_validate(self, _0: KcArm | CData, _1: CData, _2: CData, /) -> int: ...
    def kc_camera_pose(self, _0: KcCamera | CData, _1: float, _2: float, _3: KcPose | CData, /) -> None: ...
    def kc_camera_aim(self, _0: KcCamera | CData, _1: CData, _2: CData, _3: CData, /) -> int: ...
    def kc_camera_project(self, _0: KcCamera | CData, _1: CData, _2: CData, /) -> int: ...
    def kc_camera_visible(self, _0: KcCamera | CData, _1: KcPose | CData, _2: float, /) -> int: ...
    def kc_camera_chain(self, _0: KcCamera | CData, _1: float, _2: float, _3: KcPose | CData, _4: float, _5: CData, /) -> None: ...
    def kc_camera_validate(self, _0: KcCamera | CData, _1: CData, _2: CData, /) -> int: ...
    def kc_basis_eval(self, _0: KcBasis | CData, _1: KcCtx | CData, _2: KcLoads | CData, /) -> float: ...
    def kc_basis_needs_loads(self, _0: KcBasis | CData, /) -> bool: ...
    def kc_terms_validate(self, _0: KcTerms | CData, _1: int, _2: CData, _3: CData, /) -> int: ...
    def kc_terms_add_dh(self, _0: KcTerms | CData, _1: int, _2: CData, /) -> int: ...
    def kc_model_cost(self, _0: KcArm | CData, _1: KcTerms | CData, _2: bool, /) -> int: ...
    def kc_model_loads(self, _0: KcArm | CData, _1: KcTerms | CData, _2: CData, _3: KcCtx | CData, _4: KcLoads | CData, /) -> None: ...
    def kc_model_eval(self, _0: KcArm | CData, _1: KcTerms | CData, _2: CData, _3: KcCtx | CData, _4: KcLoads | CData, _5: bool, _6: KcEval | CData, /) -> None: ...
    def kc_model_frames(self, _0: KcArm | CData, _1: KcTerms | CData, _2: CData, _3: KcCtx | CData, _4: KcLoads | CData, _5: KcPose | CData, _6: CData, _7: CData, /) -> None: ...
    def kc_model_residual(self, _0: KcArm | CData, _1: KcTerms | CData, _2: CData, _3: KcObs | CData, _4: KcLoads | CData, _5: CData, _6: KcEval | CData, /) -> int: ...
    def kg_hold(self, _0: KcArm | CData, _1: KcTerms | CData, _2: CData, _3: int, _4: KcObs | CData, _5: bool, _6: KcObs | CData, _7: KcLoads | CData, /) -> None: ...
    def kg_evaluate(self, _0: KcArm | CData, _1: KcTerms | CData, _2: CData, _3: int, _4: int, _5: KcObs | CData, _6: KcLoads | CData, _7: CData, _8: CData, _9: CData, _10: CData, /) -> None: ...
    def kg_residuals(self, _0: KcArm | CData, _1: KcTerms | CData, _2: CData, _3: int, _4: int, _5: KcObs | CData, _6: KcLoads | CData, _7: CData, /) -> None: ...
    def kg_poses(self, _0: KcArm | CData, _1: KcTerms | CData, _2: CData, _3: int, _4: KcObs | CData, _5: KcLoads | CData, _6: KcPose | CData, _7: CData, /) -> None: ...
    def kg_basis(self, _0: KcBasis | CData, _1: int, _2: KcObs | CData, _3: KcLoads | CData, _4: CData, /) -> None: ...
    def kg_frames(self, _0: KcArm | CData, _1: int, _2: CData, _3: KcPose | CData, /) -> None: ...

class New(Protocol):
    """Makes a zeroed struct, by the name of its type."""

    @overload
    def __call__(self, ctype: Literal["kc_ack_t"], /) -> KcAck: ...
    @overload
    def __call__(self, ctype: Literal["kc_acq_work_t"], /) -> KcAcqWork: ...
    @overload
    def __call__(self, ctype: Literal["kc_active_t"], /) -> KcActive: ...
    @overload
    def __call__(self, ctype: Literal["kc_answer_t"], /) -> KcAnswer: ...
    @overload
    def __call__(self, ctype: Literal["kc_app_t"], /) -> KcApp: ...
    @overload
    def __call__(self, ctype: Literal["kc_arena_calibration_t"], /) -> KcArenaCalibration: ...
    @overload
    def __call__(self, ctype: Literal["kc_arena_idle_t"], /) -> KcArenaIdle: ...
    @overload
    def __call__(self, ctype: Literal["kc_arena_t"], /) -> KcArena: ...
    @overload
    def __call__(self, ctype: Literal["kc_arm_cmd_t"], /) -> KcArmCmd: ...
    @overload
    def __call__(self, ctype: Literal["kc_arm_state_t"], /) -> KcArmState: ...
    @overload
    def __call__(self, ctype: Literal["kc_arm_t"], /) -> KcArm: ...
    @overload
    def __call__(self, ctype: Literal["kc_auth_known_t"], /) -> KcAuthKnown: ...
    @overload
    def __call__(self, ctype: Literal["kc_auth_t"], /) -> KcAuth: ...
    @overload
    def __call__(self, ctype: Literal["kc_auth_text_t"], /) -> KcAuthText: ...
    @overload
    def __call__(self, ctype: Literal["kc_basis_t"], /) -> KcBasis: ...
    @overload
    def __call__(self, ctype: Literal["kc_body_t"], /) -> KcBody: ...
    @overload
    def __call__(self, ctype: Literal["kc_bounds_bad_t"], /) -> KcBoundsBad: ...
    @overload
    def __call__(self, ctype: Literal["kc_cal_t"], /) -> KcCal: ...
    @overload
    def __call__(self, ctype: Literal["kc_camera_t"], /) -> KcCamera: ...
    @overload
    def __call__(self, ctype: Literal["kc_cand_t"], /) -> KcCand: ...
    @overload
    def __call__(self, ctype: Literal["kc_change_parts_t"], /) -> KcChangeParts: ...
    @overload
    def __call__(self, ctype: Literal["kc_change_t"], /) -> KcChange: ...
    @overload
    def __call__(self, ctype: Literal["kc_check_t"], /) -> KcCheck: ...
    @overload
    def __call__(self, ctype: Literal["kc_choice_t"], /) -> KcChoice: ...
    @overload
    def __call__(self, ctype: Literal["kc_chunk_t"], /) -> KcChunk: ...
    @overload
    def __call__(self, ctype: Literal["kc_clock_t"], /) -> KcClock: ...
    @overload
    def __call__(self, ctype: Literal["kc_cmd_log_t"], /) -> KcCmdLog: ...
    @overload
    def __call__(self, ctype: Literal["kc_cmd_t"], /) -> KcCmd: ...
    @overload
    def __call__(self, ctype: Literal["kc_coef_t"], /) -> KcCoef: ...
    @overload
    def __call__(self, ctype: Literal["kc_config_t"], /) -> KcConfig: ...
    @overload
    def __call__(self, ctype: Literal["kc_consider_pose_t"], /) -> KcConsiderPose: ...
    @overload
    def __call__(self, ctype: Literal["kc_consider_t"], /) -> KcConsider: ...
    @overload
    def __call__(self, ctype: Literal["kc_counted_t"], /) -> KcCounted: ...
    @overload
    def __call__(self, ctype: Literal["kc_counters_t"], /) -> KcCounters: ...
    @overload
    def __call__(self, ctype: Literal["kc_ctx_t"], /) -> KcCtx: ...
    @overload
    def __call__(self, ctype: Literal["kc_detection_t"], /) -> KcDetection: ...
    @overload
    def __call__(self, ctype: Literal["kc_dh_bound_t"], /) -> KcDhBound: ...
    @overload
    def __call__(self, ctype: Literal["kc_dump_t"], /) -> KcDump: ...
    @overload
    def __call__(self, ctype: Literal["kc_est_job_t"], /) -> KcEstJob: ...
    @overload
    def __call__(self, ctype: Literal["kc_est_opt_t"], /) -> KcEstOpt: ...
    @overload
    def __call__(self, ctype: Literal["kc_est_sums_t"], /) -> KcEstSums: ...
    @overload
    def __call__(self, ctype: Literal["kc_est_t"], /) -> KcEst: ...
    @overload
    def __call__(self, ctype: Literal["kc_eval_t"], /) -> KcEval: ...
    @overload
    def __call__(self, ctype: Literal["kc_event_t"], /) -> KcEvent: ...
    @overload
    def __call__(self, ctype: Literal["kc_events_t"], /) -> KcEvents: ...
    @overload
    def __call__(self, ctype: Literal["kc_fit_quality_t"], /) -> KcFitQuality: ...
    @overload
    def __call__(self, ctype: Literal["kc_frame_request_t"], /) -> KcFrameRequest: ...
    @overload
    def __call__(self, ctype: Literal["kc_frames_t"], /) -> KcFrames: ...
    @overload
    def __call__(self, ctype: Literal["kc_gp_choice_t"], /) -> KcGpChoice: ...
    @overload
    def __call__(self, ctype: Literal["kc_gp_t"], /) -> KcGp: ...
    @overload
    def __call__(self, ctype: Literal["kc_guard_arm_t"], /) -> KcGuardArm: ...
    @overload
    def __call__(self, ctype: Literal["kc_guard_job_t"], /) -> KcGuardJob: ...
    @overload
    def __call__(self, ctype: Literal["kc_guard_near_t"], /) -> KcGuardNear: ...
    @overload
    def __call__(self, ctype: Literal["kc_guard_reason_t"], /) -> KcGuardReason: ...
    @overload
    def __call__(self, ctype: Literal["kc_guard_request_t"], /) -> KcGuardRequest: ...
    @overload
    def __call__(self, ctype: Literal["kc_hk_state_t"], /) -> KcHkState: ...
    @overload
    def __call__(self, ctype: Literal["kc_hk_t"], /) -> KcHk: ...
    @overload
    def __call__(self, ctype: Literal["kc_hyper_t"], /) -> KcHyper: ...
    @overload
    def __call__(self, ctype: Literal["kc_ik_opt_t"], /) -> KcIkOpt: ...
    @overload
    def __call__(self, ctype: Literal["kc_in_t"], /) -> KcIn: ...
    @overload
    def __call__(self, ctype: Literal["kc_input_t"], /) -> KcInput: ...
    @overload
    def __call__(self, ctype: Literal["kc_joint_t"], /) -> KcJoint: ...
    @overload
    def __call__(self, ctype: Literal["kc_journal_images_t"], /) -> KcJournalImages: ...
    @overload
    def __call__(self, ctype: Literal["kc_journal_store_t"], /) -> KcJournalStore: ...
    @overload
    def __call__(self, ctype: Literal["kc_journal_t"], /) -> KcJournal: ...
    @overload
    def __call__(self, ctype: Literal["kc_kernel_t"], /) -> KcKernel: ...
    @overload
    def __call__(self, ctype: Literal["kc_key_t"], /) -> KcKey: ...
    @overload
    def __call__(self, ctype: Literal["kc_keys_t"], /) -> KcKeys: ...
    @overload
    def __call__(self, ctype: Literal["kc_kin_t"], /) -> KcKin: ...
    @overload
    def __call__(self, ctype: Literal["kc_learned_t"], /) -> KcLearned: ...
    @overload
    def __call__(self, ctype: Literal["kc_leave_out_t"], /) -> KcLeaveOut: ...
    @overload
    def __call__(self, ctype: Literal["kc_loads_t"], /) -> KcLoads: ...
    @overload
    def __call__(self, ctype: Literal["kc_meas_t"], /) -> KcMeas: ...
    @overload
    def __call__(self, ctype: Literal["kc_miss_t"], /) -> KcMiss: ...
    @overload
    def __call__(self, ctype: Literal["kc_mon_obs_t"], /) -> KcMonObs: ...
    @overload
    def __call__(self, ctype: Literal["kc_mon_verdict_t"], /) -> KcMonVerdict: ...
    @overload
    def __call__(self, ctype: Literal["kc_monitor_t"], /) -> KcMonitor: ...
    @overload
    def __call__(self, ctype: Literal["kc_monitoring_t"], /) -> KcMonitoring: ...
    @overload
    def __call__(self, ctype: Literal["kc_move_t"], /) -> KcMove: ...
    @overload
    def __call__(self, ctype: Literal["kc_next_t"], /) -> KcNext: ...
    @overload
    def __call__(self, ctype: Literal["kc_obs_t"], /) -> KcObs: ...
    @overload
    def __call__(self, ctype: Literal["kc_observe_t"], /) -> KcObserve: ...
    @overload
    def __call__(self, ctype: Literal["kc_out_t"], /) -> KcOut: ...
    @overload
    def __call__(self, ctype: Literal["kc_outcome_t"], /) -> KcOutcome: ...
    @overload
    def __call__(self, ctype: Literal["kc_pantilt_cmd_t"], /) -> KcPantiltCmd: ...
    @overload
    def __call__(self, ctype: Literal["kc_pantilt_state_t"], /) -> KcPantiltState: ...
    @overload
    def __call__(self, ctype: Literal["kc_pantilt_t"], /) -> KcPantilt: ...
    @overload
    def __call__(self, ctype: Literal["kc_place_t"], /) -> KcPlace: ...
    @overload
    def __call__(self, ctype: Literal["kc_plan_t"], /) -> KcPlan: ...
    @overload
    def __call__(self, ctype: Literal["kc_point_t"], /) -> KcPoint: ...
    @overload
    def __call__(self, ctype: Literal["kc_pose_t"], /) -> KcPose: ...
    @overload
    def __call__(self, ctype: Literal["kc_posture_t"], /) -> KcPosture: ...
    @overload
    def __call__(self, ctype: Literal["kc_progress_t"], /) -> KcProgress: ...
    @overload
    def __call__(self, ctype: Literal["kc_proposal_t"], /) -> KcProposal: ...
    @overload
    def __call__(self, ctype: Literal["kc_proposing_t"], /) -> KcProposing: ...
    @overload
    def __call__(self, ctype: Literal["kc_qp_t"], /) -> KcQp: ...
    @overload
    def __call__(self, ctype: Literal["kc_request_t"], /) -> KcRequest: ...
    @overload
    def __call__(self, ctype: Literal["kc_rest_t"], /) -> KcRest: ...
    @overload
    def __call__(self, ctype: Literal["kc_review_t"], /) -> KcReview: ...
    @overload
    def __call__(self, ctype: Literal["kc_scrub_t"], /) -> KcScrub: ...
    @overload
    def __call__(self, ctype: Literal["kc_servo_mem_t"], /) -> KcServoMem: ...
    @overload
    def __call__(self, ctype: Literal["kc_servo_opt_t"], /) -> KcServoOpt: ...
    @overload
    def __call__(self, ctype: Literal["kc_space_t"], /) -> KcSpace: ...
    @overload
    def __call__(self, ctype: Literal["kc_staging_t"], /) -> KcStaging: ...
    @overload
    def __call__(self, ctype: Literal["kc_start_t"], /) -> KcStart: ...
    @overload
    def __call__(self, ctype: Literal["kc_store_t"], /) -> KcStore: ...
    @overload
    def __call__(self, ctype: Literal["kc_tables_t"], /) -> KcTables: ...
    @overload
    def __call__(self, ctype: Literal["kc_tag_t"], /) -> KcTag: ...
    @overload
    def __call__(self, ctype: Literal["kc_tbl_scratch_t"], /) -> KcTblScratch: ...
    @overload
    def __call__(self, ctype: Literal["kc_telemetry_t"], /) -> KcTelemetry: ...
    @overload
    def __call__(self, ctype: Literal["kc_term_t"], /) -> KcTerm: ...
    @overload
    def __call__(self, ctype: Literal["kc_terms_t"], /) -> KcTerms: ...
    @overload
    def __call__(self, ctype: Literal["kc_tried_t"], /) -> KcTried: ...
    @overload
    def __call__(self, ctype: Literal["kc_verdict_case_t"], /) -> KcVerdictCase: ...
    @overload
    def __call__(self, ctype: Literal["kc_verdict_fit_t"], /) -> KcVerdictFit: ...
    @overload
    def __call__(self, ctype: Literal["kc_view_t"], /) -> KcView: ...
    @overload
    def __call__(self, ctype: Literal["kc_volume_t"], /) -> KcVolume: ...
    @overload
    def __call__(self, ctype: Literal["kc_walk_t"], /) -> KcWalk: ...
    @overload
    def __call__(self, ctype: Literal["kc_work_t"], /) -> KcWork: ...
