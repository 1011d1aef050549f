"""A page as one HTML file, by plotly: zoom, hover and switch lines. The script comes from the installed package; no network is needed."""

import html

from mip_rt import optional
from mip_rt.errors import LogError
from mip_rt.log.decimation import decimated
from mip_rt.log.page import GREY, VERMILLION, Page

BINS = 3000  # points a line are twice as many: a minute of spikes remains quick to move
BAND_PX, PANEL_PX, TOP_PX, GAP_PX = 20, 150, 105, 42


def write(page: Page, output) -> None:
    """Writes the page.

    Raises:
        PackageMissing: there is no plotly.
        LogError: the file cannot be written.
    """
    text = figure(page).to_html(include_plotlyjs=True, full_html=True, config={"responsive": True, "displaylogo": False, "scrollZoom": True})
    title = f"<head><title>{html.escape(page.heading, quote=False)}</title>"
    try:
        with open(output, "w", encoding="utf-8") as file:
            file.write(text.replace("<head>", title, 1))
    except OSError as error:
        raise LogError(f"{output} cannot be written: {error.strerror}.", "Name another file with -o.", "log_write") from error


def figure(page: Page):
    """The plotly figure; its axes of time move together.

    Raises:
        PackageMissing: there is no plotly.
    """
    graph = optional.load("plotly.graph_objects", "view", "an interactive plot")
    subplots = optional.load("plotly.subplots", "view", "an interactive plot")
    count, columns = max(len(column) for column in page.columns), len(page.columns)
    band_px = max(3, len(page.bands)) * BAND_PX
    height = TOP_PX + band_px + count * (PANEL_PX + GAP_PX) + 60
    titles = [""] * columns
    for row in range(count):
        titles += [f"{c[row].title} ({c[row].unit})" for c in page.columns if row < len(c)]  # an empty cell takes no title
    sheet = subplots.make_subplots(
        rows=count + 1, cols=columns, shared_xaxes="all", row_heights=[band_px, *[PANEL_PX] * count], subplot_titles=titles,
        vertical_spacing=GAP_PX / (height - TOP_PX), horizontal_spacing=0.05,
        specs=[[{}] * columns] + [[{} if row < len(c) else None for c in page.columns] for row in range(count)],
    )  # fmt: skip
    for number, column in enumerate(page.columns):
        _add_bands(graph, sheet, page, number + 1, named=number == 0)
        for row, panel in enumerate(column):
            _add_panel(graph, sheet, panel, page, row + 2, number + 1)
    for annotation in sheet.layout.annotations:  # the panels' titles: left above the axes, as in the picture
        annotation.update(font={"size": 12}, xanchor="left", x=annotation.x - 0.5 * (0.95 / columns if columns > 1 else 1.0))
    for moment_s, code in page.faults:
        sheet.add_vline(x=moment_s, line={"color": VERMILLION, "width": 1.5})
        sheet.add_annotation(x=moment_s, y=1.0, yref="y domain", yanchor="bottom", text=f"<b>{html.escape(code, quote=False)}</b>", showarrow=False,
                             font={"color": VERMILLION, "size": 12}, row=1, col=1)  # fmt: skip
    begin, end = float(page.times_s[0]), float(page.times_s[-1])
    sheet.update_xaxes(range=[begin, end], showticklabels=True, gridcolor="#E8E8E8", zeroline=False, linecolor="#BBBBBB", mirror=True,
                       showspikes=True, spikemode="across", spikethickness=1, spikecolor="#999999", spikedash="solid", ticksuffix=" s")  # fmt: skip
    sheet.update_yaxes(gridcolor="#E8E8E8", zeroline=False, linecolor="#BBBBBB", mirror=True)
    colour = VERMILLION if page.faults else "black"
    sheet.update_layout(
        height=height, plot_bgcolor="white", hovermode="x", dragmode="zoom", font={"size": 11},
        margin={"l": 130, "r": 20, "t": TOP_PX, "b": 40},
        title={"text": f"<b>{html.escape(page.heading, quote=False)}</b><br><span style='font-size:13px;color:{colour}'>{'<br>'.join(html.escape(line, quote=False) for line in page.verdict)}</span>",
               "x": 0.01, "y": 1.0 - 18 / height, "yanchor": "top", "font": {"size": 16}},
        legend={"groupclick": "toggleitem", "tracegroupgap": 8, "font": {"size": 10}},
    )  # fmt: skip
    return sheet


def _add_bands(graph, sheet, page: Page, column: int, named: bool) -> None:
    """Bars on a row for each band; hovering names them."""
    labels = [band.label for band in page.bands]
    for row, band in enumerate(page.bands):
        spans = band.spans
        sheet.add_trace(
            graph.Bar(
                base=[span[0] for span in spans], x=[span[1] - span[0] for span in spans], y=[row] * len(spans), orientation="h", width=0.8,
                marker={"color": [span[3] for span in spans], "line": {"color": [span[3] for span in spans], "width": 1}},
                text=[span[2] if row == 0 else "" for span in spans], textposition="inside", insidetextanchor="middle", textangle=0,
                textfont={"color": "black", "size": 9}, showlegend=False, hoverinfo="text",
                hovertext=[f"{span[2]}: {span[0]:.3f} to {span[1]:.3f} s" for span in spans],
            ),
            row=1, col=column,
        )  # fmt: skip
    sheet.update_yaxes(tickvals=list(range(len(labels))), ticktext=labels if named else [""] * len(labels),
                       range=[max(2.5, len(labels) - 0.5), -0.5], fixedrange=True, row=1, col=column)  # fmt: skip
    sheet.update_layout(barmode="overlay", uniformtext={"minsize": 8, "mode": "hide"})


def _add_panel(graph, sheet, panel, page: Page, row: int, column: int) -> None:
    for line in panel.lines:
        times_s, values = decimated(page.times_s, line.values, BINS)
        sheet.add_trace(
            graph.Scatter(x=times_s, y=values, name=line.label, mode="lines", legendgroup=panel.title, legendgrouptitle={"text": panel.title},
                          line={"color": line.colour, "width": line.width, "dash": line.style},
                          hovertemplate=f"%{{y:.4g}} {panel.unit}"),
            row=row, col=column,
        )  # fmt: skip
    low = min((_least(line.values) for line in panel.lines), default=0.0)
    high = max((-_least(-line.values) for line in panel.lines), default=0.0)
    for bound in panel.bounds:
        if low <= bound <= high:
            sheet.add_hline(y=bound, line={"color": GREY, "width": 1, "dash": "dot"}, row=row, col=column)


def _least(values) -> float:
    import numpy as np

    finite = values[np.isfinite(values)]
    return finite.min() if len(finite) else 0.0
