"""Measurements: `python -m benchmarks` writes docs/benchmarks.md; the other modules run alone."""
