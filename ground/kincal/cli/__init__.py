"""The `kincal` command. Every command is a short call into the library; one module a group."""

from __future__ import annotations

import os

import click

# The workbench handles thousands of small matrices: threads inside the linear algebra only get in each
# other's way (five times slower). Has to be said before numpy is loaded; the user's own setting wins.
for _name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ.setdefault(_name, "1")

from kincal import __version__  # noqa: E402
from kincal.cli import arm, key, log, model, review, run, schema, space, table  # noqa: E402
from kincal.cli.errors import Commands  # noqa: E402


@click.group(cls=Commands, context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 100})
@click.version_option(__version__)
def main() -> None:
    """Ground side of KinCal: make tables and search spaces, run calibrations, read logs, review
    corrections, find what the arm model lacks.

    \b
    Exit status: 0 good, 1 the work was done and the answer is no, 2 bad input, 3 the data cannot answer,
    130 interrupted.

    \b
    Example:
        kincal run paper --fast
    """


for _group in (
    arm.arm,
    key.key,
    log.log,
    model.model,
    review.review,
    run.run,
    schema.schema,
    space.space,
    table.table,
):
    main.add_command(_group)
