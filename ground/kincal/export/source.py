"""A fitted model as self-contained source code, Python (numpy only) and C99, from one description.

Both do the same steps in the same order as flight's model (fsw/model) and its inverse kinematics
(fsw/motion), with every effect of the model written out as one line.
"""

from __future__ import annotations

import re
from collections.abc import Iterable
from dataclasses import dataclass, replace

import jinja2
import numpy as np

from kincal.flight import FRAME_CAMERA, FRAME_MEAS, FRAME_TOOL
from kincal.rotations import Floats, Pose
from kincal_shared.schema.names import VARIABLES, Variable

from .calibrated import BASE, TOOL, CalibratedArm, FittedTerm
from .camera import Camera, camera_of
from .expressions import IMAGE, LEVERS, LOADS, MASSES, VIEW, Language, Line, line, plain, points_of
from .leftout import LeftOut, left_out


@dataclass(frozen=True)
class Driver:
    """A quantity beside the joint readings that the model depends on.

    size: numbers that it consists of (0: one number); default: where a natural one exists, else None.
    """

    name: str
    size: int
    default: tuple[float, ...] | None
    meaning: str


@dataclass(frozen=True)
class Source:
    """What the templates write.

    constant: twists by frame (0..n, tool, sensor, target) of all that does not change; found: of the base
    and tool frame alone; steady, loaded: other corrections, without and with gravity loads; seen: those of
    a pose that a camera found from many points; camera: that camera and its target, if there are any.
    """

    title: str
    sources: str
    prefix: str
    arm: CalibratedArm
    constant: Floats
    found: Floats
    steady: tuple[Line, ...]
    loaded: tuple[Line, ...]
    seen: tuple[Line, ...]
    camera: Camera | None
    drivers: tuple[Driver, ...]
    on_sensor: bool
    uses_masses: bool
    uses_levers: bool
    uses_view: bool
    uses_image: bool

    @property
    def n(self) -> int:
        """Number of joints."""
        return self.arm.n

    @property
    def keeps_orientation(self) -> bool:
        """Whether `correct` restores the orientation too: that takes six joints and measured orientations."""
        return self.n >= 6 and self.arm.record.components == 6

    @property
    def uses_loads(self) -> bool:
        """Whether gravity loads are needed."""
        return bool(self.loaded)

    @property
    def masses(self) -> list[tuple[float, tuple[float, ...]]]:
        """Mass [kg] and its centre in the link frame [m] of each link; 0 where the arm table has none."""
        if not self.arm.arm.has_masses:
            return [(0.0, (0.0, 0.0, 0.0))] * self.n
        joints = self.arm.arm.joints
        return [(j.mass_kg or 0.0, j.com_m or (0.0, 0.0, 0.0)) for j in joints]

    @property
    def functions(self) -> str:
        """The text of all expressions, for helpers that only some of them need."""
        return " ".join(one.product for one in (*self.steady, *self.loaded, *self.seen))


def python_source(arm: CalibratedArm) -> str:
    """One Python file that needs numpy only: forward, nominal, inverse, correct, measured."""
    return _render("arm.py.j2", describe(arm, "python"))


def c_source(arm: CalibratedArm, header: str) -> str:
    """C99 source that needs math.h only; header: name of the file with its declarations."""
    return _render("arm.c.j2", describe(arm, "c"), header=header)


def c_header(arm: CalibratedArm) -> str:
    """The declarations of `c_source`."""
    return _render("arm.h.j2", describe(arm, "c"))


def describe(arm: CalibratedArm, language: Language) -> Source:
    """What the templates need to know of a fitted arm. CannotAnswer if a term cannot be written as code."""
    camera = camera_of(arm)
    if _sensor_fits(arm, camera):
        terms = list(arm.terms)
    else:
        terms, camera = [term for term in arm.terms if not term.on_sensor], None
    on_sensor = any(term.on_sensor for term in terms)
    varying = [term for term in terms if not term.constant]
    seen = [term for term in varying if points_of(term)]
    varying = [term for term in varying if not points_of(term)]
    variables = {basis.var for term in (*varying, *seen) for basis in term.bases}
    lines = {term: line(term, _row(term.frame, arm.n), language) for term in varying}
    return Source(
        title=plain(arm.arm.name),
        sources=plain(arm.sources),
        prefix=identifier(arm.arm.name),
        arm=arm,
        constant=_constants(arm, None),
        found=_constants(arm, [BASE, TOOL]),
        steady=tuple(lines[term] for term in varying if not _loaded(term)),
        loaded=tuple(lines[term] for term in varying if _loaded(term)),
        seen=tuple(line(_placed(term, camera), _row(term.frame, arm.n), language) for term in seen),
        camera=camera,
        drivers=tuple(_drivers(arm, variables, on_sensor, camera)),
        on_sensor=on_sensor,
        uses_masses=bool(variables & MASSES),
        uses_levers=bool(variables & LEVERS),
        uses_view=bool(variables & VIEW),
        uses_image=bool(variables & IMAGE),
    )


def _sensor_fits(arm: CalibratedArm, camera: Camera | None) -> bool:
    """Whether the effects of the sensor can be written: those through many points need a camera and target
    that are known, and depend on nothing that the pose itself decides."""
    through = [term for term in arm.terms if points_of(term)]
    variables = {basis.var for term in through for basis in term.bases}
    return not through or (camera is not None and not variables & (VIEW | LOADS))


def source_left_out(arm: CalibratedArm) -> tuple[LeftOut, ...]:
    """Effects of the sensor that the generated code does not hold: all of them, or none."""
    if _sensor_fits(arm, camera_of(arm)):
        return ()
    return left_out(arm, [term for term in arm.terms if term.on_sensor])


def _placed(term: FittedTerm, camera: Camera | None) -> FittedTerm:
    """The term with its columns counted as the generated code has them."""
    assert camera is not None
    places = {number: place for place, number in enumerate(camera.numbers, 1)}
    through = points_of(term)
    bases = (replace(b, index=places[b.index]) if b in through else b for b in term.bases)
    return replace(term, bases=tuple(bases))


def _loaded(term: FittedTerm) -> bool:
    return any(basis.var in LOADS for basis in term.bases)


def _row(frame: int, n: int) -> int:
    """Row of a frame in the table of twists: 0..n, tool, sensor, target."""
    return {FRAME_TOOL: n + 1, FRAME_CAMERA: n + 2, FRAME_MEAS: n + 3}.get(frame, frame)


def _constants(arm: CalibratedArm, groups: Iterable[str] | None) -> Floats:
    """(n + 4, 6) constant twists."""
    frames = (*range(arm.n + 1), FRAME_TOOL, FRAME_CAMERA, FRAME_MEAS)
    chosen = None if groups is None else list(groups)
    return np.array([arm.constant_twist(frame, chosen) for frame in frames])


def _drivers(
    arm: CalibratedArm, variables: set[str], on_sensor: bool, camera: Camera | None
) -> Iterable[Driver]:
    """The drivers that these variables need, in a fixed order."""
    masses, view = bool(variables & MASSES), on_sensor or bool(variables & VIEW)
    for name, variable in VARIABLES.items():
        if variable.given and (name in variables or name == "payload" and masses):
            yield _driver(variable, arm.n)
    if camera and len(camera.targets) > 1 and "tag" not in variables:
        yield replace(_driver(VARIABLES["tag"], arm.n), default=(0.0,))
    if variables & LOADS:
        g = tuple(float(x) for x in arm.arm.gravity_m_s2)
        yield Driver("gravity_m_s2", 3, g, "gravity in the base frame [m/s^2]")
    if view:
        own = ", left as it is: the measured pose is the camera's own" if camera and camera.on_tool else ""
        yield Driver("sensor_xyz_m", 3, (0.0,) * 3, f"position of the sensor in the base frame [m]{own}")
        yield Driver("sensor_wxyz", 4, (1.0, 0.0, 0.0, 0.0), "its orientation, quaternion (w, x, y, z)")


def _driver(variable: Variable, n: int) -> Driver:
    """What a caller gives as the value of a variable; n: joints."""
    count, default = n if variable.indexed else 0, variable.unless_given
    values = None if default is None else (default,) * max(count, 1)
    return Driver(variable.given, count, values, f"{variable.about} [{variable.unit}]")


def identifier(name: str) -> str:
    """A name for C, small letters: that of the arm as far as it goes."""
    words = re.sub(r"[^a-z0-9]+", "_", name.lower()).strip("_")[:24].rstrip("_") or "arm"
    return f"arm_{words}" if words[0].isdigit() else words


def _render(template: str, source: Source, **more: str) -> str:
    environment = jinja2.Environment(
        loader=jinja2.PackageLoader("kincal.export"),
        undefined=jinja2.StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
        keep_trailing_newline=True,
        autoescape=False,  # code, not HTML; `plain` keeps texts inside their comments
    )
    return environment.get_template(template).render(
        s=source, base=_rows(source.arm.base), tool=_rows(source.arm.tool), **more
    )


def _rows(pose: Pose) -> list[list[float]]:
    """(3, 4) rows of rotation matrix and origin."""
    return [[*map(float, row), float(x)] for row, x in zip(pose.R, pose.p_m, strict=True)]
