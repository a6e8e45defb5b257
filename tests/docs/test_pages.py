"""What the pages of the documentation show is so: their Python runs, block after block,
their commands have the options that are named, every public name has its place."""

import re
import shlex
from pathlib import Path
from types import ModuleType

import matplotlib.pyplot as plt
import pytest
import typer.main

import manireg as mr
from manireg._cli.app import app

ROOT = Path(__file__).parents[2]
PAGES = sorted((ROOT / "docs").rglob("*.md"))
BLOCK = re.compile(r"^```python\n(.*?)^```", re.DOTALL | re.MULTILINE)
WITH_CODE = [page for page in PAGES if BLOCK.search(page.read_text())]


def name_of(page):
    return page.relative_to(ROOT).as_posix()


@pytest.mark.slow
@pytest.mark.parametrize("page", WITH_CODE, ids=name_of)
def test_blocks_run_in_order(page, tmp_path, monkeypatch, unchecked):
    monkeypatch.chdir(tmp_path)
    names = {}
    for block in BLOCK.findall(page.read_text()):
        try:
            exec(compile(block, page.name, "exec"), names)
        except FileNotFoundError as missing:  # tables of `MANIREG_DATA`
            pytest.skip(str(missing))
    plt.close("all")


def commands():
    """Lines of shell that start with `manireg`, of all pages and the README."""
    for page in (ROOT / "README.md", *PAGES):
        text = page.read_text().replace("\\\n", " ")
        for line in re.findall(r"^ *(manireg .*)$|`(manireg .*?)`", text, re.MULTILINE):
            yield pytest.param(*filter(None, line), id=f"{page.name}: {''.join(line)}")


@pytest.mark.parametrize("command", [*commands()])
def test_options_exist(command):
    group = typer.main.get_command(app)
    _, *words = shlex.split(command.replace("\n", " "), comments=True)
    known = {o for p in group.params for o in (*p.opts, *p.secondary_opts)}
    for word in words:
        if found := getattr(group, "commands", {}).get(word):
            group = found
            known = {o for p in group.params for o in p.opts} | {"--help"}
        elif word.startswith("--"):
            assert word in known, f"{word} is no option of {command}"


def public(module):
    return {
        name
        for name, thing in vars(module).items()
        if not name.startswith("_") and not isinstance(thing, ModuleType)
    }


def test_api_has_every_public_name():
    api = ROOT / "docs" / "api"
    shown = {
        name
        for page in api.glob("*.md")
        for name in re.findall(r"^::: manireg\.(\S+)$", page.read_text(), re.MULTILINE)
    }
    modules = (mr.apps, mr.baselines, mr.datasets, mr.meshes, mr.plot, mr.manifolds)
    expected = public(mr)
    for module in modules:
        of_it = public(module) - (public(mr) if module is mr.manifolds else set())
        expected |= {f"{module.__name__.removeprefix('manireg.')}.{n}" for n in of_it}
    missing = expected - shown
    assert not missing, f"give {missing} a line `::: manireg.NAME` on a page of {api}"
    assert not shown - expected
    index = (api / "index.md").read_text()
    assert not [name for name in shown if f"`{name}`" not in index]
