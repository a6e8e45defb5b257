"""`manireg register` with a folder of targets."""

import re
from pathlib import Path

import typer

import manireg as mr

from .report import print_rows


def onto_folder(
    template: Path,
    folder: Path,
    landmarks: Path,
    target_landmarks: Path | None,
    out: Path,
    shard: str,
    **options,
) -> bool:
    """Whether no scan was passed over."""
    part = re.fullmatch(r"(\d+)/(\d+)", shard)
    if part is None:
        raise ValueError(f"--shard: expected for instance 3/16, found {shard!r}.")
    of_scans = landmarks if target_landmarks is None else target_landmarks
    if not of_scans.is_dir():
        raise ValueError(
            f"{of_scans}: expected a folder of landmarks, as {folder} is one of scans."
        )
    batch = mr.register_folder(
        template,
        folder,
        of_scans,
        out.with_suffix("") if out.suffix.lower() == ".ply" else out,
        template_landmarks=None if landmarks.is_dir() else landmarks,
        shard=(int(part[1]), int(part[2])),
        tell=typer.echo,
        **options,
    )
    rows = {"scans done": str(len(batch.done))}
    if batch.failed:
        rows["passed over"] = ", ".join(batch.failed)
    if batch.waiting:
        rows["of other shards"] = str(len(batch.waiting))
    written = [
        batch.out / name for name in ("quality.csv", "vertices.npz", "shapes.npz")
    ]
    print_rows(rows, [path for path in written if path.is_file()])
    return not batch.failed
