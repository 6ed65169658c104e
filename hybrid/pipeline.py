"""From pictures to straight pictures: the functions that users call."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from functools import lru_cache

import cv2
import numpy as np
from jaxtyping import Shaped

from classical.camera import KannalaBrandt, Pinhole
from classical.warp import pinhole_target, remap, undistort_maps
from hybrid.arrays import check_image, to_rgb8
from hybrid.config import RectifyConfig
from hybrid.methods import make_estimator
from hybrid.page import on_black
from hybrid.result import Calibration, Quality, Rectification, RectificationError, Status

_SAME_SHAPE = 0.005  # relative difference of aspect ratios up to which a camera fits a picture


class Rectifier:
    """Estimates lenses and straightens pictures; keeps loaded weights between calls.

    Args:
        config: The method and the frame of the straight picture.
    """

    def __init__(self, config: RectifyConfig = RectifyConfig()) -> None:
        self.config = config
        self._estimator = make_estimator(config)

    def calibrate(self, images: Sequence[Shaped[np.ndarray, "..."]]) -> Calibration:
        """Find the one lens that took all the pictures.

        Args:
            images: Pictures of one size, each as for `rectify`.

        Returns:
            The lens with its quality; `failed` with a reason where the pictures do not tell.

        Raises:
            ValueError: If there is no picture, or one is malformed or of another size.
        """
        if len(images) == 0:
            raise ValueError("Expected at least one picture, got none.")
        for image in images:
            check_image(image)
        sizes = sorted({image.shape[1::-1] for image in images})
        if len(sizes) > 1:
            first, second = ("x".join(map(str, size)) for size in sizes[:2])
            raise ValueError(f"Expected pictures of one size, got {first} and {second}.")
        with opencv_threads(self.config.threads):
            return self._estimator([on_black(to_rgb8(image)) for image in images])

    def rectify(
        self,
        image: Shaped[np.ndarray, "..."],
        *,
        camera: KannalaBrandt | None = None,
        throw: bool = True,
    ) -> Rectification:
        """Straighten a picture.

        Args:
            image: RGB (h, w, 3); also grey (h, w) or (h, w, 1), RGBA (h, w, 4). Type uint8,
                uint16, or float in [0, 1].
            camera: The lens if it is known; then nothing is estimated. It may be of the same
                picture at another resolution.
            throw: Raise where the lens cannot be told, rather than return the picture as it is
                with the status `failed`.

        Returns:
            The straight picture with all that is known about it.

        Raises:
            ValueError: If the picture is malformed, or the camera is of another picture.
            RectificationError: If the lens cannot be told and `throw` is set.
        """
        check_image(image)
        if camera is None:
            found = self.calibrate([image])
        else:
            camera = fitted_camera(camera, image.shape[1], image.shape[0])
            found = Calibration(camera, ((),), Quality(), "ok", "the camera was given")
        with opencv_threads(self.config.threads):
            result = _warped(image, found, self.config)
        if throw and result.status == "failed":
            raise RectificationError(result.reason)
        return result


def rectify(
    image: Shaped[np.ndarray, "..."],
    config: RectifyConfig = RectifyConfig(),
    *,
    camera: KannalaBrandt | None = None,
    throw: bool = True,
) -> Rectification:
    """Straighten one picture; see `Rectifier.rectify`.

    Args:
        image: RGB, grey or RGBA; uint8, uint16, or float in [0, 1].
        config: The method and the frame of the straight picture.
        camera: The lens if it is known; then nothing is estimated.
        throw: Raise where the lens cannot be told.
    """
    return _rectifier(config).rectify(image, camera=camera, throw=throw)


def calibrate(
    images: Sequence[Shaped[np.ndarray, "..."]], config: RectifyConfig = RectifyConfig()
) -> Calibration:
    """Find the one lens of many pictures; see `Rectifier.calibrate`.

    Args:
        images: Pictures of one lens and one size.
        config: The method.
    """
    return _rectifier(config).calibrate(images)


def fitted_camera(camera: KannalaBrandt, width: int, height: int) -> KannalaBrandt:
    """The camera for a picture of another resolution.

    Raises:
        ValueError: If the picture has another shape, so that it cannot be a resized one.
    """
    if (camera.width, camera.height) == (width, height):
        return camera
    stretch = (width / camera.width) / (height / camera.height)
    if abs(stretch - 1) > max(_SAME_SHAPE, 1 / min(width, height)):
        raise ValueError(
            f"Expected a picture shaped like the camera's {camera.width}x{camera.height}, "
            f"got {width}x{height}."
        )
    return camera.resized(width, height).normalized()


@lru_cache(maxsize=4)
def _rectifier(config: RectifyConfig) -> Rectifier:
    """Rectifiers used last, so that repeated calls load weights once."""
    return Rectifier(config)


def _warped(image: np.ndarray, found: Calibration, config: RectifyConfig) -> Rectification:
    """The picture straightened by what was found, or as it is."""
    try:
        target = None if found.camera is None else straight_target(found.camera, config)
    except ValueError as error:
        return _untouched(image, found, "failed", f"the lens cannot be shown: {error}")
    if found.camera is None or target is None:
        return _untouched(image, found, found.status, found.reason)
    maps = undistort_maps(found.camera, target)
    straight = remap(image, maps, interpolation=config.interpolation, antialias=config.antialias)
    return Rectification(
        straight,
        maps.valid,
        found.camera,
        target,
        found.curves[0],
        found.quality,
        found.status,
        found.reason,
        _heatmap(found),
    )


def _untouched(image: np.ndarray, found: Calibration, status: Status, reason: str) -> Rectification:
    """The picture as it is."""
    valid = np.ones(image.shape[:2], bool)
    curves = found.curves[0]
    return Rectification(
        image, valid, None, None, curves, found.quality, status, reason, _heatmap(found)
    )


def _heatmap(found: Calibration) -> np.ndarray | None:
    return found.heatmaps[0] if found.heatmaps else None


def straight_target(camera: KannalaBrandt, config: RectifyConfig) -> Pinhole:
    """The camera of the straight picture that a config asks for.

    Raises:
        ValueError: If no part of the picture can be shown so.
    """
    return pinhole_target(
        camera,
        focal=config.focal,
        fov=config.fov,
        balance=config.balance,
        size=config.size,
    )


@contextmanager
def opencv_threads(number: int | None) -> Iterator[None]:
    """Let OpenCV use so many threads inside the block."""
    if number is None:
        yield
        return
    before = cv2.getNumThreads()
    cv2.setNumThreads(number)
    try:
        yield
    finally:
        cv2.setNumThreads(before)
