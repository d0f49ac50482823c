"""Tag detector: accuracy on rendered frames against the truth, agreement with the fast mode, LCM."""

import json
import select
import subprocess
import time
from dataclasses import replace
from pathlib import Path

import corner_model
import cv2
import lcm
import numpy as np
import pytest

import kcm
from kincal_sim import transforms
from kincal_sim.mechanics import arm
from kincal_sim.ports import private_port, private_url
from kincal_sim.vision import camera, detection_model, pnp

ROOT = Path(__file__).resolve().parents[2]
TAGDET = ROOT / "build" / "kincal-tagdet"
CONFIG = ROOT / "sim" / "models" / "detector.yml"
FLOATING, HELD = 34, 28  # frames with both tags, and with the tool on the arm
PARKED = [2.5, -1.9, 0.0, 3.0, 0.0, 0.3, 0.0]


@pytest.fixture(scope="module")
def cfg():
    return camera.load_config()


@pytest.fixture(scope="module")
def body():
    return arm.Arm()


@pytest.fixture(scope="module")
def cam(cfg, body):
    cam = camera.Camera(cfg, body.model)
    yield cam
    cam.close()


def detect(path, config=CONFIG):
    """The detector's answers about image files."""
    paths = [str(p) for p in (path if isinstance(path, list) else [path])]
    run = subprocess.run(
        [TAGDET, "--config", config, "--image", *paths], capture_output=True, text=True, check=True
    )
    return [json.loads(line) for line in run.stdout.splitlines()]


def covariance(answer) -> np.ndarray:
    P = np.zeros((6, 6))
    P[np.triu_indices(6)] = answer["cov"]
    return P + np.triu(P, 1).T


def error(answer, T_cam_tool) -> np.ndarray:
    """Position and left rotation vector, measured against true."""
    R = transforms.rotation_matrix(answer["q_cam_tool_wxyz"]) @ T_cam_tool[:3, :3].T
    p = np.array(answer["p_cam_tool_m"]) - T_cam_tool[:3, 3]
    return np.concatenate([p, cv2.Rodrigues(R)[0].ravel()])


def nees(answer, T_cam_tool) -> float:
    e = error(answer, T_cam_tool)
    return float(e @ np.linalg.solve(covariance(answer), e))


def corner_errors(cfg, answer, T_cam_tool) -> np.ndarray:
    tag = {t.id: t for t in cfg.tags}
    out = []
    for k in range(answer["n_tags"]):
        t = tag[answer["tag_id"][k]]
        points = pnp.tool_corners(t.T_tool_tag, t.size_m)
        true = pnp.project(cfg.K, T_cam_tool[:3, :3], T_cam_tool[:3, 3], points)
        out.append(np.reshape(answer["corner_px"][8 * k : 8 * k + 8], (4, 2)) - true)
    return np.array(out)


def floating_pose(cfg, rng) -> np.ndarray:
    """Tool anywhere in view, 0.8 to 1.6 m away, up to 25 degrees oblique, any spin: both tags in sight."""
    z = rng.uniform(0.8, 1.6)
    ray = np.linalg.inv(cfg.K) @ [rng.uniform(250, 1670), rng.uniform(200, 880), 1.0]
    forward = ray / np.linalg.norm(ray)
    across = np.cross([0.0, 0.0, 1.0], forward)
    face = cv2.Rodrigues(across / np.linalg.norm(across) * np.arccos(forward[2]))[0]
    axis = rng.normal(size=3)
    lean = cv2.Rodrigues(axis / np.linalg.norm(axis) * np.radians(rng.uniform(0.0, 25.0)))[0]
    return transforms.transform(ray * z, lean @ face @ transforms.rot("z", rng.uniform(-3.1, 3.1))[:3, :3])


def posture_in_view(cfg, body, rng) -> np.ndarray:
    """Put arm and pan-tilt unit so that the camera sees a tag of the tool; gives T_cam_tool."""
    low, high = (np.array(body.spec["region"][k]) for k in ("min_m", "max_m"))
    for _ in range(100_000):
        q = rng.uniform(body.q_min, body.q_max)
        body.set(q)
        p = body.T_base_tool[:3, 3]
        if np.any(p < low) or np.any(p > high):
            continue
        body.set(q, *camera.aim(body.spec, p + rng.normal(0.0, 0.05, 3)))
        T = np.linalg.inv(body.T_base_cam) @ body.T_base_tool
        if T[2, 2] < 0.5 or np.linalg.norm(T[:3, 3]) > 1.6:
            continue
        if detection_model.visible_tags(cfg, body.model, body.data, body.T_base_cam, body.T_base_tool):
            return T
    raise AssertionError("no posture with a tag in view was found")


def picture(cam, body, T_base_tool, rng, whole):
    """A frame with all of the scene, or with what is about the tags, which takes a third of the time."""
    if whole:
        return cam.render(body.data, body.T_base_cam, T_base_tool, rng)
    return cam.expose_tags(cam.tags_radiance(body.data, body.T_base_cam, T_base_tool), rng)


@pytest.fixture(scope="module")
def frames(cfg, body, cam, tmp_path_factory):
    """Rendered frames, one in six whole, with the truth and what the detector says: (truth, answers)."""
    folder, rng = tmp_path_factory.mktemp("frames"), np.random.default_rng(2025)
    truth, paths, sizes = [], [], []
    for i in range(FLOATING + HELD):
        if i < FLOATING:
            body.set(PARKED, 0.0, 0.6)
            T = floating_pose(cfg, rng)
        else:
            T = posture_in_view(cfg, body, rng)
        frame = cam.encode(picture(cam, body, body.T_base_cam @ T, rng, whole=i % 6 == 0))
        sizes.append(len(frame.data))
        paths.append(folder / f"{i:03d}.jpg")
        paths[-1].write_bytes(frame.data)
        truth.append(T)
    answers = detect(paths)
    print(f"JPEG {min(sizes)}..{max(sizes)} bytes, detection {np.median([a['ms'] for a in answers]):.0f} ms")
    assert max(sizes) < cfg.image["max_jpeg_bytes"]
    return truth, answers


def test_configuration_agrees_with_the_simulated_camera_and_tags(cfg):
    f = cv2.FileStorage(str(CONFIG), cv2.FILE_STORAGE_READ)
    K = [[f.getNode(n).real() for n in row] for row in (("fx_px", "cx_px"), ("fy_px", "cy_px"))]
    assert [[cfg.K[0, 0], cfg.K[0, 2]], [cfg.K[1, 1], cfg.K[1, 2]]] == K
    assert (f.getNode("width_px").real(), f.getNode("height_px").real()) == (cfg.width_px, cfg.height_px)
    nodes = [f.getNode("tags").at(i) for i in range(f.getNode("tags").size())]
    assert len(nodes) == len(cfg.tags)
    for node, tag in zip(nodes, cfg.tags, strict=True):
        assert (int(node.getNode("id").real()), node.getNode("size_m").real()) == (tag.id, tag.size_m)
        xyz = [node.getNode("xyz_m").at(i).real() for i in range(3)]
        turn = transforms.rot("y", np.radians(node.getNode("turn_y_deg").real()))
        assert np.allclose(transforms.trans(*xyz) @ turn, tag.T_tool_tag, atol=1e-12)
    assert f.getNode("corner_sigma_weight").real() == cfg.detection["corner_sigma_weight"]
    sigma = [f.getNode(name).real() for name in ("edge_sigma_px", "aligned_sigma_px")]
    assert sigma == [corner_model.EDGE_PX, corner_model.ALIGNED_PX]


def test_corners_are_sharp_and_without_bias(cfg, frames):
    """Sub-pixel corners; a wrong pixel centre convention would show as half a pixel of mean error."""
    e = np.vstack([corner_errors(cfg, a, T) for T, a in zip(*frames, strict=True) if a["n_tags"]])
    e = e[np.abs(e).max(axis=(1, 2)) < 0.3]  # whole tags; a hidden edge has its own test
    print(f"corner error mean {e.mean(axis=(0, 1))} rms {np.sqrt(np.mean(e**2)):.4f} px, {len(e)} tags")
    assert len(e) > 0.95 * (2 * FLOATING + HELD)
    assert np.abs(e.mean(axis=(0, 1))).max() < 0.01
    assert 0.02 < np.sqrt(np.mean(e**2)) < 0.13


def test_two_tags_give_a_fifth_of_a_millimetre(frames):
    pairs = [(T, a) for T, a in zip(*(x[:FLOATING] for x in frames), strict=True) if a["n_tags"] == 2]
    assert len(pairs) >= 0.9 * FLOATING  # the mast's shadow may fall on the edge of a tag
    e = np.array([error(a, T) for T, a in pairs])
    chi = np.array([nees(a, T) for T, a in pairs])
    pos, rot = (np.sqrt(np.mean(np.sum(x**2, axis=1))) for x in (e[:, :3], e[:, 3:]))
    print(f"two tags: {1e3 * pos:.3f} mm, {np.degrees(rot):.3f} deg RMS, mean NEES {chi.mean():.2f}")
    assert pos < 0.3e-3 and rot < np.radians(0.12)
    # 6 if the covariance were exact; corner errors of one tag hang together, which makes it cautious.
    assert 2.5 < chi.mean() < 7.5
    assert chi.max() < 30.0


def test_one_tag_on_the_arm_gives_a_millimetre(frames):
    pairs = [(T, a) for T, a in zip(*(x[FLOATING:] for x in frames), strict=True) if a["n_tags"] == 1]
    assert len(pairs) >= 0.6 * HELD  # the wrist hides the other tag in most postures
    e = np.array([error(a, T) for T, a in pairs])
    chi = np.array([nees(a, T) for T, a in pairs])
    pos, rot = (np.sqrt(np.mean(np.sum(x**2, axis=1))) for x in (e[:, :3], e[:, 3:]))
    print(f"one tag: {1e3 * pos:.3f} mm, {np.degrees(rot):.3f} deg RMS, mean NEES {chi.mean():.2f}")
    assert pos < 1.5e-3 and rot < np.radians(0.6)
    assert 2.5 < np.median(chi) * 6.0 / 5.35 < 9.0


def test_no_flipped_pose_is_accepted(frames):
    pairs = [(T, a) for T, a in zip(*frames, strict=True) if a["n_tags"]]
    turned = [np.linalg.norm(error(a, T)[3:]) for T, a in pairs]
    assert max(turned) < np.radians(3.0)
    assert all(a["rms_px"] <= a["rms_alt_px"] for _, a in pairs)
    # The other solution is reported where there is one: always with one tag seen obliquely.
    assert any(a["rms_alt_px"] > a["rms_px"] and a["n_tags"] == 1 for _, a in pairs)


def both_minima(K, tag, px):
    """The two plane poses of a tag, as poses of the tool."""
    size = pnp.tool_corners(np.eye(4), tag.size_m)
    _, rvecs, tvecs, _ = cv2.solvePnPGeneric(size, px, K, None, flags=cv2.SOLVEPNP_IPPE)
    for rvec, tvec in zip(rvecs, tvecs, strict=True):
        R = corner_model.turn(rvec) @ tag.T_tool_tag[:3, :3].T
        yield R, tvec.ravel() - R @ tag.T_tool_tag[:3, 3]


def fitted(cfg, answer):
    """Pose and covariance of the reference from the corners of an answer; whether it is a mean over tilts."""
    tags = {t.id: t for t in cfg.tags}
    n = answer["n_tags"]
    px = np.reshape(answer["corner_px"][: 8 * n], (n, 4, 2))
    seen = [tags[i] for i in answer["tag_id"][:n]]
    points = np.vstack([pnp.tool_corners(t.T_tool_tag, t.size_m) for t in seen])
    information = np.zeros((8 * n, 8 * n))
    for k in range(n):
        at = slice(8 * k, 8 * k + 8)
        information[at, at] = np.linalg.inv(corner_model.corner_covariance(px[k]))
    starts = [s for t, c in zip(seen, px, strict=True) for s in both_minima(cfg.K, t, c)]
    refined = [opencv_fit(cfg.K, *s, points, np.vstack(px)) for s in starts]
    fits = [corner_model.fit(cfg.K, R, p, points, np.vstack(px), information) for _, R, p in refined]
    fits.sort(key=lambda x: np.sum((np.vstack(px) - pnp.project(cfg.K, x[0], x[1], points)) ** 2))
    between = [np.linalg.norm(corner_model.vector(fits[0][0].T @ x[0])) for x in fits]
    second = next((k for k, angle in enumerate(between) if angle > 0.01), 0)
    if n == 1 and (between[second] < 0.21 if second else answer["incid_rad"] < 0.105):
        return *corner_model.average(cfg.K, seen[0], px[0], fits[0], fits[second]), True
    R, p, chi2, H = fits[0]
    return R, p, corner_model.covariance(chi2, 4 * n, H), False


def agrees(cfg, answer) -> tuple[bool, bool]:
    """Whether an answer is what the reference makes of its corners, and whether that is a mean over tilts."""
    R, p, C, averaged = fitted(cfg, answer)
    scale = np.sqrt(np.diag(C))
    off = transforms.rotation_matrix(answer["q_cam_tool_wxyz"]) @ R.T
    d = np.concatenate([np.array(answer["p_cam_tool_m"]) - p, corner_model.vector(off)])
    P = covariance(answer) / np.outer(scale, scale)
    return bool(
        np.all(np.abs(d) < 0.01 * scale) and np.allclose(C / np.outer(scale, scale), P, atol=1e-2)
    ), averaged


def test_the_detectors_pose_and_covariance_are_those_of_the_reference(cfg, frames):
    same, averaged = np.array([agrees(cfg, a) for a in frames[1] if a["n_tags"]]).T
    assert np.all(same[~averaged]) and np.sum(~averaged) > 40


def front_view(cfg, tag, rng, tilt_deg) -> np.ndarray:
    """Tool with a tag in view that is seen nearly from the front, 0.8 to 1.5 m away."""
    ray = np.linalg.inv(cfg.K) @ [rng.uniform(350, 1570), rng.uniform(250, 830), 1.0]
    forward = ray / np.linalg.norm(ray)
    across = np.cross([0.0, 0.0, 1.0], forward)
    face = corner_model.turn(across / np.linalg.norm(across) * np.arccos(forward[2]))
    axis = rng.uniform(0.0, 2.0 * np.pi)
    lean = np.radians(rng.uniform(*tilt_deg)) * (np.cos(axis) * face[:, 0] + np.sin(axis) * face[:, 1])
    R = corner_model.turn(lean) @ face @ transforms.rot("z", rng.uniform(-3.1, 3.1))[:3, :3]
    return transforms.transform(ray * rng.uniform(0.8, 1.5), R) @ np.linalg.inv(tag.T_tool_tag)


@pytest.fixture(scope="module")
def front_views(cfg, body, tmp_path_factory):
    """Frames of one tag, tilted by 0 to 6 degrees: (truth, answers)."""
    alone = replace(cfg, tags=cfg.tags[:1])
    cam = camera.Camera(alone, body.model)
    folder, rng = tmp_path_factory.mktemp("front"), np.random.default_rng(2027)
    truth, paths = [], []
    body.set(PARKED, 0.0, 0.6)
    for i in range(100):
        T = front_view(cfg, cfg.tags[0], rng, (0.0, 6.0))
        scene = cam.tags_radiance(body.data, body.T_base_cam, body.T_base_cam @ T)
        paths.append(folder / f"{i:03d}.jpg")
        cv2.imwrite(str(paths[-1]), cam.expose_tags(scene, rng), [cv2.IMWRITE_JPEG_QUALITY, 75])
        truth.append(T)
    cam.close()
    answers = detect(paths)
    found = [(T, a) for T, a in zip(truth, answers, strict=True) if a["n_tags"]]
    return [T for T, _ in found], [a for _, a in found]


def test_a_tag_from_the_front_states_how_uncertain_its_tilt_is(front_views):
    """First order at either minimum stated 0.8 deg where the error was 2.1 deg."""
    truth, answers = front_views
    assert len(truth) >= 90
    e = np.array([np.sum(error(a, T)[3:] ** 2) for T, a in zip(truth, answers, strict=True)])
    stated = np.array([np.trace(covariance(a)[3:, 3:]) for a in answers])
    chi = np.array([nees(a, T) for T, a in zip(truth, answers, strict=True)])
    ratio = np.sqrt(e.mean() / stated.mean())
    print(
        f"from the front: tilt error {np.degrees(np.sqrt(e.mean())):.2f} deg, {ratio:.2f} times the stated",
        end=" ",
    )
    print(f"one, median NEES {np.median(chi):.2f}, {np.mean(chi < 12.6):.2f} below its 95 % quantile")
    assert 0.6 < ratio < 1.4
    assert 3.0 < np.median(chi) < 7.5
    assert np.mean(chi < 12.6) > 0.8


def test_a_mean_over_tilts_is_that_of_the_reference_and_has_no_second_pose(cfg, front_views):
    """Where two minima nearly meet, rounding decides which of them is found: one in ten may differ."""
    same, averaged = np.array([agrees(cfg, a) for a in front_views[1][:30]]).T
    assert np.sum(averaged) >= 20 and np.mean(same) > 0.85
    for a in (a for a, is_mean in zip(front_views[1], averaged, strict=False) if is_mean):
        assert a["p_alt_m"] == a["p_cam_tool_m"] and a["rms_alt_px"] == a["rms_px"]


def test_images_named_on_standard_input_are_answered_one_by_one(two_tags, tmp_path):
    cv2.imwrite(str(tmp_path / "two.png"), two_tags[0])
    [want] = detect(tmp_path / "two.png")
    run = subprocess.run(
        [TAGDET, "--config", CONFIG, "--image", "-"],
        input=f"{tmp_path / 'two.png'}\n" * 2,
        capture_output=True,
        text=True,
        check=True,
    )
    answers = [json.loads(line) for line in run.stdout.splitlines()]
    assert len(answers) == 2 and all(a | {"ms": 0} == want | {"ms": 0} for a in answers)


def test_pose_jacobian_agrees_with_differences(cfg):
    T = floating_pose(cfg, np.random.default_rng(4))
    points = np.vstack([pnp.tool_corners(t.T_tool_tag, t.size_m) for t in cfg.tags])
    J = corner_model.jacobian(cfg.K, T[:3, :3], T[:3, 3], points)
    h = 1e-6
    for k in range(6):
        d = np.zeros(6)
        d[k] = h
        plus, minus = (
            pnp.project(cfg.K, cv2.Rodrigues(s * d[3:])[0] @ T[:3, :3], T[:3, 3] + s * d[:3], points)
            for s in (1.0, -1.0)
        )
        assert np.allclose(J[:, k], ((plus - minus) / (2 * h)).ravel(), rtol=1e-6, atol=1e-4)


@pytest.fixture(scope="module")
def two_tags(body, cam):
    """A frame with both tags in sight, and its truth."""
    body.set(PARKED, 0.0, 0.6)
    T = transforms.transform(
        [0.02, -0.03, 1.0], (transforms.rot("z", 0.3) @ transforms.rot("x", 0.2))[:3, :3]
    )
    frame = cam.render(body.data, body.T_base_cam, body.T_base_cam @ T, np.random.default_rng(9))
    return frame, T


def test_partly_hidden_tag_is_left_out(cfg, two_tags, tmp_path):
    """Paint over the outer edge of tag 1, so that it still decodes with a corner in the wrong place."""
    frame, T = two_tags[0].copy(), two_tags[1]
    t = cfg.tags[1]
    corner = pnp.project(cfg.K, T[:3, :3], T[:3, 3], pnp.tool_corners(t.T_tool_tag, t.size_m))
    inward = (corner.mean(axis=0) - corner[3]) / np.linalg.norm(corner.mean(axis=0) - corner[3])
    cut = (corner[3] + 10.0 * inward).round().astype(int)
    along = np.array([-inward[1], inward[0]])
    quad = np.array(
        [cut + 30 * along, cut - 30 * along, cut - 30 * along - 30 * inward, cut + 30 * along - 30 * inward]
    )
    cv2.fillConvexPoly(frame, quad.round().astype(np.int32), 235, cv2.LINE_AA)
    cv2.imwrite(str(tmp_path / "cut.png"), frame)
    [a] = detect(tmp_path / "cut.png")
    assert a["n_tags"] == 1 and a["tag_id"] == [0, -1, -1, -1]
    assert np.linalg.norm(error(a, T)[:3]) < 2e-3
    assert a["corner_px"][8:] == [0.0] * 24


def test_a_tag_that_is_not_configured_is_counted_and_ignored(two_tags, tmp_path):
    text = CONFIG.read_text().replace("id: 1,", "id: 77,")
    (tmp_path / "other.yml").write_text(text)
    cv2.imwrite(str(tmp_path / "two.png"), two_tags[0])
    [a] = detect(tmp_path / "two.png", tmp_path / "other.yml")
    assert a["unknown_tags"] == 1 and a["n_tags"] == 1 and a["tag_id"][0] == 0


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (("fx_px: 1397.", ""), "'fx_px' is missing"),
        (("edge_sigma_px: 0.0", "edge_sigma_px: -0.0"), "out of range"),
        (("size_m: 0.06", "size_m: -0.06"), "tag 1"),
        (("xyz_m: [ 0.12, 0., -0.02 ]", "xyz_m: [ 0.12, 0. ]"), "three numbers"),
    ],
)
def test_bad_configuration_is_refused_by_name(change, message, tmp_path):
    bad = tmp_path / "bad.yml"
    bad.write_text(CONFIG.read_text().replace(*change))
    run = subprocess.run([TAGDET, "--config", bad, "--image", "x.png"], capture_output=True, text=True)
    assert run.returncode == 1 and message in run.stderr and "bad.yml" in run.stderr


def test_bad_command_line_shows_usage():
    for args in (["--url", "x"], ["--config", "x"], ["--config", CONFIG, "--frobnicate"], ["--config"]):
        run = subprocess.run([TAGDET, *args], capture_output=True, text=True)
        assert run.returncode == 2 and "usage:" in run.stderr
    missing = subprocess.run(
        [TAGDET, "--config", CONFIG, "--image", "nowhere.png"], capture_output=True, text=True
    )
    assert missing.returncode == 1 and "nowhere.png" in missing.stderr


# ---- over LCM ------------------------------------------------------------------------------------------


class Bench:
    """The detector as a process, and the simulator's side of the bus."""

    def __init__(self, log):
        port, self._port_lock = private_port()
        url = private_url(port)
        self.bus = lcm.LCM(url)
        self.detections, self.dones = [], []
        for name, kind, box in (
            ("KC_DETECTION", kcm.detection_t, self.detections),
            ("KC_TICK_DONE", kcm.tick_done_t, self.dones),
        ):
            self.bus.subscribe(name, lambda _, data, kind=kind, box=box: box.append(kind.decode(data)))
        self.process = subprocess.Popen([TAGDET, "--config", CONFIG, "--url", url, "--lockstep"], stderr=log)

    def until(self, condition, what: str, seconds: float = 10.0) -> None:
        deadline = time.monotonic() + seconds
        while not condition():
            left = deadline - time.monotonic()
            assert left > 0.0, f"waited {seconds} s for {what}"
            if select.select([self.bus.fileno()], [], [], left)[0]:
                self.bus.handle()

    def image(self, jpeg: bytes, t_us: int, seq: int) -> None:
        m = kcm.image_t()
        m.t_us, m.seq, m.width_px, m.height_px, m.n_bytes, m.jpeg = t_us, seq, 1920, 1080, len(jpeg), jpeg
        self.bus.publish("KC_IMAGE", m.encode())

    def tick(self, number: int) -> int:
        """Announce a tick, wait for the answer; gives n_published."""
        t = kcm.time_t()
        t.tick, t.now_us = number, number * 100_000
        before = len(self.dones)
        self.bus.publish("KC_TIME", t.encode())
        self.until(lambda: any(d.tick == number for d in self.dones[before:]), f"the answer to tick {number}")
        assert {d.who for d in self.dones} == {kcm.tick_done_t.WHO_DETECTOR}
        return self.dones[-1].n_published

    def close(self) -> int:
        self.process.terminate()
        return self.process.wait(10)

    def stop(self) -> None:
        if self.process.poll() is None:
            self.process.kill()
            self.process.wait()
        self._port_lock.close()


@pytest.fixture
def bench(tmp_path):
    with open(tmp_path / "tagdet.log", "w") as log:
        b = Bench(log)
        yield b
        b.stop()


def test_lockstep_answers_every_tick_after_its_images(bench, cam, two_tags, tmp_path):
    frame, T = two_tags
    jpeg = cam.encode(frame).data
    blank = cam.encode(np.full_like(frame, 80)).data
    # Given: it announces itself with tick 0 until time begins.
    bench.until(lambda: len(bench.dones) >= 2, "the announcement")
    assert {d.tick for d in bench.dones} == {0}
    # When an image comes before the tick, then its detection comes before the answer.
    bench.image(jpeg, t_us=100_000, seq=5)
    assert bench.tick(1) == 1
    [d] = bench.detections
    assert (d.t_us, d.seq, d.n_tags, list(d.tag_id)) == (100_000, 5, 2, [0, 1, -1, -1])
    assert np.linalg.norm(np.array(d.p_cam_tool_m) - T[:3, 3]) < 1e-3
    assert d.range_m == pytest.approx(np.linalg.norm(T[:3, 3]), abs=1e-3)
    assert np.hypot(d.u_px - 987.4, d.v_px - 497.6) < 1.0
    assert np.linalg.eigvalsh(covariance({"cov": d.cov})).min() > 0.0
    # A repeated tick is answered again with the same count; nothing is published twice.
    assert bench.tick(1) == 1 and len(bench.detections) == 1
    # An image without tags is answered too; a tick without images publishes nothing.
    bench.image(blank, t_us=200_000, seq=6)
    assert bench.tick(2) == 1
    assert (bench.detections[1].seq, bench.detections[1].n_tags) == (6, 0)
    assert list(bench.detections[1].q_cam_tool_wxyz) == [1.0, 0.0, 0.0, 0.0]
    assert bench.tick(3) == 0
    # A damaged image is reported and not answered.
    bench.image(b"not an image", t_us=400_000, seq=7)
    assert bench.tick(4) == 0 and len(bench.detections) == 2
    assert bench.close() == 0
    log = (tmp_path / "tagdet.log").read_text()
    assert "frame 7 dropped: not a JPEG" in log and "3 images, 1 with a pose" in log


def test_a_packet_that_lies_about_its_size_is_refused(bench, cam, two_tags, tmp_path):
    """Generated code would take n_bytes as it is: -1 was a crash, 2^31 - 1 an allocation of 2 GB."""
    frame, _ = two_tags
    jpeg = cam.encode(frame).data
    m = kcm.image_t()
    m.width_px, m.height_px, m.jpeg = 1920, 1080, jpeg[:1000]
    fixed = 32
    lies = [-1, -(2**31), 2**31 - 1, 0, 999, 1001]
    bench.until(lambda: len(bench.dones) >= 2, "the announcement")
    for n in lies:
        m.n_bytes = 1000
        packet = m.encode()
        bench.bus.publish("KC_IMAGE", packet[: fixed - 4] + n.to_bytes(4, "big", signed=True) + m.jpeg)
    m.n_bytes = -1
    whole = m.encode()
    short = [b"", whole[:7], whole[: fixed - 1], b"\0" * 100, whole[:fixed]]
    for packet in short:
        bench.bus.publish("KC_IMAGE", packet)
        bench.bus.publish("KC_TIME", packet)
    bench.image(jpeg, t_us=100_000, seq=5)
    assert bench.tick(1) == 1
    assert bench.detections[0].n_tags == 2
    refused = len(lies) + 2 * len(short)
    assert bench.close() == 0
    log = (tmp_path / "tagdet.log").read_text()
    assert f"{refused} messages refused" in log and "n_bytes is -1" in log


def test_a_jpeg_of_another_resolution_is_refused_before_it_takes_memory(bench, cam, two_tags, tmp_path):
    frame, _ = two_tags
    good = cam.encode(frame).data
    start = good.index(b"\xff\xc0") + 5
    huge = good[:start] + (32000).to_bytes(2, "big") * 2 + good[start + 4 : 300]
    other = [
        cv2.imencode(".jpg", frame[:-8])[1].tobytes(),
        cv2.imencode(".jpg", np.dstack([frame] * 3))[1].tobytes(),  # three components
        cv2.imencode(".jpg", frame, [cv2.IMWRITE_JPEG_PROGRESSIVE, 1])[1].tobytes(),
        cv2.imencode(".png", frame)[1].tobytes(),
    ]

    def peak_kb() -> int:
        text = Path(f"/proc/{bench.process.pid}/status").read_text()
        return int(text.split("VmHWM:")[1].split()[0])

    bench.until(lambda: len(bench.dones) >= 2, "the announcement")
    bench.image(good, t_us=100_000, seq=1)
    assert bench.tick(1) == 1
    before = peak_kb()
    for i in range(10):
        bench.image(huge, t_us=200_000, seq=10 + i)
    for jpeg in other:
        bench.image(jpeg, t_us=200_000, seq=30)
    assert bench.tick(2) == 0
    assert peak_kb() - before < 20_000
    bench.image(good, t_us=300_000, seq=40)
    assert bench.tick(3) == 1
    assert bench.close() == 0
    log = (tmp_path / "tagdet.log").read_text()
    assert "frame 10 dropped: the JPEG is 32000x32000, the configuration says 1920x1080" in log
    assert f"{10 + len(other)} messages refused" in log


# ---- fast mode -----------------------------------------------------------------------------------------


def test_fast_mode_has_the_noise_it_reports(cfg, body):
    rng = np.random.default_rng(12)
    chi, n = [], {1: 0, 2: 0}
    model = detection_model.DetectionModel(cfg, body.model)
    for i in range(240):
        if i % 2:
            body.set(PARKED, 0.0, 0.6)
            T = floating_pose(cfg, rng)
        elif i % 12 == 0:
            T = held = posture_in_view(cfg, body, rng)
            posture = body.data.qpos.copy()
        else:
            body.set(posture[:7], *posture[7:])
            T = held
        d = model.detect(body.data, body.T_base_cam, body.T_base_cam @ T, rng)
        n[d["n_tags"]] += 1
        chi.append(nees(d, T))
        again = kcm.detection_t()
        for name, value in d.items():
            setattr(again, name, value)
        assert kcm.detection_t.decode(again.encode()).n_tags == d["n_tags"]
    print(f"fast mode: mean NEES {np.mean(chi):.2f}, frames by number of tags {n}")
    assert np.mean(chi) == pytest.approx(6.0, rel=0.2)
    assert n[1] > 60 and n[2] >= 120


def mean_of_three(answers, T_cam_tool) -> float:
    """Mean square of the mean error of the frames of a resting scene, in units of what one frame reports."""
    root = np.linalg.cholesky(covariance(answers[0]))
    e = np.mean([error(a, T_cam_tool) for a in answers], axis=0)
    return float(np.mean(np.linalg.solve(root, e) ** 2))


def test_frames_of_a_resting_scene_share_noise_on_rendered_frames(cfg, body, cam, tmp_path):
    """Three independent frames would leave a third, one frame repeated all of it; flight counts on a half."""
    rng, paths, truth = np.random.default_rng(15), [], []
    for i in range(12):
        if i % 2:
            body.set(PARKED, 0.0, 0.6)
            truth.append(floating_pose(cfg, rng))
        else:
            truth.append(posture_in_view(cfg, body, rng))
        scene = cam.tags_radiance(body.data, body.T_base_cam, body.T_base_cam @ truth[-1])
        for k in range(3):
            frame = cam.encode(cam.expose_tags(scene, rng))
            paths.append(tmp_path / f"{i:02d}-{k}.jpg")
            paths[-1].write_bytes(frame.data)
    answers = detect(paths)
    scenes = [(answers[3 * i : 3 * i + 3], T) for i, T in enumerate(truth)]
    whole = [(a, T) for a, T in scenes if len({tuple(x["tag_id"]) for x in a}) == 1 and a[0]["n_tags"]]
    left = float(np.mean([mean_of_three(a, T) for a, T in whole]))
    print(f"rendered frames: three of a scene leave {left:.2f} of the variance that one reports")
    assert len(whole) >= 10
    assert 0.34 < left < 0.95


def test_frames_of_a_resting_scene_share_noise_in_the_fast_mode(cfg, body):
    rng, left = np.random.default_rng(16), []
    model = detection_model.DetectionModel(cfg, body.model)
    body.set(PARKED, 0.0, 0.6)
    for _ in range(150):
        T = floating_pose(cfg, rng)
        seen = [model.detect(body.data, body.T_base_cam, body.T_base_cam @ T, rng) for _ in range(3)]
        if len({d["n_tags"] for d in seen}) == 1 and seen[0]["n_tags"]:
            left.append(mean_of_three(seen, T))
    assert len(left) > 120
    assert np.mean(left) == pytest.approx(0.5, rel=0.15)


def test_pose_and_alternative_are_those_of_opencv(cfg):
    """The best and the next different one of what solvePnPRefineLM makes of all plane poses. It stops up to
    1e-5 short of a minimum, and Gauss-Newton goes on from there."""
    rng, others = np.random.default_rng(17), 0
    for i in range(60):
        T, tags = floating_pose(cfg, rng), cfg.tags[: 1 + i % 2]
        points = [pnp.tool_corners(t.T_tool_tag, t.size_m) for t in tags]
        px = [cv2.projectPoints(x, cv2.Rodrigues(T[:3, :3])[0], T[:3, 3], cfg.K, None)[0] for x in points]
        px = [x.reshape(4, 2) + 0.1 * rng.standard_normal((4, 2)) for x in px]
        starts = [s for tag, x in zip(tags, px, strict=True) for s in both_minima(cfg.K, tag, x)]
        fits = [exact_fit(cfg.K, *s, np.vstack(points), np.vstack(px)) for s in starts]
        best = min(fits, key=lambda fit: fit[0])
        different = [fit for fit in fits if np.linalg.norm(corner_model.vector(best[1].T @ fit[1])) > 0.01]
        other = min(different, key=lambda fit: fit[0], default=best)
        pose, information = pnp.Solver(cfg.K).solve(list(zip(tags, px, strict=True)))
        assert same_fit(best, (pose.rms_px, pose.R, pose.p_m))
        assert same_fit(other, (pose.rms_alt_px, pose.R_alt, pose.p_alt_m))
        J = corner_model.jacobian(cfg.K, pose.R, pose.p_m, np.vstack(points))
        assert np.allclose(information, J.T @ J, 1e-12, 1e-6)
        others += other is not best
    assert others >= 30


def test_corners_that_are_no_numbers_have_no_pose(cfg):
    tag = cfg.tags[0]
    assert pnp.Solver(cfg.K).solve([(tag, np.full((4, 2), np.nan))]) is None


def opencv_fit(K, R, p, points, px):
    """RMS [px], R, p [m] of a start refined by OpenCV alone."""
    rvec, tvec = cv2.Rodrigues(R)[0], p.reshape(3, 1).copy()
    until = (cv2.TERM_CRITERIA_EPS + cv2.TERM_CRITERIA_COUNT, 50, 1e-12)
    rvec, tvec = cv2.solvePnPRefineLM(points, px, K, None, rvec, tvec, until)
    seen = cv2.projectPoints(points, rvec, tvec, K, None)[0].reshape(-1, 2)
    return np.sqrt(np.mean((seen - px) ** 2)), cv2.Rodrigues(rvec)[0], tvec.ravel()


def exact_fit(K, R, p, points, px):
    """The same at the minimum."""
    _, R, p = opencv_fit(K, R, p, points, px)
    for _ in range(5):  # of 20 steps each: near a tag's front view they shrink slowly
        R, p, chi2, _ = corner_model.fit(K, R, p, points, px, np.eye(px.size))
    return np.sqrt(chi2 / px.size), R, p


def same_fit(wanted, got) -> bool:
    """To 1e-9 the same pose with the same residual."""
    return all(np.allclose(a, b, 0, 1e-9) for a, b in zip(wanted, got, strict=True))


def test_a_scene_that_has_moved_is_looked_at_anew(cfg, body):
    """The tags in view are kept while a scene rests, and no longer: camera and tool stay, a shape moves."""
    rng, model = np.random.default_rng(18), detection_model.DetectionModel(cfg, body.model)
    T = posture_in_view(cfg, body, rng)
    at, shape = (body.data, body.T_base_cam, body.T_base_cam @ T, rng), body.model.geom("pedestal").id
    away_m, before_lens_m = body.data.geom_xpos[shape].copy(), body.T_base_cam[:3, :3] @ (0.4 * T[:3, 3])
    for place_m, seen in (
        (away_m, True),
        (away_m, True),
        (body.T_base_cam[:3, 3] + before_lens_m, False),
        (away_m, True),
    ):
        body.data.geom_xpos[shape] = place_m
        assert (model.detect(*at)["n_tags"] > 0) == seen
    far = transforms.transform([0.0, 0.0, 6.0], np.eye(3))
    assert model.detect(body.data, body.T_base_cam, body.T_base_cam @ far, rng)["n_tags"] == 0


def test_fast_mode_isotropic_noise(body):
    iso = camera.load_config(detection={"noise": "isotropic"})
    rng = np.random.default_rng(13)
    body.set(PARKED, 0.0, 0.6)
    T = transforms.transform([0.0, 0.0, 1.0], np.eye(3))
    model = detection_model.DetectionModel(iso, body.model)
    made = [model.detect(body.data, body.T_base_cam, body.T_base_cam @ T, rng) for _ in range(500)]
    e = np.array([error(d, T) for d in made])
    want = np.array([0.5e-3] * 3 + [np.radians(0.2)] * 3)
    assert np.allclose(e.std(axis=0), want, rtol=0.15)
    assert np.allclose(covariance(made[0]), np.diag(want**2))


def test_fast_mode_sees_nothing_outside_the_image_or_from_behind(cfg, body):
    rng = np.random.default_rng(14)
    body.set(PARKED, 0.0, 0.6)
    model = detection_model.DetectionModel(cfg, body.model)
    outside = transforms.transform([1.2, 0.0, 1.0], np.eye(3))
    behind = transforms.transform([0.0, 0.0, 1.0], transforms.rot("y", np.pi)[:3, :3])
    far = transforms.transform([0.0, 0.0, 6.0], np.eye(3))
    back = transforms.transform([0.0, 0.0, -1.0], np.eye(3))
    for T in (outside, behind, far, back):
        d = model.detect(body.data, body.T_base_cam, body.T_base_cam @ T, rng)
        assert d["n_tags"] == 0 and d["tag_id"] == [-1] * 4


def test_fast_mode_sees_the_tags_that_the_detector_sees(frames):
    """With the tool on the arm: a tag that the fast mode calls visible is detected in the pixels."""
    found = sum(a["n_tags"] >= 1 for a in frames[1][FLOATING:])
    assert found >= 0.9 * HELD
