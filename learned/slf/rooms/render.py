"""Rooms as a set: draws scenes, lets a separate interpreter with Blender render them."""

import json
import subprocess
import tempfile
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from types import TracebackType

import numpy as np
import torch
from jaxtyping import Float, UInt8
from numpy import ndarray

from learned.slf.atlas import PATTERN, Atlas
from learned.slf.layouts import draw_rotations
from learned.slf.lenses import LensBatch, frame_theta_max
from learned.slf.optics import Optics, optics
from learned.slf.pack import Annotated, build_atlas, read_rgb
from learned.slf.patterns import USES, draw_patterns, numbers_for
from learned.slf.photometry import photographed
from learned.slf.priors import lens_prior
from learned.slf.rooms.builder import RoomScene
from learned.slf.rooms.catalogue import Model
from learned.slf.rooms.lines import room_geometry, room_strokes
from learned.slf.rooms.models import Furniture
from learned.slf.rooms.scenes import draw_scene
from learned.slf.rooms.sight import Hits, TracedSight
from learned.slf.strokes import Segments3D, Strokes
from learned.slf.suite import SuiteItem, write_png
from learned.slf.synthesis import Made, SetCfg, line_bytes, suite_curves, true_camera

_ROOMS = 13
_PANORAMAS = 14
_PATTERNS = 44
_SHORTEST_SHARE = 0.04
_POSE_TRIES = 5
_ENOUGH_LINES = 8.0  # length of all lines seen, picture widths
_RESULT = "@result "
_WORKER = Path(__file__).with_name("worker.py")
EQUISOLID_FOCAL = 0.9925
"""Half widths; about 121° across and 182° along the diagonal, as Fish-SUNCG shows."""


@dataclass
class Renderer:
    """A Blender process that renders one job after the other.

    Attributes:
        python: Interpreter that has `bpy`.
        samples: Rays per pixel before denoising.
        threads: Threads of the renderer.
        denoise: Whether to denoise.
    """

    python: str
    samples: int = 8
    threads: int = 2
    denoise: bool = True
    _process: subprocess.Popen[str] | None = field(default=None, init=False, repr=False)

    def __enter__(self) -> "Renderer":
        """Start nothing yet: the process starts with the first job."""
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        value: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        """End the process."""
        self.close()

    def close(self) -> None:
        """End the process, if there is one."""
        if self._process is not None:
            with self._process as process:  # closes its pipes, too
                process.kill()
            self._process = None

    def render(self, job: dict) -> None:
        """Render a job; see `worker.py`.

        Raises:
            RuntimeError: If Blender cannot be started or fails.
        """
        options = {"samples": self.samples, "threads": self.threads, "denoise": self.denoise}
        self._ask({**job, **options})

    def trace(self, job: dict, rays: Float[ndarray, "n 3"]) -> Hits:
        """What rays from the camera of a job meet first, unit directions in world axes.

        Raises:
            RuntimeError: If Blender cannot be started or fails.
        """
        with tempfile.TemporaryDirectory(prefix="rays-") as folder:
            files = {name: str(Path(folder) / f"{name}.npy") for name in ("rays", "hits")}
            np.save(files["rays"], rays)
            self._ask({**job, **files})
            hits = np.load(files["hits"])
        return Hits(hits[:, 0], hits[:, 1:4], hits[:, 4].astype(int))

    def _ask(self, job: dict) -> None:
        """Give the process a job and wait until it is done."""
        process = self._running()
        assert process.stdin is not None
        try:
            process.stdin.write(json.dumps(job) + "\n")
            process.stdin.flush()
            result = next(self._results(process), None)
        except BrokenPipeError:
            result = None
        if result is None:
            code = process.wait()
            self.close()
            raise RuntimeError(
                f"Blender ended with code {code}; {self.python} needs the module bpy 4.5 "
                "(pip install 'bpy==4.5.*' in an environment of its own)"
            )
        if result["error"]:
            raise RuntimeError(f"Blender failed: {result['error'].strip().splitlines()[-1]}")

    def _running(self) -> subprocess.Popen[str]:
        if self._process is None or self._process.poll() is not None:
            self._process = subprocess.Popen(
                [self.python, str(_WORKER)],
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                stderr=subprocess.DEVNULL,
                text=True,
            )
        return self._process

    @staticmethod
    def _results(process: subprocess.Popen[str]) -> Iterator[dict]:
        assert process.stdout is not None
        for line in process.stdout:
            if line.startswith(_RESULT):
                yield json.loads(line[len(_RESULT) :])


@dataclass(frozen=True)
class RoomStudio:
    """What all rooms of a set share.

    Attributes:
        atlas: Drawn textures, then one without lines.
        paths: Files of the textures.
        renderer: Blender.
        furniture: Models beside the furniture of boxes, if any.
    """

    atlas: Atlas
    paths: dict[str, str]
    renderer: Renderer
    furniture: Furniture | None = None


def open_studio(
    renderer: Renderer, folder: Path, *, seed: int, models: Sequence[Model] = ()
) -> RoomStudio:
    """Draw the textures into a folder and pack them; models are unpacked there when needed."""
    drawn = list(draw_patterns(_PATTERNS, seed=seed))
    paths = {}
    for i, pattern in enumerate(drawn):
        file = folder / f"pattern_{i:03d}.png"
        write_png(file, pattern.image)
        paths[str(i)] = str(file)
    blank = Annotated(np.full((16, 16, 3), 128, np.uint8), np.zeros((0, 4), np.float32), PATTERN)
    furniture = Furniture(list(models), folder / "models") if models else None
    return RoomStudio(build_atlas([*drawn, blank]), paths, renderer, furniture)


def make_room(studio: RoomStudio, index: int, config: SetCfg) -> Made:
    """Draw, render and annotate one room.

    Args:
        studio: Textures and renderer.
        index: Number of the item.
        config: Lens prior (`equisolid` is the paper's single lens), size and seed.
    """
    rng = np.random.default_rng([config.seed, _ROOMS, index])
    lenses = room_lenses(config.prior, rng)
    furniture = studio.furniture
    uses = {use: numbers_for(use, len(studio.paths)) for use in USES}
    scene = draw_scene(rng, uses, furniture.sizes if furniture else ())
    lens = optics(lenses, size=config.size)
    with tempfile.TemporaryDirectory(prefix="room-") as folder:
        pictures = [Path(folder) / name for name in ("fisheye.png", "straight.png")]
        job = room_job(scene, lenses, studio, index, config, pictures)
        scene, strokes, segments = _pose_with_lines(rng, studio, scene, job, lens)
        studio.renderer.render(room_job(scene, lenses, studio, index, config, pictures))
        fisheye, straight = (read_rgb(path) for path in pictures)
    if config.photometry is not None:
        fisheye = _photographed(fisheye, lens, rng, config)
    item = SuiteItem(
        index=index,
        camera=true_camera(lenses.vector[0], config.size),
        theta_max=float(lenses.theta_max[0]),
        curves=suite_curves(strokes, segments, 0),
        origin="street" if scene.is_open else "room",
        credits=furniture.credits(scene) if furniture else (),
    )
    return Made(item, fisheye, straight, line_bytes(strokes, config.size))


def make_room_panorama(
    studio: RoomStudio, index: int, seed: int, height: int
) -> UInt8[ndarray, "h 2*h 3"]:
    """Draw a room or a street and render all that is around a level camera in it.

    Args:
        studio: Textures and renderer.
        index: Number of the panorama.
        seed: Of the set.
        height: In pixels; the panorama is twice as wide.

    Returns:
        Equirectangular, as `learned.slf.panoramas` reads it.
    """
    rng = np.random.default_rng([seed, _PANORAMAS, index])
    sizes = studio.furniture.sizes if studio.furniture else ()
    scene = draw_scene(rng, {use: numbers_for(use, len(studio.paths)) for use in USES}, sizes)
    level = replace(scene, rotation=np.eye(3))
    with tempfile.TemporaryDirectory(prefix="room-") as folder:
        path = Path(folder) / "panorama.png"
        job = scene_job(level, studio, index, seed, height)
        studio.renderer.render({**job, "panorama": str(path)})
        return read_rgb(path)


def _pose_with_lines(
    rng: np.random.Generator, studio: RoomStudio, scene: RoomScene, job: dict, lens: Optics
) -> tuple[RoomScene, Strokes, Segments3D]:
    """The scene as the camera stands or turned so that it sees enough lines, or most of them."""
    tries: list[tuple[float, RoomScene, Strokes, Segments3D]] = []
    for _ in range(_POSE_TRIES):
        strokes, segments = _strokes(studio, scene, job, lens)
        seen = float(strokes.length.sum()) / lens.size
        tries.append((seen, scene, strokes, segments))
        if seen >= _ENOUGH_LINES:
            break
        scene = replace(scene, rotation=draw_rotations(rng, 1)[0])
    _, scene, strokes, segments = max(tries, key=lambda tried: tried[0])
    return scene, strokes, segments


def _strokes(
    studio: RoomStudio, scene: RoomScene, job: dict, lens: Optics
) -> tuple[Strokes, Segments3D]:
    """Visible lines; with models in the scene Blender says what hides what."""
    room = room_geometry(scene, studio.atlas)
    shortest = _SHORTEST_SHARE * lens.size
    if studio.furniture is None or not len(scene.model):
        return room_strokes(room, studio.atlas, lens, shortest_px=shortest)
    sight = TracedSight(scene.rotation, lambda rays: studio.renderer.trace(job, rays))
    edges = studio.furniture.edges(scene)
    return room_strokes(room, studio.atlas, lens, shortest_px=shortest, sight=sight, edges=edges)


def room_lenses(prior: str, rng: np.random.Generator) -> LensBatch:
    """One lens of a prior, or the paper's equisolid one."""
    if prior != "equisolid":
        return lens_prior(prior).sample(rng, 1)
    f = EQUISOLID_FOCAL
    # 2 f sin(θ / 2) as a series; the fifth term leaves 1e−6 at 95°
    k = f * np.array([1.0, -1 / 24, 1 / 1920, -1 / 322560, 1 / 92897280])
    vector = np.concatenate([k, [1.0, 1.0, 0.0, 0.0]])[None]
    circle, height = np.full(1, np.inf), np.ones(1)
    return LensBatch(vector, frame_theta_max(vector, circle, height), circle, height)


def room_job(
    scene: RoomScene,
    lenses: LensBatch,
    studio: RoomStudio,
    index: int,
    config: SetCfg,
    pictures: list[Path],
) -> dict:
    """The scene, the lens and the files as plain numbers."""
    vector = lenses.vector[0]
    names = ("k1", "k2", "k3", "k4", "k5")
    lens = {
        **dict(zip(names, vector[:5].tolist(), strict=True)),
        "m_v": float(vector[6]),
        "u0": float(vector[7]),
        "v0": float(vector[8]),
        "theta_max": float(lenses.theta_max[0]),
        "circle": float(min(lenses.circle[0], 1e3)),
        "half_height": float(lenses.half_height[0]),
    }
    files = {"fisheye": str(pictures[0]), "straight": str(pictures[1])}
    return {**scene_job(scene, studio, index, config.seed, config.size), "lens": lens, **files}


def scene_job(scene: RoomScene, studio: RoomStudio, index: int, seed: int, size: int) -> dict:
    """The scene as plain numbers, without lens and files; pictures are `size` high."""
    n = len(scene.centre)
    shell = [-1, -1, -1, int(scene.shell_material[3]), -1, -1]
    shell = shell if scene.is_open else scene.shell_material.tolist()
    faces = [shell, *np.repeat(scene.material[:, None], 6, axis=1).tolist()]
    arrays = {name: np.asarray(value).tolist() for name, value in vars(scene).items()}
    arrays["centre"] = [[0.0, 0.0, 0.0], *arrays["centre"]]
    arrays["half"] = [arrays["shell"], *arrays["half"]]
    arrays["yaw"] = [0.0, *arrays["yaw"]]
    assert len(faces) == n + 1
    return {
        "index": index,
        "key": [seed, index],
        "seed": int(np.random.default_rng([seed, index]).integers(2**31)),
        "size": size,
        "scene": {**arrays, "face_material": faces},
        "models": studio.furniture.job(scene) if studio.furniture else [],
        "patterns": studio.paths,
    }


def _photographed(
    image: ndarray, lens: Optics, rng: np.random.Generator, config: SetCfg
) -> ndarray:
    tensor = torch.from_numpy(image).permute(2, 0, 1)[None].float() / 255
    done = photographed(tensor, lens, rng=rng, config=config.photometry)
    return (done[0] * 255).round().byte().permute(1, 2, 0).numpy()
