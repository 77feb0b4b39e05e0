"""A picture of how fast it must be (5.3.1): the time for a frame over height and speed."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

from pipeline_tracker.errors import SettingsError
from pipeline_tracker.limits import Plan

# Of Okabe and Ito, one for each speed; each line is named at its end too.
_COLOURS = ("#0072B2", "#009E73", "#E69F00", "#D55E00", "#000000")
_SHARES = (0.25, 0.5, 1.0, 1.5, 2.0)
_HEIGHTS = 41


def write_limits_plot(plan: Plan, file: Path, spent: float | None = None) -> None:
    """Draw t2 over the height above the pipe, a line for each of five speeds about the planned one.

    Args:
        plan: checked; its speed and height are marked.
        file: PNG, SVG or PDF, as its name ends.
        spent: t1, the time that a frame takes, s, drawn as a line; None: not drawn.

    Raises:
        SettingsError: the file cannot be written, or its name ends in another way.
    """
    from matplotlib.backends.backend_agg import FigureCanvasAgg  # noqa: PLC0415 - slow to import
    from matplotlib.figure import Figure  # noqa: PLC0415
    from matplotlib.ticker import FormatStrFormatter  # noqa: PLC0415

    figure = Figure(figsize=(7.0, 4.5), layout="constrained")
    FigureCanvasAgg(figure)
    axes = figure.subplots()
    heights = np.linspace(0.25 * plan.altitude, 2.0 * plan.altitude, _HEIGHTS)
    for share, colour in zip(_SHARES, _COLOURS, strict=True):
        speed = share * plan.speed
        times = [1e3 * replace(plan, altitude=float(h), speed=speed).time for h in heights]
        axes.plot(heights, times, color=colour, linewidth=2.5 if share == 1.0 else 1.2)
        end = (float(heights[-1]), times[-1])
        axes.annotate(
            f"{speed:g} m/s", end, (4, 0), textcoords="offset points", va="center", color=colour
        )
    axes.plot(plan.altitude, 1e3 * plan.time, "o", color=_COLOURS[2], markersize=8)
    label = f"t2 = {1e3 * plan.time:.0f} ms"
    place = (plan.altitude, 1e3 * plan.time)
    axes.annotate(
        label, place, (-8, 8), textcoords="offset points", ha="right",
        bbox={"facecolor": "white", "edgecolor": "none", "pad": 1.5},
    )  # fmt: skip
    if spent is not None:
        axes.axhline(1e3 * spent, color="#555555", linestyle="--", linewidth=1.0)
        place = (float(heights[-1]), 1e3 * spent)
        label = f"t1 = {1e3 * spent:.0f} ms"
        axes.annotate(label, place, (0, 4), textcoords="offset points", ha="right")
    axes.set_yscale("log")
    axes.yaxis.set_major_formatter(FormatStrFormatter("%d"))
    axes.set_xlabel("camera above the pipe, m")
    axes.set_ylabel("time that a frame may take, ms")
    axes.set_title(
        f"{plan.angle:g}° of view, tilted {plan.tilt:g}°, overlap {plan.overlap:g} (5.3.1)",
        fontsize=10,
    )
    axes.grid(which="both", color="#E5E5E5")
    axes.spines[["top", "right"]].set_visible(False)
    try:
        figure.savefig(file, dpi=150)
    except OSError as error:
        raise SettingsError(f"--plot {file}: cannot be written ({error.strerror})") from None
    except ValueError:
        raise SettingsError(
            f"--plot {file}: expected a name ending in .png, .svg or .pdf"
        ) from None
