"""`kincal model` inside the process of the tests."""

from click.testing import CliRunner

from kincal.cli import main


def kincal(*args):
    """Result of a command; an exception other than its exit fails the test."""
    done = CliRunner().invoke(main, ["model", *map(str, args)])
    assert done.exception is None or isinstance(done.exception, SystemExit), done.exc_info
    return done
