"""Commands keep compiled programs, unless told not to."""

import os
import subprocess
import sys

import jax
import jax.numpy as jnp
import numpy as np
import platformdirs
import pytest
from typer.testing import CliRunner

import manireg as mr
from manireg._cli.app import app
from manireg._cli.errors import clean_errors


@pytest.fixture
def home(jax_cache, tmp_path, monkeypatch):
    """The user's cache folder, not yet there."""
    monkeypatch.setattr(platformdirs, "user_cache_path", lambda name: tmp_path / name)
    return tmp_path / "manireg"


def start(*options):
    """A command that ends before any work: there is no such table."""
    arguments = [*options, "fit", "nothing.csv", "--target", "sphere"]
    result = CliRunner().invoke(app, [*arguments, "--input", "t", "--output", "x,y,z"])
    assert result.exit_code == 2 and "nothing.csv" in result.output
    return result.output


def test_commands_keep_programs(home):
    start()
    assert home.is_dir()
    assert jax.config.values["jax_compilation_cache_dir"].startswith(str(home))


def test_no_cache_writes_nothing(home):
    start("--no-cache")
    assert not home.exists()
    assert not jax.config.values["jax_enable_compilation_cache"]


def test_the_folder_that_jax_was_given(home, tmp_path):
    jax.config.update("jax_compilation_cache_dir", str(tmp_path / "jax"))
    start("--cache")
    assert not home.exists()
    assert jax.config.values["jax_compilation_cache_dir"] == str(tmp_path / "jax")


def test_without_a_folder_commands_go_on(home):
    home.write_text("a file, where a folder should be")
    assert "programs are not kept" in start()


def test_one_note_for_many_damaged_entries(home, capsys):
    mr.cache_programs()
    for damaged in (False, True):
        jax.clear_caches()
        with clean_errors():
            for n in range(2, 5):
                assert jax.jit(lambda x: jnp.sum(x))(jnp.ones(n)) == n
        said = capsys.readouterr().err
        assert (said.count("note: "), said.count(str(home))) == (damaged, damaged)
        for file in home.glob("*/*-cache"):
            file.write_bytes(b"damaged")


@pytest.mark.slow
def test_the_second_command_compiles_nothing_new(tmp_path):
    """All that can be kept was kept: JAX would write what it compiles to a file."""
    t = np.linspace(0, 2, 12)
    rows = np.stack([t, np.cos(t), np.sin(t), 0 * t], axis=-1)
    header = {"header": "t,x,y,z", "comments": "", "delimiter": ","}
    np.savetxt(tmp_path / "data.csv", rows, **header)
    folder = tmp_path / "programs"
    fit = "fit data.csv --target sphere --input t --output x,y,z --lam 1 --out out.csv"
    code = (
        "import sys, manireg as mr; from manireg._cli.app import app;"
        "mr.cache_programs(sys.argv.pop(1)); app()"
    )
    files = []
    for options in (["--no-cache"], [], []):
        command = [sys.executable, "-c", code, str(folder), *options, *fit.split()]
        environment = os.environ | {"JAX_ENABLE_COMPILATION_CACHE": "true"}
        subprocess.run(command, cwd=tmp_path, env=environment, check=True)
        files.append(sorted(file.name for file in folder.rglob("*-cache")))
    assert not files[0] and 5 < len(files[1]) < 30 and files[2] == files[1]
