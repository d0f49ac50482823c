"""The simulated world: arm, head and camera on one clock. Messages in, messages out; LCM is elsewhere."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass

import numpy as np

import kcm

from . import geom
from .effects import State
from .motion import ArmController, HeadController
from .scenario import Scenario, generator

TRUTH_PERIOD_US = 1_000_000
HELD_OUT_N = 200
HELD_OUT_TRIES = 200_000
JOINT_SLOTS = 8
# Commands of one tick are handled in this order, then by sequence number.
ORDER = ("KC_ARM_CMD", "KC_PANTILT_CMD", "KC_FRAME_REQUEST")


def _slots(values) -> list[float]:
    """A joint vector in the eight entries that messages carry."""
    return [float(v) for v in values] + [0.0] * (JOINT_SLOTS - len(values))


@dataclass(frozen=True)
class Frame:
    """What a camera needs to know about one exposure."""

    t_us: int
    seq: int
    T_base_cam: np.ndarray
    T_base_tool: np.ndarray


class World:
    """Scenario truth, controllers and camera (see eyes.py) on one clock."""

    def __init__(self, scenario: Scenario, seed: int, eye):
        self.scenario, self.seed = scenario, seed
        self.arm = scenario.build_arm()
        self.truth = scenario.build_truth(self.arm)
        self.controller = ArmController(self.arm.spec)
        self.head = HeadController(self.arm.spec)
        self.eye_channel, self.eye = eye(scenario, self.arm, seed)
        self.encoder_rng = generator(seed, "encoders")
        self.now_us: int | None = None
        self.inbox: list[tuple[str, object]] = []
        self.frames_due: list[int] = []
        self.seq = 0
        self.next_truth_us = 0
        self.moved_us = -1  # when arm or head were last seen moving
        self.touched: Counter[str] = Counter()  # pairs of shapes that touched, by seconds of mission time

    def take(self, channel: str, message) -> None:
        """A command from flight; acted on when time next moves."""
        self.inbox.append((channel, message))

    def step(self, now_us: int) -> list[tuple[str, object]]:
        """Carry out what was commanded, let time pass until now_us, and give the sensor messages."""
        self._obey(self.now_us if self.now_us is not None else now_us)
        self.now_us = now_us
        self.seq += 1
        q, dq, moving = self.controller.mover.at(now_us * 1e-6)
        head, _, head_moving = self.head.mover.at(now_us * 1e-6)
        if moving or head_moving:
            self.moved_us = now_us
        out = [
            ("KC_ARM_STATE", self._arm_state(q, dq, moving)),
            ("KC_PANTILT_STATE", self._pantilt_state(head, head_moving)),
        ]
        truth_due = now_us >= self.next_truth_us
        if self.frames_due or truth_due:
            q_true = self._stand(q, head)
            seen = [(self.eye_channel, self.eye(self._frame(seq))) for seq in self.frames_due]
            out += [(channel, m) for channel, m in seen if m is not None]  # None: comes when it is drawn
            self.frames_due = []
        if truth_due:
            self.next_truth_us = now_us - now_us % TRUTH_PERIOD_US + TRUTH_PERIOD_US
            self.touched.update({" - ".join(pair) for pair in self.arm.collisions()})
            out.append(("KC_SIM_TRUTH", self._sim_truth(q_true)))
        return out

    def _obey(self, t_us: int) -> None:
        self.inbox.sort(key=lambda m: (ORDER.index(m[0]), m[1].seq))
        for channel, m in self.inbox:
            if channel == "KC_ARM_CMD":
                n = m.n_joints if 0 <= m.n_joints <= JOINT_SLOTS else 0
                self.controller.command(t_us * 1e-6, m.seq, m.q_rad[:n], m.speed_scale, bool(m.hold))
            elif channel == "KC_PANTILT_CMD":
                self.head.command(t_us * 1e-6, m.seq, m.pan_rad, m.tilt_rad)
            else:
                self.frames_due.append(m.seq)
        self.inbox = []

    def _state(self) -> State:
        env = self.scenario.env
        return State((self.now_us or 0) * 1e-6, env.temp_c, env.payload_kg, self.controller.mover.dir)

    def _stand(self, q_enc, head) -> np.ndarray:
        """Put the MuJoCo arm where it truly is for these readings."""
        self.arm.set(self.arm.data.qpos[: self.arm.n], *head)
        return self.truth.settle(q_enc, self._state())

    def _frame(self, seq: int) -> Frame:
        return Frame(self.now_us, seq, self.arm.T_base_cam, self.arm.T_base_tool)

    def _arm_state(self, q, dq, moving: bool):
        m, truth, env = kcm.arm_state_t(), self.scenario.arm, self.scenario.env
        if truth.encoder_noise_rad:
            q = q + truth.encoder_noise_rad * self.encoder_rng.standard_normal(len(q))
        if truth.encoder_step_rad:
            q = np.round(q / truth.encoder_step_rad) * truth.encoder_step_rad
        m.t_us, m.seq, m.n_joints = self.now_us, self.seq, len(q)
        m.q_rad, m.dq_rad_s, m.q_cmd_rad = _slots(q), _slots(dq), _slots(self.controller.q_cmd)
        m.dir = [int(d) for d in self.controller.mover.dir] + [0] * (JOINT_SLOTS - len(q))
        m.moving, m.fault_mask = int(moving), self.controller.fault_mask
        m.temp_c, m.payload_kg, m.g_m_s2 = env.temp_c, env.payload_kg, [float(g) for g in env.gravity_m_s2]
        return m

    def _pantilt_state(self, head, moving: bool):
        m = kcm.pantilt_state_t()
        m.t_us, m.seq, m.moving = self.now_us, self.seq, int(moving)
        m.pan_rad, m.tilt_rad = float(head[0]), float(head[1])
        return m

    def _sim_truth(self, q_true):
        m, T = kcm.sim_truth_t(), self.arm.T_base_tool
        m.t_us, m.n_joints, m.q_true_rad = self.now_us, len(q_true), _slots(q_true)
        m.p_m, m.q_wxyz = T[:3, 3].tolist(), geom.quat(T).tolist()
        return m

    def truth_record(self, mode: str) -> dict:
        """What was wrong with the arm, and held-out poses to judge a correction by (truth.json)."""
        s = self.scenario
        return {
            "scenario": s.name,
            "title": s.title,
            "seed": self.seed,
            "mode": mode,
            "errors": s.coefficients(),
            "encoder_bias_rad": self.truth.bias_rad.tolist(),
            "env": {
                "gravity_m_s2": list(s.env.gravity_m_s2),
                "temp_c": s.env.temp_c,
                "payload_kg": s.env.payload_kg,
            },
            "held_out": self.held_out(),
        }

    def held_out(self, n: int = HELD_OUT_N) -> list[dict]:
        """Random poses inside the joint limits with the tool in the search region, each reached from a
        random side: the readings that the encoders would show, and where the tool truly is."""
        rng, region = generator(self.seed, "held out"), self.arm.spec["region"]
        lo, hi = np.array(region["min_m"]), np.array(region["max_m"])
        env, found, sides = self.scenario.env, [], generator(self.seed, "held out sides")
        for _ in range(HELD_OUT_TRIES):
            q = rng.uniform(self.arm.q_min, self.arm.q_max)
            side = sides.choice([-1, 1], self.arm.n)
            self.truth.settle(q, State(0.0, env.temp_c, env.payload_kg, side))
            T = self.arm.T_base_tool
            if np.all(T[:3, 3] >= lo) and np.all(T[:3, 3] <= hi):
                pose = {"q_rad": q.tolist(), "dir": side.tolist()}
                found.append(pose | {"p_m": T[:3, 3].tolist(), "q_wxyz": geom.quat(T).tolist()})
                if len(found) == n:
                    return found
        raise ArithmeticError(
            f"only {len(found)} of {HELD_OUT_TRIES} random poses have the tool in the region"
        )
