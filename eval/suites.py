"""Loaders of test sets: own folders, calibrated photographs, calibration files, fisheye videos."""

import json
from pathlib import Path

import numpy as np

from classical.camera import KannalaBrandt, radial_coefficients
from classical.camera.formats import read_lens
from eval.cases import Case, Suite, read_picture
from eval.metrics import THETA_MAX
from learned.slf.pack import PICTURE_SUFFIXES, picture_paths
from learned.slf.suite import SuiteFolder

VIDEO_SYNTHETIC_SIDE = 1088
_OCAMCALIB = "calib_results*.txt"
_CAMERA_SUFFIXES = (".json", ".yaml", ".yml", ".xml", ".txt")
_VIDEO_FOCAL_MM, _VIDEO_SENSOR_MM, _VIDEO_FIELD = 1.8, 5.2, np.radians(185.0)


def load_suite(path: Path) -> Suite:
    """Load whatever a path holds.

    Args:
        path: A set of `straightlens synthesize`; a JSON list of calibrated photographs, or the
            folder that holds it as `suite.json`; a folder of photographs with one camera file
            (OpenCV, Kalibr, OCamCalib and others); or the root of the fisheye video dataset.

    Raises:
        ValueError: If it is none of these.
    """
    file = path / "suite.json" if path.is_dir() else path
    if not file.is_file() and path.is_dir():
        return _load_photographs(path)
    if not file.is_file():
        raise ValueError(f"expected a test set, got {path}")
    if isinstance(json.loads(file.read_text()), list):
        return load_calibrated_list(file)
    return load_folder(file.parent)


def _load_photographs(folder: Path) -> Suite:
    """Photographs beside one camera file, or else sequences of the fisheye video dataset."""
    files = sorted(p for p in folder.iterdir() if p.suffix.lower() in _CAMERA_SUFFIXES)
    beside = any(p.suffix.lower() in PICTURE_SUFFIXES for p in folder.iterdir())
    if beside and len(files) == 1:
        return load_calibrated_folder(folder, files[0])
    if beside and files:
        names = ", ".join(p.name for p in files)
        raise ValueError(f"expected one camera file in {folder}, got {names}")
    return load_fisheye_videos(folder)


def load_folder(path: Path) -> Suite:
    """Load a set made by `straightlens synthesize`.

    Rendered rooms bring a perspective twin as the rectified truth; the others are rectified by the
    true camera.

    Raises:
        ValueError: If the folder is no such set or is empty.
    """
    folder = SuiteFolder(path)
    header = folder.header()
    paired = header["kind"] == "rooms"
    cases = [
        Case(
            name=f"{item.index:06d}",
            picture=folder.picture(item.index),
            camera=item.camera,
            group=header["kind"],
            curves=tuple(curve.points for curve in item.curves),
            straight=folder.straight(item.index) if paired else None,
        )
        for item in folder
    ]
    return Suite(name=header["name"], cases=cases, is_real=False, note=header["note"])


def load_calibrated_list(
    path: Path, *, scenes_only: bool = False, theta_max: float = THETA_MAX
) -> Suite:
    """Load calibrated photographs from a JSON list.

    Args:
        path: A list of `image width height fx fy cx cy D camera` (OpenCV fisheye), with optional
            `scene` (false where a calibration board fills much of the picture) and
            `theta_max_deg`; pictures lie beside it.
        scenes_only: Leave out pictures whose `scene` is false.
        theta_max: Angle up to which pixels are compared, in radians; lowered to the smallest
            `theta_max_deg` of the list.

    Raises:
        ValueError: If an entry lacks a field or nothing is left.
    """
    entries = json.loads(path.read_text())
    cases = []
    for entry in entries:
        if scenes_only and entry.get("scene") is False:
            continue
        cases.append(_listed_case(path, entry))
        if entry.get("theta_max_deg") is not None:
            theta_max = min(theta_max, float(np.radians(entry["theta_max_deg"])))
    note = f"Photographs of {len({c.group for c in cases})} calibrated cameras."
    name = path.parent.name if path.stem == "suite" else path.stem
    return Suite(name=name, cases=cases, is_real=True, theta_max=theta_max, note=note)


def load_calibrated_folder(
    folder: Path, calibration: Path, *, camera: str | None = None, name: str | None = None
) -> Suite:
    """Load photographs of one camera whose calibration is a file.

    Pictures of another size than the calibrated one must have its aspect; the camera is resized.

    Args:
        folder: The photographs.
        calibration: A camera file of any known format.
        camera: Which camera, where the file holds several.
        name: Name of the suite, by default the folder's.

    Raises:
        ValueError: If there are no pictures or sizes do not fit.
    """
    lens = read_lens(calibration, camera)
    group = name or folder.name
    cases = [
        Case(_case_name(p, folder), p, _fitted_to(lens, p), group) for p in picture_paths(folder)
    ]
    note = f"Photographs of one camera, calibrated in {calibration.name}."
    return Suite(name=group, cases=cases, is_real=True, note=note)


def load_fisheye_videos(folder: Path, *, every: int = 30) -> Suite:
    """Load the fisheye video dataset of Eichenseer & Kaup from where the user has unpacked it.

    Every sequence is a folder of frames as pictures. Frames of 1088x1088 pixels are the synthetic
    sequences, whose lens is known (equisolid, f = 1.8 mm, 5.2 mm sensor, 185 degrees; ICASSP 2016);
    others need the OCamCalib text of the real camera in their folder, above it, or as the only one
    below the root.

    Args:
        folder: Root of the dataset.
        every: Take every so many-th frame of a sequence.

    Raises:
        ValueError: If there are no frames, or real ones without a calibration.
    """
    sequences: dict[Path, list[Path]] = {}
    for path in picture_paths(folder):
        sequences.setdefault(path.parent, []).append(path)
    cases = []
    for sequence, frames in sequences.items():
        height, width = read_picture(frames[0]).shape[:2]
        lens = _video_camera(sequence, folder, width, height)
        group = "synthetic" if width == height == VIDEO_SYNTHETIC_SIDE else "real"
        cases += [Case(_case_name(p, folder), p, lens, group) for p in frames[::every]]
    note = "Fisheye video dataset of Eichenseer & Kaup (ICASSP 2016)."
    return Suite(name="fisheye-video", cases=cases, is_real=False, note=note)


def equisolid_camera(
    width: int, height: int, *, focal_mm: float, sensor_mm: float, field: float
) -> KannalaBrandt:
    """An equisolid lens r = 2 f sin(θ / 2), fitted up to half the field.

    Args:
        width: Picture width in pixels.
        height: Picture height in pixels.
        focal_mm: Focal length.
        sensor_mm: Width of the sensor.
        field: Full field of view in radians.
    """
    theta = np.linspace(0.0, field / 2, 400)
    k = radial_coefficients(theta, 4 * focal_mm / sensor_mm * np.sin(theta / 2))
    return KannalaBrandt.centred(k, width, height)


def _video_camera(sequence: Path, root: Path, width: int, height: int) -> KannalaBrandt:
    if width == height == VIDEO_SYNTHETIC_SIDE:
        return equisolid_camera(
            width,
            height,
            focal_mm=_VIDEO_FOCAL_MM,
            sensor_mm=_VIDEO_SENSOR_MM,
            field=float(_VIDEO_FIELD),
        )
    lens = read_lens(_video_calibration(sequence, root))
    return lens if (lens.width, lens.height) == (width, height) else lens.resized(width, height)


def _video_calibration(sequence: Path, root: Path) -> Path:
    """The nearest OCamCalib text of a sequence."""
    for place in (sequence, *sequence.parents):
        if found := sorted(place.glob(_OCAMCALIB)):
            return found[0]
        if place == root:
            break
    if len(found := sorted(root.rglob(_OCAMCALIB))) == 1:
        return found[0]
    raise ValueError(
        f"expected {_OCAMCALIB} of the real camera in or above {sequence}, got none or several"
    )


def _listed_case(path: Path, entry: dict) -> Case:
    try:
        K = np.array([[entry["fx"], 0, entry["cx"]], [0, entry["fy"], entry["cy"]], [0, 0, 1.0]])
        camera = KannalaBrandt.from_opencv(
            K, np.array(entry["D"], float), entry["width"], entry["height"]
        )
        picture, group = path.parent / entry["image"], str(entry["camera"])
    except KeyError as error:
        raise ValueError(f"expected the field {error} in every entry of {path}") from error
    return Case(_case_name(picture, path.parent), picture, camera, group)


def _case_name(path: Path, root: Path) -> str:
    """A name fit for a file: the path below the root, joined by dashes, without its suffix."""
    relative = path.relative_to(root)
    stem = relative.with_suffix("") if relative.suffix.lower() in PICTURE_SUFFIXES else relative
    return "-".join(stem.parts)


def _fitted_to(lens: KannalaBrandt, picture: Path) -> KannalaBrandt:
    height, width = read_picture(picture).shape[:2]
    if (width, height) == (lens.width, lens.height):
        return lens
    if abs(width * lens.height - height * lens.width) > max(lens.width, lens.height):
        raise ValueError(
            f"expected a picture with the aspect of {lens.width}x{lens.height}, "
            f"got {width}x{height} in {picture}"
        )
    return lens.resized(width, height)
