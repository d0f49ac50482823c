"""The benchmark against other software: what it is asked for."""

import bench
import pytest


@pytest.mark.parametrize("number", ["0", "-3"])
def test_no_problems_are_no_benchmark(number, capsys):
    """It measured nothing and ended with a traceback of numpy."""
    with pytest.raises(SystemExit) as refused:
        bench.options(["--only", "qp", "--problems", number])
    assert refused.value.code == 2
    assert f"--problems: is {number}, must be 1 or more" in capsys.readouterr().err


def test_what_is_asked_for_is_measured():
    o = bench.options(["--only", "kernel", "qp", "--problems", "1"])
    assert (o.only, o.problems, o.write) == (["kernel", "qp"], 1, False)
