"""Compiled programs kept in a folder, by what JAX itself says of its cache."""

import os
import subprocess
import sys
from collections import Counter
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import platformdirs
import pytest

import manireg as mr

PROCESS = """
import sys
from collections import Counter
import jax
import jax.numpy as jnp
before = dict(jax.config.values)
import manireg as mr
assert dict(jax.config.values) == before, "the import of manireg changed JAX's settings"
events = Counter()
jax.monitoring.register_event_listener(lambda event, **_: events.update([event]))
assert mr.cache_programs(sys.argv[1]) is not None
for n in range(1, 20):
    assert jax.jit(lambda x: jnp.cumsum(x * x))(jnp.ones(n))[-1] == n
hits, misses = (events[f"/jax/compilation_cache/cache_{e}"] for e in ("hits", "misses"))
print(hits, misses)
"""


def start(folder):
    environment = os.environ | {"JAX_ENABLE_COMPILATION_CACHE": "true"}
    command = [sys.executable, "-W", "error", "-c", PROCESS, str(folder)]
    return subprocess.Popen(command, env=environment, stdout=subprocess.PIPE, text=True)


def end(process):
    printed, _ = process.communicate(timeout=300)
    assert process.returncode == 0
    return tuple(map(int, printed.split()))


def squares(n):
    return jax.jit(lambda x: x**2 + n)(jnp.arange(float(n)))


def entries(folder):
    return sorted(folder.glob("python*/*-cache"))


def entry(folder, name, *, size, used):
    """A file with the name of an entry, `size` bytes long and last used at `used`."""
    file = folder / "python3.99" / f"jit_{name}-{'0' * 64}-cache"
    file.parent.mkdir(parents=True, exist_ok=True)
    file.write_bytes(b"x" * size)
    os.utime(file, (used, used))
    return file


@pytest.fixture
def events():
    """How often JAX's cache did what, from here on."""
    counts = Counter()
    count = lambda event, **_: counts.update([event.split("/")[-1]])
    jax.monitoring.register_event_listener(count)
    yield counts
    jax.monitoring.unregister_event_listener(count)


def test_a_later_process_compiles_nothing(tmp_path):
    """After two that ran at once, without a warning, and imports change no setting."""
    for process in [start(tmp_path), start(tmp_path)]:
        hits, misses = end(process)
        assert hits + misses >= 19
    hits, misses = end(start(tmp_path))
    assert misses == 0 and hits >= 19


def test_programs_that_need_no_time_are_kept(jax_cache, events, tmp_path):
    place = mr.cache_programs(tmp_path)
    assert place is not None and place.parent == tmp_path
    for hits in (False, True):
        jax.clear_caches()
        events.clear()
        np.testing.assert_array_equal(squares(7), np.arange(7) ** 2 + 7)
        assert bool(events["cache_hits"]) == hits
        assert bool(events["cache_misses"]) != hits
    assert entries(tmp_path)
    if os.name == "posix":  # entries are programs: nobody else may write them
        assert place.stat().st_mode & 0o077 == 0


def test_another_folder_from_now_on(jax_cache, tmp_path):
    for name in ("first", "second"):
        jax.clear_caches()
        mr.cache_programs(tmp_path / name)
        squares(5)
        assert entries(tmp_path / name)


def test_a_damaged_entry_is_compiled_anew(jax_cache, tmp_path):
    mr.cache_programs(tmp_path)
    squares(6)
    for file in entries(tmp_path):
        file.write_bytes(file.read_bytes()[:-20])
    jax.clear_caches()
    with pytest.warns(UserWarning, match="Error reading persistent compilation cache"):
        found = squares(6)
    np.testing.assert_array_equal(found, np.arange(6) ** 2 + 6)


def test_an_empty_entry_is_replaced(jax_cache, tmp_path):
    """As left by a process that died while it wrote."""
    mr.cache_programs(tmp_path)
    squares(4)
    whole = entries(tmp_path)
    for file in whole:
        file.write_bytes(b"")
    jax.clear_caches()
    mr.cache_programs(tmp_path)
    assert not entries(tmp_path)
    squares(4)
    assert entries(tmp_path) == whole


def test_the_last_used_are_kept(jax_cache, tmp_path):
    old = entry(tmp_path, "old", size=10, used=1e9)
    recent = entry(tmp_path, "recent", size=400, used=1.2e9)
    middle = entry(tmp_path, "middle", size=500, used=1.1e9)
    others = [tmp_path / "python3.99" / "my-cache", tmp_path / "my-cache"]
    for other in others:
        other.write_bytes(b"x" * 5000)
    mr.cache_programs(tmp_path, size=900)
    assert recent.exists() and middle.exists() and not old.exists()
    mr.cache_programs(tmp_path, size=899)
    assert recent.exists() and not middle.exists()
    mr.cache_programs(tmp_path, size=0)
    assert not recent.exists() and all(other.exists() for other in others)


@pytest.mark.parametrize("folder", ["file/folder", "~nobody-of-this-name/folder"])
def test_a_folder_that_cannot_be_written(jax_cache, tmp_path, folder):
    """Under a file, as root may write any folder; or in a home that does not exist."""
    (tmp_path / "file").write_text("")
    folder = folder if folder.startswith("~") else tmp_path / folder
    with pytest.warns(UserWarning, match="programs are not kept.*Name a folder"):
        assert mr.cache_programs(folder) is None
    assert jax.config.values["jax_compilation_cache_dir"] is None
    np.testing.assert_array_equal(squares(3), [3, 4, 7])


def test_the_default_is_the_folder_of_the_user(jax_cache, tmp_path, monkeypatch):
    monkeypatch.setattr(platformdirs, "user_cache_path", lambda name: tmp_path / name)
    place = mr.cache_programs()
    assert place is not None and place.parent == tmp_path / "manireg"
    assert mr.cache_programs() == place


def test_settings_of_jax_come_first(jax_cache, tmp_path):
    jax.config.update("jax_compilation_cache_dir", str(tmp_path / "jax"))
    assert mr.cache_programs(size=0) == Path(tmp_path / "jax")
    assert jax.config.values["jax_persistent_cache_min_compile_time_secs"] == 1
    jax.config.update("jax_enable_compilation_cache", False)
    assert mr.cache_programs(tmp_path / "mine") is None
    assert not list(tmp_path.iterdir())


def test_a_size_below_nothing():
    with pytest.raises(ValueError, match="size is -1"):
        mr.cache_programs(size=-1)
