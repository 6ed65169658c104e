"""Rectify the example picture and write everything there is to see.

python examples/demo.py [PHOTOGRAPH] [--out out/demo]

Without a photograph it takes examples/room.jpg, a rendered room whose lens is known exactly, and so
also tells how far off the estimate is.
"""

import argparse
from pathlib import Path

import cv2
import numpy as np

from eval.metrics import aligned_error
from hybrid import (
    CameraFile,
    Picture,
    Rectification,
    RectificationError,
    draw_curves,
    read_camera,
    read_picture,
    rectify,
    write_camera,
    write_picture,
)
from hybrid.figure import describe, side_by_side

HERE = Path(__file__).resolve().parent
EXAMPLE = HERE / "room.jpg"


def before_after(before: np.ndarray, after: np.ndarray, width: int = 640) -> np.ndarray:
    """The two pictures beside each other, each `width` pixels wide."""
    size = (width, round(width * before.shape[0] / before.shape[1]))
    left, right = (cv2.resize(p, size, interpolation=cv2.INTER_AREA) for p in (before, after))
    return np.hstack([left, np.full((size[1], 8, 3), 255, np.uint8), right])


def write_all(source: Path, picture: Picture, result: Rectification, out: Path) -> list[Path]:
    """Write the result, the camera, the curves and the side-by-side picture."""
    out.mkdir(parents=True, exist_ok=True)
    files = {
        out / f"{source.stem}.rectified.jpg": result.image,
        out / f"{source.stem}.curves.jpg": draw_curves(picture.pixels, result.curves),
        out / f"{source.stem}.before_after.jpg": before_after(picture.pixels, result.image),
        out / f"{source.stem}.side_by_side.png": side_by_side(picture.pixels, result),
    }
    for path, pixels in files.items():
        write_picture(path, Picture(pixels))
    camera = out / f"{source.stem}.camera.json"
    if result.camera is not None:
        content = CameraFile(result.camera, result.status, result.reason, result.quality)
        write_camera(camera, content)
    return [*files, camera]


def compare_with_truth(result: Rectification, truth_file: Path) -> str:
    """How far rectified positions are off, beside the picture left alone."""
    truth = read_camera(truth_file).camera
    size = {"width": truth.width, "height": truth.height}
    error = aligned_error(result.camera, truth, **size)
    alone = aligned_error(None, truth, **size)
    return (
        f"against the true lens: {error:.2f} px mean error after the best similarity in a frame of "
        f"320 px, up to 60 degrees off the axis (left alone: {alone:.1f} px)"
    )


def main() -> None:
    """Run the demo."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("photograph", nargs="?", type=Path, default=EXAMPLE)
    parser.add_argument("--out", type=Path, default=Path("out/demo"))
    options = parser.parse_args()
    try:
        picture = read_picture(options.photograph)
        result = rectify(picture.pixels)
    except (OSError, ValueError, RectificationError) as error:
        parser.exit(1, f"{options.photograph}: {error}\n")
    files = write_all(options.photograph, picture, result, options.out)
    print(*describe(result), sep="\n")
    truth_file = options.photograph.with_name(f"{options.photograph.stem}.truth.json")
    if truth_file.exists():
        print(compare_with_truth(result, truth_file))
    print("written:", *files, sep="\n  ")


if __name__ == "__main__":
    main()
