from __future__ import annotations

import pytest

from pipeline_tracker.doctor import ros

pytestmark = pytest.mark.ros


def test_two_processes_talk(domain: int, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("ROS_DOMAIN_ID", str(domain))
    found = list(ros.conversation())
    assert [finding.what for finding in found] == ["conversation"]
    assert "found each other" in found[0].seen
