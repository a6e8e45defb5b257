"""Globes, and curves on them."""

from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from jaxtyping import Float

from ..datasets._tables import directions, unit
from ._band import envelope
from ._figure import BLUE, GREY, ORANGE, ArrayLike, figure, figure_of

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
else:
    Axes = Figure = Any

DOT = 9.0  # area of a datum, in square points


class Globe(NamedTuple):
    """The unit sphere seen from far away: `axes` to draw on, and `turn`, whose rows are
    the directions right, up and towards the eye. What lies on the far side is pale.
    `equal_area`: each hemisphere by Lambert's projection, the rim where it was."""

    axes: Axes
    turn: Float[np.ndarray, "3 3"]
    equal_area: bool = False

    @property
    def figure(self) -> Figure:
        return figure_of(self.axes)

    def flatten(self, points: ArrayLike) -> tuple[np.ndarray, np.ndarray]:
        """Positions (n, 2) on the paper, and which points (n,) are on the near side."""
        points = np.asarray(points)
        turned = points / np.linalg.norm(points, axis=-1, keepdims=True) @ self.turn.T
        return self.spread(turned[..., :2]), turned[..., 2] >= 0

    def spread(self, place: np.ndarray) -> np.ndarray:
        """Orthographic positions (n, 2) as the projection has them."""
        if not self.equal_area:
            return place
        squared = np.clip(np.sum(place**2, axis=-1, keepdims=True), 0.0, 1.0)
        return place / np.sqrt(1 + np.sqrt(1 - squared))

    def points(
        self,
        points: ArrayLike,
        colours: Any = ORANGE,
        sizes: ArrayLike = DOT,
        **style: Any,
    ) -> None:
        """Dots at `points` (n, 3), in one colour or one each, likewise of one area."""
        place, near = self.flatten(points)
        colours = _colours(colours, len(place))
        sizes = np.broadcast_to(np.asarray(sizes, float), len(place))
        style = {"linewidths": 0.5, "edgecolors": "white", "zorder": 6} | style
        for side, own in ((near, {}), (~near, {"alpha": 0.3, "zorder": 1.5})):
            options = {"c": colours[side], "s": sizes[side]} | style | own
            self.axes.scatter(*place[side].T, **options)

    def path(self, points: ArrayLike, colours: Any = BLUE, **style: Any) -> None:
        """The line through `points` (n, 3), in one colour or one a point; dashed on the
        far side."""
        from matplotlib.collections import LineCollection

        points, colours = unit(points), _colours(colours, len(np.asarray(points)))
        step = np.linalg.norm(np.diff(points, axis=0), axis=-1)
        length = np.concatenate([[0.0], step.cumsum()])
        even = np.linspace(0, length[-1], 2 + int(length[-1] / 0.01))
        even_points, even_colours = (
            np.stack([np.interp(even, length, column) for column in columns.T], axis=-1)
            for columns in (points, colours)
        )
        place, near = self.flatten(even_points)
        segments = np.stack([place[:-1], place[1:]], axis=1)
        colours, near, dash = even_colours[:-1], near[:-1], even[:-1] % 0.05 < 0.03
        style = {"linewidths": 1.6, "capstyle": "round", "zorder": 5} | style
        lines = LineCollection(list(segments[near]), colors=colours[near], **style)
        self.axes.add_collection(lines, autolim=False)
        far = ~near & dash
        style |= {"alpha": 0.4, "zorder": 1, "capstyle": "butt"}
        lines = LineCollection(list(segments[far]), colors=colours[far], **style)
        self.axes.add_collection(lines, autolim=False)

    def band(
        self, outlines: Float[np.ndarray, "q m 3"], colours: Any = BLUE, **style: Any
    ) -> None:
        """The union of regions along a path, given by their rims in the order of the path,
        and of what lies between two of them, in one colour or one a region, mixed with
        white; paler on the far side."""
        from matplotlib.collections import PolyCollection

        colours = _colours(colours, len(outlines))
        for side, share, order in ((1.0, 0.35, 2.5), (-1.0, 0.12, 0.8)):
            turn = self.turn * [[1.0], [1.0], [side]]
            pieces = envelope(unit(outlines) @ turn.T)
            seen = [i for i, piece in enumerate(pieces) if len(piece)]
            # opaque: they overlap
            options = {"facecolors": pale(colours[seen], share), "linewidths": 0}
            options |= {"zorder": order} | style
            shapes = [self.spread(pieces[i]) for i in seen]
            band = PolyCollection(shapes, **options)
            self.axes.add_collection(band, autolim=False)

    def circles(
        self, centres: ArrayLike, radii: ArrayLike, colours: Any = GREY, **style: Any
    ) -> None:
        """Small circles of angular `radii` (n,) in degrees about `centres` (n, 3)."""
        from matplotlib.collections import PolyCollection

        centres, radii = unit(centres), np.radians(np.asarray(radii, np.float64))
        colours = _colours(colours, len(centres))
        angle = np.linspace(0, 2 * np.pi, 73)[:, None]
        outlines, near = [], []
        for centre, radius in zip(centres, radii, strict=True):
            e1, e2 = np.linalg.svd(centre[None])[2][1:]
            ring = np.cos(angle) * e1 + np.sin(angle) * e2
            place, front = self.flatten(np.cos(radius) * centre + np.sin(radius) * ring)
            outlines.append(place)
            near.append(front.mean() > 0.5)
        near = np.array(near, bool)
        for side, alpha, order in ((near, 1.0, 3), (~near, 0.3, 1)):
            shapes = [o for o, keep in zip(outlines, side, strict=True) if keep]
            fill, edge = colours[side].copy(), colours[side].copy()
            fill[:, 3], edge[:, 3] = 0.13 * alpha, 0.6 * alpha
            options = {"facecolors": fill, "edgecolors": edge, "linewidths": 0.5}
            polygons = PolyCollection(shapes, zorder=order, **(options | style))
            self.axes.add_collection(polygons, autolim=False)


def globe(
    ax: Axes | None = None,
    *,
    view: ArrayLike = (1.0, -1.0, 0.7),
    radius: float = 1.0,
    graticule: float | None = None,
    equal_area: bool = False,
) -> Globe:
    """An empty globe, seen from the direction `view` (3,) with the z axis upwards, with
    meridians and parallels every `graticule` degrees (0 for none, by default what suits
    the picture). `radius` < 1 shows only so much of the globe about its middle.
    `equal_area`: a hemisphere by Lambert's azimuthal projection in place of what the eye
    would see."""
    from matplotlib.patches import Circle

    ax = figure(3.0, 3.0).add_subplot() if ax is None else ax
    size = 1.02 if radius >= 1 else radius
    if equal_area and radius < 1:
        size = radius / np.sqrt(1 + np.sqrt(1 - radius**2))
    ax.set(xlim=(-size, size), ylim=(-size, size), aspect="equal", xticks=[], yticks=[])
    ax.spines[:].set(visible=radius < 1, color=GREY, lw=0.8)
    drawn = Globe(ax, _turn(unit(view)), equal_area)
    rim = ax.add_patch(Circle((0, 0), 1, fc="none", ec=GREY, lw=0.8, zorder=4))
    i = np.linspace(-1, 1, 300)
    depth = np.sqrt(np.clip(1 - i[:, None] ** 2 - i**2, 0, 1))
    shade = np.clip(0.86 + 0.14 * depth + 0.03 * (i[:, None] - i), 0, 1)
    shade = np.stack([0.97 * shade, 0.985 * shade, shade], axis=-1)
    image = ax.imshow(shade, extent=(-1, 1, -1, 1), origin="lower", zorder=0)
    image.set_clip_path(rim)
    ax.set(xlim=(-size, size), ylim=(-size, size))
    if graticule is None:
        graticule = 30 if radius > 0.5 else 10 if radius > 0.17 else 2
    if graticule:
        _draw_graticule(drawn, graticule)
        style = {"fontsize": 6, "color": GREY, "ha": "left", "va": "bottom"}
        where = {"transform": ax.transAxes, "clip_on": False, "zorder": 7}
        ax.text(0.01, 0.01, f"grid {graticule:g}°", **style, **where)
    return drawn


def _draw_graticule(drawn: Globe, step: float) -> None:
    from matplotlib.collections import LineCollection

    along = np.linspace(-180, 180, 721)
    meridians = [directions(along, 0 * along + a) for a in np.arange(0, 180, step)]
    parallels = [
        directions(0 * along + a, along) for a in np.arange(step - 90, 90, step)
    ]
    for piece in meridians + parallels:
        place, near = drawn.flatten(piece)
        segments = np.stack([place[:-1], place[1:]], axis=1)[near[:-1] & near[1:]]
        lines = LineCollection(list(segments), colors="#b4bac2", lw=0.4, zorder=2)
        drawn.axes.add_collection(lines, autolim=False)


def view_of(points: ArrayLike) -> Float[np.ndarray, "3"]:
    """The direction from which most of `points` (n, 3) lie well on the near side."""
    points = unit(points)
    mean = points.mean(0)
    if np.linalg.norm(mean) > 0.95:
        return unit(mean)
    i = np.arange(2000) + 0.5
    latitude = np.degrees(np.arcsin(1 - i / 1000))
    candidates = directions(latitude, 180 * (1 + np.sqrt(5)) * i)
    depth = candidates @ points.T
    score = (depth > 0.2) + np.minimum(depth, 0.5) + 0.1 * depth
    return candidates[np.argmax(score.mean(1))]


def _turn(view: np.ndarray) -> np.ndarray:
    """Rotation whose rows are right, up and `view`, with the z axis upwards."""
    up = (
        np.array([0.0, 0.0, 1.0]) if abs(view[2]) < 0.999 else np.array([0.0, 1.0, 0.0])
    )
    up = unit(up - up @ view * view)
    return np.stack([np.cross(up, view), up, view])


def _colours(colours: Any, n: int) -> np.ndarray:
    from matplotlib.colors import to_rgba_array

    return np.broadcast_to(to_rgba_array(colours), (n, 4))


def pale(colours: Float[np.ndarray, "n 4"], share: float) -> Float[np.ndarray, "n 4"]:
    """A `share` of them, the rest white; as opaque as they are."""
    return np.concatenate([1 - share * (1 - colours[:, :3]), colours[:, 3:]], axis=1)
