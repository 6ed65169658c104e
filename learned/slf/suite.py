"""Test sets on disk: one folder, readable without this program.

    suite.json            format, kind, name, note, settings; written first
    pictures/000012.png   the fisheye photograph, 8-bit RGB
    straight/000012.png   the rectified truth: pinhole f = width / 2, same size
    lines/000012.png      the line map, 8-bit grey: the bent length in pixels, at most 255, of the
                          line within 1 px of a pixel's centre, else 0
    items/000012.json     camera, curves, origin; written last, so it marks a finished item
    card.json, card.png, contact_sheet.png   what the set holds

The camera is r(θ) = Σ k_i θ^(2i−1), pixel = (m_u r cos φ + u0, m_v r sin φ + v0), k in units of
half the width, the centre of the top-left pixel at (0, 0). A curve is the image of a straight line:
its `points` in pixels of the picture, its two `ends` in camera coordinates (x right, y down, z
forward) and its bent `length_px`.
"""

import json
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Float, UInt8
from numpy import ndarray

from classical.camera import KannalaBrandt
from classical.files import atomic_path, remove_leftovers

FORMAT = "straightlens-suite-1"
_FOLDERS = ("pictures", "straight", "lines", "items")
_POINT_DIGITS = 3
_RAY_DIGITS = 7


@dataclass(frozen=True)
class SuiteCurve:
    """The image of a straight line.

    Attributes:
        points: Pixels (u, v) along the curve.
        ends: The two ends of the visible piece in camera coordinates, up to scale.
        length_px: Bent length in pixels.
    """

    points: Float[ndarray, "n 2"]
    ends: Float[ndarray, "2 3"]
    length_px: float


@dataclass(frozen=True)
class SuiteItem:
    """One picture of a suite.

    Attributes:
        index: Its number.
        camera: The true camera.
        theta_max: Largest incident angle that the picture shows, radians.
        curves: Images of straight lines.
        origin: Where it comes from, in words; pictures of one origin are one group.
        credits: Works of others in the picture, each with its author and licence.
    """

    index: int
    camera: KannalaBrandt
    theta_max: float
    curves: tuple[SuiteCurve, ...]
    origin: str
    credits: tuple[str, ...] = ()


@dataclass(frozen=True)
class SuiteFolder:
    """Files of one suite.

    Attributes:
        path: The folder.
    """

    path: Path

    def picture(self, index: int) -> Path:
        """The fisheye photograph."""
        return self.path / "pictures" / f"{index:06d}.png"

    def straight(self, index: int) -> Path:
        """The rectified truth."""
        return self.path / "straight" / f"{index:06d}.png"

    def lines(self, index: int) -> Path:
        """The line map."""
        return self.path / "lines" / f"{index:06d}.png"

    def item(self, index: int) -> Path:
        """Camera and curves."""
        return self.path / "items" / f"{index:06d}.json"

    def header(self) -> dict:
        """Kind, name, note and settings.

        Raises:
            ValueError: If this is no suite.
        """
        file = self.path / "suite.json"
        if not file.is_file():
            raise ValueError(f"expected a folder with suite.json, got {self.path}")
        header = json.loads(file.read_text())
        if not isinstance(header, dict) or header.get("format") != FORMAT:
            raise ValueError(f"expected a suite of format {FORMAT!r} in {file}")
        return header

    def begin(self, header: dict) -> None:
        """Make the folders and the header, or check that an older header is the same.

        Raises:
            ValueError: If the folder holds a suite with other settings.
        """
        full = {"format": FORMAT, **header}
        begun = (self.path / "suite.json").exists()
        if begun and (found := self.header()) != json.loads(json.dumps(full)):
            raise ValueError(
                f"expected the settings of the suite that is there already, {found}, got {full}"
            )
        for folder in (self.path, *(self.path / name for name in _FOLDERS)):
            folder.mkdir(parents=True, exist_ok=True)
            remove_leftovers(folder)
        if not begun:
            write_whole(self.path / "suite.json", json.dumps(full, indent=1).encode() + b"\n")

    def indices(self) -> list[int]:
        """Numbers of the finished items."""
        return sorted(int(p.stem) for p in (self.path / "items").glob("[0-9]*.json"))

    def write(
        self,
        item: SuiteItem,
        picture: UInt8[ndarray, "h w 3"],
        straight: UInt8[ndarray, "h2 w2 3"],
        lines: UInt8[ndarray, "h w"],
    ) -> None:
        """Write an item: pictures first, its JSON last."""
        write_png(self.picture(item.index), picture)
        write_png(self.straight(item.index), straight)
        write_png(self.lines(item.index), lines)
        write_whole(self.item(item.index), json.dumps(_to_json(item)).encode())

    def read(self, index: int) -> SuiteItem:
        """Read the camera and the curves of an item."""
        return _from_json(json.loads(self.item(index).read_text()))

    def __iter__(self) -> Iterator[SuiteItem]:
        """All finished items."""
        return (self.read(i) for i in self.indices())


def write_png(path: Path, image: UInt8[ndarray, "h w 3"] | UInt8[ndarray, "h w"]) -> None:
    """Write an RGB or a grey picture, whole or not at all; the same pixels give the same bytes."""
    import cv2

    bgr = image[..., ::-1] if image.ndim == 3 else image
    done, data = cv2.imencode(".png", np.ascontiguousarray(bgr))
    if not done:
        raise OSError(f"cannot encode a picture for {path}")
    write_whole(path, data.tobytes())


def write_whole(path: Path, data: bytes) -> None:
    """Write a file, whole or not at all."""
    with atomic_path(path) as temporary:
        temporary.write_bytes(data)


def _to_json(item: SuiteItem) -> dict:
    camera = item.camera
    return {
        "index": item.index,
        "origin": item.origin,
        **({"credits": list(item.credits)} if item.credits else {}),
        "camera": {
            "k": camera.k.tolist(),
            **{n: float(getattr(camera, n)) for n in ("m_u", "m_v", "u0", "v0")},
            "width": camera.width,
            "height": camera.height,
        },
        "theta_max": float(item.theta_max),
        "curves": [
            {
                "points": np.round(curve.points, _POINT_DIGITS).tolist(),
                "ends": np.round(curve.ends, _RAY_DIGITS).tolist(),
                "length_px": round(float(curve.length_px), _POINT_DIGITS),
            }
            for curve in item.curves
        ],
    }


def _from_json(record: dict) -> SuiteItem:
    curves = tuple(
        SuiteCurve(
            np.array(curve["points"], float).reshape(-1, 2),
            np.array(curve["ends"], float).reshape(2, 3),
            float(curve["length_px"]),
        )
        for curve in record["curves"]
    )
    camera = {**record["camera"], "k": np.array(record["camera"]["k"], float)}
    return SuiteItem(
        record["index"],
        KannalaBrandt(**camera),
        record["theta_max"],
        curves,
        record["origin"],
        tuple(record.get("credits", ())),
    )
