"""Weights as safetensors in half precision, with a model card inside and a checksum beside.

Never pickles: a weights file is data, and opening one runs nothing. The card travels in the file's
metadata and as Markdown next to it.
"""

from __future__ import annotations

import hashlib
import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Generic, TypeVar

import torch
from safetensors import SafetensorError, safe_open
from safetensors.torch import save_file
from torch import Tensor

from classical.files import atomic_path
from learned.config_json import from_json, to_json
from learned.dlp import DlpCfg, LinePerception
from learned.larecnet import LaRecNet, LarecnetCfg
from learned.rong import RongCfg, RongNet

FORMAT = "straightlens-weights-1"
_READABLE = 0o644
FOLDER = Path(__file__).parent
_NAMES: dict[type, str] = {LaRecNet: "larecnet", LinePerception: "dlp", RongNet: "rong"}
_CONFIGS: dict[type, type] = {LaRecNet: LarecnetCfg, LinePerception: DlpCfg, RongNet: RongCfg}
_SHOWN = 300  # characters of what is wrong
_EXACT = ("parameters_of_lens", "values", "running_", "temperature")


Network = TypeVar("Network", bound=LaRecNet | LinePerception | RongNet)


@dataclass(frozen=True)
class Loaded(Generic[Network]):
    """A network with its card.

    Attributes:
        network: In evaluation mode.
        card: What is known of the training: data, seed, steps, commit, scores.
    """

    network: Network
    card: dict[str, Any]


def packaged(name: str) -> Path:
    """Path of weights that ship: "compact", "compact-wf" (D-Wireframe alone) or "rong-compact".

    Raises:
        FileNotFoundError: If none of that name ship.
    """
    path = FOLDER / f"{name}.safetensors"
    if not path.exists():
        there = sorted(p.stem for p in FOLDER.glob("*.safetensors"))
        raise FileNotFoundError(f"expected weights among {there}, got {name!r}")
    return path


def located(weights: str | Path | None, default: str) -> Path:
    """Path of weights given as a file, as the name of some that ship, or not at all.

    Raises:
        FileNotFoundError: If neither is there.
    """
    if weights is None:
        return packaged(default)
    path = Path(weights)
    return packaged(path.name) if path.name == str(weights) and not path.suffix else path


def save_weights(
    path: Path, network: LaRecNet | LinePerception | RongNet, card: dict[str, Any]
) -> None:
    """Write weights, checksum and model card.

    Args:
        path: `….safetensors`; `.sha256` and `.md` are written beside it.
        network: Matrices and kernels are stored in half precision, all else as it is.
        card: JSON-able facts about the training.
    """
    tensors = {name: _stored(name, value) for name, value in network.state_dict().items()}
    kind = _NAMES[type(network)]
    metadata = {
        "format": FORMAT,
        "kind": kind,
        "config": to_json(network.cfg),
        "card": json.dumps(card, sort_keys=True),
    }
    path.parent.mkdir(parents=True, exist_ok=True)
    with atomic_path(path) as temporary:
        save_file(tensors, temporary, metadata=metadata)
        temporary.chmod(_READABLE)  # safetensors leaves it to its owner alone
    with atomic_path(path.with_suffix(".sha256")) as temporary:
        temporary.write_text(f"{checksum(path)}  {path.name}\n")
    with atomic_path(path.with_suffix(".md")) as temporary:
        temporary.write_text(card_text(path.stem, kind, card))


def checksum(path: Path) -> str:
    """SHA-256 of a file, in hexadecimal."""
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def card_text(name: str, kind: str, card: dict[str, Any]) -> str:
    """The model card as Markdown: one table row a fact."""
    rows = "\n".join(f"| {key} | {_cell(value)} |" for key, value in card.items())
    return f"# {name}\n\nWeights of `{kind}`.\n\n| what | value |\n|---|---|\n{rows}\n"


def load_weights(path: Path, kind: type[Network]) -> Loaded[Network]:
    """A network from weights.

    Args:
        path: File of `save_weights`; a `.sha256` beside it is checked.
        kind: `LaRecNet`, `LinePerception` or `RongNet`.

    Raises:
        ValueError: If the file is not what it should be or its checksum is wrong.
        FileNotFoundError: If it is not there.
    """
    if not path.exists():
        raise FileNotFoundError(f"expected a weights file, got {path}, which is not there")
    tensors, metadata = _read(path, kind)
    try:
        card = json.loads(metadata["card"])
        network = kind(from_json(_CONFIGS[kind], metadata["config"]))
        network.load_state_dict(tensors)
    except (AttributeError, KeyError, RuntimeError, TypeError, ValueError) as error:
        reason = " ".join(str(error).split())[:_SHOWN]
        raise ValueError(f"expected weights of {_NAMES[kind]} in {path}: {reason}") from error
    return Loaded(network.eval(), card)


def load_perception(path: Path) -> LinePerception:
    """Line perception out of its own weights or out of LaRecNet's; see `load_weights`."""
    try:
        return load_weights(path, LinePerception).network
    except ValueError:
        return load_weights(path, LaRecNet).network.dlp


def _read(path: Path, kind: type) -> tuple[dict[str, Tensor], dict[str, str]]:
    beside = path.with_suffix(".sha256")
    if beside.exists():
        expected, got = beside.read_text().partition(" ")[0].strip(), checksum(path)
        if expected != got:
            raise ValueError(f"expected checksum {expected} of {path.name}, got {got}")
    try:
        with safe_open(path, framework="pt") as file:
            metadata = file.metadata() or {}
            tensors = {name: file.get_tensor(name) for name in file.keys()}  # noqa: SIM118
    except SafetensorError as error:
        raise ValueError(f"expected a safetensors file, got {path} ({error})") from error
    if metadata.get("format") != FORMAT or metadata.get("kind") != _NAMES[kind]:
        found = (metadata.get("format"), metadata.get("kind"))
        raise ValueError(f"expected {FORMAT} of {_NAMES[kind]}, got {found} in {path}")
    exact = {n: t.float() if t.dtype == torch.float16 else t for n, t in tensors.items()}
    return exact, metadata


def _stored(name: str, value: Tensor) -> Tensor:
    small = value.ndim < 2 or any(part in name for part in _EXACT)
    value = value.detach().cpu().contiguous()
    return value if small or not value.is_floating_point() else value.half()


def _cell(value: Any) -> str:
    if isinstance(value, float):
        return f"{value:.4g}"
    if isinstance(value, dict):
        return "; ".join(f"{k}: {_cell(v)}" for k, v in value.items())
    return str(value)
