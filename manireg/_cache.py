"""Compiled programs, kept in a folder for the next process.

JAX has such a cache and can limit its size, but then it looks at every file of the folder
whenever it adds one of some hundred small programs (0.3 s each with 8,000 files). So the
folder is made smaller here, when the cache is switched on. Processes share it without a
lock: JAX writes an entry once and never changes it, and compiles what it cannot read.
JAX's names of entries depend on the program, jaxlib and what the processor can do.
"""

import contextlib
import os
import re
import sys
import tempfile
import warnings
from pathlib import Path

import jax
import platformdirs
from jax.experimental.compilation_cache.compilation_cache import reset_cache

ENTRY = re.compile(r".+-[0-9a-f]{64}-cache")  # what JAX calls its files


def cache_programs(
    folder: str | os.PathLike[str] | None = None, *, size: int = 2**28
) -> Path | None:
    """Keep compiled programs in a folder, so that the next process need not compile them.

    Most of a first fit is compilation, which depends on shapes and not on numbers: a
    process that finds its programs takes a quarter of the time. To be called before the
    first fit. This changes JAX's settings, so programs of other libraries are kept too;
    manireg does it for commands in the shell, but never for a program that imports it.

    Processes may share a folder, also those of machines with other processors. Whoever can
    write to it can run code in your programs: choose one that is yours alone.

    **Arguments:**

    - `folder`: is made where there is none. Default: the one that JAX's own setting names
      (`JAX_COMPILATION_CACHE_DIR`), which is left as it is, or else the cache folder of
      the user.
    - `size`: in bytes. Of more, this call deletes what has not been used for longest;
      programs that come later are all kept until the next call.

    **Returns:** where the programs are. None if JAX's own switch
    (`JAX_ENABLE_COMPILATION_CACHE`) is off, or, with a warning, if the folder cannot be
    written. Entries that are damaged (after a full disk, say) are compiled anew, with
    a warning by JAX each time: then delete the folder.

    **Raises:** `ValueError` if `size` is negative.

        mr.cache_programs()
        mr.fit(mr.Interval(0, 1), mr.Sphere(2), x, y, 1e-4)  # soon, next time
    """
    if size < 0:
        raise ValueError(
            f"cache_programs: size is {size}; give a number of bytes, >= 0."
        )
    named = jax.config.values["jax_compilation_cache_dir"]
    if not jax.config.values["jax_enable_compilation_cache"]:
        return None
    if folder is None and named:
        return Path(named)
    try:
        root = Path(folder or platformdirs.user_cache_path("manireg")).expanduser()
        place = _writable_part(root.absolute())
    except (OSError, RuntimeError) as error:  # RuntimeError: there is no home folder
        warnings.warn(
            f"cache_programs: compiled programs are not kept: {error}. Name a folder that "
            "can be written.",
            stacklevel=2,
        )
        return None
    _shrink(root, size)
    _switch_on(place)
    return place


def _writable_part(root: Path) -> Path:
    """For this version of Python: later ones pack entries of the same name differently."""
    place = root / f"python{sys.version_info.major}.{sys.version_info.minor}"
    place.mkdir(mode=0o700, parents=True, exist_ok=True)
    with tempfile.TemporaryFile(dir=place):
        return place


def _shrink(root: Path, size: int) -> None:
    """Delete what has not been used for longest, and empty files, left by processes that
    died: JAX would neither read nor replace them."""
    kept = 0
    for file, stat in sorted(_entries(root), key=_last_used, reverse=True):
        kept += stat.st_size
        if kept > size or stat.st_size == 0:
            with contextlib.suppress(OSError):  # another process was quicker
                file.unlink()


def _entries(root: Path) -> list[tuple[Path, os.stat_result]]:
    found = []
    for file in root.glob("python*/*-cache"):
        # no other files: the folder may be one that the user has for more than this
        if ENTRY.fullmatch(file.name):
            with contextlib.suppress(OSError):
                found.append((file, file.stat()))
    return found


def _last_used(entry: tuple[Path, os.stat_result]) -> float:
    # some file systems do not record when a file is read
    return max(entry[1].st_atime, entry[1].st_mtime)


def _switch_on(place: Path) -> None:
    jax.config.update("jax_compilation_cache_dir", str(place))
    # small programs too: a fit has a hundred, which take a second to compile
    jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.0)
    jax.config.update("jax_persistent_cache_min_entry_size_bytes", -1)
    reset_cache()  # JAX goes on with a folder that it has used before
