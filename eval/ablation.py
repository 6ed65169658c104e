"""The paper's ablation study and its comparison of training sets: which variants, trained how.

Every variant is trained under one budget and seed, from the same line perception and a random
calibration. What is kept of each is its calibration alone; line perception is kept once.
"""

import hashlib
import json
import shutil
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

from jaxtyping import UInt8
from numpy import ndarray
from safetensors import safe_open
from safetensors.torch import save_file

from classical.files import atomic_path
from eval import published
from eval.cases import Suite
from eval.folder import RunFolder, claim_folder
from eval.methods import Method, method_of
from eval.predict import Predictor, Settings
from eval.prediction import Prediction
from eval.summary import SuiteScores, load_scores
from learned.config_json import from_json
from learned.jobs import WEIGHTS, JobCfg, run_job
from learned.larecnet import LaRecNet, LarecnetCfg
from learned.predictor import Predictor as Network
from learned.presets import ABLATIONS, COMPACT, Preset, ablation, preset
from learned.slf.stream import StreamCfg
from learned.train import RunCfg
from learned.weights import load_perception, save_weights

PERCEPTION = "perception.safetensors"
_STUDY, _LOG = "study.json", "log.jsonl"
_DLP = "dlp."

_ALL = StreamCfg().scenes
_PLANES = (1.0, 0.0, 0.0, 0.0)
_ROOMS = (0.0, *_ALL[1:])
_SCENES = {_ALL: "all", _PLANES: "planes", _ROOMS: "rooms"}


@dataclass(frozen=True)
class Variant:
    """A network to train and compare.

    Attributes:
        name: As the paper calls it.
        trained: Name of the training; two studies may show the same one.
        level: "BL1" to "BL6", see `learned.presets.ablation`.
        scenes: `StreamCfg.scenes` of its training set.
        theirs: The paper's numbers, on its own test set.
    """

    name: str
    trained: str
    level: str
    scenes: tuple[float, float, float, float]
    theirs: published.PublishedRow

    @property
    def tag(self) -> str:
        """Its name as a method of the comparison."""
        return self.trained.lower()

    def folder(self, out: Path, seed: int) -> Path:
        """Where its weights and its log are kept."""
        return out / self.trained / f"seed-{seed}"

    def is_trained(self, out: Path, seed: int) -> bool:
        """Whether they are there."""
        return (self.folder(out, seed) / WEIGHTS).is_file()


_SLF = {row.name.removeprefix("LaRecNet, "): row for row in published.SLF}
STUDIES = {
    "parts": tuple(
        Variant(row.name, level, level, _PLANES, row)
        for level in ABLATIONS
        for row in (published.ABLATION[level.lower()],)
    ),
    "data": (
        Variant("SLF: planes, boxes, panoramas", "SLF", "BL6", _ALL, _SLF["SLF"]),
        Variant("SLF_wf: planes", "BL6", "BL6", _PLANES, _SLF["SLF_wf"]),
        Variant("SLF_sun: boxes, panoramas", "SLF_sun", "BL6", _ROOMS, _SLF["SLF_sun"]),
    ),
}
"""What is compared: parts of the network and its loss, or training sets of the whole network."""


@dataclass(frozen=True)
class Budget:
    """What all variants of a study folder have in common.

    Attributes:
        preset: "compact" (with a calibration about 3/4 as wide and no covariance head, so that
            the kept weights are small) or "paper".
        steps: Optimiser steps.
        batch: Samples a step.
        size: Side of the frame in pixels.
        ahead: Samples made before the training, of each training set; 0 draws each anew.
        rate: Highest learning rate, None for the preset's.
        fall: Share of the steps in which a trapezoid's rate falls.
        init: Name and checksum of the weights whose line perception all start from.
    """

    preset: str = "compact"
    steps: int = 1500
    batch: int = 16
    size: int = 128
    ahead: int = 8000
    rate: float | None = None
    fall: float = 0.5
    init: str = ""

    def network(self, level: str) -> Preset:
        """The preset of a variant."""
        base = narrowed(COMPACT) if self.preset == COMPACT.name else preset(self.preset)
        return ablation(base.with_schedule(rate=self.rate, fall=self.fall), level)


def narrowed(base: Preset) -> Preset:
    """The compact preset with 1.4 million weights in the calibration instead of 3.9 million."""
    calibration = replace(
        base.network.calibration,
        widths=(48, 96, 160, 224),
        branch=160,
        hidden=128,
        covariance=False,
    )
    network = replace(base.network, calibration=calibration)
    return replace(base, name=f"{base.name}-narrow", network=network)


def claim_study(out: Path, budget: Budget, init: Path) -> Path:
    """Save the budget and the line perception of a study, or check that they are the saved ones.

    Args:
        out: Folder of the study; made if missing.
        budget: Of all its trainings; `init` is filled in here.
        init: Weights of line perception, or of a LaRecNet whose line perception is taken.

    Returns:
        File of the line perception.

    Raises:
        ValueError: If the folder holds trainings of another budget; the message says what differs.
    """
    budget = replace(budget, init=f"{init.name} {_checksum(init)}")
    study, perception = out / _STUDY, out / PERCEPTION
    if study.is_file():
        saved, asked = asdict(read_budget(out)), asdict(budget)
        wrong = [
            f"{key} {saved[key]!r} not {asked[key]!r}" for key in saved if saved[key] != asked[key]
        ]
        if wrong:
            raise ValueError(f"expected the budget of {out}, got another: {'; '.join(wrong)}")
        return perception
    out.mkdir(parents=True, exist_ok=True)
    save_weights(perception, load_perception(init), {"taken from": budget.init})
    with atomic_path(study) as temporary:
        temporary.write_text(json.dumps(asdict(budget), indent=1), encoding="utf-8")
    return perception


def read_budget(out: Path) -> Budget:
    """The budget of a study folder.

    Raises:
        ValueError: If it is none.
    """
    study = out / _STUDY
    if not study.is_file():
        raise ValueError(f"expected a folder written by 'ablate', got {out}")
    return Budget(**json.loads(study.read_text(encoding="utf-8")))


def train_variant(variant: Variant, seed: int, pack: Path, out: Path, *, cpu: bool = False) -> None:
    """Train a variant unless its weights are there; a stopped training goes on.

    Args:
        variant: What to train.
        seed: Of first weights, samples and their order.
        pack: Training pictures.
        out: Folder of the study, see `claim_study`.
        cpu: Stay on the CPU.
    """
    if variant.is_trained(out, seed):
        return
    budget = read_budget(out)
    run = out / "work" / f"{variant.trained}-seed{seed}"
    job = JobCfg(
        target="larecnet",
        preset=budget.network(variant.level),
        pack=pack,
        validation=None,
        folder=run,
        steps=budget.steps,
        seed=seed,
        batch_size=budget.batch,
        size=budget.size,
        ahead=budget.ahead,
        samples=out / "work" / "samples" / f"{_SCENES[variant.scenes]}-seed{seed}",
        data=StreamCfg(scenes=variant.scenes),
        init=out / PERCEPTION,
        run=RunCfg(steps=budget.steps, workers=0, log_every=min(20, budget.steps)),
    )
    whole = run_job(job, resume=True, cpu=cpu)
    kept = variant.folder(out, seed)
    kept.mkdir(parents=True, exist_ok=True)
    for file in (run / _LOG, whole.with_suffix(".md")):
        with atomic_path(kept / file.name) as temporary:
            shutil.copyfile(file, temporary)
    _keep_calibration(whole, kept / WEIGHTS)


def _keep_calibration(whole: Path, target: Path) -> None:
    """Write a LaRecNet's weights without those of line perception."""
    with safe_open(whole, framework="pt") as file:
        names = [name for name in file.keys() if not name.startswith(_DLP)]  # noqa: SIM118
        tensors = {name: file.get_tensor(name) for name in names}
        metadata = file.metadata()
    with atomic_path(target) as temporary:
        save_file(tensors, temporary, metadata=metadata)


def load_variant(variant: Variant, seed: int, out: Path) -> Network:
    """A trained variant, put together from its calibration and the study's line perception.

    Raises:
        FileNotFoundError: If it has not been trained.
    """
    path = variant.folder(out, seed) / WEIGHTS
    if not path.is_file():
        raise FileNotFoundError(f"expected weights of {variant.trained}, got none in {path.parent}")
    with safe_open(path, framework="pt") as file:
        config = from_json(LarecnetCfg, file.metadata()["config"])
        tensors = {name: file.get_tensor(name) for name in file.keys()}  # noqa: SIM118
    perception = load_perception(out / PERCEPTION).state_dict()
    network = LaRecNet(config)
    network.load_state_dict(tensors | {_DLP + name: value for name, value in perception.items()})
    return Network(network)


@dataclass(frozen=True)
class VariantFactory:
    """Makes predictors of trained variants for loop one; see `eval.predict.Factory`.

    Attributes:
        out: Folder of the study.
        seed: Which of the trainings.
    """

    out: Path
    seed: int

    def __call__(self, estimator: str, _: Settings) -> Predictor:
        """The predictor of the variant with this tag."""
        chosen = {v.tag: v for variants in STUDIES.values() for v in variants}[estimator]
        return partial(_ask, load_variant(chosen, self.seed, self.out))


def _ask(network: Network, pictures: Sequence[UInt8[ndarray, "h w 3"]]) -> list[Prediction]:
    """The network's lens of each picture, one at a time and nothing else."""
    cameras = [network.lens(picture).camera for picture in pictures]
    return [
        Prediction(camera, "ok") if camera else Prediction(None, "failed", "k1 is not positive")
        for camera in cameras
    ]


def trained(out: Path, variants: Sequence[Variant]) -> dict[int, list[Variant]]:
    """Which of these a folder holds the weights of, by seed.

    Raises:
        ValueError: If it holds none.
    """
    files = out.glob(f"*/seed-*/{WEIGHTS}")
    seeds = sorted({int(file.parent.name.removeprefix("seed-")) for file in files})
    each = {seed: [v for v in variants if v.is_trained(out, seed)] for seed in seeds}
    found = {seed: there for seed, there in each.items() if there}
    if not found:
        raise ValueError(f"expected trained variants in {out}, got none")
    return found


def claim_scores(suite: Suite, variants: Sequence[Variant], seed: int, out: Path) -> RunFolder:
    """The folder for answers and scores of trained variants, which `report` reads too.

    Raises:
        ValueError: If it holds those of another test set or of other weights.
    """
    folder = scores_folder(out, seed, suite.name)
    claim_folder(folder, suite, settings_of_variants(variants, seed, out))
    return folder


def scores_folder(out: Path, seed: int, suite: str) -> RunFolder:
    """Where answers and scores on a suite lie."""
    return RunFolder(out / "scores" / f"seed-{seed}" / suite)


def scored_suites(out: Path) -> dict[str, dict[int, SuiteScores]]:
    """All scores of a study, by suite and seed."""
    found: dict[str, dict[int, SuiteScores]] = {}
    for config in sorted(out.glob("scores/seed-*/*/config.json")):
        seed = int(config.parent.parent.name.removeprefix("seed-"))
        found.setdefault(config.parent.name, {})[seed] = load_scores(RunFolder(config.parent))
    return found


def settings_of_variants(
    variants: Sequence[Variant], seed: int, out: Path
) -> dict[Method, dict[str, Any]]:
    """Each variant as a method of the comparison, with a checksum of its weights."""
    files = {v.tag: v.folder(out, seed) / WEIGHTS for v in variants}
    return {method_of(tag): {"weights": _checksum(file)} for tag, file in files.items()}


def _checksum(path: Path) -> str:
    return hashlib.sha256(path.read_bytes()).hexdigest()[:16]
