"""`kincal schema`: JSON Schema of every file that people write."""

from __future__ import annotations

from pathlib import Path

import click

from kincal.cli.outputs import FOLDER_OUT


@click.command()
@click.option(
    "-o", "--out", type=FOLDER_OUT, default=Path("schema"), show_default=True, help="Folder to write to."
)
def schema(out: Path) -> None:
    """Write the JSON Schema of every TOML file that KinCal reads.

    An editor that knows TOML completes and checks a file whose first line names its schema, for
    instance `#:schema ./schema/arm.schema.json`.

    \b
    Example:
        kincal schema -o schema
    """
    from kincal_shared.schema.files import write_json_schemas

    for path in write_json_schemas(out):
        click.echo(str(path))
