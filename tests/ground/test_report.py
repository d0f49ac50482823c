"""Pictures and pages of a run."""

import json
import re

import cv2
import numpy as np
import pytest
from samples import result

from kincal import pictures, report


@pytest.fixture(scope="module")
def written(tmp_path_factory):
    return report.write(result(), tmp_path_factory.mktemp("report"))


def test_page_opens_from_disk_without_a_network(written):
    text = written[0].read_text()
    outside = re.findall(r"<(?:script|link|img)[^>]+(?:src|href)=[\"']?(?:https?:)?//", text)
    assert outside == []
    assert text.count("Plotly.newPlot(") >= 3


def test_page_escapes_what_it_was_given(written):
    text = written[0].read_text()
    assert "Made-up &lt;run&gt;" in text
    assert "CAL_TAGS_LOST: &amp; more" in text


def test_page_shows_every_pose_and_coefficient(written):
    text = written[0].read_text()
    r = result()
    assert all(f"<td class='text'>{c.name}</td>" in text for c in r.coefs)
    assert text.count("± 0.100</td>") == len(r.poses)
    assert "passed" in text
    assert "failed" in report.render(result(ok=False))


def test_picture_is_large_and_not_empty(written):
    image = cv2.imread(str(written[1]))
    assert image.shape[1] > 1200
    assert image.shape[0] > 800
    assert np.mean(image < 250) > 0.02


def test_data_file_has_the_numbers(written):
    doc = json.loads(written[2].read_text())
    assert doc["ok"] is True
    assert doc["crc"] == "fedcba98"
    assert doc["after"]["pos_m"] == pytest.approx(5e-4)
    assert len(doc["coefs"]) == 28


def test_page_without_truth_shows_estimates():
    r = result()
    r.coefs = [type(c)(c.name, c.unit, float("nan"), c.estimate, c.sigma, c.status) for c in r.coefs]
    titles = [a.text for a in pictures.page_coefs(r).layout.annotations]
    assert titles[0].startswith("Angles: estimate,")


def test_run_without_poses_still_gives_a_page():
    r = result()
    r.poses, r.coefs, r.curves, r.scene, r.before, r.after = [], [], [], None, None, None
    assert "Poses" in report.render(r)


def test_review_picture_is_drawn(tmp_path):
    n = 5
    names, units = [f"J{i}.phi_rad" for i in range(n)], ["rad"] * n
    pictures.save_review_png(names, units, np.zeros(n), np.ones(n) * 1e-3, np.eye(n), tmp_path / "x.png", "t")
    assert (tmp_path / "x.png").stat().st_size > 10_000
