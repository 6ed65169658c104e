"""Cameras from calibration files: OpenCV YAML, Kalibr camchain, OCamCalib text."""

from pathlib import Path
from typing import Any

import numpy as np
import yaml
from jaxtyping import Float
from numpy import ndarray

from classical.camera import KannalaBrandt

_FISHEYE_NAMES = (
    "fisheye",
    "equidistant",
    "equi",
    "kannala_brandt",
    "kannala_brandt4",
    "opencv_fisheye",
)
_MATRIX_KEYS = ("camera_matrix", "K", "cameraMatrix", "intrinsic_matrix")
_DISTORTION_KEYS = ("distortion_coefficients", "D", "distCoeffs", "dist_coeffs")
_LARGEST_SHEAR = 5e-3
_FIT_NODES = 400
_POWERS = np.array([1, 3, 5, 7, 9])


def read_calibration(path: Path, *, camera: str = "cam0") -> KannalaBrandt:
    """Read a calibration of any known kind.

    Args:
        path: `calib_results*.txt` of OCamCalib, or YAML of OpenCV or Kalibr.
        camera: Which camera of a Kalibr camchain.

    Raises:
        ValueError: If the file is of no known kind or of a lens that is not a fisheye.
    """
    if path.suffix.lower() == ".txt":
        return read_ocam(path)
    record = _read_yaml(path)
    if camera in record and isinstance(record[camera], dict):
        return _from_kalibr(record[camera], path)
    return _from_opencv(record, path)


def read_ocam(path: Path) -> KannalaBrandt:
    """Read an OCamCalib text file and fit the nearest Kannala–Brandt lens.

    Scaramuzza's model gives the ray of a pixel at distance ρ from the centre as (x, y, f(ρ)) with
    a polynomial f; the five coefficients of r(θ) are fitted to it over the picture.

    Raises:
        ValueError: If the file is incomplete or the affine part shears.
    """
    rows = [line.split() for line in path.read_text().splitlines()]
    rows = [[float(x) for x in row] for row in rows if row and not row[0].startswith("#")]
    if len(rows) < 5 or len(rows[2]) != 2 or len(rows[3]) != 3 or len(rows[4]) != 2:
        raise ValueError(f"expected the five records of OCamCalib in {path}, got {len(rows)}")
    polynomial, (row0, column0), (stretch, shear_d, shear_e) = rows[0][1:], rows[2], rows[3]
    height, width = (int(x) for x in rows[4])
    if max(abs(shear_d), abs(shear_e)) > _LARGEST_SHEAR:
        raise ValueError(f"expected square axes in {path}, got shear {shear_d:g}, {shear_e:g}")
    corners = np.array(
        [[u - column0, (v - row0) / stretch] for u in (0, width) for v in (0, height)]
    )
    theta, rho = _ocam_curve(np.array(polynomial), float(np.hypot(*corners.T).max()))
    half = width / 2
    return KannalaBrandt(
        k=fitted_polynomial(theta, rho / half),
        m_u=half,
        m_v=half * stretch,
        u0=column0,
        v0=row0,
        width=width,
        height=height,
    )


def fitted_polynomial(
    theta: Float[ndarray, " n"], radius: Float[ndarray, " n"]
) -> Float[ndarray, " 5"]:
    """Least-squares coefficients k1..k5 of a radial curve.

    Args:
        theta: Incident angles in radians.
        radius: Image radii in the unit wanted for k.
    """
    basis = theta[:, None] ** _POWERS
    scale = np.abs(basis).max(axis=0)
    return np.linalg.lstsq(basis / scale, radius, rcond=None)[0] / scale


def _ocam_curve(polynomial: ndarray, farthest: float) -> tuple[ndarray, ndarray]:
    """Angle against radius as far as it rises."""
    rho = np.linspace(0.0, farthest, _FIT_NODES)
    forward = -np.polynomial.polynomial.polyval(rho, polynomial)
    theta = np.arctan2(rho, forward)
    falls = np.diff(theta) <= 0
    last = int(falls.argmax()) if falls.any() else len(rho) - 1
    return theta[: last + 1], rho[: last + 1]


def _from_opencv(record: dict[str, Any], path: Path) -> KannalaBrandt:
    matrix, distortion = _first(record, _MATRIX_KEYS, path), _first(record, _DISTORTION_KEYS, path)
    K, D = _matrix(matrix).reshape(3, 3), _matrix(distortion).reshape(-1)
    model = str(record.get("distortion_model", record.get("model", "fisheye"))).lower()
    if model not in _FISHEYE_NAMES or len(D) != 4:
        raise ValueError(
            f"expected a fisheye calibration with four coefficients in {path}, "
            f"got model {model!r} with {len(D)}"
        )
    width, height = _size(record, path)
    return KannalaBrandt.from_opencv(K, D, width, height)


def _from_kalibr(record: dict[str, Any], path: Path) -> KannalaBrandt:
    model = (record.get("camera_model"), record.get("distortion_model"))
    if model != ("pinhole", "equidistant"):
        raise ValueError(f"expected pinhole with equidistant in {path}, got {model}")
    fx, fy, cx, cy = record["intrinsics"]
    K = np.array([[fx, 0, cx], [0, fy, cy], [0, 0, 1.0]])
    width, height = record["resolution"]
    D = np.array(record["distortion_coeffs"], float)
    return KannalaBrandt.from_opencv(K, D, int(width), int(height))


def _size(record: dict[str, Any], path: Path) -> tuple[int, int]:
    if "image_width" in record and "image_height" in record:
        return int(record["image_width"]), int(record["image_height"])
    for key in ("image_size", "resolution", "size", "imageSize"):
        if key in record:
            width, height = np.asarray(_matrix(record[key])).reshape(-1)[:2]
            return int(width), int(height)
    raise ValueError(f"expected image_width and image_height in {path}, got {sorted(record)}")


def _first(record: dict[str, Any], names: tuple[str, ...], path: Path) -> Any:
    for name in names:
        if name in record:
            return record[name]
    raise ValueError(f"expected one of {names} in {path}, got {sorted(record)}")


def _matrix(value: Any) -> ndarray:
    """A matrix written as OpenCV does ({rows, cols, data}) or as nested lists."""
    return np.array(value["data"] if isinstance(value, dict) else value, dtype=float)


class _Loader(yaml.SafeLoader):
    """YAML with OpenCV's matrix tag, which is an ordinary mapping."""


def _mapping(loader: yaml.SafeLoader, node: yaml.Node) -> dict[Any, Any]:
    assert isinstance(node, yaml.MappingNode)
    return loader.construct_mapping(node, deep=True)


_Loader.add_constructor("tag:yaml.org,2002:opencv-matrix", _mapping)


def _read_yaml(path: Path) -> dict[str, Any]:
    # OpenCV writes "%YAML:1.0", which is no directive of YAML
    text = "\n".join(x for x in path.read_text().splitlines() if not x.startswith("%"))
    try:
        record = yaml.load(text, Loader=_Loader)
    except yaml.YAMLError as error:
        raise ValueError(f"expected YAML in {path}: {error}") from error
    if not isinstance(record, dict):
        raise ValueError(f"expected a mapping in {path}, got {type(record).__name__}")
    return record
