"""Plots are drawn for any number of methods, as SVG that stands in a page."""

import xml.etree.ElementTree as ET

import numpy as np
import pytest

from eval import plots
from eval.lines import THRESHOLDS, MatchCounts
from eval.methods import METHODS, TOGETHER

EVERY = (*METHODS, *TOGETHER)
N = 12


def draw(name: str, n_methods: int) -> str:
    rng = np.random.default_rng(1)
    chosen = EVERY[-n_methods:]
    rows = [(method, rng.uniform(0.5, 30, N)) for method in chosen]
    if name == "precision_recall":
        found = np.arange(10, 10 + len(THRESHOLDS)) * 5
        counts = MatchCounts(found // 2, found, 120)
        figure = plots.precision_recall([(method, counts) for method in chosen])
    elif name == "error_by_fov":
        figure = plots.error_by_fov(rows, rng.uniform(80, 190, N))
    elif name == "trust":
        figure = plots.trust([(method, values, values[::-1]) for method, values in rows])
    else:
        figure = getattr(plots, name)(rows)
    return plots.to_svg(figure, 'Errors of "A" & <B>')


@pytest.mark.parametrize("n_methods", [1, len(EVERY)])
@pytest.mark.parametrize(
    "name", ["precision_recall", "error_shares", "error_by_fov", "trust", "seconds"]
)
def test_a_plot_is_well_formed_and_says_what_it_shows(name, n_methods):
    svg = draw(name, n_methods)
    element = ET.fromstring(svg)
    assert element.get("role") == "img"
    assert element.get("aria-label") == 'Errors of "A" & <B>'
    assert "currentColor" in svg
    assert "#010203" not in svg


def test_the_same_numbers_give_the_same_plot():
    assert draw("error_shares", 3) == draw("error_shares", 3)


def test_an_unknown_expectation_is_not_plotted():
    values, true = np.array([1.0, np.nan, 3.0, 2.0]), np.array([2.0, 4.0, 5.0, 3.0])
    svg = plots.to_svg(plots.trust([(METHODS[-1], values, true)]), "x")
    assert "rank correlation 1.00" in svg
    assert ET.fromstring(svg) is not None
