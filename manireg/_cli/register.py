"""`manireg register`."""

import time
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Annotated, Literal

import numpy as np
import typer

import manireg as mr

from .. import plot
from ..datasets._text_tables import read_text_table
from ..meshes import write_mesh
from .batch import onto_folder
from .certificate import check_report, write_report
from .columns import has, numbers
from .errors import check_written, clean_errors
from .report import print_rows

WITH_SURFACE = {"yes": True, "no": False, "auto": "auto"}


def register(
    source: Annotated[Path, typer.Argument(help="Mesh: PLY, OBJ, STL, ...")],
    target: Annotated[
        Path, typer.Argument(help="Mesh to map it onto, or a folder of them.")
    ],
    landmarks: Annotated[
        Path | None,
        typer.Option(
            help="Of the source: .mrk.json or .fcsv (3D Slicer), .pp (MeshLab), .tps or "
            "CSV (`name` and `x,y,z` or `vertex`). Without --target-landmarks a CSV "
            "with a row for each pair: columns `source,target` hold vertex numbers of the "
            "files (from 0), or `sx,sy,sz,tx,ty,tz` positions."
        ),
    ] = None,
    target_landmarks: Annotated[
        Path | None,
        typer.Option(help="Of the target, matched by name; or a folder of them."),
    ] = None,
    out: Annotated[
        Path, typer.Option(help="The registered mesh: source triangles on the target.")
    ] = Path("registered.ply"),
    picture: Annotated[
        Path | None, typer.Option(help="Source, morph and distortion: PNG, PDF or SVG.")
    ] = None,
    morph: Annotated[
        float | None,
        typer.Option(help="Also write the morph at this share, 0.5 is half way."),
    ] = None,
    report: Annotated[
        Path | None,
        typer.Option(
            help="Folds, stretches, distances, 95 % radii: .json (numbers and the worst "
            "places) or .csv (a row for each vertex)."
        ),
    ] = None,
    page: Annotated[
        Path | None,
        typer.Option(help="The same as a page to turn in a browser: .html, offline."),
    ] = None,
    inverse: Annotated[
        bool,
        typer.Option(
            "--inverse", help="For the report: also map the target back, and compare."
        ),
    ] = False,
    surface: Annotated[
        Literal["yes", "no", "auto"],
        typer.Option(
            help="`yes`: go on from the landmarks to the whole target, by places that are "
            "near in position and normal. `auto`: where that predicts left-out landmarks "
            "better."
        ),
    ] = "no",
    align: Annotated[
        bool,
        typer.Option(
            "--align",
            help="Without landmarks: brought near the target by shape alone, then "
            "`--surface yes`. Much less sure than five landmarks.",
        ),
    ] = False,
    no_folds: Annotated[
        bool,
        typer.Option(
            "--no-folds", help="Raise lambda until no triangle is folded over."
        ),
    ] = False,
    lam: Annotated[
        float | None,
        typer.Option(help="Lambda. Default: chosen by leaving out landmarks."),
    ] = None,
    geometry: Annotated[
        list[str],
        typer.Option(
            help="`ambient` (stiff) or `intrinsic` (bends freely). Given twice: what "
            "predicts left-out landmarks best."
        ),
    ] = ["ambient"],
    centres: Annotated[
        list[int], typer.Option(min=20, help="Local polynomials; several: as above.")
    ] = [400],
    tension: Annotated[
        list[float],
        typer.Option(
            min=0,
            help="Of the ambient energy; 0 where surfaces bend far. Several: as above.",
        ),
    ] = [1.0],
    transfer: Annotated[
        Path | None,
        typer.Option(
            help="With a folder: points of the source to carry to every scan."
        ),
    ] = None,
    shard: Annotated[
        str, typer.Option(help="With a folder: `3/16` does the third of 16 parts.")
    ] = "1/1",
) -> None:
    """Map one scanned surface onto another from a few landmarks.

    Example: `manireg register mean.ply anna.ply --landmarks mean.mrk.json
    --target-landmarks anna.mrk.json --picture anna.png --morph 0.5`. Every vertex of the
    source gets its place on the target. Meshes of 20,000 vertices take some minutes, most
    of them for the choice of lambda.

    Onto many: `manireg register mean.ply scans --landmarks landmarks --out results`, with
    folders of meshes and of landmark files of the same names. A call that was killed goes
    on where it was; `--shard` is for job arrays.
    """
    rounds = WITH_SURFACE["yes" if align else surface]
    if target.is_dir():
        options = {"geometry": geometry, "centres": centres, "tension": tension}
        options |= {"lam": lam, "transfer": transfer}
        options |= {"surface": rounds, "no_folds": no_folds}
        with clean_errors():
            alone = picture, morph, report, page
            if inverse or any(option is not None for option in alone):
                raise ValueError(
                    "--picture, --morph, --report, --page, --inverse: only for a single "
                    "target."
                )
            if landmarks is None or align:
                raise ValueError("--landmarks: a folder of them is needed, no --align.")
            files = source, target, landmarks, target_landmarks, out
            whole = onto_folder(*files, shard, **options)
        raise typer.Exit(0 if whole else 1)
    with clean_errors():
        if transfer is not None or shard != "1/1":
            raise ValueError("--transfer, --shard: only for a folder of targets.")
        check_written(picture, out)
        check_report(report, page, inverse)
        marks = None if align else _landmarks(landmarks, target_landmarks)
        if align and (landmarks, target_landmarks) != (None, None):
            raise ValueError("--align: without landmarks, which know better.")
        surfaces = [mr.load_surface(file) for file in (source, target)]
        for file, loaded in zip((source, target), surfaces):
            typer.echo(f"{file}: {loaded.report}")
        start = time.perf_counter()
        fit = partial(
            mr.register,
            lam=lam,
            geometry=geometry,
            centres=centres,
            tension=tension,
            surface=rounds,
            no_folds=no_folds,
        )
        found = _onto(fit, surfaces, marks)
        seconds = time.perf_counter() - start
        written = [write_mesh(found.mesh(), out)]
        if morph is not None:
            path = out.with_stem(f"{out.stem}_morph")
            written.append(write_mesh(found.mesh(morph), path))
        if picture is not None:
            plot.save(
                plot.registration(found, 0.5 if morph is None else morph), picture
            )
            written.append(picture)
        rows = {}
        if found.cv is not None:
            rows["lambda"] = f"{float(found.cv.lam):.3g} (landmarks left out)"
            rows["error of a left-out landmark"] = f"{float(found.cv.score):.3g}"
        if found.held_out is not None:
            alone, whole = (float(e.mean()) for e in found.held_out[:2])
            kept = "the surface" if found.held_out.surface_is_better else "landmarks"
            rows["left out in fifths"] = (
                f"{alone:.3g} by landmarks, {whole:.3g} by the surface: {kept} kept"
            )
        errors = found.landmark_errors
        if len(errors):
            worst = found.landmark_names[errors.argmax()]
            rows["landmark errors"] = (
                f"{errors.mean():.3g}, at most {errors.max():.3g} ({worst})"
            )
        low, high = np.percentile(found.stretch(), [5, 95])
        rows["area on target / source"] = f"{low:.2f} to {high:.2f} (90 %)"
        rows["time"] = f"{seconds:.0f} s"
        if report is not None or page is not None:
            back = None
            if inverse:
                back = _onto(fit, surfaces[::-1], marks and marks[::-1])
            more, files = write_report(found, found.report(back), report, page)
            rows |= more
            written += files
        print_rows(rows, written)


def _onto(fit: Callable, surfaces: list[mr.Surface], marks: tuple | None):
    if marks is None:
        return fit(*surfaces, start=mr.align(*surfaces))
    return fit(*surfaces, *marks)


def _landmarks(ours: Path | None, theirs: Path | None) -> tuple:
    if ours is None:
        raise ValueError("--landmarks: needed, or --align to do without.")
    if theirs is None:
        return tuple(_read_pairs(ours))
    return mr.read_landmarks(ours), mr.read_landmarks(theirs)


def _read_pairs(file: Path):
    table, option = read_text_table(file), "--landmarks"
    if has(table, "source", "target"):
        pairs = numbers(table, ["source", "target"], option)
        whole = pairs.astype(int)
        bad = np.flatnonzero(np.any(whole != pairs, axis=1))
        if len(bad):
            raise ValueError(
                f"--landmarks: vertex numbers are whole, but row {bad[0] + 1} of {file} "
                f"has {' and '.join(map(repr, pairs[bad[0]].tolist()))}."
            )
        return whole.T
    both = numbers(table, ["sx", "sy", "sz", "tx", "ty", "tz"], option)
    return both[:, :3], both[:, 3:]
