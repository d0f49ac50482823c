"""Arm, lander and pan-tilt camera as MuJoCo bodies (MJCF), built from models/wam.toml and an arm's errors.

Every DH frame is a body of its own, and an error moves that body, so kinematics come from MuJoCo alone. The
world frame is the base frame: base plate of the arm on the lander deck, z up, x away from the lander.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any
from xml.etree import ElementTree as ET

import numpy as np
from numpy.typing import ArrayLike

from ..transforms import frame_error, quaternion, rot, trans
from . import appearance

GRAVITY_EARTH = (0.0, 0.0, -9.81)  # [m/s^2]
TINY_INERTIA = "1e-6 1e-6 1e-6"  # static loads need masses only; MuJoCo's compiler wants an inertia too
CAMERA_AXES = ((0, 0, 1), (-1, 0, 0), (0, -1, 0))  # camera in the tilt frame: z forward, x right, y down


def mjcf(
    spec: dict,
    dh: np.ndarray,
    base: dict,
    tool: dict,
    payload_kg: float = 0.0,
    pictures: bool = True,
) -> str:
    """The whole model as MJCF text.

    spec: numbers of models/wam.toml; dh: (n, 4) errors phi [rad], alpha [rad], a [m], d [m]; base, tool:
    errors of these frames as keywords of transforms.frame_error; payload_kg: mass in the scoop; pictures:
    whether any will be taken of it.
    """
    root = ET.Element("mujoco", model=spec["name"])
    world = _scene(root, spec, pictures)
    body = _arm(world, spec, dh, base, tool)
    _scoop(body)
    _tag_plates(body, spec)
    if payload_kg > 0.0:
        _point_mass(_body(body, "payload", np.eye(4)), [0.0, 0.0, 0.0], payload_kg)
    _pantilt(world, spec)
    contact = ET.SubElement(root, "contact")
    for a, b in _collision_exclusions(len(spec["joint"])):
        ET.SubElement(contact, "exclude", body1=a, body2=b)
    ET.indent(root)
    return ET.tostring(root, encoding="unicode")


# ---- elements ---------------------------------------------------------------------------------------


def _numbers(values: ArrayLike) -> str:
    return " ".join(repr(float(v)) for v in np.atleast_1d(values))


def _body(parent: ET.Element, name: str, T: np.ndarray) -> ET.Element:
    return ET.SubElement(parent, "body", name=name, pos=_numbers(T[:3, 3]), quat=_numbers(quaternion(T)))


def _hinge(body: ET.Element, name: str, axis: str) -> None:
    ET.SubElement(body, "joint", name=name, type="hinge", axis=axis)


def _point_mass(body: ET.Element, at_m: ArrayLike, mass_kg: float) -> None:
    ET.SubElement(body, "inertial", pos=_numbers(at_m), mass=_numbers(mass_kg), diaginertia=TINY_INERTIA)


def _geom(body: ET.Element, name: str, kind: str, material: str, **attributes: str | ArrayLike) -> None:
    text: dict[str, Any] = {k: v if isinstance(v, str) else _numbers(v) for k, v in attributes.items()}
    ET.SubElement(body, "geom", name=name, type=kind, material=material, mass="0", **text)


# ---- parts ------------------------------------------------------------------------------------------


def _scene(root: ET.Element, spec: dict, pictures: bool) -> ET.Element:
    """Options, materials, light, ice, deck and mast; gives the world body."""
    ET.SubElement(root, "compiler", angle="radian", autolimits="false", fusestatic="false")
    ET.SubElement(root, "option", gravity=_numbers(GRAVITY_EARTH))
    world = ET.SubElement(root, "worldbody")
    appearance.add_to(root, world, pictures)
    lander = spec["lander"]
    _geom(world, "ice", "plane", "ice", pos=[0, 0, lander["ice_z_m"]], size=[40, 40, 0.1])
    _geom(world, "deck", "box", "deck", pos=lander["deck_xyz_m"], size=lander["deck_half_m"])
    x, y, z = spec["pantilt"]["mast_xyz_m"]
    _geom(world, "mast", "capsule", "mast", fromto=[x, y, 0.0, x, y, z - 0.12], size=0.03)
    return world


def _arm(world: ET.Element, spec: dict, dh: np.ndarray, base: dict, tool: dict) -> ET.Element:
    """The chain of bodies; gives the tool body. link<j> turns about joint j, frame<j> is DH frame j."""
    _geom(world, "pedestal", "capsule", "joint", fromto=[0, 0, 0.02, 0, 0, 0.16], size=0.10)
    frame = _body(world, "frame0", trans(*spec["base"]["xyz_m"]) @ frame_error(**base))
    for j, joint in enumerate(spec["joint"], 1):
        frame = _link(frame, j, joint, dh[j - 1])
    return _body(frame, "tool", trans(*spec["tool"]["xyz_m"]) @ frame_error(**tool))


def _link(parent: ET.Element, j: int, joint: dict, error: np.ndarray) -> ET.Element:
    """Joint j and its link; gives the body of DH frame j."""
    phi, alpha, a, d = error + (joint.get("phi_rad", 0.0), joint["alpha_rad"], joint["a_m"], joint["d_m"])
    link = _body(parent, f"link{j}", rot("z", phi))
    _hinge(link, f"J{j}", "0 0 1")
    # A link that is longer than nominal is longer as a body too; else its end would stick out beyond the
    # next joint, or not reach it. Compact joints (d = 0) keep their shape.
    stretch = np.array([error[2], 0.0, error[3]]) / joint["d_m"] if joint["d_m"] else np.zeros(3)
    for k, shape in enumerate(joint["shapes"]):
        ends = [np.array(shape[end]) + stretch * shape[end][2] for end in ("from", "to")]
        material = "joint" if k % 2 else "arm"
        _geom(
            link,
            f"link{j}.{k}",
            shape["type"],
            material,
            fromto=np.concatenate(ends),
            size=shape["radius"],
        )
    frame = _body(link, f"frame{j}", trans(a, 0, d) @ rot("x", alpha))
    _point_mass(frame, joint["com_m"], joint["mass_kg"])
    return frame


def _scoop(tool: ET.Element) -> None:
    """Scoop and bracket of the tags."""
    _geom(tool, "stem", "capsule", "joint", fromto=[0, 0, -0.075, 0, 0, -0.03], size=0.022)
    _geom(tool, "scoop.back", "box", "scoop", pos=[0, 0, -0.02], size=[0.035, 0.03, 0.003])
    _geom(tool, "scoop.floor", "box", "scoop", pos=[0, 0.03, 0.005], size=[0.035, 0.003, 0.028])
    for side, x in (("left", -0.035), ("right", 0.035)):
        _geom(tool, f"scoop.{side}", "box", "scoop", pos=[x, 0.01, 0.0], size=[0.003, 0.022, 0.022])
    _geom(tool, "bracket", "box", "joint", pos=[0, 0, -0.008], size=[0.123, 0.008, 0.003])


def _tag_plates(tool: ET.Element, spec: dict) -> None:
    for tag in spec["tag"]:
        name, half = f"tag{tag['id']}", 0.66 * tag["size_m"]
        plate = _body(tool, name, trans(*tag["xyz_m"]) @ rot("y", tag["rot_y_rad"]))
        # The plate begins 1 mm behind the printed plane, so a ray that ends on the print does not hit it.
        _geom(plate, f"{name}.plate", "box", "plate", pos=[0, 0, 0.003], size=[half, half, 0.002])


def _pantilt(world: ET.Element, spec: dict) -> None:
    """Pan-tilt unit on the mast: bodies pan, tilt and camera, and a MuJoCo camera in the last."""
    unit = spec["pantilt"]
    pan = _body(world, "pan", trans(*unit["mast_xyz_m"]))
    _hinge(pan, "pan", "0 0 1")
    _point_mass(pan, [0.0, 0.0, 0.0], 0.1)
    _geom(pan, "pantilt.neck", "capsule", "mast", fromto=[0, 0, -0.09, 0, 0, -0.05], size=0.025)
    tilt = _body(pan, "tilt", np.eye(4))
    _hinge(tilt, "tilt", "0 1 0")
    _point_mass(tilt, [0.0, 0.0, 0.0], 0.1)
    _geom(tilt, "pantilt.box", "box", "mast", pos=[-0.015, 0, 0.02], size=[0.04, 0.06, 0.04])
    T_tilt_cam = trans(*unit["camera_xyz_m"])
    T_tilt_cam[:3, :3] = CAMERA_AXES
    _camera(_body(tilt, "camera", T_tilt_cam), spec["camera"])


def _camera(body: ET.Element, cam: dict) -> None:
    fovy_deg = np.degrees(2 * np.arctan2(cam["height_px"] / 2, cam["fy_px"]))  # always degrees in MJCF
    # MuJoCo cameras look along -z with y up: half a turn about x.
    ET.SubElement(body, "camera", name="mast", quat="0 1 0 0", fovy=_numbers(fovy_deg))


def _collision_exclusions(n: int) -> Iterator[tuple[str, str]]:
    """Pairs of bodies that touch by design: neighbours, and the compact shoulder and wrist."""
    yield from (("world", "link1"), ("pan", "world"), ("tilt", "world"), ("pan", "tilt"))
    yield from ((f"link{i}", f"link{i + 1}") for i in range(1, n))
    # Upper arm and forearm lie side by side when the elbow is folded to its stop.
    yield from (("link1", "link3"), ("link3", "link5"), ("link5", f"link{n}"))
    yield from ((f"link{n}", "tool"), (f"link{n - 1}", "tool"))
    yield from ((a, b) for a in ("tag0", "tag1") for b in ("tool", f"link{n}"))
