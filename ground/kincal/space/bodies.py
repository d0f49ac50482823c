"""The arm as solid shapes in MuJoCo's collision engine, built from the arm table and space.toml.

Every DH frame is a body. The arm may be given DH errors: a link with a length along its axis is stretched,
and the shapes of a compact joint stand twice, where they are if the error lies beyond them and where they
are if it lies before."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable
from typing import Any
from xml.etree import ElementTree as ET

import mujoco
import numpy as np

from kincal.errors import KincalError
from kincal.geometry import quat_to_R

from .description import Description, KeepOut, Shape, Vec3

FIELDS = ("phi_rad", "alpha_rad", "a_m", "d_m")


Move = Callable[[Vec3], np.ndarray]


def _num(values: Iterable[float]) -> str:
    return " ".join(repr(float(v)) for v in values)


def _rot_x(a: float) -> np.ndarray:
    return np.array([[1, 0, 0], [0, np.cos(a), -np.sin(a)], [0, np.sin(a), np.cos(a)]])


def _body(parent: ET.Element, name: str, p: Iterable[float], quat: Iterable[float]) -> ET.Element:
    return ET.SubElement(parent, "body", name=name, pos=_num(p), quat=_num(quat))


def _about_z(a: float) -> list[float]:
    return [np.cos(0.5 * a), 0.0, 0.0, np.sin(0.5 * a)]


def _about_x(a: float) -> list[float]:
    return [np.cos(0.5 * a), np.sin(0.5 * a), 0.0, 0.0]


class Bodies:
    """One arm (nominal or with errors) among its keep-out volumes. Nearer than `margin_m` is contact."""

    def __init__(
        self,
        desc: Description,
        arm: Any,
        camera: Any,
        errors: dict[str, float] | None = None,
        margin_m: float = 0.0,
        grow_m: float = 0.0,
    ) -> None:
        self.n = int(arm.n_joints)
        self.desc, self.margin_m = desc, margin_m
        self._names: dict[str, str] = {}
        root = ET.Element("mujoco")
        ET.SubElement(root, "compiler", angle="radian", autolimits="false", fusestatic="false")
        world = ET.SubElement(root, "worldbody")
        for k in desc.keep_out:
            self._keep_out(world, k)
        tool = self._chain(world, arm, errors or {}, grow_m)
        self._tool(tool, camera)
        self._exclude(root)
        self.model = mujoco.MjModel.from_xml_string(ET.tostring(root, encoding="unicode"))
        self.data = mujoco.MjData(self.model)
        self._tool_id = self.model.body("tool").id
        self.names = [self._names[self.model.geom(i).name] for i in range(self.model.ngeom)]
        self._tag_geom = {
            s.tag: self.model.geom(s.name).id for s in desc.shape if s.joint == 0 and s.tag is not None
        }

    # ---- building

    def _geom(self, body: ET.Element, name: str, label: str, **attributes: str) -> None:
        self._names[name] = label
        ET.SubElement(body, "geom", name=name, margin=repr(self.margin_m), mass="1", **attributes)

    def _keep_out(self, world: ET.Element, k: KeepOut) -> None:
        if k.kind == "below":
            self._geom(world, k.name, k.name, type="plane", pos=_num(k.centre_m), size="40 40 0.1")
        elif k.kind == "box" and k.half_m is not None:
            self._geom(world, k.name, k.name, type="box", pos=_num(k.centre_m), size=_num(k.half_m))
        elif k.kind == "capsule" and k.end_m is not None and k.radius_m:
            ends = _num([*k.centre_m, *k.end_m])
            self._geom(world, k.name, k.name, type="capsule", fromto=ends, size=repr(k.radius_m))
        elif k.kind == "sphere" and k.radius_m:
            self._geom(world, k.name, k.name, type="sphere", pos=_num(k.centre_m), size=repr(k.radius_m))
        else:
            raise KincalError(f"keep-out volume {k.name!r} lacks its size", "keep_out")

    def _shape(self, body: ET.Element, s: Shape, copy: str, grow_m: float, move: Move) -> None:
        if s.radius_m is not None:
            assert s.start_m is not None and s.end_m is not None
            ends = _num([*move(s.start_m), *move(s.end_m)])
            self._geom(
                body, s.name + copy, s.name, type="capsule", fromto=ends, size=repr(s.radius_m + grow_m)
            )
        else:
            assert s.centre_m is not None and s.half_m is not None
            self._geom(body, s.name + copy, s.name, type="box", pos=_num(s.centre_m), size=_num(s.half_m))

    def _chain(self, world: ET.Element, arm: Any, errors: dict[str, float], grow_m: float) -> ET.Element:
        frame = _body(world, "frame0", list(arm.base_xyz_m), list(arm.base_quat_wxyz))
        for j in range(self.n):
            joint = arm.joint[j]
            dh = {f: float(getattr(joint, f)) for f in FIELDS}
            off = {f: errors.get(f"J{j + 1}.{f}", 0.0) for f in FIELDS}
            link = _body(frame, f"link{j + 1}", (0, 0, 0), _about_z(dh["phi_rad"] + off["phi_rad"]))
            kind = "hinge" if joint.type == 0 else "slide"
            ET.SubElement(link, "joint", name=f"J{j + 1}", type=kind, axis="0 0 1")
            frame = _body(
                link,
                f"frame{j + 1}",
                (dh["a_m"] + off["a_m"], 0, dh["d_m"] + off["d_m"]),
                _about_x(dh["alpha_rad"] + off["alpha_rad"]),
            )
            R, end = _rot_x(dh["alpha_rad"]), np.array([dh["a_m"], 0.0, dh["d_m"]])
            longer = np.array([off["a_m"], 0.0, off["d_m"]])
            rigid = dh["d_m"] == 0.0
            for s in (s for s in self.desc.shape if s.joint == j + 1):
                if rigid:
                    self._shape(link, s, "", grow_m, np.asarray)
                    if any(off[f] for f in FIELDS[1:]):
                        far = lambda p, R=R, end=end: R.T @ (np.array(p) - end)  # noqa: E731
                        self._shape(frame, s, "'", grow_m, far)
                else:
                    stretch = lambda p, d=dh["d_m"], w=longer: np.array(p) + w * (p[2] / d)  # noqa: E731
                    self._shape(link, s, "", grow_m, stretch)
        return _body(frame, "tool", list(arm.tool_xyz_m), list(arm.tool_quat_wxyz))

    def _tool(self, tool: ET.Element, camera: Any) -> None:
        plates = {}
        for i in range(int(camera.n_tags)):
            t = camera.tag[i]
            plates[i] = _body(tool, f"tag{i}", list(t.xyz_m), list(t.quat_wxyz))
        for s in self.desc.shape:
            if s.joint == 0:
                if s.tag is not None and s.tag not in plates:
                    raise KincalError(f"shape {s.name!r} carries tag {s.tag}, which the camera table lacks")
                self._shape(tool if s.tag is None else plates[s.tag], s, "", 0.0, np.asarray)

    def _exclude(self, root: ET.Element) -> None:
        """Pairs by shape are sorted out after the engine; whole bodies only where all touch by design."""
        known = {s.name for s in self.desc.shape}
        for pair in self.desc.touching:
            if not set(pair) <= known:
                raise KincalError(f"unknown shape in {pair}", "touching")
        self._fine = {frozenset(p) for p in self.desc.touching}
        for k in self.desc.keep_out:
            for name in k.except_:
                if not any(re.fullmatch(name, s) for s in known):
                    raise KincalError(f"unknown shape {name!r}", f"keep_out {k.name}")
            self._fine |= {
                frozenset((k.name, s)) for s in known if any(re.fullmatch(x, s) for x in k.except_)
            }
        by = {}
        for s in self.desc.shape:
            body = f"link{s.joint}" if s.joint else "tool" if s.tag is None else f"tag{s.tag}"
            by.setdefault(body, []).append(s.name)
        # bodies all of whose shapes may touch each other need no test by the engine
        contact = ET.SubElement(root, "contact")
        names = list(by)
        fine = lambda a, b: all(frozenset((x, y)) in self._fine for x in by[a] for y in by[b])  # noqa: E731
        frames = lambda b: [b, "frame" + b[4:]] if b.startswith("link") else [b]  # noqa: E731
        for i, a in enumerate(names):
            for x in frames(a)[1:]:
                ET.SubElement(contact, "exclude", body1=a, body2=x)
            for b in names[:i]:
                if fine(a, b):
                    for x in frames(a):
                        for y in frames(b):
                            ET.SubElement(contact, "exclude", body1=x, body2=y)

    # ---- asking

    def touching(self, q: np.ndarray) -> str:
        """First pair that touches (or is nearer than the margin) at joints q, or an empty string."""
        m, d = self.model, self.data
        d.qpos[: self.n] = q
        mujoco.mj_kinematics(m, d)
        mujoco.mj_collision(m, d)
        if d.ncon:
            near = d.contact.dist[: d.ncon] < self.margin_m
            for a, b in d.contact.geom[: d.ncon][near]:
                pair = frozenset((self.names[a], self.names[b]))
                if len(pair) == 2 and pair not in self._fine:
                    return " - ".join(sorted(pair))
        return ""

    def tool(self, q: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Tool pose, for an independent look at the chain."""
        self.data.qpos[: self.n] = q
        mujoco.mj_kinematics(self.model, self.data)
        return self.data.xpos[self._tool_id].copy(), self.data.xmat[self._tool_id].reshape(3, 3).copy()

    def seen(self, q: np.ndarray, eye: np.ndarray, camera: Any) -> int:
        """Bit set of tags with nothing of the arm between the eye and nine points of the print (rays)."""
        m, d = self.model, self.data
        p, R = self.tool(q)
        out = 0
        for i in range(int(camera.n_tags)):
            t = camera.tag[i]
            xyz, R_tag = np.array(list(t.xyz_m)), quat_to_R(list(t.quat_wxyz))
            half = 0.5 * self.desc.sight.border * float(t.size_m)
            grid = np.array([[x * half, y * half, 0.0] for x in (-1, 0, 1) for y in (-1, 0, 1)])
            to = p + (xyz + grid @ R_tag.T) @ R.T - eye
            reach = np.linalg.norm(to, axis=1)
            ids, dist = np.zeros(9, np.int32), np.zeros(9)
            unit = np.ascontiguousarray((to / reach[:, None]).reshape(-1))
            mujoco.mj_multiRay(m, d, eye, unit, None, False, -1, ids, dist, None, 9, 10.0)
            hit = (ids >= 0) & (dist < reach - 0.001) & (ids != self._tag_geom.get(i, -1))
            if not np.any(hit):
                out |= 1 << i
        return out
