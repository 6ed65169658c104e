"""ONNX files of the networks, for runtimes without torch."""

from __future__ import annotations

import warnings
from pathlib import Path

import torch
from jaxtyping import Float
from torch import Tensor, nn
from torch.jit._trace import TracerWarning

from classical.files import atomic_path
from learned.dlp import LinePerception
from learned.larecnet import LaRecNet

OPSET = 18


class _Lines(nn.Module):
    """Line perception with plain tensors out."""

    def __init__(self, network: LinePerception) -> None:
        super().__init__()
        self.network = network

    def forward(self, image: Float[Tensor, "b 3 h w"]) -> tuple[Tensor, Tensor]:
        raw = self.network(image).raw
        return self.network.heatmap(raw), self.network.lineness(raw)


class _Lens(nn.Module):
    """LaRecNet with plain tensors out."""

    def __init__(self, network: LaRecNet) -> None:
        super().__init__()
        self.network = network

    def forward(self, image: Float[Tensor, "b 3 h w"]) -> tuple[Tensor, ...]:
        out = self.network(image)
        maps = () if out.heatmap is None else (out.heatmap, out.lineness)
        if out.estimate.cholesky is None:
            return (out.k, *maps)
        return (out.k, out.estimate.cholesky, *maps)


def export_onnx(network: LaRecNet, folder: Path, *, size: int = 320) -> tuple[Path, Path]:
    """Write `dlp.onnx` and `larecnet.onnx`.

    Line perception takes any batch and any height and width that divide by its multiple; LaRecNet
    takes any batch of `size` x `size`. `larecnet.onnx` gives k, the Cholesky factor of the
    precision of the free coordinates (where the weights have one), heatmap and lineness.

    Args:
        network: The network; it is not changed.
        folder: Where to write; must exist.
        size: Side of LaRecNet's frame.

    Returns:
        Paths of the two files.
    """
    image = torch.zeros(2, 3, size, size)
    lens = ["k"] + ["cholesky"] * (network.calibration.spread is not None)
    maps = ["heatmap", "lineness"]
    uses_maps = bool(set(network.cfg.calibration.inputs) & {"heatmap", "lineness"})
    free = {0: "batch", 2: "height", 3: "width"}
    jobs = {
        "dlp": (_Lines(network.dlp), maps, {"image": free} | dict.fromkeys(maps, free)),
        "larecnet": (
            _Lens(network),
            lens + maps * uses_maps,
            {n: {0: "batch"} for n in ["image", *lens, *(maps * uses_maps)]},
        ),
    }
    paths = []
    for name, (module, outputs, axes) in jobs.items():
        path = folder / f"{name}.onnx"
        with atomic_path(path) as temporary:
            _export(module.eval(), image, temporary, outputs, axes)
        paths.append(path)
    return paths[0], paths[1]


def _export(
    module: nn.Module,
    image: Tensor,
    path: Path,
    outputs: list[str],
    axes: dict[str, dict[int, str]],
) -> None:
    """Trace and write. The tracer's exporter needs onnx alone; the newer one onnxscript besides."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DeprecationWarning)
        # sizes that become constants: LaRecNet's frame is fixed
        warnings.simplefilter("ignore", TracerWarning)
        torch.onnx.export(
            module,
            (image,),
            str(path),
            input_names=["image"],
            output_names=outputs,
            dynamic_axes=axes,
            opset_version=OPSET,
            dynamo=False,
        )
