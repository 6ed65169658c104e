"""Samples a second of the training stream, per scene type, in wall and in processor time.

    python -m benchmarks.slf_throughput train.pack --samples 128 --processes 2

A training runs one such process a core, each with one thread; the rate is that of all of them
together, from the first start to the last end. Where other programs share the cores, the wall rate
is theirs as much as ours; the figure by processor time is what the same work takes on a core of its
own, so many processes make that many times its inverse.
"""

import multiprocessing
import time
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path

import click
import torch

from learned.slf.atlas import load_atlas
from learned.slf.stream import SlfStream, StreamCfg

SCENES = {
    "planes (D-Wireframe)": (1.0, 0.0, 0.0, 0.0),
    "boxes": (0.0, 1.0, 0.0, 0.0),
    "panoramas": (0.0, 0.0, 1.0, 0.0),
}
BATCH = 8


def measure(
    pack: Path, config: StreamCfg, process: int, samples: int, size: int, threads: int
) -> tuple[float, float, float]:
    """Start and end by the wall clock, and processor time, all in seconds."""
    torch.set_num_threads(threads)
    stream = SlfStream(load_atlas(pack), seed=process, batch_size=BATCH, size=size, config=config)
    stream.batch(0)
    start, processor = time.time(), time.process_time()
    for index in range(1, samples // BATCH + 1):
        stream.batch(index)
    return start, time.time(), time.process_time() - processor


@click.command()
@click.argument("pack", type=click.Path(exists=True, dir_okay=False, path_type=Path))
@click.option("--samples", default=128, show_default=True, type=click.IntRange(BATCH))
@click.option("--size", default=320, show_default=True)
@click.option("--threads", default=1, show_default=True)
@click.option("--processes", default=2, show_default=True, type=click.IntRange(1))
def main(pack: Path, samples: int, size: int, threads: int, processes: int) -> None:
    """Measure with and without camera effects, without rectified ground truth."""
    made = samples // BATCH * BATCH
    spawn = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(processes, mp_context=spawn) as pool:
        for name, scenes in SCENES.items():
            for label, clean in (("clean", True), ("as photographed", False)):
                config = StreamCfg(scenes=scenes, with_rectified=False)
                if clean:
                    config = StreamCfg(scenes=scenes, with_rectified=False, photometry=None)
                runs = [
                    pool.submit(measure, pack, config, i, samples, size, threads)
                    for i in range(processes)
                ]
                starts, ends, processor = zip(*(run.result() for run in runs), strict=True)
                rate = processes * made / (max(ends) - min(starts))
                cost = 1e3 * sum(processor) / (processes * made)
                click.echo(
                    f"{name:22s} {label:16s} {rate:7.1f} samples/s by {processes} processes, "
                    f"{cost:5.1f} ms CPU a sample"
                )


if __name__ == "__main__":
    main()
