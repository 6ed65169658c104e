"""Boards before the lens: where they are drawn, what they hide, what their lines are."""

import dataclasses

import numpy as np
import pytest
import torch
from click.testing import CliRunner

from learned.slf.atlas import BOARD, PANORAMA, PHOTOGRAPH, load_atlas
from learned.slf.boards import (
    Boards,
    Held,
    board_segments,
    board_visibility,
    draw_boards,
    lay_boards,
)
from learned.slf.commands import synthesize
from learned.slf.optics import optics, pixel_rays, project
from learned.slf.pack import Annotated, build_atlas
from learned.slf.patterns import draw_patterns, draw_targets
from learned.slf.priors import lens_prior
from learned.slf.stream import SlfStream, StreamCfg

SIZE = 96


@pytest.fixture(scope="module")
def atlas():
    """Photographs, patterns, a dark panorama and drawn boards."""
    drawn = list(draw_patterns(8, seed=3))
    photographs = [dataclasses.replace(p, kind=PHOTOGRAPH) for p in drawn[:4]]
    lines = np.array([[10, 20, 40, 30], [60, 32, 90, 20]], np.float32)
    dark = Annotated(np.full((64, 128, 3), 20, np.uint8), lines, PANORAMA)
    return build_atlas([*photographs, *drawn[4:], dark, *draw_targets(10, seed=2)])


@pytest.fixture(scope="module")
def lens():
    return optics(lens_prior("wild").sample(np.random.default_rng(4), 1), size=320)


def frontal(picture: int, half: tuple[float, float] = (0.4, 0.3)) -> Boards:
    """A board in the middle, facing the lens."""
    return Boards(torch.tensor([picture]), torch.eye(3)[None], torch.tensor([half]), torch.ones(1))


def test_a_board_is_drawn_where_it_projects(lens):
    """One white block of the picture appears at its projection, and its line begins there."""
    image = np.zeros((300, 400, 3), np.uint8)
    image[198:203, 278:283] = 255
    line = np.array([[280, 200, 100, 200]], np.float32)
    dots = build_atlas([Annotated(image, line, BOARD)])
    board = frontal(0)
    picture = torch.zeros(1, 3, 320, 320)
    lay_boards(dots, board, lens, pixel_rays(lens)[0], picture)
    v, u = torch.meshgrid(torch.arange(320.0), torch.arange(320.0), indexing="ij")
    grey = picture[0].mean(0)
    centroid = torch.stack([(grey * u).sum(), (grey * v).sum()]) / grey.sum()
    segments = board_segments(dots, board)
    where, _ = project(lens, segments.start[:1], segments.row[:1])
    assert len(segments) == 5  # its line and its four sides
    assert (where[0] - centroid).norm() < 0.15


def test_a_board_covers_what_its_sides_enclose_and_nothing_else(atlas, lens):
    white = build_atlas([Annotated(np.full((40, 40, 3), 255, np.uint8), np.empty((0, 4)), BOARD)])
    board = frontal(0, (0.5, 0.2))
    rays, _ = pixel_rays(lens)
    picture = torch.zeros(1, 3, 320, 320)
    lay_boards(white, board, lens, rays, picture)
    x, y = rays[0, 0] / rays[0, 2], rays[0, 1] / rays[0, 2]
    off = torch.maximum(x.abs() / 0.5, y.abs() / 0.2)
    ahead = rays[0, 2] > 0
    assert (picture[0, 0][(off < 0.93) & ahead] == 255).all()
    assert (picture[0, 0][(off > 1.07) | ~ahead] == 0).all()


def test_a_board_hides_points_behind_it_but_not_those_beside_or_back():
    board = frontal(0)
    points = torch.tensor([[0.0, 0.0, 3.0], [1.5, 0.0, 3.0], [0.0, 0.0, -3.0], [0.9, 0.8, 3.0]])
    seen = board_visibility(board, points, torch.zeros(4, dtype=torch.int64))
    assert seen.tolist() == [False, True, True, False]


def test_poses_are_rotations_before_the_lens(atlas):
    rng = np.random.default_rng(1)
    boards = draw_boards(rng, atlas, atlas.of_kind(BOARD), atlas.of_kind(PHOTOGRAPH), 400)
    right, down, middle = boards.pose.unbind(2)
    assert torch.allclose((right * down).sum(1), torch.zeros(400), atol=1e-5)
    assert torch.allclose(middle.norm(dim=1), torch.ones(400), atol=1e-5)
    away = torch.linalg.cross(right, down)
    assert ((away * middle).sum(1) > 0.4).all()  # its face is towards the lens
    assert (middle[:, 2] > 0.4).all()
    assert 0.5 < (down[:, 1] > 0.8).float().mean() < 0.95  # most are upright
    photographs = torch.isin(boards.picture, atlas.of_kind(PHOTOGRAPH)).float().mean()
    assert 0.2 < photographs < 0.4


@pytest.mark.parametrize("scenes", [(0.0, 1.0, 0.0, 0.0), (0.0, 0.0, 1.0, 0.0)])
def test_boards_come_before_boxes_and_panoramas_alike(atlas, scenes):
    without = StreamCfg(scenes=scenes, photometry=None)
    with_boards = dataclasses.replace(without, board_share=1.0)
    plain, held = (SlfStream(atlas, 3, 4, SIZE, cfg).batch(0) for cfg in (without, with_boards))
    assert torch.equal(plain.k, held.k)  # the lenses are nobody's business
    for row in range(4):
        assert not torch.equal(plain.image[row], held.image[row])
    assert not torch.equal(plain.line_map, held.line_map)


def test_boards_hide_lines_of_their_own_samples_alone():
    """Of three samples the first and the last have a board, of which the last one's is small."""
    two = Boards(
        torch.tensor([0, 0]),
        torch.eye(3).expand(2, 3, 3),
        torch.tensor([[0.4, 0.3], [0.1, 0.1]]),
        torch.ones(2),
    )
    held = Held(two, torch.tensor([0, -1, 1]))
    points = torch.tensor([[0.6, 0.0, 3.0], [0.0, 0.0, 3.0]]).repeat(3, 1)
    row = torch.tensor([0, 0, 1, 1, 2, 2])
    expected = torch.tensor([False, False, True, True, True, False])
    assert torch.equal(held.seen(points, row, scene=None), expected)
    nothing = held.seen(points, row, scene=lambda points, row: torch.zeros(len(row)).bool())
    assert not nothing.any()
    last = held.before(torch.tensor([1, 2]))
    assert last.rows.tolist() == [1]
    assert torch.equal(last.seen(points[2:], row[2:] - 1, scene=None), expected[2:])
    assert held.before(torch.tensor([1])).boards is None


@pytest.mark.parametrize("share", [0.0, 1.0])
def test_which_samples_have_a_board_is_told_where_the_pictures_are(atlas, share):
    """On a GPU, too, where samples are numbered; `meta` stands in for one."""
    config = StreamCfg(board_share=share)
    elsewhere = dataclasses.replace(atlas, texels=atlas.texels.to("meta"))
    stream = SlfStream(elsewhere, 1, 4, SIZE, config)
    held = stream._held(np.array([0, 1, 2]), 0)  # pyright: ignore[reportPrivateUsage]
    assert held.number.device.type == "meta"
    assert (held.boards is None) == (share == 0.0)


def test_no_board_comes_before_a_photograph_as_a_plane(atlas):
    planes = StreamCfg(scenes=(1.0, 0.0, 0.0, 0.0))
    plain, held = (
        SlfStream(atlas, 3, 4, SIZE, cfg).batch(0)
        for cfg in (planes, dataclasses.replace(planes, board_share=1.0))
    )
    assert torch.equal(plain.image, held.image)


def test_pictures_with_boards_do_not_depend_on_how_many_are_rendered_together(atlas):
    config = StreamCfg(scenes=(0.3, 0.4, 0.3, 0.0), photometry=None, board_share=0.5)
    one, many = (
        SlfStream(atlas, 3, 8, SIZE, dataclasses.replace(config, together=n)).batch(0)
        for n in (1, 8)
    )
    assert (one.image - many.image).abs().max() < 2 / 255
    assert torch.equal(one.line_map, many.line_map)


def test_boards_without_drawn_ones_are_told_before_the_first_batch():
    flat = build_atlas([dataclasses.replace(p, kind=PHOTOGRAPH) for p in draw_patterns(2, seed=3)])
    with pytest.raises(ValueError, match="drawn boards"):
        SlfStream(flat, 1, 4, SIZE, StreamCfg(board_share=0.5))


def test_a_share_of_the_pictures_has_no_colour(atlas):
    config = StreamCfg(scenes=(0.5, 0.5, 0.0, 0.0), group=2, grey_share=0.5)
    batch = SlfStream(atlas, 5, 80, 32, config).batch(0)
    for pictures in (batch.image, batch.rectified):
        grey = (pictures == pictures[:, :1]).flatten(1).all(1)
        assert 25 < int(grey.sum()) < 55


def test_pack_draws_boards(tmp_path):
    out = tmp_path / "boards.pack"
    words = ["pack", "--patterns", "0", "--boards", "5", "--out", str(out)]
    result = CliRunner().invoke(synthesize, words)
    assert result.exit_code == 0, result.output
    atlas = load_atlas(out)
    assert atlas.kind.tolist() == [BOARD] * 5
    lines = (atlas.first[1:] - atlas.first[:-1]).tolist()
    assert min(lines[:3]) > 8  # chequers and tags
    assert lines[3] == 0  # discs


def test_the_lines_of_a_chequerboard_lie_on_its_edges():
    target = next(draw_targets(1, seed=7))
    grey = target.image.mean(axis=2)
    upright = target.segments[target.segments[:, 0] == target.segments[:, 2]]
    assert len(upright) > 4
    for u, top, _, bottom in upright[1:-1]:
        rows = slice(int(top) + 3, int(bottom) - 3)
        step = np.abs(grey[rows, int(u + 0.5)] - grey[rows, int(u - 0.5)])
        assert np.median(step) > 60
