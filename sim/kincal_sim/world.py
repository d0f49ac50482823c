"""The simulated world: arm, pan-tilt unit and camera on one clock. Messages in, messages out; no LCM."""

from __future__ import annotations

import operator
from collections import Counter
from collections.abc import Callable
from typing import Any

import numpy as np

import kcm

from .mechanics.motion import ArmController, PanTiltController
from .mechanics.plant import AtRest, Conditions
from .randomness import generator
from .scenario import Scenario
from .transforms import quaternion
from .truth import build_plant, conditions
from .vision.imagers import Exposure, Imager, MakeImager, Message, fast_imager

TRUTH_PERIOD_US = 1_000_000
JOINT_SLOTS = 8  # entries of a joint vector in a message
# Commands of one tick are handled in this order, then by sequence number.
ORDER = ("KC_ARM_CMD", "KC_PANTILT_CMD", "KC_FRAME_REQUEST")


def _slots(values: np.ndarray) -> list[float]:
    """A joint vector as messages carry it, filled up with zeros."""
    return values.tolist() + [0.0] * (JOINT_SLOTS - len(values))


class _Listed:
    """A list of an array's values, made when it is another array than last time."""

    def __init__(self, make: Callable[[np.ndarray], list] = _slots) -> None:
        self._make, self._of = make, np.empty(0)
        self._values: list = []

    def of(self, array: np.ndarray) -> list:
        """The list; messages share it."""
        if array is not self._of:
            self._of, self._values = array, self._make(array)
        return self._values


class World:
    """The plant of a scenario, its controllers and its imager (see imagers.py) on one clock.

    seed: of all noise; make_imager: one of the functions of imagers.py.
    contacts: pairs of shapes that touched, each with the seconds of mission time in which they did.
    last_motion_us: when arm or pan-tilt unit were last seen moving; -1 = never.

    What the sensors read after advance(); arrays are never changed in place: q_rad, dq_rad_s (n,), arm_moves,
    pantilt_rad (2,), pantilt_moves; seq: number of their messages.
    """

    def __init__(self, scenario: Scenario, seed: int, make_imager: MakeImager):
        self.scenario, self.seed = scenario, seed
        self.plant = build_plant(scenario, pictures=make_imager is not fast_imager)
        self._payload_kg = scenario.env.payload_kg
        self.arm = self.plant.arm(self._payload_kg)
        self.controller = ArmController(self.arm.spec)
        self.pantilt = PanTiltController(self.arm.spec)
        self.imager: Imager = make_imager(scenario, self.arm, seed)
        self.now_us: int | None = None
        self.last_motion_us = -1
        self.contacts: Counter[str] = Counter()
        self._encoder_rng = generator(seed, "encoders")
        self._commands: list[tuple[str, Any]] = []
        self._requested_frames: list[int] = []
        self.seq = 0
        self._next_truth_us = 0
        # The last answer of settle(), what was asked, where the arm stood then; and what touches there.
        self._true: AtRest | None = None
        self._asked: tuple[Any, ...] = ()
        self._asked_of: tuple[Any, ...] = ()
        self._stands = b""
        self._contacts_at: tuple[AtRest | None, list[str]] = None, []
        self.q_rad = self.dq_rad_s = self.pantilt_rad = np.empty(0)
        self.arm_moves = self.pantilt_moves = False
        self._encoders = np.empty(0)  # readings without noise
        self._noise_rad, self._step_rad = scenario.arm.encoder_noise_rad, scenario.arm.encoder_step_rad
        self._q, self._dq, self._q_cmd = _Listed(), _Listed(), _Listed()
        self._dir = _Listed(lambda d: d.tolist() + [0] * (JOINT_SLOTS - len(d)))
        self.gravity_m_s2 = [float(g) for g in scenario.env.gravity_m_s2]

    def receive(self, channel: str, message: Any) -> None:
        """A command from flight; carried out when time next moves."""
        self._commands.append((channel, message))

    def step(self, now_us: int) -> list[tuple[str, Message]]:
        """Carry out what was commanded, let time pass until now_us, and give the sensor messages."""
        self.advance(now_us)
        return [*self.states(), *self.observe()]

    def advance(self, now_us: int) -> None:
        """The first part of a step: time passes, and everything moves."""
        self.execute_commands(self.now_us if self.now_us is not None else now_us)
        self.now_us = now_us
        self.seq += 1
        t_s = now_us * 1e-6
        q, self.dq_rad_s, self.arm_moves = self.controller.trajectory.at(t_s)
        self.pantilt_rad, _, self.pantilt_moves = self.pantilt.trajectory.at(t_s)
        if self.arm_moves or self.pantilt_moves:
            self.last_motion_us = now_us
        if q is not self._encoders or self._noise_rad:
            self._encoders, self.q_rad = q, self._readings(q)

    def states(self) -> list[tuple[str, Message]]:
        """The second: what the encoders of arm and pan-tilt unit read."""
        return [("KC_ARM_STATE", self._arm_state()), ("KC_PANTILT_STATE", self._pantilt_state())]

    def observe(self) -> list[tuple[str, Message]]:
        """The last: frames that were requested, and the truth once a second."""
        frames, truth_due = self.watch()
        return [*frames, self.truth()] if truth_due else frames

    def watch(self) -> tuple[list[tuple[str, Message]], bool]:
        """observe() with truth() left to the caller: the frames, and whether the truth is due. What touches
        then is noted."""
        now_us = self.now_us or 0
        frames: list[tuple[str, Message]] = []
        if self._requested_frames:
            frames = self._take_frames(now_us, self.settle(self._encoders, self.pantilt_rad))
        truth_due = now_us >= self._next_truth_us
        if truth_due:
            self._next_truth_us = now_us - now_us % TRUTH_PERIOD_US + TRUTH_PERIOD_US
            self._note_contacts()
        return frames, truth_due

    def _note_contacts(self) -> None:
        true = None
        if self.arm_moves or self.pantilt_moves:  # to another place each time
            self.stand(self._encoders, self.pantilt_rad)
        else:
            true = self.settle(self._encoders, self.pantilt_rad)
        if true is None or true is not self._contacts_at[0]:
            self._contacts_at = true, sorted({" - ".join(pair) for pair in self.arm.collisions()})
        if self._contacts_at[1]:
            self.contacts.update(self._contacts_at[1])

    def truth(self) -> tuple[str, Message]:
        """Where the arm truly is now."""
        return "KC_SIM_TRUTH", self._sim_truth(self.settle(self._encoders, self.pantilt_rad))

    def execute_commands(self, t_us: int) -> None:
        """Pass the commands that were received to the controllers, at this time. Called in every step: who
        looks between steps begins here."""
        if not self._commands:
            return
        for channel, m in sorted(self._commands, key=lambda c: (ORDER.index(c[0]), c[1].seq)):
            if channel == "KC_ARM_CMD":
                n = m.n_joints if 0 <= m.n_joints <= JOINT_SLOTS else 0
                self.controller.command(t_us * 1e-6, m.seq, m.q_rad[:n], m.speed_scale, bool(m.hold))
            elif channel == "KC_PANTILT_CMD":
                self.pantilt.command(t_us * 1e-6, m.seq, m.pan_rad, m.tilt_rad)
            else:
                self._requested_frames.append(m.seq)
        self._commands = []

    def settle(self, q_read_rad: np.ndarray, pantilt_rad: np.ndarray) -> AtRest:
        """Put the MuJoCo arm where it truly is for these readings of arm (n,) and pan-tilt unit (2,). Where
        it stands there already, since nothing has moved, the answer is the one of before: what is wrong with
        the arm of a scenario does not depend on time."""
        asked_of = q_read_rad, pantilt_rad, self.controller.trajectory.direction
        true = self._true if self.arm.data.qpos.tobytes() == self._stands else None
        if true and all(map(operator.is_, asked_of, self._asked_of)):  # arrays are never changed in place
            return true
        at = self._conditions(q_read_rad, pantilt_rad)
        asked = (at.q_rad.tobytes(), np.asarray(at.direction).tobytes(), at.pan_rad, at.tilt_rad)
        if true is None or asked != self._asked:
            self._asked, self._true = asked, (true := self.plant.settle(at))
            self._stands = self.arm.data.qpos.tobytes()
        self._asked_of = asked_of
        return true

    def stand(self, q_read_rad: np.ndarray, pantilt_rad: np.ndarray) -> None:
        """settle() for those who need no poses."""
        if self.plant.effects:
            self.plant.stand(self._conditions(q_read_rad, pantilt_rad))
        else:
            pan_rad, tilt_rad = pantilt_rad.tolist()
            self.plant.stand_rigid(q_read_rad, pan_rad, tilt_rad, self._payload_kg)

    def _conditions(self, q_read_rad: np.ndarray, pantilt_rad: np.ndarray) -> Conditions:
        direction, t_s = self.controller.trajectory.direction, (self.now_us or 0) * 1e-6
        pan_rad, tilt_rad = pantilt_rad.tolist()
        return conditions(self.scenario, q_read_rad, direction, t_s, (pan_rad, tilt_rad))

    def _take_frames(self, now_us: int, true: AtRest) -> list[tuple[str, Message]]:
        requested, self._requested_frames = self._requested_frames, []
        messages = [
            self.imager.expose(Exposure(now_us, seq, true.T_base_cam, true.T_base_tool)) for seq in requested
        ]
        return [(self.imager.channel, m) for m in messages if m is not None]

    def _readings(self, q: np.ndarray) -> np.ndarray:
        """Encoder readings with noise and quantisation."""
        if self._noise_rad:
            q = q + self._noise_rad * self._encoder_rng.standard_normal(len(q))
        return np.rint(q / self._step_rad) * self._step_rad if self._step_rad else q

    def _arm_state(self) -> kcm.arm_state_t:
        m, env = kcm.arm_state_t.__new__(kcm.arm_state_t), self.scenario.env
        m.t_us, m.seq, m.n_joints = self.now_us, self.seq, len(self.q_rad)
        m.q_rad, m.dq_rad_s = self._q.of(self.q_rad), self._dq.of(self.dq_rad_s)
        m.q_cmd_rad, m.dir = (
            self._q_cmd.of(self.controller.q_cmd),
            self._dir.of(self.controller.trajectory.direction),
        )
        m.moving, m.fault_mask = int(self.arm_moves), self.controller.fault_mask
        m.temp_c, m.payload_kg, m.g_m_s2 = env.temp_c, env.payload_kg, self.gravity_m_s2
        return m

    def _pantilt_state(self) -> kcm.pantilt_state_t:
        m = kcm.pantilt_state_t.__new__(kcm.pantilt_state_t)
        m.t_us, m.seq, m.moving = self.now_us, self.seq, int(self.pantilt_moves)
        m.pan_rad, m.tilt_rad = self.pantilt_rad.tolist()
        return m

    def _sim_truth(self, true: AtRest) -> kcm.sim_truth_t:
        m, T = kcm.sim_truth_t(), true.T_base_tool
        m.t_us, m.n_joints, m.q_true_rad = self.now_us, len(true.q_rad), _slots(true.q_rad)
        m.p_m, m.q_wxyz = T[:3, 3].tolist(), quaternion(T).tolist()
        return m
