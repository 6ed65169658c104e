"""The methods of the comparison: names, colours, and what each of them claims to know."""

from dataclasses import dataclass


@dataclass(frozen=True)
class Method:
    """One row of every table.

    Attributes:
        tag: Name on the command line and of folders.
        full_name: Name in tables and plots.
        color: Colour in all plots (Okabe–Ito, told apart by colour-blind readers).
        knows_focal: False where the model has no focal length, only a stated convention: its
            focal error says nothing and is not shown.
        together: Sees all pictures of a camera at once and gives one answer for all of them.
        variant: `RectifyConfig.variant`, None for the whole method.
        weights: Name of other weights that ship, None for the default.
        of: The estimator behind it, where that is not the tag.
        knows_truth: A yardstick that is chosen with the true lenses in view: no method for users,
            and never the best of a table.
    """

    tag: str
    full_name: str
    color: str
    knows_focal: bool = True
    together: bool = False
    variant: str | None = None
    weights: str | None = None
    of: str | None = None
    knows_truth: bool = False

    @property
    def estimator(self) -> str:
        """Name of the estimator behind it, `RectifyConfig.method`."""
        return self.of or self.tag


IDENTITY = Method("identity", "Left alone", "#7f7f7f", knows_focal=False)

METHODS = (
    IDENTITY,
    Method("bukhari", "Bukhari & Dailey 2013", "#e69f00", knows_focal=False),
    Method("aleman-flores", "Alemán-Flores et al. 2014", "#56b4e9", knows_focal=False),
    Method("rong", "Rong et al. 2016", "#009e73", knows_focal=False),
    Method("learned", "LaRecNet (network alone)", "#cc79a7"),
    Method("classical", "Straightness fit (no network)", "#0072b2"),
    Method("hybrid", "Straightlens (network + fit)", "#d55e00"),
)
"""In the order of the tables."""

TOGETHER = (
    Method(
        "classical-together",
        "Straightness fit, one for a camera",
        "#8a6fd1",
        together=True,
        of="classical",
    ),
    Method(
        "hybrid-together",
        "Straightlens, one fit for a camera",
        "#c43c39",
        together=True,
        of="hybrid",
    ),
)
"""Asked for by name only; they know more than the others: which pictures share a lens."""

STEPS = tuple(
    Method(f"hybrid-{variant}", full_name, color, variant=variant, of="hybrid")
    for variant, full_name, color in (
        ("start", "Centre lines, start of the network", "#9e9ac8"),
        ("prior", "… and its belief", "#807dba"),
        ("snapped", "… and sub-pixel edges", "#6a51a3"),
        ("edges", "… and the picture's own edges", "#4a1486"),
        ("followed", "… and lines followed further", "#3b0f70"),
        ("parallels", "… and directions of lines", "#2d0a57"),
    )
)
"""The hybrid built up step by step; the whole adds vanishing points. Asked for by name only."""

WIREFRAME = tuple(
    Method(f"{of}-wf", full_name, color, weights="compact-wf", of=of)
    for of, full_name, color in (
        ("learned", "LaRecNet, weights of SLF_wf", "#b0578f"),
        ("hybrid", "Straightlens, weights of SLF_wf", "#8c3f00"),
    )
)
"""With weights that know planes of photographs and the paper's lenses alone, as one row of the
paper's table. Asked for by name only."""

FIXED = Method(
    "fixed",
    "Best fixed lens (knows the truth)",
    "#000000",
    knows_focal=False,
    knows_truth=True,
)
"""The one lens that does best when all pictures of a suite are given it. Asked for by name only."""

EVERY = (*METHODS, *WIREFRAME, *TOGETHER, *STEPS, FIXED)
"""All of them, in the order of the tables."""

_BY_TAG = {method.tag: method for method in EVERY}


def method_of(tag: str) -> Method:
    """The method of a tag; an unknown one (an ablation's, say) stands for itself, in black."""
    return _BY_TAG.get(tag, Method(tag, tag, "#444444"))


def parse_methods(tags: str) -> tuple[Method, ...]:
    """The methods of a comma-separated list, in the order of the tables.

    Raises:
        ValueError: If a tag is unknown or the list is empty.
    """
    wanted = [tag.strip() for tag in tags.split(",") if tag.strip()]
    unknown = sorted(set(wanted) - set(_BY_TAG))
    if unknown or not wanted:
        raise ValueError(f"expected methods among {', '.join(_BY_TAG)}, got {tags!r}")
    return tuple(method for tag, method in _BY_TAG.items() if tag in wanted)
