"""What can be hidden: every kind with the joints it may sit at and the size of one prior sigma.

A case names a kind, perhaps a joint, and a size in sigmas. One parameter gets plus or minus that size;
several get a random direction with that RMS size. Constants (time constants, moments) are drawn as well.
"""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from . import arm_side as arm
from . import eye
from .plant import Effect
from .session import TEMP_MEAN_C

N = 7
# Vendor's gear numbers: turns of each motor per turn of each joint. Joints 2/3 and 5/6 share two motors.
GEAR = np.diag([42.0, 28.25, 28.25 / 1.68, 18.0, 9.48, 9.48, 14.93])
GEAR[1, 2], GEAR[2, 1], GEAR[2, 2] = -28.25 / 1.68, 28.25, 28.25 / 1.68
GEAR[4, 5], GEAR[5, 4], GEAR[5, 5] = -9.48, 9.48, 9.48
GEAR_RATIO = (42.0, 28.25, 28.25, 18.0, 9.48, 9.48, 14.93)


@dataclass(frozen=True)
class Scene:
    """What a kind may need to know of the campaign."""

    spec: dict
    span_s: float
    home: np.ndarray  # pose of frame 0 in the base frame
    rng: np.random.Generator | None


@dataclass(frozen=True)
class Kind:
    """sigma: one prior sigma of each parameter (per joint if it sits at joints); places: joints (from 1) or
    pairs where it can be; together: whether it may sit at all of them at once; positive: only one sign is
    possible (nothing springs up under its weight)."""

    name: str
    about: str
    sigma: tuple[float, ...]
    make: Callable[[Scene, np.ndarray, tuple], Effect]
    places: tuple = ()
    together: bool = True
    positive: bool = False


def _spread(theta: np.ndarray, places: tuple) -> np.ndarray:
    """(parameters, 7): values at their joints, zero elsewhere."""
    out = np.zeros((theta.shape[1], N))
    for row, j in zip(theta, places, strict=True):
        out[:, j - 1] = row
    return out


def _at_joints(build) -> Callable[[Scene, np.ndarray, tuple], Effect]:
    return lambda scene, theta, places: build(scene, *_spread(theta, places))


def _whole(build) -> Callable[[Scene, np.ndarray, tuple], Effect]:
    return lambda scene, theta, _places: build(scene, *theta[0])


def _at_pair(build) -> Callable[[Scene, np.ndarray, tuple], Effect]:
    return lambda scene, theta, places: build(scene, (places[0][0] - 1, places[0][1] - 1), *theta[0])


def _motor_wave(scene: Scene, size: np.ndarray) -> Effect:
    wave = arm.MotorWave(GEAR, np.zeros(N), scene.rng.uniform(0, 2 * np.pi, N))
    wave.amplitude = size * np.diag(GEAR)
    return wave


def _differential_wave(scene: Scene, pair: tuple[int, int], a: float, b: float) -> Effect:
    size = np.zeros(N)
    size[list(pair)] = a, b
    return arm.MotorWave(GEAR, size, scene.rng.uniform(0, 2 * np.pi, N))


def _moment(scene: Scene) -> float:
    return scene.span_s * scene.rng.uniform(0.2, 0.8)


def _slow(scene: Scene, size=None):
    low, high = np.log(scene.span_s / 40.0), np.log(scene.span_s / 3.0)
    return np.exp(scene.rng.uniform(low, high, size))


def _two_drivers(scene: Scene, joint: int, size: float) -> Effect:
    others = [j for j in range(N) if j not in (joint, 0)]
    a, b = scene.rng.choice(others, 2, replace=False)
    return arm.Function(joint, lambda now: size * np.tanh(now.q[a]) * np.cos(now.q[b]))


_EVERY, _LOADED, _HEAVY = (1, 2, 3, 4, 5, 6, 7), (2, 3, 4, 5, 6), (2, 3, 4)
_MM, _MRAD = 1e-3, 1e-3
_SHIFT_TURN = (1 * _MM,) * 3 + (1.5 * _MRAD,) * 3

_LIST = [
    Kind(
        "compliance",
        "cable springs",
        (2e-4,),
        _at_joints(lambda _s, c: arm.Compliance(c)),
        _LOADED,
        positive=True,
    ),
    Kind(
        "droop",
        "commanded angles logged",
        (2e-4,),
        _at_joints(lambda _s, c: arm.Droop(c)),
        _LOADED,
        positive=True,
    ),
    Kind(
        "payload_sag",
        "sag under payload",
        (2e-4,),
        _at_joints(lambda _s, c: arm.PayloadSag(c)),
        _LOADED,
        positive=True,
    ),
    Kind(
        "differential",
        "compliance through a shared differential",
        (1e-4,),
        _at_pair(lambda _s, pair, c: arm.DifferentialCoupling(pair, c)),
        ((2, 3), (5, 6)),
        False,
        positive=True,
    ),
    Kind(
        "ratio",
        "transmission ratio",
        (1e-3,),
        _at_joints(lambda s, k: arm.Ratio(k, s.spec["motion"]["home_rad"])),
        _EVERY,
    ),
    Kind(
        "routing",
        "cable taken along by another joint",
        (1e-3,),
        _at_pair(lambda _s, pair, c: arm.Routing(*pair, c)),
        tuple((i, j) for i in _EVERY for j in _EVERY if i != j),
        False,
    ),
    Kind(
        "eccentricity",
        "once a turn",
        (1 * _MRAD,) * 2,
        _at_joints(lambda _s, a, b: arm.Eccentricity(a, b)),
        _EVERY,
    ),
    Kind("oval", "twice a turn", (0.5 * _MRAD,) * 2, _at_joints(lambda _s, a, b: arm.Oval(a, b)), _EVERY),
    Kind(
        "motor_wave", "motor error of an uncoupled joint", (0.5 * _MRAD,), _at_joints(_motor_wave), (1, 4, 7)
    ),
    Kind(
        "differential_wave",
        "motor error behind a differential",
        (15 * _MRAD,) * 2,
        _at_pair(_differential_wave),
        ((2, 3), (5, 6)),
        False,
    ),
    Kind(
        "hysteresis",
        "friction wind-up with memory",
        (1 * _MRAD,),
        _at_joints(lambda _s, h: arm.FrictionWindup(h)),
        _EVERY,
    ),
    Kind(
        "gravity_backlash",
        "play that gravity takes up",
        (1 * _MRAD,),
        _at_joints(lambda s, b: arm.GravityBacklash(b, s.rng.uniform(0.5, 1.5))),
        _LOADED,
    ),
    Kind(
        "wobble", "bearing wobble", (0.5 * _MRAD,) * 2, _at_joints(lambda _s, a, b: arm.Wobble(a, b)), _EVERY
    ),
    Kind(
        "bending",
        "a link bends and twists",
        (8e-5,),
        _at_joints(lambda _s, e: arm.Bending(e)),
        (3, 5),
        False,
        positive=True,
    ),
    Kind(
        "base_flex",
        "deck and mount bend",
        (5e-5,) * 2,
        _whole(lambda s, x, y: arm.BaseFlex(s.home, x, y, (0, 0, 0))),
        positive=True,
    ),
    Kind(
        "base_tilt",
        "base plate tilted",
        (2 * _MRAD,) * 2,
        _whole(lambda s, x, y: arm.BaseMoved(s.home, (x, y, 0), (0, 0, 0))),
    ),
    Kind(
        "base_shift",
        "base plate shifted",
        (1 * _MM,) * 3,
        _whole(lambda s, *p: arm.BaseMoved(s.home, (0, 0, 0), p)),
    ),
    Kind(
        "settling",
        "lander settles",
        (1.5 * _MRAD,) * 3,
        _whole(lambda s, *w: arm.BaseSettling(s.home, w, _slow(s), (0, 0, 0))),
    ),
    Kind(
        "tool_shift",
        "tool bent",
        (1 * _MM,) * 3 + (4 * _MRAD,) * 3,
        _whole(lambda _s, *x: arm.ToolMoved(x[:3], x[3:])),
    ),
    Kind(
        "link_growth",
        "links grow with temperature",
        (1.8e-5,),
        _whole(lambda s, a: arm.LinkGrowth(s.spec, a, TEMP_MEAN_C)),
    ),
    Kind(
        "thermal_zero",
        "zeros drift with temperature",
        (3e-5,),
        _at_joints(lambda _s, b: arm.ThermalZero(b, TEMP_MEAN_C)),
        _EVERY,
    ),
    Kind("creep", "cables creep", (1.5 * _MRAD,), _at_joints(lambda s, r: arm.Creep(r, _slow(s, N))), _EVERY),
    Kind(
        "encoder_step",
        "counts lost",
        (3 * _MRAD,),
        _at_joints(lambda s, d: arm.EncoderStep(d, _moment(s))),
        _EVERY,
        False,
    ),
    Kind("latency", "picture later than reading", (0.15,), _whole(lambda _s, dt: arm.Latency(dt))),
    Kind(
        "camera_shift",
        "camera stands elsewhere",
        _SHIFT_TURN,
        _whole(lambda _s, *x: eye.CameraMoved(x[:3], x[3:])),
    ),
    Kind(
        "camera_step",
        "camera is knocked",
        _SHIFT_TURN,
        _whole(lambda s, *x: eye.CameraMoved(x[:3], x[3:], _moment(s))),
    ),
    Kind(
        "head_error",
        "pan and tilt scale",
        (2 * _MRAD,) * 2,
        _whole(lambda s, a, b: eye.HeadError(a, b, (0.3e-3, 0.3e-3), s.rng.uniform(0, 6.28, 2))),
    ),
    Kind("focal", "focal length", (4e-3,), _whole(lambda _s, e: eye.Lens(focal=e))),
    Kind(
        "thermal_focal",
        "focal length follows temperature",
        (4e-5,),
        _whole(lambda _s, g: eye.Lens(focal_per_k=g, t0_c=TEMP_MEAN_C)),
    ),
    Kind(
        "principal_point", "principal point", (1.5e-3,) * 2, _whole(lambda _s, a, b: eye.PrincipalPoint(a, b))
    ),
    Kind("radial", "radial lens distortion", (1e-2,) * 2, _whole(lambda _s, a, b: eye.Lens(radial=(a, b)))),
    Kind(
        "decentring",
        "decentring lens distortion",
        (1e-3,) * 2,
        _whole(lambda _s, a, b: eye.Lens(decentring=(a, b))),
    ),
    Kind("tag_size", "tags printed too large", (4e-3,), _whole(lambda _s, e: eye.TagSize(e))),
    Kind(
        "second_tag",
        "second tag moved on its mount",
        (1 * _MM,) * 3 + (4 * _MRAD,) * 3,
        _whole(lambda _s, *x: eye.TagMount(1, x[:3], x[3:])),
    ),
    Kind(
        "incidence", "depth depends on incidence", (1.5 * _MM,), _whole(lambda _s, b: eye.DepthByIncidence(b))
    ),
    Kind(
        "incidence_tilt",
        "tilt depends on incidence",
        (8 * _MRAD,),
        _whole(lambda _s, c: eye.TiltByIncidence(c)),
    ),
    Kind("blooming", "bright tags look larger", (0.1,), _whole(lambda _s, px: eye.Lens(grown_px=px))),
    Kind(
        "two_drivers",
        "joint error tanh(q_a) cos(q_b)",
        (3 * _MRAD,),
        lambda s, theta, places: _two_drivers(s, places[0] - 1, theta[0, 0]),
        _HEAVY,
        False,
    ),
]
KINDS = {kind.name: kind for kind in _LIST}


class UnknownKind(ValueError):
    """A case asks for something there is not."""


@dataclass(frozen=True)
class Wish:
    """One hidden effect: kind, place ("all", or the joint numbers), size in prior sigmas."""

    kind: str
    place: tuple[int, ...] | str
    size: float


def parse(text: str, size: float, rng: np.random.Generator) -> Wish:
    """ "ratio[3]", "ratio[all]", "ratio" (a place is drawn, or all); "ratio@2" says a size."""
    match = re.fullmatch(r"(\w+)(?:\[(all|\d(?:,\d)*)\])?(?:@([\d.]+))?", text.strip())
    if not match or match[1] not in KINDS:
        raise UnknownKind(f"{text!r} is no hidden effect; there are none, {', '.join(KINDS)}")
    kind = KINDS[match[1]]
    size = float(match[3]) if match[3] else size
    if not kind.places:
        if match[2]:
            raise UnknownKind(f"{kind.name} has no place; leave [{match[2]}] away")
        return Wish(kind.name, (), size)
    if match[2] == "all" or (match[2] is None and kind.together and rng.random() < 0.5):
        if not kind.together:
            raise UnknownKind(f"{kind.name} sits at one place only")
        return Wish(kind.name, "all", size)
    if match[2] is None:
        place = kind.places[rng.integers(len(kind.places))]
        return Wish(kind.name, place if isinstance(place, tuple) else (place,), size)
    place = tuple(int(j) for j in match[2].split(","))
    if (place if len(place) > 1 else place[0]) not in kind.places:
        raise UnknownKind(f"{kind.name} can be at {', '.join(map(str, kind.places))}, not at {match[2]}")
    return Wish(kind.name, place, size)


def draw(wish: Wish, scene: Scene) -> tuple[Effect, list]:
    """The effect with its random constants, and its parameter values (for the sealed answer)."""
    kind = KINDS[wish.kind]
    if wish.place == "all":
        places = kind.places
    elif wish.place:
        places = (wish.place,) if isinstance(kind.places[0], tuple) else wish.place
    else:
        places = ((),)
    shape = (len(places), len(kind.sigma))
    theta = scene.rng.standard_normal(shape)
    theta *= wish.size * np.sqrt(theta.size) / np.linalg.norm(theta)
    theta *= np.array(kind.sigma)
    theta = np.abs(theta) if kind.positive else theta
    return kind.make(scene, theta, places), theta.tolist()


def units(name: str, scene: Scene, place: tuple[int, ...] = ()) -> list[Effect]:
    """One effect for each parameter of a kind at a place, each one prior sigma large."""
    kind = KINDS[name]
    thetas = np.eye(len(kind.sigma)) * np.array(kind.sigma)
    return [kind.make(scene, theta[None, :], place or ((),)) for theta in thetas]
