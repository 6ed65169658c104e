import dataclasses
import math

import numpy as np
import pytest
import torch

from learned.slf.atlas import (
    PANORAMA,
    PHOTOGRAPH,
    ROOM,
    load_atlas,
    merged_atlas,
    sample,
    save_atlas,
)
from learned.slf.boxes import box_segments, box_visibility, render_boxes
from learned.slf.layouts import draw_boxes
from learned.slf.optics import optics, pixel_rays, plane_points, project, unproject
from learned.slf.pack import Annotated, build_atlas
from learned.slf.patterns import draw_patterns
from learned.slf.priors import lens_prior
from learned.slf.stream import SlfStream, StreamCfg
from learned.slf.strokes import Segments3D, bent_strokes, draw_line_map
from learned.slf.synthesis import true_camera

SIZE = 96


def globes(lines):
    """A dark panorama and a bright one of a room, both with the same lines."""
    rng = np.random.default_rng(0)
    for kind, low in ((PANORAMA, 0), (ROOM, 128)):
        picture = rng.integers(low, low + 128, (64, 128, 3), dtype=np.uint8)
        yield Annotated(picture, lines, kind)


@pytest.fixture(scope="module")
def atlas():
    """Drawn textures that play all parts: photographs, patterns, a panorama and a room."""
    drawn = list(draw_patterns(10, seed=3))
    photographs = [dataclasses.replace(p, kind=PHOTOGRAPH) for p in drawn[:6]]
    lines = np.array([[10, 20, 40, 30], [60, 32, 90, 20]], np.float32)
    return build_atlas([*photographs, *drawn[6:], *globes(lines)])


@pytest.fixture
def lens():
    lenses = lens_prior("wild").sample(np.random.default_rng(4), 3)
    return lenses, optics(lenses, size=320)


def test_batch_depends_on_seed_and_index_alone(atlas):
    first = SlfStream(atlas, 7, 3, SIZE).batch(5)
    iterator = SlfStream(atlas, 7, 3, SIZE).starting_at(4)
    next(iterator)
    again = next(iterator)
    for name, value in vars(first).items():
        twin = getattr(again, name)
        assert value is twin is None or torch.equal(value, twin), name


def test_other_seed_or_index_gives_another_batch(atlas):
    first = SlfStream(atlas, 7, 2, SIZE).batch(0)
    assert not torch.equal(first.image, SlfStream(atlas, 8, 2, SIZE).batch(0).image)
    assert not torch.equal(first.image, SlfStream(atlas, 7, 2, SIZE).batch(1).image)


@pytest.mark.parametrize("scene", [tuple(row) for row in np.eye(4).tolist()])
def test_batch_has_the_documented_ranges(atlas, scene):
    batch = SlfStream(atlas, 1, 4, SIZE, StreamCfg(scenes=scene)).batch(0)
    for picture in (batch.image, batch.rectified, batch.line_map):
        assert picture.min() >= 0
        assert picture.max() <= 1
    assert batch.line_map.shape == (4, 1, SIZE, SIZE)
    assert torch.equal(batch.k[:, 5], torch.ones(4))
    assert (batch.theta_max > 0.5).all()


@pytest.mark.parametrize(("share", "expected"), [(0.0, (0, 0)), (0.25, (5, 15)), (1.0, (40, 40))])
def test_a_share_of_the_groups_stays_without_camera_effects(atlas, share, expected):
    """Of 40 groups of two: how many are as without photometry, to the last bit."""
    planes = (1.0, 0.0, 0.0, 0.0)
    config = StreamCfg(planes, group=2, with_rectified=False, clean_share=share)
    image, clean = (
        SlfStream(atlas, 5, 80, 32, each).batch(0).image
        for each in (config, dataclasses.replace(config, photometry=None))
    )
    same = (image == clean).flatten(1).all(1).view(40, 2)
    assert torch.equal(same[:, 0], same[:, 1])  # a group is clean as a whole
    assert expected[0] <= int(same[:, 0].sum()) <= expected[1]


def test_panoramas_and_rooms_are_shares_of_their_own(atlas):
    clean = StreamCfg(scenes=(0.0, 0.0, 1.0, 0.0), photometry=None)
    rooms = dataclasses.replace(clean, scenes=(0.0, 0.0, 0.0, 1.0))
    dark, bright = (SlfStream(atlas, 1, 4, SIZE, cfg).batch(0).image for cfg in (clean, rooms))
    assert 0 < dark.max() < 0.51
    assert bright[bright > 0].median() > 0.6


@pytest.mark.parametrize(
    "scenes", [(0.0,) * 4, (0.0, 0.0, 1.0, 0.0), (0.0, 0.0, 0.0, 1.0), (math.nan, 1.0, 0.0, 0.0)]
)
def test_scenes_without_a_picture_are_told_before_the_first_batch(scenes):
    flat = build_atlas([dataclasses.replace(p, kind=PHOTOGRAPH) for p in draw_patterns(2, seed=3)])
    with pytest.raises(ValueError, match="expected scenes"):
        SlfStream(flat, 1, 4, SIZE, StreamCfg(scenes=scenes))


def test_strokes_are_the_projection_of_straight_lines(lens):
    lenses, seen = lens
    rng = np.random.default_rng(1)
    ahead = np.array([0, 0, 1.0])
    ends = torch.from_numpy(rng.normal(size=(2, 60, 3)) + ahead).float()
    segments = Segments3D(ends[0], ends[1], torch.arange(60) // 20)
    strokes = bent_strokes(seen, segments)
    camera = [true_camera(v, 320) for v in lenses.vector]
    assert len(strokes.length) > 10
    for run in range(len(strokes.length)):
        points = strokes.points[strokes.run == run].double().numpy()
        i, row = int(strokes.segment[run]), int(strokes.row[run])
        start, end = (x[i].double().numpy() for x in (segments.start, segments.end))
        plane = np.cross(start, end)
        rays, _ = camera[row].unproject(points)
        # distance from the line's image: out-of-plane angle times pixels per radian
        off = np.abs(rays @ (plane / np.linalg.norm(plane))) * lenses.vector[row, 0] * 160 * 2
        assert off.max() < 0.1


def test_line_map_has_the_clipped_length_within_a_pixel_and_zero_elsewhere():
    lenses = lens_prior("paper").sample(np.random.default_rng(0), 1)
    seen = optics(lenses, size=320)
    segments = Segments3D(
        torch.tensor([[-0.3, 0.2, 1.0]]), torch.tensor([[0.1, 0.25, 1.0]]), torch.zeros(1).long()
    )
    strokes = bent_strokes(seen, segments)
    drawn = draw_line_map(strokes, batch=1, size=320)[0, 0]
    v, u = torch.meshgrid(torch.arange(320.0), torch.arange(320.0), indexing="ij")
    pixels = torch.stack([u, v], -1).reshape(-1, 2)
    distance = torch.cdist(pixels, strokes.points).amin(1).view(320, 320)
    value = float(strokes.length[0].clamp_max(255) / 255)
    steps = strokes.points[1:] - strokes.points[:-1]
    assert float(strokes.length[0]) == pytest.approx(float(steps.norm(dim=1).sum()), rel=1e-4)
    torch.testing.assert_close(
        drawn[distance < 0.85], torch.full_like(drawn[distance < 0.85], value)
    )
    assert (drawn[distance > 1.13] == 0).all()


def test_long_lines_are_clipped_to_one():
    lenses = lens_prior("paper").sample(np.random.default_rng(0), 1)
    ends = torch.tensor([[-0.9, 0.0, 1.0], [0.9, 0.0, 1.0]])
    segments = Segments3D(ends[:1], ends[1:], torch.zeros(1).long())
    strokes = bent_strokes(optics(lenses, size=320), segments)
    assert float(strokes.length[0]) > 255
    assert draw_line_map(strokes, batch=1, size=320).max() == 1


def test_pixel_rays_project_back_to_their_pixels(lens):
    _, seen = lens
    rays, valid = pixel_rays(seen)
    for row in range(len(seen)):
        at = torch.nonzero(valid[row])[::97]
        chosen = rays[row, :, at[:, 0], at[:, 1]].T
        points, inside = project(seen, chosen, torch.full((len(at),), row))
        assert inside.float().mean() > 0.99
        assert (points - at.flip(1)).abs().max() < 0.02


@pytest.mark.parametrize("size", [64, 63])
@pytest.mark.parametrize("shift", [0.0, 0.07])
def test_plane_points_are_where_the_rays_meet_the_plane(size, shift):
    """The quarter of a centred lens is unfolded, others are made as a whole."""
    lenses = lens_prior("paper").sample(np.random.default_rng(0), 3)
    lenses.vector[:, 7] = shift
    lenses.half_height[1] = 0.8
    seen = optics(lenses, size=size)
    rays, valid = pixel_rays(seen)
    points = plane_points(seen)
    ahead = valid & (rays[:, 2] > 0.55)
    expected = rays[:, :2] / rays[:, 2:]
    np.testing.assert_allclose(
        points.movedim(1, 3)[ahead], expected.movedim(1, 3)[ahead], atol=2e-4
    )
    assert (points.abs().amax(dim=1)[~valid] > 1.0).all()


def test_pictures_do_not_depend_on_how_many_are_rendered_together(atlas):
    config = StreamCfg(photometry=None)
    one, many = (
        SlfStream(atlas, 3, 8, SIZE, dataclasses.replace(config, together=n)).batch(0)
        for n in (1, 8)
    )
    assert (one.image - many.image).abs().max() < 2 / 255
    assert torch.equal(one.line_map, many.line_map)


def test_unproject_inverts_project(lens):
    _, seen = lens
    pixels = torch.rand(200, 2) * 100 + 110
    row = torch.zeros(200, dtype=torch.int64)
    rays, _ = unproject(seen, pixels, row)
    points, _ = project(seen, rays, row)
    assert (points - pixels).abs().max() < 0.01


def test_lines_behind_a_box_are_not_drawn(atlas):
    rng = np.random.default_rng(2)
    boxes = draw_boxes(rng, atlas, atlas.of_kind(0), atlas.of_kind(1), 1)
    ahead = boxes.rotation[0, :, 2]
    boxes.centre[0, 1:] = 100.0
    boxes.centre[0, 1] = boxes.position[0] + 0.8 * ahead
    boxes.half[0, 1:] = 0.0
    boxes.half[0, 1] = 0.1
    points = torch.tensor([[0.0, 0.0, 1.5], [0.0, 0.0, 0.3], [1.5, 0.0, 0.1]])
    seen = box_visibility(boxes, points, torch.zeros(3, dtype=torch.int64))
    assert seen.tolist() == [False, True, True]


def test_a_point_of_a_face_is_drawn_where_it_projects(atlas):
    # a picture with one white texel block on one wall: it must appear at its projection
    lenses = lens_prior("paper").sample(np.random.default_rng(1), 1)
    seen = optics(lenses, size=320)
    image = np.zeros((200, 200, 3), np.uint8)
    image[118:123, 78:83] = 255
    dots = build_atlas([Annotated(image, np.array([[80, 120, 180, 120]], np.float32))])
    boxes = draw_boxes(
        np.random.default_rng(0), dots, torch.tensor([0]), torch.tensor([], dtype=torch.int64), 1
    )
    boxes.half[0, 1:] = 0
    boxes.half[0, 0] = torch.tensor([2.0, 2.0, 2.0])
    boxes.tile[:] = 4.0
    boxes.offset[:] = 0.0
    boxes.shade[:] = 1.0
    boxes.position[:] = 0.0
    boxes.rotation[0] = torch.eye(3)
    picture = render_boxes(dots, boxes, seen, pixel_rays(seen)[0])[0].mean(0)
    segments = box_segments(dots, boxes)
    start = segments.start[torch.isclose(segments.start[:, 2], torch.tensor(2.0))]
    where, _ = project(seen, start, torch.zeros(len(start), dtype=torch.int64))
    v, u = torch.meshgrid(torch.arange(320.0), torch.arange(320.0), indexing="ij")
    centroid = torch.stack([(picture * u).sum(), (picture * v).sum()]) / picture.sum()
    assert (where - centroid).norm(dim=1).min() < 0.15


def test_sampling_a_texel_centre_gives_the_texel(atlas):
    width, height = atlas.extent[2, 0].tolist()
    u, v = torch.tensor([5.0, width - 1.0]), torch.tensor([9.0, height - 1.0])
    found = sample(atlas, torch.full((2,), 2), u, v, torch.zeros(2, dtype=torch.int64))
    image = atlas.image(2)
    torch.testing.assert_close(found[:, 0], image[:, 9, 5])
    torch.testing.assert_close(found[:, 1], image[:, -1, -1])


def test_pack_survives_the_disk_and_merging(atlas, tmp_path):
    save_atlas(atlas, tmp_path / "a.pack")
    both = merged_atlas([atlas, load_atlas(tmp_path / "a.pack")])
    n = len(atlas)
    assert len(both) == 2 * n
    assert torch.equal(both.image(n + 3), atlas.image(3))
    lines = [x.segments[x.first[i] : x.first[i + 1]] for x, i in ((both, n + 3), (atlas, 3))]
    assert torch.equal(*lines)


def test_a_foreign_file_is_no_pack(tmp_path):
    from safetensors.torch import save_file

    save_file({"x": torch.zeros(1)}, tmp_path / "x")
    with pytest.raises(ValueError, match="pack"):
        load_atlas(tmp_path / "x")
