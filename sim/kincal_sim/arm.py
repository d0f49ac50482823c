"""The true arm, lander and camera head as MuJoCo bodies, built from models/wam.toml plus a scenario's errors.

Kinematics come from MuJoCo alone: every DH frame is a body of its own, and an error moves that body.
The world frame is the base frame (base plate of the arm on the lander deck, z up, x away from the lander).
"""

from __future__ import annotations

import re
import tomllib
from pathlib import Path
from xml.etree import ElementTree as ET

import mujoco
import numpy as np

from . import geom, scenery

SPEC_PATH = Path(__file__).resolve().parent.parent / "models" / "wam.toml"
DH = ("phi_rad", "alpha_rad", "a_m", "d_m")
FRAME = {"tx_m": "tx", "ty_m": "ty", "tz_m": "tz", "rx_rad": "rx", "ry_rad": "ry", "rz_rad": "rz"}
GRAVITY_EARTH = (0.0, 0.0, -9.81)


def load_spec(path: Path = SPEC_PATH) -> dict:
    """The simulator's numbers of arm, lander, mast and camera."""
    with open(path, "rb") as f:
        return tomllib.load(f)


class ErrorNames(ValueError):
    """An error was given for something the model does not have."""


def split_errors(errors: dict[str, float], n_joints: int) -> tuple[np.ndarray, dict, dict]:
    """Named errors as (n_joints x 4 DH errors, base frame twist, tool frame twist).

    Names are those of the coefficients: J<j>.phi_rad .alpha_rad .a_m .d_m, base.* and tool.* with
    tx_m ty_m tz_m rx_rad ry_rad rz_rad.
    """
    dh = np.zeros((n_joints, 4))
    frames: dict[str, dict[str, float]] = {"base": {}, "tool": {}}
    for name, value in errors.items():
        joint = re.fullmatch(r"J(\d+)\.(\w+)", name)
        where, _, comp = name.partition(".")
        if joint and 1 <= int(joint[1]) <= n_joints and joint[2] in DH:
            dh[int(joint[1]) - 1, DH.index(joint[2])] = value
        elif where in frames and comp in FRAME:
            frames[where][FRAME[comp]] = value
        else:
            raise ErrorNames(
                f"unknown error '{name}'; known: J1..J{n_joints} with {', '.join(DH)}; "
                f"base and tool with {', '.join(FRAME)}"
            )
    return dh, frames["base"], frames["tool"]


def _num(values) -> str:
    return " ".join(repr(float(v)) for v in np.atleast_1d(values))


def _body(parent: ET.Element, name: str, T: np.ndarray) -> ET.Element:
    return ET.SubElement(parent, "body", name=name, pos=_num(T[:3, 3]), quat=_num(geom.quat(T)))


def _geom(body: ET.Element, name: str, kind: str, material: str, **attributes) -> None:
    text = {k: v if isinstance(v, str) else _num(v) for k, v in attributes.items()}
    ET.SubElement(body, "geom", name=name, type=kind, material=material, mass="0", **text)


def _capsule(body: ET.Element, name: str, shape: dict, material: str, longer_m: np.ndarray) -> None:
    """longer_m: how much a point moves per metre along the joint axis."""
    ends = [np.array(shape[k]) + longer_m * shape[k][2] for k in ("from", "to")]
    _geom(body, name, shape["type"], material, fromto=np.concatenate(ends), size=shape["radius"])


def _scene(root: ET.Element, spec: dict) -> ET.Element:
    """Options, materials, light, ice and deck; gives the world body."""
    ET.SubElement(root, "compiler", angle="radian", autolimits="false", fusestatic="false")
    ET.SubElement(root, "option", gravity=_num(GRAVITY_EARTH))
    world = ET.SubElement(root, "worldbody")
    scenery.dress(root, world)
    lander = spec["lander"]
    _geom(world, "ice", "plane", "ice", pos=[0, 0, lander["ice_z_m"]], size=[40, 40, 0.1])
    _geom(world, "deck", "box", "deck", pos=lander["deck_xyz_m"], size=lander["deck_half_m"])
    x, y, z = spec["head"]["mast_xyz_m"]
    _geom(world, "mast", "capsule", "mast", fromto=[x, y, 0.0, x, y, z - 0.12], size=0.03)
    return world


def _arm(world: ET.Element, spec: dict, errors: dict[str, float]) -> ET.Element:
    """The chain of bodies; gives the tool body. Link<j> turns about joint j, frame<j> is DH frame j."""
    dh, base_error, tool_error = split_errors(errors, len(spec["joint"]))
    _geom(world, "pedestal", "capsule", "joint", fromto=[0, 0, 0.02, 0, 0, 0.16], size=0.10)
    frame = _body(world, "frame0", geom.trans(*spec["base"]["xyz_m"]) @ geom.twist(**base_error))
    for i, joint in enumerate(spec["joint"]):
        phi, alpha, a, d = dh[i] + (joint.get("phi_rad", 0.0), joint["alpha_rad"], joint["a_m"], joint["d_m"])
        link = _body(frame, f"link{i + 1}", geom.rot("z", phi))
        ET.SubElement(link, "joint", name=f"J{i + 1}", type="hinge", axis="0 0 1")
        # A link that is longer than drawn is longer as a body too; else its end would stick out beyond the
        # next joint, or not reach it. Compact joints (d = 0) keep their shape.
        longer = np.array([dh[i][2], 0.0, dh[i][3]]) / joint["d_m"] if joint["d_m"] else np.zeros(3)
        for k, shape in enumerate(joint["shapes"]):
            _capsule(link, f"link{i + 1}.{k}", shape, "joint" if k % 2 else "arm", longer)
        frame = _body(link, f"frame{i + 1}", geom.trans(a, 0, d) @ geom.rot("x", alpha))
        # A point mass is all that static loads need; the tiny inertia only keeps the compiler content.
        ET.SubElement(
            frame,
            "inertial",
            pos=_num(joint["com_m"]),
            mass=_num(joint["mass_kg"]),
            diaginertia="1e-6 1e-6 1e-6",
        )
    return _body(frame, "tool", geom.trans(*spec["tool"]["xyz_m"]) @ geom.twist(**tool_error))


def _scoop(tool: ET.Element, spec: dict, payload_kg: float) -> None:
    """Scoop, bracket with tag plates, and what the scoop holds."""
    _geom(tool, "stem", "capsule", "joint", fromto=[0, 0, -0.075, 0, 0, -0.03], size=0.022)
    _geom(tool, "scoop.back", "box", "scoop", pos=[0, 0, -0.02], size=[0.035, 0.03, 0.003])
    _geom(tool, "scoop.floor", "box", "scoop", pos=[0, 0.03, 0.005], size=[0.035, 0.003, 0.028])
    for side, x in (("left", -0.035), ("right", 0.035)):
        _geom(tool, f"scoop.{side}", "box", "scoop", pos=[x, 0.01, 0.0], size=[0.003, 0.022, 0.022])
    _geom(tool, "bracket", "box", "joint", pos=[0, 0, -0.008], size=[0.123, 0.008, 0.003])
    for tag in spec["tag"]:
        T = geom.trans(*tag["xyz_m"]) @ geom.rot("y", tag["rot_y_rad"])
        plate = _body(tool, f"tag{tag['id']}", T)
        # The plate begins 1 mm behind the printed plane, so a ray that ends on the print does not hit it.
        half = 0.66 * tag["size_m"]
        _geom(plate, f"tag{tag['id']}.plate", "box", "plate", pos=[0, 0, 0.003], size=[half, half, 0.002])
    if payload_kg > 0.0:
        load = _body(tool, "payload", np.eye(4))
        ET.SubElement(load, "inertial", pos="0 0 0", mass=_num(payload_kg), diaginertia="1e-6 1e-6 1e-6")


def _head(world: ET.Element, spec: dict) -> None:
    """Mast head: pan, tilt, camera body (z forward, x right, y down) and a MuJoCo camera in it."""
    head, cam = spec["head"], spec["camera"]
    light = {"pos": "0 0 0", "mass": "0.1", "diaginertia": "1e-6 1e-6 1e-6"}
    pan = _body(world, "pan", geom.trans(*head["mast_xyz_m"]))
    ET.SubElement(pan, "joint", name="pan", type="hinge", axis="0 0 1")
    ET.SubElement(pan, "inertial", light)
    _geom(pan, "head.neck", "capsule", "mast", fromto=[0, 0, -0.09, 0, 0, -0.05], size=0.025)
    tilt = _body(pan, "tilt", np.eye(4))
    ET.SubElement(tilt, "joint", name="tilt", type="hinge", axis="0 1 0")
    ET.SubElement(tilt, "inertial", light)
    _geom(tilt, "head.box", "box", "mast", pos=[-0.015, 0, 0.02], size=[0.04, 0.06, 0.04])
    T_head_cam = geom.trans(*head["camera_xyz_m"])
    T_head_cam[:3, :3] = [[0, 0, 1], [-1, 0, 0], [0, -1, 0]]
    camera = _body(tilt, "camera", T_head_cam)
    fovy = np.degrees(2 * np.arctan2(cam["height_px"] / 2, cam["fy_px"]))  # always degrees in MJCF
    # MuJoCo cameras look along -z with y up: half a turn about x.
    ET.SubElement(camera, "camera", name="eye", quat="0 1 0 0", fovy=_num(fovy))


def mjcf(spec: dict, errors: dict[str, float] | None = None, payload_kg: float = 0.0) -> str:
    """The whole model as MJCF text."""
    root = ET.Element("mujoco", model=spec["name"])
    world = _scene(root, spec)
    tool = _arm(world, spec, errors or {})
    _scoop(tool, spec, payload_kg)
    _head(world, spec)
    contact = ET.SubElement(root, "contact")
    for a, b in _touching(len(spec["joint"])):
        ET.SubElement(contact, "exclude", body1=a, body2=b)
    ET.indent(root)
    return ET.tostring(root, encoding="unicode")


def _touching(n: int) -> list[tuple[str, str]]:
    """Bodies that touch by design and are no collision: neighbours, and the compact shoulder and wrist."""
    pairs = [("world", "link1"), ("pan", "world"), ("tilt", "world"), ("pan", "tilt")]
    pairs += [(f"link{i}", f"link{i + 1}") for i in range(1, n)]
    # Upper arm and forearm lie side by side when the elbow is folded to its stop.
    pairs += [
        ("link1", "link3"),
        ("link3", "link5"),
        ("link5", f"link{n}"),
        (f"link{n}", "tool"),
        (f"link{n - 1}", "tool"),
    ]
    pairs += [(a, b) for a in ("tag0", "tag1") for b in ("tool", f"link{n}")]
    return pairs


class Arm:
    """MuJoCo model and data of one arm on its lander; positions are set, never integrated."""

    def __init__(
        self,
        spec: dict | None = None,
        errors: dict[str, float] | None = None,
        gravity_m_s2=GRAVITY_EARTH,
        payload_kg: float = 0.0,
    ):
        self.spec = spec or load_spec()
        self.n = len(self.spec["joint"])
        self.model = mujoco.MjModel.from_xml_string(mjcf(self.spec, errors, payload_kg))
        self.model.opt.gravity[:] = gravity_m_s2
        self.data = mujoco.MjData(self.model)
        self._tool = self.model.body("tool").id
        self._camera = self.model.body("camera").id
        self._bias = np.zeros(self.model.nv)
        self.q_min = np.array([j["q_rad"][0] for j in self.spec["joint"]])
        self.q_max = np.array([j["q_rad"][1] for j in self.spec["joint"]])

    def set(self, q_rad, pan_rad: float | None = None, tilt_rad: float | None = None) -> None:
        """Put the true joints (and the head) there and update all frames."""
        self.data.qpos[: self.n] = q_rad
        if pan_rad is not None:
            self.data.qpos[self.n :] = pan_rad, tilt_rad
        mujoco.mj_kinematics(self.model, self.data)

    def _pose(self, body: int) -> np.ndarray:
        return geom.pose(self.data.xpos[body], self.data.xmat[body].reshape(3, 3))

    @property
    def T_base_tool(self) -> np.ndarray:
        return self._pose(self._tool)

    @property
    def T_base_cam(self) -> np.ndarray:
        return self._pose(self._camera)

    def gravity_torque(self) -> np.ndarray:
        """Torque [N m] that gravity exerts about each joint at the present posture, positive along +q."""
        mujoco.mj_comPos(self.model, self.data)
        self.data.qvel[:] = 0.0
        mujoco.mj_comVel(self.model, self.data)
        mujoco.mj_rne(self.model, self.data, 0, self._bias)
        return -self._bias[: self.n]

    def collisions(self) -> list[tuple[str, str]]:
        """Names of the shapes that touch at the present posture."""
        mujoco.mj_comPos(self.model, self.data)
        mujoco.mj_collision(self.model, self.data)
        name = [self.model.geom(i).name for i in range(self.model.ngeom)]
        return [(name[c.geom1], name[c.geom2]) for c in self.data.contact[: self.data.ncon]]
