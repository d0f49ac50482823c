"""Commands inside the process of the tests."""

from click.testing import CliRunner

from kincal.cli import main

# Keys of the figures of a report that names an effect.
FIGURES = ("found-1", "models", "posterior", "suspects", "map", "vectors", "variables", "joints",
           "confounding", "harm")  # fmt: skip


def shell(*args):
    """Result of a command of `kincal`, whatever it ends with."""
    return CliRunner().invoke(main, [*map(str, args)])


def kincal(*args):
    """Result of a command of `kincal model`; an exception other than its exit fails the test."""
    done = shell("model", *args)
    assert done.exception is None or isinstance(done.exception, SystemExit), done.exc_info
    return done
