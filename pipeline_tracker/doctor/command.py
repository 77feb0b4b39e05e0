"""The command: look at everything, print it, say how it stands."""

from __future__ import annotations

import json
import sys
from collections.abc import Iterator, Sequence

from rich.console import Console
from rich.text import Text

from pipeline_tracker.doctor import ros, system
from pipeline_tracker.doctor.finding import Finding, examined

_STYLES = {"ok": "green", "look": "yellow", "wrong": "bold red"}


def findings(*, talk: bool = True) -> Iterator[Finding]:
    """Yield what there is to say of this machine, one by one as it is found.

    Args:
        talk: let two processes talk over the middleware, which takes some seconds.
    """
    yield from examined(system.python, "Python")
    yield from examined(system.libraries, "libraries")
    yield from examined(system.kernels, "kernels")
    yield from examined(system.processor, "processor")
    yield from examined(ros.installation, "ROS 2")
    yield from examined(ros.middleware, "middleware")
    yield from examined(ros.shared_memory, "shared memory")
    if talk:
        yield from examined(ros.conversation, "conversation")


def doctor_command(
    console: Console | None = None, *, as_json: bool = False, talk: bool = True
) -> bool:
    """Look at this machine and print what was found.

    Args:
        console: where lines for people are printed; standard output by default.
        as_json: print a JSON list of findings instead of lines for people.
        talk: see ``findings``.

    Returns:
        Whether nothing is wrong.
    """
    seen = []
    # Colours on a terminal alone, and not where NO_COLOR is set: rich sees to both.
    console = console or Console(highlight=False, soft_wrap=True)
    for finding in findings(talk=talk):
        seen.append(finding)
        if not as_json:
            _show(console, finding)
    if as_json:
        sys.stdout.write(json.dumps([finding.as_json() for finding in seen], indent=2) + "\n")
    else:
        console.print(in_words(seen))
    return not any(finding.level == "wrong" for finding in seen)


def _show(console: Console, finding: Finding) -> None:
    line = Text.assemble(
        (f"{finding.level:<6}", _STYLES[finding.level]), f"{finding.what}: {finding.seen}"
    )
    console.print(line)
    if finding.advice:
        console.print(Text(f"      {finding.advice}"))


def in_words(seen: Sequence[Finding]) -> str:
    """Return how it stands, in a line."""
    wrong = sum(finding.level == "wrong" for finding in seen)
    look = sum(finding.level == "look" for finding in seen)
    if wrong:
        return f"{wrong} wrong, {look} to look at; put right what is wrong first"
    return f"nothing wrong, {look} to look at" if look else "nothing wrong"
