"""The same kinematic chain in Pinocchio and in MuJoCo, from numbers only: no flight code here.

A chain is a list of elements, each acting after the one before:
    Fixed(T)            constant transform (4x4)
    Move(kind, value)   one degree of freedom: "tx" .. "rz"
    Mass(kg, com)       point-like body at com in the current frame
A correction twist Tx Rx Ty Ry Rz Tz is six Moves, so both libraries differentiate the pose by every
correction themselves.
"""

from dataclasses import dataclass

import mujoco
import numpy as np
import pinocchio as pin
from scipy.spatial.transform import Rotation

COMPONENTS = ("tx", "ty", "tz", "rx", "ry", "rz")
ORDER = ("tx", "rx", "ty", "ry", "rz", "tz")  # method: E_i = Tx Rx Ty Ry Rz Tz

# METHOD.md 1
HALF_PI = np.pi / 2
WAM_DH = np.array(
    [  # phi, alpha, a, d
        [0, -HALF_PI, 0.0, 0.0],
        [0, HALF_PI, 0.0, 0.0],
        [0, -HALF_PI, 0.045, 0.55],
        [0, HALF_PI, -0.045, 0.0],
        [0, -HALF_PI, 0.0, 0.30],
        [0, HALF_PI, 0.0, 0.0],
        [0, 0.0, 0.0, 0.06],
    ]
)
WAM_LIMITS = np.array(
    [[-2.6, 2.6], [-2.0, 2.0], [-2.8, 2.8], [-0.9, 3.1], [-4.76, 1.24], [-1.6, 1.6], [-3.0, 3.0]]
)
WAM_MASS = np.array([10.7677, 3.8749, 1.8023, 2.1727, 0.35656, 0.40916, 0.07548])
WAM_COM = np.array(
    [
        [-0.00443, 0.12189, -0.00066],
        [-0.00237, 0.03106, 0.01542],
        [-0.03826, 0.20751, 0.00003],
        [0.00553, 0.00007, 0.11928],
        [0.00005, 0.02886, 0.00148],
        [-0.00006, -0.01686, 0.02419],
        [0.00015, 0.00007, -0.00335],
    ]
)


@dataclass
class Fixed:
    T: np.ndarray


@dataclass
class Move:
    kind: str
    value: float
    tag: object = None


@dataclass
class Mass:
    kg: float
    com: np.ndarray


@dataclass
class Numbers:
    """An arm as plain arrays."""

    dh: np.ndarray  # n x 4: phi alpha a d
    prismatic: np.ndarray  # n bools
    base: np.ndarray  # 4x4
    tool: np.ndarray
    gravity: np.ndarray
    mass: np.ndarray
    com: np.ndarray

    @property
    def n(self):
        return len(self.dh)


def transform(p=(0, 0, 0), rotvec=(0, 0, 0)):
    T = np.eye(4)
    T[:3, :3] = Rotation.from_rotvec(rotvec).as_matrix()
    T[:3, 3] = p
    return T


def elementary(kind, value):
    v = np.zeros(3)
    v["xyz".index(kind[1])] = value
    return transform(p=v) if kind[0] == "t" else transform(rotvec=v)


def link(phi, alpha, a, d):
    return elementary("rz", phi) @ elementary("tz", d) @ elementary("tx", a) @ elementary("rx", alpha)


def wam(tool=None, base=None):
    return Numbers(
        WAM_DH.copy(),
        np.zeros(7, bool),
        transform((0, 0, 0.346)) if base is None else base,
        transform((0, 0, 0.10)) if tool is None else tool,
        np.array([0, 0, -9.81]),
        WAM_MASS.copy(),
        WAM_COM.copy(),
    )


def random_arm(rng, n):
    dh = np.column_stack(
        [rng.uniform(-3, 3, n), rng.uniform(-2, 2, n), rng.uniform(-0.5, 0.5, n), rng.uniform(-0.5, 0.5, n)]
    )
    return Numbers(
        dh,
        rng.random(n) < 0.35,
        transform(rng.normal(size=3), rng.normal(size=3)),
        transform(rng.normal(size=3) * 0.3, rng.normal(size=3)),
        rng.normal(size=3) * 9,
        rng.uniform(0.1, 5, n),
        rng.normal(size=(n, 3)) * 0.2,
    )


def twist_moves(frame, twist):
    """Six Moves of the twist (tx ty tz rx ry rz) at a frame, in the order in which they act."""
    return [Move(kind, twist[COMPONENTS.index(kind)], (frame, COMPONENTS.index(kind))) for kind in ORDER]


def chain_of(arm, q, twists, payload_kg=0.0, probes=False):
    """Elements from the base frame to the tool; twists: {frame: 6 values}, frame n_frames-1 'tool'.
    probes: three more turns (value 0) at every frame, to read moments in that frame."""

    def probe(frame):
        return [Move(k, 0.0, ("probe", frame, i)) for i, k in enumerate(("rx", "ry", "rz"))] if probes else []

    zero = np.zeros(6)
    out = [Fixed(arm.base), *twist_moves(0, twists.get(0, zero)), *probe(0)]
    for i in range(arm.n):
        out.append(Move("tz" if arm.prismatic[i] else "rz", q[i], ("q", i)))
        out.append(Fixed(link(*arm.dh[i])))
        out += twist_moves(i + 1, twists.get(i + 1, zero))
        out.append(Mass(arm.mass[i], arm.com[i]))
        out += probe(i + 1)
    out += [Fixed(arm.tool), *twist_moves("tool", twists.get("tool", zero)), Mass(payload_kg, np.zeros(3))]
    return out


@dataclass
class Answer:
    T: np.ndarray  # 4x4
    J: dict  # tag -> (dp; dtheta) of the chain's end, in the base frame
    gravity: dict  # tag -> what gravity does about or along that freedom


PIN_JOINTS = {
    "tx": pin.JointModelPX,
    "ty": pin.JointModelPY,
    "tz": pin.JointModelPZ,
    "rx": pin.JointModelRX,
    "ry": pin.JointModelRY,
    "rz": pin.JointModelRZ,
}


def by_pinocchio(chain, gravity=(0, 0, -9.81)):
    model = pin.Model()
    model.gravity.linear = np.array(gravity, float)
    at, parent, tags, q = pin.SE3.Identity(), 0, [], []
    for e in chain:
        if isinstance(e, Fixed):
            at = at * pin.SE3(e.T)
        elif isinstance(e, Mass):
            model.appendBodyToJoint(parent, pin.Inertia(e.kg, e.com, np.zeros((3, 3))), at)
        else:
            parent = model.addJoint(parent, PIN_JOINTS[e.kind](), at, f"j{len(tags)}")
            at = pin.SE3.Identity()
            tags.append(e.tag)
            q.append(e.value)
    end = model.addFrame(pin.Frame("end", parent, at, pin.FrameType.OP_FRAME))
    data, q = model.createData(), np.array(q)
    pin.computeJointJacobians(model, data, q)
    pin.updateFramePlacements(model, data)
    J = pin.getFrameJacobian(model, data, end, pin.ReferenceFrame.LOCAL_WORLD_ALIGNED)
    g = pin.computeGeneralizedGravity(model, model.createData(), q)  # what the motors must hold
    return Answer(
        data.oMf[end].homogeneous, dict(zip(tags, J.T, strict=True)), dict(zip(tags, -g, strict=True))
    )


def by_mujoco(chain, gravity=(0, 0, -9.81)):
    spec = mujoco.MjSpec()
    spec.option.gravity = list(gravity)
    body, at, tags, q = spec.worldbody, np.eye(4), [], []

    def place(T):
        return {"pos": T[:3, 3], "quat": Rotation.from_matrix(T[:3, :3]).as_quat(scalar_first=True)}

    for e in chain:
        if isinstance(e, Fixed):
            at = at @ e.T
        elif isinstance(e, Mass):
            if e.kg > 0:
                p = at[:3, :3] @ e.com + at[:3, 3]
                body.add_body(pos=p, ipos=[0, 0, 0], mass=e.kg, inertia=[1e-9] * 3, explicitinertial=True)
        else:
            # A moving body must have some mass; 1e-13 kg is 1e-12 N.
            body = body.add_body(
                **place(at), mass=1e-13, ipos=[0, 0, 0], inertia=[1e-13] * 3, explicitinertial=True
            )
            at = np.eye(4)
            axis = np.eye(3)["xyz".index(e.kind[1])]
            kind = mujoco.mjtJoint.mjJNT_SLIDE if e.kind[0] == "t" else mujoco.mjtJoint.mjJNT_HINGE
            body.add_joint(type=kind, axis=axis)
            tags.append(e.tag)
            q.append(e.value)
    body.add_site(name="end", **place(at))
    model = spec.compile()
    data = mujoco.MjData(model)
    data.qpos[:] = q
    mujoco.mj_forward(model, data)
    site = data.site("end")
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = site.xmat.reshape(3, 3), site.xpos
    jp, jr = np.zeros((3, model.nv)), np.zeros((3, model.nv))
    mujoco.mj_jacSite(model, data, jp, jr, site.id)
    J = np.vstack([jp, jr])
    return Answer(T, dict(zip(tags, J.T, strict=True)), dict(zip(tags, -data.qfrc_bias, strict=True)))
