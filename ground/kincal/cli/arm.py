"""`kincal arm`: the arms that ship, and arm tables from URDF files."""

from __future__ import annotations

import json
from dataclasses import asdict
from pathlib import Path

import click

from kincal.cli.options import PATH
from kincal.cli.outputs import FILE_OUT


@click.group()
def arm() -> None:
    """Arm tables: those that ship, and new ones from URDF files.

    \b
    Example:
        kincal arm import robot.urdf --base base_link --tip tool0 -o arm.toml
    """


@arm.command("list")
@click.option("--json", "as_json", is_flag=True, help="Machine-readable answer.")
def list_command(as_json: bool) -> None:
    """List the arms that ship: every name works as --arm NAME.

    \b
    Example:
        kincal arm list
    """
    from kincal.arms import shipped
    from kincal.cli.text import arm as text

    arms = shipped()
    click.echo(json.dumps({"arms": [asdict(one) for one in arms]}, indent=1) if as_json else text.arms(arms))


@arm.command("show")
@click.argument("name")
def show_command(name: str) -> None:
    """Print the table of an arm that ships, to begin your own with.

    \b
    Example:
        kincal arm show ur5e > arm.toml
    """
    from kincal.arms import arm_text

    click.echo(arm_text(name), nl=False)


@arm.command("import")
@click.argument("urdf", type=PATH)
@click.option("--base", metavar="LINK", default=None, help="First link.  [default: the root]")
@click.option("--tip", metavar="LINK", default=None, help="Last link.  [default: the only end]")
@click.option("--estimate-frames", is_flag=True,
              help="Base and tool frame are unknown: for data of a tracker or motion capture.")  # fmt: skip
@click.option("--out", "-o", "out_path", type=FILE_OUT, required=True, help="Arm table to write (TOML).")
def import_command(
    urdf: Path, base: str | None, tip: str | None, estimate_frames: bool, out_path: Path
) -> None:
    """Make an arm table from a URDF: any serial chain, as DH parameters with fixed base and tool frames.

    The table is compared with the URDF at 100 random joint vectors.

    \b
    Example:
        kincal arm import robot.urdf --base base_link --tip tool0 -o arm.toml
    """
    from kincal.arms import import_urdf
    from kincal.cli.text import arm as text
    from kincal_shared.writing import keep_inputs, write_file

    keep_inputs([out_path], [urdf])
    made = import_urdf(urdf, base, tip, estimate_frames=estimate_frames)
    write_file(out_path, made.text)
    click.echo(text.imported(made, out_path, estimate_frames))
