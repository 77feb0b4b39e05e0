"""How far a benchmark is: a bar on a terminal, and a line for each task that has ended."""

from __future__ import annotations

from types import TracebackType

from rich.console import Console
from rich.progress import (
    BarColumn,
    MofNCompleteColumn,
    Progress,
    TextColumn,
    TimeElapsedColumn,
    TimeRemainingColumn,
)
from typing_extensions import Self

from pipeline_tracker.benchmark.engine import Engine, Task
from pipeline_tracker.benchmark.plan import Plan
from pipeline_tracker.benchmark.work import Outcome


class BenchmarkProgress:
    """Tells what is done; a context manager.

    Attributes:
        details: tracebacks of failures that should not have happened, each with its task.
    """

    def __init__(self, plan: Plan, engine: Engine, console: Console) -> None:
        """Begin.

        Args:
            plan: all tasks.
            engine: knows what is left to do of them.
            console: where to write.
        """
        self.details: list[str] = []
        self._console = console
        self._before = len(plan.runs) - len(engine.todo)
        self._runs, self._seas = len(plan.runs), len(engine.seas)
        self._total = len(engine.todo) + len(engine.seas)
        self._ended = 0
        self._bar = Progress(
            TextColumn("benchmark"),
            BarColumn(),
            MofNCompleteColumn(),
            TextColumn("tasks"),
            TimeElapsedColumn(),
            TimeRemainingColumn(),
            console=console,
            transient=True,
            disable=not console.is_terminal,
        )
        self._task = self._bar.add_task("", total=self._total)

    def __enter__(self) -> Self:
        """Say what there is to do, and show the bar."""
        self._say(
            f"runs: {self._runs}, done before: {self._before}, "
            f"to do: {self._runs - self._before}; seas to simulate: {self._seas}"
        )
        self._bar.start()
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        value: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        """Take the bar away."""
        self._bar.stop()

    def start(self, workers: int) -> None:
        """Say who does it."""
        if not workers:
            self._say("the cluster has no workers yet; waiting for some")

    def told(self, task: Task, outcome: Outcome) -> None:
        """Tell of a task that has ended."""
        self._ended += 1
        what = f"failed: {outcome.reason}" if outcome.reason else f"{outcome.seconds:.1f} s"
        where = f" ({outcome.where})" if outcome.where else ""
        self._say(f"{self._ended} of {self._total}  {task.label}: {what}{where}")
        if outcome.details:
            self.details.append(f"{task.label}{where}\n{outcome.details}")
        self._bar.advance(self._task)

    def _say(self, text: str) -> None:
        self._console.print(text, highlight=False, markup=False, soft_wrap=True)
