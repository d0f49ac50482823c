"""`kincal model effects`, `add`, `remove`, `undo`, `list`, `history`, `uplink`, `export`: the model file."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING

import click

from kincal.cli.data import Given, data_options
from kincal.cli.options import PATH, tables_option
from kincal.cli.outputs import FILE_OUT, FOLDER_OUT
from kincal.errors import BadInput

from .given import EFFECTS, JSON, MODEL_NEEDED, MODEL_WRITTEN, arm_of, load_model

if TYPE_CHECKING:
    from collections.abc import Sequence

    from kincal.export.files import Format
    from kincal.workbench.diagnosis.unnamed_effects import Found
    from kincal.workbench.model.effects import Library
    from kincal.workbench.model.modelfile import ModelFile


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


def _check_names(library: Library, names: Sequence[str]) -> None:
    """Every name is an effect of the library, with its constants; joints of an arm that is known are checked
    later."""
    from kincal.schema.arm import MAX_JOINTS
    from kincal.schema.names import split_constants

    for text in names:
        name, constants = split_constants(text)
        base, _, joint = name.partition("[")
        if base not in library.effects:
            near = [n for n in library.effects if n.startswith(base[:4])] or list(library.effects)
            raise BadInput(f"no effect {base!r}; did you mean {', '.join(near[:6])}? (kincal model effects)")
        inside = joint.rstrip("]")
        if joint and not (
            joint.endswith("]") and all(x.strip().isdigit() and int(x) > 0 for x in inside.split(","))
        ):
            raise BadInput(f"{name!r}: write {base}[2] for one joint, or {base} for all")
        if any(int(x) > MAX_JOINTS for x in inside.split(",") if joint):
            raise BadInput(f"{name!r}: an arm has up to {MAX_JOINTS} joints")
        if joint and library.effects[base].per == "arm":
            raise BadInput(f"{base} concerns the whole arm; leave [{inside}] out")
        library.check_constants(base, constants)


@click.command("add")
@MODEL_WRITTEN
@EFFECTS
@click.option(
    "--arm",
    "arm_path",
    type=click.Path(path_type=Path),
    default=None,
    help="Arm table, for an unnamed effect and to check joints.  [default: that of the last fit]",
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
    """Add effects to the model (a new model file if there is none); the change goes into its history.

    Constants behind the name are kept by every fit; without them the data choose.

    An unnamed effect, as `diagnose` names it, becomes a smooth function there: ordinary terms, chosen from
    the data that --arm and --data give, with what held-out poses gain from them. `unnamed` alone adds as many
    as predict better, the one that the data ask for most first.

    \b
    Examples:
        kincal model add --model M.toml joint_compliance[2]
        kincal model add --model M.toml "joint_ripple[2](k=4)"
        kincal model add --model M.toml --arm arm.toml --data poses.csv "unnamed[joint 1: q1, q3]"
        kincal model add --model M.toml --arm arm.toml --data poses.csv unnamed
    """
    from dataclasses import replace

    from kincal.cli.text import model as text
    from kincal.schema.arm import read_arm
    from kincal.schema.names import UNNAMED, is_unnamed
    from kincal.workbench.model.effects import Library
    from kincal.workbench.model.modelfile import read_model, write_model
    from kincal.workbench.model.unnamed_names import UnnamedName

    before = read_model(model_path, must_exist=False)
    files = [model_path.parent / name for name in before.libraries] + list(effect_files)
    library = Library.load(*files)
    wanted = [str(UnnamedName.parse(name)) if is_unnamed(name) else name for name in names]
    before.add([name for name in wanted if name != UNNAMED])  # said before the work is done
    _check_names(library, [name for name in wanted if name != UNNAMED and not is_unnamed(name)])
    if where := arm_path or (Path(before.arm) if before.arm else None):
        from kincal.schema.names import split_constants

        arm = read_arm(where)
        for name in wanted:
            library.check_joints(split_constants(name)[0], arm)
    found = _found_in_data(before, library, arm_path, given, wanted)
    for line in text.additions(found):
        click.echo(line)
    after = before.add(list(found.names)) if found.names else before
    for addition in found.additions:
        after = after.with_terms(addition.effect.entry())
    new = [str(f.resolve()) for f in effect_files if str(f.resolve()) not in before.libraries]
    write_model(model_path, replace(after, libraries=(*before.libraries, *new)))
    click.echo(f"{model_path}: {text.names(after)}")


def _found_in_data(
    chosen: ModelFile,
    library: Library,
    arm_path: Path | None,
    given: Given | None,
    names: Sequence[str],
) -> Found:
    """Effects to add to a model, the unnamed ones among them with terms from the measurements."""
    from kincal.cli.terminal import progress
    from kincal.schema.arm import read_arm
    from kincal.schema.names import UNNAMED, is_unnamed
    from kincal.workbench.diagnosis.unnamed_effects import Found, find_unnamed

    unnamed = next((name for name in names if name == UNNAMED or is_unnamed(name)), None)
    if unnamed is None:
        return Found(tuple(names))
    where = arm_path or (Path(chosen.arm) if chosen.arm else None)
    if where is None or given is None:
        raise BadInput(f"{unnamed}: its terms are chosen from measurements", todo="give --arm and --data")
    arm = read_arm(where)
    known = library.with_unnamed(chosen.unnamed.values())
    with progress() as tick:
        return find_unnamed(
            arm, given.read(arm), names, chosen.texts, library=known, dh=chosen.dh, progress=tick
        )


@click.command("remove")
@MODEL_NEEDED
@click.argument("names", metavar="EFFECT...", nargs=-1, required=True)
def remove_command(model_path: Path, names: tuple[str, ...]) -> None:
    """Take effects out of the model; the change goes into its history.

    \b
    Example:
        kincal model remove --model M.toml joint_compliance[2]
    """
    from kincal.cli.text import model as text
    from kincal.workbench.model.modelfile import read_model, write_model

    after = read_model(model_path).remove(list(names))
    write_model(model_path, after)
    click.echo(f"{model_path}: {text.names(after)}")


@click.command("undo")
@MODEL_NEEDED
def undo_command(model_path: Path) -> None:
    """Take back the last add or remove.

    \b
    Example:
        kincal model undo --model M.toml
    """
    from kincal.cli.text import model as text
    from kincal.workbench.model.modelfile import read_model, write_model

    after = read_model(model_path).undo()
    write_model(model_path, after)
    click.echo(f"{model_path}: {text.names(after)}")


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
    help="Arm table; absent: the one the model was fitted with.",
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
    help="Leave an effect out of the image, at all joints or at some ([2,3]); may be given several times.",
)
@tables_option("Directory with flight's table images: the arm has to be theirs, and --fly copies them.")
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
    """The model as a correction-term table image for flight (uplink it with `kincal table uplink`).

    Flight then estimates these coefficients together with the DH errors. It carries 64 coefficients; of a
    larger model this says which effects to --drop, and with --data what that costs on held-out poses.
    Bounds are inside what the search space of --tables was verified for (docs/SPACES.md).

    \b
    Examples:
        kincal model uplink --model M.toml -o terms.tbl
        kincal model uplink --model M.toml --fly out/tables
        kincal model uplink --model M.toml --drop 'joint_ripple[5,6]' --data poses.csv
    """
    from kincal.cli.text import model as text
    from kincal.flight.bounds import Flown
    from kincal.schema.arm import read_arm
    from kincal.workbench.consistency import refuse_model_of_other_arm
    from kincal.workbench.evidence.constants import choose_constants
    from kincal.workbench.model.uplink import dropped, flight_tables, refuse_other_arm, term_image
    from kincal.workbench.prediction.nested import cost_without

    chosen, library = load_model(model_path, effect_files)
    arm = read_arm(arm_of(chosen, model_path, arm_path))
    refuse_model_of_other_arm(chosen, arm, str(model_path))
    compared = refuse_other_arm(arm, tables_dir)
    data = given.read(arm) if given else None
    known = {} if data is not None else chosen.constants
    effects = choose_constants(library, chosen.texts, arm, data, dh=chosen.dh, known=known)
    left_out = dropped(effects, drop)
    image = term_image(arm, [h for h in effects if h not in left_out], Flown.read(tables_dir), chosen)
    out = out_path or model_path.with_suffix(".tbl")
    out.parent.mkdir(parents=True, exist_ok=True)
    out.write_bytes(image.data)
    click.echo(f"{out}: correction terms, {len(image.data)} bytes, CRC {image.crc_text}; {compared}")
    click.echo(f"bounds inside what {tables_dir / 'space.tbl'} was verified for, and a tenth")
    if left_out:
        click.echo(f"left out: {', '.join(h.name for h in left_out)}")
    if left_out and data is not None:
        click.echo(text.cost(cost_without(arm, data, effects, left_out, dh=chosen.dh)))
    if fly_dir:
        flight_tables(tables_dir, fly_dir, image)
        click.echo(f"{fly_dir}: tables to fly with")


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
    """The fitted model to take away: DH table, JSON, URDF, Python or C source.

    dh and urdf hold what is constant in the model; effects that they cannot hold are named. python and c
    hold all effects, and give the joint readings for a wanted pose.

    \b
    Examples:
        kincal model export --model M.toml --format dh -o calibrated.toml
        kincal model export --model M.toml --format c -o calibrated.c
    """
    from kincal.cli.text import model as text
    from kincal.export import calibrated_arm, export
    from kincal.schema.arm import read_arm

    chosen, library = load_model(model_path, effect_files)
    arm = read_arm(arm_of(chosen, model_path, arm_path))
    made = export(
        calibrated_arm(arm, chosen, library, name=str(model_path)),
        form,
        out_path,
        keep=(model_path, Path(arm.source)),
    )
    click.echo(text.exported(made))
    if made.left_out:
        click.echo(text.left_out(made, form), err=True)
