"""Samples a second of the training stream, per scene type, in wall and in processor time.

    python benchmarks/slf_throughput.py train.pack --samples 128

One thread is best: samples are made one at a time, and a training runs one such process a core.
Where other programs share the cores, the wall figure is theirs as much as ours; the figure by
processor time is what the same work takes on a core of its own.
"""

import time
from pathlib import Path

import click
import torch

from learned.slf.atlas import Atlas, load_atlas
from learned.slf.stream import SlfStream, StreamCfg

SCENES = {
    "planes (D-Wireframe)": (1.0, 0.0, 0.0),
    "boxes": (0.0, 1.0, 0.0),
    "panoramas": (0.0, 0.0, 1.0),
}


def measure(atlas: Atlas, config: StreamCfg, *, samples: int, size: int) -> tuple[float, float]:
    """Samples a second by the wall clock, and milliseconds of processor time a sample."""
    stream = SlfStream(atlas, seed=1, batch_size=8, size=size, config=config)
    stream.batch(0)
    wall, processor = time.perf_counter(), time.process_time()
    for index in range(1, samples // 8 + 1):
        stream.batch(index)
    done = samples // 8 * 8
    seconds = time.perf_counter() - wall
    return done / seconds, 1e3 * (time.process_time() - processor) / done


@click.command()
@click.argument("pack", type=click.Path(exists=True, dir_okay=False, path_type=Path))
@click.option("--samples", default=128, show_default=True, type=click.IntRange(8))
@click.option("--size", default=320, show_default=True)
@click.option("--threads", default=1, show_default=True)
def main(pack: Path, samples: int, size: int, threads: int) -> None:
    """Measure with and without camera effects, without rectified ground truth."""
    torch.set_num_threads(threads)
    atlas = load_atlas(pack)
    for name, scenes in SCENES.items():
        for label, clean in (("clean", True), ("as photographed", False)):
            config = StreamCfg(scenes=scenes, with_rectified=False)
            if clean:
                config = StreamCfg(scenes=scenes, with_rectified=False, photometry=None)
            rate, cost = measure(atlas, config, samples=samples, size=size)
            click.echo(f"{name:22s} {label:16s} {rate:7.1f} samples/s {cost:7.1f} ms CPU a sample")


if __name__ == "__main__":
    main()
