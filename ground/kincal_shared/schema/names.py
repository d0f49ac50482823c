"""Names of the term grammar: functions, variables, twist components, places on the arm; of acquisitions.

Names only. Their numbers are those of the flight headers (fsw/model/kc_terms.h), which `kincal.flight` reads;
tests/ground/test_schema_terms.py compares the two.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from math import isfinite
from typing import get_args

from .acquisitions import Acquisition
from .numbers import plain_number


@dataclass(frozen=True)
class Variable:
    """What a basis may depend on.

    flight: name in kc_var_t, small letters. indexed: belongs to one joint (or link). needs: what the data or
    the arm table must hold, "" if nothing. unit: of the value. of_link: its index is a link, 0 for the base;
    of_body: a link and a body beyond. In exported code a value is given by the caller, by the name `given`,
    with what it is `about` in words and its value where the caller says nothing (None: it must be given); or
    it is `computed`, an expression in Python and in C with {i} for the joint from 0, or the link.
    """

    flight: str
    unit: str
    indexed: bool = False
    needs: str = ""
    of_link: bool = False
    of_body: bool = False
    given: str = ""
    about: str = ""
    unless_given: float | None = None
    computed: tuple[str, str] | None = None


ACQUISITIONS: tuple[str, ...] = get_args(Acquisition)
"""How the next pose is chosen; in the order of their numbers (kc_acq_t)."""

# Twist of a pose from a camera by a fault of camera or target: name here -> name in kc_var_t.
PNP = {f"p{comp}": f"pnp_{comp}" for comp in ("tx", "ty", "tz", "rx", "ry", "rz")}
# What may be wrong with the image of a target's points, in a unit each (METHOD.md 13.1).
FAULTS = (
    "radial_1", "radial_2", "decentring_1", "decentring_2", "focal_x", "focal_y", "centre_x", "centre_y",
    "bow_x", "bow_y", "target_size", "target_edges",
)  # fmt: skip
# Of those, faults of a target on the tool; a fixed one that is too large is a sensor with a wrong scale.
FAULTS_ON_TOOL = ("target_size", "target_edges")

# kc_fn_t, small letters; the basis is fn(z) with z = c1 (x - c0)
FUNCTIONS = ("lin", "sin", "cos", "tanh", "ln1p", "expn", "step", "sq", "tan2", "abs")

VARIABLES = {
    "1": Variable("one", "1"),
    "q": Variable("q", "rad or m", True, computed=("q[{i}]", "q[{i}]")),
    "tau": Variable("tau", "N m", True, "mass", computed=("load.tau[{i}]", "load->tau[{i}]")),
    "Mx": Variable(
        "mx", "N m", True, "mass", of_link=True, computed=("load.moment[{i}][0]", "load->moment[{i}][0]")
    ),
    "My": Variable(
        "my", "N m", True, "mass", of_link=True, computed=("load.moment[{i}][1]", "load->moment[{i}][1]")
    ),
    "Mz": Variable(
        "mz", "N m", True, "mass", of_link=True, computed=("load.moment[{i}][2]", "load->moment[{i}][2]")
    ),
    "dir": Variable(
        "dir", "-1, 0, 1", True, "dir", given="direction", about="sign of the last motion of each joint"
    ),
    "move": Variable(
        "move",
        "rad or m",
        True,
        "move",
        given="move",
        about="change of each joint since the pose before; 0 for an arm that waited until it was at rest",
        unless_given=0.0,
    ),
    "temp": Variable("temp", "deg C", needs="temp_c", given="temp_c", about="temperature of the arm"),
    "t": Variable("t", "s", needs="t_s", given="t_s", about="time, as in the measurements"),
    "payload": Variable(
        "payload",
        "kg",
        needs="payload_kg",
        given="payload_kg",
        about="extra mass at the tool",
        unless_given=0.0,
    ),
    "range": Variable("range", "m", needs="range_m", given="range_m", about="range from camera to target"),
    "incid": Variable(
        "incid", "rad", needs="incid_rad", given="incid_rad", about="angle of incidence at the target"
    ),
    "u": Variable("u", "1", needs="image", computed=("view.u", "view->u")),
    "v": Variable("v", "1", needs="image", computed=("view.v", "view->v")),
    "r2": Variable(
        "r2",
        "1",
        needs="image",
        computed=("(view.u**2 + view.v**2)", "(view->u * view->u + view->v * view->v)"),
    ),
    "pan": Variable("pan", "rad", needs="pan_rad", given="pan_rad", about="pan encoder of the camera"),
    "tilt": Variable("tilt", "rad", needs="tilt_rad", given="tilt_rad", about="tilt encoder of the camera"),
    "qdot": Variable(
        "qdot", "rad/s or m/s", True, "qdot", given="qdot", about="joint speed", unless_given=0.0
    ),
    "taup": Variable(
        "tau_payload", "N m", True, "payload_kg", computed=("load.tau_payload[{i}]", "load->tau_payload[{i}]")
    ),
    "xcam": Variable("xcam", "m", needs="cam", computed=("view.p[0]", "view->p[0]")),
    "ycam": Variable("ycam", "m", needs="cam", computed=("view.p[1]", "view->p[1]")),
    "zcam": Variable("zcam", "m", needs="cam", computed=("view.p[2]", "view->p[2]")),
    "tag": Variable("tag", "0, 0.5, 1", needs="tag", given="tag", about="target seen: first, both, second"),
    # What gravity does whatever the masses are: its direction in the frame of a link, and the moment of 1 kg
    # at the origin of a body beyond a link, about the origin of the link's frame.
    "gx": Variable(
        "gx", "m/s^2", True, of_link=True, computed=("load.gravity[{i}][0]", "load->gravity[{i}][0]")
    ),
    "gy": Variable(
        "gy", "m/s^2", True, of_link=True, computed=("load.gravity[{i}][1]", "load->gravity[{i}][1]")
    ),
    "gz": Variable(
        "gz", "m/s^2", True, of_link=True, computed=("load.gravity[{i}][2]", "load->gravity[{i}][2]")
    ),
    "levx": Variable(
        "levx",
        "N m/kg",
        True,
        of_body=True,
        computed=("_lever(load, {i}, {body}, 0)", "lever(load, {i}, {body}, 0)"),
    ),
    "levy": Variable(
        "levy",
        "N m/kg",
        True,
        of_body=True,
        computed=("_lever(load, {i}, {body}, 1)", "lever(load, {i}, {body}, 1)"),
    ),
    "levz": Variable(
        "levz",
        "N m/kg",
        True,
        of_body=True,
        computed=("_lever(load, {i}, {body}, 2)", "lever(load, {i}, {body}, 2)"),
    ),
    # Columns of a PnP pose, computed for effects that say `image` (METHOD.md 13.1); nobody writes them.
    **{
        name: Variable(flight, "m or rad", True, "points", computed=(f"pnp[{{i}}][{c}]", f"pnp[{{i}}][{c}]"))
        for c, (name, flight) in enumerate(PNP.items())
    },
    # Without camera columns the sensor is the measurement frame itself (a laser tracker, a board): the
    # position it saw, by the same variables.
    "sx": Variable("xcam", "m", needs="own_sensor", computed=("view.p[0]", "view->p[0]")),
    "sy": Variable("ycam", "m", needs="own_sensor", computed=("view.p[1]", "view->p[1]")),
    "sz": Variable("zcam", "m", needs="own_sensor", computed=("view.p[2]", "view->p[2]")),
}

# kc_comp_t, small letters: translation and rotation along and about the axes of the frame
COMPONENTS = ("tx", "ty", "tz", "rx", "ry", "rz")

# Places without an index -> (frame, what the data must hold). Frame 0 is the base; KC_FRAME_* of the headers.
PLACES: dict[str, tuple[int | str, str]] = {
    "base": (0, ""),
    "tool": ("tool", ""),
    "camera": ("camera", "cam"),
    "sensor": ("camera", "own_sensor"),
    "meas": ("meas", "cam"),
}
# Places of one joint: joint[j] is its own axis, before[j] the frame before it, link[j] the frame after it.
JOINT_PLACES = ("joint", "before", "link")

# Constants that a basis may use by name; an effect may add some of its own with [effect.grid].
DATA_CONSTANTS = ("T0", "tstart")
GEAR_RATIO = "N"
JOINT_LETTERS = ("i", "j", "p", "k")
# The body of a gravity lever: a link's number, or the tool. Its index on board is 16 x link + body
# (kc_terms.h).
TOOL_BODY, LEVER_STRIDE = "tool", 16

# What `model add` makes of a function that the library has no name for: unnamed[joint 1: q1, q3]; the word
# alone: as many of them as pay.
UNNAMED = "unnamed"


def effect_of(name: str) -> str:
    """The effect of a name: joint_compliance of joint_compliance[2]; of an unnamed one all of it."""
    return name if is_unnamed(name) else name.partition("[")[0]


def place_of(name: str) -> str:
    """The place of a name: "[2]" of joint_compliance[2]; empty for the whole arm, all joints or an unnamed
    effect."""
    return name[len(effect_of(name)) :]


def is_unnamed(name: str) -> bool:
    """Whether a name is that of an effect by place and drivers: unnamed[joint 1: q1, q3]."""
    return name.startswith(f"{UNNAMED}[")


def with_constants(name: str, constants: Mapping[str, float]) -> str:
    """A name with the constants that a fit keeps: bias_step[3](t0=120.5)."""
    if not constants:
        return name
    return f"{name}({','.join(f'{key}={value:.15g}' for key, value in constants.items())})"


def split_constants(text: str) -> tuple[str, dict[str, float]]:
    """Name and constants of `with_constants`; blanks may stand anywhere. ValueError says how to write it."""
    name, opened, inside = text.strip().partition("(")
    if not opened:
        return name, {}
    constants: dict[str, float] = {}
    for pair in inside.rstrip(")").split(","):
        key, _, value = (part.strip() for part in pair.partition("="))
        try:
            constants[key] = plain_number(value)
        except ValueError:
            constants[key] = float("nan")
    right = inside.endswith(")") and all(key.isidentifier() and isfinite(x) for key, x in constants.items())
    if not right or len(constants) != inside.count("=") or ")" in inside[:-1]:
        raise ValueError(f"cannot read {text!r}; write {name.strip()}(constant=number)")
    return name.strip(), constants
