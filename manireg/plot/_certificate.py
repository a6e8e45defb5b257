"""Fields of a registration's certificate on its mesh: for print, and on a page that turns
in a browser."""

import html
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from ._figure import Figure, figure, figure_of
from ._surface import surface, view_axes

MOST = 98.0  # percentile at which colours end


class _Field(NamedTuple):
    name: str
    values: np.ndarray
    limits: tuple[float, float]
    colours: str
    of_triangles: bool


def certificate(found: Any, report: Any) -> Figure:
    """Of a `Registration` and its `report()`: where areas grow and shrink (factors, on a
    logarithmic scale), the 95 % radius, and the distance to the target, on the registered
    mesh; folded triangles are red."""
    shown = [f for f in _fields(found, report) if f.name in ("area", *_PRINTED)]
    picture = figure(2.6 * len(shown), 2.8)
    mesh = found.mesh()
    for ax, field in zip(
        np.atleast_1d(picture.subplots(1, len(shown))), shown, strict=True
    ):
        surface(ax, mesh, field.values, field.limits, colours=field.colours)
        if len(report.folded):
            folded = mesh.triangles_center[report.folded] @ view_axes().T
            ax.plot(*folded[:, :2].T, ".", color="red", markersize=2)
        _bar(ax, field)
    return picture


_PRINTED = "95 % radius", "distance to target"


def page(
    found: Any, report: Any, file: str | Path, title: str = "Registration"
) -> Path:
    """Write a page that needs no network: the registered mesh to turn with the mouse,
    coloured by each field of the `report()`, the target by its distance from the map, and
    all numbers below. plotly comes with the extra `page`.

    **Raises** ModuleNotFoundError without it, ValueError for point clouds, which have no
    triangles to draw, and for a file that is not `.html`."""
    path = Path(file)
    if path.suffix.lower() not in (".html", ".htm"):
        raise ValueError(f"page: expected a file .html, found {path.name!r}.")
    graph = page_library()
    mesh = found.mesh()
    centre = np.mean(mesh.vertices, axis=0)  # browsers draw in single precision
    fields = _fields(found, report)
    traces = [_trace(graph, mesh, centre, field) for field in fields]
    if found.target.faces is not None:
        distance = _of_values("distance from target", report.from_target)
        traces.append(_trace(graph, found.target, centre, distance))
        fields.append(distance)
    folded = len(report.folded)
    if folded:
        red = graph.Mesh3d(
            **_geometry(mesh.vertices, mesh.faces[report.folded], centre), color="red"
        )
        traces.append(red)
    buttons = []
    for i, field in enumerate(fields):
        visible = [i == j for j in range(len(fields))] + [True] * (
            len(traces) - len(fields)
        )
        buttons.append(
            {"label": field.name, "method": "update", "args": [{"visible": visible}]}
        )
    for trace in traces[1 : len(fields)]:
        trace.visible = False
    hidden = {"visible": False}
    picture = graph.Figure(traces)
    picture.update_layout(
        scene={
            "aspectmode": "data",
            **{f"{axis}axis": hidden for axis in "xyz"},
            "camera": {
                "up": {"x": 0, "y": 1, "z": 0},
                "eye": {"x": 0.5, "y": 0.3, "z": 1.8},
            },
        },
        updatemenus=[{"buttons": buttons, "x": 0.0, "xanchor": "left", "y": 1.0}],
        margin={"l": 0, "r": 0, "t": 0, "b": 0},
    )
    drawn = picture.to_html(
        full_html=False, include_plotlyjs=True, default_height="70vh", div_id="surface"
    )
    path.write_text(_document(title, drawn, report))
    return path


def page_library():
    """plotly; where it is missing, an error that says the cure."""
    try:
        import plotly.graph_objects as graph
    except ModuleNotFoundError as error:
        raise ModuleNotFoundError(
            "The page needs plotly: pip install 'manireg[page]'"
        ) from error
    return graph


def _fields(found: Any, report: Any) -> list[_Field]:
    areas = np.log2(np.maximum(found.stretch(), 1e-3))
    limit = max(float(np.percentile(np.abs(areas), MOST)), 1e-3)
    own = [_of_values(name, values) for name, values in report.fields().items()]
    return [_Field("area", areas, (-limit, limit), "RdBu_r", True), *own]


def _of_values(name: str, values) -> _Field:
    values = np.nan_to_num(values, nan=0.0)
    low = float(np.min(values)) if "stretch" in name else 0.0
    high = float(np.percentile(values, MOST))
    return _Field(name, values, (low, max(high, low + 1e-12)), "viridis", False)


def _bar(ax, field: _Field) -> None:
    from matplotlib.cm import ScalarMappable
    from matplotlib.colors import LogNorm, Normalize

    low, high = field.limits
    scale = LogNorm(2.0**low, 2.0**high) if field.of_triangles else Normalize(low, high)
    bar = figure_of(ax).colorbar(
        ScalarMappable(scale, field.colours),
        ax=ax,
        shrink=0.7,
        orientation="horizontal",
    )
    if field.of_triangles:
        marks = [2.0**low, 1.0, 2.0**high]
        bar.set_ticks(marks, labels=[f"{mark:.2f}" for mark in marks], minor=False)
        bar.minorticks_off()
    else:
        bar.set_ticks([low, high], labels=[f"{low:.2g}", f"{high:.2g}"])
    label = "area on target / source" if field.of_triangles else field.name
    bar.set_label(label)


def _geometry(vertices, faces, centre) -> dict[str, Any]:
    columns = zip("xyz", np.round((vertices - centre).T, 12), strict=True)
    corners = zip("ijk", np.asarray(faces, np.int32).T, strict=True)
    return {name: a.astype(np.float32) for name, a in columns} | dict(corners)


def _trace(graph, mesh: Any, centre, field: _Field):
    low, high = field.limits
    bar: dict[str, Any] = {"title": {"text": field.name}, "len": 0.6}
    if field.of_triangles:
        marks = [low, 0.0, high]
        bar |= {"tickvals": marks, "ticktext": [f"{2.0**mark:.2f}" for mark in marks]}
    return graph.Mesh3d(
        **_geometry(mesh.vertices, mesh.faces, centre),
        intensity=field.values.astype(np.float32),
        intensitymode="cell" if field.of_triangles else "vertex",
        cmin=low,
        cmax=high,
        colorscale={"RdBu_r": "RdBu_r", "viridis": "Viridis"}[field.colours],
        colorbar=bar,
        name=field.name,
        hoverinfo="skip",
        flatshading=False,
        lighting={"ambient": 0.7, "diffuse": 0.5, "specular": 0.05},
    )


def _document(title: str, drawn: str, report: Any) -> str:
    worst = "\n".join(
        f"{bad.what:32}{bad.number:10}   {bad.value:.4g}" for bad in report.worst(5)
    )
    name, numbers, listed = (html.escape(a) for a in (title, str(report), worst))
    return f"""<!DOCTYPE html>
<html lang="en"><head><meta charset="utf-8"><title>{name}</title>
<style>body {{ font-family: sans-serif; margin: 1em }} pre {{ font-size: 13px }}</style>
</head><body><h1>{name}</h1>
{drawn}
<h2>Numbers</h2><pre>{numbers}</pre>
<h2>The worst</h2><pre>{listed}</pre>
</body></html>
"""
