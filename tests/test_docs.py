"""Laws of the documentation: what README and pages tell to type works as written.

The blocks of a page run in order in one folder. Python runs. Commands that are quick run, too; the
others go through their real parsers, with the files they name there.
"""

import re
import shlex
import sys
import tomllib
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import click
import numpy as np
import pytest
from PIL import Image, ImageOps

from hybrid.cli import run, straightlens
from learned.weights import packaged

ROOT = Path(__file__).resolve().parents[1]
PAGES = [ROOT / "README.md", *sorted((ROOT / "docs").glob("*.md"))]
FENCE = re.compile(r"^```(\w*)\n(.*?)^```$", re.MULTILINE | re.DOTALL)
LANGUAGES = {"python", "sh", "text"}
QUICK = {"rectify", "calibrate", "convert"}
SIZE = (320, 240)
FOLDERS = (
    "photos",
    "panoramas",
    "sets/panoramas",
    "sets/real",
    "sets/dwireframe",
    "runs/compared",
    "runs/larecnet",
)
FILES = ("film.mp4", "train.pack", "val.pack", "dlp.safetensors", "runs/dlp/weights.safetensors")


@dataclass(frozen=True)
class Block:
    """A fenced block of a page.

    Attributes:
        language: What stands behind the fence.
        line: Line of the page before its first one.
        code: What is in it.
    """

    language: str
    line: int
    code: str


def blocks(page: Path) -> Iterator[Block]:
    text = page.read_text(encoding="utf-8")
    for match in FENCE.finditer(text):
        yield Block(match[1], text.count("\n", 0, match.start(2)), match[2])


@pytest.fixture
def place(tmp_path, monkeypatch) -> Path:
    """A folder with what the pages name, small."""
    with Image.open(ROOT / "examples" / "room.jpg") as room:
        small = room.resize(SIZE, Image.Resampling.BOX)
    (tmp_path / "pictures").mkdir()
    small.save(tmp_path / "photo.jpg", quality=95)
    small.save(tmp_path / "pictures" / "left.jpg", quality=95)
    ImageOps.mirror(small).save(tmp_path / "pictures" / "right.jpg", quality=95)
    for name in FOLDERS:
        (tmp_path / name).mkdir(parents=True)
    for name in FILES:
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).touch()
    (tmp_path / "runs/larecnet/weights.safetensors").symlink_to(packaged("compact"))
    monkeypatch.chdir(tmp_path)
    return tmp_path


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_what_a_page_tells_to_type_works(page, place):
    names: dict[str, Any] = {"__name__": "__main__"}
    for block in blocks(page):
        where = f"{page.name}, line {block.line}"
        assert block.language in LANGUAGES, where
        if block.language == "python":
            exec(compile("\n" * block.line + block.code, str(page), "exec"), names)
        elif block.language == "sh":
            for words in command_lines(block.code):
                follow(words, where)


def command_lines(code: str) -> Iterator[list[str]]:
    """The words of each command, comments left out and continued lines put together."""
    for line in code.replace("\\\n", " ").splitlines():
        words = shlex.split(line, comments=True)
        if words:
            yield words


def follow(words: list[str], where: str) -> None:
    """Run a command or check it as far as that can be done quickly."""
    program = words[0].removeprefix(".venv/bin/")
    assert program in PROGRAMS, f"{where}: {program} is not known to this test"
    PROGRAMS[program](words[1:], where)


def _ours(words: list[str], where: str) -> None:
    if words[0] in QUICK:
        assert run(words) == 0, f"{where}: {words}"
    elif words != ["--version"]:
        _parse(straightlens, "straightlens", words)


def _parse(command: click.Command, name: str, words: list[str]) -> None:
    """Let the real parser read the words, down to the command they name."""
    context = command.make_context(name, list(words))
    if isinstance(command, click.Group):
        _, found, rest = command.resolve_command(context, words)
        assert found is not None
        _parse(found, words[0], rest)


def _make(words: list[str], where: str) -> None:
    targets = re.findall(r"^([\w-]+):", (ROOT / "Makefile").read_text(), re.MULTILINE)
    assert {word for word in words if "=" not in word} <= set(targets), where


def _pip(words: list[str], where: str) -> None:
    assert words[0] == "install", where
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    for extras in re.findall(r"\[(.+)\]", " ".join(words)):
        assert set(extras.split(",")) <= set(project["optional-dependencies"]), where


def _python(words: list[str], where: str) -> None:
    if words[0] == "-m":
        assert words[1] in sys.stdlib_module_names or (ROOT / words[1]).is_dir(), where
    else:
        assert (ROOT / words[0]).is_file(), where


PROGRAMS: dict[str, Callable[[list[str], str], None]] = {
    "straightlens": _ours,
    "make": _make,
    "pip": _pip,
    "python": _python,
}


def test_links_between_pages_lead_somewhere():
    for page in PAGES:
        text = re.sub(FENCE, "", page.read_text(encoding="utf-8"))
        for target in re.findall(r"\]\(([^)#\s]+)", text):
            if "://" not in target:
                assert (page.parent / target).exists(), f"{page.name}: {target}"


def test_help_in_the_pages_is_of_commands_that_exist():
    for page in PAGES:
        for name in re.findall(r"<!-- help ([a-z ]+) -->", page.read_text(encoding="utf-8")):
            _parse_help(name.split())


def _parse_help(words: list[str]) -> None:
    command: click.Command | None = straightlens
    context = click.Context(straightlens)
    for word in words:
        assert isinstance(command, click.Group)
        command = command.get_command(context, word)
        assert command is not None, words


def test_the_pictures_of_the_pages_are_of_moderate_size():
    sizes = [path.stat().st_size for path in (ROOT / "docs" / "pictures").iterdir()]
    assert np.max(sizes) < 400_000
