"""The examples in docstrings of public names run, and give what they say.

A fenced block of Python is run; one that is only indented needs files or machines of the
reader. `expression  # 4.53, 0.0` says what comes out, to the digits that are given.
"""

import ast
import inspect
import re
from collections.abc import Callable
from pathlib import Path
from types import ModuleType
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import trimesh
from scipy.spatial.transform import Rotation

import manireg as mr

BLOCK = re.compile(r"```python\n(.*?)```", re.DOTALL)
MODULES = mr.baselines, mr.datasets, mr.manifolds, mr.meshes, mr.plot
# Choices, surfaces, random maps: each takes seconds
SLOW = {
    "Circle",
    "Posterior",
    "align",
    "bootstrap",
    "cross_validate",
    "differential",
    "leave_one_out",
    "nadaraya_watson",
    "register",
    "slide",
    "solve",
    "sphere_path",
    "sweep",
}


def public(module):
    return [
        (name, thing)
        for name, thing in vars(module).items()
        if not name.startswith("_") and not isinstance(thing, ModuleType)
    ]


def examples():
    """Of each public thing and each public method of a class, by name."""
    found = {}
    for name, thing in (pair for m in (mr, *MODULES) for pair in public(m)):
        methods = public(thing) if inspect.isclass(thing) else []
        for key, each in [(name, thing), *methods]:
            blocks = BLOCK.findall(inspect.getdoc(each) or "")
            if blocks and inspect.getdoc(each) not in (inspect.getdoc(dict), None):
                found[key] = blocks
    return found


EXAMPLES = examples()


def run(block, names):
    """Runs a block, comparing values with those that comments promise."""
    lines = block.splitlines()
    for node in ast.parse(block).body:
        code = "\n".join(lines[node.lineno - 1 : node.end_lineno])
        comment = lines[(node.end_lineno or 1) - 1].rpartition("  # ")[2]
        if not isinstance(node, ast.Expr) or not (digits := promised(comment)):
            exec(compile(code, "example", "exec"), names)
            continue
        value = eval(compile(ast.Expression(node.value), "example", "eval"), names)
        for got, text in zip(np.ravel(value), digits, strict=True):
            if isinstance(expected := ast.literal_eval(text), float):
                assert got == pytest.approx(expected, abs=0.51 * last_digit(text)), code
            else:
                assert got == expected, code


def promised(comment):
    """The literals of a comment, as text; none if it is prose."""
    parts = comment.strip("()").split(", ")
    try:
        return [part for part in parts if ast.literal_eval(part) is not None]
    except (ValueError, SyntaxError):
        return []


def last_digit(text):
    return 10.0 ** -len(text.partition(".")[2])


@pytest.mark.parametrize(
    "name",
    [
        pytest.param(name, marks=[pytest.mark.slow] if name in SLOW else [])
        for name in EXAMPLES
    ],
)
def test_example(name, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    names: dict[str, Any] = dict(mr=mr, jax=jax, jnp=jnp, np=np, trimesh=trimesh)
    names |= dict(Rotation=Rotation, Path=Path, Callable=Callable)
    for block in EXAMPLES[name]:
        try:
            run(block, names)
        except FileNotFoundError as missing:
            pytest.skip(str(missing))


def test_what_users_meet_has_an_example():
    without = {"cache_programs", "register_folder"}  # of the reader's folders
    classes = mr.AbstractSource, mr.AbstractLoss
    for name, thing in public(mr):
        ours = inspect.isclass(thing) and issubclass(thing, classes)
        if (ours and not inspect.isabstract(thing)) or inspect.isfunction(thing):
            if name not in without and name != "Squared":
                assert name in EXAMPLES, f"the docstring of {name} has no example"


def test_promises_are_kept():
    run("1 / 3  # 0.33", {})
    run("(1, 2.0, True)  # (1, 2.0, True)", {})
    with pytest.raises(AssertionError):
        run("1 / 3  # 0.34", {})
    with pytest.raises(AssertionError):
        run("1 == 2  # True", {})
    assert promised("radians a Myr") == []
