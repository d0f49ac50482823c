"""Designs of other makers, from the same candidates and with the same noise, for study.py.

They choose whole sets of poses before anything is measured, from the nominal arm; nothing is learnt between.
- figaroh: the package's D-optimal weights over the candidates (SOCPOptimizer, as its
  BaseOptimalCalibration.calculate_optimal_configurations), the heaviest first.
- detmax: for each number of poses the exchange of Mitchell ("An algorithm for the construction of D-optimal
  experimental designs", Technometrics 16, 1974) with excursions, the best of some random starts.

Information: the noise of a detection that the simulator states at a candidate with the nominal arm, and the
Jacobian of this module's own kinematics. The true arm, in MuJoCo, is brought to the nominal tool pose of a
candidate, as the visual servo would; where it cannot get there, or no tag is in view, the visit yields
nothing. The simulator's detections are averaged over FRAMES. The fit is scipy's least squares over the
coefficients inside their bounds, which are also the sigmas of a prior. No code of flight has a part in choice
or fit.

What is left out is what these designs know nothing of: paths, contacts, seconds and joules. Their first poses
are anywhere, with an arm that may be off by anything: no lander would fly them.
"""

from __future__ import annotations

import json
import zlib
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache

import missions
import montecarlo
import numpy as np
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation
from servoed import true_joints

from kincal.space import SpaceTable
from kincal_sim.mechanics.arm import Arm
from kincal_sim.mechanics.spec import load_spec
from kincal_sim.randomness import generator
from kincal_sim.scenario import Scenario, load
from kincal_sim.transforms import rotation_matrix
from kincal_sim.truth import build_plant, conditions
from kincal_sim.vision.imagers import Exposure, fast_imager

FRAMES = 3
POSES = range(3, 21)  # below five the prior has a part in it: fewer rows than DH errors
FLOOR = np.array([2e-4] * 3 + [5e-4] * 3)  # of a measurement's sigma [m, rad], as CONFIG has it
DETMAX_STARTS, DETMAX_EXCURSION = 10, 3
COMPLIANCE_BOUND = 0.01  # of the elbow [rad/(N m)]
ELBOW = 3  # joint 4
DH = ("phi_rad", "alpha_rad", "a_m", "d_m")


# ---- kinematics ------------------------------------------------------------------------------------------


def coefficients(uplinked: bool) -> dict[str, float]:
    """Names of the coefficients to estimate, in order, and their bounds."""
    size = montecarlo.bounds()
    names = [f"J{j}.{parameter}" for j in range(1, 8) for parameter in DH]
    return {name: size[name] for name in names} | ({missions.EFFECT: COMPLIANCE_BOUND} if uplinked else {})


@cache
def _nominal() -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """DH parameters (7, 4), origins of base and tool frame."""
    spec = load_spec()
    rows = [[j.get("phi_rad", 0.0), j["alpha_rad"], j["a_m"], j["d_m"]] for j in spec["joint"]]
    return np.array(rows), np.array(spec["base"]["xyz_m"]), np.array(spec["tool"]["xyz_m"])


@dataclass(frozen=True)
class Chain:
    """Origins (8, n, 3) and rotations (8, n, 3, 3) of DH frames 0 to 7 at n postures, and the tool's
    position (n, 3); its rotation is that of frame 7."""

    o_m: np.ndarray
    R: np.ndarray
    tool_m: np.ndarray


def chain(q_rad: np.ndarray, elbow_nm: np.ndarray, values: np.ndarray) -> Chain:
    """At encoder readings (n, 7) and gravity torques of the elbow (n,), with coefficients as coefficients()
    orders them."""
    dh, base, tool = _nominal()
    dh = dh + values[:28].reshape(7, 4)
    q = q_rad.copy()
    if len(values) > 28:
        q[:, ELBOW] += values[28] * elbow_nm
    n = len(q)
    o, R = np.empty((8, n, 3)), np.empty((8, n, 3, 3))
    o[0], R[0] = base, np.eye(3)
    for j, (phi, alpha, a, d) in enumerate(dh):
        c, s, ca, sa = np.cos(q[:, j] + phi), np.sin(q[:, j] + phi), np.cos(alpha), np.sin(alpha)
        turn = np.zeros((n, 3, 3))
        turn[:, 0] = np.stack([c, -s * ca, s * sa], axis=1)
        turn[:, 1] = np.stack([s, c * ca, -c * sa], axis=1)
        turn[:, 2] = 0.0, sa, ca
        along = np.stack([a * c, a * s, np.full(n, d)], axis=1)
        o[j + 1], R[j + 1] = o[j] + np.einsum("nij,nj->ni", R[j], along), R[j] @ turn
    return Chain(o, R, o[7] + R[7] @ tool)


def twists(at: Chain, elbow_nm: np.ndarray, k: int) -> np.ndarray:
    """Motion of the tool, position and rotation vector in the base frame, for one unit of each of k
    coefficients, (n, 6, k)."""
    columns = []
    for j in range(7):
        z, x = at.R[j][:, :, 2], at.R[j + 1][:, :, 0]
        none = np.zeros_like(z)
        columns += [
            np.hstack([np.cross(z, at.tool_m - at.o_m[j]), z]),  # phi
            np.hstack([np.cross(x, at.tool_m - at.o_m[j + 1]), x]),  # alpha
            np.hstack([x, none]),  # a
            np.hstack([z, none]),  # d
        ]
    if k > len(columns):
        columns.append(columns[4 * ELBOW] * elbow_nm[:, None])
    return np.stack(columns, axis=2)


def rotation_vectors(R: np.ndarray) -> np.ndarray:
    """(n, 3) of rotations (n, 3, 3)."""
    return Rotation.from_matrix(R).as_rotvec()


def inverse_right_jacobian(r: np.ndarray) -> np.ndarray:
    """(n, 3, 3): log(exp(r) exp(w)) = r + this w, for small w."""
    angle = np.maximum(np.linalg.norm(r, axis=1), 1e-6)[:, None, None]
    K = np.zeros((len(r), 3, 3))
    K[:, 2, 1], K[:, 0, 2], K[:, 1, 0] = r.T
    K = K - K.transpose(0, 2, 1)
    share = 1.0 / angle**2 - (1.0 + np.cos(angle)) / (2.0 * angle * np.sin(angle))
    return np.eye(3) + 0.5 * K + share * (K @ K)


@dataclass(frozen=True)
class Data:
    """n measurements: readings (n, 7), gravity torque of the elbow (n,), tool pose, and the matrices W
    (n, 6, 6) that whiten a residual of position [m] and rotation vector [rad], base frame."""

    q_rad: np.ndarray
    elbow_nm: np.ndarray
    p_m: np.ndarray
    R: np.ndarray
    W: np.ndarray

    def residuals(self, values: np.ndarray) -> np.ndarray:
        """Whitened, measured less model (n, 6)."""
        at = chain(self.q_rad, self.elbow_nm, values)
        turn = rotation_vectors(self.R @ at.R[7].transpose(0, 2, 1))
        return np.einsum("nij,nj->ni", self.W, np.hstack([self.p_m - at.tool_m, turn]))

    def jacobian(self, values: np.ndarray) -> np.ndarray:
        """Derivative of the whitened residuals (n, 6, k)."""
        at = chain(self.q_rad, self.elbow_nm, values)
        J = twists(at, self.elbow_nm, len(values))
        J[:, 3:] = inverse_right_jacobian(rotation_vectors(self.R @ at.R[7].transpose(0, 2, 1))) @ J[:, 3:]
        return -self.W @ J


def joined(data: Sequence[Data]) -> Data:
    """Measurements of several, in order."""
    columns = ("q_rad", "elbow_nm", "p_m", "R", "W")
    return Data(*(np.concatenate([getattr(d, c) for d in data]) for c in columns))


def fit(data: Data, uplinked: bool) -> dict[str, float]:
    """Coefficients by least squares inside their bounds."""
    bound = np.array(list(coefficients(uplinked).values()))

    def residuals(x: np.ndarray) -> np.ndarray:
        return np.concatenate([data.residuals(x * bound).ravel(), x])

    def jacobian(x: np.ndarray) -> np.ndarray:
        J = data.jacobian(x * bound).reshape(-1, len(bound)) * bound
        return np.vstack([J, np.eye(len(bound))])

    found = least_squares(residuals, np.zeros(len(bound)), jacobian, bounds=(-1.01, 1.01), x_scale=1.0)
    return dict(zip(coefficients(uplinked), map(float, found.x * bound), strict=True))


# ---- measuring -------------------------------------------------------------------------------------------


class Site:
    """The arm of a scenario in front of its camera, brought to candidates."""

    def __init__(self, scenario: Scenario, seed: int) -> None:
        self.scenario, self.plant, self._nominal = scenario, build_plant(scenario), Arm()
        self.arm = self.plant.arm(scenario.env.payload_kg)
        self._imager = fast_imager(scenario, self.arm, seed)
        self._seen: dict[int, Data | None] = {}

    def measure(self, candidate: int) -> Data | None:
        """One measurement there, the same if asked again; None if there is none."""
        if candidate not in self._seen:
            self._seen[candidate] = self._measure(candidate)
        return self._seen[candidate]

    def _measure(self, candidate: int) -> Data | None:
        seed_rad = candidates().q_rad[candidate]
        self._nominal.set(seed_rad)
        geometric = true_joints(self.arm, self._nominal.T_base_tool, seed_rad)
        if geometric is None:
            return None
        q_rad = self._readings(geometric)
        rest = self.plant.settle(conditions(self.scenario, q_rad))
        pan, tilt = missions.aimed(rest.T_base_tool[:3, 3])
        self.arm.set(rest.q_rad, pan, tilt)
        self._nominal.set(q_rad)
        return self._averaged(q_rad, float(self._nominal.gravity_torque()[ELBOW]), rest.T_base_tool)

    def _readings(self, q_true: np.ndarray) -> np.ndarray:
        """Encoder readings with which the arm comes to rest near these joints."""
        q_rad = q_true + self.plant.encoders.bias_rad
        return q_rad - (self.plant.settle(conditions(self.scenario, q_rad)).q_rad - q_true)

    def _averaged(self, q_rad: np.ndarray, elbow_nm: float, T_base_tool: np.ndarray) -> Data | None:
        """Frames of the arm as it stands; of a flat tag's two poses the one that is nearer the truth."""
        T_base_cam = self.arm.T_base_cam
        found = [self._imager.expose(Exposure(0, k, T_base_cam, T_base_tool)) for k in range(FRAMES)]
        if any(m.n_tags == 0 for m in found):
            return None
        true, R_cam = T_base_tool[:3, :3], T_base_cam[:3, :3]
        points, turns = [], []
        for m in found:
            both = ((m.p_cam_tool_m, m.q_cam_tool_wxyz), (m.p_alt_m, m.q_alt_wxyz))
            turned = [Rotation.from_matrix(R_cam @ rotation_matrix(q) @ true.T).as_rotvec() for _, q in both]
            k = int(np.linalg.norm(turned[1]) < np.linalg.norm(turned[0]))
            points.append(R_cam @ np.array(both[k][0]) + T_base_cam[:3, 3])
            turns.append(turned[k])
        R = Rotation.from_rotvec(np.mean(turns, axis=0)).as_matrix() @ true
        W = _whitening(found[0].cov, R_cam)
        return Data(q_rad[None], np.array([elbow_nm]), np.mean(points, axis=0)[None], R[None], W[None])


def _whitening(packed: Sequence[float], R_cam: np.ndarray) -> np.ndarray:
    """W (6, 6) with W'W the information of a detection, in the base frame."""
    cov = np.zeros((6, 6))
    cov[np.triu_indices(6)] = packed
    cov += np.triu(cov, 1).T
    turn = np.kron(np.eye(2), R_cam)
    cov = turn @ cov @ turn.T + np.diag(FLOOR**2)
    return np.linalg.inv(np.linalg.cholesky(cov))


@cache
def candidates() -> SpaceTable:
    """The candidates of the space in use."""
    return SpaceTable.load(missions.TABLES / "space.tbl")[1].candidates()


# ---- choosing --------------------------------------------------------------------------------------------


@cache
def information(uplinked: bool) -> np.ndarray:
    """Information matrices (candidates, k, k) at the nominal arm, in a basis in which their mean is the
    identity (which no D-optimal choice depends on); zero where no tag is in view."""
    site = Site(load("healthy"), 0)
    seen = [site.measure(k) for k in range(len(candidates().q_rad))]
    bound = np.array(list(coefficients(uplinked).values()))
    k = len(bound)
    rows = np.zeros((len(seen), 6, k))
    for one, data in zip(rows, seen, strict=True):
        if data is not None:
            one[:] = data.jacobian(np.zeros(k))[0] * bound
    L = np.linalg.cholesky(np.mean(rows.transpose(0, 2, 1) @ rows, axis=0))
    rows = rows @ np.linalg.inv(L).T
    return rows.transpose(0, 2, 1) @ rows


def figaroh_order(matrices: np.ndarray) -> list[int]:
    """Candidates by figaroh's weights, the heaviest first. matrices: (candidates, k, k)."""
    from figaroh.optimal.base_optimal_calibration import SOCPOptimizer

    pool = dict(enumerate(matrices))
    _, by_weight = SOCPOptimizer(pool, {"NbSample": len(matrices)}).solve()
    return [int(k) for k in by_weight]


def gain(inverse: np.ndarray, matrices: np.ndarray) -> np.ndarray:
    """log det(M + X) - log det M for each X (n, k, k), from M's inverse."""
    return np.linalg.slogdet(np.eye(len(inverse)) + inverse @ matrices)[1]


def detmax(
    matrices: np.ndarray,
    n: int,
    rng: np.random.Generator,
    starts: int = DETMAX_STARTS,
    excursion: int = DETMAX_EXCURSION,
) -> tuple[list[int], float]:
    """n different candidates with as large a determinant of information as the exchange finds, and its
    logarithm. matrices: (candidates, k, k); excursion: how far from n the set may go."""
    found = [
        _from(matrices, list(rng.choice(len(matrices), n, replace=False)), excursion) for _ in range(starts)
    ]
    return max(found, key=lambda f: f[1])


def _from(matrices: np.ndarray, chosen: list[int], excursion: int) -> tuple[list[int], float]:
    """Excursions of growing length, alternately above and below n, until none of them gains."""
    best = _log_det(matrices, chosen)
    length = 1
    while length <= excursion:
        for first in (_add, _remove):
            second = _remove if first is _add else _add
            tried = list(chosen)
            for step in (first,) * length + (second,) * length:
                step(matrices, tried)
            value = _log_det(matrices, tried)
            if value > best + 1e-9:
                chosen, best, length = tried, value, 0
                break
        length += 1
    return sorted(int(k) for k in chosen), best


RIDGE = 1e-6  # of the mean information: sets with fewer rows than unknowns have to be compared, too


def _log_det(matrices: np.ndarray, chosen: list[int]) -> float:
    return float(np.linalg.slogdet(_sum(matrices, chosen))[1])


def _sum(matrices: np.ndarray, chosen: list[int]) -> np.ndarray:
    return matrices[chosen].sum(axis=0) + RIDGE * np.eye(matrices.shape[1])


def _add(matrices: np.ndarray, chosen: list[int]) -> None:
    gains = gain(np.linalg.inv(_sum(matrices, chosen)), matrices)
    gains[chosen] = -np.inf
    chosen.append(int(np.argmax(gains)))


def _remove(matrices: np.ndarray, chosen: list[int]) -> None:
    losses = -gain(np.linalg.inv(_sum(matrices, chosen)), -matrices[chosen])
    chosen.pop(int(np.argmin(losses)))


def sets(design: str, uplinked: bool) -> list[list[int]]:
    """Candidates for each number of POSES. They are kept in a file, since figaroh takes half a minute.
    ImportError if it is not installed."""
    crc = zlib.crc32(information(uplinked).tobytes())
    file = missions.BUILD / "study" / f"{design}-{POSES.start}-{POSES.stop}-{crc:08x}.json"
    if not file.exists():
        file.parent.mkdir(parents=True, exist_ok=True)
        file.write_text(json.dumps(_sets(design, information(uplinked))))
    return json.loads(file.read_text())


def _sets(design: str, matrices: np.ndarray) -> list[list[int]]:
    if design == "figaroh":
        order = figaroh_order(matrices)
        return [order[:n] for n in POSES]
    rng = generator(1, "detmax")
    return [detmax(matrices, n, rng)[0] for n in POSES]


def corrections(design: str, scenario: Scenario, seed: int) -> list[tuple[int, int, dict[str, float]]]:
    """For each number of POSES: visits, measurements, and the correction that they give."""
    uplinked, site = scenario.name == "uplinked", Site(scenario, seed)
    out = []
    for chosen in sets(design, uplinked):
        data = [d for d in map(site.measure, chosen) if d is not None]
        out.append((len(chosen), len(data), fit(joined(data), uplinked) if data else {}))
    return out
