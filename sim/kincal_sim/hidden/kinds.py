"""What can be hidden: every kind with the joints it may sit at and the size of one prior sigma.

A case names a kind, perhaps a joint, and a size in sigmas. One parameter gets plus or minus that size;
several get a random direction with that RMS size. Constants (time constants, times of a step) are sampled.
"""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from ..mechanics.effects import JointCompliance, JointFunction
from ..mechanics.plant import Effect
from . import mechanical_effects as mech
from . import optical_effects as opt
from .campaign import TEMP_MEAN_C

N = 7
# Vendor's gear numbers: turns of each motor per turn of each joint. Joints 2/3 and 5/6 share two motors.
GEAR = np.diag([42.0, 28.25, 28.25 / 1.68, 18.0, 9.48, 9.48, 14.93])
GEAR[1, 2], GEAR[2, 1], GEAR[2, 2] = -28.25 / 1.68, 28.25, 28.25 / 1.68
GEAR[4, 5], GEAR[5, 4], GEAR[5, 5] = -9.48, 9.48, 9.48
GEAR_RATIO = (42.0, 28.25, 28.25, 18.0, 9.48, 9.48, 14.93)

ALL, LOADED, HEAVY = (1, 2, 3, 4, 5, 6, 7), (2, 3, 4, 5, 6), (2, 3, 4)
DIFFERENTIALS = ((2, 3), (5, 6))
OTHER_PAIRS = tuple((i, j) for i in ALL for j in ALL if i != j)
MM, MRAD = 1e-3, 1e-3
CAMERA_SIGMA = (1 * MM,) * 3 + (1.5 * MRAD,) * 3
TOOL_SIGMA = (1 * MM,) * 3 + (4 * MRAD,) * 3


class UnknownKind(ValueError):
    """A case asks for something that does not exist."""


@dataclass(frozen=True)
class Context:
    """What a kind may need to know of the campaign. spec: the nominal arm; span_s: duration; T_base_frame0:
    nominal pose of frame 0 (4x4); rng: for constants."""

    spec: dict
    span_s: float
    T_base_frame0: np.ndarray
    rng: np.random.Generator

    def time_s(self) -> float:
        """A time in the middle of the campaign."""
        return self.span_s * self.rng.uniform(0.2, 0.8)

    def time_constant_s(self, size: int | None = None) -> Any:
        """A time constant that shows within the campaign; (size,) of them."""
        low, high = np.log(self.span_s / 40.0), np.log(self.span_s / 3.0)
        return np.exp(self.rng.uniform(low, high, size))


# (context, theta (places, parameters), places) -> effect
Make = Callable[[Context, np.ndarray, tuple], Effect]


@dataclass(frozen=True)
class Kind:
    """sigma: one prior sigma of each parameter (per joint if it sits at joints); places: joints (from 1) or
    pairs where it can be; together: whether it may sit at all of them at once; positive: only one sign is
    possible (nothing springs up under its weight)."""

    name: str
    about: str
    sigma: tuple[float, ...]
    places: tuple = ()
    together: bool = True
    positive: bool = False
    make: Make = field(kw_only=True)


@dataclass(frozen=True)
class Request:
    """One hidden effect: kind, place ("all", or the joint numbers), size in prior sigmas."""

    kind: str
    place: tuple[int, ...] | str
    size: float


# ---- the table --------------------------------------------------------------------------------------


def _at_joints(build: Callable[..., Effect]) -> Make:
    """build(context, *values (7,) of each parameter, zero elsewhere)"""

    def make(context: Context, theta: np.ndarray, places: tuple) -> Effect:
        values = np.zeros((theta.shape[1], N))
        for row, j in zip(theta, places, strict=True):
            values[:, j - 1] = row
        return build(context, *values)

    return make


def _anywhere(build: Callable[..., Effect]) -> Make:
    """build(context, *parameters)"""
    return lambda context, theta, _places: build(context, *theta[0])


def _at_pair(build: Callable[..., Effect]) -> Make:
    """build(context, pair of joint indices from 0, *parameters)"""
    return lambda context, theta, places: build(context, (places[0][0] - 1, places[0][1] - 1), *theta[0])


def _motor_wave(context: Context, size: np.ndarray) -> Effect:
    phase = context.rng.uniform(0, 2 * np.pi, N)
    return mech.MotorWave(GEAR, size * np.diag(GEAR), phase)


def _differential_wave(context: Context, pair: tuple[int, int], a: float, b: float) -> Effect:
    size = np.zeros(N)
    size[list(pair)] = a, b
    return mech.MotorWave(GEAR, size, context.rng.uniform(0, 2 * np.pi, N))


def _run_out(context: Context, cos: np.ndarray, sin: np.ndarray) -> Effect:
    return mech.OutOfRound(cos, sin, context.rng.choice((-1, 2)), tilts=False)


def _settling(context: Context, *turn_rad: float) -> Effect:
    return mech.BaseSettling(context.T_base_frame0, turn_rad, context.time_constant_s(), (0, 0, 0))


def _pantilt_error(context: Context, pan: float, tilt: float) -> Effect:
    return opt.PanTiltError(pan, tilt, (0.3e-3, 0.3e-3), context.rng.uniform(0, 6.28, 2))


def _two_drivers(context: Context, theta: np.ndarray, places: tuple) -> Effect:
    joint, size = places[0] - 1, theta[0, 0]
    others = [j for j in range(N) if j not in (joint, 0)]
    a, b = context.rng.choice(others, 2, replace=False)
    return JointFunction(
        joint,
        lambda at, _: size * np.tanh(at.q_rad[a]) * np.cos(at.q_rad[b]),
        drivers=(int(a) + 1, int(b) + 1),
    )


# fmt: off
_KINDS = (
    Kind("compliance", "cable springs", (2e-4,), LOADED, positive=True,
         make=_at_joints(lambda _, c: JointCompliance(c, mech.HARDENING_NM))),
    # A proportional controller stands off by torque over gain.
    Kind("droop", "commanded angles logged", (2e-4,), LOADED, positive=True,
         make=_at_joints(lambda _, c: JointCompliance(c))),
    Kind("payload_sag", "sag under payload", (2e-4,), LOADED, positive=True,
         make=_at_joints(lambda _, c: mech.PayloadSag(c))),
    Kind("differential", "compliance through a shared differential", (1e-4,), DIFFERENTIALS, together=False,
         positive=True, make=_at_pair(lambda _, pair, c: mech.DifferentialCoupling(pair, c))),
    Kind("ratio", "transmission ratio", (1e-3,), ALL,
         make=_at_joints(lambda context, k: mech.Ratio(k, context.spec["motion"]["park_rad"]))),
    Kind("routing", "cable taken along by another joint", (1e-3,), OTHER_PAIRS, together=False,
         make=_at_pair(lambda _, pair, c: mech.Routing(pair[0], pair[1], c))),
    Kind("eccentricity", "once a turn", (1 * MRAD,) * 2, ALL,
         make=_at_joints(lambda _, a, b: mech.Eccentricity(a, b))),
    Kind("oval", "twice a turn", (0.5 * MRAD,) * 2, ALL,
         make=_at_joints(lambda _, a, b: mech.OvalPulley(a, b))),
    Kind("motor_wave", "motor error of an uncoupled joint", (0.5 * MRAD,), (1, 4, 7),
         make=_at_joints(_motor_wave)),
    Kind("differential_wave", "motor error behind a differential", (15 * MRAD,) * 2, DIFFERENTIALS,
         together=False, make=_at_pair(_differential_wave)),
    Kind("hysteresis", "friction wind-up with memory", (1 * MRAD,), ALL,
         make=_at_joints(lambda _, h: mech.FrictionWindup(h))),
    Kind("gravity_backlash", "play that gravity takes up", (1 * MRAD,), LOADED,
         make=_at_joints(lambda context, b: mech.GravityBacklash(b, context.rng.uniform(0.5, 1.5)))),
    Kind("wobble", "bearing wobble", (0.5 * MRAD,) * 2, ALL,
         make=_at_joints(lambda _, a, b: mech.Wobble(a, b))),
    Kind("out_of_round", "axis tilts twice a turn", (0.5 * MRAD,) * 2, ALL,
         make=_at_joints(lambda _, a, b: mech.OutOfRound(a, b, 2, tilts=True))),
    Kind("run_out", "axis shifts as it turns", (0.2 * MM,) * 2, ALL, make=_at_joints(_run_out)),
    Kind("bending", "a link bends and twists", (8e-5,), (3, 5), together=False, positive=True,
         make=_at_joints(lambda _, e: mech.Bending(e))),
    Kind("base_flex", "deck and mount bend", (5e-5,) * 2, positive=True,
         make=_anywhere(lambda context, x, y: mech.BaseFlex(context.T_base_frame0, x, y, (0, 0, 0)))),
    Kind("base_tilt", "base plate tilted", (2 * MRAD,) * 2,
         make=_anywhere(lambda context, x, y: mech.BaseMoved(context.T_base_frame0, (x, y, 0), (0, 0, 0)))),
    Kind("base_shift", "base plate shifted", (1 * MM,) * 3,
         make=_anywhere(lambda context, *p: mech.BaseMoved(context.T_base_frame0, (0, 0, 0), p))),
    Kind("settling", "lander settles", (1.5 * MRAD,) * 3, make=_anywhere(_settling)),
    Kind("tool_shift", "tool bent", TOOL_SIGMA,
         make=_anywhere(lambda _, *x: mech.ToolMoved(x[:3], x[3:]))),
    Kind("link_growth", "links grow with temperature", (1.8e-5,),
         make=_anywhere(lambda context, a: mech.LinkGrowth(context.spec, a, TEMP_MEAN_C))),
    Kind("thermal_zero", "zeros drift with temperature", (3e-5,), ALL,
         make=_at_joints(lambda _, b: mech.ThermalZero(b, TEMP_MEAN_C))),
    Kind("creep", "cables creep", (1.5 * MRAD,), ALL,
         make=_at_joints(lambda context, r: mech.Creep(r, context.time_constant_s(N)))),
    Kind("encoder_step", "counts lost", (3 * MRAD,), ALL, together=False,
         make=_at_joints(lambda context, d: mech.EncoderStep(d, context.time_s()))),
    Kind("latency", "frame later than reading", (0.15,),
         make=_anywhere(lambda _, dt: mech.Latency(dt))),
    Kind("camera_shift", "camera stands elsewhere", CAMERA_SIGMA,
         make=_anywhere(lambda _, *x: opt.CameraMoved(x[:3], x[3:]))),
    Kind("camera_step", "camera is knocked", CAMERA_SIGMA,
         make=_anywhere(lambda context, *x: opt.CameraMoved(x[:3], x[3:], context.time_s()))),
    Kind("pantilt_error", "pan and tilt scale", (2 * MRAD,) * 2, make=_anywhere(_pantilt_error)),
    Kind("focal", "focal length", (4e-3,), make=_anywhere(lambda _, e: opt.Lens(focal=e))),
    Kind("thermal_focal", "focal length follows temperature", (4e-5,),
         make=_anywhere(lambda _, g: opt.Lens(focal_per_k=g, t0_c=TEMP_MEAN_C))),
    Kind("principal_point", "principal point", (1.5e-3,) * 2,
         make=_anywhere(lambda _, a, b: opt.PrincipalPoint(a, b))),
    Kind("radial", "radial lens distortion", (1e-2,) * 2,
         make=_anywhere(lambda _, a, b: opt.Lens(radial=(a, b)))),
    Kind("decentring", "decentring lens distortion", (1e-3,) * 2,
         make=_anywhere(lambda _, a, b: opt.Lens(decentring=(a, b)))),
    Kind("tag_size", "tags printed too large", (4e-3,), make=_anywhere(lambda _, e: opt.TagSize(e))),
    Kind("second_tag", "second tag moved on its mount", TOOL_SIGMA,
         make=_anywhere(lambda _, *x: opt.TagMoved(1, x[:3], x[3:]))),
    Kind("incidence", "depth depends on incidence", (1.5 * MM,),
         make=_anywhere(lambda _, b: opt.DepthByIncidence(b))),
    Kind("incidence_tilt", "tilt depends on incidence", (8 * MRAD,),
         make=_anywhere(lambda _, c: opt.TiltByIncidence(c))),
    Kind("blooming", "bright tags look larger", (0.1,),
         make=_anywhere(lambda _, px: opt.Lens(grown_px=px))),
    Kind("two_drivers", "joint error tanh(q_a) cos(q_b)", (3 * MRAD,), HEAVY, together=False,
         make=_two_drivers),
)
# fmt: on
KINDS = {kind.name: kind for kind in _KINDS}


# ---- from a text to an effect -----------------------------------------------------------------------


def parse(text: str, size: float, rng: np.random.Generator) -> Request:
    """ "ratio[3]", "ratio[all]", "ratio" (place at random, or all); "ratio@2" names a size in sigmas.

    size: where the text names none. Raises UnknownKind.
    """
    match = re.fullmatch(r"(\w+)(?:\[(all|\d(?:,\d)*)\])?(?:@([\d.]+))?", text.strip())
    if not match or match[1] not in KINDS:
        raise UnknownKind(f"{text!r} is no hidden effect; known: none, {', '.join(KINDS)}")
    kind = KINDS[match[1]]
    return Request(kind.name, _place(kind, match[2], rng), float(match[3]) if match[3] else size)


def _place(kind: Kind, text: str | None, rng: np.random.Generator) -> tuple[int, ...] | str:
    if not kind.places:
        if text:
            raise UnknownKind(f"{kind.name} has no place; leave out [{text}]")
        return ()
    if text == "all" or (text is None and kind.together and rng.random() < 0.5):
        if not kind.together:
            raise UnknownKind(f"{kind.name} sits at one place only")
        return "all"
    if text is None:
        place = kind.places[rng.integers(len(kind.places))]
        return place if isinstance(place, tuple) else (place,)
    place = tuple(int(j) for j in text.split(","))
    if (place if len(place) > 1 else place[0]) not in kind.places:
        raise UnknownKind(f"{kind.name} can be at {', '.join(map(str, kind.places))}, not at {text}")
    return place


def sample(request: Request, context: Context) -> tuple[Effect, list]:
    """The effect with its random constants, and its parameter values (for the sealed answer)."""
    kind = KINDS[request.kind]
    places = _places(kind, request.place)
    theta = context.rng.standard_normal((len(places), len(kind.sigma)))
    theta *= request.size * np.sqrt(theta.size) / np.linalg.norm(theta)
    theta *= np.array(kind.sigma)
    theta = np.abs(theta) if kind.positive else theta
    return kind.make(context, theta, places), theta.tolist()


def _places(kind: Kind, place: tuple[int, ...] | str) -> tuple:
    """The entries of kind.places that a place means; one empty entry for a kind without places."""
    if place == "all":
        return kind.places
    if not place or isinstance(place, str):
        return ((),)
    return (place,) if isinstance(kind.places[0], tuple) else place


def unit_effects(name: str, context: Context, place: tuple[int, ...] = ()) -> list[Effect]:
    """One effect for each parameter of a kind at a place, each one prior sigma large."""
    kind = KINDS[name]
    thetas = np.eye(len(kind.sigma)) * np.array(kind.sigma)
    return [kind.make(context, theta[None, :], place or ((),)) for theta in thetas]
