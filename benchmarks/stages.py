"""Each stage and whole `rectify` on the example picture at three sizes."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import partial
from itertools import count, cycle
from pathlib import Path

import cv2
import numpy as np

from benchmarks.timing import in_turn, median_seconds
from classical.camera import KannalaBrandt, Pinhole
from classical.fit import fit_lens
from classical.lines import Curve, curves_from_both, curves_from_image
from classical.warp import pinhole_target, remap, undistort_maps
from hybrid import Rectifier, RectifyConfig, read_picture
from learned.predictor import Predictor

EXAMPLE = Path(__file__).parents[1] / "examples" / "room.jpg"
SIZES = ((320, 240), (1280, 960), (4000, 3000))
BARE = "bare `cv2.remap`"
SOME_CURVES = 60
WHOLE = {
    "classical": RectifyConfig(method="classical"),
    "learned": RectifyConfig(method="learned"),
    "hybrid": RectifyConfig(method="hybrid"),
    "Bukhari & Dailey 2013": RectifyConfig(method="bukhari"),
    "Alemán-Flores et al. 2014": RectifyConfig(method="aleman-flores"),
    "Alemán-Flores et al. 2016": RectifyConfig(method="aleman-flores", variant="2016"),
}


def example(size: tuple[int, int]) -> np.ndarray:
    """The example picture at another size."""
    picture = read_picture(EXAMPLE).pixels
    way = cv2.INTER_AREA if size[0] < picture.shape[1] else cv2.INTER_CUBIC
    return cv2.resize(picture, size, interpolation=way)


def measure_stages(image: np.ndarray, rounds: int) -> dict[str, float]:
    """Seconds of each stage, in the order of the work."""
    height, width = image.shape[:2]
    curves = curves_from_image(image)
    camera = fit_lens([curves], width, height, pictures=[image]).camera
    assert camera is not None
    target = pinhole_target(camera)
    maps = undistort_maps(camera, target)
    predictor = Predictor.from_weights()
    heatmap = predictor.lines(image).lineness
    both = curves_from_both(heatmap, image)
    work: dict[str, Callable[[], object]] = {
        "edges and curves": lambda: curves_from_image(image),
        "heatmap of line perception": lambda: predictor.lines(image),
        "edges, heatmap and curves": lambda: curves_from_both(heatmap, image),
        "LaRecNet": lambda: predictor.lens(image),
        f"fit, the longest {SOME_CURVES} curves": partial(
            fit_lens, [_longest(curves, SOME_CURVES)], width, height
        ),
        "fit, all curves": lambda: fit_lens([both], width, height, pictures=[image]),
        "frame": lambda: pinhole_target(camera),
        "maps of a new lens": _new_maps(camera, target),
    }
    found = {name: median_seconds(call, rounds) for name, call in work.items()}
    warps: dict[str, Callable[[], object]] = {
        "warp": lambda: remap(image, maps),
        "warp without anti-aliasing": lambda: remap(image, maps, antialias=False),
        BARE: lambda: cv2.remap(image, maps.u, maps.v, cv2.INTER_LINEAR),
    }
    return found | in_turn(warps, 3 * rounds)


def measure_whole(image: np.ndarray, rounds: int) -> dict[str, float]:
    """Seconds of whole `rectify`, weights loaded; each round sees another mirror image.

    The lens of a mirror image is another one, so maps are not found in the cache.
    """
    found = {}
    for name, config in WHOLE.items():
        rectifier = Rectifier(config)
        images = cycle([image, image[:, ::-1], image[::-1], image[::-1, ::-1]])

        def one_more(rectifier: Rectifier = rectifier, images: cycle = images) -> None:
            rectifier.rectify(np.ascontiguousarray(next(images)), throw=False)

        found[name] = median_seconds(one_more, min(rounds, 3))
    return found


def _longest(curves: list[Curve], number: int) -> list[Curve]:
    return sorted(curves, key=lambda curve: -curve.length)[:number]


def _new_maps(camera: KannalaBrandt, target: Pinhole) -> Callable[[], object]:
    """Maps of lenses that differ by nothing visible, so that none is in the cache."""
    steps = count(1)
    return lambda: undistort_maps(replace(camera, u0=camera.u0 + 1e-7 * next(steps)), target)
