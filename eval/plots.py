"""Plots of the report: arrays in, a Figure out; and figures as SVG in the page's own colours."""

import io
from collections.abc import Sequence
from typing import Any

import matplotlib as mpl
import numpy as np
from jaxtyping import Float
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy import ndarray

from eval.lines import THRESHOLDS, MatchCounts
from eval.methods import Method
from eval.summary import rank_correlation

_INK = "#010203"  # stands for the page's text colour until the SVG is written
_STYLE: Any = {
    "svg.fonttype": "none",
    "svg.hashsalt": "straightlens",
    "font.family": "sans-serif",
    "font.size": 10,
    "text.color": _INK,
    "axes.labelcolor": _INK,
    "axes.edgecolor": _INK,
    "xtick.color": _INK,
    "ytick.color": _INK,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.grid": True,
    "grid.alpha": 0.25,
    "grid.color": _INK,
    "legend.frameon": False,
    "legend.fontsize": 9,
}
_SIZE = (5.6, 4.0)  # inches
_N_BINS = 6
_MARKERS = "osD^vPX"


def precision_recall(curves: Sequence[tuple[Method, MatchCounts]]) -> Figure:
    """Precision against recall of the rectified line maps, one point a threshold τ."""
    figure, axes = _axes("Recall", "Precision")
    for index, (method, counts) in enumerate(curves):
        label = f"{method.full_name} (F = {counts.f_score:.2f})"
        shown = counts.found > 0
        axes.plot(
            counts.recall[shown], counts.precision[shown], label=label, **_look(method, index)
        )
    axes.set(xlim=(0, 1.02), ylim=(0, 1.02))
    _legend(axes)
    return figure


def error_shares(errors: Sequence[tuple[Method, Float[ndarray, " n"]]]) -> Figure:
    """Share of photographs whose aligned error is below a bound, against that bound."""
    figure, axes = _axes("Aligned error (px of a 320 px frame)", "Share of photographs (%)")
    for method, values in errors:
        ordered = np.sort(np.maximum(values, 0.05))
        share = 100 * np.arange(1, len(ordered) + 1) / len(ordered)
        axes.step(
            np.concatenate([[0.05], ordered, [200]]),
            np.concatenate([[0], share, [100]]),
            where="post",
            color=method.color,
            label=method.full_name,
            linewidth=1.8,
            linestyle=_line(method),
        )
    axes.set(xscale="log", xlim=(0.1, 100), ylim=(0, 101))
    _plain_ticks(axes, [0.1, 0.3, 1, 3, 10, 30, 100])
    _legend(axes)
    return figure


def error_by_fov(
    errors: Sequence[tuple[Method, Float[ndarray, " n"]]], fov: Float[ndarray, " n"]
) -> Figure:
    """Median aligned error of photographs of like field of view."""
    figure, axes = _axes("Horizontal field of view of the lens (°)", "Aligned error, median (px)")
    edges = np.unique(np.quantile(fov, np.linspace(0, 1, _N_BINS + 1)))
    place = np.clip(np.searchsorted(edges, fov, side="right") - 1, 0, max(len(edges) - 2, 0))
    bins = np.unique(place)
    centre = [float(np.median(fov[place == one])) for one in bins]
    for index, (method, values) in enumerate(errors):
        middle = [max(float(np.median(values[place == one])), 0.02) for one in bins]
        axes.plot(centre, middle, label=method.full_name, **_look(method, index))
    axes.set(yscale="log")
    _plain_ticks(axes, [0.1, 0.3, 1, 3, 10, 30], vertical=True)
    _legend(axes)
    return figure


def trust(
    rows: Sequence[tuple[Method, Float[ndarray, " n"], Float[ndarray, " n"]]],
) -> Figure:
    """Aligned error against the expected one of each photograph, with their rank correlation."""
    figure, axes = _axes("Expected error (px)", "Aligned error (px)")
    lows, highs = [], []
    for method, expected, true in rows:
        known = np.isfinite(expected)
        rank = rank_correlation(expected[known], true[known])
        x, y = np.maximum(expected[known], 0.05), np.maximum(true[known], 0.05)
        label = f"{method.full_name} (rank correlation {rank:.2f})"
        axes.scatter(x, y, s=16, color=method.color, alpha=0.7, label=label, linewidths=0)
        lows.append(min(x.min(), y.min()))
        highs.append(max(x.max(), y.max()))
    span = (min(lows) / 1.3, max(highs) * 1.3)
    axes.plot(span, span, color=_INK, linewidth=0.8, linestyle=":")
    axes.set(xscale="log", yscale="log", xlim=span, ylim=span)
    for vertical in (False, True):
        _plain_ticks(axes, [0.1, 0.3, 1, 3, 10, 30, 100, 300], vertical=vertical)
    _legend(axes, 1)
    return figure


def seconds(times: Sequence[tuple[Method, Float[ndarray, " n"]]]) -> Figure:
    """Time of an estimate: a bar to the median, a whisker to the 90th percentile."""
    shown = [(method, values) for method, values in times if np.median(values) > 1e-3]
    figure, axes = _axes("Seconds a photograph", "")
    figure.set_size_inches(_SIZE[0], 1.2 + 0.42 * max(len(shown), 1))
    for index, (method, values) in enumerate(shown[::-1]):
        middle, top = (float(np.percentile(values, share)) for share in (50, 90))
        axes.barh(index, middle, color=method.color, height=0.6)
        axes.plot([middle, top], [index, index], color=_INK, linewidth=1.2)
        beside = {"xytext": (5, 0), "textcoords": "offset points", "va": "center"}
        axes.annotate(f"{middle:.2g}", (top, index), fontsize=9, color=_INK, **beside)
    axes.set_yticks(range(len(shown)), [method.full_name for method, _ in shown[::-1]])
    axes.grid(visible=False, axis="y")
    if shown:
        longest = max(float(np.percentile(values, 90)) for _, values in shown)
        axes.set(xlim=(0, 1.25 * longest))
    return figure


def thresholds_text() -> str:
    """The thresholds of the precision–recall curve, for its caption."""
    return ", ".join(str(threshold) for threshold in THRESHOLDS)


def to_svg(figure: Figure, text: str) -> str:
    """A figure as an <svg> element that takes the colour of the text around it.

    Args:
        figure: The figure.
        text: What it shows, for readers who do not see it.
    """
    stream = io.StringIO()
    with mpl.rc_context(_STYLE):
        figure.savefig(stream, format="svg", transparent=True, metadata={"Date": None})
    svg = stream.getvalue()
    svg = svg[svg.index("<svg") :].replace(_INK, "currentColor")
    label = text.replace("&", "&amp;").replace('"', "&quot;").replace("<", "&lt;")
    return svg.replace("<svg", f'<svg role="img" aria-label="{label}"', 1)


def _axes(x_label: str, y_label: str) -> tuple[Figure, Axes]:
    with mpl.rc_context(_STYLE):
        figure = Figure(figsize=_SIZE, layout="constrained")
        axes = figure.add_subplot()
        axes.set(xlabel=x_label, ylabel=y_label)
    return figure, axes


def _look(method: Method, index: int) -> dict[str, Any]:
    marker = _MARKERS[index % len(_MARKERS)]
    style = {"linewidth": 1.8, "linestyle": _line(method), "markersize": 4.5}
    return {"color": method.color, "marker": marker, **style}


def _line(method: Method) -> str:
    return "--" if method.tag == "identity" else "-"


def _legend(axes: Axes, columns: int = 2) -> None:
    with mpl.rc_context(_STYLE):
        axes.legend(
            loc="upper center",
            bbox_to_anchor=(0.5, -0.16),
            ncols=columns,
            fontsize="x-small",
            columnspacing=1.0,
            handlelength=1.6,
        )


def _plain_ticks(axes: Axes, ticks: Sequence[float | int], *, vertical: bool = False) -> None:
    """Ticks of a logarithmic axis as ordinary numbers."""
    axis = axes.yaxis if vertical else axes.xaxis
    low, high = axis.get_view_interval()
    shown = [tick for tick in ticks if low <= tick <= high]
    axis.set_ticks(shown, [f"{tick:g}" for tick in shown])
    axis.set_ticks([], minor=True)
