"""Where the two loops keep their files, and the configuration that must not change under them."""

import json
import os
import platform
import subprocess
from collections.abc import Mapping
from dataclasses import dataclass
from importlib import metadata
from pathlib import Path
from typing import Any

import numpy as np

from classical.files import atomic_path, remove_leftovers
from eval.cases import Case, Suite
from eval.methods import Method

_FORMAT = 1
_PACKAGES = ("straightlens", "numpy", "scipy", "opencv-python-headless", "scikit-image", "torch")


@dataclass(frozen=True)
class RunFolder:
    """Files of one suite: `config.json`, `predictions/METHOD/NAME.npz`, `scores/NAME.json`."""

    root: Path

    def prediction(self, method: str, case: str) -> Path:
        """File of the answer of a method on a photograph."""
        return self.root / "predictions" / method / f"{case}.npz"

    def score(self, case: str) -> Path:
        """File of the scores of all methods on a photograph."""
        return self.root / "scores" / f"{case}.json"

    @property
    def config(self) -> Path:
        """File of the configuration."""
        return self.root / "config.json"

    @property
    def gallery(self) -> Path:
        """Folder of the pictures for the report."""
        return self.root / "gallery"

    def read_config(self) -> dict[str, Any]:
        """The saved configuration.

        Raises:
            ValueError: If there is none, or one of another format.
        """
        if not self.config.is_file():
            raise ValueError(f"expected a folder written by 'evaluate', got {self.root}")
        config = json.loads(self.config.read_text(encoding="utf-8"))
        if config.get("format") != _FORMAT:
            raise ValueError(f"expected format {_FORMAT} in {self.config}, got another")
        return config


def claim_folder(
    folder: RunFolder, suite: Suite, methods: Mapping[Method, Mapping[str, Any]]
) -> dict[str, Any]:
    """Save the configuration of a run, or check that it is the saved one.

    Methods may be added to a folder; the data and the settings of a method may not change, since
    files of two configurations would lie side by side.

    Args:
        folder: Where the run lives; made if missing.
        suite: The test set.
        methods: The settings of each method, plain values.

    Returns:
        The configuration as it now lies in the folder.

    Raises:
        ValueError: If the folder holds another configuration; the message names what differs.
    """
    config = {
        "format": _FORMAT,
        "suite": _suite_record(suite),
        "methods": {method.tag: dict(settings) for method, settings in methods.items()},
        "origins": dict.fromkeys((method.tag for method in methods), origin()),
    }
    config = json.loads(json.dumps(config, sort_keys=True))
    if folder.config.is_file():
        saved = folder.read_config()
        _refuse_differences(saved, config, folder.root)
        for key in ("methods", "origins"):  # what is there keeps its origin
            config[key] = config[key] | saved[key]
    places = [folder.root / "predictions" / method.tag for method in methods]
    for place in (*places, folder.root / "scores", folder.gallery):
        place.mkdir(parents=True, exist_ok=True)
        remove_leftovers(place)
    remove_leftovers(folder.root)
    with atomic_path(folder.config) as temporary:
        temporary.write_text(json.dumps(config, indent=1, sort_keys=True), encoding="utf-8")
    return config


def _suite_record(suite: Suite) -> dict[str, Any]:
    return {
        "name": suite.name,
        "note": suite.note,
        "is_real": suite.is_real,
        "n": len(suite.cases),
        "fingerprint": suite.fingerprint,
        "theta_max_deg": round(float(np.degrees(suite.theta_max)), 6),
        "lines": "marked" if any(case.curves for case in suite.cases) else "grid",
        "cases": {case.name: _case_record(case) for case in suite.cases},
    }


def _case_record(case: Case) -> dict[str, Any]:
    camera = case.camera
    return {
        "group": case.group,
        "fov": round(case.fov, 2),
        "width": camera.width,
        "height": camera.height,
        "k": [round(float(value), 6) for value in camera.to_vector()],
    }


def _refuse_differences(saved: dict[str, Any], config: dict[str, Any], root: Path) -> None:
    """Stop when a folder holds the files of another configuration."""
    wrong = [
        f"suite {key} {saved['suite'][key]!r} instead of {config['suite'][key]!r}"
        for key in ("name", "fingerprint", "theta_max_deg")
        if saved["suite"][key] != config["suite"][key]
    ]
    for tag, settings in config["methods"].items():
        old = saved["methods"].get(tag, settings)
        changed = sorted(key for key in {*old, *settings} if old.get(key) != settings.get(key))
        wrong += [f"{tag}.{key} {old.get(key)!r} not {settings.get(key)!r}" for key in changed]
    if wrong:
        raise ValueError(f"expected the configuration of {root}, got another: {'; '.join(wrong)}")


def origin() -> dict[str, Any]:
    """Where numbers come from: commit, versions, and the class of machine without its name."""
    return {
        "commit": _commit(),
        "python": platform.python_version(),
        "packages": {name: _version(name) for name in _PACKAGES},
        "machine": f"{platform.system()} {platform.machine()}, {os.cpu_count()} cores",
        "processor": _processor(),
    }


def _commit() -> str:
    """Commit of the checkout that this file lies in, "+" where it has changes; else empty."""
    here = Path(__file__).parent

    def git(*arguments: str) -> str:
        command = ["git", "-C", str(here), *arguments]
        done = subprocess.run(command, capture_output=True, text=True, timeout=20, check=False)
        return done.stdout.strip() if done.returncode == 0 else ""

    try:
        commit = git("rev-parse", "--short=12", "HEAD")
        return commit + ("+" if commit and git("status", "--porcelain", "-uno") else "")
    except (OSError, subprocess.TimeoutExpired):
        return ""


def _version(package: str) -> str:
    try:
        return metadata.version(package)
    except metadata.PackageNotFoundError:
        return ""


def _processor() -> str:
    """Model of the processor where Linux tells it."""
    try:
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines()
    except OSError:
        return platform.processor()
    names = [line.partition(":")[2].strip() for line in lines if line.startswith("model name")]
    return names[0] if names else platform.processor()
