"""Maps, posteriors and registrations as files: arrays in an `.npz`, their structure as
JSON inside it. Nothing in a file is executed."""

import dataclasses
import functools
import importlib
import json
import math
import types
import zipfile
from collections.abc import Iterator
from importlib.metadata import version
from pathlib import Path
from typing import Any

import equinox as eqx
import jax
import numpy as np
import optimistix as optx
from jax.tree_util import Partial

from ._input.precision import check_x64

FORMAT = 1
STRUCTURE = "structure"  # name of the entry that holds the JSON
OURS = "manireg", "equinox", "optimistix", "lineax"  # of which a file may name parts


def save(value: eqx.Module, path: str | Path) -> None:
    """Writes a value whose class is ours to an `.npz` file."""
    writer = _Writer()
    structure = {
        "manireg": version("manireg"),
        "format": FORMAT,
        "value": writer.encoded(value),
    }
    arrays: dict[str, Any] = {STRUCTURE: np.array(json.dumps(structure))}
    with open(path, "wb") as file:
        np.savez_compressed(file, **arrays, **writer.arrays)  # pyright: ignore[reportArgumentType]


def load(path: str | Path, *own: Any) -> Any:
    """What `save` has written: a map, a posterior, a registration.

    **Arguments:** `path` of the file; `own`: the manifolds, sources, terms and functions
    of your own that it was made with, in any order.

    **Raises** ValueError in float32 mode (JAX forgets float64 from process to process),
    for files of another kind or of a later format, and where something of your own is
    missing or differs from what was saved.

    **Example:**

    ```python
    x = np.linspace(0, 1, 9)
    mr.fit(mr.Interval(0, 1), mr.Euclidean(1), x, x[:, None], 1.0).save("line.npz")
    line = mr.load("line.npz")
    line(0.5)  # 0.5000
    ```
    """
    check_x64()
    try:
        file = np.load(path, allow_pickle=False)
        structure = json.loads(str(file[STRUCTURE]))
        format = structure["format"]
    except (KeyError, TypeError, ValueError, zipfile.BadZipFile) as error:
        raise ValueError(
            f"load: {path} was not written by manireg's `save`."
        ) from error
    if format > FORMAT:
        raise ValueError(
            f"load: {path} has format {format}, written by manireg "
            f"{structure['manireg']}; this one reads formats up to {FORMAT}. Update it."
        )
    with file:
        return _Reader(file, own).decoded(structure["value"])


class _Writer:
    """Turns values into JSON, and keeps their arrays, shared ones once."""

    def __init__(self):
        self.arrays: dict[str, np.ndarray] = {}
        self.names: dict[int, str] = {}
        self.kept: list[Any] = []  # alive, so that no id is given twice

    def encoded(self, value: Any) -> Any:
        if value is None or isinstance(value, bool | int | str):
            return value
        if isinstance(value, float):
            return value if math.isfinite(value) else {"float": str(value)}
        if isinstance(value, jax.Array | np.ndarray | np.generic):
            kind = "jax" if isinstance(value, jax.Array) else "numpy"
            kind = "scalar" if isinstance(value, np.generic) else kind
            return {kind: self._array(value)}
        if isinstance(value, optx.RESULTS):  # pyright: ignore[reportArgumentType]
            return {"result": [self.encoded(leaf) for leaf in jax.tree.leaves(value)]}
        if isinstance(value, dict):
            pairs = value.items()
            return {"dict": [[self.encoded(k), self.encoded(v)] for k, v in pairs]}
        if type(value) in (tuple, list):
            return {type(value).__name__: [self.encoded(v) for v in value]}
        if isinstance(value, functools.partial):
            parts = value.func, value.args, value.keywords
            kind = "jax partial" if isinstance(value, Partial) else "partial"
            return {kind: [self.encoded(part) for part in parts]}
        return self._object(value)

    def _object(self, value: Any) -> Any:
        function = isinstance(value, types.FunctionType | type)
        named = value if function else type(value)
        if not _is_ours(named):
            arrays = [self._array(leaf) for leaf in _leaves(value)]
            return {"own": named.__qualname__, "arrays": arrays}
        name = f"{named.__module__}:{named.__qualname__}"
        if function:
            return {"name": name}
        fields = {k: self.encoded(v) for k, v in _fields(value)}
        return {"class": name, "fields": fields}

    def _array(self, value: Any) -> str:
        array = np.asarray(value)
        if array.dtype.hasobject:
            raise TypeError(f"save: an array of {array.dtype} cannot be written.")
        if id(value) not in self.names:
            self.names[id(value)] = name = f"a{len(self.arrays)}"
            self.arrays[name] = array
            self.kept.append(value)
        return self.names[id(value)]


class _Reader:
    """The way back."""

    def __init__(self, file: Any, own: tuple[Any, ...]):
        self.file, self.own = file, own
        self.known: dict[tuple[str, str], Any] = {}

    def decoded(self, value: Any) -> Any:
        if not isinstance(value, dict):
            return value
        [kind, content] = next(iter(value.items()))
        match kind:
            case "float":
                return float(content)
            case "jax" | "numpy" | "scalar":
                return self._array(kind, content)
            case "result":
                outcome = jax.tree.structure(optx.RESULTS.successful)
                return jax.tree.unflatten(outcome, map(self.decoded, content))
            case "dict":
                return {self.decoded(k): self.decoded(v) for k, v in content}
            case "tuple" | "list":
                parts = [self.decoded(v) for v in content]
                return tuple(parts) if kind == "tuple" else parts
            case "partial" | "jax partial":
                function, args, keywords = map(self.decoded, content)
                kind = Partial if kind == "jax partial" else functools.partial
                return kind(function, *args, **keywords)
            case "own":
                return self._own(content, value["arrays"])
            case "name":
                return _named(content)
            case "class":
                fields = {k: self.decoded(v) for k, v in value["fields"].items()}
                return _made(_named(content), fields)
        raise ValueError(f"load: unknown entry {kind!r}.")

    def _array(self, kind: str, name: str) -> Any:
        if (kind, name) not in self.known:
            array = self.file[name]
            array = jax.device_put(array) if kind == "jax" else array
            self.known[kind, name] = array[()] if kind == "scalar" else array
        return self.known[kind, name]

    def _own(self, name: str, arrays: list[str]) -> Any:
        alike = [o for o in self.own if _name_of(o) == name]
        if not alike:
            raise ValueError(
                f"load: the file was made with {name}, which is not part of manireg; give "
                f"it again: mr.load(path, {name}(...)) with the arguments it had."
            )
        saved = [self.file[a] for a in arrays]
        for value in alike:
            leaves = [np.asarray(leaf) for leaf in _leaves(value)]
            if len(leaves) == len(saved) and all(map(np.array_equal, leaves, saved)):
                return value
        raise ValueError(
            f"load: the {name} given differs from the one saved; give it with the "
            f"arguments it had (arrays saved: {[a.tolist() for a in saved]!r:.200})."
        )


def _fields(value: Any) -> Iterator[tuple[str, Any]]:
    if isinstance(value, tuple):
        yield from zip(value._fields, value, strict=True)  # pyright: ignore
    elif dataclasses.is_dataclass(value):
        for field in dataclasses.fields(value):
            if hasattr(value, field.name):
                yield field.name, getattr(value, field.name)
    else:
        raise TypeError(f"save: a {type(value).__name__} cannot be written.")


def _made(kind: Any, fields: dict[str, Any]) -> Any:
    """Without its `__init__`, which would convert and check again."""
    if issubclass(kind, tuple):
        return kind(**fields)
    value = object.__new__(kind)
    for name, content in fields.items():
        object.__setattr__(value, name, content)
    return value


def _leaves(value: Any) -> list[Any]:
    return [leaf for leaf in jax.tree.leaves(value) if eqx.is_array_like(leaf)]


def _name_of(value: Any) -> str:
    named = value if isinstance(value, types.FunctionType | type) else type(value)
    return named.__qualname__


def _is_ours(named: Any) -> bool:
    return named.__module__.split(".")[0] in OURS


def _named(name: str) -> Any:
    """A class or function of ours; a file may name nothing else."""
    module, _, path = name.partition(":")
    if module.split(".")[0] in OURS:
        found = functools.reduce(
            getattr, path.split("."), importlib.import_module(module)
        )
        if _is_ours(found) and found.__qualname__ == path:
            return found
    raise ValueError(f"load: {name} is not part of manireg.")
