"""`kincal model check`, `compare`, `diagnose`, `fit`, `next`: what measurements say."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING

import click

from kincal import __version__
from kincal.cli.data import Given
from kincal.cli.errors import EXIT_FAILED
from kincal.cli.options import FILE, tables_option
from kincal.cli.outputs import FILE_OUT, REPORT
from kincal.cli.provenance import say_files, today
from kincal.cli.terminal import progress
from kincal_shared.errors import BadInput

from .given import ARM, DATA, EFFECTS, JSON, MODEL, case_of, load

if TYPE_CHECKING:
    from collections.abc import Sequence

    from kincal.workbench.prediction.measurable import Box


@click.command("check")
@ARM
@DATA
@JSON
def check_command(arm_path: Path, given: Given, as_json: bool) -> None:
    """Do the arm table and the measurements belong together?

    Exit status 0 if they do, 1 if something has to be corrected first.

    \b
    Example:
        kincal model check --arm arm.toml --data poses.csv
    """
    from kincal.cli.text import check as text
    from kincal.workbench.consistency import check
    from kincal_shared.schema.arm import read_arm

    arm = read_arm(arm_path)
    answer = check(arm, given.read(arm))
    click.echo(json.dumps(text.as_json(answer), indent=1) if as_json else text.lines(answer))
    if not answer.ok:
        click.get_current_context().exit(EXIT_FAILED)


@click.command("compare")
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
    from kincal.workbench.numerics.background import second_process
    from kincal.workbench.report.answers import comparison_json, comparison_text

    case = case_of(arm_path, given, model_path, effect_files)
    with second_process() as begin:
        answer = case.compare(begin)
        said = json.dumps(comparison_json(answer), indent=1) if as_json else comparison_text(answer)
    click.echo(said)


@click.command("diagnose")
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
    """Which physical effect is missing? A probability for every effect and joint, and for nothing missing.

    \b
    Example:
        kincal model diagnose --arm arm.toml --data poses.csv --report out/report.html
    """
    from kincal.workbench.numerics.background import second_process
    from kincal.workbench.report.advice import Inputs, free_name, next_steps
    from kincal.workbench.report.answers import diagnosis_json
    from kincal.workbench.report.diagnosis_text import diagnosis_text

    case = case_of(arm_path, given, model_path, effect_files)
    with second_process() as begin:
        with progress() as tick:
            answer = case.diagnose(tick, begin)
            poses = case.advise(answer)
            shown = case.report(answer, poses, tick) if report_path else None
        inputs = Inputs(
            str(arm_path),
            given.options(),
            str(model_path or ""),
            tuple(map(str, effect_files)),
            free_name(lambda name: Path(name).exists()),
        )
        steps = next_steps(answer, poses, inputs)
        as_text = json.dumps(diagnosis_json(answer, poses, steps), indent=1) if as_json else ""
        said = as_text or diagnosis_text(answer, poses, steps)
    click.echo(said)
    if shown is not None and report_path is not None:
        from kincal.pages import diagnosis as pages
        from kincal.pages.page import Provenance

        files, why = pages.write_all(shown, report_path, Provenance.of_file(today(), given.paths), steps)
        say_files("report", files, why, err=as_json)


@click.command("fit")
@ARM
@DATA
@click.option(
    "--model",
    "model_path",
    type=FILE_OUT,
    default=None,
    help="Model file to fit and write; created if there is none.  [default: DH errors, not written]",
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

    The values are written into the model file, for `kincal model export`. A model without effects is plain
    DH calibration; a new model file starts as one.

    \b
    Examples:
        kincal model fit --arm arm.toml --data poses.csv --model M.toml
        kincal model fit --arm arm.toml --data poses.csv
    """
    from kincal.api.case import Case
    from kincal.api.models import load_model, place_of
    from kincal.cli.text import model as text
    from kincal.workbench.comparison.fitrecord import file_digest, fitted
    from kincal.workbench.model.modelfile import replace_model
    from kincal.workbench.numerics.background import second_process
    from kincal.workbench.report.answers import fit_json, fit_text

    arm, data = load(arm_path, given)
    chosen, library = load_model(model_path, effect_files, arm, must_exist=False)
    if note := text.of_other_data(chosen, {str(path): file_digest(path) for path in given.paths}):
        click.echo(note, err=True)
    with second_process() as begin:
        with progress() as tick:
            result = Case.of_model(arm, data, chosen, library).fit(tick, begin)
        said = json.dumps(fit_json(result), indent=1) if as_json else fit_text(result)
    if model_path is not None:
        where, new = place_of(arm_path), not model_path.exists()
        replace_model(model_path, fitted(chosen, result, arm=where, files=given.paths, version=__version__))
        if new:
            click.echo(f"{model_path}: new model, {text.names(chosen)}", err=True)
    else:
        click.echo("nothing was written: --model M.toml keeps the fit for `kincal model export`", err=True)
    click.echo(said)


@click.command("next")
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
    "--space",
    "space_path",
    type=FILE,
    default=None,
    help="Description of a search space (TOML): poses in which its shapes touch are excluded.",
)
@tables_option("With --space: directory with the arm and camera tables that its shapes stand on.")
@click.option(
    "--out",
    "-o",
    "out_path",
    type=FILE_OUT,
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
    space_path: Path | None,
    tables_dir: Path,
    out_path: Path | None,
    names: tuple[str, ...],
) -> None:
    """The poses that best separate two or more alternative effects.

    They stay within what was measured: tool positions, joint ranges, tool directions, and the camera's view.

    \b
    Examples:
        kincal model next --arm arm.toml --data poses.csv joint_compliance[2] base_flex
        kincal model next --arm arm.toml --data poses.csv -o next.csv backlash[1] encoder_gain[1]
        kincal model next --arm wam --data p.csv --space tables/src/space.toml backlash[1] backlash[2]
    """
    from kincal.api.case import check_alternatives
    from kincal.workbench.data.sums import of_the_joints
    from kincal.workbench.prediction.measurable import Limits
    from kincal.workbench.prediction.nextposes import poses_csv
    from kincal.workbench.report.answers import poses_json, poses_text
    from kincal_shared.writing import keep_inputs, write_file

    boxes = _boxes("--inside", inside), _boxes("--outside", outside)
    check_alternatives(names)
    if out_path is not None:
        keep_inputs([out_path], [*given.paths, arm_path, *([model_path] if model_path else [])])
    case = case_of(arm_path, given, model_path, effect_files)
    clear = None
    if space_path:
        from kincal.api.spaces import free_of_contact  # needs MuJoCo

        clear = free_of_contact(space_path, tables_dir, case.arm)
    limits = Limits(*boxes, clear)
    poses = case.separating_poses(names, count=count, limits=limits)
    if out_path is not None:
        write_file(out_path, poses_csv(poses, case.data.sums))
        click.echo(f"{out_path}: {len(poses)} poses", err=as_json)
    if case.data.sums:
        click.echo(f"note: {of_the_joints(case.data.sums)}", err=True)
    click.echo(json.dumps({"next_poses": poses_json(poses)}, indent=1) if as_json else poses_text(poses))


def _boxes(option: str, texts: Sequence[str]) -> tuple[Box, ...]:
    """Boxes of an option. BadInput names what is not six numbers."""
    from kincal.workbench.prediction.measurable import BOX_TEXT, Box
    from kincal_shared.schema.numbers import plain_number

    def numbers(text: str) -> list[float]:
        try:
            return [plain_number(x) for x in text.split(",")]
        except ValueError:
            raise BadInput(f"{option} {text}: not numbers", todo=BOX_TEXT) from None

    return tuple(Box.of(numbers(text)) for text in texts)
