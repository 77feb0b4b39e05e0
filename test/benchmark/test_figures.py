from __future__ import annotations

import numpy as np
import pytest

from pipeline_tracker.benchmark.figures import Figures, Stat, pooled


def stat(values: list[float]) -> Stat:
    if not values:
        return Stat()
    array = np.array(values)
    extreme = max(values, key=abs)
    return Stat(len(values), float(array.mean()), float(np.sqrt(np.mean(array**2))), extreme)


def test_pooled_figures_are_those_of_all_frames_together() -> None:
    rng = np.random.default_rng(3)
    parts = [rng.normal(0.1, 1.0, n).tolist() for n in (3, 20, 0, 1)]
    together = stat([value for part in parts for value in part])
    found = pooled([Figures(stats={"pitch": stat(part)}) for part in parts]).stats["pitch"]
    assert found.n == 24
    assert found.mean == pytest.approx(together.mean)
    assert found.rms == pytest.approx(together.rms)
    assert found.extreme == together.extreme


def test_frames_without_estimate_never_improve_a_mean() -> None:
    bad, nothing = Figures(stats={"horizontal": Stat(4, 0.5, None, 0.9)}), Figures()
    empty = Figures(stats={"horizontal": Stat(0, None, None, None)})
    for others in ([nothing], [empty], [nothing, empty, nothing]):
        assert pooled([bad, *others]).stats["horizontal"] == Stat(4, 0.5, None, 0.9)


def test_counts_add_up_and_what_one_does_not_know_is_not_known() -> None:
    one = Figures({"frames": 8, "valid": 6, "detectable": 4}, {"end": 2})
    two = Figures({"frames": 2, "valid": 2, "detectable": None}, {"end": 1, "direction": 1})
    both = pooled([one, two])
    assert both.counts == {"frames": 10, "valid": 8, "detectable": None}
    assert both.reasons == {"direction": 1, "end": 3}
    assert both.share("valid", "frames") == 0.8
    assert both.share("valid", "detectable") is None
    assert Figures({"frames": 0, "valid": 0}).share("valid", "frames") is None
