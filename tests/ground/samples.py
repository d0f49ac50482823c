"""Made-up telemetry and results of the right shape, for tests without a flight process."""

import lcm
import numpy as np
from places import BIN

import kcm
from kincal.flight.tables import decode
from kincal.results import CoefResult, Criterion, Curve, HeldOut, PoseLine, RunResult, Scene
from kincal.review import kin_crc

CRC = 0xFEDCBA98  # does not fit a signed field: must survive the trip
NAMES = [f"J{j}.{k}" for j in range(1, 8) for k in ("phi_rad", "alpha_rad", "a_m", "d_m")]


def decided(entries) -> list:
    """Lines of a journal that are no attempts, and do not say how one failed."""
    return [e for e in entries if e.decision not in ("attempt", "refused", "unanswered")]


def signed(crc: int) -> int:
    return crc - (1 << 32) if crc >> 31 else crc


def proposal(verdict: int = 1, n_coef: int = 54) -> kcm.proposal_t:
    """28 estimated coefficients, the 27th held and confounded with the first, the rest masked."""
    p = kcm.proposal_t()
    rng = np.random.default_rng(2)
    A = rng.normal(size=(28, 28)) * 1e-4
    cov = np.zeros((64, 64))
    cov[:28, :28] = A @ A.T + 1e-8 * np.eye(28)
    cov[26, :] = cov[:, 26] = 0.0
    p.crc, p.session, p.verdict, p.n_poses, p.n_coef = signed(CRC), 3, verdict, 20, n_coef
    p.value = [*np.linspace(-0.02, 0.02, 28), *[0.0] * 36]
    p.sigma = list(np.sqrt(np.diag(cov)))
    p.status = [0] * 26 + [2, 0] + [1] * 36
    p.confounded = [0] * 64
    p.confounded[26] = 0b1
    packed = cov[:n_coef, :n_coef][np.triu_indices(n_coef)]
    p.cov = [*packed, *[0.0] * (2080 - len(packed))]
    p.rank, p.n_free, p.dof, p.chi2 = 27, 28, 93, 90.0
    p.noise_scale, p.p_fit, p.p_no_change, p.kkt, p.cond = 0.98, 0.57, 1e-9, 1e-12, 12.0
    p.fit_pos_m, p.fit_rot_rad, p.before_pos_m, p.before_rot_rad = 4e-4, 2e-3, 3e-2, 5e-2
    p.pred_pos_m, p.pred_rot_rad, p.crc_kin_before = 3e-4, 1e-3, 0x1234
    p.frame, p.pred_camera_pos_m, p.pred_camera_rot_rad = p.CAMERA, 3e-4, 1e-3
    p.pred_lander_pos_m, p.pred_lander_rot_rad = 9e-4, 2e-3
    p.pred_noise_pos_m, p.pred_noise_rot_rad = 1e-4, 5e-4
    p.ended, p.n_checked, p.confidence, p.bound_pos_m, p.bound_rot_rad = 1, 4, 0.9, 4e-4, 1.4e-3
    return sealed(p)


def sealed(p: kcm.proposal_t) -> kcm.proposal_t:
    """The same, as the description of the table that its CRC names: after a change of value, sigma, session
    or poses. The CRC of its arm makes up for that: a CRC is linear in each bit."""
    p.crc_arm = 0
    start = kin_crc(p)
    rows = []
    for bit in range(32):
        p.crc_arm = signed(1 << bit)
        rows.append((kin_crc(p) ^ start, 1 << bit))
    p.crc_arm, wanted = 0, start ^ (p.crc & 0xFFFFFFFF)
    solution = 0
    for bit in reversed(range(32)):  # Gauss
        at = next(i for i, (effect, _) in enumerate(rows) if effect >> bit & 1)
        effect, cause = rows.pop(at)
        rows = [(e ^ effect, c ^ cause) if e >> bit & 1 else (e, c) for e, c in rows]
        if wanted >> bit & 1:
            wanted, solution = wanted ^ effect, solution ^ cause
    p.crc_arm = signed(solution)
    return p


def shipped(p: kcm.proposal_t, values=None) -> kcm.proposal_t:
    """The same as a correction of the tables as shipped: with their CRCs and its own. values: of its
    coefficients, from the first."""
    for kind in ("arm", "terms"):
        image = decode((BIN / f"{kind}.tbl").read_bytes())[0]
        setattr(p, f"crc_{kind}", signed(image.crc))
    if values is not None:
        p.value = [*values, *[0.0] * (64 - len(values))]
    p.crc = signed(kin_crc(p))
    return p


def progress(pose: int, n_goal: int = 20) -> kcm.progress_t:
    m = kcm.progress_t()
    m.t_us, m.session, m.pose, m.n_goal, m.candidate, m.servo_steps = (
        1_000_000 * (pose + 1),
        3,
        pose + 1,  # counted from 1
        n_goal,
        7 * pose,
        2,
    )
    m.res_pos_m, m.res_rot_rad, m.f, m.pred_pos_m, m.pred_rot_rad = (
        0.1 / (pose + 1), 0.2 / (pose + 1), -0.5, 1e-3, 2e-3,
    )  # fmt: skip
    return m


def image(seq: int, jpeg: bytes = b"\xff\xd8\xff" + b"x" * 100) -> kcm.image_t:
    m = kcm.image_t()
    m.t_us, m.seq, m.width_px, m.height_px, m.n_bytes, m.jpeg = 1000 * seq, seq, 1920, 1080, len(jpeg), jpeg
    return m


def event(t_us: int, seq: int, number: int, severity: int, got: float = 0.0, index: int = -1) -> kcm.event_t:
    m = kcm.event_t()
    m.t_us, m.seq, m.id, m.severity, m.got, m.index = t_us, seq, number, severity, got, index
    return m


def write_log(path, damage: bool = True, verdict: int = 1, waiting: kcm.proposal_t | None = None) -> None:
    """Three poses, events, a proposal, housekeeping; a damaged message, an image, a foreign one. The proposal
    is in force at the end; one that is given waits."""
    log = lcm.EventLog(str(path), "w", overwrite=True)
    hk = kcm.hk_t()
    hk.t_us, hk.state, hk.boot_count = 9_000_000, 9, 2
    hk.table_crc[4] = signed(CRC) if waiting is None else 1
    ack = kcm.ack_t()
    ack.status, ack.event_id = -8, 13
    records = [
        ("KC_EVENT", event(500_000, 0, 1, 1, index=2)), ("KC_CMD", kcm.cmd_t()), ("KC_ACK", kcm.ack_t()),
        ("KC_ACK", ack), *[("KC_PROGRESS", progress(k)) for k in range(3)],
        ("KC_EVENT", event(3_500_000, 1, 64, 2, got=24.0, index=11)),
        ("KC_EVENT", event(3_600_000, 2, 48, 0)), ("KC_PROPOSAL", waiting or proposal(verdict)),
        ("KC_HK", hk),
    ]  # fmt: skip
    for t, (channel, message) in enumerate(records):
        log.write_event(t, channel, message.encode())
    if damage:
        log.write_event(90, "KC_HK", hk.encode()[:40])
    log.write_event(91, "KC_IMAGE", image(4).encode())
    log.write_event(92, "SOMETHING_ELSE", b"\1\2")
    log.close()


def result(ok: bool = True) -> RunResult:
    rng = np.random.default_rng(4)

    def lines(seed: int) -> tuple[PoseLine, ...]:
        r = np.random.default_rng(seed)
        held = 0.3 * np.exp(-np.linspace(0, 6, 20)) + 5e-4
        return tuple(
            PoseLine(
                i + 1, int(r.integers(300)), 2, tuple(r.uniform([0.3, -0.5, 0.1], [0.9, 0.5, 0.9])), held[i],
                held[i], -held[i], -0.1, 0.1, held[i] / 2, held[i], held[i], 2 * held[i], -held[i],
            )
            for i in range(20)
        )  # fmt: skip

    truth = {"J7.phi_rad": 1.3, "J2.alpha_rad": 0.4, "J3.a_m": 0.01, "J3.d_m": 0.15}
    coefs = []
    for n in NAMES:
        true, s = truth.get(n, 0.0), 2e-3 if n.endswith("rad") else 3e-4
        coefs.append(CoefResult(n, n.rsplit("_", 1)[1], true, true + s * rng.normal(), s, "estimated"))
    poses = lines(1)
    tips = np.array([p.tool_m for p in poses])
    arms = np.stack([np.zeros_like(tips), np.full_like(tips, 0.3), tips], axis=1)
    eye = np.array([-0.3, 0.45, 1.28])
    scene = Scene(
        rng.uniform(0.2, 0.9, (50, 3)), arms, np.array([[-0.35, 0.45, 0], [-0.35, 0.45, 1.25]]), eye,
        eye + np.array([[0.5, 0.3, -0.2], [0.5, -0.3, -0.2], [0.4, -0.3, -0.6], [0.4, 0.3, -0.6]]),
    )  # fmt: skip
    return RunResult(
        "Made-up <run>", "paper", "fast", 1, "ucb", 20, poses, tuple(coefs), HeldOut(200, 0.288, 1.36),
        HeldOut(200, 5e-4, 1e-3), "change proposed", CRC, CRC, "approved", 28, 28, 0.5, 0.0, 1.0,
        (Criterion("held-out position RMS", "0.50 mm", "<= 2.00 mm", ok),),
        (Curve("ucb, fast", poses), Curve("random, fast", lines(2))), scene, ("CAL_TAGS_LOST: & more",),
        400.0, 5.0,
    )  # fmt: skip
