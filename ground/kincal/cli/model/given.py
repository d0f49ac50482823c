"""What the commands of `kincal model` share: their options, and reading what these name."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import click

from kincal.cli.data import Given, data_options
from kincal.cli.outputs import FILE_OUT
from kincal.errors import BadInput

if TYPE_CHECKING:
    from kincal.schema.arm import ArmTable
    from kincal.workbench.data.measurements import Measurements
    from kincal.workbench.model.effects import Library
    from kincal.workbench.model.modelfile import ModelFile

ARM = click.option(
    "--arm",
    "arm_path",
    required=True,
    type=click.Path(path_type=Path),
    help="Arm table (TOML), or the name of one that is shipped (`kincal arm list`): wam.",
)
DATA = data_options()
MODEL = click.option("--model", "model_path", type=click.Path(path_type=Path), default=None,
                     help="Model file; absent: DH errors only.")  # fmt: skip
MODEL_NEEDED = click.option(
    "--model", "model_path", type=click.Path(path_type=Path), required=True, help="Model file."
)
MODEL_WRITTEN = click.option("--model", "model_path", type=FILE_OUT, required=True, help="Model file.")
EFFECTS = click.option("--effects", "effect_files", multiple=True, type=click.Path(path_type=Path),
                       help="A file with your own effects; may be given several times.")  # fmt: skip
JSON = click.option("--json", "as_json", is_flag=True, help="Machine-readable answer.")


def load(arm_path: Path, given: Given) -> tuple[ArmTable, Measurements]:
    """Arm and measurements."""
    from kincal.schema.arm import read_arm

    arm = read_arm(arm_path)
    return arm, given.checked(arm)


def load_model(
    model_path: Path | None,
    effect_files: tuple[Path, ...],
    arm: ArmTable | None = None,
    *,
    must_exist: bool = True,
) -> tuple[ModelFile, Library]:
    """Model file and the library with its own and the named effect files. BadInput if the model is of another
    arm than `arm`, or absent and must_exist."""
    from kincal.workbench.consistency import refuse_model_of_other_arm
    from kincal.workbench.model.effects import Library
    from kincal.workbench.model.modelfile import ModelFile, read_model

    model = read_model(model_path, must_exist=must_exist) if model_path else ModelFile()
    if arm is not None:
        refuse_model_of_other_arm(model, arm, str(model_path))
    base = model_path.parent if model_path else Path()
    files = list(dict.fromkeys([*(base / name for name in model.libraries), *effect_files]))
    return model, Library.load(*files).with_unnamed(model.unnamed.values())


def arm_of(chosen: ModelFile, model_path: Path, arm_path: Path | None) -> Path:
    """The arm table that was named, else the one that the model was fitted with."""
    if arm_path is None and not chosen.arm:
        raise BadInput(
            f"{model_path} does not say which arm it is for; run `kincal model fit` first or give --arm"
        )
    return arm_path or Path(chosen.arm)
