"""A test set for the two loops: all of it, or a part chosen by rule."""

from dataclasses import replace
from pathlib import Path

from eval.cases import Case, Suite
from eval.metrics import aligned_error
from eval.suites import load_suite

_SPACING = 4.0  # pixels between the samples that tell how bent a picture is


def open_suite(path: Path, *, min_bend: float = 0.0, every: int = 1) -> Suite:
    """Read a test set and choose from it.

    Args:
        path: What `load_suite` reads.
        min_bend: Leave out pictures whose aligned error, left alone, is below so many pixels of
            the 320 px frame: lenses that are nearly straight already.
        every: Take each so-many-th of the pictures that are left.

    Raises:
        ValueError: If there is no such set, or nothing is left of it.
    """
    suite = load_suite(path)
    bent = [case for case in suite.cases if min_bend <= 0 or bend(case) >= min_bend]
    if not bent:
        raise ValueError(f"expected pictures bent by {min_bend} px or more in {path}, got none")
    note = suite.note
    if left_out := len(suite.cases) - len(bent):
        note += f" {left_out} nearly straight pictures (under {min_bend:g} px) are left out."
    return replace(suite, cases=tuple(bent[::every]), note=note.strip())


def bend(case: Case) -> float:
    """Aligned error of a picture that is left alone, in pixels of the 320 px frame."""
    camera = case.camera
    size = {"width": camera.width, "height": camera.height}
    return aligned_error(None, camera, **size, spacing=_SPACING)
