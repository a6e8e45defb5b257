"""Imports only go down the floors of the house, and plotting and the command line stay
out of `import manireg`."""

import ast
import subprocess
import sys
from collections.abc import Sequence
from graphlib import TopologicalSorter
from pathlib import Path

import manireg

FLOORS: Sequence[str] = """
_cache _citation _input _files _programs _algebra datasets meshes _source manifolds
_sources _geodesics _discretisation _objective _solver _selection _surfaces baselines plot
apps __init__ _cli __main__
""".split()
ROOT = Path(manireg.__path__[0])
FILES = {
    ".".join(("manireg", *f.relative_to(ROOT).with_suffix("").parts)): f
    for f in ROOT.rglob("*.py")
}


def imports(module: str) -> set[str]:
    """The modules of manireg that `module` imports."""
    names, parts = set(), module.split(".")
    for node in ast.walk(ast.parse(FILES[module].read_text())):
        if isinstance(node, ast.Import):
            names.update(alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            base = parts[: len(parts) - node.level] if node.level else []
            base += (node.module or "").split(".") if node.module else []
            names.update(".".join((*base, alias.name)) for alias in node.names)
    ours = {tuple(name.split(".")) for name in names if name.startswith("manireg")}
    return {_file(name) for name in ours} - {module}


def _file(name: tuple[str, ...]) -> str:
    candidates = (name, (*name, "__init__"), name[:-1], (*name[:-1], "__init__"))
    return next(".".join(c) for c in candidates if ".".join(c) in FILES)


def test_imports_go_down():
    for module in FILES:
        here = module.split(".")[1]
        assert here in FLOORS, f"{module} is in no room of the house: add it to FLOORS"
        for other in imports(module):
            there = other.split(".")[1]
            down = here == there or FLOORS.index(there) < FLOORS.index(here)
            assert down, f"{module} imports {other}, which is above it"


def test_no_cycles():
    TopologicalSorter({module: imports(module) for module in FILES}).prepare()


def test_import_is_light():
    code = (
        "import sys, manireg; slow = {'matplotlib', 'typer', 'pandas'}\n"
        "print(slow & {*sys.modules})\n"
        "import manireg._cli.app; print({'pandas'} & {*sys.modules})"
    )
    run = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert run.stdout == "set()\nset()\n", run.stderr
