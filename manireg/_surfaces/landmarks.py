"""Named points of a surface, as files keep them."""

import os
from collections.abc import Sequence
from pathlib import Path

import equinox as eqx
import numpy as np
from jaxtyping import ArrayLike, Float, Int

from .._input.numbers import as_numbers
from .landmark_files import FoundLandmarks, read_fcsv, read_markups, read_pp, read_tps
from .landmark_tables import read_table

READERS = {".json": read_markups, ".fcsv": read_fcsv, ".pp": read_pp}


class Landmarks(eqx.Module):
    """Points of a surface by position or by vertex number: what `read_landmarks` returns
    and `register` takes."""

    names: tuple[str, ...] = eqx.field(static=True)
    positions: Float[np.ndarray, "l 3"] | None
    vertices: Int[np.ndarray, " l"] | None
    """Numbers of vertices, from 0, in place of positions."""
    system: str | None = eqx.field(static=True, default=None)
    """"LPS" or "RAS" where the file says so: x and y have opposite signs in them."""
    named: bool = eqx.field(static=True, default=True)
    """Whether names are given, not counted."""
    missing: tuple[str, ...] = eqx.field(static=True, default=())
    """Names without a place."""
    origin: str = eqx.field(static=True, default="")
    """The file they are from."""

    def __check_init__(self):
        if (self.positions is None) == (self.vertices is None):
            raise ValueError("Landmarks: give positions, or vertex numbers.")
        if len(self.names) != len(self):
            raise ValueError(
                f"Landmarks: {len(self.names)} names, but {len(self)} places."
            )

    def __len__(self) -> int:
        places = self.positions if self.vertices is None else self.vertices
        assert places is not None
        return len(places)

    def take(self, index: Sequence[int]) -> "Landmarks":
        """Those at `index`."""
        index = list(index)
        part = lambda a: None if a is None else a[index]
        return Landmarks(
            tuple(self.names[i] for i in index),
            part(self.positions),
            part(self.vertices),
            self.system,
            self.named,
            self.missing,
            self.origin,
        )


LandmarksLike = Landmarks | str | os.PathLike | ArrayLike


def read_landmarks(
    file: str | os.PathLike, *, specimen: str | int | None = None
) -> Landmarks:
    r"""The landmarks in a file.

    **Arguments:**

    - `file`: `.mrk.json` or `.fcsv` (3D Slicer: names, and whether x and y are LPS or
      RAS), `.pp` (MeshLab), `.tps` (three coordinates; names are numbers from 1), or a
      table: columns `x, y, z`, or `vertex` with numbers from 0, and perhaps `name`; or the
      same without a header: three numbers a row, or one.
    - `specimen`: of a `.tps` file of several, the `ID` or the number from 0.

    Points that a file lists without a place (undefined in Slicer, switched off in MeshLab,
    `NA`) are in `.missing`.

        landmarks = mr.read_landmarks("skull.mrk.json")
        landmarks.names, landmarks.positions

    **Raises** ValueError for a file that is not what its name says, that has no points, or
    points of two dimensions; FileNotFoundError.

    **Example:**

    ```python
    Path("two.csv").write_text("name,x,y,z\nnose,1,2,3\nchin,1,0,3\n")
    mr.read_landmarks("two.csv").names  # ('nose', 'chin')
    ```
    """
    path = Path(file).expanduser()
    if not path.is_file():
        raise FileNotFoundError(f"{path}: there is no such file.")
    suffix = path.suffix.lower()
    if specimen is not None and suffix != ".tps":
        raise ValueError(f"specimen: only for .tps files, found {path.name}.")
    if suffix == ".tps":
        found = read_tps(path, specimen)
    else:
        found = READERS.get(suffix, read_table)(path)
    return _landmarks(path, found)


def _landmarks(path: Path, found: FoundLandmarks) -> Landmarks:
    there = [i for i, place in enumerate(found.places) if place is not None]
    if not there:
        raise ValueError(f"{path}: holds no landmarks with a place.")
    names = found.names
    named = names is not None and not (len(set(names)) == 1 and len(names) > 1)
    if names is None or not named:
        names = [str(i + 1) for i in range(len(found.places))]
    places = np.array([found.places[i] for i in there])
    by_number = places.ndim == 1
    return Landmarks(
        tuple(names[i] for i in there),
        None if by_number else places.astype(float),
        places.astype(int) if by_number else None,
        found.system,
        named,
        tuple(names[i] for i in range(len(names)) if i not in there),
        str(path),
    )


def as_landmarks(name: str, given: LandmarksLike) -> Landmarks:
    """Of a file, or an array: vertex numbers `(l,)` or positions `(l, 3)`."""
    if isinstance(given, Landmarks):
        return given
    if isinstance(given, str | os.PathLike):
        return read_landmarks(given)
    array = np.asarray(given)
    names = tuple(map(str, range(len(array)))) if array.ndim else ()
    if array.ndim == 1 and array.dtype.kind in "iu":
        return Landmarks(names, None, array.astype(int), named=False)
    if array.ndim == 2 and array.shape[1] == 3:
        positions = as_numbers(name, given)
        return Landmarks(names, positions, None, named=False)
    raise ValueError(
        f"{name}: expected vertex numbers (l,) or positions (l, 3), found shape "
        f"{array.shape} of {array.dtype}."
    )
