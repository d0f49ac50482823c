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
from kincal.geometry import quat_to_R

from .checks import Checks
from .description import Description

BLOCK = 250  # tool poses drawn from one stream of random numbers
_TRIES = 3  # starts of the inverse kinematics for one tool pose


@dataclass(frozen=True)
class Sample:
    """A tool pose that was examined: joints if it was reached, and why it was dropped ("" if not)."""

    p_m: np.ndarray
    q: np.ndarray | None
    reason: str


def tool_pose(checks: Checks, rng: np.random.Generator, lo: Any, hi: Any) -> tuple[np.ndarray, np.ndarray]:
    """Position in a box; a tag, its incidence inside the cone, the side it leans to and the spin about the
    line of sight drawn evenly."""
    p = rng.uniform(lo, hi)
    cam = checks.camera
    tag = int(rng.integers(len(cam.tags)))
    incid = np.arccos(rng.uniform(np.cos(checks.desc.view.incid_max_rad), 1.0))
    lean, spin = rng.uniform(-np.pi, np.pi, 2)
    pan, tilt, _ = cam.aim(p)
    eye, _ = cam.pose(pan, tilt)
    z = (p - eye) / np.linalg.norm(p - eye)
    x = np.cross(z, [0.0, 0.0, 1.0] if abs(z[2]) < 0.9 else [1.0, 0.0, 0.0])
    x /= np.linalg.norm(x)
    sight = np.column_stack([x, np.cross(z, x), z])  # a tag seen straight on, some spin
    half = lambda a: (np.cos(0.5 * a), np.sin(0.5 * a))  # noqa: E731
    (c, s), (ci, si) = half(spin), half(incid)
    turn = quat_to_R([ci, si * np.cos(lean), si * np.sin(lean), 0.0]) @ quat_to_R([c, 0.0, 0.0, s])
    return p, sight @ turn @ cam.tags[tag][1].T


def examine(checks: Checks, block: int, count: int, lo: Any, hi: Any) -> list[Sample]:
    """Tool poses of one stream: in view, reached, not hidden, clear as drawn?"""
    rng = np.random.default_rng([checks.desc.seed, 2, block])
    out = []
    for _ in range(count):
        p, R = tool_pose(checks, rng, lo, hi)
        starts = rng.uniform(checks.lo, checks.hi, (_TRIES, checks.chain.n))
        reason = checks.view_problem(p, R)[0]
        if reason:
            out.append(Sample(p, None, reason))
            continue
        reason, q = "not reached inside the joint margins", None
        for start in starts:  # another elbow may do
            found = checks.reach(p, R, start)
            if found is not None:
                q, reason = found, checks.problem(found)
                if not reason:
                    break
        out.append(Sample(p, q, reason))
    return out


def prove(checks: Checks, number: int, q: np.ndarray) -> tuple[int, str]:
    """Hub of a candidate (-1 if none), or what is in the way."""
    rng = np.random.default_rng([checks.desc.seed, 3, number])
    if found := checks.wrong_touching(q):
        return -1, f"too near with errors: {found[0]}"
    if pair := checks.leash_problem(q, checks.leash, checks.desc.clear.leash_samples, rng):
        return -1, f"servo box not clear: {pair}"
    hub = checks.hub_of(q)
    return (-1, "no clear segment to a hub") if hub is None else (hub, "")


def survives(checks: Checks, q: np.ndarray) -> int:
    """How many of the arms with errors still show a tag there."""
    return sum(checks.seen_by_wrong(q, k) for k in range(len(checks.wrong)))


def recheck(
    checks: Checks, number: int, q: np.ndarray, hub: np.ndarray, leash: np.ndarray, p: np.ndarray, tags: int
) -> tuple[list[str], int]:
    """What does not hold at a candidate (p, tags: as its table says), and how many sampled postures of its
    servo box touch, drawn with other random numbers than the search used."""
    what = [checks.problem(q)] if checks.problem(q) else []
    if (off := float(np.linalg.norm(checks.chain.fk(q)[0] - p))) > 1e-5:
        what.append(f"its joints lead {off * 1e3:.1f} mm beside its pose")
    if not what and checks.tags(q) != tags:
        what.append(f"shows tags {checks.tags(q):02b}, the table says {tags:02b}")
    if found := checks.wrong_touching(q):
        what.append(f"too near with errors: {found[0]}")
    if pair := checks.segment_problem(hub, q):
        what.append(f"segment from its hub not clear: {pair}")
    rng = np.random.default_rng([checks.desc.seed, 4, number])
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
