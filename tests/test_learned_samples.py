"""Training sets made ahead: whole, the same again, every sample once an epoch."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from small_networks import SMALL_DLP, write_small_pack

from learned.dlp import LinePerception
from learned.rectification import rectify_images
from learned.samples import Epochs, SamplesCfg, SampleSet, make_samples
from learned.slf.atlas import load_atlas
from learned.slf.stream import SlfStream
from learned.weights import load_perception, save_weights


@pytest.fixture(scope="module")
def cfg(tmp_path_factory: pytest.TempPathFactory) -> SamplesCfg:
    """Two photographs with lines, an untrained line perception, sixteen small samples."""
    folder = tmp_path_factory.mktemp("pack")
    torch.manual_seed(0)
    save_weights(folder / "dlp.safetensors", LinePerception(SMALL_DLP), {})
    return SamplesCfg(
        count=16,
        size=32,
        seed=5,
        pack=write_small_pack(folder / "small.pack", 2),
        perception=folder / "dlp.safetensors",
    )


@pytest.fixture(scope="module")
def folder(cfg: SamplesCfg, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The set on disk."""
    out = tmp_path_factory.mktemp("set")
    make_samples(out, cfg, progress=False)
    return out


def test_samples_are_those_of_the_stream_in_bytes(cfg: SamplesCfg, folder: Path) -> None:
    assert cfg.perception is not None
    ahead = SampleSet(folder).batch(np.arange(8, 16))
    data = replace(cfg.data, with_rectified=False)
    fresh = SlfStream(load_atlas(cfg.pack), cfg.seed, 8, cfg.size, data).batch(1)
    torch.testing.assert_close(ahead.image, fresh.image, atol=0.51 / 255, rtol=0)
    torch.testing.assert_close(ahead.line_map, fresh.line_map, atol=0.51 / 255, rtol=0)
    assert torch.equal(ahead.k, fresh.k)
    assert torch.equal(ahead.theta_max, fresh.theta_max)
    with torch.inference_mode():
        maps = load_perception(cfg.perception).maps(fresh.image)
    assert ahead.seen is not None
    torch.testing.assert_close(ahead.seen, maps, atol=0.51 / 255, rtol=0)
    torch.testing.assert_close(ahead.rectified, rectify_images(ahead.image, ahead.k))


def test_what_is_missing_is_made_again_to_the_same_bytes(
    cfg: SamplesCfg, folder: Path, tmp_path: Path
) -> None:
    make_samples(tmp_path, cfg, progress=False)
    names = ("image", "line_map", "seen", "k", "theta_max")
    for name in (*names, "done"):  # as if it had been stopped before the last group
        np.load(tmp_path / f"{name}.npy", mmap_mode="r+")[-8 if name != "done" else -1 :] = 0
    make_samples(tmp_path, cfg, progress=False)
    for name in (*names, "done"):
        assert (tmp_path / f"{name}.npy").read_bytes() == (folder / f"{name}.npy").read_bytes()


def test_a_set_of_another_making_is_refused(cfg: SamplesCfg, folder: Path) -> None:
    with pytest.raises(ValueError, match="made like this run's"):
        make_samples(folder, replace(cfg, seed=6), progress=False)
    with pytest.raises(ValueError, match="multiple of 8"):
        replace(cfg, count=12)


def test_an_epoch_has_every_sample_once_and_depends_on_the_number_alone(folder: Path) -> None:
    samples = SampleSet(folder)
    epochs = Epochs(samples, seed=1, batch_size=4)
    seen = torch.cat([epochs(i).theta_max for i in range(4)])
    whole = samples.batch(np.arange(16)).theta_max
    assert torch.equal(seen.sort().values, whole.sort().values)
    again = Epochs(SampleSet(folder), seed=1, batch_size=4)(6)
    assert torch.equal(epochs(6).image, again.image)
    assert not torch.equal(epochs(2).image, again.image)  # the second epoch has another order


def test_mirrored_samples_keep_lens_and_picture_together(folder: Path) -> None:
    epochs = Epochs(SampleSet(folder), seed=4, batch_size=8)
    for number in range(4):
        batch = epochs(number)
        again = rectify_images(batch.image, batch.k)
        # but for what the exposure burns out
        assert (again - batch.rectified).abs().quantile(0.98) < 1e-3


def test_a_share_of_the_batches_is_upright_and_keeps_lens_and_picture_together(
    folder: Path,
) -> None:
    """Not one batch, some, or all; where transposed, the lens rectifies the picture still."""
    plain = [Epochs(SampleSet(folder), seed=4, batch_size=8)(i).image for i in range(12)]
    for share, least, most in ((0.0, 0, 0), (0.5, 2, 10), (1.0, 12, 12)):
        epochs = Epochs(SampleSet(folder), seed=4, batch_size=8, upright=share)
        batches = [epochs(i) for i in range(12)]
        turned = [
            torch.equal(b.image.transpose(2, 3), p) for b, p in zip(batches, plain, strict=True)
        ]
        same = [torch.equal(b.image, p) for b, p in zip(batches, plain, strict=True)]
        assert all(a != b for a, b in zip(turned, same, strict=True))
        assert least <= sum(turned) <= most
        for batch in batches[:4]:
            again = rectify_images(batch.image, batch.k)
            assert (again - batch.rectified).abs().quantile(0.98) < 1e-3
            assert torch.equal(batch.k[:, 5], torch.ones(8))


def test_a_batch_larger_than_the_set_is_refused(folder: Path) -> None:
    with pytest.raises(ValueError, match="at most 16 samples, got 17"):
        Epochs(SampleSet(folder), seed=1, batch_size=17)(0)
