"""What the commands of `kincal model` share: their options, and reading what these name."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import click

from kincal.cli.data import Given, data_options
from kincal.cli.outputs import FILE_OUT

if TYPE_CHECKING:
    from kincal.api.case import Case
    from kincal.workbench.data.measurements import Measurements
    from kincal_shared.schema.arm import ArmTable

ARM = click.option(
    "--arm",
    "arm_path",
    required=True,
    type=click.Path(path_type=Path),
    help="Arm table (TOML), or the name of a shipped one, such as wam or ur5e: see `kincal arm list`.",
)
DATA = data_options()
MODEL = click.option("--model", "model_path", type=click.Path(path_type=Path), default=None,
                     help="Model file.  [default: DH errors only]")  # fmt: skip
MODEL_NEEDED = click.option(
    "--model", "model_path", type=click.Path(path_type=Path), required=True, help="Model file."
)
MODEL_WRITTEN = click.option("--model", "model_path", type=FILE_OUT, required=True, help="Model file.")
EFFECTS = click.option("--effects", "effect_files", multiple=True, type=click.Path(path_type=Path),
                       help="File with your own effects; may be repeated.")  # fmt: skip
JSON = click.option("--json", "as_json", is_flag=True, help="Machine-readable answer.")


def load(arm_path: Path, given: Given) -> tuple[ArmTable, Measurements]:
    """Arm and measurements."""
    from kincal_shared.schema.arm import read_arm

    arm = read_arm(arm_path)
    return arm, given.checked(arm)


def case_of(arm_path: Path, given: Given, model_path: Path | None, effect_files: tuple[Path, ...]) -> Case:
    """Arm, measurements, and the model that is named, DH errors without one."""
    from kincal.api.case import Case
    from kincal.api.models import load_model

    arm, data = load(arm_path, given)
    return Case.of_model(arm, data, *load_model(model_path, effect_files, arm))
