"""One sealed case: errors, hidden effects, a campaign, noise; the files to be read, and the sealed answer."""

from __future__ import annotations

import base64
import csv
import hashlib
import json
import zlib
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np

from .. import geom
from ..arm import GRAVITY_EARTH, Arm, load_spec
from . import eye, kinds, session
from .plant import Effect, Moment, Plant, turn

# One sigma of a detection in the camera frame: position [m], rotation vector [rad].
NOISE = np.array([0.6e-3, 0.6e-3, 1.8e-3, 5e-3, 5e-3, 2e-3])
BIAS_MAX_RAD = 0.060  # encoder biases: uniform up to this
ALPHA_SIGMA_RAD, LENGTH_SIGMA_M = 4e-3, 1.5e-3
PAYLOAD_KG = 0.5
N_UNSEEN = 200


@dataclass(frozen=True)
class Order:
    """What a case shall be. effects: texts as kinds.parse reads them; size: prior sigmas where a text names
    none; outliers: share of grossly wrong readings; noise: true noise over stated noise; order: "shuffled" or
    "sorted"; fixed_head: the camera never turns."""

    id: str
    effects: tuple[str, ...] = ()
    n: int = 100
    seed: int = 1
    size: float = 1.5
    noise: float = 1.0
    outliers: float = 0.0
    order: str = "shuffled"
    fixed_head: bool = False


@dataclass(frozen=True)
class Reading:
    """A detection as it goes into the file. T: tool in the base frame by the table's camera."""

    now: Moment
    T: np.ndarray
    T_base_cam: np.ndarray
    T_cam_tag: np.ndarray


class Bench:
    """The arm as the table has it and as it is, and how readings come about."""

    def __init__(self, order: Order):
        self.order, self.spec = order, load_spec()
        self.table = Arm(self.spec)
        self.errors = draw_errors(len(self.spec["joint"]), np.random.default_rng([order.seed, 1]))
        self.plant = Plant(self.spec, self.errors, (0.0, PAYLOAD_KG))
        self.optics = eye.nominal(self.spec)
        self.span_s = session.SECONDS_PER_POSE * order.n

    def campaign(self) -> tuple[list[Moment], list[int]]:
        rng = np.random.default_rng([self.order.seed, 2])
        todo = session.visits(
            self.table,
            self.order.n,
            rng,
            order=self.order.order,
            payload_kg=PAYLOAD_KG,
            fixed_head=self.order.fixed_head,
        )
        self.sky = session.weather(self.table.n, self.span_s, rng)
        moments = session.run(self.table, todo, self.sky, self.span_s, rng, order=self.order.order)
        return moments, [visit.replicate for visit in todo]

    def unseen(self) -> list[Moment]:
        """Moments of the same hours in a part of the workspace where nothing was measured, at full rest."""
        rng = np.random.default_rng([self.order.seed, 3])
        todo = [
            session.Visit(*posture, k, PAYLOAD_KG if rng.random() < 0.5 else 0.0)
            for k, posture in enumerate(session.postures(self.table, N_UNSEEN, True, rng))
        ]
        return session.run(self.table, todo, self.sky, self.span_s, rng, order="shuffled", still=True)

    def hide(self) -> tuple[list[Effect], list[dict]]:
        rng = np.random.default_rng([self.order.seed, 4])
        scene = kinds.Scene(self.spec, self.span_s, geom.trans(*self.spec["base"]["xyz_m"]), rng)
        effects, told = [], []
        for text in self.order.effects:
            wish = kinds.parse(text, self.order.size, rng)
            effect, theta = kinds.draw(wish, scene)
            effects.append(effect)
            told.append({"kind": wish.kind, "place": wish.place, "size": wish.size, "theta": theta})
        return effects, told

    def rivals(self, told: dict) -> list[Effect]:
        """Effects that do nearly the same: a soft joint 2 and a soft mount, on a level base."""
        scene = kinds.Scene(self.spec, self.span_s, geom.trans(*self.spec["base"]["xyz_m"]), None)
        if told["kind"] == "base_flex":
            return kinds.units("compliance", scene, (2,))
        if told["kind"] in ("compliance", "droop") and told["place"] == (2,):
            return kinds.units("base_flex", scene)
        return []

    def read(self, now: Moment, effects: list[Effect]) -> Reading:
        """What camera and encoders give, without noise."""
        T_base_tool, T_base_cam = self.plant.settle(now, effects)
        optics = self.optics
        for effect in effects:
            optics = effect.optics(now, optics)
        M = eye.mount(self.spec, now.tag)
        T_cam_tag = np.linalg.inv(T_base_cam) @ T_base_tool @ M @ optics.mounts.get(now.tag, np.eye(4))
        seen = eye.perceive(self.optics, eye.image(optics, T_cam_tag), T_cam_tag)
        for effect in effects:
            seen = effect.sensed(now, seen)
        told = session.reported_camera(self.table, now)
        return Reading(now, told @ seen @ np.linalg.inv(M), told, seen)

    def dh_columns(self, now: Moment) -> np.ndarray:
        """(6, 28) motion of the tool (base frame) per unit of each DH error, from the bodies' axes."""
        arm = self.plant.arms[float(now.payload_kg)]
        self.plant.settle(now)
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

    def strength(self, moments: list[Moment], effects: list[Effect], rivals=()) -> dict[str, float]:
        """How visible effects are in these poses: squared length in units of the noise, after the best
        change of the DH parameters was taken away (chi2); how much that took (absorbed); raw size (mm);
        and what is left when effects of other kinds may imitate them too, in any size (beside_rivals)."""
        rows, columns, beside, square = [], [], [], []
        for now in moments:
            healthy = self.read(now, [])
            whiten = np.kron(np.eye(2), healthy.T_base_cam[:3, :3].T) / NOISE[:, None]
            change = _motion(healthy.T, self.read(now, effects).T)
            square.append(change[:3] @ change[:3])
            rows.append(whiten @ change)
            columns.append(whiten @ self.dh_columns(now))
            beside.append([whiten @ _motion(healthy.T, self.read(now, [rival]).T) for rival in rivals])
        d, J = np.concatenate(rows), np.vstack(columns)
        left, whole = _left(d, J), max(float(d @ d), 1e-300)
        out = {"chi2": left, "absorbed": 1.0 - left / whole, "rms_mm": 1e3 * float(np.sqrt(np.mean(square)))}
        if rivals:
            more = np.array(beside).transpose(0, 2, 1).reshape(len(d), len(rivals))
            out["beside_rivals"] = _left(d, np.hstack([J, more]))
        return out


def draw_errors(n: int, rng: np.random.Generator) -> dict[str, float]:
    """Encoder biases and DH errors of an arm as it came from assembly."""
    errors = {}
    for j in range(1, n + 1):
        errors[f"J{j}.phi_rad"] = float(rng.uniform(-BIAS_MAX_RAD, BIAS_MAX_RAD))
        errors[f"J{j}.alpha_rad"] = float(ALPHA_SIGMA_RAD * rng.standard_normal())
        errors[f"J{j}.a_m"] = float(LENGTH_SIGMA_M * rng.standard_normal())
        errors[f"J{j}.d_m"] = float(LENGTH_SIGMA_M * rng.standard_normal())
    return errors


def _left(d: np.ndarray, J: np.ndarray) -> float:
    """Squared length of what the columns cannot imitate."""
    J = J / np.linalg.norm(J, axis=0)
    rest = d - J @ np.linalg.lstsq(J, d, rcond=1e-9)[0]
    return float(rest @ rest)


def _motion(A: np.ndarray, B: np.ndarray) -> np.ndarray:
    """(position; rotation vector) from A to B, both in the base frame."""
    q = geom.quat(B[:3, :3] @ A[:3, :3].T)
    length = np.linalg.norm(q[1:])
    factor = 2.0 * np.arctan2(length, q[0]) / length if length > 0 else 2.0
    return np.concatenate([B[:3, 3] - A[:3, 3], factor * q[1:]])


def _noisy(reading: Reading, scale: float, rng: np.random.Generator) -> np.ndarray:
    e = scale * NOISE * rng.standard_normal(6)
    C = reading.T_base_cam[:3, :3]
    return geom.pose(reading.T[:3, 3] + C @ e[:3], turn(C @ e[3:]) @ reading.T[:3, :3])


def _spoil(reading: Reading, T: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """A gross error: the mirrored solution of PnP, a wrong range, or a stray corner."""
    C, eye_at = reading.T_base_cam[:3, :3], reading.T_base_cam[:3, 3]
    way = rng.integers(3)
    out = T.copy()
    if way == 0:
        ray = (T[:3, 3] - eye_at) / np.linalg.norm(T[:3, 3] - eye_at)
        normal = C @ reading.T_cam_tag[:3, 2]
        axis = np.cross(normal, ray)
        angle = max(2.0 * eye.incidence_rad(reading.T_cam_tag), 0.1)
        out[:3, :3] = turn(axis / max(np.linalg.norm(axis), 1e-9) * angle) @ T[:3, :3]
    elif way == 1:
        out[:3, 3] = eye_at + (T[:3, 3] - eye_at) * (1.0 + rng.choice([-1, 1]) * rng.uniform(0.02, 0.08))
    else:
        out[:3, 3] += C @ (rng.standard_normal(3) * 0.015)
        out[:3, :3] = turn(C @ (rng.standard_normal(3) * 0.08)) @ out[:3, :3]
    return out


# ---- files --------------------------------------------------------------------------------------------


def _names(stem: str, n: int = 7) -> list[str]:
    return [f"{stem}{j}" for j in range(1, n + 1)]


_STATE = ["t_s", *_names("q"), *_names("dir"), *_names("qdot"), "temp_c", "payload_kg"]
_POSE = ["px", "py", "pz", "qw", "qx", "qy", "qz"]
_COV = [f"c{i}{j}" for i in range(1, 7) for j in range(i, 7)]
_EYE = [
    "range_m",
    "incid_rad",
    "u_px",
    "v_px",
    "cx",
    "cy",
    "cz",
    "cqw",
    "cqx",
    "cqy",
    "cqz",
    "pan_rad",
    "tilt_rad",
    "tag",
]
COLUMNS = ["id", *_STATE, *_POSE, *_COV, *_EYE, "replicate"]
QUERY = ["id", *_STATE, "px", "py", "pz"]


def _state(now: Moment) -> list[float]:
    return [now.t_s, *now.q, *now.dir, *now.qdot, now.temp_c, now.payload_kg]


def _pose(T: np.ndarray) -> list[float]:
    return [*T[:3, 3], *geom.quat(T)]


def _row(reading: Reading, T: np.ndarray, optics: eye.Optics, spec: dict) -> list[float]:
    """What a detector can know: its own, noisy pose gives range, incidence and image position."""
    C = reading.T_base_cam
    T_cam_tool = np.linalg.inv(C) @ T
    big = np.kron(np.eye(2), C[:3, :3])
    cov = big @ np.diag(NOISE**2) @ big.T
    u, v, w = optics.K @ T_cam_tool[:3, 3]
    now = reading.now
    incidence = eye.incidence_rad(T_cam_tool @ eye.mount(spec, now.tag))
    return [
        *_state(now), *_pose(T), *cov[np.triu_indices(6)],
        np.linalg.norm(T_cam_tool[:3, 3]), incidence, u / w, v / w, *_pose(C), now.pan, now.tilt, now.tag,
    ]  # fmt: skip


def _text(value) -> str:
    return f"{value:.10g}"


def _write_csv(path: Path, header: list[str], rows: list[list]) -> None:
    with path.open("w", newline="", encoding="utf-8") as f:
        out = csv.writer(f, lineterminator="\n")
        out.writerow(header)
        out.writerows([[row[0], *map(_text, row[1:])] for row in rows])


def arm_toml(spec: dict) -> str:
    """The arm as the table has it, in the workbench's format."""
    lines = [
        f'name = "{spec["name"]}"',
        'convention = "standard"',
        f"gravity_m_s2 = {list(GRAVITY_EARTH)}",
    ]
    for frame in ("base", "tool"):
        lines += [
            f"[{frame}]",
            f"xyz_m = {spec[frame]['xyz_m']}",
            "quat_wxyz = [1.0, 0.0, 0.0, 0.0]",
            "estimate = false",
        ]
    cam = spec["camera"]
    lines += ["[camera]", *(f"{key} = {cam[key]}" for key in ("fx_px", "fy_px", "cx_px", "cy_px"))]
    for joint, gear in zip(spec["joint"], kinds.GEAR_RATIO, strict=True):
        lines += [
            "[[joint]]",
            'type = "revolute"',
            *(
                f"{key} = {joint.get(key, 0.0)}"
                for key in ("a_m", "alpha_rad", "d_m", "phi_rad", "mass_kg", "com_m")
            ),
            f"q_min_rad = {joint['q_rad'][0]}",
            f"q_max_rad = {joint['q_rad'][1]}",
            f"gear_ratio = {gear}",
        ]
    return "\n".join(lines) + "\n"


def seal(answer: dict) -> dict:
    """The answer, unreadable to the eye, with the hash of its canonical text."""
    text = json.dumps(answer, sort_keys=True, separators=(",", ":")).encode()
    return {
        "sha256": hashlib.sha256(text).hexdigest(),
        "sealed": base64.b64encode(zlib.compress(text)).decode(),
    }


class BrokenSeal(ValueError):
    """The answer is not the one that was sealed."""


def unseal(sealed: dict, sha256: str | None = None) -> dict:
    """The answer. sha256: what the manifest said when the case was made."""
    text = zlib.decompress(base64.b64decode(sealed["sealed"]))
    found = hashlib.sha256(text).hexdigest()
    if found != sealed["sha256"] or (sha256 is not None and found != sha256):
        raise BrokenSeal(f"the answer has hash {found[:12]}, sealed was {(sha256 or sealed['sha256'])[:12]}")
    return json.loads(text)


def make(order: Order, folder: Path) -> dict:
    """Write poses.csv, queries.csv and sealed.json into `folder`; gives the manifest's line.

    queries.csv: states of the unseen region, positions left at zero; the true ones are in the seal.
    """
    folder.mkdir(parents=True, exist_ok=True)
    bench = Bench(order)
    moments, replicate = bench.campaign()
    effects, told = bench.hide()
    rng = np.random.default_rng([order.seed, 5])
    readings = [bench.read(now, effects) for now in moments]
    poses = [_noisy(reading, order.noise, rng) for reading in readings]
    wrong = sorted(int(i) for i in rng.choice(order.n, round(order.outliers * order.n), replace=False))
    for i in wrong:
        poses[i] = _spoil(readings[i], poses[i], rng)
    ids = [f"p{i:03d}" for i in range(order.n)]
    rows = [
        [name, *_row(reading, T, bench.optics, bench.spec), group]
        for name, reading, T, group in zip(ids, readings, poses, replicate, strict=True)
    ]
    _write_csv(folder / "poses.csv", COLUMNS, rows)
    unseen = bench.unseen()
    _write_csv(
        folder / "queries.csv",
        QUERY,
        [[f"u{i:03d}", *_state(now), 0.0, 0.0, 0.0] for i, now in enumerate(unseen)],
    )
    for effect, line in zip(effects, told, strict=True):
        line |= bench.strength(moments, [effect], bench.rivals(line))
    answer = {
        "order": asdict(order),
        "effects": told,
        "errors": bench.errors,
        "outliers": [ids[i] for i in wrong],
        "unseen": [_pose(bench.plant.settle(now, effects)[0]) for now in unseen],
    }
    sealed = seal(answer)
    (folder / "sealed.json").write_text(json.dumps(sealed) + "\n", encoding="utf-8")
    return {"id": order.id, "n": order.n, "sha256": sealed["sha256"]}
