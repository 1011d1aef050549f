"""Recorded against replayed over time, as one page of a few panels."""

import numpy as np

from mip_rt import optional
from mip_rt.errors import LogError

PANELS = 6
DRAWN = ("roll_rad", "pitch_rad", "ball_rate", "phi_rate")  # beginnings of the estimates' names


class Traces:
    """Collects the columns that are drawn: lean and rates of the estimator in control and of the shadows, then the commands.

    Args:
        rerun: a Rerun; robot-specific fields are taken where its frames have them.
    """

    def __init__(self, rerun):
        names = rerun.layout.estimate_names
        self.control = rerun.names[0]
        self.shadows = [name for name in rerun.names[1:] if name not in rerun.recorded_names]
        self._slots = [rerun.names.index(name) for name in self.shadows]
        wanted = [("estimates", i) for i, name in enumerate(names) if name.startswith(DRAWN)]
        for field in ("command_feedback", "command_applied", "duty"):
            if field in rerun.outputs:
                wanted.append((field, 0))
        self.panels = wanted[:PANELS]
        self.units = {f.name: f.unit for f in rerun.layout.fields}
        self.labels = [names[i] if field == "estimates" else f"{field}[{i}] ({self.units[field]})" for field, i in self.panels]
        self._rerun, self._ticks, self._values = rerun, [], []

    def take(self, recorded, replayed) -> None:
        """Keeps the columns of these rows."""
        self._ticks.append(recorded["tick"].copy())
        kept = []
        for field, i in self.panels:
            if field == "estimates":
                kept.append([recorded[field][:, 0, i], *(replayed[field][:, slot, i] for slot in (0, *self._slots))])
            else:
                kept.append([recorded[field][:, i], replayed[field][:, i]])
        self._values.append([[values.copy() for values in panel] for panel in kept])

    def series(self):
        """(seconds since the loop's first tick, for each panel a list of arrays: recorded, replayed, new shadows)."""
        joined = [
            [np.concatenate([batch[p][k] for batch in self._values]) for k in range(len(self._values[0][p]))] for p in range(len(self.panels))
        ]
        rows = np.searchsorted(self._rerun.log.frames["tick"], np.concatenate(self._ticks))
        return self._rerun.times_s[rows], joined


def draw(path, traces: Traces, title: str) -> None:
    """Writes the page.

    Raises:
        PackageMissing: matplotlib is not installed.
        LogError: the file cannot be written.
    """
    optional.load("matplotlib", "lab", "The plot").use("Agg")
    pyplot = optional.load("matplotlib.pyplot", "lab", "The plot")
    times, panels = traces.series()
    figure, axes = pyplot.subplots(len(panels), 2, figsize=(14, 2.2 * len(panels)), sharex=True, squeeze=False, layout="constrained")
    for (left, right), label, series in zip(axes, traces.labels, panels):
        recorded, replayed, *shadows = series
        left.plot(times, recorded, color="0.7", linewidth=2.5, label="recorded")
        left.plot(times, replayed, color="C0", linewidth=0.9, label=f"replayed ({traces.control})")
        for number, (name, values) in enumerate(zip(traces.shadows, shadows)):
            left.plot(times, values, color=f"C{number + 1}", linewidth=0.8, label=name)
            right.plot(times, values - recorded, color=f"C{number + 1}", linewidth=0.8)
        right.plot(times, replayed - recorded, color="C0", linewidth=0.8)
        left.set_ylabel(label, fontsize=8)
        for axis in (left, right):
            axis.grid(alpha=0.3)
    axes[0, 0].set_title(f"{title}: recorded and replayed", fontsize=9)
    axes[0, 1].set_title("minus recorded", fontsize=9)
    axes[0, 0].legend(fontsize=7, ncols=4)
    for axis in axes[-1]:
        axis.set_xlabel("time since the loop's first tick (s)")
    try:
        figure.savefig(path, dpi=110)
    except (OSError, ValueError) as error:
        raise LogError(f"the plot {path} cannot be written: {error}.", "Name a file that ends in .png, .pdf or .svg.", "plot_write") from error
    finally:
        pyplot.close(figure)
