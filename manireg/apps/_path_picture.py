"""The picture of a path of poles: where it is, and how fast it went."""

from typing import Any

import numpy as np
from scipy.stats import norm

from ..datasets._tables import directions, unit
from ..plot._band import spread_along
from ..plot._figure import GREY, STYLE, figure, matplotlib
from ..plot._globe import Globe, globe, view_of

DARK = "#33373c"
MANY = 150  # poles, whose circles are drawn as lines alone
LINE = 600  # ages along the path
BAND = 200
NARROW = 0.95  # radians from the middle: less is enlarged
MARKS = 6  # ages that are named, about
STEPS = np.array([1.0, 2.0, 5.0, 10.0, 20.0, 50.0, 100.0, 200.0, 500.0])


def draw(path: Any, projection: str, level: float) -> Any:
    """Of a `PolePath`. **Raises** ValueError for other projections."""
    if projection not in ("globe", "polar"):
        raise ValueError(
            f"projection: expected 'globe' or 'polar', found {projection!r}."
        )
    with matplotlib().rc_context(STYLE):
        from matplotlib.cm import ScalarMappable
        from matplotlib.colors import ListedColormap, Normalize

        poles = path.poles
        first, last = (f([*path.ages, *poles.age]) for f in (np.min, np.max))
        ages = np.linspace(first, last, LINE)
        line = unit(path.model(ages))
        known = np.isfinite(path.posterior.scale)
        rims = None
        if known:
            at = spread_along(ages, line, BAND)
            rims = np.asarray(path.posterior.region(at, level).outline())
        dark = ListedColormap(matplotlib().colormaps["viridis"](range(236)))
        colour = ScalarMappable(Normalize(first, last), dark)
        picture = figure(3.5, 4.5)
        above, below = picture.subplots(2, 1, height_ratios=[3.0, 1.0])
        drawn = _background(path, above, projection, line, rims)
        _draw_poles(drawn, poles, colour)
        if rims is not None:
            drawn.band(rims, GREY)
        drawn.path(line, "white", linewidths=3.0, zorder=4.9)
        drawn.path(line, colour.to_rgba(ages), linewidths=1.8)
        marks = _marks(first, last)
        if known and len(marks):
            for rim in np.asarray(path.posterior.region(marks, level).outline()):
                drawn.path(rim, DARK, linewidths=0.5, zorder=4.5)
        _name_ages(drawn, path.model, marks)
        bar = picture.colorbar(colour, ax=above, shrink=0.75, aspect=25, pad=0.03)
        bar.set_label("age (Ma)")
        bar.outline.set_linewidth(0.4)
        _draw_rate(path, below, ages, colour, level if known else None)
        return picture


def _background(path: Any, ax: Any, projection: str, line, rims) -> Globe:
    if projection == "polar":
        return _about_the_pole(path, ax, line, rims)
    view = view_of(np.concatenate([line, path.poles.directions]))
    off = _farthest(path.poles, line, rims, view)
    radius = 1.1 * np.sin(off) if off < NARROW else 1.0
    return globe(ax, view=view, radius=radius)


def _about_the_pole(path: Any, ax: Any, line, rims) -> Globe:
    view = np.array([0.0, 0.0, -1.0 if path.hemisphere == "south" else 1.0])
    tens = 10 * np.ceil(np.degrees(_farthest(path.poles, line, rims, view)) / 10)
    radius = float(np.sin(np.radians(tens))) if tens < 70 else 1.0
    step = 10 if tens < 35 else 30
    options: dict[str, Any] = {"graticule": step, "equal_area": True}
    drawn = globe(ax, view=view, radius=radius, **options)
    lons = np.arange(0, 360, 90)
    style = {"fontsize": 6, "color": GREY, "ha": "center", "va": "center"}
    rim = 1.11 * drawn.spread(np.array([[radius, 0.0]]))[0, 0]
    for lon, place in zip(lons, drawn.flatten(directions(0 * lons, lons))[0]):
        ax.text(*(rim * place), f"{lon}°", **style, clip_on=False)
    return drawn


def _farthest(poles: Any, line, rims, view: np.ndarray) -> float:
    """From `view`, in radians, of all that is drawn."""
    seen = line if rims is None else unit(rims.reshape(-1, 3))
    off = np.arccos(np.clip(poles.directions @ view, -1, 1))
    off += 0.0 if poles.a95 is None else np.radians(poles.a95)
    return float(max(off.max(), np.arccos(np.clip((seen @ view).min(), -1, 1))))


def _draw_poles(drawn: Globe, poles: Any, colour: Any) -> None:
    colours = colour.to_rgba(poles.age)
    many = len(poles.age) > MANY
    if poles.a95 is not None:
        style: dict[str, Any] = {}
        if many:
            style = {"facecolors": "none", "linewidths": 0.2}
        drawn.circles(poles.directions, poles.a95, colours, **style)
    # below the path, which many would hide
    style = {"zorder": 3.5} if many else {}
    size = 5 if many else 14
    drawn.points(poles.directions, colours, size, linewidths=0.3, **style)


def _marks(first: float, last: float) -> np.ndarray:
    """Ages to be named."""
    step = STEPS[np.argmin(np.abs(np.log((last - first) / MARKS / STEPS)))]
    ages = step * np.arange(np.ceil(first / step - 0.1), np.floor(last / step) + 1)
    return ages[ages >= first] + 0.0  # no -0


def _name_ages(drawn: Globe, model: Any, ages: np.ndarray) -> None:
    from matplotlib.patheffects import withStroke

    if len(ages) == 0:
        return
    points = unit(model(ages))
    drawn.points(points, DARK, 10, linewidths=0.5, zorder=7)
    places, near = drawn.flatten(points)
    halo = [withStroke(linewidth=1.6, foreground="white")]
    style = {"fontsize": 6, "color": DARK, "zorder": 9, "path_effects": halo}
    for age, place, seen in zip(ages, places, near, strict=True):
        if seen:
            offset = {"xytext": (4, 3), "textcoords": "offset points"}
            drawn.axes.annotate(f"{age:g}", place, **offset, **style)


def _draw_rate(path: Any, ax: Any, ages, colour: Any, level: float | None) -> None:
    at = ages[:: LINE // BAND]
    motion = path.posterior.sphere_motion(at)
    rate = np.degrees(motion.speed)
    if level is not None:
        reach = norm.ppf(0.5 + level / 2) * np.degrees(motion.speed_deviation)
        low, high = np.maximum(rate - reach, 0.0), rate + reach
        ax.fill_between(at, low, high, color=GREY, alpha=0.25, lw=0)
        ax.set_ylim(0, 1.05 * np.quantile(high, 0.98))
    ax.plot(at, rate, color=DARK, lw=1.2)
    poles = path.poles
    ticks = {"linewidths": 0.6, "transform": ax.get_xaxis_transform(), "clip_on": False}
    ax.vlines(poles.age, -0.05, 0, colors=colour.to_rgba(poles.age), **ticks)
    ax.tick_params(axis="x", pad=4)
    ax.set(xlabel="age (Ma), poles as ticks", ylabel="rate (°/Myr)", xlim=at[[0, -1]])
