"""`kincal model`: compare a model with measurements, find the missing effect, add it, fly it."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING

import click

from kincal import __version__
from kincal.cli.data import Given, data_options
from kincal.cli.errors import EXIT_FAILED
from kincal.cli.options import PATH, tables_option
from kincal.cli.outputs import FILE_OUT, FOLDER_OUT, REPORT
from kincal.cli.provenance import say_files, today
from kincal.cli.terminal import progress
from kincal.errors import BadInput

if TYPE_CHECKING:
    from collections.abc import Sequence

    from kincal.export.files import Format
    from kincal.schema.arm import ArmTable
    from kincal.workbench.additions import Addition
    from kincal.workbench.data import Measurements
    from kincal.workbench.effects import Library
    from kincal.workbench.measurable import Box
    from kincal.workbench.modelfile import ModelFile

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


def _load(arm_path: Path, given: Given) -> tuple[ArmTable, Measurements]:
    """Arm and measurements."""
    from kincal.schema.arm import read_arm

    arm = read_arm(arm_path)
    return arm, given.checked(arm)


def _model(
    model_path: Path | None, effect_files: tuple[Path, ...], arm: ArmTable | None = None
) -> tuple[ModelFile, Library]:
    """Model file and the library with its own and the named effect files. BadInput if the model is of another
    arm than `arm`."""
    from kincal.workbench.belonging import refuse_model_of_other_arm
    from kincal.workbench.effects import Library
    from kincal.workbench.modelfile import ModelFile, read_model

    model = read_model(model_path) if model_path else ModelFile()
    if arm is not None:
        refuse_model_of_other_arm(model, arm, str(model_path))
    base = model_path.parent if model_path else Path()
    files = list(dict.fromkeys([*(base / name for name in model.libraries), *effect_files]))
    return model, Library.load(*files).with_unnamed(model.unnamed.values())


@click.group()
def model() -> None:
    """Compare a model with measurements, see where it fails, learn which effect is missing, add it.

    \b
    Example:
        kincal model diagnose --arm arm.toml --data poses.csv
    """


@model.command("check")
@ARM
@DATA
@JSON
def check_command(arm_path: Path, given: Given, as_json: bool) -> None:
    """Do the arm table and the measurements belong together?

    Exit status 0 if they do, 1 if something has to be put right first.

    \b
    Example:
        kincal model check --arm arm.toml --data poses.csv
    """
    from kincal.cli.text import check as text
    from kincal.schema.arm import read_arm
    from kincal.workbench.belonging import check

    arm = read_arm(arm_path)
    answer = check(arm, given.read(arm))
    click.echo(json.dumps(text.as_json(answer), indent=1) if as_json else text.lines(answer))
    if not answer.ok:
        click.get_current_context().exit(EXIT_FAILED)


@model.command("compare")
@ARM
@DATA
@MODEL
@EFFECTS
@JSON
def compare_command(
    arm_path: Path,
    given: Given,
    model_path: Path | None,
    effect_files: tuple[Path, ...],
    as_json: bool,
) -> None:
    """Does the model explain the data, and if not, where does it fail?

    \b
    Example:
        kincal model compare --arm arm.toml --data poses.csv --json
    """
    from kincal.workbench.answers import comparison_json, comparison_text
    from kincal.workbench.compare import compare
    from kincal.workbench.constants import choose_constants

    arm, data = _load(arm_path, given)
    chosen, library = _model(model_path, effect_files, arm)
    effects = choose_constants(library, chosen.effects, arm, data, dh=chosen.dh)
    answer = compare(arm, data, effects, dh=chosen.dh)
    click.echo(json.dumps(comparison_json(answer), indent=1) if as_json else comparison_text(answer))


@model.command("diagnose")
@ARM
@DATA
@MODEL
@EFFECTS
@JSON
@click.option(
    "--report",
    "report_path",
    type=REPORT,
    default=None,
    help="Write a self-contained page (HTML) and its figures (PNG).",
)
def diagnose_command(
    arm_path: Path,
    given: Given,
    model_path: Path | None,
    effect_files: tuple[Path, ...],
    as_json: bool,
    report_path: Path | None,
) -> None:
    """Which physical effect is missing? Probabilities for every effect and joint, and for none of them.

    \b
    Example:
        kincal model diagnose --arm arm.toml --data poses.csv --report out/report.html
    """
    from kincal.workbench.advice import Inputs, next_steps
    from kincal.workbench.answers import diagnosis_json
    from kincal.workbench.api import advise, report_content
    from kincal.workbench.constants import choose_constants
    from kincal.workbench.diagnosis import diagnose
    from kincal.workbench.diagnosis_text import diagnosis_text

    arm, data = _load(arm_path, given)
    chosen, library = _model(model_path, effect_files, arm)
    effects = choose_constants(library, chosen.effects, arm, data, dh=chosen.dh)
    with progress() as tick:
        answer = diagnose(arm, data, library, effects, dh=chosen.dh, progress=tick)
        poses = advise(answer, library)
        shown = report_content(answer, library, effects, poses, progress=tick) if report_path else None
    steps = next_steps(answer, poses, Inputs(str(arm_path), given.options(), str(model_path or "")))
    as_text = json.dumps(diagnosis_json(answer, poses), indent=1) if as_json else ""
    click.echo(as_text or diagnosis_text(answer, poses, steps))
    if shown is not None and report_path is not None:
        from kincal.pages import diagnosis as pages
        from kincal.pages.page import Provenance

        files, why = pages.write_all(shown, report_path, Provenance.of_file(today(), given.paths), steps)
        say_files("report", files, why, err=as_json)


@model.command("fit")
@ARM
@DATA
@click.option(
    "--model",
    "model_path",
    type=FILE_OUT,
    default=None,
    help="Model file to fit and write; absent: DH errors only.",
)
@EFFECTS
@JSON
def fit_command(
    arm_path: Path,
    given: Given,
    model_path: Path | None,
    effect_files: tuple[Path, ...],
    as_json: bool,
) -> None:
    """Fit the model and show how the held-out error falls from model to model, down to the noise floor.

    The values are written into the model file. Without one this is plain DH calibration, and nothing is
    written.

    \b
    Examples:
        kincal model fit --arm arm.toml --data poses.csv
        kincal model fit --arm arm.toml --data poses.csv --model M.toml
    """
    from kincal.workbench.answers import fit_json, fit_text
    from kincal.workbench.api import fit
    from kincal.workbench.fitrecord import fitted
    from kincal.workbench.modelfile import write_model

    arm, data = _load(arm_path, given)
    chosen, library = _model(model_path, effect_files, arm)
    with progress() as tick:
        result = fit(arm, data, chosen.effects, library=library, dh=chosen.dh, progress=tick)
    if model_path is not None:
        where = str(arm_path.resolve()) if arm_path.exists() else str(arm_path)
        write_model(model_path, fitted(chosen, result, arm=where, files=given.paths, version=__version__))
    click.echo(json.dumps(fit_json(result), indent=1) if as_json else fit_text(result))


@model.command("effects")
@EFFECTS
@JSON
def effects_command(effect_files: tuple[Path, ...], as_json: bool) -> None:
    """List the effect library: formula, units, typical size, what each needs and is confounded with.

    \b
    Example:
        kincal model effects --effects my.toml
    """
    from kincal.cli.text import model as text
    from kincal.workbench.effects import Library

    library = Library.load(*effect_files)
    if as_json:
        click.echo(json.dumps(text.effects_json(library), indent=1))
    else:
        click.echo(text.effects(library))


def _check_names(library: Library, names: Sequence[str]) -> None:
    """Every name is an effect of the library; the joint is checked against the arm when it is fitted."""
    for name in names:
        base, _, joint = name.partition("[")
        if base not in library.effects:
            near = [n for n in library.effects if n.startswith(base[:4])] or list(library.effects)
            raise BadInput(f"no effect {base!r}; did you mean {', '.join(near[:6])}? (kincal model effects)")
        inside = joint.rstrip("]")
        if joint and not (
            joint.endswith("]") and all(x.strip().isdigit() and int(x) > 0 for x in inside.split(","))
        ):
            raise BadInput(f"{name!r}: write {base}[2] for one joint, or {base} for all")
        if joint and library.effects[base].per == "arm":
            raise BadInput(f"{base} concerns the whole arm; leave [{inside}] out")


@model.command("add")
@MODEL_WRITTEN
@EFFECTS
@click.option(
    "--arm",
    "arm_path",
    type=click.Path(path_type=Path),
    default=None,
    help="Arm table, for an unnamed effect.  [default: the one the model was fitted with]",
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

    An unnamed effect, as `diagnose` names it, becomes a smooth function there: ordinary terms, chosen from
    the data that --arm and --data give, with what held-out poses gain from them.

    \b
    Examples:
        kincal model add --model M.toml joint_compliance[2]
        kincal model add --model M.toml --arm arm.toml --data poses.csv "unnamed[joint 1: q1, q3]"
    """
    from dataclasses import replace

    from kincal.cli.text import model as text
    from kincal.schema.names import is_unnamed
    from kincal.workbench.effects import Library
    from kincal.workbench.modelfile import read_model, write_model
    from kincal.workbench.smooth import UnnamedName

    before = read_model(model_path, must_exist=False)
    files = [model_path.parent / name for name in before.libraries] + list(effect_files)
    library = Library.load(*files)
    _check_names(library, [name for name in names if not is_unnamed(name)])
    wanted = [str(UnnamedName.parse(name)) if is_unnamed(name) else name for name in names]
    after = before.add(wanted)
    for k, name in enumerate(wanted):
        if is_unnamed(name):
            addition = _found_in_data(after, library, arm_path, given, name, (*before.effects, *wanted[:k]))
            after = after.with_terms(addition.effect.entry())
            click.echo(text.addition(addition))
    new = [str(f.resolve()) for f in effect_files if str(f.resolve()) not in before.libraries]
    write_model(model_path, replace(after, libraries=(*before.libraries, *new)))
    click.echo(f"{model_path}: {text.names(after)}")


def _found_in_data(
    chosen: ModelFile,
    library: Library,
    arm_path: Path | None,
    given: Given | None,
    name: str,
    beside: tuple[str, ...],
) -> Addition:
    """Terms of an unnamed effect beside other effects of a model, and what they bring."""
    from kincal.schema.arm import read_arm
    from kincal.workbench.api import unnamed_effect
    from kincal.workbench.smooth import UnnamedName

    where = arm_path or (Path(chosen.arm) if chosen.arm else None)
    if where is None or given is None:
        raise BadInput(f"{name}: its terms are chosen from measurements", todo="give --arm and --data")
    arm = read_arm(where)
    known = library.with_unnamed(chosen.unnamed.values())
    wanted = UnnamedName.parse(name)
    return unnamed_effect(arm, given.read(arm), wanted, beside, library=known, dh=chosen.dh)


@model.command("remove")
@MODEL_NEEDED
@click.argument("names", metavar="EFFECT...", nargs=-1, required=True)
def remove_command(model_path: Path, names: tuple[str, ...]) -> None:
    """Take effects out of the model; the change goes into its history.

    \b
    Example:
        kincal model remove --model M.toml joint_compliance[2]
    """
    from kincal.cli.text import model as text
    from kincal.workbench.modelfile import read_model, write_model

    after = read_model(model_path).remove(list(names))
    write_model(model_path, after)
    click.echo(f"{model_path}: {text.names(after)}")


@model.command("undo")
@MODEL_NEEDED
def undo_command(model_path: Path) -> None:
    """Take back the last add or remove.

    \b
    Example:
        kincal model undo --model M.toml
    """
    from kincal.cli.text import model as text
    from kincal.workbench.modelfile import read_model, write_model

    after = read_model(model_path).undo()
    write_model(model_path, after)
    click.echo(f"{model_path}: {text.names(after)}")


@model.command("list")
@MODEL_NEEDED
@JSON
def list_command(model_path: Path, as_json: bool) -> None:
    """Show the effects in use and their fitted values.

    \b
    Example:
        kincal model list --model M.toml
    """
    from kincal.cli.text import model as text
    from kincal.workbench.modelfile import read_model

    chosen = read_model(model_path)
    click.echo(json.dumps(text.contents_json(chosen), indent=1) if as_json else text.contents(chosen))


@model.command("history")
@MODEL_NEEDED
def history_command(model_path: Path) -> None:
    """Show every change of the model, oldest first.

    \b
    Example:
        kincal model history --model M.toml
    """
    from kincal.workbench.modelfile import read_model

    for change in read_model(model_path).history:
        click.echo(f"{change.when}  {change.action:<7} {', '.join(change.effects)}")


@model.command("next")
@ARM
@DATA
@MODEL
@EFFECTS
@JSON
@click.option("--count", type=click.IntRange(1, 64), default=8, show_default=True, help="Poses wanted.")
@click.option(
    "--inside",
    multiple=True,
    metavar="X0,Y0,Z0,X1,Y1,Z1",
    help="Box for the tool point [m]; may be repeated.  [default: where poses were measured]",
)
@click.option(
    "--outside",
    multiple=True,
    metavar="X0,Y0,Z0,X1,Y1,Z1",
    help="Box that no part of the arm may enter [m]; may be repeated.",
)
@click.option(
    "--out",
    "-o",
    "out_path",
    type=click.Path(path_type=Path, dir_okay=False),
    default=None,
    help="Write the poses as CSV: joints, approach direction, tool position.",
)
@click.argument("names", metavar="EFFECT EFFECT...", nargs=-1, required=True)
def next_command(
    arm_path: Path,
    given: Given,
    model_path: Path | None,
    effect_files: tuple[Path, ...],
    as_json: bool,
    count: int,
    inside: tuple[str, ...],
    outside: tuple[str, ...],
    out_path: Path | None,
    names: tuple[str, ...],
) -> None:
    """The poses that separate two or more alternative effects best.

    They lie where poses were measured: tool positions, joint ranges, directions of the tool, view of the
    camera.

    \b
    Examples:
        kincal model next --arm arm.toml --data poses.csv joint_compliance[2] base_flex
        kincal model next --arm arm.toml --data poses.csv -o next.csv backlash[1] encoder_gain[1]
    """
    from kincal.workbench.answers import poses_json, poses_text
    from kincal.workbench.constants import choose_constants
    from kincal.workbench.fit import fit_model
    from kincal.workbench.measurable import Limits
    from kincal.workbench.nextposes import next_poses, poses_csv

    limits = Limits(_boxes("--inside", inside), _boxes("--outside", outside))
    if twice := sorted({name for name in names if names.count(name) > 1}):
        raise BadInput(f"{twice[0]} is given twice", todo="name two or more different effects")

    arm, data = _load(arm_path, given)
    chosen, library = _model(model_path, effect_files, arm)
    if len(names) < 2:
        raise BadInput("name two or more alternative effects, for instance joint_compliance[2] base_flex")
    alternatives = [
        choose_constants(library, [name], arm, data, dh=chosen.dh, joined=True)[0] for name in names
    ]
    effects = choose_constants(library, chosen.effects, arm, data, dh=chosen.dh)
    fit = fit_model(arm, data, effects, dh=chosen.dh)
    poses = next_poses(fit, alternatives, count=count, limits=limits)
    if out_path is not None:
        out_path.write_text(poses_csv(poses), encoding="utf-8")
        click.echo(f"{out_path}: {len(poses)} poses", err=as_json)
    click.echo(json.dumps({"next_poses": poses_json(poses)}, indent=1) if as_json else poses_text(poses))


def _boxes(option: str, texts: Sequence[str]) -> tuple[Box, ...]:
    """Boxes of an option. BadInput names what is not six numbers."""
    from kincal.workbench.measurable import BOX_TEXT, Box

    def numbers(text: str) -> list[float]:
        try:
            return [float(x) for x in text.split(",")]
        except ValueError:
            raise BadInput(f"{option} {text}: not numbers", todo=BOX_TEXT) from None

    return tuple(Box.of(numbers(text)) for text in texts)


@model.command("uplink")
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
@tables_option("Directory with flight's table images: the arm has to be theirs, and --fly copies them.")
def uplink_command(
    model_path: Path,
    effect_files: tuple[Path, ...],
    arm_path: Path | None,
    given: Given | None,
    out_path: Path | None,
    fly_dir: Path | None,
    tables_dir: Path,
) -> None:
    """The model as a correction-term table image for flight (uplink it with `kincal table uplink`).

    Flight then estimates these coefficients together with the DH errors.

    \b
    Examples:
        kincal model uplink --model M.toml -o terms.tbl
        kincal model uplink --model M.toml --fly out/tables
    """
    from kincal.schema.arm import read_arm
    from kincal.workbench.belonging import refuse_model_of_other_arm
    from kincal.workbench.constants import choose_constants
    from kincal.workbench.uplink import flight_tables, refuse_other_arm, term_image

    chosen, library = _model(model_path, effect_files)
    arm = read_arm(_arm_of(chosen, model_path, arm_path))
    refuse_model_of_other_arm(chosen, arm, str(model_path))
    refuse_other_arm(arm, tables_dir)
    data = given.read(arm) if given else None
    known = {} if data is not None else chosen.constants
    image = term_image(arm, choose_constants(library, chosen.effects, arm, data, dh=chosen.dh, known=known))
    out = out_path or model_path.with_suffix(".tbl")
    out.parent.mkdir(parents=True, exist_ok=True)
    out.write_bytes(image.data)
    click.echo(f"{out}: correction terms, {len(image.data)} bytes, CRC {image.crc_text}")
    if fly_dir:
        flight_tables(tables_dir, fly_dir, image)
        click.echo(f"{fly_dir}: tables to fly with")


@model.command("export")
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

    chosen, library = _model(model_path, effect_files)
    arm = read_arm(_arm_of(chosen, model_path, arm_path))
    made = export(
        calibrated_arm(arm, chosen, library, name=str(model_path)),
        form,
        out_path,
        keep=(model_path, Path(arm.source)),
    )
    click.echo(text.exported(made))
    if made.left_out:
        click.echo(text.left_out(made, form), err=True)


def _arm_of(chosen: ModelFile, model_path: Path, arm_path: Path | None) -> Path:
    """The arm table that was named, else the one that the model was fitted with."""
    if arm_path is None and not chosen.arm:
        raise BadInput(
            f"{model_path} does not say which arm it is for; run `kincal model fit` first or give --arm"
        )
    return arm_path or Path(chosen.arm)
