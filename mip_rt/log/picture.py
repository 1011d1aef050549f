"""A page as a PNG, by matplotlib."""

from mip_rt import optional
from mip_rt.log.decimation import decimated
from mip_rt.log.page import GREY, VERMILLION, Page

BINS = 1200  # more than a panel has dots
STYLES = {"solid": "-", "dash": (0, (4, 2)), "dot": (0, (1, 1.5))}
BAND_IN, PANEL_IN, TOP_IN, BOTTOM_IN = 0.2, 1.55, 0.95, 0.5  # heights
SHORT_TEXT = 0.011  # width of a letter in a band as a fraction of the axes
SHORTEST = 0.003  # likewise of a span, so that a single tick shows in a minute


def figure(width_in: float, height_in: float):
    """A matplotlib figure that needs no screen.

    Raises:
        PackageMissing: there is no matplotlib.
    """
    optional.load("matplotlib", "lab", "a PNG").use("Agg")
    return optional.load("matplotlib.figure", "lab", "a PNG").Figure(figsize=(width_in, height_in), dpi=110)


def write(page: Page, output) -> None:
    """Draws the page into a file.

    Raises:
        PackageMissing: there is no matplotlib.
        LogError: the file cannot be written.
    """
    count = max(len(column) for column in page.columns)
    band_in = max(3, len(page.bands)) * BAND_IN
    wide = len(page.columns) > 1
    height_in = TOP_IN + band_in + 0.35 + count * (PANEL_IN + 0.42) + BOTTOM_IN
    sheet = figure(15.0 if wide else 11.0, height_in)
    grid = sheet.add_gridspec(
        count + 1, len(page.columns), height_ratios=[band_in, *[PANEL_IN] * count], hspace=0.27, wspace=0.16,
        left=0.115 if wide else 0.15, right=0.985, top=1.0 - TOP_IN / height_in, bottom=BOTTOM_IN / height_in,
    )  # fmt: skip
    begin, end = float(page.times_s[0]), float(page.times_s[-1])
    if end <= begin:
        end = begin + 0.005
    for number, column in enumerate(page.columns):
        _draw_bands(sheet.add_subplot(grid[0, number]), page, begin, end, named=number == 0)
        for row, panel in enumerate(column):
            _draw_panel(sheet.add_subplot(grid[row + 1, number]), panel, page, begin, end, last=row == len(column) - 1)
    sheet.text(0.01, 1.0 - 0.12 / height_in, page.heading, fontsize=12, weight="bold", va="top")
    sheet.text(0.01, 1.0 - 0.38 / height_in, "\n".join(page.verdict), fontsize=10, va="top",
               color=VERMILLION if page.faults else "black", linespacing=1.35)  # fmt: skip
    save(sheet, output)


def save(sheet, output) -> None:
    """Writes a figure as a PNG.

    Raises:
        LogError: the file cannot be written.
    """
    from mip_rt.errors import LogError

    try:
        sheet.savefig(output, format="png")
    except OSError as error:
        raise LogError(f"{output} cannot be written: {error.strerror}.", "Name another file with -o.", "log_write") from error


def _mark_faults(axes, page: Page, named: bool = False) -> None:
    for moment_s, code in page.faults:
        axes.axvline(moment_s, color=VERMILLION, linewidth=1.4, zorder=5)
        if named:
            axes.annotate(code, (moment_s, 1.0), xycoords=("data", "axes fraction"), xytext=(0, 2), textcoords="offset points",
                          color=VERMILLION, fontsize=9, weight="bold", ha="center", va="bottom", annotation_clip=True)  # fmt: skip


def _draw_bands(axes, page: Page, begin: float, end: float, named: bool) -> None:
    for row, band in enumerate(page.bands):
        for first, last, text, colour in band.spans:
            last = max(last, first + SHORTEST * (end - begin))
            axes.barh(row, last - first, left=first, height=0.8, color=colour, edgecolor=colour, linewidth=0.6)
            low, high = max(first, begin), min(last, end)
            if row == 0 and (high - low) / (end - begin) > SHORT_TEXT * len(text):
                axes.text((low + high) / 2, row, text, ha="center", va="center", fontsize=7.5, clip_on=True)
    axes.set_yticks(range(len(page.bands)), [band.label for band in page.bands] if named else [], fontsize=8)
    axes.set_ylim(max(2.5, len(page.bands) - 0.5), -0.5)
    axes.set_xlim(begin, end)
    axes.tick_params(labelbottom=False, length=0)
    axes.grid(axis="x", color="#E4E4E4", linewidth=0.6)
    axes.set_axisbelow(True)
    for side in axes.spines.values():
        side.set_color("#BBBBBB")
    _mark_faults(axes, page, named=True)


def _draw_panel(axes, panel, page: Page, begin: float, end: float, last: bool) -> None:
    for line in panel.lines:
        times_s, values = decimated(page.times_s, line.values, BINS)
        axes.plot(times_s, values, color=line.colour, linestyle=STYLES[line.style], linewidth=line.width, label=line.label,
                  marker="." if len(page.times_s) == 1 else None)  # fmt: skip
    axes.set_xlim(begin, end)
    low, high = axes.get_ylim()
    for bound in panel.bounds:
        if low <= bound <= high:  # a bound far away must not flatten the lines
            axes.axhline(bound, color=GREY, linewidth=0.8, linestyle=STYLES["dot"])
    axes.ticklabel_format(useOffset=False)
    axes.margins(y=0.08)
    axes.set_title(f"{panel.title} ({panel.unit})", loc="left", fontsize=9.5, pad=3)
    if len(panel.lines) > 1 or panel.lines[0].label not in (panel.title, "battery"):
        axes.legend(loc="lower right", bbox_to_anchor=(1.0, 1.0), ncol=min(8, len(panel.lines)), fontsize=7.5, frameon=False,
                    borderpad=0.1, borderaxespad=0.1, handlelength=1.8, columnspacing=1.0)  # fmt: skip
    axes.tick_params(labelsize=8, labelbottom=True)
    axes.grid(color="#E4E4E4", linewidth=0.6)
    for side in axes.spines.values():
        side.set_color("#BBBBBB")
    if last:
        axes.set_xlabel("seconds since the loop's first tick", fontsize=8.5)
    _mark_faults(axes, page)
