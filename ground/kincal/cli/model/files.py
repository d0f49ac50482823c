"""`kincal model effects`, `add`, `remove`, `undo`, `list`, `history`, `uplink`, `export`: the model file."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING

import click

from kincal.cli.data import Given, data_options
from kincal.cli.options import PATH, tables_option
from kincal.cli.outputs import FILE_OUT, FOLDER_OUT

from .given import EFFECTS, JSON, MODEL_NEEDED, MODEL_WRITTEN

if TYPE_CHECKING:
    from kincal.export.files import Format


@click.command("effects")
@EFFECTS
@JSON
def effects_command(effect_files: tuple[Path, ...], as_json: bool) -> None:
    """List the effect library: formula, units, typical size, what each needs and is confounded with.

    \b
    Example:
        kincal model effects --effects my.toml
    """
    from kincal.cli.text import model as text
    from kincal.workbench.model.effects import Library

    library = Library.load(*effect_files)
    if as_json:
        click.echo(json.dumps(text.effects_json(library), indent=1))
    else:
        click.echo(text.effects(library))


@click.command("add")
@MODEL_WRITTEN
@EFFECTS
@click.option(
    "--arm",
    "arm_path",
    type=click.Path(path_type=Path),
    default=None,
    help="Arm table, for an unnamed effect and to check joints; a new model keeps it.  [default: its own]",
)
@data_options(required=False, about="Measurements that the terms of an unnamed effect are chosen from.")
@click.argument("names", metavar="EFFECT...", nargs=-1, required=True)
def add_command(
    model_path: Path,
    effect_files: tuple[Path, ...],
    arm_path: Path | None,
    given: Given | None,
    names: tuple[str, ...],
) -> None:
    """Add effects to the model, or to a new model file; the change is recorded in its history.

    Constants given after the name stay fixed in every fit; otherwise each fit chooses them from the data.

    An unnamed effect, as `diagnose` names it, is added as a smooth function at that location: ordinary terms,
    chosen from the data given by --arm and --data, with the improvement on held-out poses. `unnamed` alone
    adds as many as improve cross-validation of the fitted poses, the strongest first. The held-out poses are
    not used to choose them, so some may show no improvement there. Those that `fit` would advise against are
    left out and named: they make an unseen region of the poses worse. No term can follow the orientation of
    the tool: where the error does, nothing is added, and the answer says what to look at.

    \b
    Examples:
        kincal model add --model M.toml joint_compliance[2]
        kincal model add --model M.toml "joint_ripple[2](k=4)"
        kincal model add --model M.toml --arm arm.toml --data poses.csv "unnamed[joint 1: q1, q3]"
        kincal model add --model M.toml --arm arm.toml --data poses.csv unnamed
    """
    from kincal.api.models import change_by_adding
    from kincal.cli.terminal import progress
    from kincal.cli.text import model as text

    read = given.checked if given else None
    with progress() as tick:
        added = change_by_adding(model_path, names, effect_files, arm_path, read, tick)
    for line in text.additions(added.found):
        click.echo(line)
    click.echo(f"{model_path}: {text.names(added.model)}")


@click.command("remove")
@MODEL_NEEDED
@click.argument("names", metavar="EFFECT...", nargs=-1, required=True)
def remove_command(model_path: Path, names: tuple[str, ...]) -> None:
    """Remove effects from the model; the change is recorded in its history.

    \b
    Example:
        kincal model remove --model M.toml joint_compliance[2]
    """
    from kincal.cli.text import model as text
    from kincal.workbench.model.modelfile import change_model

    after = change_model(model_path, lambda model: model.remove(list(names)))
    click.echo(f"{model_path}: {text.names(after)}")


@click.command("undo")
@MODEL_NEEDED
def undo_command(model_path: Path) -> None:
    """Undo the last add or remove, and restore the fitted values that it discarded.

    \b
    Example:
        kincal model undo --model M.toml
    """
    from kincal.cli.text import model as text
    from kincal.workbench.model.modelfile import ModelFile, change_model

    after = change_model(model_path, ModelFile.undo)
    click.echo(f"{model_path}: {text.names(after)}" + (", fitted as before" if after.fit else ""))


@click.command("list")
@MODEL_NEEDED
@JSON
def list_command(model_path: Path, as_json: bool) -> None:
    """Show the effects in use and their fitted values.

    \b
    Example:
        kincal model list --model M.toml
    """
    from kincal.cli.text import model as text
    from kincal.workbench.model.modelfile import read_model

    chosen = read_model(model_path)
    click.echo(json.dumps(text.contents_json(chosen), indent=1) if as_json else text.contents(chosen))


@click.command("history")
@MODEL_NEEDED
def history_command(model_path: Path) -> None:
    """Show every change of the model, oldest first.

    \b
    Example:
        kincal model history --model M.toml
    """
    from kincal.workbench.model.modelfile import read_model

    for change in read_model(model_path).history:
        click.echo(f"{change.when}  {change.action:<7} {', '.join(change.effects)}")


@click.command("uplink")
@MODEL_NEEDED
@EFFECTS
@click.option(
    "--arm",
    "arm_path",
    type=click.Path(path_type=Path),
    default=None,
    help="Arm table.  [default: as the model says]",
)
@data_options(
    required=False,
    about="Measurements, for effects whose constants follow from them (time of a step).  "
    "[default: as the last `kincal model fit` found them]",
)
@click.option(
    "--out",
    "-o",
    "out_path",
    type=FILE_OUT,
    default=None,
    help="Image to write.  [default: MODEL with .tbl]",
)
@click.option(
    "--fly",
    "fly_dir",
    type=FOLDER_OUT,
    default=None,
    help="Also make this directory: all images of --tables, with these terms and no correction yet.",
)
@click.option(
    "--drop",
    "drop",
    multiple=True,
    metavar="EFFECT",
    help="Leave an effect out of the image, at all joints or at some ([2,3]); may be repeated.",
)
@tables_option("Directory with flight's table images: the arm must be theirs; --fly copies them.")
def uplink_command(
    model_path: Path,
    effect_files: tuple[Path, ...],
    arm_path: Path | None,
    given: Given | None,
    out_path: Path | None,
    fly_dir: Path | None,
    drop: tuple[str, ...],
    tables_dir: Path,
) -> None:
    """Write the model as a correction-term table image for flight (send it with `kincal table uplink`).

    Flight then estimates these coefficients together with the DH errors. It has room for 64 coefficients; for
    a larger model the command says which effects to --drop, and with --data what that costs on held-out
    poses.
    Bounds stay within what the search space of --tables was verified for (docs/SPACES.md).

    \b
    Examples:
        kincal model uplink --model M.toml -o terms.tbl
        kincal model uplink --model M.toml --fly out/tables
        kincal model uplink --model M.toml --drop 'joint_ripple[5,6]' --data poses.csv
    """
    from kincal.api.models import for_flight
    from kincal.cli.text import model as text
    from kincal.workbench.model.uplink import flight_tables
    from kincal_shared.writing import keep_inputs, write_file

    read = given.checked if given else None
    out = out_path or model_path.with_suffix(".tbl")
    measured = given.paths if given else ()
    keep_inputs([out], [model_path, *effect_files, *measured, *([arm_path] if arm_path else [])])
    made = for_flight(model_path, tables_dir, effect_files, arm_path, read, drop)
    image = made.image
    write_file(out, image.data)
    click.echo(f"{out}: correction terms, {len(image.data)} bytes, CRC {image.crc_text}; {made.compared}")
    click.echo(f"bounds within what {tables_dir / 'space.tbl'} was verified for, plus a tenth")
    if made.left_out:
        click.echo(f"left out: {', '.join(h.name for h in made.left_out)}")
    if (cost := made.cost()) is not None:
        click.echo(text.cost(cost))
    if fly_dir:
        flight_tables(tables_dir, fly_dir, image)
        click.echo(f"{fly_dir}: tables to fly with")


@click.command("predict")
@click.option(
    "--arm",
    "arm_path",
    type=PATH,
    default=None,
    help="Arm table that the model was fitted with.  [default: as the model says]",
)
@data_options()
@MODEL_NEEDED
@EFFECTS
@JSON
def predict_command(
    arm_path: Path | None, given: Given, model_path: Path, effect_files: tuple[Path, ...], as_json: bool
) -> None:
    """How well does the fitted model predict other measurements? Nothing is fitted to them.

    The values are those that `kincal model fit` wrote into the model file, including base and tool frame: the
    measurements must be in the same base frame. The error is shown beside that of the nominal arm in these
    frames, and beside the error on held-out poses when the model was fitted. (`compare` and `fit` refit.)

    \b
    Example:
        kincal model predict --model M.toml --data new.csv
    """
    from kincal.api.models import arm_of, load_model
    from kincal.api.predicted import predict
    from kincal.cli.text import model as text
    from kincal.export import calibrated_arm
    from kincal_shared.schema.arm import read_arm

    chosen, library = load_model(model_path, effect_files)
    arm = read_arm(arm_of(chosen, model_path, arm_path))
    calibrated = calibrated_arm(arm, chosen, library, name=str(model_path))
    found = predict(calibrated, given.checked(arm), library, tuple(given.paths))
    click.echo(json.dumps(text.predicted_json(found), indent=1) if as_json else text.predicted(found))


@click.command("export")
@click.option(
    "--arm",
    "arm_path",
    type=PATH,
    default=None,
    help="Arm table that the model was fitted with.  [default: as the model says]",
)
@MODEL_NEEDED
@EFFECTS
@click.option(
    "--format",
    "form",
    type=click.Choice(["dh", "json", "urdf", "python", "c"]),
    required=True,
    help="dh: corrected DH table (TOML and CSV); json: everything; urdf; python, c: source code.",
)
@click.option("--out", "-o", "out_path", type=FILE_OUT, required=True, help="File to write.")
def export_command(
    arm_path: Path | None, model_path: Path, effect_files: tuple[Path, ...], form: Format, out_path: Path
) -> None:
    """Export the fitted model as DH table, JSON, URDF, Python or C source.

    dh and urdf contain only the constant part of the model; effects that they cannot represent are named.
    python and c contain all effects, and also compute the joint readings for a wanted pose.

    \b
    Examples:
        kincal model export --model M.toml --format dh -o calibrated.toml
        kincal model export --model M.toml --format c -o calibrated.c
    """
    from kincal.api.models import arm_of, load_model
    from kincal.cli.text import model as text
    from kincal.export import calibrated_arm, export
    from kincal_shared.schema.arm import read_arm

    chosen, library = load_model(model_path, effect_files)
    arm = read_arm(arm_of(chosen, model_path, arm_path))
    calibrated = calibrated_arm(arm, chosen, library, name=str(model_path))
    measured = [Path(data.path) for data in chosen.fit.data] if chosen.fit else []  # as fit was given them
    beside = [model_path.parent / path for path in measured]
    made = export(calibrated, form, out_path, keep=(model_path, Path(arm.source), *measured, *beside))
    click.echo(text.exported(made))
    if calibrated.of_session:
        click.echo(text.of_session(calibrated.of_session, form), err=True)
    if made.left_out:
        click.echo(text.left_out(made, form, chosen.fit, calibrated.of_session), err=True)
