"""Options that the commands of the comparison share."""

from pathlib import Path

import click

suites_option = click.option(
    "--suite",
    "suites",
    required=True,
    multiple=True,
    type=click.Path(exists=True, path_type=Path),
    help="Test set: a folder with suite.json, photographs with one camera file, or the fisheye "
    "video dataset. May be given several times.",
)
every_option = click.option(
    "--every", default=1, show_default=True, type=click.IntRange(1), help="Each n-th picture only."
)
workers_option = click.option(
    "--workers", default=1, show_default=True, type=click.IntRange(1), help="Processes of the test."
)
