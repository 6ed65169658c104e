import os
import sys
from dataclasses import replace

import numpy as np
import pytest
import torch

from hybrid.cli import run
from learned.slf.atlas import PATTERN, ROOM, load_atlas
from learned.slf.boxes import first_hits
from learned.slf.optics import optics
from learned.slf.pack import Annotated, build_atlas, read_rgb
from learned.slf.patterns import USES, draw_patterns, numbers_for
from learned.slf.rooms.lines import room_geometry, room_strokes
from learned.slf.rooms.render import Renderer, RoomStudio, room_job, room_lenses
from learned.slf.rooms.scenes import draw_scene
from learned.slf.synthesis import SetCfg, true_camera

BLENDER_PYTHON = os.environ.get("STRAIGHTLENS_BLENDER_PYTHON", "")
needs_blender = pytest.mark.skipif(not BLENDER_PYTHON, reason="STRAIGHTLENS_BLENDER_PYTHON not set")


@pytest.fixture(scope="module")
def textures():
    blank = Annotated(np.full((16, 16, 3), 128, np.uint8), np.zeros((0, 4), np.float32), PATTERN)
    return build_atlas([*draw_patterns(11, seed=1), blank])


def scene_of(seed, uses=None):
    return draw_scene(np.random.default_rng(seed), uses or {u: numbers_for(u, 11) for u in USES})


def test_a_scene_is_the_same_for_the_same_generator():
    first, second = vars(scene_of(3)), vars(scene_of(3))
    for name, value in first.items():
        np.testing.assert_array_equal(value, second[name])


@pytest.mark.parametrize("seed", range(6))
def test_the_camera_stands_clear_of_furniture_and_walls(seed, textures):
    room = room_geometry(scene_of(seed), textures)
    rays = torch.nn.functional.normalize(
        torch.from_numpy(np.random.default_rng(0).normal(size=(300, 3))).float(), dim=1
    )
    depth, _, _ = first_hits(room.boxes, rays, torch.zeros(300, dtype=torch.int64))
    assert depth.min() > 0.1


def test_visible_lines_are_the_nearest_thing_on_their_ray(textures):
    room = room_geometry(scene_of(0), textures)
    lenses = room_lenses("equisolid", np.random.default_rng(0))
    strokes, segments = room_strokes(room, textures, optics(lenses, size=320), shortest_px=13.0)
    at = strokes.segment[strokes.run]
    points = torch.lerp(segments.start[at], segments.end[at], strokes.share[:, None])
    distance = points.norm(dim=1)
    depth, _, _ = first_hits(room.boxes, points / distance[:, None], torch.zeros_like(at))
    assert len(strokes.length) > 10
    assert (depth > 0.99 * distance - 0.02).all()


def test_lines_of_a_pavement_end_where_they_cannot_be_told_apart(textures):
    uses = {use: numbers_for(use, 11) for use in USES}
    scene = next(s for s in (scene_of(i, uses) for i in range(40)) if s.is_open)
    eye = float(scene.shell[1] - scene.position[1])
    level = replace(scene, rotation=np.eye(3))
    room = room_geometry(level, textures)
    lens = optics(room_lenses("equisolid", np.random.default_rng(0)), size=320)
    strokes, segments = room_strokes(room, textures, lens, shortest_px=13.0)
    at = strokes.segment[strokes.run]
    points = torch.lerp(segments.start[at], segments.end[at], strokes.share[:, None])
    on_ground = (points[:, 1] - eye).abs() < 1e-3
    distance = points[on_ground].norm(dim=1)
    assert (distance < 4 * eye).sum() > 100
    assert distance.quantile(0.9) < 5 * eye


def test_the_papers_lens_spans_what_fish_suncg_shows():
    lens = room_lenses("equisolid", np.random.default_rng(0))
    camera = true_camera(lens.vector[0], 320)
    rays, _ = camera.unproject(np.array([[-0.5, 159.5], [-0.5, -0.5]]))
    across, diagonal = 2 * np.degrees(np.arccos(rays[:, 2]))
    assert across == pytest.approx(121, abs=1)
    assert diagonal == pytest.approx(182, abs=1)


@needs_blender
@pytest.mark.slow
@pytest.mark.parametrize("prior", ["equisolid", "wild"])
def test_the_rendered_lens_meets_the_camera_model(prior, tmp_path, textures):
    # bright little cubes on a sphere around the camera: their centroids against the projection
    lenses = room_lenses(prior, np.random.default_rng(5))
    camera = true_camera(lenses.vector[0], 320)
    grid = np.array([[u, v] for u in range(24, 320, 34) for v in range(24, 320, 34)], float)
    rays, valid = camera.unproject(grid)
    inside = np.arccos(rays[:, 2]) < lenses.theta_max[0] - 0.05
    inside &= np.hypot(*((grid - 159.5) / 160).T) < lenses.circle[0] - 0.05
    inside &= np.abs(grid[:, 1] - 159.5) / 160 < lenses.half_height[0] - 0.05
    rays = rays[valid & inside]
    n = len(rays)
    scene = replace(
        scene_of(0, {}),
        centre=8.0 * rays,
        half=np.full((n, 3), 0.05),
        yaw=np.zeros(n),
        material=np.zeros(n, int),
        colour=np.full((1, 3), 0.8),
        roughness=np.ones(1),
        emission=np.full(1, 1.0),
        is_pane=np.zeros(1, bool),
        pattern=np.full(1, -1),
        tile=np.ones((1, 2)),
        shell=np.full(3, 100.0),
        shell_material=np.full(6, -1),
        lights=np.zeros((0, 6)),
        sky=0.0,
        exposure=0.0,
        position=np.zeros(3),
        rotation=np.eye(3),
        is_open=False,
    )
    files = [tmp_path / "fisheye.png", tmp_path / "straight.png"]
    with Renderer(BLENDER_PYTHON, samples=64, denoise=False) as renderer:
        studio = RoomStudio(textures, {}, renderer)
        config = SetCfg(prior, 320, 1)
        renderer.render(room_job(scene, lenses, studio, 0, config, files))
    picture = read_rgb(files[0]).astype(float).mean(axis=2)
    linear = np.where(
        picture < 10.3, picture / 12.92, ((picture / 255 + 0.055) / 1.055) ** 2.4 * 255
    )
    linear = np.maximum(linear - np.median(linear), 0)
    expected, _ = camera.project(rays)
    v, u = np.mgrid[0:320, 0:320]
    errors = []
    for x, y in expected:
        near = np.exp(-0.5 * (((u - x) ** 2 + (v - y) ** 2) / 9.0) ** 4) * linear
        errors.append(
            np.hypot((near * u).sum() / near.sum() - x, (near * v).sum() / near.sum() - y)
        )
    assert n > 20
    assert np.median(errors) < 0.05
    assert np.max(errors) < 0.1


# stands in for Blender: panoramas that depend on the job alone
RENDERER = """#!{python}
import json, sys
import cv2, numpy as np

for line in sys.stdin:
    job = json.loads(line)
    assert np.array_equal(job["scene"]["rotation"], np.eye(3))  # level
    rng = np.random.default_rng(job["seed"])
    cv2.imwrite(job["panorama"], rng.integers(0, 255, (job["size"], 2 * job["size"], 3), np.uint8))
    sys.stdout.write("@result " + json.dumps({{"index": job["index"], "error": None}}) + "\\n")
    sys.stdout.flush()
"""


def test_room_panoramas_are_made_once_and_packed_as_rooms(tmp_path, capsys):
    renderer, out, pack = tmp_path / "blender", tmp_path / "rooms", tmp_path / "rooms.pack"
    renderer.write_text(RENDERER.format(python=sys.executable))
    renderer.chmod(0o755)
    words = ["synthesize", "room-panoramas", "--blender-python", str(renderer), "--out", str(out)]
    words += ["--height", "64", "--workers", "1", "--count"]
    assert run([*words, "2"]) == 0
    first, second = out / "000000.png", out / "000001.png"
    made, time = second.read_bytes(), first.stat().st_mtime_ns
    second.unlink()
    assert run([*words, "2"]) == 0  # goes on, to the same bytes
    assert second.read_bytes() == made != first.read_bytes()
    assert first.stat().st_mtime_ns == time
    capsys.readouterr()
    assert run([*words, "1", "--seed", "2"]) == 2
    assert "expected panoramas made with" in capsys.readouterr().err
    assert (
        run(["synthesize", "pack", "--rooms", str(out), "--patterns", "0", "--out", str(pack)]) == 0
    )
    atlas = load_atlas(pack)
    assert atlas.kind.tolist() == [ROOM, ROOM]
    assert atlas.extent[0, 0].tolist() == [128, 64]
