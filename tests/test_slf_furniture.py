"""Furniture models: catalogues, meshes, their edges, and what they hide."""

import zipfile
from pathlib import Path

import numpy as np
import pytest
import torch

from learned.slf.atlas import PATTERN
from learned.slf.boxes import first_hits
from learned.slf.optics import optics
from learned.slf.pack import Annotated, build_atlas
from learned.slf.patterns import USES, draw_patterns, numbers_for
from learned.slf.rooms.catalogue import extract, read_catalogues
from learned.slf.rooms.lines import room_geometry, room_strokes
from learned.slf.rooms.meshes import Mesh, moved, read_obj, straight_edges, to_piece
from learned.slf.rooms.models import Furniture
from learned.slf.rooms.render import room_lenses
from learned.slf.rooms.scenes import draw_scene
from learned.slf.rooms.sight import Hits, TracedSight

CUBE = """# a cube of 2 with one face divided
v -1 0 -1
v 1 0 -1
v 1 2 -1
v -1 2 -1
v -1 0 1
v 1 0 1
v 1 2 1
v -1 2 1
v 0 2 1
f 1 2 3 4
f 5/1 6/2 7/3 9/4
f 5 9 8
f 1 5 6 2
f 4 3 7 9 8
f 1 4 8 5
f 2 6 7 3
"""


def entry(number: int, name: str, **other: object) -> str:
    properties = {
        "id": f"Test#{name}",
        "category": "Bedroom",
        "model": f"/models/{name}/{name}.obj",
        "width": 80,
        "depth": 50,
        "height": 120,
        "doorOrWindow": "false",
        "creator": "Ren\\u00e9",
        **other,
    }
    return "".join(f"{key}#{number}={value}\n" for key, value in properties.items())


def write_catalogue(path: Path, licence: str, entries: list[str], *, glass: str = "") -> None:
    text = f"# comment = no entry\nlicense={licence}\n" + "\n".join(entries)
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr("PluginFurnitureCatalog.properties", text.encode("latin-1"))
        for name in ("chest", "lamp", "door", "glass", "turned", "shelf"):
            archive.writestr(f"models/{name}/{name}.obj", CUBE)
            opacity = "d 0.3" if name == glass else "d 1.0"
            archive.writestr(f"models/{name}/{name}.mtl", f"newmtl a\nKd 1 0 0\n{opacity}\n")


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    folder = tmp_path_factory.mktemp("sh3f")
    free = [
        entry(1, "chest"),
        entry(2, "lamp", elevation=150),
        entry(3, "door", doorOrWindow="true"),
        entry(4, "glass"),
        entry(5, "gone"),
        entry(6, "lamp", width=5),
        entry(7, "door", category="Exterior"),
        entry(10, "turned", modelRotation="0 0 1 0 1 0 -1 0 0"),
    ]
    write_catalogue(folder / "free.sh3f", "Public domain", free, glass="glass")
    write_catalogue(folder / "named.sh3f", "Creative Commons Attribution 3.0", [entry(1, "shelf")])
    return folder


# ---- catalogues ----------------------------------------------------------------------------------


def test_a_catalogue_gives_what_stands_on_the_floor_and_is_opaque(folder):
    names = [model.name for model in read_catalogues(folder)]
    assert names == ["Test#chest", "Test#turned", "Test#shelf"]


def test_every_model_has_its_size_author_and_licence(folder):
    first, _, last = read_catalogues(folder)
    assert first.size == (0.8, 0.5, 1.2)
    assert first.credit == "Test#chest by René; Public domain"
    assert (first.is_cc0, last.is_cc0) == (True, False)


def test_only_the_public_domain_on_request(folder):
    assert all(model.is_cc0 for model in read_catalogues(folder, cc0_only=True))


def test_a_folder_without_catalogues_is_refused(tmp_path):
    with pytest.raises(ValueError, match="got none"):
        read_catalogues(tmp_path)


def test_a_broken_catalogue_is_refused(tmp_path):
    (tmp_path / "bad.sh3f").write_bytes(b"no zip")
    with pytest.raises(ValueError, match=r"bad\.sh3f"):
        read_catalogues(tmp_path)


# ---- meshes --------------------------------------------------------------------------------------


@pytest.mark.parametrize("number", [0, 1])
def test_a_model_fills_the_box_of_its_catalogue(folder, tmp_path, number):
    model = read_catalogues(folder)[number]
    mesh = read_obj(extract(model, tmp_path))
    points = moved(mesh.vertices, to_piece(model, mesh.vertices))
    np.testing.assert_allclose(points.min(axis=0), [-0.4, -1.2, 0.0], atol=1e-9)
    np.testing.assert_allclose(points.max(axis=0), [0.4, 0.0, 0.5], atol=1e-9)


def test_the_front_of_a_model_is_the_front_of_the_piece(folder, tmp_path):
    """The front looks along +z in OBJ files of Sweet Home 3D; a piece's front is at z = 0."""
    model = read_catalogues(folder)[0]
    mesh = read_obj(extract(model, tmp_path))
    front = np.array([[0.0, 1.0, 1.0]])
    assert moved(front, to_piece(model, mesh.vertices))[0, 2] == pytest.approx(0.0)


def test_a_cube_has_twelve_edges(folder, tmp_path):
    """A face of two polygons has no edge between them; an edge of two pieces is one line."""
    mesh = read_obj(extract(read_catalogues(folder)[0], tmp_path))
    edges = straight_edges(mesh)
    assert len(edges) == 12
    np.testing.assert_allclose(np.linalg.norm(edges[:, 1] - edges[:, 0], axis=1), 2.0)


def prism(corners: int) -> Mesh:
    angle = 2 * np.pi * np.arange(corners) / corners
    ring = np.stack([np.cos(angle), np.zeros(corners), np.sin(angle)], axis=1)
    n = corners
    sides = [(i, (i + 1) % n, n + i) for i in range(n)]
    sides += [((i + 1) % n, n + (i + 1) % n, n + i) for i in range(n)]
    caps = [(k, k + i, k + i + 1) for k in (0, n) for i in range(1, n - 1)]
    top = ring + np.array([0.0, 2.0, 0.0])
    return Mesh(np.concatenate([ring, top]), np.array(sides + caps))


def test_a_round_rim_is_no_straight_line():
    assert len(straight_edges(prism(24))) == 0


def test_a_prism_keeps_its_edges():
    assert len(straight_edges(prism(4))) == 12
    assert len(straight_edges(prism(6))) == 18


def test_open_sheets_end_in_edges():
    sheet = Mesh(
        np.array([[0.0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]]), np.array([[0, 1, 2], [0, 2, 3]])
    )
    assert len(straight_edges(sheet)) == 4


def test_an_obj_without_faces_is_refused(tmp_path):
    (tmp_path / "a.obj").write_text("v 0 0 0\n")
    with pytest.raises(ValueError, match="faces"):
        read_obj(tmp_path / "a.obj")


# ---- scenes --------------------------------------------------------------------------------------


def scene_with_models(seed: int, sizes: list[tuple[float, float, float]]):
    uses = {use: numbers_for(use, 11) for use in USES}
    return draw_scene(np.random.default_rng(seed), uses, sizes)


def test_models_stand_on_the_floor_inside_the_room():
    size = (0.8, 0.5, 1.2)
    placed = 0
    for seed in range(8):
        scene = scene_with_models(seed, [size])
        corners = np.array(
            [[x, y, z] for x in (-0.4, 0.4) for y in (-1.2, 0.0) for z in (0.0, 0.5)]
        )
        for pose in scene.model_pose:
            world = moved(corners, pose)
            assert world[:, 1].max() == pytest.approx(scene.shell[1])
            assert (np.abs(world[:, [0, 2]]) <= scene.shell[[0, 2]] + 1e-6).all()
            placed += 1
    assert placed > 8


def test_rooms_without_models_are_what_they_were(folder):
    assert len(scene_with_models(3, []).model) == 0


def test_edges_of_a_model_are_where_it_stands(folder, tmp_path):
    furniture = Furniture(read_catalogues(folder), tmp_path)
    scene = next(
        s for s in (scene_with_models(i, furniture.sizes) for i in range(9)) if len(s.model)
    )
    edges = furniture.edges(scene)
    world = edges.start.double().numpy() @ scene.rotation.T + scene.position
    assert len(edges) == 12 * len(scene.model)
    assert world[:, 1].max() == pytest.approx(scene.shell[1], abs=1e-5)
    job = furniture.job(scene)
    assert [Path(model["obj"]).is_file() for model in job] == [True] * len(scene.model)
    assert furniture.credits(scene)


@pytest.fixture(scope="module")
def textures():
    blank = Annotated(np.full((16, 16, 3), 128, np.uint8), np.zeros((0, 4), np.float32), PATTERN)
    return build_atlas([*draw_patterns(11, seed=1), blank])


def test_tracing_sees_the_lines_that_arithmetic_sees(textures):
    """A tracer of the boxes alone finds the same lines as the boxes' own formulas."""
    scene = scene_with_models(0, [])
    room = room_geometry(scene, textures)
    lens = optics(room_lenses("equisolid", np.random.default_rng(0)), size=320)

    def trace(rays: np.ndarray) -> Hits:
        camera = torch.from_numpy(rays @ scene.rotation).float()
        depth, owner, face = first_hits(
            room.boxes, camera, torch.zeros(len(rays), dtype=torch.int64)
        )
        yaw = room.boxes.yaw[0, owner].double().numpy()
        axis = (face // 2).numpy()
        side, zero = np.ones_like(yaw), np.zeros_like(yaw)
        along_x = np.stack([np.cos(yaw), zero, -np.sin(yaw)], axis=1)
        along_z = np.stack([np.sin(yaw), zero, np.cos(yaw)], axis=1)
        up = np.stack([zero, side, zero], axis=1)
        normal = np.choose(axis[:, None], [along_x, up, along_z])
        return Hits(depth.double().numpy(), normal, room.material[0, owner, face].numpy())

    plain, _ = room_strokes(room, textures, lens, shortest_px=13.0)
    traced, _ = room_strokes(
        room, textures, lens, shortest_px=13.0, sight=TracedSight(scene.rotation, trace)
    )
    assert float(traced.length.sum()) == pytest.approx(float(plain.length.sum()), rel=0.02)
