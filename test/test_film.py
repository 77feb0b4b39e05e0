"""Overlay films: the right frames, drawn where they were found, in a file that browsers play."""

from __future__ import annotations

import io
import shutil
import sys
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
from bag_maker import SECOND, Sea, write_bag
from stand_in import StandIn

from pipeline_tracker.cli import run_command
from pipeline_tracker.errors import PipelineTrackerError
from pipeline_tracker.replay import replay
from pipeline_tracker.replay.film import Cut, write_film
from pipeline_tracker.replay.results import BAG_KEY
from pipeline_tracker.report.overlay import _LEFT_CONTOUR
from pipeline_tracker.settings_io import settings_from_values

SEA = Sea(frames=6, encoding="png", level=lambda i: 120 + 20 * i)


def replayed(bag: Path, output: Path, **settings: object) -> Path:
    values = {"pipe.diameter": 0.6, **settings}
    stream = io.StringIO()
    made = settings_from_values(values)
    return replay(bag, made, output, stream=stream, make_pipeline=StandIn).output


@pytest.fixture(scope="module")
def place(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A directory with a bag and its replay."""
    place = tmp_path_factory.mktemp("film")
    replayed(write_bag(place / "bag", SEA.items()), place / "out")
    return place


def film(directory: Path, output: Path, cut: Cut = Cut(), **options: object) -> str:  # noqa: B008
    return write_film(directory, output, cut, stream=io.StringIO(), **options).in_words()  # type: ignore[arg-type]


def test_pictures_are_those_of_the_frames(place: Path, tmp_path: Path) -> None:
    said = film(place / "out", tmp_path / "all")
    assert said == f"written to {tmp_path / 'all'}: 6 pictures, PNG files"
    picture = cv2.imread(str(tmp_path / "all" / "000002.png"))
    assert picture.shape == (48, 128, 3), "both images"
    assert tuple(picture[44, 10]) == _LEFT_CONTOUR, "the stand-in has found it there"
    assert sorted(p.name for p in (tmp_path / "all").iterdir()) == [
        f"{i:06d}.png" for i in range(6)
    ]


@pytest.mark.parametrize(
    ("cut", "wanted"),
    [
        (Cut(every=2), [0, 2, 4]),
        (Cut(start=1.0, end=2.0), [2, 3, 4]),
        (Cut(every=3, start=1.0), [3]),
        (Cut(end=0.4), [0]),
    ],
)
def test_cut(cut: Cut, wanted: list[int], place: Path, tmp_path: Path) -> None:
    film(place / "out", tmp_path / "all")
    film(place / "out", tmp_path / "some", cut)
    everything = sorted((tmp_path / "all").iterdir())
    some = sorted((tmp_path / "some").iterdir())
    assert [p.read_bytes() for p in some] == [everything[i].read_bytes() for i in wanted]


def test_film_is_h264_that_browsers_play(place: Path, tmp_path: Path) -> None:
    av = pytest.importorskip("av")
    path = tmp_path / "new" / "film.mp4"
    assert film(place / "out", path, Cut(rate=4.0)) == f"written to {path}: 6 pictures, H.264"
    with av.open(str(path)) as container:
        (stream,) = container.streams
        assert (stream.codec_context.name, stream.codec_context.pix_fmt) == ("h264", "yuv420p")
        assert (stream.average_rate, stream.width, stream.height) == (4, 128, 48)
        pictures = [frame.to_ndarray(format="bgr24") for frame in container.decode(stream)]
    film(place / "out", tmp_path / "png")
    drawn = [cv2.imread(str(path)).astype(float) for path in sorted((tmp_path / "png").iterdir())]
    apart = np.array([[np.abs(p - d).mean() for d in drawn] for p in pictures])
    assert apart.shape == (6, 6)
    assert list(apart.argmin(axis=1)) == list(range(6)), "in the order of the frames"
    data = path.read_bytes()
    assert data.index(b"moov") < data.index(b"mdat"), "it plays before all of it is there"


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="Linux's full disk")
def test_full_disk_is_one_line(place: Path, tmp_path: Path) -> None:
    pytest.importorskip("av")
    (tmp_path / "film.mp4").symlink_to("/dev/full")
    with pytest.raises(PipelineTrackerError, match=r"cannot be written .No space left"):
        film(place / "out", tmp_path / "film.mp4", force=True)


def test_film_without_pyav_is_vp9(
    place: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "av", None)
    path = tmp_path / "film.mp4"
    assert film(place / "out", path).endswith("6 pictures, VP9")
    capture = cv2.VideoCapture(str(path))
    assert [capture.read()[0] for _ in range(7)] == [True] * 6 + [False]


def test_film_says_what_is_missing_where_nothing_can_encode(
    place: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "av", None)
    monkeypatch.setattr(cv2.VideoWriter, "fourcc", lambda *_: 0x20202020)
    with pytest.raises(PipelineTrackerError, match=r"pip install '\.\[video\]'"):
        film(place / "out", tmp_path / "film.mp4")


def test_odd_sizes_and_mono_fit(tmp_path: Path) -> None:
    sea = Sea(frames=2, size=(65, 49), sides=("left",))
    out = replayed(write_bag(tmp_path / "bag", sea.items()), tmp_path / "out", mode="mono")
    assert film(out, tmp_path / "film.mp4").startswith(f"written to {tmp_path}")
    capture = cv2.VideoCapture(str(tmp_path / "film.mp4"))
    assert capture.read()[1].shape == (48, 64, 3)


def test_frames_without_images_are_left_out_and_told(tmp_path: Path) -> None:
    items = [i for i in SEA.items() if not (i.log_ns == SEA.stamp(2) and "right/image" in i.topic)]
    out = replayed(write_bag(tmp_path / "bag", items), tmp_path / "out")
    said = film(out, tmp_path / "png")
    assert said.endswith("5 pictures, PNG files; 1 frame without images or result left out")


def test_clocks_that_were_set_back(tmp_path: Path) -> None:
    later = replace(SEA, frames=3, static=False)
    items = [*SEA.items()]
    for item in later.items():
        moved = item.message
        moved.header.stamp.sec -= 100
        items.append(type(item)(item.topic, item.type_name, item.log_ns + 100 * SECOND, moved))
    out = replayed(write_bag(tmp_path / "bag", items), tmp_path / "out")
    assert film(out, tmp_path / "png").endswith("9 pictures, PNG files")


def test_a_moved_bag_is_named(place: Path, tmp_path: Path) -> None:
    shutil.copytree(place / "out", tmp_path / "out")
    metadata = tmp_path / "out" / "result" / "metadata.yaml"
    text = metadata.read_text()
    assert f"{BAG_KEY}:" in text
    assert str(place / "bag") in text
    metadata.write_text(text.replace(str(place / "bag"), str(tmp_path / "gone")))
    with pytest.raises(PipelineTrackerError, match="no longer there; name it with --bag"):
        film(tmp_path / "out", tmp_path / "png")
    metadata.write_text(text.replace(BAG_KEY, "other"))
    with pytest.raises(PipelineTrackerError, match="does not say which bag was replayed"):
        film(tmp_path / "out", tmp_path / "png")
    assert "6 pictures" in film(tmp_path / "out", tmp_path / "png", bag=place / "bag")


def test_another_bag_is_refused(place: Path, tmp_path: Path) -> None:
    items = [*SEA.items()]
    for item in items:
        if hasattr(item.message, "header"):
            item.message.header.stamp.sec += 1000
    other = write_bag(tmp_path / "other", items)
    with pytest.raises(PipelineTrackerError, match="none of its frames"):
        film(place / "out", tmp_path / "png", bag=other)
    assert not (tmp_path / "png").exists()
    wide = write_bag(tmp_path / "wide", replace(SEA, size=(80, 48)).items())
    with pytest.raises(PipelineTrackerError, match="cameras are not those of the replay"):
        film(place / "out", tmp_path / "png", bag=wide)


def test_what_is_there_is_not_replaced(place: Path, tmp_path: Path) -> None:
    film(place / "out", tmp_path / "png")
    with pytest.raises(PipelineTrackerError, match=r"is there already.*--force"):
        film(place / "out", tmp_path / "png")
    film(place / "out", tmp_path / "png", Cut(every=3), force=True)
    assert len(list((tmp_path / "png").iterdir())) == 2
    (tmp_path / "film.avi").touch()
    with pytest.raises(PipelineTrackerError, match=r"ends with \.mp4"):
        film(place / "out", tmp_path / "film.avi")


@pytest.mark.parametrize(
    ("arguments", "line"),
    [
        (["nothing", "--output", "x.mp4"], "no settings.yaml in it; expected the output"),
        (["out"], "no --output given"),
        (["out", "--output", "x.mp4", "--every", "0"], "--every 0: expected at least 1"),
        (["out", "--output", "x.mp4", "--every", "2.5"], "--every 2.5: expected an integer"),
        (["out", "--output", "x.mp4", "--rate", "nan"], "--rate nan: expected 0.1 to 240"),
        (["out", "--output", "x.mp4", "--from", "-1"], "--from -1: expected at least 0"),
        (["out", "--output", "x.mp4", "--from", "2", "--to", "1"], "--to 1: expected at least 2"),
        (["out", "--output", "x.mp4", "--to", "nan"], "--to nan: expected at least 0"),
        (["out", "--output", "out/estimates.csv/x.mp4"], "cannot be written"),
    ],
)
def test_wrong_commands(
    arguments: list[str],
    line: str,
    place: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.chdir(place)
    assert run_command(["overlay", *arguments]) == 2
    said = capsys.readouterr().err
    assert line in said
    assert said.count("\n") == 1


def test_command(
    place: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.chdir(place)
    target = str(tmp_path / "png")
    arguments = ["--every", "2", "--from", "1", "--to", "2", "--rate", "5", "--bag", "bag"]
    assert run_command(["overlay", "out", "--output", target, *arguments, "--force"]) == 0
    assert capsys.readouterr().out == f"written to {target}: 2 pictures, PNG files\n"
