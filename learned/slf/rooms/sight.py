"""What a camera in a room sees: which points are hidden, and where two sides of a line differ."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple, Protocol, runtime_checkable

import numpy as np
import torch
from jaxtyping import Bool, Float, Int
from numpy import ndarray
from torch import Tensor

from learned.slf.boxes import Boxes, box_visibility, first_hits

_DEPTH_STEP = 0.01
_FACING = np.cos(np.radians(15.0))  # faces that differ less in direction are one surface
_SLACK, _SLACK_M = 0.002, 0.002  # of a point's distance, within which it is seen


@runtime_checkable
class Sight(Protocol):
    """Questions about what the camera sees; rays are in camera coordinates."""

    def sees(self, points: Float[Tensor, "n 3"]) -> Bool[Tensor, " n"]:
        """True where nothing stands between the camera and the point."""
        ...

    def differ(self, one: Float[Tensor, "n 3"], other: Float[Tensor, "n 3"]) -> Bool[Tensor, " n"]:
        """True where two rays meet different things: another surface or distance."""
        ...


@dataclass(frozen=True)
class BoxSight:
    """A scene of boxes alone, by arithmetic.

    Attributes:
        boxes: The scene.
        material: Material of every face, shape (1, n, 6).
    """

    boxes: Boxes
    material: Int[Tensor, "1 n 6"]

    def sees(self, points: Float[Tensor, "n 3"]) -> Bool[Tensor, " n"]:
        """See `Sight`."""
        return box_visibility(self.boxes, points, torch.zeros(len(points), dtype=torch.int64))

    def differ(self, one: Float[Tensor, "n 3"], other: Float[Tensor, "n 3"]) -> Bool[Tensor, " n"]:
        """See `Sight`."""
        (d0, f0, m0), (d1, f1, m1) = self._met(one), self._met(other)
        return (m0 != m1) | ((f0 - f1).abs() > 0.05) | _apart(d0, d1)

    def _met(self, rays: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        """Distance, direction of the face and its material."""
        depth, owner, face = first_hits(self.boxes, rays, torch.zeros(len(rays), dtype=torch.int64))
        yaw = self.boxes.yaw[0, owner]
        axis = face // 2
        turned = torch.where(axis == 0, yaw, torch.where(axis == 2, yaw + np.pi / 2, 0.0))
        facing = torch.where(axis == 1, 3.0, torch.cos(2 * turned))
        return depth, facing, self.material[0, owner, face]


class Hits(NamedTuple):
    """What rays meet first.

    Attributes:
        depth: Distance in metres, infinite where a ray meets nothing.
        normal: Unit normal of the surface, of either sign, in world axes.
        surface: Number of the surface, −1 where a ray meets nothing.
    """

    depth: Float[ndarray, " n"]
    normal: Float[ndarray, "n 3"]
    surface: Int[ndarray, " n"]


@dataclass(frozen=True)
class TracedSight:
    """A scene with meshes, by a ray tracer.

    Attributes:
        rotation: World directions of the camera's axes (columns).
        trace: What rays from the camera meet, for unit directions in world axes (n, 3).
    """

    rotation: Float[ndarray, "3 3"]
    trace: Callable[[Float[ndarray, "n 3"]], Hits]

    def sees(self, points: Float[Tensor, "n 3"]) -> Bool[Tensor, " n"]:
        """See `Sight`."""
        distance = points.norm(dim=1).double().numpy()
        hits = self._met(points)
        near = distance * (1 - _SLACK) - _SLACK_M
        return torch.from_numpy(hits.depth >= near)

    def differ(self, one: Float[Tensor, "n 3"], other: Float[Tensor, "n 3"]) -> Bool[Tensor, " n"]:
        """See `Sight`."""
        a, b = self._met(one), self._met(other)
        turned = np.abs((a.normal * b.normal).sum(axis=1)) < _FACING
        # two rays into the open are alike
        d0, d1 = (torch.from_numpy(np.minimum(hits.depth, 1e4)) for hits in (a, b))
        return torch.from_numpy((a.surface != b.surface) | turned) | _apart(d0, d1)

    def _met(self, rays: Tensor) -> Hits:
        world = rays.double().numpy() @ self.rotation.T
        return self.trace(world / np.maximum(np.linalg.norm(world, axis=1, keepdims=True), 1e-12))


def _apart(d0: Tensor, d1: Tensor) -> Tensor:
    return (d0 - d1).abs() > _DEPTH_STEP * (d0 + d1) + 0.02
