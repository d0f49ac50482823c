"""Pages and pictures: one theme, provenance, nothing from a network, and no failure without a browser."""

import json
import re
from dataclasses import replace
from html.parser import HTMLParser
from pathlib import Path

import cv2
import numpy as np
import plotly.graph_objects as go
import pytest
from samples import result

from kincal.pages import glossary, image, page, run, run_figures, theme, words
from kincal.pages.page import Cell, Grid, Page, Provenance, Section, Tile
from kincal.results import Curve
from kincal.workbench.model.unnamed_names import OF_ORIENTATION
from kincal_shared.errors import BadInput

ORIGIN = Provenance("2026-11-22", {"arm": "1a2b3c4d"}, "out/run.lcmlog", "ab" * 32, seed=7)


@pytest.fixture(scope="module")
def written(tmp_path_factory):
    files, why = run.write_all(result(), tmp_path_factory.mktemp("report"), ORIGIN)
    assert why == ""
    return {file.suffix: file for file in files}


def without_scripts(text):
    return re.sub(r"<script\b.*?</script>", "", text, flags=re.S)


class Balance(HTMLParser):
    """Elements that were not closed, or closed without being open."""

    VOID = {"meta", "br", "link", "img"}

    def __init__(self):
        super().__init__()
        self.open, self.wrong = [], []

    def handle_starttag(self, tag, attrs):  # noqa: ARG002 as the parser calls it
        if tag not in self.VOID:
            self.open.append(tag)

    def handle_endtag(self, tag):
        if not self.open or self.open.pop() != tag:
            self.wrong.append(tag)


# --------------------------------------------------------------------------- the page


@pytest.mark.parametrize("name", [*sorted(OF_ORIENTATION), "dir1"])
def test_titles_of_small_panels_do_not_cover_their_neighbours(name):
    lines = words.title(name).split("<br>")
    assert " ".join(lines).replace("\N{NO-BREAK SPACE}", " ") == words.axis(name)
    assert max(map(len, lines)) <= 34 and len(lines) <= 3
    assert all(line.count("[") == line.count("]") for line in lines)


def test_page_opens_from_disk_without_a_network(written):
    text = written[".html"].read_text()
    assert re.findall(r"<(?:script|link|img)[^>]+(?:src|href)=", text) == []
    assert re.search(r"https?://|@import|url\(", without_scripts(text)) is None
    assert text.count("plotly.js v") == 1  # inlined once
    assert text.count('data-figure="figure-') == 3


def test_page_is_well_formed_and_made_from_the_same_input_twice_the_same(written):
    parser = Balance()
    parser.feed(without_scripts(written[".html"].read_text()))
    assert (parser.open, parser.wrong) == ([], [])
    assert page.render(run.page(result(), ORIGIN)) == written[".html"].read_text()


def test_page_escapes_what_it_was_given(written):
    text = written[".html"].read_text()
    assert "Made-up &lt;run&gt;" in text
    assert "CAL_TAGS_LOST: &amp; more" in text
    figure = go.Figure(go.Scatter(x=[1], y=[2], name="</script><b>"))
    made = Page("Test", "t", "s", ORIGIN, [Section("a", "A", figure=figure)])
    assert "</script><b>" not in page.render(made)


def test_page_shows_every_pose_and_coefficient(written):
    text = written[".html"].read_text()
    r = result()
    assert all(f'<td class="t ">{c.name}</td>' in text for c in r.coefs)
    assert text.count("± 0.100</td>") == len(r.poses)
    assert ">passed</b>" in text
    assert ">failed</b>" in page.render(run.page(result(ok=False), ORIGIN))


def test_page_says_where_its_numbers_come_from(written):
    foot = written[".html"].read_text().split("<footer>")[1]
    for text in (
        "2026-11-22", "kincal 0.1.0", "out/run.lcmlog", "abababababababab", "1a2b3c4d", "<dd>7</dd>",
    ):  # fmt: skip
        assert text in foot


def test_data_file_is_named_with_its_hash(tmp_path):
    (tmp_path / "d.csv").write_bytes(b"x")
    origin = Provenance.of_file("2026-11-22", tmp_path / "d.csv")
    assert origin.data_sha256.startswith("2d711642b726b044")
    assert Provenance.of_file("2026-11-22", tmp_path / "nothing.csv").data_sha256 == ""


def test_page_without_figures_carries_no_script():
    made = Page(
        "Test", "t", "s", ORIGIN, [Section("a", "A", grid=Grid.of("x", [["1"]]))], tiles=[Tile("n", "1")]
    )
    assert "<script" not in page.render(made)


def test_page_of_a_run_begins_with_what_came_out(written):
    text = written[".html"].read_text("utf-8")
    verdict = text[text.index('class="verdict"') :].partition("</div>")[0]
    assert "Passed: flight says" in verdict
    assert "poses that were not measured" in verdict


def test_what_a_browser_would_obey_is_shown_instead():
    evil = "all \u202edoog si\u2066 \x1b[31m"
    made = Page("Review", "t", evil, ORIGIN, [Section("a", evil, evil)], summary=[evil], verdict=evil)
    text = page.render(made)
    assert text.count("all \\x202edoog si\\x2066 \\x1b[31m") >= 4
    assert not re.search("[\u202e\u2066\x1b]", without_scripts(text))


def test_run_without_poses_still_gives_a_page():
    r = replace(result(), poses=(), coefs=(), curves=(), scene=None, before=None, after=None)
    assert "Poses" in page.render(run.page(r, ORIGIN))


def test_cells_and_columns_say_what_they_are():
    grid = Grid.of("<name|value", [["a", Cell("1", "bad")]])
    assert [(c.title, c.number) for c in grid.columns] == [("name", False), ("value", True)]
    assert grid.rows == ((Cell("a"), Cell("1", "bad")),)


def test_words_of_a_page_are_explained_from_the_glossary(monkeypatch):
    text = (
        '| term | meaning | source |\n| <a id="hub"></a>hub `hub` | node of the [roadmap](X.md) | PRM |\n'
        '| <a id="body"></a>body | a thing | none |\n'
    )
    terms = glossary.parse(text)
    assert [(t.key, t.name, t.meaning) for t in terms] == [
        ("hub", "hub", "node of the roadmap"),
        ("body", "body", "a thing"),
    ]
    monkeypatch.setattr(glossary, "terms", lambda: tuple(terms))
    assert [t.key for t in glossary.terms_in("4 Hubs, nobody")] == ["hub"]


# --------------------------------------------------------------------------- theme and figures


def colours_in(value):
    """All hex colours of a figure."""
    if isinstance(value, str):
        return {value.lower()} if re.fullmatch(r"#[0-9a-fA-F]{6}", value) else set()
    if isinstance(value, dict):
        value = list(value.values())
    return set().union(*map(colours_in, value)) if isinstance(value, list) else set()


def figures():
    r = result()
    return {
        "arm": run_figures.arm(r.scene, r),
        "progress": run_figures.progress(r),
        "corrections": run_figures.corrections(r.coefs),
        "sheet": run_figures.sheet(r),
    }


@pytest.mark.parametrize("name", figures())
def test_every_colour_has_a_dark_partner_or_reads_on_both(name):
    ramp = {colour for scale in (theme.ORDER, theme.CYCLE) for _, colour in scale}
    assert colours_in(json.loads(figures()[name].to_json())) - set(theme.DARK) - ramp == set()


def luminance(colour):
    parts = [int(colour[i : i + 2], 16) / 255 for i in (1, 3, 5)]
    linear = [p / 12.92 if p <= 0.04045 else ((p + 0.055) / 1.055) ** 2.4 for p in parts]
    return float(np.dot([0.2126, 0.7152, 0.0722], linear))


def contrast(a, b):
    low, high = sorted((luminance(a), luminance(b)))
    return (high + 0.05) / (low + 0.05)


@pytest.mark.parametrize("dark", [False, True])
def test_text_and_lines_stand_out_from_the_paper(dark):
    def shade(colour):
        return theme.DARK[colour] if dark else colour

    paper = shade(theme.PAPER)
    assert contrast(shade(theme.INK), paper) >= 7.0
    words = (theme.MUTED, theme.BLUE, theme.GREEN, theme.RED)  # WCAG 2.2, 1.4.3
    assert all(contrast(shade(colour), paper) >= 4.5 for colour in words)
    assert all(contrast(shade(colour), paper) >= 3.0 for colour in theme.SERIES)


def test_the_objective_is_drawn_on_a_scale_on_which_one_sees_it():
    """After the first pose f is close to zero, on a linear scale all of it on the axis."""
    first = result().curves[0]
    poses = tuple(replace(p, f_run=f) for p, f in zip(first.poses, (-1.0, -0.003, -0.03), strict=False))
    drawn = run_figures.progress(replace(result(), curves=(Curve("ucb", poses),)))
    f = next(t for t in drawn.data if t.xaxis == "x")
    assert list(f.y) == [1.0, 0.003, 0.03][: len(poses)] and drawn.layout.yaxis.type == "log"


def test_figures_without_truth_show_estimates():
    coefs = [type(c)(c.name, c.unit, float("nan"), c.estimate, c.sigma, c.status) for c in result().coefs]
    titles = [a.text for a in run_figures.corrections(coefs).layout.annotations]
    assert titles[0].startswith("Angles: estimate,")


# --------------------------------------------------------------------------- pictures


def test_picture_is_large_and_not_empty(written):
    drawn = cv2.imread(str(written[".png"]))
    assert drawn.shape[1] > 1200
    assert drawn.shape[0] > 800
    assert np.mean(drawn < 250) > 0.02


def test_data_file_has_the_numbers(written):
    doc = json.loads(written[".json"].read_text())
    assert doc["ok"] is True
    assert doc["crc"] == "fedcba98"
    assert doc["after"]["pos_m"] == pytest.approx(5e-4)
    assert len(doc["coefs"]) == 28


def test_picture_can_be_svg(tmp_path):
    image.save({tmp_path / "x.svg": run_figures.corrections(result().coefs)})
    assert (tmp_path / "x.svg").read_text().startswith("<svg")


def test_other_kinds_of_picture_are_refused(tmp_path):
    with pytest.raises(BadInput, match="a picture is .png or .svg, not .gif"):
        image.save({tmp_path / "x.gif": go.Figure()})


def test_without_a_browser_the_page_is_written_and_the_reason_said(tmp_path, monkeypatch):
    monkeypatch.setenv("BROWSER_PATH", str(tmp_path / "none"))
    monkeypatch.setenv("PATH", str(tmp_path))
    files, why = run.write_all(result(), tmp_path, ORIGIN)
    assert [Path(f).name for f in files] == ["summary.html", "summary.json"]
    assert "apt install chromium" in why
    with pytest.raises(BadInput, match="need a browser"):
        image.save({tmp_path / "x.png": run_figures.corrections(result().coefs)})
