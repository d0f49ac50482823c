"""Names of the term grammar: functions, variables, twist components, places on the arm; of acquisitions.

Names only. Their numbers are those of the flight headers (kc_terms.h, kc_variables.h), which `kincal.flight`
reads; tests/ground/test_schema_terms.py compares the two. `make stubs` makes variables.csv, which has the
variables.
"""

from __future__ import annotations

import csv
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from importlib import resources
from math import isfinite
from typing import get_args

from .acquisitions import Acquisition
from .numbers import plain_number


@dataclass(frozen=True)
class OnGround:
    """What only the ground knows of a variable.

    needs: what the data or the arm table must hold, "" if nothing. In exported code a value is given by the
    caller, by the name `given`, with its value where the caller says nothing (None: it must be given); or it
    is `computed`, an expression in Python and in C with {i} for the joint from 0, or the link.
    """

    needs: str = ""
    given: str = ""
    unless_given: float | None = None
    computed: tuple[str, str] | None = None


@dataclass(frozen=True, kw_only=True)
class Variable(OnGround):
    """What a basis may depend on.

    flight: name in kc_var_t, small letters. index, source: what its index is, and what it is computed from
    (KC_INDEX_*, KC_FROM_* of the header, small letters). unit: of the value. about: what it is, in words.
    """

    flight: str
    index: str
    source: str
    unit: str
    about: str

    @property
    def indexed(self) -> bool:
        """Whether it belongs to one joint, link, or pair of these."""
        return self.index != "none"

    @property
    def of_link(self) -> bool:
        """Whether its index is a link, 0 for the base."""
        return self.index == "link"

    @property
    def of_body(self) -> bool:
        """Whether its index is a link and a body beyond."""
        return self.index == "lever"

    @property
    def modelled(self) -> bool:
        """Whether its value depends on the coefficients: gravity loads, where the model expects the tool."""
        return self.source != "record"


ACQUISITIONS: tuple[str, ...] = get_args(Acquisition)
"""How the next pose is chosen; in the order of their numbers (kc_acq_t)."""

# What may be wrong with the image of a target's points, in a unit each (METHOD.md 13.1).
FAULTS = (
    "radial_1", "radial_2", "decentring_1", "decentring_2", "focal_x", "focal_y", "centre_x", "centre_y",
    "bow_x", "bow_y", "target_size", "target_edges",
)  # fmt: skip
# Of those, faults of a target on the tool; a fixed one that is too large is a sensor with a wrong scale.
FAULTS_ON_TOOL = ("target_size", "target_edges")

# kc_fn_t, small letters; the basis is fn(z) with z = c1 (x - c0)
FUNCTIONS = ("lin", "sin", "cos", "tanh", "ln1p", "expn", "step", "sq", "tan2", "abs")

_ON_GROUND = {
    "q": OnGround(computed=("q[{i}]", "q[{i}]")),
    "tau": OnGround("mass", computed=("load.tau[{i}]", "load->tau[{i}]")),
    "Mx": OnGround("mass", computed=("load.moment[{i}][0]", "load->moment[{i}][0]")),
    "My": OnGround("mass", computed=("load.moment[{i}][1]", "load->moment[{i}][1]")),
    "Mz": OnGround("mass", computed=("load.moment[{i}][2]", "load->moment[{i}][2]")),
    "dir": OnGround("dir", given="direction"),
    "move": OnGround("move", given="move", unless_given=0.0),
    "temp": OnGround("temp_c", given="temp_c"),
    "t": OnGround("t_s", given="t_s"),
    "payload": OnGround("payload_kg", given="payload_kg", unless_given=0.0),
    "range": OnGround("range_m", given="range_m"),
    "incid": OnGround("incid_rad", given="incid_rad"),
    "u": OnGround("image", computed=("view.u", "view->u")),
    "v": OnGround("image", computed=("view.v", "view->v")),
    "r2": OnGround("image", computed=("(view.u**2 + view.v**2)", "(view->u * view->u + view->v * view->v)")),
    "pan": OnGround("pan_rad", given="pan_rad"),
    "tilt": OnGround("tilt_rad", given="tilt_rad"),
    "qdot": OnGround("qdot", given="qdot", unless_given=0.0),
    "taup": OnGround("payload_kg", computed=("load.tau_payload[{i}]", "load->tau_payload[{i}]")),
    "xcam": OnGround("cam", computed=("view.p[0]", "view->p[0]")),
    "ycam": OnGround("cam", computed=("view.p[1]", "view->p[1]")),
    "zcam": OnGround("cam", computed=("view.p[2]", "view->p[2]")),
    "tag": OnGround("tag", given="tag"),
    # What gravity does whatever the masses are: nothing is needed.
    "gx": OnGround(computed=("load.gravity[{i}][0]", "load->gravity[{i}][0]")),
    "gy": OnGround(computed=("load.gravity[{i}][1]", "load->gravity[{i}][1]")),
    "gz": OnGround(computed=("load.gravity[{i}][2]", "load->gravity[{i}][2]")),
    "levx": OnGround(computed=("_lever(load, {i}, {body}, 0)", "lever(load, {i}, {body}, 0)")),
    "levy": OnGround(computed=("_lever(load, {i}, {body}, 1)", "lever(load, {i}, {body}, 1)")),
    "levz": OnGround(computed=("_lever(load, {i}, {body}, 2)", "lever(load, {i}, {body}, 2)")),
    # Columns of a PnP pose, computed for effects that say `image` (METHOD.md 13.1); nobody writes them.
    "ptx": OnGround("points", computed=("pnp[{i}][0]", "pnp[{i}][0]")),
    "pty": OnGround("points", computed=("pnp[{i}][1]", "pnp[{i}][1]")),
    "ptz": OnGround("points", computed=("pnp[{i}][2]", "pnp[{i}][2]")),
    "prx": OnGround("points", computed=("pnp[{i}][3]", "pnp[{i}][3]")),
    "pry": OnGround("points", computed=("pnp[{i}][4]", "pnp[{i}][4]")),
    "prz": OnGround("points", computed=("pnp[{i}][5]", "pnp[{i}][5]")),
}
# Without camera columns the sensor is the measurement frame itself (a laser tracker, a board): the position
# it saw, by the same variables.
_OWN_SENSOR = {"sx": "xcam", "sy": "ycam", "sz": "zcam"}


def _variables() -> Iterator[tuple[str, Variable]]:
    """(name in the grammar, variable) of all, in the order of their numbers."""
    yield "1", Variable(flight="one", index="none", source="record", unit="1", about="")
    text = resources.files(__package__).joinpath("variables.csv").read_text(encoding="utf-8")
    for row in csv.DictReader(text.splitlines()):
        name = row["name"]
        yield (
            name,
            Variable(
                flight=row["flight"],
                index=row["index"],
                source=row["source"],
                unit=row["unit"],
                about=row["about"],
                **vars(_ON_GROUND[name]),
            ),
        )


VARIABLES = dict(_variables())
VARIABLES |= {name: replace(VARIABLES[of], needs="own_sensor") for name, of in _OWN_SENSOR.items()}
# Twist of a pose from a camera by a fault of camera or target: name here -> name in kc_var_t.
PNP = {name: of.flight for name, of in VARIABLES.items() if of.source == "points"}

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
DATA_CONSTANTS = ("T0", "tstart", "tspan")
GEAR_RATIO = "N"
JOINT_LETTERS = ("i", "j", "p", "k")
# The body of a gravity lever: a link's number, or the tool. Its index on board is 16 x link + body
# (kc_variables.h).
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
