"""Pictures for the report: cases chosen by rule, shown in the layout of the paper's figures."""

import json
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass

import cv2
import numpy as np
from jaxtyping import Float, UInt8
from numpy import ndarray

from classical.camera import KannalaBrandt
from classical.files import atomic_path
from eval.cases import Case, Suite
from eval.doubt import expected_error
from eval.folder import RunFolder
from eval.frame import Resampled, best_similarity, rectify_picture
from eval.metrics import FRAME_WIDTH, rectified
from eval.prediction import Prediction
from eval.score import Truth
from eval.summary import MethodScores, SuiteScores, load_scores

SHOWN = 2
"""Pictures of each kind: best, median, worst."""


@dataclass(frozen=True)
class NetworkMap:
    """Something that the network sees in a photograph, to be shown beside the answers.

    Attributes:
        tag: Part of file names.
        title: Heading.
        values: Photograph to values in [0, 1], of any size.
    """

    tag: str
    title: str
    values: Callable[[UInt8[ndarray, "h w 3"]], Float[ndarray, "_ _"]]


_UNSURE = 3.0  # times the geometric mean; a larger U_A looks like it
_WORST_SHOWN = 10.0  # pixels; larger expected errors look like it
_SIDE = 240  # width of a picture in the report, pixels
_QUALITY = 82
_INLIER, _OUTLIER, _TRUE = (0, 114, 178), (213, 94, 0), (0, 158, 115)  # Okabe–Ito, RGB


@dataclass(frozen=True)
class Picture:
    """One picture of a row.

    Attributes:
        file: Name within the gallery folder.
        title: Heading of its column.
        alt: What it shows, in words.
        error: Aligned error in px where it is an answer, else `None`.
    """

    file: str
    title: str
    alt: str
    error: float | None = None


@dataclass(frozen=True)
class Row:
    """One photograph with all its answers."""

    case: str
    group: str
    kind: str
    pictures: tuple[Picture, ...]
    maps: tuple[Picture, ...]


def choose(errors: Float[ndarray, " n"], names: Sequence[str]) -> list[tuple[int, str]]:
    """The best, the median and the worst photographs, by error and then by name.

    Returns:
        (index, "best" | "median" | "worst"), at most `SHOWN` of each and none twice.
    """
    order = sorted(range(len(names)), key=lambda index: (errors[index], names[index]))
    middle = max(0, (len(order) - SHOWN) // 2)
    parts = {
        "best": order[:SHOWN],
        "median": order[middle : middle + SHOWN],
        "worst": order[::-1][:SHOWN],
    }
    chosen: dict[int, str] = {}
    for kind in ("worst", "best", "median"):
        for index in parts[kind]:
            chosen.setdefault(index, kind)
    kinds = list(parts)
    return sorted(chosen.items(), key=lambda item: (kinds.index(item[1]), order.index(item[0])))


def write_gallery(suite: Suite, folder: RunFolder, *, maps: Sequence[NetworkMap] = ()) -> None:
    """Choose cases by the primary method's aligned error and write their pictures.

    Real suites get, besides, the median case of each camera. `index.json` says what is where.

    Args:
        suite: The test set.
        folder: Where its answers and scores are, and the pictures go.
        maps: What the network sees, to be shown; see `network_maps`.
    """
    scores = load_scores(folder)
    errors = scores.primary.values("aligned", "rpe")
    picks = choose(errors, scores.names)
    if suite.is_real:
        picks += _medians(errors, scores)
    folder.gallery.mkdir(exist_ok=True)
    cases = {case.name: case for case in suite.cases}
    rows = [
        _write_row(cases[scores.names[index]], kind, index, suite.theta_max, scores, folder, maps)
        for index, kind in picks
    ]
    record = {"by": scores.primary.method.full_name, "rows": [asdict(row) for row in rows]}
    with atomic_path(folder.gallery / "index.json") as temporary:
        temporary.write_text(json.dumps(record, indent=1), encoding="utf-8")


def _medians(errors: Float[ndarray, " n"], scores: SuiteScores) -> list[tuple[int, str]]:
    """The median case of each camera."""
    picks = []
    for group in dict.fromkeys(scores.groups):
        members = [index for index, name in enumerate(scores.groups) if name == group]
        members.sort(key=lambda index: (errors[index], scores.names[index]))
        picks.append((members[(len(members) - 1) // 2], "camera"))
    return picks


def _write_row(
    case: Case,
    kind: str,
    index: int,
    theta_max: float,
    scores: SuiteScores,
    folder: RunFolder,
    maps: Sequence[NetworkMap],
) -> Row:
    """Write all pictures of one case."""
    truth = Truth(case, theta_max)
    answers = {
        row.method.tag: Prediction.load(folder.prediction(row.method.tag, case.name))
        for row in scores.methods
    }
    best = answers[scores.primary.method.tag]
    pictures = [
        _save(folder, case, "input", truth.photo, "Input", f"Fisheye photograph {case.name}"),
        _save(folder, case, "lines", _lines(truth, best), "Lines", _lines_text(truth, best)),
    ]
    for row in scores.methods:
        pictures.append(_save_answer(folder, truth, answers[row.method.tag], row, index))
    text = "Rectified by the true camera"
    pictures.append(_save(folder, case, "truth", truth.straight, "Ground truth", text))
    seen = [_network_map(folder, truth, each) for each in maps]
    doubts = _doubt_maps(folder, case, scores, answers)
    return Row(case.name, case.group, kind, tuple(pictures), (*seen, *doubts))


def _doubt_maps(
    folder: RunFolder, case: Case, scores: SuiteScores, answers: dict[str, Prediction]
) -> list[Picture]:
    """The expected error over the rectified frame, for each method that knows it."""
    maps = []
    for row in scores.methods:
        answer = answers[row.method.tag]
        if answer.covariance is None or not isinstance(answer.camera, KannalaBrandt):
            continue
        error = expected_error(answer.camera, answer.covariance)
        share = np.clip(np.nan_to_num(error) / _WORST_SHOWN, 0, 1)
        picture = colored(np.round(255 * share).astype(np.uint8))
        picture[np.isnan(error)] = 0
        typical = float(np.nanmedian(error)) if np.isfinite(error).any() else float("nan")
        title = f"{row.method.full_name}: expected error, 0 (dark) to {_WORST_SHOWN:g} px (bright)"
        alt = f"{title}; median {typical:.1f} px"
        maps.append(_save(folder, case, f"{row.method.tag}-doubt", picture, title, alt))
    return maps


def _network_map(folder: RunFolder, truth: Truth, seen: NetworkMap) -> Picture:
    """A map of the network in colours."""
    values = np.clip(np.nan_to_num(seen.values(truth.photo)), 0, 1)
    picture = colored(np.round(255 * values).astype(np.uint8))
    return _save(folder, truth.case, seen.tag, picture, seen.title, seen.title)


def network_maps() -> tuple[NetworkMap, ...]:
    """Lines and uncertainty as the weights that ship see them; none where none ship."""
    from learned.predictor import Predictor

    try:
        predictor = Predictor.from_weights()
    except FileNotFoundError:
        return ()
    return (
        NetworkMap(
            "heatmap",
            "Bent lines seen by the network, brighter for longer ones",
            lambda photo: predictor.lines(photo, longest=FRAME_WIDTH).heatmap,
        ),
        NetworkMap(
            "uncertainty",
            f"Where it finds the rectified picture hard: U_A, 0 to {_UNSURE:g} geometric means",
            lambda photo: predictor.uncertainty(photo) / _UNSURE,
        ),
    )


def _save_answer(
    folder: RunFolder, truth: Truth, answer: Prediction, row: MethodScores, index: int
) -> Picture:
    """The photograph rectified by one answer, after the best similarity."""
    size = np.array([truth.camera.width, truth.camera.height], dtype=np.float64)
    camera = answer.camera
    lens = None if camera is None else Resampled(camera, size / [camera.width, camera.height])
    place = rectified(lens, truth.points, truth.camera.width, truth.camera.height)
    similarity = best_similarity(place, truth.places)
    picture = rectify_picture(truth.photo, lens, similarity=similarity)
    error = float(row.values("aligned", "rpe")[index])
    name = row.method.full_name
    verdict = "failed, left alone" if answer.failed else "rectified"
    alt = f"{name}: {verdict}, aligned error {error:.1f} px"
    title = f"{name} (failed)" if answer.failed else name
    saved = _save(folder, truth.case, row.method.tag, picture, title, alt)
    return Picture(saved.file, saved.title, saved.alt, error)


def _lines(truth: Truth, answer: Prediction) -> UInt8[ndarray, "h w 3"]:
    """The curves that the primary method used, else the true lines, on the dimmed photograph."""
    canvas = 255 - (255 - cv2.cvtColor(truth.photo, cv2.COLOR_RGB2GRAY).astype(float)) * 0.6
    canvas = np.repeat(np.round(canvas).astype(np.uint8)[..., None], 3, axis=2)
    scale = np.array([truth.camera.width, truth.camera.height]) / [
        truth.case.camera.width,
        truth.case.camera.height,
    ]
    inlier = answer.inlier if answer.inlier is not None else np.ones(len(answer.curves), bool)
    drawn = [
        ((np.asarray(curve) + 0.5) * scale - 0.5, _INLIER if good else _OUTLIER)
        for curve, good in zip(answer.curves, inlier, strict=True)
    ]
    for points, color in drawn or [(curve, _TRUE) for curve in truth.curves]:
        fixed = np.round(points * 16).astype(np.int32).reshape(-1, 1, 2)
        cv2.polylines(canvas, [fixed], False, color, 1, cv2.LINE_AA, 4)
    return canvas


def _lines_text(truth: Truth, answer: Prediction) -> str:
    if not answer.curves:
        return f"{len(truth.curves)} true lines" if truth.curves else "No lines known"
    used = len(answer.curves) if answer.inlier is None else int(np.sum(answer.inlier))
    return f"{len(answer.curves)} curves found: {used} used (blue), the others left out (orange)"


def colored(values: UInt8[ndarray, "h w"]) -> UInt8[ndarray, "h w 3"]:
    """A map in colours that also read in grey."""
    return np.ascontiguousarray(cv2.applyColorMap(values, cv2.COLORMAP_VIRIDIS)[:, :, ::-1])


def _save(
    folder: RunFolder, case: Case, tag: str, picture: UInt8[ndarray, "h w 3"], title: str, alt: str
) -> Picture:
    """Write a picture 240 px wide as JPEG."""
    height = max(1, round(picture.shape[0] * _SIDE / picture.shape[1]))
    small = cv2.resize(picture, (_SIDE, height), interpolation=cv2.INTER_AREA)
    done, data = cv2.imencode(".jpg", small[:, :, ::-1], [cv2.IMWRITE_JPEG_QUALITY, _QUALITY])
    if not done:
        raise ValueError(f"expected a picture that JPEG can hold, got shape {picture.shape}")
    name = f"{case.name}--{tag}.jpg"
    with atomic_path(folder.gallery / name) as temporary:
        temporary.write_bytes(data.tobytes())
    return Picture(name, title, alt)
