from __future__ import annotations

import io

import pytest

from pipeline_tracker.simulation.render_progress import RenderProgress, speed_line


@pytest.mark.parametrize(
    ("pairs", "seconds", "line"),
    [
        (20, 41.2, "20 pairs in 41 s, 2.1 s a pair"),
        (1, 3.04, "1 pair in 3 s, 3.0 s a pair"),
        (80, 95.9, "80 pairs in 96 s, 1.2 s a pair"),
    ],
)
def test_the_speed_in_words(pairs: int, seconds: float, line: str) -> None:
    assert speed_line(pairs, seconds) == line


def test_the_last_line_tells_the_speed() -> None:
    stream, times = io.StringIO(), iter([10.0, 51.2])
    with RenderProgress(2, stream, lambda: next(times)) as progress:
        progress.advance()
        assert stream.getvalue() == ""
        progress.advance()
    assert stream.getvalue() == "2 pairs in 41 s, 20.6 s a pair\n"


def test_a_run_that_did_not_end_tells_no_speed() -> None:
    stream = io.StringIO()
    with RenderProgress(2, stream) as progress:
        progress.advance()
    assert stream.getvalue() == ""


class Terminal(io.StringIO):
    def isatty(self) -> bool:
        return True


def test_a_terminal_shows_a_bar() -> None:
    stream = Terminal()
    with RenderProgress(2, stream) as progress:
        progress.advance()
        progress.advance()
    assert "2/2" in stream.getvalue()
    assert "rendering" in stream.getvalue()
    assert "a pair" in stream.getvalue().splitlines()[-1]


def test_nowhere_is_silent(capsys: pytest.CaptureFixture[str]) -> None:
    with RenderProgress(1, None) as progress:
        progress.advance()
    captured = capsys.readouterr()
    assert captured.out + captured.err == ""
