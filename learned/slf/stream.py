"""Training samples on the fly: lenses, scenes and lines in, `SlfBatch` out, torch alone.

Batch i depends on the seed and on i only, so that a stopped training goes on with the same samples.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from functools import lru_cache, partial
from itertools import pairwise

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from learned.slf.atlas import BOARD, PANORAMA, PATTERN, PHOTOGRAPH, ROOM, Atlas
from learned.slf.batch import SlfBatch
from learned.slf.boards import Held, board_segments, draw_boards
from learned.slf.boxes import Boxes, box_segments, box_visibility, render_boxes
from learned.slf.layouts import LayoutCfg, PoseCfg, draw_boxes, draw_rotations
from learned.slf.lenses import LensBatch, concatenated
from learned.slf.optics import Optics, optics, pixel_rays, plane_points, ray_tables
from learned.slf.panoramas import Views, render_views, view_segments
from learned.slf.perspective import perspective_lenses
from learned.slf.photometry import PhotometryCfg, photographed
from learned.slf.planes import Planes, draw_planes, plane_segments, render_planes
from learned.slf.priors import lens_prior
from learned.slf.rectify import rectified
from learned.slf.strokes import (
    Segments3D,
    Strokes,
    Visibility,
    bent_strokes,
    draw_line_map,
)

_PLANES, _BOXES, _VIEWS, _ROOMS = range(4)
_KINDS = (PHOTOGRAPH, PHOTOGRAPH, PANORAMA, ROOM)
_BLOCK = 64
Content = Planes | Boxes | Views


@dataclass(frozen=True)
class Scenery:
    """What some samples look at.

    Attributes:
        content: One row a sample.
        segments: Its straight lines, in camera coordinates.
        visibility: What of them is not hidden, or None where nothing hides anything.
    """

    content: Content
    segments: Segments3D
    visibility: Visibility | None = None


@dataclass(frozen=True)
class StreamCfg:
    """Mixture of training samples.

    Attributes:
        scenes: Weights of photograph planes (D-Wireframe), boxes of photographs, cuts of panoramas,
            cuts of panoramas of rendered rooms; a scene without pictures in the atlas is left out.
        wild_share: Weight of the `wild` prior in boxes and panoramas, the rest is `paper`. Planes
            always take `paper`: a flat photograph cannot fill a wider lens.
        fisheye_share: Share of the `wild` lenses that are of the prior `fisheye`.
        straight_share: Share of all scenes that are taken by lenses that bend next to nothing.
        board_share: Share of the boxes and panoramas that have a board before the lens.
        grey_share: Share of all pictures that have no colour.
        shortest_px: Bent lines shorter than this are not drawn.
        photometry: What a real camera does to the picture, or None for clean pictures.
        clean_share: Share of the groups that stay clean all the same.
        layout: Sizes of the box scenes.
        pose: Camera poses of panoramas.
        oversampling: Rays per pixel and axis.
        group: Samples drawn together. Samples depend on it, so keep it when resuming.
        together: Pictures rendered together. One is best on a CPU, whose caches hold one picture;
            take the whole group on a GPU.
        with_rectified: Whether to make the rectified ground truth; zeros otherwise.
    """

    scenes: tuple[float, float, float, float] = (0.45, 0.35, 0.2, 0.0)
    wild_share: float = 0.8
    fisheye_share: float = 0.0
    straight_share: float = 0.0
    board_share: float = 0.0
    grey_share: float = 0.0
    shortest_px: float = 12.0
    photometry: PhotometryCfg | None = field(default_factory=PhotometryCfg)
    clean_share: float = 0.25
    layout: LayoutCfg = field(default_factory=LayoutCfg)
    pose: PoseCfg = field(default_factory=PoseCfg)
    oversampling: int = 1
    group: int = 8
    together: int = 1
    with_rectified: bool = True


@dataclass(frozen=True)
class SlfStream:
    """An endless, repeatable sequence of batches.

    Attributes:
        atlas: Pictures, on the device where samples are to be made.
        seed: Seed of the whole sequence.
        batch_size: Samples a batch.
        size: Width and height in pixels.
        config: Mixture.
    """

    atlas: Atlas
    seed: int
    batch_size: int
    size: int = 320
    config: StreamCfg = field(default_factory=StreamCfg)

    def __post_init__(self) -> None:
        if not sum(self._weights()) > 0:  # nor where one is NaN
            raise ValueError(
                "expected scenes that the pack has pictures for, got the weights "
                f"{self.config.scenes} of planes, boxes, panoramas and rooms"
            )
        if self.config.board_share and not len(self.atlas.of_kind(BOARD)):
            raise ValueError(
                f"expected a pack with drawn boards for a share of {self.config.board_share}, "
                "got none; `synthesize pack --boards` draws them"
            )

    def __iter__(self) -> Iterator[SlfBatch]:
        """All batches from the first."""
        return self.starting_at(0)

    def starting_at(self, index: int) -> Iterator[SlfBatch]:
        """All batches from batch `index`."""
        while True:
            yield self.batch(index)
            index += 1

    @torch.no_grad()
    def batch(self, index: int) -> SlfBatch:
        """Batch `index` of the sequence."""
        return self.batch_and_strokes(index)[0]

    @torch.no_grad()
    def batch_and_strokes(self, index: int) -> tuple[SlfBatch, Strokes]:
        """Batch `index` with the bent lines as points."""
        first, last = index * self.batch_size, (index + 1) * self.batch_size
        group = self.config.group
        edges = sorted({first, last, *range(-(-first // group) * group, last, group)})
        parts = [self._samples(a, b) for a, b in pairwise(edges)]
        if len(parts) == 1:
            return parts[0]
        device = self.atlas.texels.device
        rows = [torch.arange(a - first, b - first, device=device) for a, b in pairwise(edges)]
        strokes = [(strokes, at) for (_, strokes), at in zip(parts, rows, strict=True)]
        return joined_batches([batch for batch, _ in parts]), joined_strokes(strokes)

    def _samples(self, first: int, last: int) -> tuple[SlfBatch, Strokes]:
        """Samples of one group, drawn together."""
        rng = np.random.default_rng([self.seed, 1, first])
        scene, lens = self._lenses(first, last)
        held = self._held(scene, first)
        clean = lens.vector.new_empty((last - first, 3, self.size, self.size))
        strokes = []
        for kind, draw in self._draws():
            rows = torch.from_numpy(np.nonzero(scene == kind)[0]).to(clean.device)
            if len(rows):
                scenery, boards = draw(rng, len(rows)), held.before(rows)
                strokes += [
                    (runs, rows[of]) for runs, of in self._runs(scenery, boards, lens[rows])
                ]
                self._render(scenery.content, boards, lens[rows], clean, rows)
        lines = joined_strokes(strokes) if len(strokes) > 1 else strokes[0][0]
        image = clean
        stays_clean = (
            np.random.default_rng([self.seed, 2, first]).random() < self.config.clean_share
        )
        if self.config.photometry is not None and not stays_clean:
            image = photographed(clean, lens, rng=rng, config=self.config.photometry)
        grey = np.random.default_rng([self.seed, 4, first]).random(last - first)
        image, clean = (_without_colour(x, grey < self.config.grey_share) for x in (image, clean))
        # zeros that take no memory
        flat = rectified(clean, lens) if self.config.with_rectified else clean.new_zeros(1)
        line_map = draw_line_map(lines, batch=last - first, size=self.size)
        flat = flat.expand_as(clean)
        return SlfBatch(image, line_map, lens.vector, flat, lens.theta_max), lines

    def _draws(self) -> list[tuple[int, Callable[..., Scenery]]]:
        """Every scene and what draws it."""
        return [
            (_PLANES, self._planes),
            (_BOXES, self._boxes),
            (_VIEWS, partial(self._views, kind=PANORAMA)),
            (_ROOMS, partial(self._views, kind=ROOM)),
        ]

    def _held(self, scene: np.ndarray, first: int) -> Held:
        """Boards before some of the samples; their random numbers are nobody else's."""
        rng = np.random.default_rng([self.seed, 3, first])
        chosen = (scene != _PLANES) & (rng.random(len(scene)) < self.config.board_share)
        number = np.where(chosen, np.cumsum(chosen) - 1, -1)
        boards = None
        if chosen.any():
            targets, photographs = (self.atlas.of_kind(kind) for kind in (BOARD, PHOTOGRAPH))
            boards = draw_boards(rng, self.atlas, targets, photographs, int(chosen.sum()))
        return Held(boards, torch.from_numpy(number).to(self.atlas.texels.device))

    def _runs(
        self, scenery: Scenery, boards: Held, lens: Optics
    ) -> Iterator[tuple[Strokes, Tensor]]:
        """Bent lines of a scene and of the boards before it, and the samples they are of."""
        shortest = self.config.shortest_px
        every = torch.arange(len(lens), device=lens.vector.device)
        seen = partial(boards.seen, scene=scenery.visibility)
        yield bent_strokes(lens, scenery.segments, visibility=seen, shortest_px=shortest), every
        if boards.boards is not None:
            lines = board_segments(self.atlas, boards.boards)
            yield bent_strokes(lens[boards.rows], lines, shortest_px=shortest), boards.rows

    def _render(
        self, content: Content, held: Held, lens: Optics, out: Tensor, rows: Tensor
    ) -> None:
        """Clean pictures in [0, 1] into rows of `out`, so many at a time as fit the caches."""
        oversampling = self.config.oversampling
        tables = ray_tables(lens, oversampling=oversampling)
        here = torch.arange(len(rows), device=rows.device)
        for some in here.split(self.config.together):
            lenses, scenes, inverse = lens[some], _some_of(content, some), tables[some]
            if isinstance(scenes, Planes):
                points = plane_points(lenses, oversampling=oversampling, tables=inverse)
                picture = render_planes(self.atlas, scenes, points)
            else:
                rays, valid = pixel_rays(lenses, oversampling=oversampling, tables=inverse)
                if isinstance(scenes, Boxes):
                    picture = render_boxes(self.atlas, scenes, lenses, rays)
                else:
                    picture = render_views(self.atlas, scenes, rays)
                held.before(some).lay(self.atlas, lenses, rays, picture)
                picture *= valid[:, None]
            out[rows[some]] = _averaged(picture, oversampling).mul_(1 / 255.0)

    def _lenses(self, first: int, last: int) -> tuple[np.ndarray, Optics]:
        """The scene of each sample and its lens; drawn in blocks, which is much cheaper."""
        weights = self._weights()
        blocks = range(first // _BLOCK, (last - 1) // _BLOCK + 1)
        share = tuple((weights / weights.sum()).tolist())
        cfg = self.config
        lens_shares = (cfg.wild_share, cfg.straight_share, cfg.fisheye_share)
        drawn = [lens_block(self.seed, i, share, *lens_shares) for i in blocks]
        scene = np.concatenate([part for part, _ in drawn])
        lenses = concatenated([part for _, part in drawn])
        rows = slice(first - blocks[0] * _BLOCK, last - blocks[0] * _BLOCK)
        return scene[rows], optics(lenses[rows], size=self.size, device=self.atlas.texels.device)

    def _weights(self) -> Float[np.ndarray, "4"]:
        """Weights of the scenes; 0 where the atlas has no picture for them."""
        return np.array(self.config.scenes, float) * [
            len(self.atlas.of_kind(k)) > 0 for k in _KINDS
        ]

    def _planes(self, rng: np.random.Generator, n: int) -> Scenery:
        photographs = self.atlas.of_kind(PHOTOGRAPH)
        planes = draw_planes(rng, self.atlas, photographs, n, upright=False)
        return Scenery(planes, plane_segments(self.atlas, planes))

    def _boxes(self, rng: np.random.Generator, n: int) -> Scenery:
        photographs, patterns = self.atlas.of_kind(PHOTOGRAPH), self.atlas.of_kind(PATTERN)
        boxes = draw_boxes(rng, self.atlas, photographs, patterns, n, self.config.layout)
        return Scenery(boxes, box_segments(self.atlas, boxes), partial(box_visibility, boxes))

    def _views(self, rng: np.random.Generator, n: int, *, kind: int) -> Scenery:
        panoramas = self.atlas.of_kind(kind)
        chosen = torch.from_numpy(rng.integers(0, len(panoramas), n)).to(panoramas.device)
        rotation = torch.as_tensor(
            draw_rotations(rng, n, self.config.pose), dtype=torch.float32, device=panoramas.device
        )
        views = Views(panoramas[chosen], rotation)
        return Scenery(views, view_segments(self.atlas, views))


@lru_cache(maxsize=64)
def lens_block(
    seed: int,
    block: int,
    scenes: tuple[float, ...],
    wild_share: float,
    straight_share: float = 0.0,
    fisheye_share: float = 0.0,
) -> tuple[np.ndarray, LensBatch]:
    """Scene and lens of a block of samples, from the seed and the number of the block."""
    rng = np.random.default_rng([seed, 0, block])
    scene = rng.choice(len(scenes), _BLOCK, p=scenes)
    wild = (scene != _PLANES) & (rng.random(_BLOCK) < wild_share)
    drawn = [lens_prior(name).sample(rng, _BLOCK) for name in ("paper", "wild")]
    straight = rng.random(_BLOCK) < straight_share
    drawn.append(perspective_lenses(rng, _BLOCK))
    source = np.where(straight, 2, wild)
    if fisheye_share:  # drawn last: without it a block is what it was before there were any
        drawn.append(lens_prior("fisheye").sample(rng, _BLOCK))
        source = np.where((source == 1) & (rng.random(_BLOCK) < fisheye_share), 3, source)
    return scene, concatenated(drawn)[np.arange(_BLOCK) + _BLOCK * source]


def joined_batches(parts: list[SlfBatch]) -> SlfBatch:
    """Several batches as one."""
    names = [name for name, value in vars(parts[0]).items() if value is not None]
    return SlfBatch(**{name: torch.cat([getattr(p, name) for p in parts]) for name in names})


def joined_strokes(parts: list[tuple[Strokes, Tensor]]) -> Strokes:
    """Strokes of several groups as one, with each group's rows in the whole batch."""
    runs, n_runs, n_segments = [], 0, 0
    segments = []
    for strokes, _ in parts:
        runs.append(strokes.run + n_runs)
        segments.append(strokes.segment + n_segments)
        n_runs += len(strokes.length)
        n_segments += int(strokes.segment.max()) + 1 if len(strokes.segment) else 0
    return Strokes(
        points=torch.cat([s.points for s, _ in parts]),
        tangent=torch.cat([s.tangent for s, _ in parts]),
        share=torch.cat([s.share for s, _ in parts]),
        run=torch.cat(runs),
        length=torch.cat([s.length for s, _ in parts]),
        row=torch.cat([rows[s.row] for s, rows in parts]),
        segment=torch.cat(segments),
    )


def _without_colour(image: Float[Tensor, "b 3 h w"], chosen: np.ndarray) -> Tensor:
    """The pictures, the chosen ones grey."""
    if not chosen.any():
        return image
    mask = torch.from_numpy(chosen).to(image.device)[:, None, None, None]
    return torch.where(mask, image.mean(dim=1, keepdim=True), image)


def _some_of(content: Content, rows: Tensor) -> Content:
    """Some samples of a scene, whose tensors all have one row a sample."""
    return type(content)(**{name: value[rows] for name, value in vars(content).items()})


def _averaged(image: Tensor, oversampling: int) -> Tensor:
    if oversampling == 1:
        return image
    return torch.nn.functional.avg_pool2d(image, oversampling)
