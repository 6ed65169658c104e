"""The networks by PyTorch and by ONNX Runtime."""

from __future__ import annotations

import tempfile
from collections.abc import Callable
from pathlib import Path

import numpy as np
import onnxruntime
import torch

from benchmarks.timing import median_seconds
from learned.export import export_onnx
from learned.inference import folded
from learned.larecnet import LaRecNet
from learned.predictor import LINES_VIEW
from learned.presets import PAPER, SIZE
from learned.weights import load_weights, packaged

VIEW = (LINES_VIEW * 6 // 7, LINES_VIEW)  # of line perception; it pads to multiples of 64 and more
PAPER_FRAME = (SIZE, SIZE)
_WARM = 3


def measure_networks(rounds: int) -> dict[str, dict[str, float]]:
    """Seconds of one picture by network and runtime; that they answer alike is tested."""
    compact = load_weights(packaged("compact"), LaRecNet).network.eval()
    frame = (compact.cfg.frame, compact.cfg.frame)
    paper = LaRecNet(PAPER.network).eval()  # how long it takes does not depend on weights
    return {
        **_measured("compact", compact, (VIEW, frame), rounds, threads=1),
        **_measured("compact", compact, (PAPER_FRAME, PAPER_FRAME), rounds, threads=2),
        **_measured("paper", paper, (PAPER_FRAME, PAPER_FRAME), rounds, threads=2),
    }


def _measured(
    preset: str,
    network: LaRecNet,
    sides: tuple[tuple[int, int], tuple[int, int]],
    rounds: int,
    *,
    threads: int,
) -> dict[str, dict[str, float]]:
    """Line perception alone, then LaRecNet, which holds it, at these heights and widths."""
    rng = np.random.default_rng(0)
    before = torch.get_num_threads()
    torch.set_num_threads(threads)
    found = {}
    try:
        with tempfile.TemporaryDirectory() as folder:
            paths = export_onnx(network, Path(folder), size=sides[1][0])
            for path, side, module in zip(paths, sides, (network.dlp, network), strict=True):
                image = rng.random((1, 3, *side), dtype=np.float32)
                part = {"dlp": "line perception", "larecnet": "both networks"}[path.stem]
                cores = "one thread" if threads == 1 else f"{threads} threads"
                name = f"{preset}: {part}, {side[1]}x{side[0]}, {cores}"
                found[name] = _compare(module, path, image, rounds, threads)
    finally:
        torch.set_num_threads(before)
    return found


def _compare(
    module: torch.nn.Module, path: Path, image: np.ndarray, rounds: int, threads: int
) -> dict[str, float]:
    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = threads
    session = onnxruntime.InferenceSession(str(path), options, providers=["CPUExecutionProvider"])
    # as `Predictor` runs it
    fast = folded(module).to(memory_format=torch.channels_last)  # type: ignore[call-overload]
    tensor = torch.from_numpy(image).contiguous(memory_format=torch.channels_last)

    def by_torch() -> object:
        with torch.inference_mode():
            return fast(tensor)

    # one after the other, not in turn: idle threads of either spin for a while and slow the other
    return {
        "PyTorch": _seconds(by_torch, rounds),
        "ONNX Runtime": _seconds(lambda: session.run(None, {"image": image}), rounds),
    }


def _seconds(call: Callable[[], object], rounds: int) -> float:
    """Median after some calls that warm up."""
    for _ in range(_WARM):
        call()
    return median_seconds(call, 3 * rounds)
