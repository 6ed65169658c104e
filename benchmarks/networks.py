"""The shipped networks by PyTorch and by ONNX Runtime, one thread each."""

from __future__ import annotations

import tempfile
from pathlib import Path

import numpy as np
import onnxruntime
import torch

from benchmarks.timing import in_turn
from learned.export import export_onnx
from learned.larecnet import LaRecNet
from learned.predictor import LINES_VIEW
from learned.weights import load_weights, packaged

VIEW = (LINES_VIEW * 6 // 7, LINES_VIEW)  # of line perception; it pads to multiples of 64 and more


def measure_networks(rounds: int) -> dict[str, dict[str, float]]:
    """Seconds of one picture by network and runtime; that they answer alike is tested."""
    network = load_weights(packaged("compact"), LaRecNet).network.eval()
    frame = network.cfg.frame
    rng = np.random.default_rng(0)
    before = torch.get_num_threads()
    torch.set_num_threads(1)
    found = {}
    try:
        with tempfile.TemporaryDirectory() as folder:
            paths = export_onnx(network, Path(folder), size=frame)
            sides = (VIEW, (frame, frame))
            modules = (network.dlp, network)
            for path, side, module in zip(paths, sides, modules, strict=True):
                image = rng.random((1, 3, *side), dtype=np.float32)
                name = {"dlp": "line perception", "larecnet": "LaRecNet"}[path.stem]
                found[f"{name}, {side[1]}x{side[0]}"] = _compare(module, path, image, rounds)
    finally:
        torch.set_num_threads(before)
    return found


def _compare(
    module: torch.nn.Module, path: Path, image: np.ndarray, rounds: int
) -> dict[str, float]:
    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = 1
    session = onnxruntime.InferenceSession(str(path), options, providers=["CPUExecutionProvider"])
    module = module.to(memory_format=torch.channels_last)  # type: ignore[call-overload]
    tensor = torch.from_numpy(image).contiguous(memory_format=torch.channels_last)

    def by_torch() -> object:
        with torch.inference_mode():
            return module(tensor)

    return in_turn(
        {"PyTorch": by_torch, "ONNX Runtime": lambda: session.run(None, {"image": image})}, rounds
    )
