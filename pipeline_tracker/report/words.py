"""The summary of a report: how much was followed, how well, where it was lost and why."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from statistics import median

from pipeline_tracker.report.reasons import count, in_words, parts_of
from pipeline_tracker.report.record import Record, seconds_of
from pipeline_tracker.report.stretches import Course, Lie, Stretch

# So many stretches without the pipe are told one by one.
_TOLD = 4
_LIES = {
    Lie.FREE_SPAN: "spans freely over",
    Lie.ON_BED: "rests on the bed over",
    Lie.PARTLY_BURIED: "is partly buried over",
    Lie.MORE_THAN_HALF_BURIED: "is more than half buried over",
}


def summary(record: Record) -> list[str]:
    """Return the summary as sentences, the most important first."""
    if not record.rows:
        return ["No frame was processed.", *_about_end(record)]
    return [
        _how_much(record),
        *_where_lost(record),
        *_how_well(record),
        *_how_it_lies(record),
        *_about_mode(record),
        *_about_end(record),
    ]


def notes(record: Record) -> list[str]:
    """Return what the replay itself had to say beside that, each with a capital."""
    said = record.facts.notes if record.facts else []
    return [line[:1].upper() + line[1:] + "." for line in said]


def followed_length(stretches: Sequence[Stretch]) -> float | None:
    """Return the length of pipe that was followed, m; None where no chainage is known."""
    lengths = [s.length for s in stretches if s.course is Course.FOLLOWED and s.length is not None]
    return sum(lengths) if lengths else None


def why(stretch: Stretch, most: int = 3) -> str:
    """Return the reasons of a stretch in words."""
    told = [
        in_words(reason) + (f" ({n})" if len(stretch.reasons) > 1 else "")
        for reason, n in stretch.reasons[:most]
    ]
    further = len(stretch.reasons) - most
    return "; ".join(told) + (f"; and {count(further, 'further reason')}" if further > 0 else "")


def _how_much(record: Record) -> str:
    rows = record.rows
    valid = sum(row["valid"] == "1" for row in rows)
    if not valid:
        return f"The pipe was not found in {_any(len(rows))}."
    share = 100.0 * valid / len(rows)
    text = f"The pipe was followed in {valid} of {count(len(rows), 'frame')} ({_percent(share)})"
    length = followed_length(record.stretches)
    if length:
        text += f", over {length:.1f} m of its length"
    duration = seconds_of(record, int(rows[-1]["stamp_ns"]))
    return text + (f", in {_duration(duration)}." if duration > 0.0 else ".")


def _how_well(record: Record) -> list[str]:
    states = [state for state in record.states.values() if state.valid]
    sentences = []
    if states:
        worst = min(states, key=lambda state: state.quality)
        text = "Of what the pipe should show in the pictures (contours, surface), "
        text += f"{100.0 * median(s.quality for s in states):.0f} % was found in the median frame"
        if len(states) > 1:
            text += f" and {100.0 * worst.quality:.0f} % in the worst (at "
            text += f"{seconds_of(record, worst.stamp_ns):.1f} s)"
        sentences.append(text + ": the quality.")
    valid = {int(row["stamp_ns"]) for row in record.rows if row["valid"] == "1"}
    sigmas = [
        (place.sigma_left, place.sigma_up)
        for stamp, place in record.placed.items()
        if stamp in valid and place.sigma_left is not None and place.sigma_up is not None
    ]
    if sigmas:
        left, up = (median(pair[k] for pair in sigmas) for k in (0, 1))
        sentences.append(
            f"Relative to the vehicle the axis is known to {_length(left)} across and "
            f"{_length(up)} in height (one standard deviation, median)."
        )
    return sentences


def _where_lost(record: Record) -> list[str]:
    """Say where the pipe was not followed, the longest stretches first."""
    if not any(row["valid"] == "1" for row in record.rows):
        return _why_never(record)
    said, gaps = [], _gaps(record.stretches)
    if gaps and gaps[0][0].first == 0:
        gap = gaps.pop(0)
        found = gap[-1].last + 1
        time = seconds_of(record, int(record.rows[found]["stamp_ns"]))
        said.append(f"It was found in frame {found + 1} ({time:.1f} s), not before{_told(gap)}.")
    if not gaps:
        return [*said, "It was never lost after that." if said else "It was never lost."]
    longest = sorted(gaps, key=lambda gap: -sum(s.frames for s in gap))
    shown = sorted(longest[:_TOLD], key=lambda gap: gap[0].first)
    frames = sum(s.frames for gap in gaps for s in gap)
    text = "It was lost once"
    if len(gaps) > 1:
        text = f"It was lost {len(gaps)} times, for {count(frames, 'frame')} in all"
    if len(gaps) > _TOLD:
        text += f"; the {_TOLD} longest"
    return [*said, f"{text}: {'; '.join(_gap(record, gap) for gap in shown)}."]


def _why_never(record: Record) -> list[str]:
    reasons = Counter(row["reason"] for row in record.rows if row["reason"])
    told = [f"{in_words(reason)} ({count(n, 'frame')})" for reason, n in reasons.most_common(3)]
    sentences = [f"Why: {'; '.join(told)}."] if told else []
    advice = (
        "Is there a pipe in the pictures below, and is pipe.diameter "
        f"({record.settings.pipe.diameter:g} m) right?"
    )
    return [*sentences, advice]


def _gaps(stretches: Sequence[Stretch]) -> list[list[Stretch]]:
    """Put stretches together that lie between two that were followed."""
    gaps: list[list[Stretch]] = []
    fresh = True
    for stretch in stretches:
        if stretch.course is Course.FOLLOWED:
            fresh = True
        elif fresh:
            gaps.append([stretch])
            fresh = False
        else:
            gaps[-1].append(stretch)
    return gaps


def _gap(record: Record, gap: Sequence[Stretch]) -> str:
    frames = sum(s.frames for s in gap)
    text = f"at {seconds_of(record, gap[0].start_ns):.1f} s"
    start, end = gap[0].chainage_from, gap[-1].chainage_to
    if start is not None:
        text += f", chainage {start:.1f} m"
    over = [count(frames, "frame")]
    if start is not None and end is not None:
        over.append(f"{abs(end - start):.1f} m")
    text += f", for {', '.join(over)}"
    return text + _told(gap)


def _told(gap: Sequence[Stretch]) -> str:
    reasons: Counter[str] = Counter()
    for stretch in gap:
        for reason, frames in stretch.reasons:
            reasons.update(dict.fromkeys(parts_of(reason), frames))
    told = "; ".join(in_words(reason) for reason, _ in reasons.most_common(2))
    return f" ({told})" if told else ""


def _how_it_lies(record: Record) -> list[str]:
    lengths: dict[Lie, float] = {}
    for stretch in record.stretches:
        if stretch.course is Course.FOLLOWED and stretch.length:
            lengths[stretch.lie] = lengths.get(stretch.lie, 0.0) + stretch.length
    parts = [f"{words} {lengths[lie]:.1f} m" for lie, words in _LIES.items() if lie in lengths]
    if not parts:
        return []
    unknown = lengths.get(Lie.NOT_KNOWN)
    rest = f"; not known over {unknown:.1f} m" if unknown else ""
    told = " and ".join(filter(None, (", ".join(parts[:-1]), parts[-1])))
    return [f"As far as the bed beside it tells, the pipe {told}{rest}."]


def _about_mode(record: Record) -> list[str]:
    said = []
    if record.settings.mode == "mono":
        said.append("One camera was used: distances come from the pipe's width and the echoes.")
    if record.settings.recognition.only:
        said.append("Each frame was recognised by itself, as asked: nothing was tracked.")
    elif not record.poses and any(row["state"] for row in record.rows):
        said.append(
            "There are no poses of the vehicle: each frame stands alone, and where the pipe runs "
            "and how long it is are not known."
        )
    return said


def _about_end(record: Record) -> list[str]:
    facts, rows = record.facts, len(record.rows)
    if facts is None:
        return ["The replay was cut off before its end; this is what it had written."]
    if facts.damage:
        return [f"The replay ended early: {facts.damage.rstrip('.')}."]
    if facts.interrupted:
        return [f"The replay was interrupted after {rows} of {facts.frames_expected} frames."]
    return []


def _any(frames: int) -> str:
    return "the only frame" if frames == 1 else f"any of {frames} frames"


def _percent(share: float) -> str:
    # What is not the whole is not told as the whole.
    if 99.5 <= share < 100.0:
        return f"{min(share, 99.9):.1f} %"
    return "less than 1 %" if 0.0 < share < 1.0 else f"{share:.0f} %"


def _duration(seconds: float) -> str:
    if seconds < 120.0:
        return f"{seconds:.1f} s"
    minutes = round(seconds / 60.0)
    return f"{minutes} min" if minutes < 120 else f"{minutes // 60} h {minutes % 60} min"


def _length(metres: float) -> str:
    """Say a standard deviation: millimetres to a digit, as it never is nothing."""
    if metres < 0.01:
        return f"{max(1000.0 * metres, 0.1):.1f} mm"
    return f"{100.0 * metres:.1f} cm" if metres < 1.0 else f"{metres:.1f} m"
