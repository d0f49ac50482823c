"""Kinds of faults for the campaign of faults.py: each makes hooks of a run from its onset and random numbers.

A fault stands between flight and its surroundings and stays from its onset on, unless its text says more.
"""

from __future__ import annotations

import copy
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from kincal.link.channels import message_type
from kincal.run.inprocess import Hooks, Messages, command
from kincal_shared.keys import Key, Signer
from kincal_sim.mechanics.plant import turn
from kincal_sim.transforms import quaternion, rotation_matrix, transform

N_JOINTS = 7
NO_BIAS = np.zeros(N_JOINTS)
JOURNAL, KIN, PROPOSAL = 18, 4, 16  # kinds of the store
KEY = Key(1, bytes(range(32)))  # of every run
SECOND = 10  # ticks
DRIFT_TICKS = 400 * SECOND


@dataclass(frozen=True)
class Fault:
    """What one run suffers. slip_rad(tick): by how much the encoders read wrong then (n,) [rad];
    seen(tick): what happens then to every pose (4x4, in the camera's frame) that the camera sees."""

    hooks: Hooks
    slip_rad: Callable[[int], np.ndarray] = lambda _tick: NO_BIAS
    seen: Callable[[int], Callable[[np.ndarray], np.ndarray]] = lambda _tick: lambda T: T


def both(first: Fault, second: Fault) -> Fault:
    """Both in one run, the first one nearer to the surroundings."""
    a, b = first.hooks, second.hooks

    def keep(tick: int, kind: int, data: bytes) -> bytes | None:
        kept = b.keep(tick, kind, data)
        return None if kept is None else a.keep(tick, kind, kept)

    hooks = Hooks(
        to_flight=lambda tick, messages: b.to_flight(tick, a.to_flight(tick, messages)),
        from_flight=lambda tick, messages: a.from_flight(tick, b.from_flight(tick, messages)),
        clock=lambda tick, now_us: b.clock(tick, a.clock(tick, now_us)),
        keep=keep,
        power_loss=lambda tick: a.power_loss(tick) or b.power_loss(tick),
    )
    return Fault(
        hooks,
        slip_rad=lambda tick: first.slip_rad(tick) + second.slip_rad(tick),
        seen=lambda tick: lambda T: second.seen(tick)(first.seen(tick)(T)),
    )


Make = Callable[[int, np.random.Generator], Fault]


@dataclass(frozen=True)
class Kind:
    """name, what: for the table; events: one of them explains it to an operator; by: "flight", or "executive"
    where only the executive can notice, because its own link is broken."""

    name: str
    what: str
    make: Make
    events: tuple[str, ...] = ()
    by: str = "flight"


KINDS: list[Kind] = []


def kind(what: str, *events: str, by: str = "flight") -> Callable[[Make], Make]:
    """Register a kind under the name of its function."""

    def register(make: Make) -> Make:
        KINDS.append(Kind(make.__name__, what, make, events, by))
        return make

    return register


# ---- tools


def changed(channel: str, onset: int, change: Callable, until: int = 10**9) -> Callable:
    """Hook: a changed copy of every message of the channel; change(message, tick) works on the copy."""

    def hook(tick: int, messages: Messages) -> Messages:
        if not onset <= tick < until:
            return messages
        return tuple((ch, _copied(m, change, tick) if ch == channel else m) for ch, m in messages)

    return hook


def _copied(message, change: Callable, tick: int):
    m = copy.deepcopy(message)
    change(m, tick)
    return m


def setting(channel: str, onset: int, until: int = 10**9, **values) -> Callable:
    """Hook: fields with other values."""

    def change(m, _tick: int) -> None:
        for name, value in values.items():
            setattr(m, name, value)

    return changed(channel, onset, change, until)


def lost(channel: str, onset: int, until: int = 10**9) -> Callable:
    """Hook: messages of the channel do not arrive."""

    def hook(tick: int, messages: Messages) -> Messages:
        gone = onset <= tick < until
        return tuple(m for m in messages if not (gone and m[0] == channel))

    return hook


def late(channel: str, onset: int, ticks: int) -> Callable:
    """Hook: messages of the channel arrive later, stamps unchanged."""
    held: list = []

    def hook(tick: int, messages: Messages) -> Messages:
        if tick < onset:
            return messages
        held.extend((tick + ticks, m) for m in messages if m[0] == channel)
        due = [m for at, m in held if at <= tick]
        held[:] = [(at, m) for at, m in held if at > tick]
        return (*(m for m in messages if m[0] != channel), *due)

    return hook


def frozen(channel: str, onset: int, *names: str) -> Callable:
    """Hook: fields keep the values they had at the onset; without names the whole message."""
    kept: list = []

    def change(m, _tick: int) -> None:
        if not kept:
            kept.append(copy.deepcopy(m))
        for name in names or m.__slots__:
            setattr(m, name, getattr(kept[0], name))

    return changed(channel, onset, change)


def sent(onset: int, *commands, every: int = 0, key: Key | None = KEY) -> Callable:
    """Hook: other commands arrive too, once at the onset or every so many ticks, signed with a key or (None)
    not."""
    first = command("NOOP", source="GROUND").seq

    def hook(tick: int, messages: Messages) -> Messages:
        again = every and tick > onset and (tick - onset) % every == 0
        if tick != onset and not again:
            return messages
        extra = []
        for k, c in enumerate(commands):
            m = copy.deepcopy(c)
            m.t_us, m.seq = (tick - 1) * 100_000, first + (tick - onset) * len(commands) + k
            if key is not None:
                signed_at(m.seq, key).command(m)
            extra.append(("KC_CMD", m))
        return (*messages, *extra)

    return hook


def signed_at(counter: int, key: Key = KEY) -> Signer:
    """A signer whose counter follows from the tick, since hooks have no memory."""
    return Signer(key, lambda _source: counter)


def by_ground(opcode: str, *arg_i: int):
    """A command of the ground."""
    return command(opcode, *arg_i, source="GROUND")


def to_flight(hook: Callable) -> Fault:
    """A fault on the way to flight."""
    return Fault(Hooks(to_flight=hook))


def from_flight(hook: Callable) -> Fault:
    """A fault on the way from flight."""
    return Fault(Hooks(from_flight=hook))


ARM, PANTILT, DET = "KC_ARM_STATE", "KC_PANTILT_STATE", "KC_DETECTION"
STOPS = ("CAL_ABORTED", "IN_SILENT")
LATE = ("CAL_MOVE_TIMEOUT", "CAL_ABORTED")
BAD_FIT = (
    *("CAL_MODEL_MISMATCH", "CAL_POOR", "CAL_OUTLIER", "CAL_TAGS_NOT_DETECTED", "CAL_TAGS_LOST", "CAL_RANK"),
    *("CAL_SERVO_LIMIT", "DET_JUMP", *LATE),
)

# ---- arm


@kind("no arm messages any more", *STOPS)
def arm_silent(t, _rng):
    return to_flight(lost(ARM, t))


@kind("no arm messages for 0.5 s")
def arm_gap(t, _rng):
    return to_flight(lost(ARM, t, t + 5))


@kind("the last arm message again and again", "IN_STALE", *STOPS)
def arm_repeated(t, _rng):
    return to_flight(frozen(ARM, t))


@kind("encoders of all joints stand still", "CAL_ABORTED", *BAD_FIT)
def encoders_frozen(t, _rng):
    return to_flight(frozen(ARM, t, "q_rad", "dq_rad_s"))


@kind("the encoder of one joint stands still", "CAL_ABORTED", *BAD_FIT)
def encoder_frozen(t, rng):
    joint, kept = rng.integers(N_JOINTS), []

    def change(m, _tick):
        kept.append(m.q_rad[joint])
        m.q_rad[joint] = kept[0]

    return to_flight(changed(ARM, t, change))


@kind("a joint reading is not a number", "IN_RANGE", *STOPS)
def encoder_nan(t, rng):
    joint = rng.integers(N_JOINTS)
    return to_flight(changed(ARM, t, lambda m, _: m.q_rad.__setitem__(joint, float("nan"))))


@kind("a joint reading beyond all limits, one message in three", "IN_RANGE")
def encoder_spikes(t, rng):
    joint = rng.integers(N_JOINTS)
    return to_flight(changed(ARM, t, lambda m, k: m.q_rad.__setitem__(joint, 50.0) if k % 3 == 0 else None))


def _slip(t, slip_rad: Callable[[int], np.ndarray]):
    """From the first move after the onset on; the controller closes its loop on what the encoder reads, and
    holds the arm where it stands between moves."""
    moves: list[int] = []

    def read(m, _tick):
        if moves:
            slip = [*slip_rad(moves[-1]), 0.0]
            for name in ("q_rad", "q_cmd_rad"):
                setattr(m, name, [q + b for q, b in zip(getattr(m, name), slip, strict=True)])

    def moved(m, tick):
        moves.append(tick)
        m.q_rad = [q - b for q, b in zip(m.q_rad, [*slip_rad(tick), 0.0], strict=True)]

    hooks = Hooks(to_flight=changed(ARM, t, read), from_flight=changed("KC_ARM_CMD", t, moved))
    return Fault(hooks, slip_rad=slip_rad)


def _one_joint(size_rad, rng):
    return size_rad * np.eye(N_JOINTS)[rng.integers(N_JOINTS)]


@kind("an encoder drifts by 10 mrad in 400 s, the controller goes by it", *BAD_FIT)
def encoder_drifts(t, rng):
    size = _one_joint(0.010, rng)
    return _slip(t, lambda tick: size * max(0, tick - t) / DRIFT_TICKS)


@kind("an encoder slips by 30 mrad, the controller goes by it", *BAD_FIT)
def encoder_slips_30_mrad(t, rng):
    size = _one_joint(0.03, rng)
    return _slip(t, lambda _tick: size)


@kind("an encoder slips by 300 mrad, the controller goes by it", *BAD_FIT)
def encoder_slips_300_mrad(t, rng):
    size = _one_joint(0.3, rng)
    return _slip(t, lambda _tick: size)


class LastPoses:
    """Hook that looks: since when at most so many poses are to come, as flight's progress says."""

    def __init__(self, to_come: int) -> None:
        self.to_come, self.tick = to_come, None

    def __call__(self, tick: int, messages: Messages) -> Messages:
        for channel, m in messages:
            if self.tick is None and channel == "KC_PROGRESS" and m.pose >= m.n_goal - self.to_come:
                self.tick = tick + 1
        return messages

    def began(self, tick: int) -> bool:
        """Whether they have begun."""
        return self.tick is not None and tick >= self.tick


@kind("an encoder slips by 30 mrad before one of the last three poses", "CAL_CHANGED", *BAD_FIT)
def encoder_slips_at_the_end(_t, rng):
    size, last = _one_joint(0.03, rng), LastPoses(int(rng.integers(1, 4)))
    slip = _slip(0, lambda tick: size if last.began(tick) else NO_BIAS)
    moved = slip.hooks.from_flight
    hooks = Hooks(slip.hooks.to_flight, lambda tick, messages: moved(tick, last(tick, messages)))
    return Fault(hooks, slip_rad=slip.slip_rad)


@kind("readings of all joints with 5 mrad of noise", *BAD_FIT)
def encoder_noise(t, rng):
    noise = rng.normal(0.0, 5e-3, (997, 8))
    return to_flight(
        changed(ARM, t, lambda m, k: setattr(m, "q_rad", (np.array(m.q_rad) + noise[k % 997]).tolist()))
    )


@kind("sequence numbers of the arm begin again", "IN_JUMP")
def arm_restarted(t, _rng):
    return to_flight(changed(ARM, t, lambda m, k: setattr(m, "seq", k - t + 1)))


@kind("stamps of the arm an hour old", "IN_RANGE", *STOPS)
def arm_old(t, _rng):
    return to_flight(changed(ARM, t, lambda m, _: setattr(m, "t_us", m.t_us - 3_600_000_000)))


@kind("stamps of the arm a second ahead", "IN_RANGE", *STOPS)
def arm_ahead(t, _rng):
    return to_flight(changed(ARM, t, lambda m, _: setattr(m, "t_us", m.t_us + 1_000_000)))


@kind("arm messages with six joints", "IN_COUNT", *STOPS)
def arm_of_six_joints(t, _rng):
    return to_flight(setting(ARM, t, n_joints=6))


@kind("arm messages with -1 joints", "IN_COUNT", *STOPS)
def arm_of_minus_one_joint(t, _rng):
    return to_flight(setting(ARM, t, n_joints=-1))


@kind("fault bit of the arm controller in one message", "ARM_FAULT", "CAL_ABORTED")
def arm_fault(t, _rng):
    return to_flight(setting(ARM, t, t + 1, fault_mask=4))


@kind("a fault bit in a message that is otherwise wrong", "ARM_FAULT", "CAL_ABORTED")
def arm_fault_in_a_bad_message(t, rng):
    joint = rng.integers(N_JOINTS)

    def change(m, _tick):
        m.fault_mask = 4
        m.q_rad[joint], m.temp_c = float("nan"), 1e6

    return to_flight(changed(ARM, t, change, t + 1))


@kind("the arm says that it moves, always", *LATE)
def arm_always_moves(t, _rng):
    return to_flight(setting(ARM, t, moving=1))


@kind("the arm says that it rests, always", *BAD_FIT)
def arm_never_moves(t, _rng):
    return to_flight(setting(ARM, t, moving=0, dq_rad_s=[0.0] * 8))


@kind("temperature of the arm beyond all limits", "IN_RANGE", *STOPS)
def arm_too_hot(t, _rng):
    return to_flight(setting(ARM, t, temp_c=1e6))


@kind("negative mass in the scoop", "IN_RANGE", *STOPS)
def arm_payload_negative(t, _rng):
    return to_flight(setting(ARM, t, payload_kg=-1.0))


@kind("gravity that is not a number", "IN_RANGE", *STOPS)
def arm_gravity_nan(t, _rng):
    return to_flight(setting(ARM, t, g_m_s2=[float("nan")] * 3))


@kind("every arm message twice")
def arm_twice(t, _rng):
    def hook(tick, messages):
        again = tuple(m for m in messages if m[0] == ARM and tick >= t)
        return (*messages, *again)

    return to_flight(hook)


@kind("arm commands do not arrive", *LATE)
def arm_commands_lost(t, _rng):
    return from_flight(lost("KC_ARM_CMD", t))


@kind("one arm command in three does not arrive", *LATE)
def arm_commands_lost_in_part(t, rng):
    drop = rng.random(997) < 0.33

    def hook(tick, messages):
        return tuple(m for m in messages if not (tick >= t and m[0] == "KC_ARM_CMD" and drop[tick % 997]))

    return from_flight(hook)


@kind("arm commands arrive a second late", *BAD_FIT)
def arm_commands_late(t, _rng):
    return from_flight(late("KC_ARM_CMD", t, SECOND))


@kind("the arm moves at a tenth of its speed", *LATE)
def arm_slow(t, _rng):
    return from_flight(changed("KC_ARM_CMD", t, lambda m, _: setattr(m, "speed_scale", 0.1 * m.speed_scale)))


# ---- pan-tilt unit


@kind("no pan-tilt messages any more", *STOPS)
def pantilt_silent(t, _rng):
    return to_flight(lost(PANTILT, t))


@kind("pan and tilt readings stand still", *BAD_FIT)
def pantilt_frozen(t, _rng):
    return to_flight(frozen(PANTILT, t, "pan_rad", "tilt_rad"))


@kind("the pan reading is not a number", "IN_RANGE", *STOPS)
def pantilt_nan(t, _rng):
    return to_flight(setting(PANTILT, t, pan_rad=float("nan")))


@kind("the tilt encoder slips by 20 mrad, the controller does not go by it", *BAD_FIT)
def tilt_slips(t, _rng):
    return to_flight(changed(PANTILT, t, lambda m, _: setattr(m, "tilt_rad", m.tilt_rad + 0.02)))


@kind("the pan-tilt unit says that it moves, always", *LATE)
def pantilt_always_moves(t, _rng):
    return to_flight(setting(PANTILT, t, moving=1))


@kind("pan-tilt commands do not arrive", "CAL_TAGS_LOST", "CAL_TAGS_NOT_DETECTED", *LATE)
def pantilt_commands_lost(t, _rng):
    return from_flight(lost("KC_PANTILT_CMD", t))


# ---- camera and tags


@kind("no detections any more", "CAL_FRAME_TIMEOUT", "CAL_ABORTED")
def detections_lost(t, _rng):
    return to_flight(lost(DET, t))


@kind("one detection in three is lost", "CAL_FRAME_TIMEOUT")
def detections_lost_in_part(t, rng):
    drop = rng.random(997) < 0.33

    def hook(tick, messages):
        return tuple(m for m in messages if not (tick >= t and m[0] == DET and drop[tick % 997]))

    return to_flight(hook)


@kind("frame requests do not arrive", "CAL_FRAME_TIMEOUT", "CAL_ABORTED")
def frame_requests_lost(t, _rng):
    return from_flight(lost("KC_FRAME_REQUEST", t))


@kind("no tag in any frame", "CAL_TAGS_LOST", "CAL_TAGS_NOT_DETECTED", "CAL_NO_CANDIDATE")
def tags_hidden(t, _rng):
    return to_flight(setting(DET, t, n_tags=0))


@kind("detections a minute late", "CAL_FRAME_TIMEOUT", "DET_OLD", "DET_UNREQUESTED")
def detections_late(t, _rng):
    return to_flight(late(DET, t, 60 * SECOND))


@kind("every detection twice", "DET_UNREQUESTED")
def detections_twice(t, _rng):
    def hook(tick, messages):
        return (*messages, *(m for m in messages if m[0] == DET and tick >= t))

    return to_flight(hook)


@kind("detections of frames that nobody requested", "DET_UNREQUESTED")
def detections_unrequested(t, _rng):
    return to_flight(changed(DET, t, lambda m, _: setattr(m, "seq", m.seq + 1000)))


@kind("a tag position that is not a number", "IN_RANGE")
def detection_nan(t, _rng):
    return to_flight(setting(DET, t, p_cam_tool_m=[float("nan")] * 3))


@kind("a quaternion of norm 2", "IN_NOT_UNIT")
def detection_not_unit(t, _rng):
    return to_flight(
        changed(DET, t, lambda m, _: setattr(m, "q_cam_tool_wxyz", [2.0 * x for x in m.q_cam_tool_wxyz]))
    )


@kind("a covariance of zeros", "IN_RANGE")
def covariance_zero(t, _rng):
    return to_flight(setting(DET, t, cov=[0.0] * 21))


@kind("a covariance with negative variances", "IN_RANGE")
def covariance_negative(t, _rng):
    return to_flight(changed(DET, t, lambda m, _: setattr(m, "cov", [-x for x in m.cov])))


@kind("a covariance a million times too small", *BAD_FIT)
def covariance_too_small(t, _rng):
    return to_flight(changed(DET, t, lambda m, _: setattr(m, "cov", [1e-6 * x for x in m.cov])))


@kind("an unknown tag", "DET_UNKNOWN_TAG")
def tag_unknown(t, _rng):
    return to_flight(setting(DET, t, tag_id=[99, 98, 97, 96]))


@kind("99 tags in one detection", "IN_RANGE")
def tags_99(t, _rng):
    return to_flight(setting(DET, t, n_tags=99))


def _moved(m, offset_m) -> None:
    m.p_cam_tool_m = [p + d for p, d in zip(m.p_cam_tool_m, offset_m, strict=True)]


@kind("one detection in ten is 50 mm off", "DET_JUMP", *BAD_FIT)
def detections_outliers(t, rng):
    wild, offset = rng.random(997) < 0.1, rng.normal(0.0, 0.03, (997, 3))
    return to_flight(changed(DET, t, lambda m, k: _moved(m, offset[k % 997]) if wild[k % 997] else None))


def _camera(t, motion: Callable[[int], tuple[np.ndarray, np.ndarray]]):
    """The camera moves: all that it sees is turned about its centre and shifted. motion(ticks since the
    onset): rotation vector [rad], offset [m]."""

    def seen(tick: int):
        turn_rad, offset_m = motion(max(0, tick - t))
        M = transform(offset_m, turn(turn_rad))
        return lambda T: M @ T

    def change(m, tick):
        for p, q in (("p_cam_tool_m", "q_cam_tool_wxyz"), ("p_alt_m", "q_alt_wxyz")):
            T = seen(tick)(transform(np.array(getattr(m, p)), rotation_matrix(getattr(m, q))))
            setattr(m, p, T[:3, 3].tolist())
            setattr(m, q, quaternion(T).tolist())

    return Fault(Hooks(to_flight=changed(DET, t, change)), seen=seen)


def _direction(rng, size):
    v = rng.normal(size=3)
    return size * v / np.linalg.norm(v)


NONE = np.zeros(3)
KNOCKED = ("DET_JUMP", *BAD_FIT)


@kind("the camera is knocked: all detections 20 mm off", *KNOCKED)
def camera_knocked_20_mm(t, rng):
    offset = _direction(rng, 0.020)
    return _camera(t, lambda _since: (NONE, offset))


@kind("the camera is knocked: all detections 3 mm off", *KNOCKED)
def camera_knocked_3_mm(t, rng):
    offset = _direction(rng, 0.003)
    return _camera(t, lambda _since: (NONE, offset))


@kind("the camera is knocked by 8 mm before one of the last three poses", "CAL_CHANGED", *KNOCKED)
def camera_knocked_at_the_end(_t, rng):
    offset, last = _direction(rng, 0.008), LastPoses(int(rng.integers(1, 4)))
    knocked = _camera(0, lambda tick: (NONE, offset if last.began(tick) else NONE))
    return Fault(Hooks(knocked.hooks.to_flight, last), seen=knocked.seen)


@kind("the camera is knocked: turned by 5 mrad", *KNOCKED)
def camera_turned_5_mrad(t, rng):
    turned = _direction(rng, 0.005)
    return _camera(t, lambda _since: (turned, NONE))


@kind("the camera is 5 mrad off in tilt, from the beginning", *KNOCKED)
def tilt_off_5_mrad(_t, rng):
    tilted = np.array([0.005 * rng.choice([-1.0, 1.0]), 0.0, 0.0])
    return _camera(0, lambda _since: (tilted, NONE))


@kind("the camera drifts by 3 mm in 400 s", *KNOCKED)
def camera_drifts_3_mm(t, rng):
    drift = _direction(rng, 0.003)
    return _camera(t, lambda since: (NONE, drift * since / DRIFT_TICKS))


@kind("the camera drifts by 20 mm in 400 s", *KNOCKED)
def camera_drifts_20_mm(t, rng):
    drift = _direction(rng, 0.020)
    return _camera(t, lambda since: (NONE, drift * since / DRIFT_TICKS))


@kind("the camera turns by 5 mrad in 400 s", *KNOCKED)
def camera_turns_slowly(t, rng):
    drift = _direction(rng, 0.005)
    return _camera(t, lambda since: (drift * since / DRIFT_TICKS, NONE))


@kind("the plate with the tags is 3 mm off, from the beginning", *KNOCKED)
def tag_plate_3_mm(_t, rng):
    offset = _direction(rng, 0.003)
    return to_flight(changed(DET, 0, lambda m, _: _moved(m, rotation_matrix(m.q_cam_tool_wxyz) @ offset)))


@kind("the tags look smaller and smaller, 1 % in 400 s", *KNOCKED)
def tags_shrink(t, _rng):
    def change(m, tick):
        m.p_cam_tool_m = [(1.0 + 0.01 * (tick - t) / DRIFT_TICKS) * x for x in m.p_cam_tool_m]

    return to_flight(changed(DET, t, change))


@kind("the tags look 2 % smaller than they are (a lens fogs up)", "DET_JUMP", *BAD_FIT)
def tags_seem_small(t, _rng):
    return to_flight(
        changed(DET, t, lambda m, _: setattr(m, "p_cam_tool_m", [1.02 * x for x in m.p_cam_tool_m]))
    )


@kind("the detector repeats its last pose under new numbers", "DET_JUMP", *BAD_FIT)
def detector_frozen(t, _rng):
    return to_flight(
        frozen(DET, t, "p_cam_tool_m", "q_cam_tool_wxyz", "p_alt_m", "q_alt_wxyz", "u_px", "v_px")
    )


@kind("detections with four times the noise that they state", *BAD_FIT)
def detections_noisy(t, rng):
    noise = rng.normal(0.0, 1.0, (997, 3))

    def change(m, k):
        _moved(m, 4.0 * np.sqrt(np.abs(np.array(m.cov)[[0, 6, 11]])) * noise[k % 997])

    return to_flight(changed(DET, t, change))


@kind("the noise of detections grows fourfold in 200 s, what they state does not", *BAD_FIT)
def detections_noisier_and_noisier(t, rng):
    noise = rng.normal(0.0, 1.0, (997, 3))

    def change(m, k):
        times = min(4.0, 4.0 * (k - t) / (200 * SECOND))
        _moved(m, times * np.sqrt(np.abs(np.array(m.cov)[[0, 6, 11]])) * noise[k % 997])

    return to_flight(changed(DET, t, change))


@kind("one detection in three is lost, and the camera is knocked by 3 mm", "CAL_FRAME_TIMEOUT", *KNOCKED)
def detections_lost_and_camera_knocked(t, rng):
    drop, knocked = rng.random(997) < 0.33, camera_knocked_3_mm(t, rng)

    def hook(tick, messages):
        messages = knocked.hooks.to_flight(tick, messages)
        return tuple(m for m in messages if not (tick >= t and m[0] == DET and drop[tick % 997]))

    return Fault(Hooks(to_flight=hook), seen=knocked.seen)


# ---- commands and tables


@kind("the ground floods flight with 20 NOOP a second")
def command_flood(t, _rng):
    return to_flight(sent(t, by_ground("NOOP"), by_ground("NOOP"), every=1))


@kind("the ground sends ABORT by mistake", "CAL_ABORTED")
def abort_by_mistake(t, _rng):
    return to_flight(sent(t, by_ground("ABORT")))


@kind("the ground sends START during the calibration", "CMD_STATE")
def start_again(t, _rng):
    return to_flight(sent(t, by_ground("START", -1, 0, 1)))


@kind("the ground approves what does not exist", "CMD_STATE", "CMD_CRC")
def approval_by_mistake(t, _rng):
    return to_flight(sent(t, by_ground("APPROVE_ARM", 12345), by_ground("APPROVE_GO", 12345)))


@kind("the ground sends ROLLBACK during the calibration", "CMD_STATE", "COR_NO_PREVIOUS")
def rollback_by_mistake(t, _rng):
    return to_flight(sent(t, by_ground("ROLLBACK")))


@kind("a command with an unknown opcode", "CMD_UNKNOWN")
def command_unknown(t, _rng):
    c = by_ground("NOOP")
    c.opcode = 4711
    return to_flight(sent(t, c))


@kind("a command of an unknown source", "CMD_SOURCE")
def command_of_nobody(t, _rng):
    c = by_ground("NOOP")
    c.source = 77
    return to_flight(sent(t, c))


@kind("a stranger without a key sends every command that changes anything", "CMD_UNSIGNED")
def commands_unsigned(t, _rng):
    opcodes = ("START", "APPROVE_ARM", "APPROVE_GO", "REJECT", "ROLLBACK", "TABLE_DISCARD", "TABLE_ACTIVATE")
    return to_flight(sent(t, *(by_ground(opcode, KIN) for opcode in opcodes), key=None))


@kind("a stranger with another key sends REJECT and ROLLBACK every second", "CMD_FORGED")
def commands_forged(t, _rng):
    stranger = Key(KEY.id, bytes(32))
    return to_flight(sent(t, by_ground("REJECT"), by_ground("ROLLBACK"), every=SECOND, key=stranger))


@kind("what the executive sends is sent once more a second later", "CMD_REPLAYED")
def commands_repeated(_t, _rng):
    kept: dict = {}

    def hook(tick, messages):
        kept[tick] = [copy.deepcopy(m) for channel, m in messages if channel == "KC_CMD"]
        return (*messages, *(("KC_CMD", m) for m in kept.get(tick - SECOND, ())))

    return to_flight(hook)


@kind("the executive's signatures are damaged on their way", "CMD_FORGED", by="executive")
def signatures_damaged(t, _rng):
    def change(m, _tick: int) -> None:
        m.mac = [m.mac[0] ^ 1, m.mac[1]]

    return to_flight(changed("KC_CMD", t, change))


@kind("TABLE_ACTIVATE during the calibration", "TBL_BUSY", "TBL_NOT_READY", "CMD_STATE")
def activate_during_calibration(t, _rng):
    return to_flight(sent(t, by_ground("TABLE_ACTIVATE", KIN, 12345)))


@kind("chunks of random bytes as a table", "TBL_BUSY", "TBL_CHUNK", "TBL_FORMAT", "TBL_CRC")
def table_of_random_bytes(t, rng):
    data = rng.bytes(1024)

    def hook(tick, messages):
        if tick != t:
            return messages
        m = message_type("table_chunk_t")()
        m.t_us, m.kind, m.total_bytes, m.offset, m.n, m.data = (t - 1) * 100_000, KIN, 1024, 0, 1024, data
        m.source = 2
        return (*messages, ("KC_TABLE_UP", signed_at(t).chunk(m)))

    return to_flight(hook)


@kind("the executive's commands are lost", by="executive")
def commands_lost(t, _rng):
    return to_flight(lost("KC_CMD", t))


@kind("flight's answers are lost", by="executive")
def answers_lost(t, _rng):
    return from_flight(lost("KC_ACK", t))


@kind("housekeeping is lost", by="executive")
def housekeeping_lost(t, _rng):
    return from_flight(lost("KC_HK", t))


@kind("the proposal is lost", by="executive")
def proposal_lost(_t, _rng):
    return from_flight(lost("KC_PROPOSAL", 0))


@kind("a bit of the proposed CRC flips on the way to the executive", "CMD_CRC")
def proposal_damaged(_t, rng):
    bit = 1 << int(rng.integers(30))
    return from_flight(changed("KC_PROPOSAL", 0, lambda m, _: setattr(m, "crc", m.crc ^ bit)))


# ---- time


def _clock(step: Callable[[int, int], int]) -> Fault:
    return Fault(Hooks(clock=step))


@kind("flight's clock jumps an hour ahead", "TIME_STEP")
def clock_ahead(t, _rng):
    return _clock(lambda tick, now_us: now_us + (3_600_000_000 if tick >= t else 0))


@kind("flight's clock jumps 20 s back", "TIME_STEP")
def clock_back(t, _rng):
    return _clock(lambda tick, now_us: now_us - (20_000_000 if tick >= t else 0))


@kind("flight's clock stands still", "TIME_STEP", "IN_RANGE", *STOPS)
def clock_stopped(t, _rng):
    return _clock(lambda _tick, now_us: min(now_us, t * 100_000))


@kind("flight's clock advances by a microsecond in each tick", "TIME_SLOW", "IN_RANGE", *STOPS)
def clock_creeps(t, _rng):
    return _clock(lambda tick, now_us: min(now_us, t * 100_000 + max(0, tick - t)))


@kind("flight's clock runs at a tenth of the speed", "TIME_SLOW", "IN_RANGE", *STOPS)
def clock_slow(t, _rng):
    return _clock(lambda tick, now_us: now_us - 90_000 * max(0, tick - t))


@kind("flight's clock runs at twice the speed", "TIME_STEP", "IN_RANGE", *STOPS)
def clock_fast(t, _rng):
    return _clock(lambda tick, now_us: now_us + max(0, tick - t) * 100_000)


@kind("flight's clock jumps a second ahead for one tick", "TIME_STEP")
def clock_spike(t, _rng):
    return _clock(lambda tick, now_us: now_us + (1_000_000 if tick == t else 0))


# ---- memory and power


@kind("the store refuses to write", "STORE_FAIL")
def store_refuses(t, _rng):
    return Fault(Hooks(keep=lambda tick, _kind, data: data if tick < t else None))


@kind("the store refuses to write a correction", "STORE_REFUSED")
def correction_refused(_t, _rng):
    return Fault(Hooks(keep=lambda _tick, k, data: None if k == KIN else data))


@kind("the store refuses to write every other second", "STORE_FAIL")
def store_refuses_often(_t, _rng):
    return Fault(Hooks(keep=lambda tick, _kind, data: None if tick % 20 < 10 else data))


@kind("power is lost", "BOOT_INTERRUPTED")
def power_lost(t, _rng):
    return Fault(Hooks(power_loss=lambda tick: tick == t))


@kind("power is lost three times in two seconds", "BOOT_INTERRUPTED")
def power_lost_three_times(t, _rng):
    return Fault(Hooks(power_loss=lambda tick: tick in (t, t + 7, t + 20)))


def _damaged(data: bytes) -> bytes:
    return data[:-1] + bytes([data[-1] ^ 1]) if data else data


@kind("what is stored is damaged, then power is lost", "BOOT_SLOT_BAD", "BOOT_INTERRUPTED")
def store_damaged(t, _rng):
    return Fault(Hooks(keep=lambda _tick, _kind, data: _damaged(data), power_loss=lambda tick: tick == t))


@kind("the journal cannot be written, then power is lost", "STORE_FAIL", "BOOT_INTERRUPTED")
def journal_refused(t, _rng):
    return Fault(
        Hooks(
            keep=lambda tick, k, data: None if k == JOURNAL and tick > 10 else data,
            power_loss=lambda tick: tick == t,
        )
    )


def _power_lost_after(channel: str) -> Fault:
    """Power is lost in the tick after the first message of a channel."""
    heard: list[int] = []

    def hook(tick: int, messages: Messages) -> Messages:
        if any(ch == channel for ch, _ in messages):
            heard.append(tick)
        return messages

    return Fault(Hooks(from_flight=hook, power_loss=lambda tick: bool(heard) and tick == heard[0] + 1))


@kind("power is lost just after the proposal", "BOOT_REVIEW")
def power_lost_in_review(_t, _rng):
    return _power_lost_after("KC_PROPOSAL")


@kind("power is lost just after the first measurement", "BOOT_INTERRUPTED")
def power_lost_after_measurement(_t, _rng):
    return _power_lost_after("KC_MEAS")
