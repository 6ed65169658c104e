"""What the two loops need of a test set: pictures, their true cameras, and true lines."""

import hashlib
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

import cv2
import numpy as np
from jaxtyping import Float, UInt8
from numpy import ndarray

from classical.camera import KannalaBrandt
from eval.metrics import THETA_MAX, polar_angle

_HASH_CHUNK = 1 << 20


@dataclass(frozen=True)
class Case:
    """One photograph whose lens is known.

    Attributes:
        name: Unique within its suite, fit for a file name.
        picture: File of the photograph.
        camera: Its true camera.
        group: What it is counted with in per-camera tables: a camera, or a collection.
        curves: Images of straight lines in pixels of the photograph, (n, 2) each; may be empty.
        straight: File of the true rectified picture in the 320 px frame, where one was rendered;
            otherwise the truth is the photograph rectified by the true camera.
    """

    name: str
    picture: Path
    camera: KannalaBrandt
    group: str
    curves: tuple[Float[ndarray, "_ 2"], ...] = ()
    straight: Path | None = None

    @property
    def fov(self) -> float:
        """Horizontal field of view of the true lens through the picture's middle, degrees."""
        camera = self.camera
        ends = np.array([[-0.5, camera.v0], [camera.width - 0.5, camera.v0]])
        rays, _ = camera.unproject(ends)
        return float(np.degrees(polar_angle(rays).sum()))


@dataclass(frozen=True)
class Suite:
    """A test set.

    Attributes:
        name: Fit for a folder name.
        cases: The photographs, in a fixed order.
        is_real: Real photographs are shown per camera (protocol 4).
        theta_max: True angle up to which pixels are compared, radians.
        note: One sentence on where it comes from, for the report.
    """

    name: str
    cases: Sequence[Case]
    is_real: bool
    theta_max: float = THETA_MAX
    note: str = ""
    fingerprint: str = field(init=False, default="")

    def __post_init__(self) -> None:
        names = [case.name for case in self.cases]
        if len(set(names)) != len(names) or not names:
            raise ValueError(
                f"expected distinct names of pictures in {self.name}, got {names[:3]}…"
            )
        object.__setattr__(self, "fingerprint", _fingerprint(self.cases))


def read_picture(path: Path) -> UInt8[ndarray, "h w 3"]:
    """Read a picture as RGB, 8 bits.

    Raises:
        ValueError: If the file is no picture that OpenCV reads.
    """
    picture = cv2.imread(str(path), cv2.IMREAD_COLOR)
    if picture is None:
        raise ValueError(f"expected a picture in {path}, got none that can be read")
    return np.ascontiguousarray(picture[:, :, ::-1])


def _fingerprint(cases: Sequence[Case]) -> str:
    """Hash of all pictures, cameras and lines: two runs with the same saw the same data."""
    digest = hashlib.sha256()
    for case in cases:
        digest.update(f"{case.name}\n{case.group}\n{len(case.curves)}\n".encode())
        digest.update(case.camera.to_vector().tobytes())
        for curve in case.curves:
            digest.update(np.round(np.asarray(curve, dtype=np.float64), 6).tobytes())
        for path in filter(None, (case.picture, case.straight)):
            with path.open("rb") as file:
                while chunk := file.read(_HASH_CHUNK):
                    digest.update(chunk)
    return digest.hexdigest()[:16]
