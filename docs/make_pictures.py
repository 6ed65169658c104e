"""Make the pictures of the documentation from examples/room.jpg and the renders of the tests.

    python docs/make_pictures.py

All of them are our own and CC0. They are made again when the method changes. `page.jpg` is the
screenshot that tests/test_web_page.py leaves in out/page/photograph.png; `camera.svg` is drawn by
hand.
"""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
from matplotlib import pyplot as plt

from hybrid import (
    KannalaBrandt,
    Picture,
    Rectification,
    RectifyConfig,
    draw_curves,
    read_camera,
    read_picture,
    rectify,
    write_picture,
)

ROOT = Path(__file__).resolve().parents[1]
OUT = ROOT / "docs" / "pictures"
WIDTH = 640  # pixels of a picture in a page
GAP = 8


def at_width(pixels: np.ndarray, width: int = WIDTH) -> np.ndarray:
    """A picture scaled to a width."""
    height = round(pixels.shape[0] * width / pixels.shape[1])
    return cv2.resize(pixels, (width, height), interpolation=cv2.INTER_AREA)


def beside(*pictures: np.ndarray) -> np.ndarray:
    """Pictures of one height in a row."""
    gap = np.full((pictures[0].shape[0], GAP, 3), 255, np.uint8)
    row = [part for picture in pictures for part in (picture, gap)]
    return np.hstack(row[:-1])


def save(name: str, pixels: np.ndarray) -> None:
    """Write one of the pictures."""
    write_picture(OUT / f"{name}.jpg", Picture(pixels))


def heat(pixels: np.ndarray, heatmap: np.ndarray) -> np.ndarray:
    """A picture, darkened, under its heatmap."""
    levels = cv2.resize(heatmap.astype(np.float32), pixels.shape[1::-1])
    levels = np.rint(np.clip(levels, 0, 1) * 255).astype(np.uint8)
    colours = cv2.applyColorMap(levels, cv2.COLORMAP_INFERNO)[..., ::-1]
    share = np.sqrt(levels / 255)[..., None]
    return np.rint(0.5 * pixels * (1 - share) + colours * share).astype(np.uint8)


def with_curves(pixels: np.ndarray, result: Rectification, width: int = 1200) -> np.ndarray:
    """A picture with its curves, drawn finely."""
    scale = width / pixels.shape[1]
    curves = [replace(c, points=(c.points + 0.5) * scale - 0.5) for c in result.curves]
    return draw_curves(at_width(pixels, width), curves)


def steps(room: np.ndarray) -> Rectification:
    """What the method sees of the example, one step a picture."""
    result = rectify(room)
    assert result.heatmap is not None
    save("room_input", at_width(room))
    save("room_heatmap", heat(at_width(room), result.heatmap))
    save("room_curves", at_width(with_curves(room, result), 800))
    save("room_straight", at_width(result.image))
    save("room_before_after", beside(at_width(room, 480), at_width(result.image, 480)))
    return result


def frames(room: np.ndarray, camera: KannalaBrandt) -> None:
    """The same lens shown with three balances, and with a field of view of 80°."""
    chosen = [RectifyConfig(balance=value) for value in (0.0, 0.5, 1.0)] + [RectifyConfig(fov=80.0)]
    shown = [at_width(rectify(room, config, camera=camera).image, 320) for config in chosen]
    save("room_frames", np.vstack([beside(*shown[:2]), *_rule(shown[0]), beside(*shown[2:])]))


def _rule(shown: np.ndarray) -> list[np.ndarray]:
    return [np.full((GAP, 2 * shown.shape[1] + GAP, 3), 255, np.uint8)]


def rooms() -> None:
    """The four renders of the tests, and what becomes of them."""
    folder = ROOT / "tests" / "data" / "rooms" / "pictures"
    pictures = [read_picture(path).pixels for path in sorted(folder.glob("*.png"))]
    straight = [rectify(picture, throw=False).image for picture in pictures]
    rows = [beside(*(at_width(picture, 240) for picture in row)) for row in (pictures, straight)]
    save(
        "renders", np.vstack([rows[0], np.full((GAP, rows[0].shape[1], 3), 255, np.uint8), rows[1]])
    )


def radius_plot(found: KannalaBrandt, truth: KannalaBrandt) -> None:
    """r(θ) of the example's lens, found and true, beside the textbook's projections."""
    theta = np.radians(np.linspace(0, 85, 200))
    degrees = np.degrees(theta)
    focal = truth.k[0]
    figure, axes = plt.subplots(figsize=(6.4, 3.6), layout="constrained")
    shapes = {
        "pinhole  f tan θ": np.tan(np.minimum(theta, 1.2)),
        "equidistant  f θ": theta,
        "equisolid  2 f sin(θ/2)": 2 * np.sin(theta / 2),
        "orthographic  f sin θ": np.sin(theta),
    }
    for (name, shape), style in zip(shapes.items(), ("-", "--", "-.", ":"), strict=True):
        axes.plot(degrees, focal * shape, style, color="0.6", label=name, linewidth=1.2)
    axes.plot(
        degrees, truth.radius(theta), color="black", linewidth=4, alpha=0.35, label="true lens"
    )
    axes.plot(degrees, found.radius(theta), color="#0f766e", linewidth=1.8, label="found lens")
    axes.set(xlabel="angle from the axis θ, degrees", ylabel="radius r(θ), half picture widths")
    axes.set(xlim=(0, 85), ylim=(0, 1.6))
    axes.legend(frameon=False, fontsize=8)
    axes.spines[["top", "right"]].set_visible(False)
    figure.savefig(OUT / "radius.svg", metadata={"Date": None})
    plt.close(figure)


def page() -> None:
    """The screenshot of the page, if the browser test has left one."""
    shot = ROOT / "out" / "page" / "photograph.png"
    if shot.exists():
        save("page", at_width(read_picture(shot).pixels[..., :3], 1100))


def main() -> None:
    """Make all of them."""
    OUT.mkdir(exist_ok=True)
    plt.rcParams |= {"svg.hashsalt": "straightlens", "svg.fonttype": "none"}  # the same bytes
    room = read_picture(ROOT / "examples" / "room.jpg").pixels
    truth = read_camera(ROOT / "examples" / "room.truth.json").camera
    result = steps(room)
    assert result.camera is not None
    frames(room, result.camera)
    rooms()
    radius_plot(result.camera, truth)
    page()
    error = math.degrees(
        np.abs(result.camera.theta(np.array([0.8]))[0] - truth.theta(np.array([0.8]))[0])[0]
    )
    print(f"off by {error:.2f} degrees at 0.8 half widths")


if __name__ == "__main__":
    main()
