"""The arm as the table has it and as it is, how observations come about, and how visible an effect is."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ..mechanics.arm import Arm
from ..mechanics.effects import JointFunction
from ..mechanics.plant import Conditions, Effect, Plant
from ..mechanics.spec import load_spec
from ..transforms import quaternion, trans
from . import campaign, kinds, optics
from .spec import CaseSpec

# One sigma of a detection in the camera frame: position [m], rotation vector [rad].
NOISE = np.array([0.6e-3, 0.6e-3, 1.8e-3, 5e-3, 5e-3, 2e-3])
BIAS_MAX_RAD = 0.060  # encoder biases: uniform up to this
ALPHA_SIGMA_RAD, LENGTH_SIGMA_M = 4e-3, 1.5e-3
PAYLOAD_KG = 0.5
N_UNSEEN = 200
# Streams of random numbers of a case.
ERRORS, CAMPAIGN, UNSEEN, EFFECTS, NOISES = 1, 2, 3, 4, 5


@dataclass(frozen=True)
class Observation:
    """A detection as it goes into the file; all poses 4x4.

    T_base_tool: tool by the table's camera and pan-tilt encoders; T_base_cam: camera by the same; T_cam_tag:
    the tag as the detector has it.
    """

    at: Conditions
    T_base_tool: np.ndarray
    T_base_cam: np.ndarray
    T_cam_tag: np.ndarray


class Bench:
    """Nominal arm, true arm and camera of one case."""

    def __init__(self, spec: CaseSpec):
        self.spec, self.arm_spec = spec, load_spec()
        self.nominal = Arm(self.arm_spec, pictures=False)
        self.errors = random_errors(self.nominal.n, self.rng(ERRORS))
        self.plant = Plant(self.arm_spec, self.errors, payloads_kg=(0.0, PAYLOAD_KG), pictures=False)
        self.optics = optics.nominal(self.arm_spec)
        self.span_s = campaign.SECONDS_PER_POSE * spec.n
        self._cycle: campaign.ThermalCycle | None = None

    def rng(self, stream: int) -> np.random.Generator:
        """Random numbers of this case for one of the streams above."""
        return np.random.default_rng([self.spec.seed, stream])

    def campaign(self) -> tuple[list[Conditions], list[int]]:
        """Conditions of all poses, and for each the number of the visit that it repeats."""
        rng, spec = self.rng(CAMPAIGN), self.spec
        todo = campaign.visits(
            self.nominal,
            spec.n,
            rng,
            sequence=spec.sequence,
            payload_kg=PAYLOAD_KG,
            fixed_pantilt=spec.fixed_pantilt,
        )
        self._cycle = campaign.thermal_cycle(self.nominal.n, self.span_s, rng)
        at = campaign.conditions(self.nominal, todo, self._cycle, self.span_s, rng, sequence=spec.sequence)
        return at, [visit.replicate for visit in todo]

    def unseen(self) -> list[Conditions]:
        """Conditions in a part of the workspace where nothing was measured, at full rest, in the same hours.

        campaign() comes first: it makes the temperatures.
        """
        if self._cycle is None:
            raise RuntimeError("unseen() needs the temperatures of campaign()")
        rng = self.rng(UNSEEN)
        todo = [
            campaign.Visit(posture, k, campaign.random_payload(PAYLOAD_KG, rng))
            for k, posture in enumerate(campaign.postures(self.nominal, N_UNSEEN, rng, unseen=True))
        ]
        return campaign.conditions(
            self.nominal, todo, self._cycle, self.span_s, rng, sequence="shuffled", still=True
        )

    def hide(self) -> tuple[list[Effect], list[dict]]:
        """The hidden effects, and what the sealed answer has of each: kind, place, size, theta."""
        rng = self.rng(EFFECTS)
        effects, descriptions = [], []
        for text in self.spec.effects:
            request = kinds.parse(text, self.spec.size, rng)
            effect, theta = kinds.sample(request, self._context(rng))
            effects.append(effect)
            descriptions.append(
                {"kind": request.kind, "place": request.place, "size": request.size, "theta": theta}
            )
            if isinstance(effect, JointFunction):
                descriptions[-1]["drivers"] = effect.drivers
        return effects, descriptions

    def alternatives(self, description: dict) -> list[Effect]:
        """Effects that do nearly the same: a soft joint 2 and a soft mount, on a level base."""
        context = self._context(self.rng(EFFECTS))
        if description["kind"] == "base_flex":
            return kinds.unit_effects("compliance", context, (2,))
        if description["kind"] in ("compliance", "droop") and description["place"] == (2,):
            return kinds.unit_effects("base_flex", context)
        return []

    def _context(self, rng: np.random.Generator) -> kinds.Context:
        return kinds.Context(self.arm_spec, self.span_s, trans(*self.arm_spec["base"]["xyz_m"]), rng)

    def reported_camera(self, at: Conditions) -> np.ndarray:
        """T_base_cam that the table and the pan-tilt encoders give."""
        self.nominal.set(at.q_rad, at.pan_rad, at.tilt_rad)
        return self.nominal.T_base_cam

    def observe(self, at: Conditions, effects: Sequence[Effect]) -> Observation:
        """What camera and encoders give, without noise."""
        true, true_optics = self.plant.settle(at, effects), self.optics
        for effect in effects:
            true_optics = effect.optics(at, true_optics)
        T_tool_tag = optics.nominal_tag_pose(self.arm_spec, at.tag)
        offset = true_optics.tag_offsets.get(at.tag, np.eye(4))
        T_cam_tag = np.linalg.inv(true.T_base_cam) @ true.T_base_tool @ T_tool_tag @ offset
        seen = optics.solve_pnp(self.optics, optics.image(true_optics, T_cam_tag), T_cam_tag)
        for effect in effects:
            seen = effect.detected(at, seen)
        T_base_cam = self.reported_camera(at)
        return Observation(at, T_base_cam @ seen @ np.linalg.inv(T_tool_tag), T_base_cam, seen)

    def dh_jacobian(self, at: Conditions) -> np.ndarray:
        """(6, 4n) motion of the tool (base frame) per unit of each DH error, from the bodies' axes."""
        arm = self.plant.arm(at.payload_kg)
        self.plant.settle(at)
        p = arm.T_base_tool[:3, 3]
        out = []
        for j in range(arm.n):
            before, after = (arm.data.body(f"frame{k}") for k in (j, j + 1))
            z, x = before.xmat.reshape(3, 3)[:, 2], after.xmat.reshape(3, 3)[:, 0]
            out.append(np.concatenate([np.cross(z, p - before.xpos), z]))
            out.append(np.concatenate([np.cross(x, p - after.xpos), x]))
            out.append(np.concatenate([x, np.zeros(3)]))
            out.append(np.concatenate([z, np.zeros(3)]))
        return np.array(out).T

    def visibility(
        self, poses: list[Conditions], effects: Sequence[Effect], alternatives: Sequence[Effect] = ()
    ) -> dict[str, float]:
        """How visible effects are in these poses.

        chi2: squared length in units of the noise, after the best change of the DH parameters was taken away;
        absorbed: share that this took; rms_mm: raw size; beside_alternatives: what is left when effects of
        other kinds may imitate them too, in any size.
        """
        changes, d, J, K = [], [], [], []
        for at in poses:
            healthy = self.observe(at, [])
            whiten = np.kron(np.eye(2), healthy.T_base_cam[:3, :3].T) / NOISE[:, None]
            changes.append(self._change(healthy, effects))
            d.append(whiten @ changes[-1])
            J.append(whiten @ self.dh_jacobian(at))
            K.append([whiten @ self._change(healthy, [other]) for other in alternatives])
        rows, columns = np.concatenate(d), np.vstack(J)
        left, whole = _unexplained(rows, columns), max(float(rows @ rows), 1e-300)
        square = [change[:3] @ change[:3] for change in changes]
        out = {"chi2": left, "absorbed": 1.0 - left / whole, "rms_mm": 1e3 * float(np.sqrt(np.mean(square)))}
        if alternatives:
            more = np.array(K).transpose(0, 2, 1).reshape(len(rows), len(alternatives))
            out["beside_alternatives"] = _unexplained(rows, np.hstack([columns, more]))
        return out

    def _change(self, healthy: Observation, effects: Sequence[Effect]) -> np.ndarray:
        """(6,) how effects move the observed tool: position [m] and rotation vector [rad], base frame."""
        return _motion(healthy.T_base_tool, self.observe(healthy.at, effects).T_base_tool)


def random_errors(n: int, rng: np.random.Generator) -> dict[str, float]:
    """Encoder biases and DH errors of an arm as it came from assembly, by coefficient name."""
    errors = {}
    for j in range(1, n + 1):
        errors[f"J{j}.phi_rad"] = float(rng.uniform(-BIAS_MAX_RAD, BIAS_MAX_RAD))
        errors[f"J{j}.alpha_rad"] = float(ALPHA_SIGMA_RAD * rng.standard_normal())
        errors[f"J{j}.a_m"] = float(LENGTH_SIGMA_M * rng.standard_normal())
        errors[f"J{j}.d_m"] = float(LENGTH_SIGMA_M * rng.standard_normal())
    return errors


def _unexplained(d: np.ndarray, J: np.ndarray) -> float:
    """Squared length of what the columns cannot imitate."""
    J = J / np.linalg.norm(J, axis=0)
    rest = d - J @ np.linalg.lstsq(J, d, rcond=1e-9)[0]
    return float(rest @ rest)


def _motion(A: np.ndarray, B: np.ndarray) -> np.ndarray:
    """(6,) position [m] and rotation vector [rad] from pose A to pose B, both 4x4 in the base frame."""
    q = quaternion(B[:3, :3] @ A[:3, :3].T)
    length = np.linalg.norm(q[1:])
    factor = 2.0 * np.arctan2(length, q[0]) / length if length > 0 else 2.0
    return np.concatenate([B[:3, 3] - A[:3, 3], factor * q[1:]])
