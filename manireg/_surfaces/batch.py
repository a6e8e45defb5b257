"""One template onto many scans: files in, files out, over several calls if need be."""

import json
import time
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from ..manifolds._scans.surface import Surface
from ..meshes import write_mesh
from .batch_files import (
    Scan,
    fcsv,
    fingerprint,
    landmarks_of,
    scans_in,
    shard_of,
    whole,
)
from .folds import agreement
from .given import given_surface
from .landmarks import Landmarks, read_landmarks
from .placing import placed
from .register import Registration, register
from .shapes import shape_space

VERSION = 2  # of what is kept of a scan


class Batch(NamedTuple):
    """What a folder of results holds."""

    out: Path
    done: tuple[str, ...]
    failed: dict[str, str]
    """Why, for each scan passed over."""
    waiting: tuple[str, ...]
    """Scans of other shards without a result yet."""


class Template(NamedTuple):
    surface: Surface
    landmarks: Landmarks
    files: list[Path]
    transfer: Landmarks | None


def register_folder(
    template: str | Path,
    folder: str | Path,
    landmarks: str | Path,
    out: str | Path,
    lam: float | None = None,
    *,
    template_landmarks: str | Path | None = None,
    transfer: str | Path | None = None,
    shard: tuple[int, int] = (1, 1),
    tell: Callable[[str], Any] = print,
    **options,
) -> Batch:
    """`register` a template onto every mesh in a folder.

    **Arguments:**

    - `template`: file of the mesh whose triangles all results have.
    - `folder`: of the scans; the template itself may be among them.
    - `landmarks`: folder of files for `read_landmarks`, with the names of the scans.
    - `out`: folder of the results, made if it is not there.
    - `lam`: as in `register`, and so are other `options` (`geometry`, `centres`, ...).
    - `template_landmarks`: default the file in `landmarks` with the name of the template.
    - `transfer`: a file of points of the template to be carried to every scan.
    - `shard`: (k, n), k from 1: only every n-th scan from the k-th on, for n jobs.
    - `tell`: what is done with a line about each scan.

    In `out` there are `meshes/NAME.ply`, the template's triangles on each scan;
    `points/NAME.fcsv`, with `transfer`; `vertices.npz` with `names` and `vertices
    (n, V, 3)`; `quality.csv`, a row a scan; `shapes.npz`, the mean, principal components
    and scores after Procrustes superimposition (see `ShapeSpace`); `scans/`, by which a
    later call knows what is done. Files are written whole or not at all: a call that was
    killed goes on where it was, and scans, landmarks or options that changed are done
    again. A scan that fails is told, and passed over; the next call tries it again.

        mr.register_folder("mean.ply", "scans", "landmarks", "results")

    **Raises** ValueError for a template that cannot be registered from, a folder without
    meshes, a `shard` that is none.
    """
    template, folder, landmarks, out = map(Path, (template, folder, landmarks, out))
    todo = scans_in(folder, landmarks, template)
    mine = shard_of(todo, shard)
    given = _template(template, landmarks, template_landmarks, transfer)
    for name in ("meshes", "scans", *(["points"] if given.transfer else [])):
        (out / name).mkdir(parents=True, exist_ok=True)
    for number, scan in enumerate(mine, 1):
        line = f"{number} of {len(mine)}: {scan.name}"
        tell(f"{line}: {_one(given, scan, out, lam, options)}")
    marks = {scan.name: _mark(given, scan, lam, options) for scan in todo}
    return _collect(out, marks, given.surface)


def _template(path: Path, landmarks: Path, of_template, transfer) -> Template:
    marks = landmarks_of(path.stem, landmarks) if of_template is None else of_template
    if marks is None:
        raise ValueError(
            f"template: {landmarks} has no landmarks called {path.stem!r}; give "
            "`template_landmarks`."
        )
    files, points = [path, Path(marks)], None
    surface = given_surface("template", path)
    if transfer is not None:
        files.append(Path(transfer))
        points = read_landmarks(transfer)
        points = _on_template(points, placed("transfer", points, surface), surface)
    return Template(surface, read_landmarks(marks), files, points)


def _on_template(points: Landmarks, positions, surface: Surface) -> Landmarks:
    """In the coordinates of the mesh; "LPS" or "RAS" is what that makes of them."""
    system = points.system
    if system is not None and points.positions is not None:
        away = np.linalg.norm(points.positions - positions, axis=1)
        if np.median(away) > 0.02 * surface.size:
            system = {"LPS": "RAS", "RAS": "LPS"}[system]
    return Landmarks(points.names, positions, None, system, points.named)


def _one(template: Template, scan: Scan, out: Path, lam, options) -> str:
    kept, failed = (
        out / "scans" / f"{scan.name}.npz",
        out / "scans" / f"{scan.name}.txt",
    )
    try:
        if scan.landmarks is None:
            raise ValueError(f"there are no landmarks called {scan.name!r}.")
        mark = _mark(template, scan, lam, options)
        if _kept_mark(kept) == mark:
            return "done before"
        start = time.perf_counter()
        with warnings.catch_warnings(record=True) as said:
            warnings.simplefilter("always", UserWarning)
            found = register(
                template.surface,
                scan.mesh,
                template.landmarks,
                read_landmarks(scan.landmarks),
                lam,
                **{"progress": False, **options},
            )
        row = _quality(found, time.perf_counter() - start)
        notes = dict.fromkeys(
            str(w.message) for w in said if issubclass(w.category, UserWarning)
        )
        row["notes"] = " | ".join(notes)
        _write(template, scan, out, found)
        with whole(kept) as path:
            np.savez(path, vertices=found.vertices, row=json.dumps(row), mark=mark)
        failed.unlink(missing_ok=True)
    except Exception as error:  # of any file that is not what it should be
        message = " ".join(str(error).split()) or type(error).__name__
        kept.unlink(missing_ok=True)
        with whole(failed) as path:
            path.write_text(message)
        return f"failed. {message}"
    return f"landmark error {row['landmark_error']:.3g}, {row['seconds']:.0f} s"


def _mark(template: Template, scan: Scan, lam, options) -> str:
    marks = [] if scan.landmarks is None else [scan.landmarks]
    files = [*template.files, scan.mesh, *marks]
    return fingerprint(files, VERSION, lam, sorted(options.items()))


def _kept_mark(kept: Path) -> str | None:
    if not kept.is_file():
        return None
    with np.load(kept) as found:
        return str(found["mark"])


def _write(template: Template, scan: Scan, out: Path, found: Registration) -> None:
    if template.surface.faces is not None:
        with whole(out / "meshes" / f"{scan.name}.ply") as path:
            write_mesh(found.mesh(), path)
    if template.transfer is not None:
        carried = np.asarray(found.model(template.transfer.positions))
        with whole(out / "points" / f"{scan.name}.fcsv") as path:
            path.write_text(fcsv(template.transfer, carried))


def _quality(found: Registration, seconds: float) -> dict[str, Any]:
    errors = found.landmark_errors
    low = high = folded = np.nan
    if found.faces is not None:
        low, high = np.percentile(found.stretch(), [5, 95])
        turned = agreement(found.vertices, found.faces, found.target.cloud)
        folded = int(np.sum(turned < 0))
    return {
        "landmarks": len(errors),
        "lambda": float(found.model.lam),
        "landmark_error": float(errors.mean()),
        "largest_landmark_error": float(errors.max()),
        "worst_landmark": found.landmark_names[int(errors.argmax())],
        "left_out_error": np.nan if found.cv is None else float(found.cv.score),
        "area_ratio_5": float(low),
        "area_ratio_95": float(high),
        "folded_triangles": folded,
        "seconds": float(seconds),
    }


def _collect(out: Path, marks: dict[str, str], template: Surface) -> Batch:
    """From what is there of all shards, with the marks of this call."""
    import pandas  # slow to import

    rows, vertices, failed, waiting = [], {}, {}, []
    for name, mark in marks.items():
        kept, bad = (out / "scans" / f"{name}.{end}" for end in ("npz", "txt"))
        if _kept_mark(kept) == mark:
            with np.load(kept) as found:
                vertices[name] = found["vertices"]
                rows.append({"scan": name, **json.loads(str(found["row"]))})
        elif bad.is_file():
            failed[name] = bad.read_text()
            rows.append({"scan": name, "error": failed[name]})
        else:
            waiting.append(name)
    with whole(out / "quality.csv") as path:
        pandas.DataFrame(rows).to_csv(path, index=False)
    if vertices:
        stack, names = np.stack(list(vertices.values())), np.array(list(vertices))
        faces = np.zeros((0, 3), int) if template.faces is None else template.faces
        with whole(out / "vertices.npz") as path:
            np.savez(path, names=names, vertices=stack, faces=faces)
        if len(stack) > 1:
            with whole(out / "shapes.npz") as path:
                np.savez(path, names=names, **shape_space(stack)._asdict())
    return Batch(out, tuple(vertices), failed, tuple(waiting))
