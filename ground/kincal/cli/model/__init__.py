"""`kincal model`: compare a model with measurements, find the missing effect, add it, fly it."""

from __future__ import annotations

import click

from . import files, measured


@click.group()
def model() -> None:
    """Compare a model with measurements, see where it fails, learn which effect is missing, add it.

    \b
    Example:
        kincal model diagnose --arm arm.toml --data poses.csv
    """


for _command in (
    measured.check_command,
    measured.compare_command,
    measured.diagnose_command,
    measured.fit_command,
    measured.next_command,
    files.predict_command,
    files.effects_command,
    files.add_command,
    files.remove_command,
    files.undo_command,
    files.list_command,
    files.history_command,
    files.uplink_command,
    files.export_command,
):
    model.add_command(_command)
