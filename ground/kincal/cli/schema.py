"""`kincal schema`: JSON Schema of the files that people write."""

from __future__ import annotations

from pathlib import Path

import click

from kincal.cli.outputs import FOLDER_OUT


@click.command()
@click.argument("kind", required=False)
@click.option("-o", "--out", type=FOLDER_OUT, help="Write the schemas of all kinds into this folder.")
def schema(kind: str | None, out: Path | None) -> None:
    """Show the JSON Schema of a kind of TOML file that KinCal reads, for instance of `arm`.

    Without KIND: the list of the kinds. An editor that knows TOML completes and checks a file
    whose first line names its schema, for instance `#:schema ./schema/arm.schema.json`.

    \b
    Examples:
        kincal schema arm
        kincal schema -o schema
    """
    from kincal_shared.schema.files import FILES, json_schema, write_json_schemas

    if kind is not None and out is not None:
        raise click.UsageError("give KIND to show one schema, or -o FOLDER to write all, not both")
    if kind is not None and kind not in FILES:
        raise click.UsageError(f"no kind of file '{kind}'; there are {', '.join(sorted(FILES))}")
    if out is not None:
        shown = [str(path) for path in write_json_schemas(out)]
    elif kind is not None:
        shown = [json_schema(kind).rstrip()]
    else:
        shown = [f"{name:<17} {(FILES[name].__doc__ or '').splitlines()[0]}" for name in sorted(FILES)]
    click.echo("\n".join(shown))
