"""What a registration says of itself: where it folds, stretches, misses, is unsure."""

import json
from pathlib import Path
from typing import Any, NamedTuple

import equinox as eqx
import numpy as np
from jaxtyping import Float


class Bad(NamedTuple):
    """One of the worst places."""

    what: str
    number: int
    """Of a vertex or triangle of the source, of a vertex of the target, of a landmark."""
    value: float


class Certificate(eqx.Module):
    """Quality of a registration, vertex by vertex in the numbers of the source's mesh and
    in its units. `print` it, `write` it as JSON or CSV; `manireg.plot.certificate` and
    `manireg.plot.page` draw it."""

    agreement: Float[np.ndarray, " f"] | None
    """Cosine between the normal of each triangle on the target and the target's there;
    NaN of triangles without area. None of point clouds."""
    stretches: Float[np.ndarray, "n 2"]
    r"""Largest and smallest singular value of $d(\pi \circ \Psi)$ on $T_xM$: by how much
    lengths grow."""
    radius95: Float[np.ndarray, " n"] | None
    r"""The longer semi-axis of the region that holds the true place with 95 %: of the
    map's posterior, with the variance that left-out landmarks have about it,
    $\hat\sigma^2 = \frac1{ln} \sum_i r_i^\top (1 - h_{ii})^{-1} r_i$ (where maps go
    through nearly all data their own residuals say nothing). Too short where a lambda is
    given that is far larger than the one that predicts landmarks best: what it smooths
    away is not in it. Of a map fitted to the whole target (`surface=True`) the posterior
    given the last matches, times 4.1 (faces 1 to 7 of SIMPOP): errors of matches hang
    together. None for a map without its problem."""
    to_target: Float[np.ndarray, " n"]
    """Distance of each vertex to the target's triangles (or patches, of a cloud)."""
    from_target: Float[np.ndarray, " m"]
    """Distance of each vertex of the target to the registered triangles (or points):
    what the map leaves out. NaN of vertices that no triangle uses."""
    inverse_error: Float[np.ndarray, " n"] | None
    """Distance between each vertex and where the map back sends its image. None where
    the map back was not given."""
    left_out: Float[np.ndarray, " l"] | None
    """What each landmark would miss if left out. None where the map was fitted to more
    than landmarks."""
    matched: float | None
    """Share of the source's area with a match on the target; None without a surface term.
    """
    vertices: Float[np.ndarray, "n 3"]

    @property
    def folded(self) -> np.ndarray:
        """Indices of the triangles that are turned over on the target."""
        seen = np.zeros(0) if self.agreement is None else self.agreement
        return np.flatnonzero(seen < 0)

    @property
    def collapsed(self) -> np.ndarray:
        """Indices of the triangles that have no area there."""
        seen = np.zeros(0) if self.agreement is None else self.agreement
        return np.flatnonzero(np.isnan(seen))

    def worst(self, count: int = 5) -> list[Bad]:
        """The `count` worst of each kind, the worst first."""
        kinds = (
            ("folded triangle", self.agreement, self.folded, 1),
            ("smallest stretch at vertex", self.stretches[:, 1], None, 1),
            ("largest stretch at vertex", self.stretches[:, 0], None, -1),
            ("95 % radius at vertex", self.radius95, None, -1),
            ("distance to target of vertex", self.to_target, None, -1),
            ("distance from target's vertex", self.from_target, None, -1),
            ("inverse error at vertex", self.inverse_error, None, -1),
            ("landmark left out", self.left_out, None, -1),
        )
        found = []
        for what, values, some, sign in kinds:
            if values is None:
                continue
            some = np.arange(len(values)) if some is None else some
            some = some[np.isfinite(values[some])]
            order = some[np.argsort(sign * values[some], kind="stable")[:count]]
            found += [Bad(what, int(i), float(values[i])) for i in order]
        return found

    def numbers(self) -> dict[str, Any]:
        """All that is one number; None where it is not known."""
        triangles = None if self.agreement is None else len(self.agreement)
        return {
            "vertices": len(self.vertices),
            "triangles": triangles,
            "folded triangles": None if triangles is None else len(self.folded),
            "collapsed triangles": None if triangles is None else len(self.collapsed),
            "largest stretch": _spread(self.stretches[:, 0]),
            "smallest stretch": _spread(self.stretches[:, 1]),
            "distance to target": _spread(self.to_target),
            "distance from target": _spread(self.from_target),
            "inverse error": _spread(self.inverse_error),
            "landmark left out": _spread(self.left_out),
            "95 % radius": _spread(self.radius95),
            "matched share": self.matched,
        }

    def write(self, file: str | Path) -> Path:
        """JSON: `numbers()`, the folded triangles and the worst of each kind. CSV: a row
        for each vertex. The ending of `file` chooses."""
        path = Path(file)
        if path.suffix.lower() == ".csv":
            path.write_text(self._table())
        elif path.suffix.lower() == ".json":
            worst = [bad._asdict() for bad in self.worst()]
            text = {**self.numbers(), "folded": self.folded.tolist(), "worst": worst}
            path.write_text(json.dumps(text, indent=1, allow_nan=False))
        else:
            raise ValueError(f"report: expected .json or .csv, found {path.name!r}.")
        return path

    def fields(self) -> dict[str, Float[np.ndarray, " n"]]:
        """Those that are known at each vertex, by name."""
        named = {
            "largest stretch": self.stretches[:, 0],
            "smallest stretch": self.stretches[:, 1],
            "95 % radius": self.radius95,
            "distance to target": self.to_target,
            "inverse error": self.inverse_error,
        }
        return {name: field for name, field in named.items() if field is not None}

    def _table(self) -> str:
        import pandas as pd

        columns = {f"{axis}": self.vertices[:, i] for i, axis in enumerate("xyz")}
        named = {name.replace(" ", "_"): a for name, a in self.fields().items()}
        named = {name.replace("95_%_", "95_"): a for name, a in named.items()}
        return pd.DataFrame({**columns, **named}).to_csv(index_label="vertex")

    def __str__(self) -> str:
        lines = []
        for name, value in self.numbers().items():
            if isinstance(value, dict):
                value = ", ".join(
                    f"{key} {number:.3g}" for key, number in value.items()
                )
            if value is not None:
                lines.append(f"{name:22}{value}")
        return "\n".join(lines)


def _spread(values) -> dict[str, float] | None:
    """Least, mean, 95 % and most of what is finite."""
    if values is None or not np.any(np.isfinite(values)):
        return None
    known = values[np.isfinite(values)]
    most = np.quantile(known, [0, 0.05, 0.5, 0.95, 1])
    named = dict(zip(("least", "5 %", "median", "95 %", "most"), most, strict=True))
    return {name: float(value) for name, value in named.items()} | {
        "mean": float(known.mean())
    }
