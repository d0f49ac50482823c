"""Is a model file for this arm?"""

from __future__ import annotations

import re

from kincal_shared.errors import BadInput
from kincal_shared.schema.arm import ArmTable, read_arm, same_joints
from kincal_shared.schema.dh import DH_FIELDS

from ..model.modelfile import ModelFile

_OF_JOINT = re.compile(rf"J(\d+)\.({'|'.join(DH_FIELDS)})")


def refuse_model_of_other_arm(model: ModelFile, arm: ArmTable, path: str) -> None:
    """BadInput if the model was begun or fitted with an arm table of another arm: other nominal joints, or
    another number of them. path: of the model file, for the error."""
    fitted = _joints_fitted(model)
    if fitted and fitted != arm.n:
        _refuse(f"an arm with {fitted} joints", arm, path)
    known = _table(model)
    if known is not None and not same_joints(known, arm):
        _refuse(f"{known.name} ({model.arm})", arm, path)


def _joints_fitted(model: ModelFile) -> int:
    """Joints of the arm that the values are of; 0 if the model holds no DH errors."""
    found = (_OF_JOINT.fullmatch(name) for name in model.values)
    return max((int(match[1]) for match in found if match), default=0)


def _table(model: ModelFile) -> ArmTable | None:
    """The arm table that the model was begun or fitted with, if it is still there."""
    try:
        return read_arm(model.arm) if model.arm else None
    except BadInput:
        return None


def _refuse(other: str, arm: ArmTable, path: str) -> None:
    raise BadInput(
        f"this model was made with {other}, the arm table is of {arm.name} with {arm.n} joints",
        path,
        "name the model of this arm; `kincal model add --model NEW.toml EFFECT` begins a new one",
    )
