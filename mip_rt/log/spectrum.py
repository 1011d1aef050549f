"""`mip-rt log spectrum`: Welch spectrum of any field while the robot balances, with its strongest lines and the line of the rollers.

The rollers of the omniwheels hand over to each other as the ball rolls, and shake the robot at a frequency in proportion to the ball's speed
(dissertation, section 6.4.4 and Fig. 6.24: 27.9 rad/s at 0.2 m/s, 39.1 at 0.3). The configuration's `dry_run.rollers_per_ball_turn` is that factor:
hand-overs a radian of the ball.
"""

import json
import math
from pathlib import Path

from mip_rt import optional
from mip_rt.errors import LogError
from mip_rt.log.selection import add_log, add_window, open_named, seconds, window

SEGMENT_S = 4.0  # longest Welch segment: lines are told apart at 1/SEGMENT_S Hz
SEGMENTS = 5  # at least so many, half overlapping, in a short part: the mean of few is so uneven that any bin may look like a line
LINES = 8  # strongest ones that are told
CHANCE = 0.01  # that noise alone shows a line somewhere in a spectrum
FLOOR_BINS = 5  # the noise floor about a bin is of at least so many on either side
ROLLERS_PER_RAD = 6.26  # where the log's configuration has none: that of the simulated rollers; (T Fig. 6.24) has 4.2 to 4.5
SLOWEST_M_S = 0.02  # below, the line lies in the motions of balancing
SPEED = "ball_speed_m_s"  # computed here: a magnitude, so that a spinning robot's own frame does not move its lines
DEFAULT = f"{SPEED},acceleration_m_s2"


def add_arguments(parser) -> None:
    """Declares the action's arguments."""
    add_log(parser)
    add_window(parser)
    parser.add_argument("--fields", metavar="A,B[0]", help=f"fields; {SPEED} is the estimator's ball speed (default: {DEFAULT})")
    parser.add_argument("--all", action="store_true", help="all rows of the window, not only those in which the robot balances")
    parser.add_argument("--segment", metavar="S", type=float, default=SEGMENT_S,
                        help=f"longest segment: longer tells lines better apart (default: {SEGMENT_S:g})")  # fmt: skip
    parser.add_argument("-o", "--output", metavar="FILE", help="plot it as well: ends in .png")
    parser.add_argument("--json", action="store_true", help="print one JSON object")


def run(arguments) -> int:
    """Exit code 0."""
    from mip_rt.log.codes import Codes

    output = Path(arguments.output) if arguments.output else None
    if output is not None and output.suffix != ".png":
        raise LogError(f"a spectrum cannot be plotted as {output.name!r}.", "End the file's name in .png.", "log_plot")
    log = open_named(arguments)
    mask = window(arguments, seconds(log))
    rows = log.frames[mask] if arguments.all else balancing(log.frames[mask], Codes(log.header))
    found = spectra(log, rows, arguments.fields, arguments.segment)
    if output is not None:
        draw(found, f"{log.path.name}: {found['span_s']:.1f} s", output)
    if arguments.json:
        fields = {name: {key: e[key] for key in ("unit", "rms", "lines")} for name, e in found["fields"].items()}
        print(json.dumps({**found, "fields": fields}))
    else:
        print(render(found))
        if output is not None:
            print(output)
    return 0


def balancing(frames, codes):
    """The longest stretch without a gap in which the robot balances, with its controller engaged.

    Raises:
        LogError: there is none.
    """
    import numpy as np

    from mip_rt import frame

    held = (frames["state"] == codes.balancing_state) & (frames["request"] & frame.REQUEST_ENGAGED != 0)
    begins = np.flatnonzero(held & ~np.concatenate(([False], held[:-1] & (np.diff(frames["tick"]) == 1))))
    ends = np.flatnonzero(held & ~np.concatenate((held[1:] & (np.diff(frames["tick"]) == 1), [False])))
    if not len(begins):
        raise LogError("the robot does not balance in that part of the log.", "Choose another part, or give --all.", "log_window")
    longest = int(np.argmax(ends - begins))
    return frames[begins[longest] : ends[longest] + 1]


def spectra(log, frames, fields: str | None = None, segment_s: float = SEGMENT_S) -> dict:
    """Welch spectra (Hann window, half overlap, mean removed) of fields.

    Returns:
        rate_hz, span_s, resolution_hz; ball_speed_m_s (median) and roller_hz (lower quartile, median, upper quartile of the rows), None where
        the log has no ball speed or the ball is slow; fields: by name unit, hz and density (unit^2/Hz) as lists, rms, and `lines`,
        strongest first: see `strongest`; `is_roller` for those at the rollers' frequency.

    Raises:
        LogError: fewer than 64 rows, or a field is not in the log.
        PackageMissing: there is no scipy.
    """
    import numpy as np

    signal = optional.load("scipy.signal", "lab", "a spectrum")
    if len(frames) < 64:
        raise LogError(f"{len(frames)} rows are too few for a spectrum.", "Choose a longer part.", "log_window")
    step_s = float(np.median(np.diff(frames["edge_ns"]))) * 1e-9
    length = max(64, min(2 * len(frames) // (SEGMENTS + 1), round(segment_s / step_s)))
    segments = 2 * len(frames) // length - 1
    resolution = 1.0 / (length * step_s)
    speed = ball_speed(log, frames)
    roller = None if speed is None else roller_hz(log, np.percentile(speed, (25.0, 50.0, 75.0)))
    found = {}
    for name, unit, values in _series(log, frames, fields, speed):
        bad = ~np.isfinite(values)
        if bad.all():
            continue
        if bad.any():  # a spectrum needs every sample: straight lines over the holes
            values[bad] = np.interp(np.flatnonzero(bad), np.flatnonzero(~bad), values[~bad])
        hz, density = signal.welch(values, 1.0 / step_s, "hann", length, detrend="constant")
        lines = strongest(hz, density, segments)
        for line in lines:
            line["is_roller"] = roller is not None and roller[0] - resolution <= line["hz"] <= roller[2] + resolution
        found[name] = {"unit": unit, "rms": float(values.std()), "lines": lines, "hz": hz.tolist(), "density": density.tolist()}
    return {
        "rate_hz": round(1.0 / step_s, 4),
        "span_s": round(len(frames) * step_s, 3),
        "resolution_hz": round(resolution, 4),
        "ball_speed_m_s": None if speed is None else round(float(np.median(speed)), 4),
        "roller_hz": None if roller is None else [round(v, 4) for v in roller],
        "fields": found,
    }


def _series(log, frames, fields: str | None, speed):
    """(name, unit, values) of each column that was asked for."""
    import numpy as np

    from mip_rt.log.columns import pick

    for name in (fields or DEFAULT).replace("+", ",").split(","):
        if name.strip() == SPEED:
            if speed is not None:
                yield SPEED, "m/s", speed.copy()
            elif fields:
                raise LogError("the log has no ball speed.", "mip-rt log info --fields lists what it has.", "log_field")
            continue
        for column in pick(log.header, name):
            if not column.is_bytes:
                yield column.name, column.unit, np.array(column.of(frames), float)


def ball_speed(log, frames):
    """(n,) speed of the ball over the ground, by the estimator in control; None where the log has none."""
    import numpy as np

    from mip_rt.log.configuration import value

    names, radius_m = list(log.header.get("estimate_names", [])), value(log.config, "model.ball_radius_m", None)
    if radius_m is None or "ball_rate_x_rad_s" not in names:
        return None
    x, y = (frames["estimates"][:, 0, names.index(f"ball_rate_{axis}_rad_s")] for axis in "xy")
    return np.hypot(x, y) * radius_m


def roller_hz(log, speeds_m_s) -> list[float] | None:
    """Frequencies of the rollers at three speeds of the ball; None where the middle one is slow."""
    from mip_rt.log.configuration import value

    if speeds_m_s[1] < SLOWEST_M_S:
        return None
    factor = float(value(log.config, "dry_run.rollers_per_ball_turn", ROLLERS_PER_RAD))
    return [factor * float(speed) / value(log.config, "model.ball_radius_m", None) / (2.0 * math.pi) for speed in speeds_m_s]


def strongest(hz, density, segments: int) -> list[dict]:
    """The strongest lines, strongest first: maxima that the noise about them would not show by chance (CHANCE), by the chi-squared
    distribution of a mean of so many segments. Frequency (hz, rad_s), amplitude of a sine of the line's power, and decibels above the floor.
    """
    import numpy as np

    signal = optional.load("scipy.signal", "lab", "a spectrum")
    if not density.max() > 0.0:
        return []
    quantile = optional.load("scipy.stats", "lab", "a spectrum").chi2.ppf
    freedom = 2 * segments
    threshold = quantile(1.0 - CHANCE / len(hz), freedom) / quantile(0.5, freedom)
    floor = noise_floor(density)
    peaks = signal.find_peaks(density)[0]
    peaks = peaks[density[peaks] > threshold * floor[peaks]]
    found = []
    for peak in peaks[np.argsort(density[peaks])[::-1][:LINES]].tolist():
        near = slice(max(0, peak - 1), peak + 2)  # a Hann window spreads a line over three bins
        power = float(density[near].sum() * (hz[1] - hz[0]))
        centre = float((hz[near] * density[near]).sum() / density[near].sum())
        above_db = 10.0 * math.log10(density[peak] / floor[peak]) if floor[peak] > 0.0 else math.inf
        found.append({
            "hz": round(centre, 3), "rad_s": round(2.0 * math.pi * centre, 2), "amplitude": math.sqrt(2.0 * power),
            "above_floor_db": round(min(above_db, 999.0), 1),
        })  # fmt: skip
    return found


def noise_floor(density):
    """What a spectrum would be without its lines: about each bin the geometric mean of the medians of the octave below and of that above.

    Of both, so that a slope, such as 1/f^4 of a position, does not count as a line.
    """
    import numpy as np

    last = len(density) - 1
    floor = np.empty(len(density))
    for i in range(len(density)):
        reach = max(FLOOR_BINS, i // 2)
        below, above = density[max(0, i - reach) : i + 1], density[i : min(last, i + 2 * reach) + 1]
        floor[i] = math.sqrt(np.median(below) * np.median(above))
    return floor


def _rollers(found: dict) -> str:
    low, middle, high = found["roller_hz"]
    return (f"rollers at a ball speed of {found['ball_speed_m_s']:.3f} m/s: {middle:.2f} Hz = {2.0 * math.pi * middle:.1f} rad/s "
            f"(half of the time {low:.2f} to {high:.2f} Hz)")  # fmt: skip


def render(found: dict) -> str:
    """The spectrum's lines for people."""
    lines = [f"{found['span_s']:.1f} s at {found['rate_hz']:.2f} Hz, lines are told apart at {found['resolution_hz']:.2f} Hz"]
    if found["roller_hz"] is not None:
        lines.append(_rollers(found))
    elif found["ball_speed_m_s"] is not None:
        lines.append(f"the ball is too slow for the rollers' line ({found['ball_speed_m_s']:.3f} m/s)")
    for name, entry in found["fields"].items():
        lines += ["", f"{name}: {entry['rms']:.4g} {entry['unit']} rms", f"  {'Hz':>8} {'rad/s':>9} {'amplitude':>12}  above floor"]
        for line in entry["lines"]:
            mark = "  <- rollers" if line["is_roller"] else ""
            lines.append(f"  {line['hz']:>8.2f} {line['rad_s']:>9.1f} {line['amplitude']:>12.4g} {line['above_floor_db']:>8.1f} dB{mark}")
        if not entry["lines"]:
            lines.append("  no line stands out")
    return "\n".join(lines)


def draw(found: dict, heading: str, output) -> None:
    """The spectra as a PNG, one panel a field, both axes logarithmic; the strongest lines and the rollers' range are marked.

    Raises:
        PackageMissing: there is no matplotlib.
        LogError: the file cannot be written.
    """
    from mip_rt.log.page import BLUE, ORANGE
    from mip_rt.log.picture import figure, save

    ticker = optional.load("matplotlib.ticker", "lab", "a PNG")
    count = len(found["fields"])
    height_in = 1.3 + 2.6 * count
    sheet = figure(11.0, height_in)
    axes = sheet.subplots(count, 1, squeeze=False, sharex=True, gridspec_kw={
        "left": 0.09, "right": 0.98, "top": 1.0 - 0.85 / height_in, "bottom": 0.5 / height_in, "hspace": 0.22})[:, 0]  # fmt: skip
    for panel, (name, entry) in zip(axes, found["fields"].items(), strict=True):
        panel.loglog(entry["hz"][1:], entry["density"][1:], color=BLUE, linewidth=1.2)
        panel.set_title(name, loc="left", fontsize=9.5, pad=3)
        panel.set_ylabel(f"({entry['unit'].replace('^2', '²')})²/Hz", fontsize=8.5)
        _label_lines(panel, entry)
        if found["roller_hz"] is not None:
            low, middle, high = found["roller_hz"]
            panel.axvspan(low, high, color=ORANGE, alpha=0.2, linewidth=0)
            panel.axvline(middle, color=ORANGE, linewidth=1.2, linestyle=(0, (4, 2)))
        panel.margins(x=0.0, y=0.15)
        panel.xaxis.set_major_locator(ticker.LogLocator(subs=(1.0, 2.0, 5.0)))
        panel.xaxis.set_major_formatter("{x:g}")
        panel.yaxis.set_minor_formatter(ticker.NullFormatter())
        panel.grid(which="major", color="#D8D8D8", linewidth=0.6)
        panel.grid(which="minor", axis="x", color="#EEEEEE", linewidth=0.5)
        panel.tick_params(labelsize=8)
    axes[-1].set_xlabel("frequency (Hz)", fontsize=8.5)
    words = heading if found["roller_hz"] is None else f"{heading}\n{_rollers(found)}"
    sheet.text(0.01, 1.0 - 0.12 / height_in, words, fontsize=10.5, va="top", linespacing=1.4)
    save(sheet, output)


def _label_lines(panel, entry: dict) -> None:
    """Frequencies at the strongest lines, where they do not cover each other."""
    from mip_rt.log.page import BLACK, VERMILLION

    labelled = []
    for line in entry["lines"]:
        if line["hz"] <= 0.0 or any(abs(math.log(line["hz"] / other)) < 0.35 for other in labelled):
            continue
        labelled.append(line["hz"])
        level = entry["density"][min(range(len(entry["hz"])), key=lambda i: abs(entry["hz"][i] - line["hz"]))]
        panel.annotate(f"{line['hz']:.2f} Hz", (line["hz"], level), xytext=(0, 5), textcoords="offset points", fontsize=8, ha="center",
                       color=VERMILLION if line["is_roller"] else BLACK)  # fmt: skip
