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
        self._pairs(root)
        self.model = mujoco.MjModel.from_xml_string(ET.tostring(root, encoding="unicode"))
        self.data = mujoco.MjData(self.model)
        self._qpos = self.data.qpos[: self.n]  # a view: every access through `data` costs as much as a move
        self._tool_id = self.model.body("tool").id
        self._prints = [self._print(camera.tag[i]) for i in range(int(camera.n_tags))]
        self.names = [self._names[self.model.geom(i).name] for i in range(self.model.ngeom)]
        self._tag_geom = {
            s.tag: self.model.geom(s.name).id for s in desc.shape if s.joint == 0 and s.tag is not None
        }

    def _print(self, tag: Any) -> np.ndarray:
        """Nine points of a tag's print in the tool frame."""
        half = 0.5 * self.desc.sight.border * float(tag.size_m)
        grid = np.array([[x * half, y * half, 0.0] for x in (-1, 0, 1) for y in (-1, 0, 1)])
        return np.array(list(tag.xyz_m)) + grid @ quat_to_R(list(tag.quat_wxyz)).T

    # ---- building

    def _geom(self, body: ET.Element, name: str, label: str, **attributes: str) -> None:
        self._names[name] = label
        # no collisions but those of the pairs listed below
        ET.SubElement(body, "geom", name=name, contype="0", conaffinity="0", mass="1", **attributes)

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

    def _pairs(self, root: ET.Element) -> None:
        """Which shapes the engine has to keep apart: all but those that touch by design, belong to one rigid
        link, or both stand still."""
        known = {s.name: s for s in self.desc.shape}
        for pair in self.desc.touching:
            if not set(pair) <= set(known):
                unknown = sorted(set(pair) - set(known))
                raise KincalError(
                    f"unknown shape {unknown[0]!r}", "touching", f"shapes are {', '.join(known)}"
                )
        fine = {frozenset(p) for p in self.desc.touching}
        for k in self.desc.keep_out:
            for name in k.except_:
                stands = [s for s in known if re.fullmatch(name, s)]
                if not stands:
                    raise KincalError(
                        f"no shape is called {name!r}", f"keep_out {k.name}", f"shapes are {', '.join(known)}"
                    )
                fine |= {frozenset((k.name, s)) for s in stands}
        contact = ET.SubElement(root, "contact")
        geoms = list(self._names.items())
        for i, (x, a) in enumerate(geoms):
            for y, b in geoms[:i]:
                moves = [known[n] for n in (a, b) if n in known]
                rigid = len(moves) == 2 and moves[0].joint == moves[1].joint
                if moves and not rigid and frozenset((a, b)) not in fine:
                    ET.SubElement(contact, "pair", geom1=y, geom2=x, margin=repr(self.margin_m))

    # ---- asking

    def touching(self, q: np.ndarray) -> str:
        """First pair that touches (or is nearer than the margin) at joints q, or an empty string."""
        m, d = self.model, self.data
        self._qpos[:] = q
        mujoco.mj_kinematics(m, d)
        mujoco.mj_collision(m, d)
        if d.ncon:
            near = np.flatnonzero(d.contact.dist[: d.ncon] < self.margin_m)
            if len(near):
                return " - ".join(sorted(self.names[g] for g in d.contact.geom[near[0]]))
        return ""

    def tool(self, q: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Tool pose, for an independent look at the chain."""
        self._qpos[:] = q
        mujoco.mj_kinematics(self.model, self.data)
        return self.data.xpos[self._tool_id].copy(), self.data.xmat[self._tool_id].reshape(3, 3).copy()

    def seen(self, q: np.ndarray, eye: np.ndarray, tags: int) -> int:
        """Those of some tags (bits) with nothing of the arm between the eye and nine points of the print
        (rays)."""
        out = 0
        if not tags:
            return out
        p, R = self.tool(q)
        ids, dist = np.zeros(9, np.int32), np.zeros(9)
        for i, points in enumerate(self._prints):
            if not tags >> i & 1:
                continue
            to = p + points @ R.T - eye
            reach = np.sqrt(np.sum(to * to, axis=1))
            unit = (to / reach[:, None]).reshape(-1)
            mujoco.mj_multiRay(self.model, self.data, eye, unit, None, False, -1, ids, dist, None, 9, 10.0)
            if not np.any((ids >= 0) & (dist < reach - 0.001) & (ids != self._tag_geom.get(i, -1))):
                out |= 1 << i
        return out
