"""All tasks of a plan: what is there is left, the rest is handed out, each run after its sea."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import CancelledError, Executor, Future
from pathlib import Path
from queue import Empty, SimpleQueue

from pipeline_tracker.benchmark.local_pool import WorkerDiedError
from pipeline_tracker.benchmark.plan import Plan, RunTask, SeaTask
from pipeline_tracker.benchmark.results import read_run, read_sea, remove
from pipeline_tracker.benchmark.work import Outcome, Place, make_sea, measure

Task = SeaTask | RunTask
Told = Callable[[Task, Outcome], None]

# Ctrl-C is heard at least that often, s.
_LISTEN = 0.5


class Engine:
    """Carries out a plan.

    Attributes:
        todo: runs that are not done yet.
        seas: seas that they need and that are not there yet.
        outcomes: filled with what became of each run of ``todo``, by its directory.
    """

    def __init__(self, plan: Plan, place: Place, *, force: bool = False) -> None:
        """Look what is done already.

        Args:
            plan: what is to be done.
            place: where.
            force: whether runs that are done are done again; seas are kept.
        """
        self._place = place
        root = Path(place.root)
        self.outcomes: dict[str, Outcome] = {}
        self.todo = [run for run in plan.runs if force or read_run(root / run.directory) is None]
        needed = {run.sea for run in self.todo if run.sea is not None}
        self.seas = [
            sea for sea in plan.seas if sea in needed and read_sea(root / sea.directory) is None
        ]
        # Old ones, and those that cannot be read.
        places = [run.directory for run in self.todo] + [sea.directory for sea in self.seas]
        for directory in places:
            remove(root / directory)
        self._finished: SimpleQueue[Future[Outcome]] = SimpleQueue()
        self._futures: dict[Future[Outcome], Task] = {}

    def go(self, executor: Executor, told: Told) -> None:
        """Carry it out; return when each task has ended in one way or another.

        Args:
            executor: does the tasks; its workers see the benchmark's directory.
            told: called for each task that has ended.
        """
        waiting: dict[SeaTask, list[RunTask]] = {sea: [] for sea in self.seas}
        for sea in self.seas:
            self._start(executor, sea)
        for run in self.todo:
            if run.sea in waiting:
                waiting[run.sea].append(run)
            else:
                self._start(executor, run)
        while self._futures:
            try:
                future = self._finished.get(timeout=_LISTEN)
            except Empty:
                continue
            task, outcome = self._futures.pop(future), outcome_of(future)
            told(task, outcome)
            if isinstance(task, RunTask):
                self.outcomes[task.directory] = outcome
                continue
            for run in waiting.pop(task):
                if outcome.reason:
                    self.outcomes[run.directory] = Outcome(f"simulate: {outcome.reason}")
                    told(run, self.outcomes[run.directory])
                else:
                    self._start(executor, run)

    def _start(self, executor: Executor, task: Task) -> None:
        if isinstance(task, SeaTask):
            future = executor.submit(make_sea, self._place, task)
        else:
            future = executor.submit(measure, self._place, task)
        self._futures[future] = task
        future.add_done_callback(self._finished.put)


def outcome_of(future: Future[Outcome]) -> Outcome:
    """Return the outcome of a task that has ended, the loss of its worker included."""
    try:
        return future.result()
    except CancelledError:
        return Outcome("the scheduler has gone or dropped the task; run the same command again")
    except WorkerDiedError as error:
        return Outcome(f"worker died: {error}")
    except Exception as error:  # noqa: BLE001 - whatever the executor's libraries raise
        if type(error).__name__ == "KilledWorker":
            return Outcome("worker died: it cost several workers their lives (out of memory?)")
        text = " ".join(str(error).split())
        return Outcome(f"{type(error).__name__}: {text}"[:500])
