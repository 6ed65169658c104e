"""What a method said about one photograph, and the file that keeps it."""

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Bool, Float32, Float64
from numpy import ndarray

from classical.camera import Division, KannalaBrandt
from classical.files import atomic_path

_FORMAT = 1

Estimate = KannalaBrandt | Division


@dataclass(frozen=True)
class Prediction:
    """The answer of one method on one photograph.

    Attributes:
        camera: The estimated camera, or `None` where the method failed or leaves things alone.
        status: "ok", "degraded" or "failed".
        reason: Why it is not "ok", in words.
        seconds: Wall-clock time of the estimate, one process on one core.
        predicted_error_px: The error that the method itself expects; NaN where it does not say.
        curves: Bent lines that it used, pixels of the photograph, shape (n, 2) each.
        inlier: For each curve, whether the answer makes it straight.
        covariance: Of `camera.to_vector()`, or `None` where the method does not say.
    """

    camera: Estimate | None
    status: str
    reason: str = ""
    seconds: float = float("nan")
    predicted_error_px: float = float("nan")
    curves: tuple[Float32[ndarray, "_ 2"], ...] = ()
    inlier: Bool[ndarray, " c"] | None = None
    covariance: Float64[ndarray, "9 9"] | None = None

    @property
    def failed(self) -> bool:
        """True where there is no camera though one was asked for."""
        return self.status == "failed"

    def save(self, path: Path) -> None:
        """Write one .npz file, whole or not at all."""
        record = {
            "format": _FORMAT,
            "camera": camera_to_record(self.camera),
            "status": self.status,
            "reason": self.reason,
            "seconds": self.seconds,
            "predicted_error_px": self.predicted_error_px,
        }
        arrays: dict[str, ndarray] = {
            "record": np.frombuffer(json.dumps(record).encode(), dtype=np.uint8),
            "points": np.concatenate([np.zeros((0, 2)), *self.curves]).astype(np.float32),
            "counts": np.array([len(curve) for curve in self.curves], dtype=np.int32),
        }
        optional = {"inlier": self.inlier, "covariance": self.covariance}
        arrays |= {name: array for name, array in optional.items() if array is not None}
        with atomic_path(path) as temporary, temporary.open("wb") as file:
            np.savez_compressed(file, **arrays)  # pyright: ignore[reportArgumentType]

    @classmethod
    def load(cls, path: Path) -> "Prediction":
        """Read what `save` wrote.

        Raises:
            ValueError: If the file is none of ours or of another format.
        """
        with np.load(path, allow_pickle=False) as data:
            record = json.loads(bytes(data["record"]))
            if record.get("format") != _FORMAT:
                raise ValueError(f"expected format {_FORMAT} in {path}, got {record.get('format')}")
            curves = np.split(data["points"], np.cumsum(data["counts"]))[:-1]
            optional = {name: data.get(name) for name in ("inlier", "covariance")}
        return cls(
            camera=camera_from_record(record["camera"]),
            status=record["status"],
            reason=record["reason"],
            seconds=record["seconds"],
            predicted_error_px=record["predicted_error_px"],
            curves=tuple(curves),
            **optional,
        )


def camera_to_record(camera: Estimate | None) -> dict[str, Any] | None:
    """A camera as plain numbers, exact (Python writes floats so that they read back equal)."""
    if camera is None:
        return None
    size = {"width": camera.width, "height": camera.height}
    if isinstance(camera, Division):
        centre = {"u0": camera.u0, "v0": camera.v0, "focal": camera.focal_px}
        return {"model": "division", "lambda": camera.lambda_, **centre, **size}
    return {"model": "kannala-brandt", "vector": camera.to_vector().tolist(), **size}


def camera_from_record(record: dict[str, Any] | None) -> Estimate | None:
    """The camera of `camera_to_record`."""
    if record is None:
        return None
    width, height = record["width"], record["height"]
    if record["model"] == "division":
        lens = (record["lambda"], record["u0"], record["v0"])
        return Division(*lens, width, height, focal=record["focal"])
    return KannalaBrandt.from_vector(np.array(record["vector"]), width, height)
