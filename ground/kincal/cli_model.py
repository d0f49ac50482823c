"""`kincal model`: compare a model with measurements, find the missing effect, add it, fly it."""

from __future__ import annotations

import json
from contextlib import contextmanager
from pathlib import Path

import click

from kincal.errors import BadInput

ARM = click.option(
    "--arm",
    "arm_path",
    required=True,
    type=click.Path(path_type=Path),
    help="Arm table (TOML), or the name of one that is shipped: wam.",
)
DATA = click.option("--data", "data_path", required=True, type=click.Path(path_type=Path),
                    help="Measurements: CSV, or an LCM log of the flight process.")  # fmt: skip
MODEL = click.option("--model", "model_path", type=click.Path(path_type=Path), default=None,
                     help="Model file; absent: DH errors only.")  # fmt: skip
MODEL_NEEDED = click.option(
    "--model", "model_path", type=click.Path(path_type=Path), required=True, help="Model file."
)
EFFECTS = click.option("--effects", "effect_files", multiple=True, type=click.Path(path_type=Path),
                       help="A file with your own effects; may be given several times.")  # fmt: skip
JSON = click.option("--json", "as_json", is_flag=True, help="Machine-readable answer.")
SKIP = click.option("--skip-bad", is_flag=True, help="Skip malformed rows and count them.")


@contextmanager
def _progress():
    """Yields progress(what, done, of): a bar on a terminal, nothing in a pipe."""
    from rich.console import Console
    from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn

    console = Console(stderr=True)
    columns = (TextColumn("{task.description}"), BarColumn(), TimeElapsedColumn())
    with Progress(*columns, console=console, transient=True, disable=not console.is_terminal) as bar:
        task = bar.add_task("working", total=1)
        yield lambda what, done, of: bar.update(task, description=what, completed=done, total=of)


def _load(arm_path: Path, data_path: Path, skip_bad: bool):
    from kincal.workbench.arms import read_arm
    from kincal.workbench.logs import read_measurements

    arm = read_arm(arm_path)
    return arm, read_measurements(data_path, arm.n, skip_bad=skip_bad)


def _model(model_path: Path | None, effect_files):
    """Model file and the library with its own and the named effect files."""
    from kincal.workbench.effects import Library
    from kincal.workbench.modelfile import ModelFile, read_model

    model = read_model(model_path) if model_path else ModelFile()
    base = model_path.parent if model_path else Path()
    files = list(dict.fromkeys([*(base / name for name in model.libraries), *effect_files]))
    return model, Library.load(*files)


@click.group()
def model() -> None:
    """Compare a model with measurements, see where it fails, learn which effect is missing, add it.

    \b
    Example:
        kincal model diagnose --arm arm.toml --data poses.csv
    """


@model.command("compare")
@ARM
@DATA
@MODEL
@EFFECTS
@SKIP
@JSON
def compare_command(arm_path, data_path, model_path, effect_files, skip_bad, as_json) -> None:
    """Does the model explain the data, and if not, where does it fail?

    \b
    Example:
        kincal model compare --arm arm.toml --data poses.csv --json
    """
    from kincal.workbench.answers import comparison_json, comparison_text
    from kincal.workbench.api import choose_constants
    from kincal.workbench.compare import compare

    arm, data = _load(arm_path, data_path, skip_bad)
    chosen, library = _model(model_path, effect_files)
    effects = choose_constants(library, chosen.effects, arm, data, dh=chosen.dh)
    answer = compare(arm, data, effects, dh=chosen.dh)
    click.echo(json.dumps(comparison_json(answer), indent=1) if as_json else comparison_text(answer))


@model.command("diagnose")
@ARM
@DATA
@MODEL
@EFFECTS
@SKIP
@JSON
@click.option(
    "--report",
    "report_path",
    type=click.Path(path_type=Path),
    default=None,
    help="Write a self-contained page (HTML) and its figures (PNG).",
)
def diagnose_command(arm_path, data_path, model_path, effect_files, skip_bad, as_json, report_path) -> None:
    """Which physical effect is missing? Probabilities for every effect and joint, and for none of them.

    \b
    Example:
        kincal model diagnose --arm arm.toml --data poses.csv --report out/report.html
    """
    from kincal.workbench.answers import diagnosis_json, diagnosis_text
    from kincal.workbench.api import advise, choose_constants, report
    from kincal.workbench.diagnose import diagnose

    arm, data = _load(arm_path, data_path, skip_bad)
    chosen, library = _model(model_path, effect_files)
    effects = choose_constants(library, chosen.effects, arm, data, dh=chosen.dh)
    with _progress() as progress:
        answer = diagnose(arm, data, library, effects, dh=chosen.dh, progress=progress)
        poses = advise(answer, library)
        files = (
            report(report_path, answer, library, arm, data, effects, poses, progress) if report_path else []
        )
    click.echo(
        json.dumps(diagnosis_json(answer, poses), indent=1) if as_json else diagnosis_text(answer, poses)
    )
    for file in files[:1]:
        click.echo(f"report: {file} (figures beside it)", err=as_json)


@model.command("fit")
@ARM
@DATA
@MODEL_NEEDED
@EFFECTS
@SKIP
@JSON
def fit_command(arm_path, data_path, model_path, effect_files, skip_bad, as_json) -> None:
    """Fit the model and show how the held-out error falls from rung to rung, down to the noise floor.

    The values are written into the model file.

    \b
    Example:
        kincal model fit --arm arm.toml --data poses.csv --model M.toml
    """
    from dataclasses import replace

    from kincal.workbench.answers import fit_json
    from kincal.workbench.api import fit
    from kincal.workbench.modelfile import write_model

    arm, data = _load(arm_path, data_path, skip_bad)
    chosen, library = _model(model_path, effect_files)
    with _progress() as progress:
        result = fit(arm, data, chosen.effects, library=library, dh=chosen.dh, progress=progress)
    values = {
        n: (float(v), float(s)) for n, v, s in zip(result.names, result.estimate, result.std_err, strict=True)
    }
    where = str(arm_path.resolve()) if arm_path.exists() else str(arm_path)
    write_model(model_path, replace(chosen, arm=where, values=values, constants=result.constants))
    click.echo(json.dumps(fit_json(result), indent=1) if as_json else result.summary())


@model.command("effects")
@EFFECTS
@JSON
def effects_command(effect_files, as_json) -> None:
    """List the effect library: formula, units, typical size, what each needs and is confounded with.

    \b
    Example:
        kincal model effects --effects my.toml
    """
    from kincal.workbench.effects import Library

    library = Library.load(*effect_files)
    rows = [
        {
            "name": e.name if e.per == "arm" else e.name + ("[j]" if e.per == "joint" else "[i,j]"),
            "title": e.title,
            "formula": e.formula,
            "parameters": [{k: p.get(k) for k in ("name", "unit", "sigma")} for p in e.parameters],
            "needs": list(e.needs),
            "looks_like": e.looks_like,
            "inspect": e.inspect,
            "confounded_with": list(e.confounded_with),
            "source": e.source,
        }
        for e in library.effects.values()
    ]
    if as_json:
        click.echo(json.dumps(rows, indent=1))
        return
    for row in rows:
        sizes = ", ".join(f"{p['name']} ~ {p['sigma']:g} {p['unit']}" for p in row["parameters"])
        click.echo(f"{row['name']:<30} {row['title']}")
        click.echo(f"    {row['formula']}    ({sizes})")
        click.echo(f"    looks like: {row['looks_like']}")
        click.echo(f"    inspect: {row['inspect']}")
        if row["needs"]:
            click.echo(f"    needs: {', '.join(row['needs'])}")
        if row["confounded_with"]:
            click.echo(f"    confounded with: {', '.join(row['confounded_with'])}")


def _check_names(library, names) -> None:
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
@MODEL_NEEDED
@EFFECTS
@click.argument("names", metavar="EFFECT...", nargs=-1, required=True)
def add_command(model_path, effect_files, names) -> None:
    """Add effects to the model (a new model file if there is none); the change goes into its history.

    \b
    Example:
        kincal model add --model M.toml joint_compliance[2]
    """
    from dataclasses import replace

    from kincal.workbench.effects import Library
    from kincal.workbench.modelfile import read_model, write_model

    before = read_model(model_path, must_exist=False)
    files = [model_path.parent / name for name in before.libraries] + list(effect_files)
    _check_names(Library.load(*files), names)
    after = before.add(list(names))
    new = [str(f.resolve()) for f in effect_files if str(f.resolve()) not in before.libraries]
    write_model(model_path, replace(after, libraries=(*before.libraries, *new)))
    click.echo(f"{model_path}: {', '.join(after.effects)}")


@model.command("remove")
@MODEL_NEEDED
@click.argument("names", metavar="EFFECT...", nargs=-1, required=True)
def remove_command(model_path, names) -> None:
    """Take effects out of the model; the change goes into its history.

    \b
    Example:
        kincal model remove --model M.toml joint_compliance[2]
    """
    from kincal.workbench.modelfile import read_model, write_model

    after = read_model(model_path).remove(list(names))
    write_model(model_path, after)
    click.echo(f"{model_path}: {', '.join(after.effects) or 'no effect (DH only)'}")


@model.command("undo")
@MODEL_NEEDED
def undo_command(model_path) -> None:
    """Take back the last add or remove.

    \b
    Example:
        kincal model undo --model M.toml
    """
    from kincal.workbench.modelfile import read_model, write_model

    after = read_model(model_path).undo()
    write_model(model_path, after)
    click.echo(f"{model_path}: {', '.join(after.effects) or 'no effect (DH only)'}")


@model.command("list")
@MODEL_NEEDED
@JSON
def list_command(model_path, as_json) -> None:
    """Show the effects in use and their fitted values.

    \b
    Example:
        kincal model list --model M.toml
    """
    from kincal.workbench.modelfile import read_model

    chosen = read_model(model_path)
    if as_json:
        values = {name: {"value": v, "std_err": s} for name, (v, s) in chosen.values.items()}
        click.echo(json.dumps({"effects": list(chosen.effects), "dh": chosen.dh, "values": values}, indent=1))
        return
    click.echo("\n".join(chosen.effects) or "no effect (DH only)")
    for name, (value, std_err) in chosen.values.items():
        if name.partition(".")[0] in chosen.effects:
            click.echo(f"    {name} = {value:.6g} +- {std_err:.2g}")


@model.command("history")
@MODEL_NEEDED
def history_command(model_path) -> None:
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
@SKIP
@JSON
@click.option("--count", type=click.IntRange(1, 64), default=8, show_default=True, help="Poses wanted.")
@click.argument("names", metavar="EFFECT EFFECT...", nargs=-1, required=True)
def next_command(arm_path, data_path, model_path, effect_files, skip_bad, as_json, count, names) -> None:
    """The poses that separate two or more rival effects best.

    \b
    Example:
        kincal model next --arm arm.toml --data poses.csv joint_compliance[2] base_flex
    """
    from kincal.workbench.answers import poses_json, poses_text
    from kincal.workbench.api import choose_constants
    from kincal.workbench.fit import fit_model
    from kincal.workbench.nextposes import next_poses

    arm, data = _load(arm_path, data_path, skip_bad)
    chosen, library = _model(model_path, effect_files)
    if len(names) < 2:
        raise BadInput("name two or more rival effects, for instance joint_compliance[2] base_flex")
    rivals = [choose_constants(library, [name], arm, data, dh=chosen.dh, joined=True)[0] for name in names]
    effects = choose_constants(library, chosen.effects, arm, data, dh=chosen.dh)
    poses = poses_json(next_poses(fit_model(arm, data, effects, dh=chosen.dh), rivals, count=count))
    click.echo(json.dumps({"next_poses": poses}, indent=1) if as_json else poses_text(poses))


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
@click.option(
    "--data",
    "data_path",
    type=click.Path(path_type=Path),
    default=None,
    help="Measurements, for effects whose constants follow from them (time of a step).  "
    "[default: as the last `kincal model fit` found them]",
)
@click.option(
    "--out",
    "-o",
    "out_path",
    type=click.Path(path_type=Path),
    default=None,
    help="Image to write.  [default: MODEL with .tbl]",
)
@click.option(
    "--fly",
    "fly_dir",
    type=click.Path(path_type=Path),
    default=None,
    help="Also make this directory: all images of --tables, with these terms and no correction yet.",
)
@click.option(
    "--tables",
    "tables_dir",
    type=click.Path(path_type=Path),
    default=Path("tables/bin"),
    show_default=True,
    help="Directory with built table images, for --fly.",
)
def uplink_command(model_path, effect_files, arm_path, data_path, out_path, fly_dir, tables_dir) -> None:
    """The model as a correction-term table image for flight (uplink it with `kincal table uplink`).

    Flight then estimates these coefficients together with the DH errors.

    \b
    Examples:
        kincal model uplink --model M.toml -o terms.tbl
        kincal model uplink --model M.toml --fly out/tables
    """
    from kincal.workbench.api import choose_constants
    from kincal.workbench.arms import read_arm
    from kincal.workbench.logs import read_measurements
    from kincal.workbench.uplink import flight_tables, term_image

    chosen, library = _model(model_path, effect_files)
    where = arm_path or (Path(chosen.arm) if chosen.arm else None)
    if where is None:
        raise BadInput(
            f"{model_path} does not say which arm it is for; run `kincal model fit` first or give --arm"
        )
    arm = read_arm(where)
    data = read_measurements(data_path, arm.n) if data_path else None
    known = {} if data is not None else chosen.constants
    image = term_image(arm, choose_constants(library, chosen.effects, arm, data, dh=chosen.dh, known=known))
    out = out_path or model_path.with_suffix(".tbl")
    out.parent.mkdir(parents=True, exist_ok=True)
    out.write_bytes(image.data)
    click.echo(f"{out}: correction terms, {len(image.data)} bytes, CRC {image.crc_text}")
    if fly_dir:
        flight_tables(tables_dir, fly_dir, image)
        click.echo(f"{fly_dir}: tables to fly with")
