"""Triangle meshes of furniture: read from OBJ files, brought to size, and their straight edges."""

from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

import numpy as np
from jaxtyping import Float, Int
from numpy import ndarray

from learned.slf.rooms.catalogue import Model

SHARP = np.radians(35.0)
"""Dihedral angle from which two faces meet in an edge."""
_SHORTEST_M = 0.08
_TURN = np.radians(3.0)  # up to which edges that meet go on as one line
_BEND = np.radians(30.0)  # below which edges that meet are pieces of a bent rim, not two lines
_WELD_M = 1e-4


@dataclass(frozen=True)
class Mesh:
    """A mesh.

    Attributes:
        vertices: Points, shape (n, 3).
        triangles: Their corners, shape (m, 3).
    """

    vertices: Float[ndarray, "n 3"]
    triangles: Int[ndarray, "m 3"]


def read_obj(path: Path) -> Mesh:
    """Read vertices and faces of an OBJ file; polygons become fans of triangles.

    Raises:
        ValueError: If there are no faces, or one names a vertex that is not there.
    """
    vertices: list[list[float]] = []
    triangles: list[tuple[int, int, int]] = []
    for line in path.read_text("latin-1").splitlines():
        kind, *rest = line.split() or [""]
        if kind == "v":
            vertices.append([float(x) for x in rest[:3]])
        elif kind == "f":
            corner = [int(word.split("/")[0]) for word in rest]
            corner = [c - 1 if c > 0 else len(vertices) + c for c in corner]
            triangles += [(corner[0], b, c) for b, c in pairwise(corner[1:])]
    if not triangles:
        raise ValueError(f"expected faces in {path}, got none")
    corners = np.array(triangles)
    if corners.min() < 0 or corners.max() >= len(vertices):
        raise ValueError(f"expected faces of known vertices in {path}")
    return Mesh(np.array(vertices), corners)


def to_piece(model: Model, vertices: Float[ndarray, "n 3"]) -> Float[ndarray, "4 4"]:
    """From OBJ axes to a piece's: x right, y down, z to its back, origin at its front's foot.

    The mesh is stretched to the catalogue's width, depth and height.
    """
    turned = vertices @ model.rotation.T
    low, high = turned.min(axis=0), turned.max(axis=0)
    width, depth, height = model.size
    scale = np.array([width, height, depth]) / np.maximum(high - low, 1e-9)
    anchor = np.array([(low[0] + high[0]) / 2, low[1], high[2]])
    flip = np.diag([1.0, -1.0, -1.0])
    out = np.eye(4)
    out[:3, :3] = flip @ np.diag(scale) @ model.rotation
    out[:3, 3] = -flip @ (scale * anchor)
    return out


def moved(points: Float[ndarray, "*n 3"], pose: Float[ndarray, "4 4"]) -> Float[ndarray, "*n 3"]:
    """Points under an affine map."""
    return points @ pose[:3, :3].T + pose[:3, 3]


def straight_edges(mesh: Mesh) -> Float[ndarray, "e 2 3"]:
    """Straight edges where faces meet sharply or end, longest pieces first.

    Edges that go on in the same direction are joined; pieces of bent rims, and what is shorter than
    8 cm, are left out.

    Args:
        mesh: In metres.
    """
    points, corners = _welded(mesh)
    edges = _sharp_edges(points, corners)
    if not len(edges):
        return np.zeros((0, 2, 3))
    lines = _joined(points, edges)
    ends = points[lines]
    length = np.linalg.norm(ends[:, 1] - ends[:, 0], axis=1)
    keep = (length >= _SHORTEST_M) & ~_on_a_rim(points, lines)
    order = np.argsort(-length[keep], kind="stable")
    return ends[keep][order]


def _welded(mesh: Mesh) -> tuple[ndarray, ndarray]:
    """Points without doubles, and triangles with an area."""
    cells = np.round(mesh.vertices / _WELD_M).astype(np.int64)
    _, first, number = np.unique(cells, axis=0, return_index=True, return_inverse=True)
    corners = number.reshape(-1)[mesh.triangles]
    a, b, c = corners.T
    return mesh.vertices[first], corners[(a != b) & (b != c) & (a != c)]


def _sharp_edges(points: ndarray, corners: ndarray) -> Int[ndarray, "e 2"]:
    """Edges of one face alone, or of faces that differ by more than `SHARP` in direction."""
    a, b, c = (points[corners[:, i]] for i in range(3))
    normal = np.cross(b - a, c - a)
    normal /= np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-12)
    sides = np.sort(corners[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), axis=1)
    owner = np.repeat(np.arange(len(corners)), 3)
    edges, number, count = np.unique(sides, axis=0, return_inverse=True, return_counts=True)
    order = np.argsort(number.reshape(-1), kind="stable")
    first = np.concatenate([[0], np.cumsum(count)[:-1]])
    faces = owner[order]
    one, other = faces[first], faces[np.minimum(first + 1, len(faces) - 1)]
    # the winding of furniture models is not to be relied on, so directions have no sign
    cosine = np.abs((normal[one] * normal[other]).sum(axis=1))
    return edges[(count == 1) | ((count == 2) & (cosine < np.cos(SHARP)))]


def _joined(points: ndarray, edges: ndarray) -> Int[ndarray, "l 2"]:
    """Ends of lines of edges that go on in the same direction."""
    ends = [list(edge) for edge in edges.tolist()]
    at: dict[int, set[int]] = {}
    for line, (a, b) in enumerate(ends):
        at.setdefault(a, set()).add(line)
        at.setdefault(b, set()).add(line)
    alive = [True] * len(ends)
    for point, lines in at.items():
        while (pair := _going_on(points, ends, point, lines)) is not None:
            one, two = pair
            far = ends[two][0] if ends[two][1] == point else ends[two][1]
            ends[one][ends[one].index(point)] = far
            alive[two] = False
            lines -= {one, two}
            at[far].discard(two)
            at[far].add(one)
    return np.array([end for end, lives in zip(ends, alive, strict=True) if lives])


def _going_on(
    points: ndarray, ends: list[list[int]], point: int, lines: set[int]
) -> tuple[int, int] | None:
    """Two lines at a point that are one, the first in order."""
    names = sorted(lines)
    away = _directions(points, ends, point, names)
    for i in range(len(names)):
        for j in range(i + 1, len(names)):
            if float(away[i] @ away[j]) < -np.cos(_TURN):
                return names[i], names[j]
    return None


def _directions(
    points: ndarray, ends: list[list[int]], point: int, names: list[int]
) -> Float[ndarray, "k 3"]:
    """Unit directions of lines away from a point that they end at."""
    others = [ends[n][0] if ends[n][1] == point else ends[n][1] for n in names]
    step = points[others] - points[point]
    return step / np.maximum(np.linalg.norm(step, axis=1, keepdims=True), 1e-12)


def _on_a_rim(points: ndarray, lines: Int[ndarray, "l 2"]) -> ndarray:
    """True for lines that another goes on from with a slight turn: the rim of something round."""
    ends = lines.tolist()
    at: dict[int, list[int]] = {}
    for line, (a, b) in enumerate(ends):
        at.setdefault(a, []).append(line)
        at.setdefault(b, []).append(line)
    rim = np.zeros(len(lines), dtype=bool)
    for point, names in at.items():
        away = _directions(points, ends, point, names)
        cosine = away @ away.T
        np.fill_diagonal(cosine, 1.0)
        rim[names] |= (cosine < -np.cos(_BEND)).any(axis=1)
    return rim
