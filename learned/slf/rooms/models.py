"""Furniture models made ready for a scene: unpacked, measured, their straight edges found."""

from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import torch
from jaxtyping import Float
from numpy import ndarray

from learned.slf.rooms.builder import RoomScene
from learned.slf.rooms.catalogue import Model, extract
from learned.slf.rooms.meshes import Mesh, moved, read_obj, straight_edges, to_piece
from learned.slf.strokes import Segments3D

_KEPT = 64  # models whose edges are kept in memory


@dataclass(frozen=True, eq=False)
class ReadyModel:
    """A model that can be placed.

    Attributes:
        obj: Its file, with materials and textures beside it.
        mesh: Its vertices and triangles as .npz, in the axes of the OBJ file.
        pose: From those axes to a piece's.
        edges: Straight edges in a piece's axes, shape (e, 2, 3).
    """

    obj: Path
    mesh: Path
    pose: Float[ndarray, "4 4"]
    edges: Float[ndarray, "e 2 3"]


@dataclass(frozen=True, eq=False)
class Furniture:
    """Models to choose from.

    Attributes:
        models: In a fixed order; scenes name them by number.
        folder: Where they are unpacked.
    """

    models: list[Model]
    folder: Path
    _ready: dict[int, ReadyModel] = field(default_factory=dict, repr=False)

    @property
    def sizes(self) -> list[tuple[float, float, float]]:
        """Width, depth and height of each in metres."""
        return [model.size for model in self.models]

    def ready(self, number: int) -> ReadyModel:
        """A model, unpacked at its first use."""
        if number not in self._ready:
            if len(self._ready) >= _KEPT:
                self._ready.pop(next(iter(self._ready)))
            self._ready[number] = _made_ready(self.models[number], self.folder)
        return self._ready[number]

    def credits(self, scene: RoomScene) -> tuple[str, ...]:
        """Lines that name the models of a scene."""
        return tuple(sorted({self.models[number].credit for number in scene.model.tolist()}))

    def edges(self, scene: RoomScene) -> Segments3D:
        """Straight edges of all models of a scene, in camera coordinates."""
        placed = zip(scene.model.tolist(), scene.model_pose, strict=True)
        parts = [moved(self.ready(number).edges, pose) for number, pose in placed]
        world = np.concatenate([*parts, np.zeros((0, 2, 3))])
        camera = torch.as_tensor((world - scene.position) @ scene.rotation, dtype=torch.float32)
        row = torch.zeros(len(camera), dtype=torch.int64)
        return Segments3D(camera[:, 0], camera[:, 1], row)

    def job(self, scene: RoomScene) -> list[dict]:
        """What a renderer needs of each model: files, and the map into the world."""
        out = []
        for number, pose in zip(scene.model.tolist(), scene.model_pose, strict=True):
            ready = self.ready(number)
            place = (pose @ ready.pose).tolist()
            out.append({"obj": str(ready.obj), "mesh": str(ready.mesh), "pose": place})
        return out


def _made_ready(model: Model, folder: Path) -> ReadyModel:
    obj = extract(model, folder)
    mesh = read_obj(obj)
    pose = to_piece(model, mesh.vertices)
    file = obj.with_suffix(".npz")
    np.savez(file, vertices=mesh.vertices, triangles=mesh.triangles)
    edges = straight_edges(Mesh(moved(mesh.vertices, pose), mesh.triangles))
    return ReadyModel(obj, file, pose, edges)
