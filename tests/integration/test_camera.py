"""Rendered frames: geometry, occlusion, light, noise and size. Oracle: the pinhole formula."""

import cv2
import mujoco
import numpy as np
import pytest

from kincal_shared.errors import BadInput
from kincal_sim import transforms
from kincal_sim.mechanics import arm
from kincal_sim.vision import camera, detection_model, tags

SPHERES = 30


def scene(bodies: str, light: str = '<light type="directional" dir="0 0 1" diffuse=".7 .7 .7"/>'):
    """A bare model: black sky, one light along +z of the world, the camera looking along +z."""
    model = mujoco.MjModel.from_xml_string(f"""
    <mujoco><visual><headlight ambient=".2 .2 .2" diffuse="0 0 0" specular="0 0 0"/>
      <quality offsamples="0"/></visual>
      <worldbody>{light}{bodies}</worldbody></mujoco>""")
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    return model, data


@pytest.fixture(scope="module")
def cfg():
    return camera.load_config()


def frontal(x_m=0.0, y_m=0.0, z_m=1.0, turn_deg=0.0):
    """Tool pose in a camera that stands in the world frame: tags seen from the front."""
    return transforms.trans(x_m, y_m, z_m) @ transforms.rot("z", np.radians(turn_deg))


def radiance(cfg, bodies, T_cam_tool, **kwargs):
    model, data = scene(bodies, **kwargs)
    cam = camera.Camera(cfg, model)
    try:
        return cam.radiance(data, np.eye(4), T_cam_tool), model, data
    finally:
        cam.close()


BEHIND = transforms.trans(0.0, 0.0, -5.0)


def test_spheres_appear_where_the_pinhole_formula_puts_them(cfg):
    rng = np.random.default_rng(3)
    # On a grid, so that no two touch in the image.
    places = [
        np.array([0.17 * (i % 6 - 2.5), 0.12 * (i // 6 - 2), 1.2]) + rng.uniform(-0.03, 0.03, 3)
        for i in range(SPHERES)
    ]
    bodies = "".join(
        f'<geom type="sphere" size="0.006" pos="{x} {y} {z}" rgba="1 1 1 1"/>' for x, y, z in places
    )
    light = '<light type="directional" dir="0 0 1" diffuse="0 0 0" ambient="1 1 1" castshadow="false"/>'
    frame, _, _ = radiance(cfg, bodies, BEHIND, light=light)
    _, _, _, centres = cv2.connectedComponentsWithStats((frame > 128).astype(np.uint8))
    off = []
    for place in places:
        want = (cfg.K @ place)[:2] / place[2]
        off.append(centres[1:][np.argmin(np.linalg.norm(centres[1:] - want, axis=1))] - want)
    # One blob is drawn without antialiasing, so its centre is only good to a tenth of a pixel.
    assert np.abs(np.mean(off, axis=0)).max() < 0.03
    assert np.sqrt(np.mean(np.square(off))) < 0.1


def test_tag_is_drawn_on_its_own_plate(cfg):
    """MuJoCo draws a bright square exactly where the tag's black square is printed: the edges agree."""
    tag = cfg.tags[0]
    T = frontal(0.1, -0.05, 1.1, 20.0) @ tag.T_tool_tag
    q = transforms.quaternion(T)
    plate = (
        f'<geom type="box" size="{tag.size_m / 2} {tag.size_m / 2} 1e-5" pos="{T[0, 3]} {T[1, 3]} {T[2, 3]}" '
        f'quat="{q[0]} {q[1]} {q[2]} {q[3]}"/>'
    )
    light = '<light type="directional" dir="0 0 1" diffuse="0 0 0" ambient="1 1 1" castshadow="false"/>'
    with_plate, _, _ = radiance(cfg, plate, BEHIND, light=light)
    with_tag, _, _ = radiance(cfg, "", frontal(0.1, -0.05, 1.1, 20.0), light=light)
    square = with_plate > 64
    # All of the printed black frame lies inside the plate; outside it is white border or black sky.
    ys, xs = np.nonzero(square)
    box = (slice(ys.min(), ys.max() + 1), slice(xs.min(), xs.max() + 1))
    inner = cv2.erode(square.astype(np.uint8), np.ones((3, 3))) > 0
    outer = cv2.dilate(square.astype(np.uint8), np.ones((3, 3))) > 0
    rim_in = inner & ~(cv2.erode(inner.astype(np.uint8), np.ones((3, 3))) > 0)
    rim_out = (cv2.dilate(outer.astype(np.uint8), np.ones((3, 3))) > 0) & ~outer
    assert with_tag[rim_in].max() < 60.0
    assert with_tag[rim_out].min() > 180.0
    assert square[box].mean() > 0.5


def test_thing_in_front_hides_the_tag_and_thing_behind_does_not(cfg):
    T = frontal(0.0, 0.0, 1.0)
    left = '<geom type="box" size="0.1 0.2 0.01" pos="-0.16 0 {z}" rgba=".5 .5 .5 1"/>'
    free, _, _ = radiance(cfg, left.format(z=3.0), T)
    hidden, _, _ = radiance(cfg, left.format(z=0.7), T)
    bare, _, _ = radiance(cfg, left.format(z=0.7), BEHIND)
    edge = int(cfg.K[0, 2] + cfg.K[0, 0] * -0.06 / 0.7)  # right edge of the box in the image
    assert np.abs(hidden[:, : edge - 8] - bare[:, : edge - 8]).max() < 1.5
    assert not np.array_equal(hidden, bare)  # tag 0, on the right, is still there
    right = slice(int(cfg.K[0, 2]) + 40, int(cfg.K[0, 2]) + 180)
    assert np.abs(hidden[:, right] - free[:, right]).max() < 1e-3
    seen = detection_model.visible_tags(cfg, *scene(left.format(z=0.7)), np.eye(4), T)
    assert [v.tag.id for v in seen] == [0]


def test_edge_of_a_hiding_thing_is_smooth(cfg):
    """Half covered pixels of the occluder's edge are mixed, not switched."""
    bar = '<geom type="box" size="0.004 0.3 0.001" pos="0.0857 0 0.7" euler="0 0 7" rgba="1 1 1 1"/>'
    frame, _, _ = radiance(cfg, bar, frontal(0.0, 0.0, 1.0))
    u, v = (cfg.K @ [0.0857, 0.0, 0.7])[:2] / 0.7
    patch = frame[int(v) - 30 : int(v) + 30, int(u) - 14 : int(u) + 15]
    assert len(np.unique(np.round(patch))) > 20


def test_tag_seen_from_behind_is_not_drawn(cfg):
    away = frontal() @ transforms.rot("y", np.pi)
    frame, _, _ = radiance(cfg, "", away)
    assert frame.max() == 0.0


def test_tag_is_darker_at_grazing_light_and_in_shadow(cfg):
    T = frontal(0.0, 0.0, 1.0)
    white = {}
    for name, light, bodies in (
        ("frontal", "0 0 1", ""),
        ("grazing", "0 2 1", ""),
        ("shadow", "0 2 1", '<geom type="box" size=".4 .01 .4" pos="0 -0.45 0.9"/>'),
    ):
        lamp = f'<light type="directional" dir="{light}" pos="0 -2 0" diffuse=".7 .7 .7" castshadow="true"/>'
        frame, _, _ = radiance(cfg, bodies, T, light=lamp)
        u, v = (cfg.K @ [0.12, 0.0, 1.0 - 0.02])[:2] / (1.0 - 0.02)
        white[name] = frame[int(v) - 60 : int(v) + 60, int(u) - 60 : int(u) + 60].max()
    assert white["frontal"] > 1.2 * white["grazing"] > 1.2 * 1.2 * white["shadow"] > 0.0


def test_noise_is_as_configured_and_repeats_with_its_seed(cfg):
    """The first two frames are of one drawing; before the last, a tag has come and gone."""
    model, data = scene('<geom type="plane" size="9 9 .1" pos="0 0 3" euler="180 0 0" rgba=".6 .6 .6 1"/>')
    cam = camera.Camera(cfg, model)
    a, b, tag, again = (
        cam.render(data, np.eye(4), tool, np.random.default_rng(s)).astype(float)
        for s, tool in ((1, BEHIND), (2, BEHIND), (1, frontal()), (1, BEHIND))
    )
    cam.close()
    assert np.array_equal(a, again) and not np.array_equal(a, tag)
    level = a[400:700, 800:1100].mean()
    want = np.hypot(cfg.optics["read_noise_dn"], np.sqrt(level / cfg.optics["electrons_per_dn"]))
    patch = (a - b)[400:700, 800:1100] / np.sqrt(2.0)
    assert 60.0 < level < 230.0
    assert patch.std() == pytest.approx(np.hypot(want, np.sqrt(1 / 12)), rel=0.03)


def test_lens_blur_has_the_configured_width():
    """Across a sharp edge the grey value follows the error function of the blur."""
    quiet = camera.load_config(optics={"read_noise_dn": 0.0, "electrons_per_dn": 1e9, "psf_sigma_px": 1.2})
    model, data = scene('<geom type="box" size="1 1 .01" pos="1 0 1" rgba=".9 .9 .9 1"/>')
    cam = camera.Camera(quiet, model)
    frame = cam.render(data, np.eye(4), BEHIND, np.random.default_rng(0)).astype(float)
    cam.close()
    edge = np.diff(frame[540, 940:980]).clip(0)
    x = np.arange(edge.size)
    mean = (edge * x).sum() / edge.sum()
    assert np.sqrt((edge * (x - mean) ** 2).sum() / edge.sum()) == pytest.approx(1.2, abs=0.15)


def test_quality_gives_way_to_the_size_limit(cfg):
    model, _ = scene("")
    cam = camera.Camera(cfg, model)
    plain = np.full((1080, 1920), 90, np.uint8)
    busy = np.clip(np.random.default_rng(0).normal(128, 4, (1080, 1920)), 0, 255).astype(np.uint8)
    hopeless = np.random.default_rng(0).integers(0, 256, (1080, 1920), np.uint8)
    first, second = cam.encode(plain), cam.encode(busy)
    with pytest.raises(ValueError, match="does not fit"):
        cam.encode(hopeless)
    cam.close()
    assert first.quality == cfg.image["jpeg_quality"] > second.quality
    assert max(len(first.data), len(second.data)) <= cfg.image["max_jpeg_bytes"]
    assert cv2.imdecode(np.frombuffer(second.data, np.uint8), cv2.IMREAD_GRAYSCALE).shape == (1080, 1920)


def test_arm_frame_looks_like_a_landing_site(cfg):
    """Ice, arm and tag are all there: a frame of the real model has grey of every kind."""
    body = arm.Arm()
    q = np.array([0.2, -0.5, 0.0, 2.0, 0.0, 0.3, 0.0])
    body.set(q)
    body.set(q, *camera.aim(body.spec, body.T_base_tool[:3, 3]))
    cam = camera.Camera(cfg, body.model)
    frame = cam.render(body.data, body.T_base_cam, body.T_base_tool, np.random.default_rng(1))
    jpeg = cam.encode(frame)
    cam.close()
    assert frame.shape == (1080, 1920) and frame.dtype == np.uint8
    assert np.percentile(frame, 1) < 60 and np.percentile(frame, 99) > 120
    assert np.mean(frame >= 250) < 0.01  # nothing washed out
    assert jpeg.quality >= 60


def test_aim_brings_a_point_to_the_image_centre(cfg):
    body = arm.Arm()
    for p in ([0.6, 0.2, 0.5], [0.4, -0.4, 0.2], [0.9, 0.5, 0.8]):
        body.set(np.zeros(7), *camera.aim(body.spec, p))
        x = np.linalg.inv(body.T_base_cam) @ [*p, 1.0]
        assert (cfg.K @ x[:3])[:2] / x[2] == pytest.approx([959.5, 539.5], abs=1e-6)


def test_bitmaps_have_white_rim_black_frame_and_differ():
    first, second = tags.bitmap(0), tags.bitmap(1)
    for cells in (first, second):
        assert cells[0].all() and cells[-1].all() and cells[:, 0].all() and cells[:, -1].all()
        assert not cells[1, 1:-1].any() and not cells[1:-1, 1].any()
    assert not np.array_equal(first, second)
    with pytest.raises(ValueError, match="0..586"):
        tags.bitmap(587)


def test_unknown_setting_is_refused():
    with pytest.raises(BadInput, match="optics.psf: unknown key"):
        camera.load_config(optics={"psf": 1.0})
    with pytest.raises(BadInput, match='detection.noise: is "pink"; write "corners" or "isotropic"'):
        camera.load_config(detection={"noise": "pink"})
