"""Every parameter of the two Alemán-Flores methods, in one frozen dataclass."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any, Literal

Variant = Literal["2014", "2016"]


@dataclass(frozen=True)
class AlemanFloresConfig:
    """Parameters of the method; `for_variant` gives the authors' values of each article.

    Distances are pixels of the working picture, in the undistorted plane where lines are concerned.

    Attributes:
        variant: "2014", one parameter and a fixed centre, or "2016", two parameters and a free
            centre.
        smallest_side: Pictures whose longer side is shorter are enlarged to this first.
        largest_side: Pictures whose longer side is longer are reduced to this first.
        sigma: Standard deviation of the smoothing before the gradient, px.
        low_percentile: Low hysteresis threshold as a percentile of the gradient norm.
        high_percentile: High hysteresis threshold as a percentile of the gradient norm.
        low_floor: Least value of the low threshold, grey levels a pixel.
        high_floor: Least value of the high threshold, grey levels a pixel.
        p_max: Largest normalised distortion searched.
        p_step: Step of the search over the normalised distortion.
        angle_step_deg: Step of the angle in the Hough space, degrees.
        angle_max_deg: Largest difference of a point's tangent to its line, degrees. The 2014
            demonstration used 2°, the 2016 article 10°.
        distance_range: Lines up to this many half diagonals from the centre are searched, in the
            undistorted plane.
        coarse_angles: All values of p are first searched at every so many-th angle; 1 for none.
        coarse_margin: Searched in full are slices whose coarse score is lower than the best by no
            more than this share, the two next to the best, and p = 0.
        maxima: Maxima picked in each slice of the Hough space.
        clear_angle_deg: Neighbourhood cleared around a maximum (2014), degrees.
        clear_distance: Neighbourhood cleared around a maximum (2014), px.
        line_distance: Largest distance of a point to its line, px.
        collect_slack: Added to `line_distance` for the first collection of points, px.
        least_points: A line of fewer points is dropped.
        least_share: A line of fewer than this share of the strongest line's points is dropped.
        merge_distance: Largest mean distance of a line merged into another (2014), px.
        newton_step: Step of the central differences in p.
        newton_centre_step: Step of the central differences in the centre (2016), px.
        newton_damping: First value of the damping γ.
        newton_tolerance: Relative change of p at which the refinement ends.
        newton_rounds: Most Newton steps.
        centre_share: The centre may move by this share of the width and height (2016).
        outer_growth: The outer loop goes on while line points grow by more than this share (2016).
        outer_failures: The outer loop ends after so many rounds without growth (2016).
        outer_rounds: Most rounds of the outer loop (2016).
        least_lines: Fewer lines than this that chance cannot explain are a failed estimate.
        least_run: Shortest unbroken run of edge points that speaks for a line, as a share of the
            longer side.
        least_cover: Such runs must cover this much of a line together, as a share of the longer
            side, or chance may explain it.
        workers: Threads that search slices of the Hough space; the result is the same for any.
    """

    variant: Variant = "2014"
    smallest_side: int | None = 640
    largest_side: int | None = 1280
    sigma: float = 2.0
    low_percentile: float = 70.0
    high_percentile: float = 80.0
    low_floor: float = 2.0
    high_floor: float = 4.0
    p_max: float = 3.0
    p_step: float = 0.1
    angle_step_deg: float = 0.1
    angle_max_deg: float = 10.0
    distance_range: float = 1.2
    coarse_angles: int = 5
    coarse_margin: float = 0.05
    maxima: int = 30
    clear_angle_deg: float = 2.0
    clear_distance: int = 20
    line_distance: float = 3.0
    collect_slack: float = 1.5
    least_points: int = 5
    least_share: float = 0.0
    merge_distance: float = 9.0
    newton_step: float = 1e-4
    newton_centre_step: float = 1e-2
    newton_damping: float = 1.0
    newton_tolerance: float = 1e-8
    newton_rounds: int = 100
    centre_share: float = 0.2
    outer_growth: float = 0.01
    outer_failures: int = 3
    outer_rounds: int = 20
    least_lines: int = 4
    least_run: float = 0.05
    least_cover: float = 0.09
    workers: int = 2

    def __post_init__(self) -> None:
        if self.variant not in ("2014", "2016"):
            raise ValueError(f'Expected variant "2014" or "2016", got {self.variant!r}.')
        positive = {
            "sigma": self.sigma,
            "p_step": self.p_step,
            "angle_step_deg": self.angle_step_deg,
            "angle_max_deg": self.angle_max_deg,
            "distance_range": self.distance_range,
            "coarse_angles": self.coarse_angles,
            "maxima": self.maxima,
            "line_distance": self.line_distance,
            "workers": self.workers,
        }
        for name, value in positive.items():
            if not value > 0:
                raise ValueError(f"Expected {name} > 0, got {value}.")
        if abs(180 / self.angle_step_deg - round(180 / self.angle_step_deg)) > 1e-9:
            raise ValueError(
                f"Expected an angle_step_deg that divides 180°, got {self.angle_step_deg}."
            )

    @classmethod
    def for_variant(cls, variant: Variant, **changes: Any) -> AlemanFloresConfig:
        """The values of the article of that year, with `changes` to single ones."""
        config = cls(variant=variant)
        if variant == "2016":
            config = replace(
                config, maxima=100, least_points=20, least_share=0.05, newton_damping=10.0
            )
        return replace(config, **changes)

    @property
    def n_angles(self) -> int:
        """Number of angles of the Hough space over 180°."""
        return round(180 / self.angle_step_deg)

    @property
    def angle_reach(self) -> int:
        """`angle_max_deg` in steps of the angle."""
        return round(self.angle_max_deg / self.angle_step_deg)
