"""One orientation for all copies of a picture that are turned by 90° or mirrored.

Edges, networks and fits see a turned picture a little differently, so its lens would come out a
little differently. Here pictures are first brought into an orientation that their content tells,
and what is found there is carried back: all eight copies have one lens, to rounding.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import cv2
import numpy as np
from jaxtyping import Float, Shaped, UInt8
from numpy import ndarray

from classical.camera import KannalaBrandt
from classical.lines.working import grey_picture
from hybrid.methods import Estimator
from hybrid.result import Calibration

_M_V = 6  # of (k1..k5, m_u, m_v, u0, v0)


@dataclass(frozen=True)
class Orientation:
    """How pictures of one size are brought into their own orientation: transposed, then flipped.

    Attributes:
        is_transposed: Whether rows become columns.
        is_flipped: Whether left and right, and then top and bottom, change places.
    """

    is_transposed: bool
    is_flipped: tuple[bool, bool]

    @classmethod
    def of(
        cls, pictures: Sequence[UInt8[ndarray, "h w 3"]], *, keeps_width: bool = False
    ) -> Orientation:
        """The orientation of a set of pictures: lying, and brighter above and at the left.

        Squares lie where rows differ more among one another than columns do, as they do in five of
        six upright photographs, with the sky or a ceiling above and a floor below.

        Args:
            pictures: Of one size.
            keeps_width: Whether the width stays the width.
        """
        height, width = pictures[0].shape[:2]
        rows, columns = np.zeros(height, np.int64), np.zeros(width, np.int64)
        for picture in pictures:  # whole numbers: a turned picture has the same sums, exactly
            grey = grey_picture(picture)
            rows += cv2.reduce(grey, 1, cv2.REDUCE_SUM, dtype=cv2.CV_32S).ravel()
            columns += cv2.reduce(grey, 0, cv2.REDUCE_SUM, dtype=cv2.CV_32S).ravel()
        is_upright = height > width
        if height == width:
            is_upright = _squared(columns) > _squared(rows)
        is_transposed = bool(is_upright) and not keeps_width
        across, down = (rows, columns) if is_transposed else (columns, rows)
        return cls(is_transposed, (_falls_short(across), _falls_short(down)))

    def seen(self, picture: UInt8[ndarray, "h w 3"]) -> UInt8[ndarray, "h2 w2 3"]:
        """The picture in this orientation."""
        if self.is_transposed:
            picture = cv2.transpose(picture)
        across, down = self.is_flipped
        if across or down:
            picture = cv2.flip(picture, -1 if across and down else int(across))
        return np.ascontiguousarray(picture)

    def back(self, found: Calibration, width: int, height: int) -> Calibration:
        """What was found in pictures so seen, for the pictures as they came.

        Args:
            found: The answer of an estimator.
            width: Width of the pictures as they came.
            height: Their height.
        """
        camera, covariance = found.camera, found.quality.covariance
        if camera is not None:
            covariance = self._covariance_back(covariance, camera)
            camera = self._camera_back(camera)
        return replace(
            found,
            camera=camera,
            curves=tuple(
                tuple(
                    replace(curve, points=self._points_back(curve.points, width, height))
                    for curve in curves
                )
                for curves in found.curves
            ),
            quality=replace(found.quality, covariance=covariance),
            heatmaps=tuple(self._map_back(heat) for heat in found.heatmaps),
        )

    def _points_back(
        self, points: Float[ndarray, "n 2"], width: int, height: int
    ) -> Float[ndarray, "n 2"]:
        ends = np.array([height, width] if self.is_transposed else [width, height]) - 1.0
        flipped = np.where(self.is_flipped, ends - points, points)
        return flipped[:, ::-1].copy() if self.is_transposed else flipped

    def _map_back(self, heat: Shaped[ndarray, "h w"]) -> Shaped[ndarray, "h2 w2"]:
        across, down = self.is_flipped
        heat = heat[:: -1 if down else 1, :: -1 if across else 1]
        return np.ascontiguousarray(heat.T if self.is_transposed else heat)

    def _camera_back(self, camera: KannalaBrandt) -> KannalaBrandt:
        across, down = self.is_flipped
        u0 = camera.width - 1 - camera.u0 if across else camera.u0
        v0 = camera.height - 1 - camera.v0 if down else camera.v0
        if not self.is_transposed:
            return replace(camera, u0=u0, v0=v0)
        return KannalaBrandt(
            camera.k, camera.m_v, camera.m_u, v0, u0, camera.height, camera.width
        ).normalized()

    def _covariance_back(
        self, covariance: Float[ndarray, "9 9"], camera: KannalaBrandt
    ) -> Float[ndarray, "9 9"]:
        """The covariance of `_camera_back`, in the gauge m_u = width / 2 on both sides."""
        jacobian = np.diag([1.0] * 7 + [-1.0 if flips else 1.0 for flips in self.is_flipped])
        if self.is_transposed:
            half = camera.height / 2
            swap = np.eye(9)
            swap[:5, :5] *= camera.m_v / half
            swap[:5, _M_V] = camera.k / half
            swap[_M_V, _M_V] = -camera.m_u * half / camera.m_v**2
            swap[7:, 7:] = [[0.0, 1.0], [1.0, 0.0]]
            jacobian = swap @ jacobian
        return jacobian @ covariance @ jacobian.T


class OrientedEstimator:
    """An estimator that sees all turned and mirrored copies of a picture as one.

    Args:
        estimator: Who finds the lens.
        keeps_width: Whether the width stays the width, because what is known of the lens is said
            of it.
    """

    def __init__(self, estimator: Estimator, *, keeps_width: bool = False) -> None:
        self._estimator = estimator
        self._keeps_width = keeps_width

    def __call__(self, pictures: Sequence[UInt8[ndarray, "h w 3"]]) -> Calibration:
        """One lens for all pictures."""
        height, width = pictures[0].shape[:2]
        orientation = Orientation.of(pictures, keeps_width=self._keeps_width)
        found = self._estimator([orientation.seen(picture) for picture in pictures])
        return orientation.back(found, width, height)


def _squared(sums: ndarray) -> int:
    return sum(value * value for value in sums.tolist())


def _falls_short(sums: ndarray) -> bool:
    """Whether the second half is brighter than the first."""
    half = len(sums) // 2
    return bool(sums[:half].sum() < sums[len(sums) - half :].sum())
