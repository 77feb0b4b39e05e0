"""The SROS 2 policy allows what the nodes open, and nothing else.

Keys cannot be made from wheels: `ros2 security` has none. What can be checked is the policy's form,
its topics and services beside those that running nodes really have, and the script's calls.
"""

from __future__ import annotations

import subprocess
import xml.etree.ElementTree as ET
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import pytest

DIRECTORY = Path(__file__).resolve().parents[2] / "config" / "sros2"
POLICY = DIRECTORY / "policy.xml"
SHARED = "/pipeline_tracker"
NODES = ("stereo_vectorizer", "local_recognizer", "pipe_tracker", "relative_state_publisher")
# What a node does: subscribes, publishes, answers; by fully qualified names.
Rights = dict[str, set[str]]

# The elements of sros2's schema, version 0.2.0: attributes, and what may stand in them.
FORM: dict[str, tuple[set[str], set[str]]] = {
    "policy": ({"version"}, {"enclaves"}),
    "enclaves": (set(), {"enclave"}),
    "enclave": ({"path"}, {"profiles"}),
    "profiles": (set(), {"profile"}),
    "profile": ({"ns", "node"}, {"topics", "services"}),
    "topics": ({"publish", "subscribe"}, {"topic"}),
    "services": ({"reply", "request"}, {"service"}),
    "topic": (set(), set()),
    "service": (set(), set()),
}
# What a node opens that waits for its mounting from /tf_static, whose package has no wheel.
NOT_HERE = {"/tf_static", "/stereo/left/camera_info"}
if find_spec("pipeline_tracker.nodes.diagnostics") is None:
    NOT_HERE |= {"/diagnostics"}


def enclaves(path: Path = POLICY) -> dict[str, dict[str, Rights]]:
    """Return the rights of each node by enclave."""
    found: dict[str, dict[str, Rights]] = {}
    for enclave in ET.parse(path).getroot().iter("enclave"):
        profiles = enclave.iter("profile")
        found[enclave.attrib["path"]] = {p.attrib["node"]: rights(p) for p in profiles}
    return found


def rights(profile: ET.Element) -> Rights:
    found: Rights = {"subscribe": set(), "publish": set(), "reply": set(), "request": set()}
    for group in profile:
        ((what, allowed),) = group.attrib.items()
        assert allowed == "ALLOW"
        for item in group:
            name = qualified(str(item.text), profile.attrib["ns"], profile.attrib["node"])
            assert name not in found[what], f"{name} twice"
            found[what].add(name)
    return found


def qualified(name: str, namespace: str, node: str) -> str:
    assert name == name.strip()
    assert "*" not in name, "no more than is needed"
    space = namespace.rstrip("/")
    if name.startswith("~/"):
        return f"{space}/{node}{name[1:]}"
    return name if name.startswith("/") else f"{space}/{name}"


def check_form(element: ET.Element) -> None:
    attributes, children = FORM[element.tag]
    assert set(element.attrib) <= attributes, element.tag
    assert {child.tag for child in element} <= children, element.tag
    assert bool(children) == bool(len(element)), f"{element.tag} is empty"
    for child in element:
        check_form(child)


def test_the_policy_has_the_form_of_sros2() -> None:
    root = ET.parse(POLICY).getroot()
    assert root.tag == "policy"
    assert root.attrib == {"version": "0.2.0"}
    check_form(root)


def test_each_node_has_the_same_rights_alone_and_with_the_others() -> None:
    found = enclaves()
    assert set(found) == {SHARED, *(f"{SHARED}/{node}" for node in NODES)}
    assert set(found[SHARED]) == set(NODES)
    for node in NODES:
        assert found[f"{SHARED}/{node}"] == {node: found[SHARED][node]}
        assert not found[SHARED][node]["request"], "no node of ours calls a service"


SETTINGS = (
    ("use_sim_time=true",),
    ("image_transport=compressed",),
    ("camera.rectify=true",),
    ("camera.rectify=true", "image_transport=compressed"),
    ("mode=mono",),
)


def opened(node: Any) -> Rights:
    """Return what a node has open, by the graph of ROS; names without its namespace."""
    name, space = node.get_name(), node.get_namespace()
    by = {
        "subscribe": node.get_subscriber_names_and_types_by_node,
        "publish": node.get_publisher_names_and_types_by_node,
        "reply": node.get_service_names_and_types_by_node,
        "request": node.get_client_names_and_types_by_node,
    }
    return {
        what: {topic.removeprefix(space) for topic, _ in look(name, space)}
        for what, look in by.items()
    }


@pytest.mark.ros
def test_the_policy_allows_what_the_nodes_open_and_nothing_else(bench: Any) -> None:
    """Over all settings that change what is opened."""
    found: dict[str, Rights] = {node: rights(ET.Element("profile")) for node in NODES}
    for number, overrides in enumerate(SETTINGS):
        # The graph knows nodes by their names.
        live = bench.live(*overrides, namespace=f"/vehicle_{number}")
        for node in live.nodes:
            if hasattr(node, "_pictures"):
                # As when someone looks at them.
                node._pictures._open_inputs()
            for what, names in opened(node).items():
                found[node.get_name()][what] |= names
    managed = hasattr(live.nodes[0], "trigger_configure")
    for node, allowed in enclaves()[SHARED].items():
        for what, names in allowed.items():
            assert found[node][what] <= names, f"{node} may not {what}"
            unused = names - found[node][what] - NOT_HERE
            assert unused == set() or not managed, f"{node} need not {what}"


def run_script(place: Path, *arguments: str, ros2: bool = True) -> tuple[int, str, list[str]]:
    """Run the script beside a stand-in for ros2; return exit code, stderr and the calls."""
    tools = place / "bin"
    tools.mkdir()
    calls = place / "calls"
    calls.touch()
    if ros2:
        stand_in = tools / "ros2"
        # It keeps the policy that it is given, and makes the directories that ros2 makes.
        stand_in.write_text(
            f'#!/bin/sh\necho "$@" >> {calls}\n'
            'case $2 in create_keystore) mkdir -p "$3/enclaves";; '
            f'create_permission) cp "$5" {place}/policy.xml;; esac\n'
        )
        stand_in.chmod(0o755)
    done = subprocess.run(
        ["/bin/sh", str(DIRECTORY / "make_keystore.sh"), *arguments],
        env={"PATH": f"{tools}:/usr/bin:/bin"},
        capture_output=True,
        text=True,
        check=False,
    )
    return done.returncode, done.stderr, calls.read_text().splitlines()


def test_the_script_makes_keys_and_permissions_for_each_enclave(tmp_path: Path) -> None:
    keystore = tmp_path / "keystore"
    code, _, calls = run_script(tmp_path, str(keystore))
    assert code == 0
    assert calls[0] == f"security create_keystore {keystore}"
    for enclave in enclaves():
        assert f"security create_enclave {keystore} {enclave}" in calls
        (permission,) = (c for c in calls if f"create_permission {keystore} {enclave} " in c)
        assert permission.endswith("policy.xml")
    assert len(calls) == 1 + 2 * len(enclaves())
    assert (tmp_path / "policy.xml").read_bytes() == POLICY.read_bytes()


def test_the_script_takes_a_namespace(tmp_path: Path) -> None:
    code, _, _ = run_script(tmp_path, str(tmp_path / "keystore"), "/auv1")
    assert code == 0
    found = enclaves(tmp_path / "policy.xml")[SHARED]["pipe_tracker"]
    assert "/auv1/vnm/pose" in found["subscribe"]
    assert "/auv1/pipe_tracker/get_parameters" in found["reply"]
    assert "/clock" in found["subscribe"]


@pytest.mark.parametrize(
    ("arguments", "ros2", "reason"),
    [
        ([], True, "expected KEYSTORE"),
        (["k", "auv1"], True, "begins with /"),
        (["k", "/auv1/"], True, "one like /auv1"),
        (["k", "/a|b"], True, "one like /auv1"),
        (["k"], False, "ros2 is not found"),
    ],
)
def test_the_script_refuses_with_one_line(
    tmp_path: Path, arguments: list[str], ros2: bool, reason: str
) -> None:
    code, said, calls = run_script(tmp_path, *arguments, ros2=ros2)
    assert code == 2
    assert said.count("\n") == 1
    assert reason in said
    assert not calls
