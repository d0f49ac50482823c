"""The arm as solid shapes: a MuJoCo model (MJCF) from the arm and camera tables and space.toml.

Every DH frame is a body. The arm may be given DH errors: a link with a length along its axis is stretched,
and the shapes of a compact joint stand twice, where they are if the error lies beyond them and where they
are if it lies before."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Mapping
from typing import TYPE_CHECKING
from xml.etree import ElementTree as ET

import numpy as np

from kincal.flight import library
from kincal_shared.errors import BadInput
from kincal_shared.schema.dh import DH_FIELDS
from kincal_shared.schema.space import Description, KeepOut, Shape, Vec3

if TYPE_CHECKING:
    from kincal.flight.headers import KcArm, KcCamera

Placement = Callable[[Vec3], Iterable[float]]
FAR_COPY = "'"  # ends the name of the second copy of a shape


def allowed_contacts(desc: Description) -> set[frozenset[str]]:
    """Pairs of shapes, or of a shape and a keep-out volume, that may touch by design. BadInput names a
    pair with an unknown shape."""
    shapes = [s.name for s in desc.shape]
    listed = f"shapes are {', '.join(shapes)}"
    for name in sorted({name for pair in desc.collision_exclusions for name in pair} - set(shapes)):
        raise BadInput(f"unknown shape {name!r}", "collision_exclusions", listed)
    allowed = {frozenset(pair) for pair in desc.collision_exclusions}
    for volume in desc.keep_out:
        for pattern in volume.except_:
            inside = [s for s in shapes if re.fullmatch(pattern, s)]
            if not inside:
                raise BadInput(f"no shape is called {pattern!r}", f"keep_out {volume.name}", listed)
            allowed |= {frozenset((volume.name, s)) for s in inside}
    return allowed


def _text(values: Iterable[float]) -> str:
    return " ".join(repr(float(v)) for v in values)


def _body(parent: ET.Element, name: str, p_m: Iterable[float], q_wxyz: Iterable[float]) -> ET.Element:
    return ET.SubElement(parent, "body", name=name, pos=_text(p_m), quat=_text(q_wxyz))


def _about_z(angle_rad: float) -> list[float]:
    return [np.cos(0.5 * angle_rad), 0.0, 0.0, np.sin(0.5 * angle_rad)]


def _about_x(angle_rad: float) -> list[float]:
    return [np.cos(0.5 * angle_rad), np.sin(0.5 * angle_rad), 0.0, 0.0]


def _where_drawn(p_m: Vec3) -> Iterable[float]:
    return p_m


def _stretched(dh: Mapping[str, float], error: Mapping[str, float]) -> Placement:
    """Points of a link whose far end is off by the errors of a and d."""
    longer = np.array([error["a_m"], 0.0, error["d_m"]])
    return lambda p_m: np.array(p_m) + longer * (p_m[2] / dh["d_m"])


def _beyond(dh: Mapping[str, float]) -> Placement:
    """Points of a joint in the frame at the far end of its link."""
    c, s = np.cos(dh["alpha_rad"]), np.sin(dh["alpha_rad"])
    R = np.array([[1, 0, 0], [0, c, -s], [0, s, c]])
    end_m = np.array([dh["a_m"], 0.0, dh["d_m"]])
    return lambda p_m: R.T @ (np.array(p_m) - end_m)


class ArmModel:
    """Builds the MJCF of one arm among its keep-out volumes.

    errors: DH errors by name; contact_m: nearer than that is contact; grow_m: links are that much thicker.
    `label_of` says which shape or volume of the description each geom stands for."""

    def __init__(self, desc: Description, arm: KcArm, camera: KcCamera, errors: Mapping[str, float]) -> None:
        self.desc, self.arm, self.camera, self.errors = desc, arm, camera, errors
        self.label_of: dict[str, str] = {}
        self._grow_m = 0.0

    def xml(self, contact_m: float, grow_m: float) -> str:
        """The model as MJCF."""
        self._grow_m = grow_m
        root = ET.Element("mujoco")
        ET.SubElement(root, "compiler", angle="radian", autolimits="false", fusestatic="false")
        world = ET.SubElement(root, "worldbody")
        for volume in self.desc.keep_out:
            self._keep_out(world, volume)
        self._tool(self._links(world))
        self._pairs(ET.SubElement(root, "contact"), contact_m)
        return ET.tostring(root, encoding="unicode")

    def _geom(self, body: ET.Element, name: str, label: str, **attributes: str) -> None:
        self.label_of[name] = label
        # no collisions but those of the pairs listed below
        common = {"name": name, "contype": "0", "conaffinity": "0", "mass": "1"}
        ET.SubElement(body, "geom", common | attributes)

    def _capsule(
        self, body: ET.Element, names: tuple[str, str], ends_m: list[float], radius_m: float
    ) -> None:
        self._geom(body, *names, type="capsule", fromto=_text(ends_m), size=repr(radius_m))

    def _keep_out(self, world: ET.Element, k: KeepOut) -> None:
        names, at = (k.name, k.name), _text(k.centre_m)
        if k.kind == "below":
            self._geom(world, *names, type="plane", pos=at, size="40 40 0.1")
        elif k.kind == "box" and k.half_m is not None:
            self._geom(world, *names, type="box", pos=at, size=_text(k.half_m))
        elif k.kind == "capsule" and k.end_m is not None and k.radius_m:
            self._capsule(world, names, [*k.centre_m, *k.end_m], k.radius_m)
        elif k.kind == "sphere" and k.radius_m:
            self._geom(world, *names, type="sphere", pos=at, size=repr(k.radius_m))
        else:
            raise BadInput(f"keep-out volume {k.name!r} lacks its size", "keep_out")

    def _shape(self, body: ET.Element, s: Shape, place: Placement, copy: str = "") -> None:
        names = (s.name + copy, s.name)
        if s.radius_m is not None and s.start_m is not None and s.end_m is not None:
            grown_m = s.radius_m + (self._grow_m if s.joint else 0.0)
            self._capsule(body, names, [*place(s.start_m), *place(s.end_m)], grown_m)
        elif s.centre_m is not None and s.half_m is not None:
            self._geom(body, *names, type="box", pos=_text(s.centre_m), size=_text(s.half_m))

    def _links(self, world: ET.Element) -> ET.Element:
        """The chain of joints and links; returns the body of the tool."""
        arm = self.arm
        frame = _body(world, "frame0", list(arm.base_xyz_m), list(arm.base_quat_wxyz))
        for j in range(int(arm.n_joints)):
            frame = self._link(frame, j)
        return _body(frame, "tool", list(arm.tool_xyz_m), list(arm.tool_quat_wxyz))

    def _link(self, before: ET.Element, j: int) -> ET.Element:
        """Joint j (from 0) with its link and shapes; returns the frame at the far end."""
        joint = self.arm.joint[j]
        dh = {f: float(getattr(joint, f)) for f in DH_FIELDS}
        error = {f: self.errors.get(f"J{j + 1}.{f}", 0.0) for f in DH_FIELDS}
        wrong = {f: dh[f] + error[f] for f in DH_FIELDS}
        link = _body(before, f"link{j + 1}", (0, 0, 0), _about_z(wrong["phi_rad"]))
        kind = "hinge" if joint.type == library("flight").lib.KC_REVOLUTE else "slide"
        ET.SubElement(link, "joint", name=f"J{j + 1}", type=kind, axis="0 0 1")
        end_m, twist = (wrong["a_m"], 0, wrong["d_m"]), _about_x(wrong["alpha_rad"])
        frame = _body(link, f"frame{j + 1}", end_m, twist)
        for s in (s for s in self.desc.shape if s.joint == j + 1):
            self._link_shape(link, frame, s, dh, error)
        return frame

    def _link_shape(
        self, link: ET.Element, frame: ET.Element, s: Shape, dh: dict[str, float], error: dict[str, float]
    ) -> None:
        if dh["d_m"] != 0.0:
            self._shape(link, s, _stretched(dh, error))
            return
        self._shape(link, s, _where_drawn)
        if any(error[f] for f in DH_FIELDS if f != "phi_rad"):
            self._shape(frame, s, _beyond(dh), FAR_COPY)

    def _tool(self, tool: ET.Element) -> None:
        plates = {}
        for i in range(int(self.camera.n_tags)):
            tag = self.camera.tag[i]
            plates[i] = _body(tool, f"tag{i}", list(tag.xyz_m), list(tag.quat_wxyz))
        for s in (s for s in self.desc.shape if s.joint == 0):
            if s.tag is not None and s.tag not in plates:
                raise BadInput(f"shape {s.name!r} carries tag {s.tag}, which the camera table lacks")
            self._shape(tool if s.tag is None else plates[s.tag], s, _where_drawn)

    def _pairs(self, contact: ET.Element, contact_m: float) -> None:
        """Pairs that the engine checks: all but those that may touch by design, belong to one rigid link, or
        both stand still."""
        joint_of = {s.name: s.joint for s in self.desc.shape}
        allowed = allowed_contacts(self.desc)
        geoms = list(self.label_of.items())
        for i, (x, a) in enumerate(geoms):
            for y, b in geoms[:i]:
                moving = [joint_of[label] for label in (a, b) if label in joint_of]
                rigid = len(moving) == 2 and moving[0] == moving[1]
                if moving and not rigid and frozenset((a, b)) not in allowed:
                    ET.SubElement(contact, "pair", geom1=y, geom2=x, margin=repr(contact_m))
