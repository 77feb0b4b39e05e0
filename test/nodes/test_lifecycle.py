"""Managed nodes, the operator's services and parameters at run time, over DDS.

One set of running nodes serves all tests that leave it as they found it.
"""

from __future__ import annotations

import contextlib
import runpy
import time
from pathlib import Path
from typing import Any

import pytest

pytestmark = pytest.mark.ros

SOAK = runpy.run_path(str(Path(__file__).resolve().parents[1] / "soak" / "lifecycle.py"))
SERVICES = ("pipe_tracker/reset", "relative_state_publisher/set_reference")
OUTPUT = "pipeline/relative_state"
# An answer on a busy machine may take its time, s.
DEADLINE = 30.0


class Operator:
    """Calls services of nodes, as ``ros2 lifecycle``, ``param`` and ``service`` do."""

    def __init__(self, talker: Any, nodes: list[Any]) -> None:
        from lifecycle_msgs.srv import ChangeState, GetState
        from rcl_interfaces.srv import SetParametersAtomically
        from std_srvs.srv import Trigger

        self.talker = talker
        services = {
            **dict.fromkeys(SERVICES, Trigger),
            **{f"{node.NAME}/set_parameters_atomically": SetParametersAtomically for node in nodes},
            **{f"{node.NAME}/change_state": ChangeState for node in nodes},
            **{f"{node.NAME}/get_state": GetState for node in nodes},
        }
        self._clients = {
            name: talker.node.create_client(kind, name) for name, kind in services.items()
        }
        for node in nodes:
            self._meet(f"{node.NAME}/get_state")

    def _meet(self, name: str) -> None:
        """Ask until an answer comes: a server may answer before it knows of the client.

        Clients become known in the order in which they were made, this one last.
        """
        client = self._clients[name]
        self.talker.wait(client.service_is_ready, f"{name} is there")
        deadline = time.monotonic() + DEADLINE
        while time.monotonic() < deadline:
            future = client.call_async(client.srv_type.Request())
            with contextlib.suppress(AssertionError):
                self.talker.wait(future.done, "", within=1.0)
                return
        pytest.fail(f"{name} does not answer")

    def call(self, name: str, **fields: Any) -> Any:
        client = self._clients[name]
        self.talker.wait(client.service_is_ready, f"{name} is there")
        future = client.call_async(client.srv_type.Request(**fields))
        self.talker.wait(future.done, f"{name} answers")
        return future.result()

    def change(self, node: str, transition: str) -> bool:
        from lifecycle_msgs.msg import Transition

        wanted = Transition(label=transition)
        return bool(self.call(f"{node}/change_state", transition=wanted).success)

    def state(self, node: str) -> str:
        return str(self.call(f"{node}/get_state").current_state.label)

    def trigger(self, name: str) -> tuple[bool, str]:
        answer = self.call(name)
        return answer.success, answer.message

    def set(self, node: str, **values: Any) -> tuple[bool, str]:
        """Set parameters all or none; ``__`` in a name stands for a dot."""
        from rclpy.parameter import Parameter

        parameters = [
            Parameter(name.replace("__", "."), value=value).to_parameter_msg()
            for name, value in values.items()
        ]
        name = f"{node}/set_parameters_atomically"
        result = self.call(name, parameters=parameters).result
        return result.successful, result.reason


@pytest.fixture
def managed(bench: Any) -> Any:
    """Nodes that wait for a lifecycle manager, the vehicle and the operator."""

    def make(*overrides: str, **options: Any) -> tuple[Any, Any, Operator]:
        live, vehicle = bench.live("autostart=false", *overrides, **options), bench.vehicle()
        return live, vehicle, Operator(vehicle.talker, live.nodes)

    return make


NODES = ("stereo_vectorizer", "local_recognizer", "pipe_tracker", "relative_state_publisher")


def test_a_manager_takes_the_nodes_up_and_down_and_up_again(bench: Any, managed: Any) -> None:
    live, vehicle, operator = managed()
    got = vehicle.talker.got[OUTPUT]
    assert {operator.state(node) for node in NODES} == {"unconfigured"}
    assert not any(s.topic_name.startswith("/stereo") for s in live.nodes[0].subscriptions)
    for transition in ("configure", "activate"):
        assert all(operator.change(node, transition) for node in NODES)
    bench.matched(vehicle.talker)
    assert vehicle.drive(0).valid
    assert vehicle.drive(1).valid

    assert all(operator.change(node, "deactivate") for node in NODES)
    assert {operator.state(node) for node in NODES} == {"inactive"}
    # Not even the state of silence, which comes each second otherwise.
    silent = len(got)
    vehicle.frame(2)
    vehicle.talker.watch(1.5)
    assert len(got) == silent
    # One timer is left, that of /diagnostics.
    assert all(len(list(node.timers)) == 1 for node in live.nodes)

    assert all(operator.change(node, "activate") for node in NODES)
    bench.matched(vehicle.talker)
    state = vehicle.drive(3)
    # The past is forgotten, by the tracker and by the publisher: each counts a reset.
    assert (state.valid, state.reset_counter, state.chainage) == (True, 2, 0.0)
    assert not state.motion_observed
    assert vehicle.status(vehicle.scene.stamp(3)).reset_counter == 1
    assert vehicle.talker.got["pipeline/segment"][-1].mode == 0

    assert all(operator.change(node, "deactivate") for node in NODES)
    assert all(operator.change(node, "cleanup") for node in NODES)
    topics = [p.topic_name for node in live.nodes for p in node.publishers]
    assert not any(topic.startswith("/pipeline") for topic in topics)
    assert all(operator.change(node, "shutdown") for node in NODES)
    assert {operator.state(node) for node in NODES} == {"finalized"}


def test_a_configuration_that_fails_says_why_and_can_be_put_right(
    managed: Any, capfd: pytest.CaptureFixture[str]
) -> None:
    from pipeline_tracker.nodes.pipe_tracker import PipeTracker

    live, _, operator = managed(kinds=[PipeTracker])
    node = live.node("pipe_tracker")
    assert operator.set("pipe_tracker", tracking__max_coast=-1.0)[0]
    assert not operator.change("pipe_tracker", "configure")
    assert operator.state("pipe_tracker") == "unconfigured"
    assert "[pipe_tracker]: cannot be configured: tracking.max_coast=-1.0: expected a number" in (
        capfd.readouterr().err
    )
    assert [p.topic_name for p in node.publishers if "pipeline" in p.topic_name] == []
    # A transition that its state does not allow is answered too.
    assert not operator.change("pipe_tracker", "activate")
    assert operator.set("pipe_tracker", tracking__max_coast=1.0)[0]
    assert operator.change("pipe_tracker", "configure")
    assert node.settings.tracking.max_coast == 1.0
    assert operator.trigger("pipe_tracker/reset") == (
        False,
        "reset: pipe_tracker is not active; activate it first",
    )


def test_an_activation_that_fails_leaves_the_node_inactive(
    managed: Any, monkeypatch: Any, capfd: pytest.CaptureFixture[str]
) -> None:
    from pipeline_tracker.nodes.stereo_vectorizer import StereoVectorizer

    live, _, operator = managed(kinds=[StereoVectorizer])
    node = live.node("stereo_vectorizer")
    assert operator.change("stereo_vectorizer", "configure")
    before = len(list(node.subscriptions))

    def fail() -> None:
        raise OSError("no more files")

    monkeypatch.setattr(node, "ready", fail)
    assert not operator.change("stereo_vectorizer", "activate")
    assert operator.state("stereo_vectorizer") == "inactive"
    assert len(list(node.subscriptions)) == before
    assert "cannot be activated: OSError: no more files" in capfd.readouterr().err
    monkeypatch.undo()
    assert operator.change("stereo_vectorizer", "activate")


@pytest.fixture
def running(bench: Any) -> tuple[Any, Any, Operator]:
    """Nodes that follow the pipe."""
    live, vehicle = bench.live(), bench.vehicle()
    bench.matched(vehicle.talker)
    return live, vehicle, Operator(vehicle.talker, live.nodes)


def test_the_operator_has_the_pipe_forgotten_and_the_chainage_counted_anew(running: Any) -> None:
    _, vehicle, operator = running
    states = [vehicle.drive(k) for k in range(3)]
    assert states[-1].chainage == pytest.approx(0.4, abs=0.03)
    assert operator.trigger(SERVICES[1]) == (True, "chainage 0 is here")
    state = vehicle.drive(3)
    assert state.chainage == pytest.approx(0.2, abs=0.03)
    assert (state.valid, state.reset_counter) == (True, 0)

    done, words = operator.trigger("pipe_tracker/reset")
    assert done
    assert "reset 1" in words
    state = vehicle.drive(4)
    # Found again by the recognizer, with the poses of before.
    assert (state.valid, state.reset_counter, state.chainage) == (True, 1, 0.0)
    assert state.motion_observed
    status = vehicle.status(vehicle.scene.stamp(4))
    assert (status.reset_counter, status.reason) == (1, "reset on request")
    assert vehicle.talker.got["pipeline/segment"][-1].mode == 0
    assert vehicle.drive(5).reset_counter == 1


def test_parameters_change_at_run_time_all_or_none_and_with_the_checks_of_a_start(
    running: Any,
) -> None:
    live, vehicle, operator = running
    tracker, publisher = live.node("pipe_tracker"), live.node("relative_state_publisher")
    assert operator.set("pipe_tracker", tracking__max_coast=1, pose__max_speed=3.0) == (True, "")
    assert tracker.settings.tracking.max_coast == 1.0
    assert tracker.get_parameter("tracking.max_coast").value == 1.0
    before = tracker.settings
    refused = [
        ({"tracking__max_coast": 5.0, "tracking__max_coast_time": -1.0}, "max_coast_time"),
        ({"tracking__max_coast": float("nan")}, "tracking.max_coast"),
        ({"tracking__max_coast": 5.0, "pipe__diameter": 0.7}, "pipe.diameter cannot change while"),
        ({"tracking__max_coast": "far"}, "tracking.max_coast='far': expected a number, at least 0"),
        ({"output__timeout": 1.0}, "set it on relative_state_publisher"),
        ({"use_sim_time": True}, "use_sim_time cannot change while"),
    ]
    for values, words in refused:
        done, reason = operator.set("pipe_tracker", **values)
        assert not done, values
        assert words in reason
    assert tracker.settings == before
    assert tracker.get_parameter("tracking.max_coast").value == 1.0

    # What is set has an effect, and the nodes go on.
    assert vehicle.drive(0).valid
    assert operator.set("relative_state_publisher", output__timeout=0.4) == (True, "")
    assert publisher._watch.timeout == 0.4
    assert operator.set("pipe_tracker", tracking__min_support=1.0) == (True, "")
    assert operator.set("local_recognizer", recognition__min_support=1.0) == (True, "")
    assert not vehicle.drive(1).valid
    assert operator.set("local_recognizer", recognition__min_support=0.2) == (True, "")
    assert operator.set("pipe_tracker", tracking__min_support=0.15) == (True, "")
    assert vehicle.drive(2).valid


def test_cycles_leave_nothing_behind(domain: int, compiled: None) -> None:  # noqa: ARG001
    """A share of the long run: ``python test/soak/lifecycle.py --cycles 200``.

    That one watches the memory too, which takes many cycles and a process of its own.
    """
    grown = SOAK["leaks"](domain, 5)
    assert [words for words in grown if not words.startswith("memory")] == []
