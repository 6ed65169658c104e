"""A training set made ahead: samples of the stream, with what line perception sees in them.

On a CPU, making a sample and perceiving its lines costs more than a training step on it. Made once
and kept as memory-mapped bytes, each sample is used in every epoch, mirrored and with another
exposure, and never beside its twin. Line perception is fixed in phase two, so its maps are kept.
"""

from __future__ import annotations

import json
from dataclasses import asdict, dataclass, field, replace
from functools import lru_cache, partial
from pathlib import Path

import numpy as np
import torch
from jaxtyping import Float, Int, UInt8
from numpy import ndarray
from torch import Tensor
from torch.nn import functional
from tqdm import tqdm

from classical.files import atomic_path
from learned.dlp import LinePerception
from learned.mirror import MIRRORS, mirrored, transposed
from learned.pool import WorkPool
from learned.rectification import rectify_images
from learned.slf.atlas import load_atlas
from learned.slf.batch import SlfBatch
from learned.slf.stream import SlfStream, StreamCfg
from learned.weights import load_perception

_GROUP = 8
_DESCRIPTION = "samples.json"
_DONE = "done.npy"
_EXPOSURE = (0.8, 1.25)
_ARRAYS = ("image", "line_map", "seen", "k", "theta_max")


@dataclass(frozen=True)
class SamplesCfg:
    """What a set is made of; a set of another making is not gone on with.

    Attributes:
        count: Number of samples, a multiple of eight.
        size: Side of the frame in pixels.
        seed: Seed of the stream.
        pack: Training pictures.
        perception: Weights whose line perception looks at the samples, or None for no maps.
        data: Mixture of scenes and lenses.
    """

    count: int
    size: int
    seed: int
    pack: Path
    perception: Path | None = None
    data: StreamCfg = field(default_factory=StreamCfg)

    def __post_init__(self) -> None:
        if self.count < _GROUP or self.count % _GROUP:
            raise ValueError(f"expected a multiple of {_GROUP} samples, got {self.count}")

    def described(self) -> dict[str, object]:
        """What is kept beside the samples; files by their names, wherever they lie."""
        names = {"pack": self.pack.name, "perception": self.perception and self.perception.name}
        return json.loads(json.dumps(asdict(self) | names))


class SampleSet:
    """The set in a folder, by number.

    Args:
        folder: Made by `make_samples`.
        stride: The rectified pictures are this much smaller than the fisheye ones.
    """

    def __init__(self, folder: Path, *, stride: int = 1) -> None:
        self._arrays = {n: np.load(folder / f"{n}.npy", mmap_mode="r") for n in _ARRAYS}
        self.count = len(self._arrays["k"])
        self.stride = stride

    def batch(self, numbers: Int[ndarray, " b"]) -> SlfBatch:
        """Some samples; the rectified picture is that of the picture with its effects."""
        image = _pictures(self._arrays["image"][numbers])
        k = torch.from_numpy(self._arrays["k"][numbers])
        seen = None
        if self._arrays["seen"].size:
            seen = _pictures(self._arrays["seen"][numbers])
        return SlfBatch(
            image=image,
            line_map=_pictures(self._arrays["line_map"][numbers]),
            k=k,
            rectified=rectify_images(functional.avg_pool2d(image, self.stride), k),
            theta_max=torch.from_numpy(self._arrays["theta_max"][numbers]),
            seen=seen,
        )


@dataclass(frozen=True)
class Epochs:
    """Batches of a set by number: every sample once an epoch, in another order and mirror each.

    Batch i depends on the seed and on i only.

    Attributes:
        samples: The set.
        seed: Of order, mirrors and light.
        batch_size: Samples a batch.
        upright: Share of the batches whose pictures are transposed: a wide picture becomes a high
            one, which the priors of lenses never have.
    """

    samples: SampleSet
    seed: int
    batch_size: int
    upright: float = 0.0

    def __call__(self, number: int) -> SlfBatch:
        """Batch `number`."""
        per_epoch = self.samples.count // self.batch_size
        if not per_epoch:
            raise ValueError(
                f"expected a batch of at most {self.samples.count} samples, got {self.batch_size}"
            )
        epoch, at = divmod(number, per_epoch)
        order = _order(self.seed, epoch, self.samples.count)
        rows = np.sort(order[at * self.batch_size : (at + 1) * self.batch_size])
        rng = np.random.default_rng([self.seed, 2, number])
        batch = mirrored(self.samples.batch(rows), MIRRORS[rng.integers(len(MIRRORS))])
        exposure = torch.from_numpy(rng.uniform(*_EXPOSURE, (len(rows), 3, 1, 1)).astype("f4"))
        lit = [(picture * exposure).clamp(0, 1) for picture in (batch.image, batch.rectified)]
        batch = replace(batch, image=lit[0], rectified=lit[1])
        return transposed(batch) if rng.random() < self.upright else batch


def make_samples(
    folder: Path, cfg: SamplesCfg, *, stride: int = 1, workers: int = 1, progress: bool = True
) -> SampleSet:
    """Make the set, or what is missing of it.

    Args:
        folder: Where to; made if needed.
        cfg: What to make.
        stride: Of the rectified pictures; see `SampleSet`.
        workers: Processes.
        progress: Draw a progress bar.

    Raises:
        ValueError: If the folder holds a set of another making.
    """
    _make_room(folder, cfg)
    done = np.load(folder / _DONE, mmap_mode="r")
    missing = np.flatnonzero(np.asarray(done) == 0).tolist()
    there = cfg.count - _GROUP * len(missing)
    bar = tqdm(total=cfg.count, initial=there, unit="sample", disable=not progress)
    with bar, WorkPool(workers=workers) as pool:
        for _ in pool.ordered(partial(_make_group, folder, cfg), missing):
            bar.update(_GROUP)
    return SampleSet(folder, stride=stride)


def _make_room(folder: Path, cfg: SamplesCfg) -> None:
    """Files of full length, then what they are for; later, see that it is the same set."""
    path = folder / _DESCRIPTION
    if path.exists():
        if json.loads(path.read_text()) != cfg.described():
            raise ValueError(f"expected samples made like this run's, got others in {folder}")
        return
    folder.mkdir(parents=True, exist_ok=True)
    n, side = cfg.count, cfg.size
    shapes: dict[str, tuple[tuple[int, ...], str]] = {
        "image": ((n, side, side, 3), "u1"),
        "line_map": ((n, side, side, 1), "u1"),
        "seen": ((n, side, side, 2) if cfg.perception else (n, 0), "u1"),
        "k": ((n, 9), "f4"),
        "theta_max": ((n,), "f4"),
        "done": ((n // _GROUP,), "u1"),
    }
    for name, (shape, kind) in shapes.items():
        np.lib.format.open_memmap(folder / f"{name}.npy", mode="w+", dtype=kind, shape=shape)
    with atomic_path(path) as temporary:
        temporary.write_text(json.dumps(cfg.described(), indent=1))


@torch.no_grad()
def _make_group(folder: Path, cfg: SamplesCfg, group: int) -> None:
    """Make samples 8·group to 8·group + 7; the mark that they are there comes last."""
    stream, perception, arrays = _workshop(folder, cfg)
    batch = stream.batch(group)
    rows = slice(_GROUP * group, _GROUP * (group + 1))
    arrays["image"][rows] = _bytes(batch.image)
    arrays["line_map"][rows] = _bytes(batch.line_map)
    arrays["k"][rows] = batch.k.numpy()
    arrays["theta_max"][rows] = batch.theta_max.numpy()
    if perception is not None:
        arrays["seen"][rows] = _bytes(perception.maps(batch.image))
    arrays["done"][group] = 1


@lru_cache(maxsize=1)
def _workshop(
    folder: Path, cfg: SamplesCfg
) -> tuple[SlfStream, LinePerception | None, dict[str, ndarray]]:
    """What a process needs to make samples, loaded once."""
    data = replace(cfg.data, with_rectified=False)
    stream = SlfStream(load_atlas(cfg.pack), cfg.seed, _GROUP, cfg.size, data)
    perception = None if cfg.perception is None else load_perception(cfg.perception).eval()
    arrays = {n: np.load(folder / f"{n}.npy", mmap_mode="r+") for n in (*_ARRAYS, "done")}
    return stream, perception, arrays


@lru_cache(maxsize=1)
def _order(seed: int, epoch: int, count: int) -> Int[ndarray, " n"]:
    """The order of the samples in an epoch."""
    return np.random.default_rng([seed, 1, epoch]).permutation(count)


def _bytes(picture: Float[Tensor, "b c h w"]) -> UInt8[ndarray, "b h w c"]:
    return (picture.clamp(0, 1) * 255).round().byte().permute(0, 2, 3, 1).numpy()


def _pictures(stored: UInt8[ndarray, "b h w c"]) -> Float[Tensor, "b c h w"]:
    return torch.from_numpy(stored).permute(0, 3, 1, 2).float() / 255
