"""A replay that was broken off anywhere goes on, and gives what an unbroken one gives."""

from __future__ import annotations

import csv
import io
import os
import resource
import shutil
import signal
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from bag_maker import SECOND, Item, Sea, mcap_of, picture, raw_image, write_bag
from stand_in import StandIn

from pipeline_tracker.bags.reader import BagReader
from pipeline_tracker.bags.salvage import salvage
from pipeline_tracker.cli import run_command
from pipeline_tracker.errors import BagError, PipelineTrackerError
from pipeline_tracker.replay import ReplayOutcome, replay
from pipeline_tracker.replay.estimates import EstimatesFile
from pipeline_tracker.replay.record import RECORD
from pipeline_tracker.settings_io import settings_from_values

FRAMES = 12


@pytest.fixture(autouse=True)
def _save_at_once(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("pipeline_tracker.replay.runner._SAVE_EVERY", 0.0)


class Run:
    """A replay with the stand-in."""

    def __init__(
        self, bag: Path, output: Path, at: dict[int, Callable[[], None]] | None = None, **given: Any
    ) -> None:
        self.bag, self.output = bag, output
        values = {"pipe.diameter": 0.6, **given.pop("settings", {})}
        self.pipeline: StandIn | None = None

        def make(*arguments: Any) -> StandIn:
            self.pipeline = StandIn(*arguments)
            self.pipeline.before = lambda index: (at or {}).get(index, lambda: None)()
            return self.pipeline

        self.outcome: ReplayOutcome = replay(
            bag,
            settings_from_values(values),
            output,
            stream=io.StringIO(),
            make_pipeline=make,
            **given,
        )

    @property
    def vectorized(self) -> int:
        """How many frames were vectorized, not taken over."""
        return 0 if self.pipeline is None else len(self.pipeline.levels)


def rows(output: Path) -> list[list[str]]:
    """Return the table without the times."""
    with (output / "estimates.csv").open(newline="") as file:
        return [[*row[:-3], *row[-2:]] for row in csv.reader(file)]


def content(bag: Path) -> list[tuple[str, int, bytes]]:
    with BagReader(bag) as reader:
        return [(r.topic, r.log_ns, r.raw) for r in reader.records(reader.topics)]


def check_same(one: Run, other: Run) -> None:
    """Check that nothing tells a resumed replay from an unbroken one."""
    assert rows(one.output) == rows(other.output)
    assert content(one.output / "result") == content(other.output / "result")
    names = {file.name for file in one.output.iterdir()}
    assert names == {file.name for file in other.output.iterdir()}
    for name in (*(n for n in names if n.endswith(".png")), "settings.yaml", RECORD):
        assert (one.output / name).read_bytes() == (other.output / name).read_bytes(), name
    here, there = one.outcome.summary, other.outcome.summary
    for name in ("frames", "valid", "lost", "states", "modes", "stretches", "distance_along"):
        assert getattr(here, name) == getattr(there, name), name


def difficult_sea() -> list[Item]:
    """Frames without a pipe, images that are lost, late or corrupt, and clocks set back."""
    sea = Sea(frames=FRAMES, level=lambda i: 50 if i in {3, 8} else 150 + i)
    items = list(sea.items())

    def right(item: Item, index: int) -> bool:
        return item.topic == "/stereo/right/image_rect" and item.log_ns == sea.stamp(index)

    items = [item for item in items if not right(item, 5)]
    items = [replace(item, message=b"\0\1\0\0") if right(item, 9) else item for item in items]
    late = replace(sea.image("left", 6), log_ns=sea.stamp(7))
    items.append(replace(late, message=raw_image(sea.stamp(6) + 1000, picture(150))))
    items.sort(key=lambda item: item.log_ns)
    again = [replace(item, log_ns=item.log_ns + 60 * SECOND) for item in Sea(frames=3).items()]
    return [*items, *again]


@pytest.fixture(scope="module")
def bag(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_bag(tmp_path_factory.mktemp("sea") / "bag", difficult_sea())


@pytest.fixture(scope="module")
def unbroken(bag: Path, tmp_path_factory: pytest.TempPathFactory) -> Run:
    done = Run(bag, tmp_path_factory.mktemp("unbroken") / "out")
    assert done.outcome.summary.lost == 3
    return done


def snapshot(source: Path, target: Path) -> Callable[[], None]:
    """Copy what is on the disk, as a kill would leave it."""
    return lambda: shutil.copytree(source, target)


@pytest.fixture(scope="module")
def kills(bag: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """What a replay that is killed before a frame leaves, for each frame."""
    place = tmp_path_factory.mktemp("kills")
    output = place / "out"
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("pipeline_tracker.replay.runner._SAVE_EVERY", 0.0)
        Run(bag, output, {k: snapshot(output, place / str(k)) for k in range(FRAMES + 1)})
    return place


@pytest.fixture
def killed(kills: Path, tmp_path: Path) -> Callable[[int], Path]:
    return lambda index: shutil.copytree(kills / str(index), tmp_path / f"killed_{index}")


Killed = Callable[[int], Path]


@pytest.mark.parametrize("index", [0, 1, 4, 7, 9, 12])
def test_resumed_at_any_frame(bag: Path, unbroken: Run, killed: Killed, index: int) -> None:
    left = killed(index)
    resumed = Run(bag, left, resume=True)
    check_same(resumed, unbroken)
    # All but what the last second of stamps holds was there.
    taken_over = resumed.outcome.summary.taken_over
    assert taken_over == unbroken.vectorized - resumed.vectorized >= index - 6
    assert ("resumed: " in resumed.outcome.text) == (taken_over > 0)


def test_a_kill_costs_the_last_second(unbroken: Run, killed: Killed, tmp_path: Path) -> None:
    left = killed(9)
    there = rows(left)
    assert there == rows(unbroken.output)[: len(there)]
    newest = int(there[-1][0])
    assert Sea().stamp(8) - newest <= 2 * SECOND
    report = salvage(left / "result", tmp_path / "saved")
    (saved,) = [t.saved for t in report.topics if t.name == "/pipeline/relative_state"]
    assert saved == 9, "every frame before"


def test_killed_again_while_it_catches_up(
    bag: Path, unbroken: Run, killed: Killed, tmp_path: Path
) -> None:
    left, again = killed(11), tmp_path / "again"
    before = rows(left)
    Run(bag, left, {3: snapshot(left, again)}, resume=True)
    assert rows(again) == before, "nothing is lost a second time"
    resumed = Run(bag, again, resume=True)
    check_same(resumed, unbroken)
    assert resumed.outcome.summary.taken_over >= 5


def test_killed_again_when_it_has_caught_up(
    bag: Path, unbroken: Run, killed: Killed, tmp_path: Path
) -> None:
    left, again = killed(6), tmp_path / "again"
    Run(bag, left, {10: snapshot(left, again)}, resume=True)
    resumed = Run(bag, again, resume=True)
    check_same(resumed, unbroken)
    assert resumed.outcome.summary.taken_over >= 4


def test_interrupted_and_resumed(bag: Path, unbroken: Run, tmp_path: Path) -> None:
    def interrupt() -> None:
        os.kill(os.getpid(), signal.SIGINT)

    first = Run(bag, tmp_path / "out", {6: interrupt})
    assert first.outcome.summary.interrupted
    assert f"--output {tmp_path / 'out'} --resume" in first.outcome.text
    # Interrupted once more before it has caught up.
    second = Run(bag, tmp_path / "out", {2: interrupt}, resume=True)
    assert second.outcome.summary.frames == 3
    assert len(rows(tmp_path / "out")) > 5, "earlier rows are kept"
    check_same(Run(bag, tmp_path / "out", resume=True), unbroken)


@pytest.mark.parametrize("torn", [b"171000", b"\0" * 500, b"171000,tracking,1,,\n", b"\xff\xfe\n"])
def test_what_is_no_row_counts_for_nothing(
    bag: Path, unbroken: Run, killed: Killed, torn: bytes
) -> None:
    left = killed(9)
    with (left / "estimates.csv").open("ab") as file:
        file.write(torn)
    check_same(Run(bag, left, resume=True), unbroken)


@pytest.mark.parametrize("file", ["estimates.csv", "result", "settings.yaml"])
def test_resumed_without_one_of_its_files(
    bag: Path, unbroken: Run, killed: Killed, file: str
) -> None:
    left = killed(7)
    if file == "settings.yaml":
        # Nothing else is written before it.
        for path in left.iterdir():
            shutil.rmtree(path) if path.is_dir() else path.name == RECORD or path.unlink()
    elif file == "result":
        shutil.rmtree(left / file)
    else:
        (left / file).unlink()
    check_same(Run(bag, left, resume=True), unbroken)


def test_a_damaged_result_bag_is_computed_anew(bag: Path, unbroken: Run, killed: Killed) -> None:
    left = killed(9)
    file = mcap_of(left / "result")
    data = bytearray(file.read_bytes())
    data[len(data) // 3 : len(data) // 2] = bytes(len(data) // 2 - len(data) // 3)
    file.write_bytes(data)
    resumed = Run(bag, left, resume=True)
    check_same(resumed, unbroken)


def test_nothing_there_is_a_replay_from_the_start(bag: Path, unbroken: Run, tmp_path: Path) -> None:
    check_same(Run(bag, tmp_path / "none", resume=True), unbroken)
    (tmp_path / "empty").mkdir()
    check_same(Run(bag, tmp_path / "empty", resume=True), unbroken)


def refusal(bag: Path, output: Path, **given: Any) -> str:
    before = {p: p.stat().st_mtime_ns for p in output.rglob("*")}
    with pytest.raises(PipelineTrackerError) as caught:
        Run(bag, output, resume=True, **given)
    line = str(caught.value)
    assert "\n" not in line
    assert str(output) in line
    assert "--force" in line
    assert before == {p: p.stat().st_mtime_ns for p in output.rglob("*")}, "nothing is touched"
    return line


def test_other_settings_are_refused(bag: Path, killed: Killed) -> None:
    left = killed(5)
    line = refusal(bag, left, settings={"pipe.diameter": 0.7})
    assert "pipe.diameter=0.7, it was 0.6" in line


def test_another_bag_is_refused(bag: Path, killed: Killed, tmp_path: Path) -> None:
    left = killed(5)
    other = write_bag(tmp_path / "other", Sea(frames=FRAMES).items())
    line = refusal(other, left)
    assert "it has another bag (bag)" in line
    # The same bag elsewhere is the same.
    copied = shutil.copytree(bag, tmp_path / "copied")
    assert Run(copied, left, resume=True).outcome.summary.frames == FRAMES + 4


def test_another_version_is_refused(
    bag: Path, killed: Killed, monkeypatch: pytest.MonkeyPatch
) -> None:
    left = killed(5)
    with monkeypatch.context() as patch:
        patch.setattr("pipeline_tracker.replay.record.__version__", "9.9.9")
        assert "version is 9.9.9, and was " in refusal(bag, left)
    with monkeypatch.context() as patch:
        patch.setattr("pipeline_tracker.replay.record.code_hash", lambda _wanted: "other")
        assert "code is other, and was " in refusal(bag, left)


def test_a_directory_of_something_else_is_refused(bag: Path, tmp_path: Path) -> None:
    (tmp_path / "out").mkdir()
    (tmp_path / "out" / "notes.txt").write_text("mine")
    assert "there is no replay to resume in it" in refusal(bag, tmp_path / "out")


@pytest.mark.parametrize("text", ["", "[", "3", "\0", "hash: 1\n", "a: &a [*a]"])
def test_a_damaged_record_is_refused(bag: Path, killed: Killed, text: str) -> None:
    left = killed(5)
    (left / RECORD).write_text(text)
    refusal(bag, left)


def test_rows_that_come_out_otherwise_are_refused(bag: Path, killed: Killed) -> None:
    left = killed(9)
    table = left / "estimates.csv"
    text = table.read_text()
    assert text.count(",1.700000000,") > 5
    table.write_text(text.replace(",1.700000000,", ",1.700000001,", 1))
    with pytest.raises(BagError, match=r"estimates.csv: the row at byte .* begin again with --fo"):
        Run(bag, left, resume=True)
    assert "1.700000001" in table.read_text(), "what was there is kept"


def test_a_replay_that_has_ended(bag: Path, unbroken: Run) -> None:
    before = {p: p.stat().st_mtime_ns for p in unbroken.output.rglob("*")}
    again = Run(bag, unbroken.output, resume=True)
    assert "there is nothing to resume; pipe found in 11 of 16 frames" in again.outcome.text
    assert again.outcome.summary.valid == unbroken.outcome.summary.valid == 11
    assert before == {p: p.stat().st_mtime_ns for p in unbroken.output.rglob("*")}


def test_the_command(
    bag: Path, unbroken: Run, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    arguments = ["replay", str(bag), "--output", str(unbroken.output), "--resume"]
    assert run_command([*arguments, "--force"]) == 2
    assert "--force and --resume: expected one of them" in capsys.readouterr().err
    # Settings need not be given again.
    assert run_command(arguments) == 0
    assert "nothing to resume" in capsys.readouterr().out
    assert run_command([*arguments, "--set", "pipe.diameter=0.7"]) == 2
    assert "pipe.diameter=0.7, it was 0.6" in capsys.readouterr().err
    other = write_bag(tmp_path / "other")
    assert run_command(["replay", str(other), *arguments[2:]]) == 2
    assert "another bag" in capsys.readouterr().err


# A disk that is full.


@contextmanager
def largest_file(size: int) -> Iterator[None]:
    """Let no file grow beyond a size, bytes: writing more fails as on a full disk."""
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (size, before[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)


def test_a_full_disk_is_one_line_and_can_be_gone_on_from(tmp_path: Path) -> None:
    bag = write_bag(tmp_path / "bag", Sea(frames=30).items())
    unbroken = Run(bag, tmp_path / "unbroken")
    output = tmp_path / "out"
    size = mcap_of(unbroken.output / "result").stat().st_size
    with largest_file(size // 2), pytest.raises(BagError) as caught:
        Run(bag, output)
    line = str(caught.value)
    assert line.startswith(f"{output}: cannot be written (File too large); make room there")
    assert "--resume" in line
    there = rows(output)
    assert 5 < len(there) < 30
    assert there == rows(unbroken.output)[: len(there)]
    report = salvage(output / "result", tmp_path / "saved")
    assert not report.notes, "no half chunk is in it"
    assert {t.saved for t in report.topics if t.name == "/pipeline/status"} <= {*range(5, 25)}
    check_same(Run(bag, output, resume=True), unbroken)


def test_no_half_row_is_left(tmp_path: Path) -> None:
    path = tmp_path / "estimates.csv"

    def write() -> None:
        with EstimatesFile(path) as table:
            for k in range(100):
                table.write(0, {"stamp_ns": str(k * SECOND), "reason": "some"})
            table.finish()

    with largest_file(1000), pytest.raises(OSError, match="too large"):
        write()
    text = path.read_text()
    assert text.endswith("\n")
    assert 900 < len(text) <= 1000
