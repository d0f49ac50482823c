"""One sealed case: errors, hidden effects, a campaign, noise; the files to be read, and the sealed answer."""

from __future__ import annotations

import json
from dataclasses import asdict
from pathlib import Path

import numpy as np

from ..mechanics.plant import Effect, turn
from ..transforms import transform
from . import optics
from .bench import NOISE, NOISES, Bench, Observation
from .files import COLUMNS, QUERY_COLUMNS, observation_values, pose_values, state_values, write_csv
from .seal import seal
from .spec import CaseSpec


def make(spec: CaseSpec, folder: Path) -> dict:
    """Write poses.csv, queries.csv and sealed.json into `folder`; gives the manifest's line.

    queries.csv: states of the unseen region, positions left at zero; the true ones are in the seal.
    """
    folder.mkdir(parents=True, exist_ok=True)
    bench = Bench(spec)
    poses, replicate = bench.campaign()
    effects, descriptions = bench.hide()
    seen = [bench.observe(at, effects) for at in poses]
    noisy, outliers = add_noise(seen, spec, bench.rng(NOISES))
    names = [f"p{i:03d}" for i in range(spec.n)]
    rows = [
        [name, *observation_values(one, T, bench.optics, bench.arm_spec), group]
        for name, one, T, group in zip(names, seen, noisy, replicate, strict=True)
    ]
    write_csv(folder / "poses.csv", COLUMNS, rows)
    for effect, description in zip(effects, descriptions, strict=True):
        description |= bench.visibility(poses, [effect], bench.alternatives(description))
    answer = {
        "spec": asdict(spec),
        "effects": descriptions,
        "errors": bench.errors,
        "outliers": [names[i] for i in outliers],
        "unseen": _write_queries(bench, effects, folder / "queries.csv"),
    }
    sealed = seal(answer)
    (folder / "sealed.json").write_text(json.dumps(sealed) + "\n", encoding="utf-8")
    return {"id": spec.id, "n": spec.n, "sha256": sealed["sha256"]}


def _write_queries(bench: Bench, effects: list[Effect], path: Path) -> list[list[float]]:
    """True poses (position, quaternion) of the unseen region, in the order of the file."""
    unseen = bench.unseen()
    rows = [[f"u{i:03d}", *state_values(at), 0.0, 0.0, 0.0] for i, at in enumerate(unseen)]
    write_csv(path, QUERY_COLUMNS, rows)
    return [pose_values(bench.plant.settle(at, effects).T_base_tool) for at in unseen]


def add_noise(
    seen: list[Observation], spec: CaseSpec, rng: np.random.Generator
) -> tuple[list[np.ndarray], list[int]]:
    """Tool poses (4x4, base frame) with noise and gross errors, and the indices of the latter."""
    poses = [_noisy(one, spec.noise, rng) for one in seen]
    n = len(seen)
    outliers = sorted(int(i) for i in rng.choice(n, round(spec.outliers * n), replace=False))
    for i in outliers:
        poses[i] = _gross_error(seen[i], poses[i], rng)
    return poses, outliers


def _noisy(seen: Observation, scale: float, rng: np.random.Generator) -> np.ndarray:
    e = scale * NOISE * rng.standard_normal(6)
    C, T = seen.T_base_cam[:3, :3], seen.T_base_tool
    return transform(T[:3, 3] + C @ e[:3], turn(C @ e[3:]) @ T[:3, :3])


def _gross_error(seen: Observation, T: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """One of three: the mirrored solution of PnP, a wrong range, or a wrong corner."""
    return (_mirrored, _wrong_range, _wrong_corner)[rng.integers(3)](seen, T.copy(), rng)


def _mirrored(seen: Observation, T: np.ndarray, _rng: np.random.Generator) -> np.ndarray:
    lens = seen.T_base_cam[:3, 3]
    ray = (T[:3, 3] - lens) / np.linalg.norm(T[:3, 3] - lens)
    axis = np.cross(seen.T_base_cam[:3, :3] @ seen.T_cam_tag[:3, 2], ray)
    angle = max(2.0 * optics.incidence_rad(seen.T_cam_tag), 0.1)
    T[:3, :3] = turn(axis / max(np.linalg.norm(axis), 1e-9) * angle) @ T[:3, :3]
    return T


def _wrong_range(seen: Observation, T: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    lens = seen.T_base_cam[:3, 3]
    T[:3, 3] = lens + (T[:3, 3] - lens) * (1.0 + rng.choice([-1, 1]) * rng.uniform(0.02, 0.08))
    return T


def _wrong_corner(seen: Observation, T: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    C = seen.T_base_cam[:3, :3]
    T[:3, 3] += C @ (rng.standard_normal(3) * 0.015)
    T[:3, :3] = turn(C @ (rng.standard_normal(3) * 0.08)) @ T[:3, :3]
    return T
