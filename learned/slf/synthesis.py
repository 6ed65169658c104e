"""Sets on disk from photographs and panoramas: repeatable from a seed, resumable item by item."""

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from functools import lru_cache
from pathlib import Path

import numpy as np
import torch
from jaxtyping import Float, UInt8
from numpy import ndarray
from torch import Tensor

from classical.camera import KannalaBrandt
from learned.pool import WorkPool
from learned.slf.atlas import Atlas
from learned.slf.layouts import PoseCfg, draw_rotations
from learned.slf.lenses import LensBatch
from learned.slf.optics import Optics, optics, pixel_rays, plane_points
from learned.slf.pack import annotated_photograph, build_atlas
from learned.slf.panorama_lines import annotated_panorama
from learned.slf.panoramas import Views, render_views, view_segments
from learned.slf.photometry import PhotometryCfg, photographed
from learned.slf.planes import draw_planes, plane_segments, render_planes
from learned.slf.priors import lens_prior
from learned.slf.rectify import rectified
from learned.slf.strokes import CLIPPED_LENGTH, Segments3D, Strokes, bent_strokes, draw_line_map
from learned.slf.suite import SuiteCurve, SuiteFolder, SuiteItem
from learned.slf.wireframes import Photograph

_DWIREFRAME, _PANORAMAS = 11, 12
_LONGEST_PHOTOGRAPH = 1280
_POINT_SPACING = 3
_FEWEST_CURVES = 6
_SHORTEST_SHARE = 0.05
_POSE_TRIES = 8


@dataclass(frozen=True)
class SetCfg:
    """What a set is made of.

    Attributes:
        prior: Name of the lens prior.
        size: Width and height of the pictures.
        seed: Seed of the whole set.
        oversampling: Rays per pixel and axis.
        photometry: What a camera does to the pictures, or None for clean ones.
        pose: Camera poses in panoramas.
    """

    prior: str
    size: int
    seed: int
    oversampling: int = 3
    photometry: PhotometryCfg | None = None
    pose: PoseCfg = field(default_factory=lambda: PoseCfg(level_share=0.85))


@dataclass(frozen=True)
class Made:
    """An item with its pictures.

    Attributes:
        item: Camera and curves.
        picture: The fisheye photograph.
        straight: The rectified truth.
        lines: Its line map; see `line_bytes`.
    """

    item: SuiteItem
    picture: UInt8[ndarray, "h w 3"]
    straight: UInt8[ndarray, "h2 w2 3"]
    lines: UInt8[ndarray, "h w"]


def make_dwireframe(photographs: Sequence[Photograph], index: int, config: SetCfg) -> Made:
    """One photograph bent by one lens; photographs come round in shuffled order.

    Args:
        photographs: In a fixed order, with their annotation files if they have any.
        index: Number of the item.
        config: Lenses, size and seed.
    """
    order = np.random.default_rng([config.seed, _DWIREFRAME]).permutation(len(photographs))
    photograph = photographs[order[index % len(photographs)]]
    rng = np.random.default_rng([config.seed, _DWIREFRAME, index])
    lenses = lens_prior(config.prior).sample(rng, 1)
    lens = optics(lenses, size=config.size)
    atlas = _photograph_atlas(photograph)
    planes = draw_planes(rng, atlas, atlas.of_kind(0), 1, upright=True)
    picture = render_planes(atlas, planes, plane_points(lens, oversampling=config.oversampling))
    segments = plane_segments(atlas, planes)
    return _made(index, lenses, lens, picture, segments, photograph.path.stem, rng, config)


def make_panorama_cut(panoramas: Sequence[Path], index: int, config: SetCfg) -> Made:
    """One cut of a panorama; poses that show hardly any line are drawn again a few times.

    Args:
        panoramas: Files, in a fixed order.
        index: Number of the item.
        config: Lenses, size, seed and poses.
    """
    path = panoramas[index % len(panoramas)]
    rng = np.random.default_rng([config.seed, _PANORAMAS, index])
    lenses = lens_prior(config.prior).sample(rng, 1)
    lens = optics(lenses, size=config.size)
    atlas = _panorama_atlas(path)
    # panoramas are rarely finer than the cuts, so two rays an axis are enough
    config = replace(config, oversampling=min(config.oversampling, 2))
    rays, valid = pixel_rays(lens, oversampling=config.oversampling)
    views, segments = _pose_with_lines(rng, atlas, lens, config)
    picture = render_views(atlas, views, rays).mul_(valid[:, None])
    return _made(index, lenses, lens, picture, segments, path.stem, rng, config)


def synthesize(
    folder: SuiteFolder,
    make: Callable[[int], Made],
    count: int,
    *,
    workers: int = 1,
    cluster: str | None = None,
    progress: Callable[[], object] | None = None,
) -> None:
    """Make the items that are not there yet; the same bytes however many workers make them.

    Args:
        folder: A suite that has begun.
        make: Makes an item from its number alone; for more than one worker a module-level function
            or a partial of one.
        count: Number of items of the whole set.
        workers: Processes, with one thread each.
        cluster: Address of a Ray cluster that works instead; see `WorkPool`.
        progress: Called once an item, made or found.
    """
    there = set(folder.indices())
    missing = [index for index in range(count) if index not in there]
    for _ in range(count - len(missing)):
        if progress is not None:
            progress()
    pool = WorkPool(workers=max(1, min(workers, len(missing))), cluster=cluster)
    with _one_thread(), pool:
        for made in pool.ordered(make, missing):
            folder.write(made.item, made.picture, made.straight, made.lines)
            if progress is not None:
                progress()


@contextmanager
def _one_thread() -> Iterator[None]:
    """One thread of torch: pictures are small, and sums in parts might differ in the last bit."""
    before = torch.get_num_threads()
    torch.set_num_threads(1)
    try:
        yield
    finally:
        torch.set_num_threads(before)


def suite_curves(strokes: Strokes, segments: Segments3D, row: int) -> tuple[SuiteCurve, ...]:
    """Runs of one sample as curves, longest first, with the ends of what is seen of them."""
    curves = []
    for run in torch.nonzero(strokes.row == row)[:, 0].tolist():
        points = strokes.points[strokes.run == run].double().numpy()
        keep = np.arange(0, len(points), _POINT_SPACING)
        if keep[-1] != len(points) - 1:
            keep = np.append(keep, len(points) - 1)
        share = strokes.share[strokes.run == run][[0, -1]].double().numpy()
        segment = int(strokes.segment[run])
        start, end = (x[segment].double().numpy() for x in (segments.start, segments.end))
        ends = start + share[:, None] * (end - start)
        ends /= np.linalg.norm(ends, axis=1, keepdims=True)
        curves.append(SuiteCurve(points[keep], ends, float(strokes.length[run])))
    return tuple(sorted(curves, key=lambda curve: -curve.length_px))


def true_camera(vector: Float[ndarray, " 9"], size: int) -> KannalaBrandt:
    """The camera of a vector in half widths, for a square frame of `size` pixels."""
    half, middle = size / 2, (size - 1) / 2
    return KannalaBrandt(
        k=vector[:5],
        m_u=float(vector[5] * half),
        m_v=float(vector[6] * half),
        u0=float(vector[7] * half + middle),
        v0=float(vector[8] * half + middle),
        width=size,
        height=size,
    )


def to_bytes(image: Float[Tensor, "3 h w"]) -> UInt8[ndarray, "h w 3"]:
    """A picture in [0, 1] as 8-bit RGB."""
    return (image.clamp(0, 1) * 255).round().byte().permute(1, 2, 0).cpu().numpy()


def line_bytes(strokes: Strokes, size: int) -> UInt8[ndarray, "h w"]:
    """The line map of one sample: min(length, 255) of the line that covers a pixel, else 0."""
    drawn = draw_line_map(strokes, batch=1, size=size)[0, 0]
    return (drawn * CLIPPED_LENGTH).round().byte().cpu().numpy()


def _made(
    index: int,
    lenses: LensBatch,
    lens: Optics,
    rendered: Tensor,
    segments: Segments3D,
    origin: str,
    rng: np.random.Generator,
    config: SetCfg,
) -> Made:
    clean = torch.nn.functional.avg_pool2d(rendered / 255.0, config.oversampling)
    strokes = bent_strokes(lens, segments, shortest_px=_SHORTEST_SHARE * config.size)
    image = clean
    if config.photometry is not None:
        image = photographed(clean, lens, rng=rng, config=config.photometry)
    item = SuiteItem(
        index=index,
        camera=true_camera(lenses.vector[0], config.size),
        theta_max=float(lenses.theta_max[0]),
        curves=suite_curves(strokes, segments, 0),
        origin=origin,
    )
    straight = to_bytes(rectified(clean, lens)[0])
    return Made(item, to_bytes(image[0]), straight, line_bytes(strokes, config.size))


def _pose_with_lines(
    rng: np.random.Generator, atlas: Atlas, lens: Optics, config: SetCfg
) -> tuple[Views, Segments3D]:
    """The first pose that shows enough lines, or the best of several."""
    best: tuple[int, Views, Segments3D] | None = None
    for _ in range(_POSE_TRIES):
        rotation = torch.as_tensor(draw_rotations(rng, 1, config.pose), dtype=torch.float32)
        views = Views(torch.zeros(1, dtype=torch.int64), rotation)
        segments = view_segments(atlas, views)
        shortest = 2 * _SHORTEST_SHARE * config.size
        seen = len(bent_strokes(lens, segments, shortest_px=shortest).length)
        if best is None or seen > best[0]:
            best = (seen, views, segments)
        if seen >= _FEWEST_CURVES:
            break
    assert best is not None
    return best[1], best[2]


@lru_cache(maxsize=4)
def _photograph_atlas(photograph: Photograph) -> Atlas:
    return build_atlas([annotated_photograph(photograph, longest=_LONGEST_PHOTOGRAPH)])


@lru_cache(maxsize=32)
def _panorama_atlas(path: Path) -> Atlas:
    return build_atlas([annotated_panorama(path)])
