"""The data card of a set: counts, histograms, contact sheet with the curves drawn in."""

import json
from collections import Counter

import numpy as np
from jaxtyping import Float, UInt8
from numpy import ndarray

from learned.slf.pack import read_rgb
from learned.slf.priors import lens_prior
from learned.slf.suite import SuiteFolder, SuiteItem, write_png, write_whole

_BINS = 16
_TILE = 240
_MOST_TILES = 40
_COLUMNS = 8
_BAR = (70, 110, 160)
_PLOT = (200, 320)


def write_card(folder: SuiteFolder) -> None:
    """Write card.json, card.png and contact_sheet.png of a finished set."""
    items = list(folder)
    columns = _columns(items)
    credited = sorted({credit for item in items for credit in item.credits})
    record = {
        **folder.header(),
        "items": len(items),
        "origins": dict(sorted(Counter(item.origin for item in items).items())),
        **({"credits": credited} if credited else {}),
        "curves": int(sum(len(item.curves) for item in items)),
        "statistics": {name: _statistics(values) for name, values in columns.items()},
        "histograms": {name: _histogram(values) for name, values in columns.items()},
    }
    write_whole(folder.path / "card.json", json.dumps(record, indent=1).encode() + b"\n")
    write_png(folder.path / "card.png", histogram_sheet(columns))
    write_png(folder.path / "contact_sheet.png", contact_sheet(folder, items))


def contact_sheet(folder: SuiteFolder, items: list[SuiteItem]) -> UInt8[ndarray, "h w 3"]:
    """Evenly chosen pictures side by side, curves in colours by length."""
    chosen = [items[i] for i in np.unique(np.linspace(0, len(items) - 1, _MOST_TILES).astype(int))]
    tiles = [_drawn(folder, item) for item in chosen]
    tiles += [np.zeros_like(tiles[0])] * (-len(tiles) % min(_COLUMNS, len(tiles)))
    columns = min(_COLUMNS, len(tiles))
    rows = [np.hstack(tiles[i : i + columns]) for i in range(0, len(tiles), columns)]
    return np.vstack(rows)


def histogram_sheet(columns: dict[str, Float[ndarray, " n"]]) -> UInt8[ndarray, "h w 3"]:
    """Histograms side by side, each with its name, its range and its highest count."""
    tiles = [_plot(name, values) for name, values in columns.items()]
    tiles += [np.full_like(tiles[0], 255)] * (-len(tiles) % 4)
    return np.vstack([np.hstack(tiles[i : i + 4]) for i in range(0, len(tiles), 4)])


def prior_sheet(name: str, count: int, *, seed: int) -> UInt8[ndarray, "h w 3"]:
    """Histograms of a lens prior.

    Args:
        name: Which prior.
        count: Lenses drawn.
        seed: Seed of the drawing.
    """
    prior = lens_prior(name)
    lenses = prior.sample(np.random.default_rng(seed), count)
    names = ("k1", "k2", "k3", "k4", "k5", "m_u", "m_v", "u0", "v0")
    columns = {f"{n} (half widths)": lenses.vector[:, i] for i, n in enumerate(names) if i != 5}
    columns["largest angle (degrees)"] = np.degrees(lenses.theta_max)
    density = prior.log_density(lenses.vector[:256])
    columns["log density"] = density[np.isfinite(density)]
    return histogram_sheet(columns)


def _columns(items: list[SuiteItem]) -> dict[str, ndarray]:
    """The numbers that a card shows, by name."""
    k = np.array([item.camera.k * 2 * item.camera.m_u / item.camera.width for item in items])
    out = {f"k{i + 1} (half widths)": k[:, i] for i in range(5)}
    out["k2 / k1"] = k[:, 1] / k[:, 0]
    out["field across (degrees)"] = np.array([_field_across(item) for item in items])
    out["largest angle (degrees)"] = np.degrees([item.theta_max for item in items])
    out["curves a picture"] = np.array([len(item.curves) for item in items], float)
    lengths = [curve.length_px for item in items for curve in item.curves]
    out["curve length (px)"] = np.array(lengths or [0.0])
    return out


def _field_across(item: SuiteItem) -> float:
    """Angle between the leftmost and the rightmost ray of the middle row, as far as seen."""
    camera = item.camera
    radii = np.array(
        [(camera.u0 + 0.5) / camera.m_u, (camera.width - 0.5 - camera.u0) / camera.m_u]
    )
    theta, _ = camera.theta(radii)
    return float(np.degrees(np.minimum(theta, item.theta_max).sum()))


def _statistics(values: ndarray) -> dict[str, float]:
    low, middle, high = np.percentile(values, [5, 50, 95])
    named = {"min": values.min(), "p5": low, "median": middle, "p95": high, "max": values.max()}
    return {name: round(float(value), 5) for name, value in named.items()}


def _histogram(values: ndarray) -> dict[str, list[float]]:
    counts, edges = np.histogram(values, bins=_BINS)
    return {"edges": np.round(edges, 5).tolist(), "counts": counts.tolist()}


def _drawn(folder: SuiteFolder, item: SuiteItem) -> ndarray:
    import cv2

    picture = read_rgb(folder.picture(item.index))
    scale = _TILE / picture.shape[1]
    height = round(picture.shape[0] * scale)
    tile = cv2.resize(picture, (_TILE, height), interpolation=cv2.INTER_AREA)
    for curve in reversed(item.curves):
        share = min(curve.length_px / picture.shape[1], 1.0)
        points = np.round(((curve.points + 0.5) * scale - 0.5) * 16).astype(np.int32)
        colour = (255 * share**0.5, 255 * (1 - share**0.5), 40)
        cv2.polylines(tile, [points[:, None]], False, colour, 1, cv2.LINE_AA, 4)
    return tile


def _plot(name: str, values: ndarray) -> ndarray:
    import cv2

    height, width = _PLOT
    canvas = np.full((height, width, 3), 255, np.uint8)
    counts, edges = np.histogram(values, bins=_BINS)
    left, bottom, top = 12, height - 28, 30
    step = (width - 2 * left) / _BINS
    for i, count in enumerate(counts):
        x0, x1 = round(left + i * step), round(left + (i + 1) * step) - 2
        y = round(bottom - (bottom - top) * count / max(counts.max(), 1))
        cv2.rectangle(canvas, (x0, y), (x1, bottom), _BAR, -1)
    labels = (
        (name, left, 18),
        (f"at most {counts.max()}", None, 18),
        (f"{edges[0]:.3g}", left, height - 10),
        (f"{edges[-1]:.3g}", None, height - 10),
    )
    for text, x, y in labels:
        style = cv2.FONT_HERSHEY_SIMPLEX, 0.42
        x = width - left - cv2.getTextSize(text, *style, 1)[0][0] if x is None else x
        cv2.putText(canvas, text, (x, y), *style, (0, 0, 0), 1, cv2.LINE_AA)
    return canvas
