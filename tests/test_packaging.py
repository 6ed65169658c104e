"""Laws of the package: its version is the tag's, and the wheel alone is enough to run."""

import subprocess
import sys
import sysconfig
import tarfile
import venv
import zipfile
from pathlib import Path

import pytest

pytest.importorskip("hatchling")
pytest.importorskip("hatch_vcs")
ROOT = Path(__file__).resolve().parents[1]
PACKAGES = ("classical", "learned", "hybrid", "eval")


def run(*words: object, cwd: Path) -> str:
    done = subprocess.run(
        [str(word) for word in words], cwd=cwd, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


def tracked() -> list[str]:
    """Files of the repository; skips where the tests run outside of one."""
    if not (ROOT / ".git").exists():
        pytest.skip("this is no checkout")
    return run("git", "ls-files", cwd=ROOT).splitlines()


@pytest.fixture
def tree(tmp_path) -> Path:
    """What the version is told from: no tag, no repository."""
    folder = tmp_path / "tree"
    folder.mkdir()
    for name in ("pyproject.toml", "README.md", "LICENSE"):
        (folder / name).write_bytes((ROOT / name).read_bytes())
    return folder


def version(tree: Path) -> str:
    return run(sys.executable, "-m", "hatchling", "version", cwd=tree).strip()


def commit(tree: Path) -> None:
    author = ("-c", "user.name=A", "-c", "user.email=a@example.org")
    run("git", "init", "-q", cwd=tree)
    run("git", "add", ".", cwd=tree)
    run("git", *author, "commit", "-q", "-m", "All", cwd=tree)


def test_the_version_is_that_of_the_tag(tree):
    commit(tree)
    run("git", "tag", "v1.2.3", cwd=tree)
    assert version(tree) == "1.2.3"


def test_a_checkout_without_tags_has_a_version_too(tree):
    commit(tree)
    assert ".dev1+g" in version(tree)


def test_a_tree_without_git_has_a_version_too(tree):
    assert version(tree) == "0.1.0.dev0"


@pytest.fixture(scope="module")
def built(tmp_path_factory) -> tuple[Path, Path]:
    """A wheel and the source archive that it was built from."""
    pytest.importorskip("build")
    out = tmp_path_factory.mktemp("dist")
    run(sys.executable, "-m", "build", "--no-isolation", "--outdir", out, ROOT, cwd=out)
    return next(out.glob("*.whl")), next(out.glob("*.tar.gz"))


@pytest.mark.slow
def test_the_wheel_holds_the_four_packages_and_nothing_else(built):
    ours = {name for name in tracked() if name.split("/")[0] in PACKAGES}
    with zipfile.ZipFile(built[0]) as wheel:
        inside = {name for name in wheel.namelist() if ".dist-info/" not in name}
    assert ours <= inside
    assert {name.split("/")[0] for name in inside} == set(PACKAGES)


@pytest.mark.slow
def test_the_source_archive_holds_what_the_tests_need(built):
    wanted = {
        name
        for name in tracked()
        if name.split("/")[0] in ("tests", "examples", "docs")
        # weights that only the table of the ablation is made of
        and not (name.startswith("docs/ablation/") and name.endswith(".safetensors"))
    }
    with tarfile.open(built[1]) as archive:
        inside = {name.partition("/")[2] for name in archive.getnames()}
    assert wanted <= inside
    assert {"constraints.txt", "Makefile", "CHANGELOG.md"} <= inside


@pytest.mark.slow
def test_the_wheel_runs_away_from_the_sources(built, tmp_path):
    # an environment with this one's dependencies, but the packages from the wheel
    venv.create(tmp_path / "venv", with_pip=False)
    home = {"base": str(tmp_path / "venv"), "platbase": str(tmp_path / "venv")}
    site = Path(sysconfig.get_path("purelib", "venv", vars=home))
    pip = (sys.executable, "-m", "pip", "--disable-pip-version-check", "install", "-q")
    run(*pip, "--no-deps", "--no-index", "--target", site, built[0], cwd=tmp_path)
    (site / "dependencies.pth").write_text(sysconfig.get_path("purelib") + "\n")
    python = tmp_path / "venv" / "bin" / "python"
    code = "import hybrid, learned.weights as w; print(hybrid.__file__, w.packaged('compact'))"
    places = run(python, "-c", code, cwd=tmp_path).split()
    assert all(Path(place).is_relative_to(tmp_path) for place in places)
    command = (python, "-c", "from hybrid.cli import main; main()")
    said = run(*command, "--version", cwd=tmp_path)
    assert said.split()[-1] == built[0].name.split("-")[1]
    room = ROOT / "examples" / "room.jpg"
    run(*command, "rectify", room, "--out", "out", "--method", "learned", cwd=tmp_path)
    assert (tmp_path / "out" / "room.jpg").is_file()
    assert (tmp_path / "out" / "room.camera.json").is_file()
