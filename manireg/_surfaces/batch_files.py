"""Files of a batch: what belongs together, what is done, and never half a file."""

import contextlib
import hashlib
import os
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

from .landmarks import Landmarks

MESHES = (".ply", ".obj", ".stl", ".off", ".glb", ".gltf", ".xyz")
LANDMARKS = (".mrk.json", ".json", ".fcsv", ".pp", ".tps", ".csv", ".txt")
PART = ".part-"  # how files begin that are being written


class Scan(NamedTuple):
    name: str
    mesh: Path
    landmarks: Path | None


def scans_in(folder: Path, landmarks: Path, template: Path | None) -> list[Scan]:
    """The meshes in a folder, in the order of their names, each with the file of landmarks
    that has its name; without the template.

    **Raises** ValueError for no meshes, or two of one name."""
    meshes = [
        path
        for path in sorted(folder.iterdir())
        if path.suffix.lower() in MESHES and not path.name.startswith(".")
    ]
    if template is not None:
        meshes = [path for path in meshes if not path.samefile(template)]
    if not meshes:
        raise ValueError(f"{folder}: holds no meshes ({', '.join(MESHES)}).")
    names = [path.stem for path in meshes]
    twice = sorted({name for name in names if names.count(name) > 1})
    if twice:
        raise ValueError(f"{folder}: two meshes are called {twice[0]!r}; rename one.")
    return [Scan(m.stem, m, landmarks_of(m.stem, landmarks)) for m in meshes]


def landmarks_of(name: str, folder: Path) -> Path | None:
    """The file of landmarks of this name."""
    paths = (folder / f"{name}{suffix}" for suffix in LANDMARKS)
    return next((path for path in paths if path.is_file()), None)


def shard_of(scans: list[Scan], shard: tuple[int, int]) -> list[Scan]:
    """Every n-th scan, from the k-th on, for shard (k, n), k from 1."""
    k, n = shard
    if not 1 <= k <= n:
        raise ValueError(f"shard: expected k of n with 1 <= k <= n, found {k} of {n}.")
    return scans[k - 1 :: n]


@contextlib.contextmanager
def whole(path: Path) -> Iterator[Path]:
    """A name to write under, which becomes `path` once all is written."""
    part = path.with_name(f"{PART}{os.getpid()}-{path.name}")
    try:
        yield part
        os.replace(part, path)
    finally:
        part.unlink(missing_ok=True)


def fingerprint(files: list[Path], *settings) -> str:
    """Of the contents of files and of settings: work that has it is done."""
    digest = hashlib.sha256(repr(settings).encode())
    for path in files:
        digest.update(hashlib.sha256(path.read_bytes()).digest())
    return digest.hexdigest()


def fcsv(landmarks: Landmarks, positions) -> str:
    """As 3D Slicer reads it."""
    head = [
        "# Markups fiducial file version = 5.0",
        f"# CoordinateSystem = {landmarks.system or 'LPS'}",
        "# columns = id,x,y,z,ow,ox,oy,oz,vis,sel,lock,label,desc,associatedNodeID",
    ]
    rows = [
        f'{i + 1},{x!r},{y!r},{z!r},0,0,0,1,1,1,0,"{name}",,'
        for i, (name, (x, y, z)) in enumerate(
            zip(landmarks.names, positions.tolist(), strict=True)
        )
    ]
    return "\n".join([*head, *rows, ""])
