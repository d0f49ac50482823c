"""ROS bags (1 and 2): joint states and poses, matched by time."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from kincal_shared import installation
from kincal_shared.errors import BadInput
from kincal_shared.schema.datamap import DataMap, RosEntry
from kincal_shared.schema.suggestions import nearest_name

from ...numerics.types import Array, array
from .table import Column, Joints, Table

JOINT_STATE = "sensor_msgs/msg/JointState"
POSE = "geometry_msgs/msg/PoseStamped"
_FILES = (".bag", ".mcap", ".db3")


def is_bag(path: Path) -> bool:
    """Whether a path is a bag: the folder of ROS 2, or a file of ROS 1 or 2 by its ending."""
    return (path / "metadata.yaml").is_file() if path.is_dir() else path.suffix in _FILES


@dataclass(frozen=True)
class _JointStates:
    """Joint states in order of time: names, time (M,) [s], positions and speeds (M, k)."""

    names: tuple[str, ...]
    t_s: Array
    position: Array
    speed: Array | None


@dataclass(frozen=True)
class _Poses:
    """Poses in order of time: time (N,) [s], position (N, 3) [m], quaternion (N, 4), scalar part first."""

    t_s: Array
    p_m: Array
    quat_wxyz: Array


def read_bag(path: str, mapping: DataMap, joints: Joints) -> Table:
    """One row for each pose, with the joint state that is nearest in time.

    A pose without a joint state within the tolerance is a malformed row. BadInput for topics or joints that
    are not there, or that are not the only ones and were not named.
    """
    installation.require("ros", "reading ROS bags")
    states, poses = _read(path, mapping.ros)
    order, notes = _order(path, states.names, mapping.ros, joints)
    nearest = _nearest(states.t_s, poses.t_s)
    gap_s = np.abs(states.t_s[nearest] - poses.t_s)
    good = gap_s <= mapping.ros.tolerance_s
    start_s = float(poses.t_s[0])
    malformed = tuple(
        (int(k) + 1, f"at {poses.t_s[k] - start_s:.3f} s has no joint state within "
         f"{mapping.ros.tolerance_s:g} s (nearest {gap_s[k]:.3g} s)")
        for k in np.flatnonzero(~good)
    )  # fmt: skip
    used = nearest[good]
    columns: dict[str, Column] = {"t_s": poses.t_s[good] - start_s}
    for j, k in enumerate(order, 1):
        columns[f"q{j}"] = states.position[used, k]
        if states.speed is not None:
            columns[f"qdot{j}"] = states.speed[used, k]
    columns |= dict(zip(("px", "py", "pz"), poses.p_m[good].T, strict=True))
    columns |= dict(zip(("qw", "qx", "qy", "qz"), poses.quat_wxyz[good].T, strict=True))
    numbers = [int(k) + 1 for k in np.flatnonzero(good)]
    return Table(path, "", "pose", numbers, columns, malformed, notes=notes)


def _nearest(sorted_s: Array, wanted_s: Array) -> np.ndarray[Any, np.dtype[np.intp]]:
    """Index of the nearest of sorted times, for each wanted one."""
    after = np.clip(np.searchsorted(sorted_s, wanted_s), 1, max(len(sorted_s) - 1, 1))
    before = after - 1
    after = np.minimum(after, len(sorted_s) - 1)
    return np.where(wanted_s - sorted_s[before] <= sorted_s[after] - wanted_s, before, after)


def _read(path: str, given: RosEntry) -> tuple[_JointStates, _Poses]:
    from rosbags.highlevel import AnyReader, AnyReaderError
    from rosbags.typesys import Stores, get_typestore

    # Bags of ROS 1 and new bags of ROS 2 carry their message definitions; older ones mean these.
    store = get_typestore(Stores.ROS2_HUMBLE)
    try:
        with AnyReader([Path(path)], default_typestore=store) as bag:
            joint = _topic(path, bag, JOINT_STATE, given.joint_topic, "joint_topic")
            pose = _topic(path, bag, POSE, given.pose_topic, "pose_topic")
            messages: dict[str, list[tuple[float, Any]]] = {joint: [], pose: []}
            wanted = [c for c in bag.connections if c.topic in messages]
            for connection, received_ns, raw in bag.messages(connections=wanted):
                message = bag.deserialize(raw, connection.msgtype)
                messages[connection.topic].append((_time_s(message, received_ns), message))
    except (AnyReaderError, OSError, ValueError) as error:
        raise BadInput("cannot be read as a ROS bag", path, str(error)) from None
    for topic, found in messages.items():
        if not found:
            raise BadInput(f"topic {topic} holds no message", path)
        found.sort(key=lambda pair: pair[0])
    return _joint_states(path, joint, messages[joint]), _poses(path, pose, messages[pose])


def _topic(path: str, bag: Any, kind: str, name: str | None, key: str) -> str:
    """The topic of a message type: the named one, or the only one."""
    found: list[str] = sorted({c.topic for c in bag.connections if c.msgtype == kind})
    listed = ", ".join(found) or "none"
    if name is None:
        if len(found) == 1:
            return found[0]
        what = "no topic" if not found else f"{len(found)} topics"
        others = ", ".join(sorted({f"{c.topic} ({c.msgtype})" for c in bag.connections})) or "nothing"
        todo = f"name one in the map: [ros] {key} = ...; there are {listed}"
        raise BadInput(f"{what} of type {kind}", path, todo if found else f"the bag holds {others}")
    if name not in found:
        near = nearest_name(name, found)
        hint = f"did you mean {near}? " if near else ""
        raise BadInput(f"no topic {name} of type {kind}", path, f"{hint}there are {listed}")
    return name


def _time_s(message: Any, received_ns: int) -> float:
    """The time in the message's header; when it was received if the header has none."""
    stamp = message.header.stamp
    stamped = stamp.sec + stamp.nanosec * 1e-9
    return float(stamped) if stamped > 0.0 else received_ns * 1e-9


def _joint_states(path: str, topic: str, found: Sequence[tuple[float, Any]]) -> _JointStates:
    names = tuple(found[0][1].name)
    for number, (_, message) in enumerate(found, 1):
        if tuple(message.name) != names or len(message.position) != len(names):
            raise BadInput(
                f"message {number} of {topic} has other joints than the first", path,
                f"the first has {', '.join(names)}; choose a topic of one publisher",
            )  # fmt: skip
    with_speed = all(len(message.velocity) == len(names) for _, message in found)
    return _JointStates(
        names,
        array([t for t, _ in found]),
        array([message.position for _, message in found]),
        array([message.velocity for _, message in found]) if with_speed else None,
    )


def _poses(path: str, topic: str, found: Sequence[tuple[float, Any]]) -> _Poses:
    frames = sorted({message.header.frame_id for _, message in found})
    if len(frames) > 1:
        raise BadInput(f"topic {topic} has poses in several frames: {', '.join(frames)}", path)
    places = [m.pose.position for _, m in found]
    turns = [m.pose.orientation for _, m in found]
    return _Poses(
        array([t for t, _ in found]),
        array([[p.x, p.y, p.z] for p in places]),
        array([[q.w, q.x, q.y, q.z] for q in turns]),
    )


def _order(
    path: str, there: tuple[str, ...], given: RosEntry, joints: Joints
) -> tuple[list[int], tuple[str, ...]]:
    """Place of each joint of the arm in the messages, and what was assumed."""
    names = tuple(given.joint_names or ()) or (joints.names if all(joints.names) else ())
    if given.joint_names is not None and len(names) != joints.n:
        raise BadInput(f"[ros] joint_names has {len(names)} names, the arm table has {joints.n} joints", path)
    if given.joint_names is None and not set(names) <= set(there):
        names = ()
    if not names:
        if len(there) != joints.n:
            raise BadInput(
                f"the joint states have {len(there)} joints, the arm table {joints.n}",
                path,
                f"name them in the map: [ros] joint_names = [...]; there are {', '.join(there)}",
            )
        return list(range(joints.n)), (f"joints in the order of the messages: {', '.join(there)}",)
    for name in names:
        if name not in there:
            near = nearest_name(name, there)
            hint = f"did you mean {near}? " if near else ""
            raise BadInput(
                f"no joint {name!r} in the joint states", path, f"{hint}there are {', '.join(there)}"
            )
    return [there.index(name) for name in names], ()
