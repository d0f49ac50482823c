"""Commands inside the process of the tests."""

from click.testing import CliRunner

from kincal.cli import main

# Keys of the figures of a report that names an effect.
FIGURES = ("found-1", "models", "posterior", "suspects", "map", "vectors", "variables", "joints",
           "confounding", "harm")  # fmt: skip


def shell(*args, env=None):
    """Result of a command of `kincal`, whatever it ends with."""
    return CliRunner().invoke(main, [*map(str, args)], env=env)


def good(*args, env=None):
    """Result of a command of `kincal` that ends well."""
    done = shell(*args, env=env)
    assert done.exit_code == 0, done.output
    return done


def text_of(done):
    """Words of its output, without line ends."""
    return " ".join(done.output.split())


def kincal(*args):
    """Result of a command of `kincal model`; an exception other than its exit fails the test."""
    done = shell("model", *args)
    assert done.exception is None or isinstance(done.exception, SystemExit), done.exc_info
    return done
