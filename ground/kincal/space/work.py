"""The parts of a search that two processes share out. Results do not depend on how many there are."""

from __future__ import annotations

import os
import pickle
import queue
import subprocess
import sys
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from typing import Any

import numpy as np

from kincal import tables
from kincal.errors import KincalError
from kincal.geometry import quat_to_R, rotation_angle

from .checks import Checks
from .description import Description

BLOCK = 250  # tool poses drawn from one stream of random numbers
_TRIES = 3  # starts of the inverse kinematics for one tool pose
_UNREACHED = "not reached inside the joint margins"


@dataclass(frozen=True)
class Sample:
    """A tool pose that was examined: joints if it was reached, and why it was dropped ("" if not)."""

    p_m: np.ndarray
    q: np.ndarray | None
    reason: str


def _quats_to_R(w: np.ndarray, x: np.ndarray, y: np.ndarray, z: np.ndarray) -> np.ndarray:
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ]
    ).transpose(2, 0, 1)


def tool_poses(
    checks: Checks, rng: np.random.Generator, n: int, lo: Any, hi: Any
) -> tuple[np.ndarray, np.ndarray]:
    """Positions in a box; a tag, its incidence inside the cone, the side it leans to and the spin about the
    line of sight drawn evenly."""
    p = rng.uniform(lo, hi, (n, 3))
    tag = rng.integers(len(checks.camera.tags), size=n)
    incid = np.arccos(rng.uniform(np.cos(checks.desc.view.incid_max_rad), 1.0, n))
    lean, spin = rng.uniform(-np.pi, np.pi, (2, n))
    z = p - checks.looks(p, np.tile(np.eye(3), (n, 1, 1))).eye
    z /= np.linalg.norm(z, axis=1)[:, None]
    x = np.cross(z, np.where(np.abs(z[:, 2:]) < 0.9, [0.0, 0.0, 1.0], [1.0, 0.0, 0.0]))
    x /= np.linalg.norm(x, axis=1)[:, None]
    sight = np.stack([x, np.cross(z, x), z], axis=2)  # a tag seen straight on, some spin
    c, s, none = np.cos(0.5 * incid), np.sin(0.5 * incid), np.zeros(n)
    tilt = _quats_to_R(c, s * np.cos(lean), s * np.sin(lean), none)
    turn = _quats_to_R(np.cos(0.5 * spin), none, none, np.sin(0.5 * spin))
    back = np.array([R.T for _, R in checks.camera.tags])
    return p, sight @ tilt @ turn @ back[tag]


def examine(checks: Checks, block: int, count: int, lo: Any, hi: Any) -> list[Sample]:
    """Tool poses of one stream: in view, reached, not hidden, clear as drawn?"""
    rng = np.random.default_rng([checks.desc.seed, 2, block])
    p, R = tool_poses(checks, rng, count, lo, hi)
    starts = rng.uniform(checks.lo, checks.hi, (_TRIES, count, checks.chain.n))
    reasons, _ = checks.view_problems(p, checks.looks(p, R))
    joints: list[np.ndarray | None] = [None] * count
    beyond = checks.beyond(p, R)
    for i in range(count):
        reasons[i] = reasons[i] or _UNREACHED
    left = np.array([i for i in range(count) if reasons[i] == _UNREACHED and not beyond[i]], int)
    for start in starts:  # another elbow may do
        q, good = checks.reach(p[left], R[left], start[left])
        for i, x, reason in zip(left[good], q[good], checks.problems(q[good]), strict=True):
            joints[i], reasons[i] = x, reason
        left = np.array([i for i in left if reasons[i]], int)
    return [Sample(*s) for s in zip(p, joints, reasons, strict=True)]


def prove(checks: Checks, q: np.ndarray) -> tuple[int, str]:
    """Hub of a candidate (-1 if none), or what is in the way."""
    if found := checks.wrong_touching(q):
        return -1, f"too near with errors: {found[0]}"
    if pair := checks.leash_problem(q, checks.leash, checks.desc.clear.leash_samples, checks.stream(3, q)):
        return -1, f"servo box not clear: {pair}"
    hub = checks.hub_of(q)
    return (-1, "no clear segment to a hub") if hub is None else (hub, "")


def survives(checks: Checks, q: np.ndarray) -> int:
    """How many of the arms with errors still show a tag there."""
    return sum(checks.shown_by_wrong(q))


def recheck(
    checks: Checks, q: np.ndarray, hub: np.ndarray, leash: np.ndarray, pose: tuple, tags: int
) -> tuple[list[str], int]:
    """What does not hold at a candidate (pose, tags: as its table says), and how many sampled postures of its
    servo box touch, drawn with other random numbers than the search used."""
    what = [x for x in checks.problems(q) if x]
    (p,), (R,) = checks.poses(q)
    off, turn = float(np.linalg.norm(p - pose[0])), rotation_angle(quat_to_R(pose[1]).T @ R)
    if off > 1e-5 or turn > 1e-5:
        what.append(f"its joints lead {off * 1e3:.1f} mm and {turn * 1e3:.1f} mrad beside its pose")
    if not what and (shown := checks.tags(q)) != tags:
        what.append(f"shows tags {shown:02b}, the table says {tags:02b}")
    if found := checks.wrong_touching(q):
        what.append(f"too near with errors: {found[0]}")
    if pair := checks.segment_problem(hub, q):
        what.append(f"segment from its hub not clear: {pair}")
    rng = checks.stream(4, q)
    count = checks.desc.clear.leash_samples
    return what, sum(bool(checks.leash_problem(q, leash, 1, rng)) for _ in range(count))


def joined(checks: Checks, a: np.ndarray, b: np.ndarray) -> bool:
    return not checks.segment_problem(a, b)


JOBS: dict[str, Callable[..., Any]] = {
    "examine": examine,
    "prove": prove,
    "survives": survives,
    "recheck": recheck,
    "joined": joined,
}


def helper() -> None:
    """A helper process: description, arm and camera first, then jobs, all pickled; answers the same way."""
    source, sink = sys.stdin.buffer, sys.stdout.buffer
    desc, arm, camera = pickle.load(source)
    checks = Checks(desc, tables.decode(arm)[1], tables.decode(camera)[1])
    while True:
        try:
            job, items = pickle.load(source)
        except EOFError:
            return
        pickle.dump([JOBS[job](checks, *item) for item in items], sink)
        sink.flush()


class Crew:
    """Shares jobs among processes; results come in the order of the items, whoever did them. Helpers are
    started as `python -m kincal.space`, so that this works from any program."""

    def __init__(
        self, checks: Checks, desc: Description, arm: bytes, camera: bytes, processes: int = 2
    ) -> None:
        self.checks, self.processes = checks, processes
        self._args = pickle.dumps((desc, arm, camera))
        self._helpers: list[subprocess.Popen[bytes]] = []
        self._idle: queue.SimpleQueue[subprocess.Popen[bytes]] = queue.SimpleQueue()

    def __enter__(self) -> Crew:
        return self

    def __exit__(self, *_error: object) -> None:
        for p in self._helpers:
            p.kill()
            p.communicate()

    def _start(self) -> None:
        env = dict(os.environ, OMP_NUM_THREADS="1")
        for _ in range(self.processes):
            p = subprocess.Popen(
                [sys.executable, "-m", "kincal.space"], stdin=subprocess.PIPE, stdout=subprocess.PIPE, env=env
            )
            assert p.stdin
            p.stdin.write(self._args)
            p.stdin.flush()
            self._helpers.append(p)
            self._idle.put(p)

    def _ask(self, job: str, items: list[tuple]) -> list[Any]:
        p = self._idle.get()
        try:
            assert p.stdin and p.stdout
            pickle.dump((job, items), p.stdin)
            p.stdin.flush()
            return pickle.load(p.stdout)
        except (OSError, EOFError):
            raise KincalError("a helper process of the search ended early", f"status {p.poll()}") from None
        finally:
            self._idle.put(p)

    def map(self, job: str, items: list[tuple], chunk: int = 8) -> Iterator[Any]:
        if self.processes < 2 or len(items) <= 2 * chunk:
            for item in items:
                yield JOBS[job](self.checks, *item)
            return
        if not self._helpers:
            self._start()
        chunks = [items[i : i + chunk] for i in range(0, len(items), chunk)]
        with ThreadPoolExecutor(self.processes) as threads:
            for results in threads.map(self._ask, [job] * len(chunks), chunks):
                yield from results
