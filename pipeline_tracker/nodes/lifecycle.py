"""A managed node: each transition undoes what another began, and says what went wrong."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import ExitStack
from typing import Any

from rclpy.impl.implementation_singleton import rclpy_implementation
from rclpy.lifecycle import LifecycleNode, LifecycleState, TransitionCallbackReturn

from pipeline_tracker.errors import PipelineTrackerError

_SUCCESS = TransitionCallbackReturn.SUCCESS
_FAILURE = TransitionCallbackReturn.FAILURE
_ERROR = TransitionCallbackReturn.ERROR


class Scope:
    """What was made by one transition and lives until it is undone; last made, first ended."""

    def __init__(self) -> None:
        """Hold nothing yet."""
        self._ends = ExitStack()
        self.is_open = True

    def add(self, end: Callable[..., Any], *arguments: Any) -> None:
        """Call something when the scope is closed."""
        self._ends.callback(end, *arguments)

    def close(self) -> None:
        """End all that is held, also where one of the ends fails; that one's error is raised."""
        self.is_open = False
        self._ends.close()


class ManagedNode(LifecycleNode):
    """A lifecycle node whose subclasses say what it takes to be configured, and active.

    What ``configure`` makes lives until cleanup, what ``activate`` makes until deactivation: it is
    added to ``scope``. A transition that fails is logged with its cause, which rclpy would lose,
    what it had made is ended, and the node is what it was before. Where something cannot be ended
    the node becomes unconfigured.
    """

    def __init__(self, name: str, **options: Any) -> None:
        """Make an unconfigured node.

        Args:
            name: of the node.
            options: of ``rclpy.node.Node``.
        """
        super().__init__(name, **options)
        self.failure: Exception | None = None
        self._scopes: list[Scope] = []
        self._answer_impossible_transitions()

    def configure(self) -> None:
        """Make what the node needs before it can be active; what it raises is logged."""
        raise NotImplementedError

    def activate(self) -> None:
        """Begin to work; what it raises is logged."""
        raise NotImplementedError

    @property
    def is_configured(self) -> bool:
        """Whether the node is configured, active or not."""
        return bool(self._scopes)

    @property
    def is_active(self) -> bool:
        """Whether the node works."""
        return len(self._scopes) == 2

    @property
    def scope(self) -> Scope:
        """What was made last by configuring or activating."""
        return self._scopes[-1]

    def became(self, failure: Exception | None = None) -> None:
        """Take notice of another state, or of a transition that has failed."""

    def close(self) -> None:
        """End all that the node has, whatever state it is in."""
        while self._scopes:
            self._leave("closed")

    def on_configure(self, state: LifecycleState) -> TransitionCallbackReturn:  # noqa: ARG002
        """Answer the transition."""
        return self._enter("configured", self.configure)

    def on_activate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Answer the transition."""

        def activate() -> None:
            # Publishers are heard from here on, and until all else has ended.
            LifecycleNode.on_activate(self, state)
            self.scope.add(LifecycleNode.on_deactivate, self, state)
            self.activate()

        return self._enter("activated", activate)

    def on_deactivate(self, state: LifecycleState) -> TransitionCallbackReturn:  # noqa: ARG002
        """Answer the transition."""
        return self._leave("deactivated")

    def on_cleanup(self, state: LifecycleState) -> TransitionCallbackReturn:  # noqa: ARG002
        """Answer the transition."""
        return self._leave("cleaned up")

    def on_shutdown(self, state: LifecycleState) -> TransitionCallbackReturn:  # noqa: ARG002
        """Answer the transition."""
        self.close()
        return _SUCCESS

    def on_error(self, state: LifecycleState) -> TransitionCallbackReturn:  # noqa: ARG002
        """Become unconfigured, after a transition that failed halfway."""
        self.close()
        return _SUCCESS

    def _enter(self, done: str, step: Callable[[], None]) -> TransitionCallbackReturn:
        self._scopes.append(Scope())
        self.became()
        try:
            step()
        except Exception as error:  # noqa: BLE001 - whatever it is, it is said and the node lives
            self.failure = error
            self.get_logger().error(f"cannot be {done}: {in_words(error)}")
            undone = self._leave("undone")
            self.became(error)
            return _FAILURE if undone == _SUCCESS else _ERROR
        self.failure = None
        return _SUCCESS

    def _leave(self, done: str) -> TransitionCallbackReturn:
        try:
            self._scopes.pop().close()
        except Exception as error:  # noqa: BLE001 - whatever it is, it is said and the node lives
            self.get_logger().error(f"cannot be {done}: {in_words(error)}")
            return _ERROR
        finally:
            self.became()
        return _SUCCESS

    def _answer_impossible_transitions(self) -> None:
        """Answer a transition that the state does not allow; rclpy's own callback raises."""
        service = self._service_change_state
        change = service.callback

        def answer(request: Any, response: Any) -> Any:
            try:
                return change(request, response)
            except rclpy_implementation.RCLError as error:
                self.get_logger().warning(f"transition refused: {in_words(error)}")
                response.success = False
                return response

        service.callback = answer


def in_words(error: Exception) -> str:
    """Return an error as one line: ours as it is, another one with its kind."""
    expected = isinstance(error, PipelineTrackerError | ValueError)
    kind = "" if expected else f"{type(error).__name__}: "
    return " ".join(f"{kind}{error}".split())
