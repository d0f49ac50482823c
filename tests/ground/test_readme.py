"""README.md is run as it stands, block by block in one shell, in a fresh clone."""

import os
import subprocess

import gen_tutorial
import pytest
from environments import as_function
from places import ROOT

pytestmark = pytest.mark.slow

FSW = "build/kincal-fsw --live --keys ~/.kincal/keys --tables tables/bin --store ~/.kincal/store"
DIAGNOSE = "kincal model diagnose --arm wam.toml --data wam.csv --report report.html"
# Commands that take minutes or need a network, and what is run for them: other tests do what they do.
INSTEAD = {
    "make demo": "make -n demo > /dev/null",  # tests/integration
    "make test": "make -n test > /dev/null",
    "make hil URL='udpm://239.255.76.67:7667?ttl=1'": "make -n hil > /dev/null",
    "kincal run encoder_bias --seed 7": "kincal run encoder_bias --seed 7 --fast --no-compare --no-summary",
    "kincal run healthy --fast": "kincal run healthy --fast --no-compare --no-summary",
    FSW: f"timeout 1 {FSW} --url memq:// || [ $? = 124 ]",  # a process for ever: that it begins is enough
    "kincal table uplink tables/bin/config.tbl": "kincal table uplink --help > /dev/null",  # test_review.py
    "pip install ./ground": "kincal --version > /dev/null",  # the fixture `wheel`
    # A quarter of the poses, and no diagnosis: test_tutorial.py has the same commands with all poses.
    "cp -r docs/data/wam out/": "cp -r docs/data/wam out/; sed -i -n '1p; 2~4p' out/wam/wam.csv",
    DIAGNOSE: f"{DIAGNOSE} --help > /dev/null",
}


def test_every_block_of_the_readme_ends_well(full, door, clone, tmp_path):
    text = (ROOT / "README.md").read_text("utf-8")
    blocks = [m["commands"] for m in gen_tutorial.BLOCK.finditer(text)]
    lines = {line.partition("#")[0].strip() for block in blocks for line in block.splitlines()}
    assert len(blocks) == 4 and set(INSTEAD) <= lines
    before = files_that_git_sees(clone)
    shell = gen_tutorial.Shell(clone, tmp_path, INSTEAD, HOME=str(tmp_path), **as_function(full, door))
    said = [shell.run(block) for block in blocks]
    assert "no change needed" in said[1] and "verdict" in said[3]
    assert (tmp_path / ".kincal" / "keys").is_file()
    made = clone / "out" / "wam"
    assert "def " in (made / "wam.py").read_text()
    assert files_that_git_sees(clone) == before, "the commands leave the clone clean"


def files_that_git_sees(clone):
    """Files of a tree that its .gitignore does not name, with their content."""
    ignore = ROOT / ".gitignore"
    words = ["git", "ls-files", "--others", "-z", f"--exclude-from={ignore}"]
    git = {**os.environ, "GIT_DIR": str(clone.parent / "no-index"), "GIT_WORK_TREE": str(clone)}
    subprocess.run(["git", "init", "--quiet"], env=git, cwd=clone, check=True)
    listed = subprocess.run(words, env=git, cwd=clone, capture_output=True, text=True, check=True)
    return {name: (clone / name).lstat().st_mtime_ns for name in listed.stdout.split("\0") if name}


@pytest.mark.parametrize("block", ["no-such-program | tee x", "cat missing | sort > y", "cd missing"])
def test_a_block_that_fails_in_a_pipe_is_noticed(tmp_path, block):
    with pytest.raises(SystemExit, match="status"):
        gen_tutorial.Shell(tmp_path, tmp_path, {}).run(block)


def test_folder_and_variables_of_a_block_hold_for_the_next(tmp_path):
    (tmp_path / "a b").mkdir()
    shell = gen_tutorial.Shell(tmp_path, tmp_path, {})
    shell.run("cd 'a b'\nexport X=5\n")
    assert shell.run('echo $X $(basename "$PWD")\n') == "5 a b\n"
