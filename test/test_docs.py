"""The documentation: its commands, its links, and the site."""

from __future__ import annotations

import re
import shlex
import subprocess
import sys
from importlib.util import find_spec
from pathlib import Path

import pytest
import typer

from pipeline_tracker import cli

ROOT = Path(__file__).resolve().parent.parent
PAGES = [
    ROOT / "README.md",
    *sorted((ROOT / "docs").glob("*.md")),
    *sorted((ROOT / "examples").glob("*.md")),
]
# A block of commands, with the comment before it that says why a test does not run it.
_BLOCK = re.compile(
    r"^(?P<mark> *<!-- [^>]*-->\n)?(?P<indent> *)```bash\n(?P<text>.*?)^ *```",
    re.MULTILINE | re.DOTALL,
)
_INLINE = re.compile(r"`(pipeline-tracker [a-z][^`]*)`")


def blocks(page: Path) -> list[tuple[str, str]]:
    """Return the comment before and the text of each block of commands."""
    text = page.read_text(encoding="utf-8")
    return [(found["mark"] or "", found["text"]) for found in _BLOCK.finditer(text)]


def commands_of(page: Path) -> list[list[str]]:
    """Return all our own commands of a page, in blocks and in lines, as words."""
    lines = [line for _, text in blocks(page) for line in text.splitlines()]
    lines += _INLINE.findall(page.read_text(encoding="utf-8"))
    found = []
    for line in lines:
        for part in re.split(r"&&|;", line):
            words = shlex.split(part, comments=True)
            if words and words[0].rsplit("/", 1)[-1] == "pipeline-tracker":
                found.append(words[1:])
    return found


ALL = [(page.name, words) for page in PAGES for words in commands_of(page)]


def test_there_are_commands_to_look_at() -> None:
    assert len(ALL) > 25


@pytest.mark.parametrize(("page", "words"), ALL, ids=lambda value: str(value)[:60])
def test_every_command_is_understood(page: str, words: list[str]) -> None:
    """Parsed as the command line does, and not run: unknown commands and options are refused."""
    if "…" in words or (len(words) == 1 and not words[0].startswith("-")):
        # A command that is named, not shown.
        known = {command.callback.__name__ for command in cli.app.registered_commands}
        assert words[0] in known, page
        return
    command = typer.main.get_command(cli.app)
    task = command.main(
        cli._guard_ros_args(words), prog_name="pipeline-tracker", standalone_mode=False
    )
    assert callable(task) or task in {None, 0}, page


def test_blocks_that_are_not_run_say_why() -> None:
    for page in PAGES:
        for mark, _ in blocks(page):
            assert not mark or "not run" in mark or "-command" in mark, (page.name, mark)


@pytest.fixture(scope="module")
def place(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A directory where the pages' commands find what they name."""
    directory = tmp_path_factory.mktemp("newcomer")
    (directory / "bags").mkdir()
    (directory / "bags" / "demo").symlink_to(ROOT / "bags" / "demo")
    (directory / "config").symlink_to(ROOT / "config")
    return directory


@pytest.mark.parametrize("page", ["index.md", "camera.md", "method.md"])
def test_a_newcomer_s_commands_work(
    page: str, place: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    """Run as they stand, one after the other; `doctor` may find fault with this machine."""
    monkeypatch.chdir(place)
    texts = [text for mark, text in blocks(ROOT / "docs" / page) if "not run" not in mark]
    assert texts
    for line in "".join(texts).splitlines():
        words = shlex.split(line)
        assert words[0] == "pipeline-tracker", page
        expected = {0, 1} if words[1] == "doctor" else {0}
        assert cli.run_command(words[1:]) in expected, (line, *capfd.readouterr())


def test_links_lead_to_files() -> None:
    for page in PAGES:
        text = page.read_text(encoding="utf-8")
        for target in re.findall(r"\]\(([^)#:\s]+)(?:#[^)]*)?\)", text):
            made = page.parent.name == "docs" and target == "reference.md"
            assert made or (page.parent / target).exists(), (page.name, target)


@pytest.mark.skipif(find_spec("mkdocs") is None, reason="the extra [docs] is not installed")
def test_the_site_is_built_without_a_warning(tmp_path: Path) -> None:
    command = [sys.executable, "-m", "mkdocs", "build", "--strict", "-d", str(tmp_path / "site")]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    assert "WARNING -" not in done.stderr
    page = (tmp_path / "site" / "reference.html").read_text(encoding="utf-8")
    for word in (
        "pipe.diameter",
        "heading_misalignment",
        "pipeline/relative_state",
        "min_distance",
    ):
        assert word in page
    assert "set_reference" in page
    assert "change_state" not in page, "what all nodes have is left out"
    # Nothing is fetched from elsewhere by the page itself.
    assert not re.findall(r'(?:src|href)="https?://[^"]+\.(?:js|css|woff2?)"', page)
