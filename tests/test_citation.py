"""What is to be cited."""

import re

import jax
import numpy as np
import pytest

import manireg as mr
from manireg._citation import _entries


def keys(*used):
    return re.findall(r"@\w+\{(.+?),", mr.citation(*used))


def test_the_method_always():
    assert keys() == ["manireg", "steinke2008nonparametric"]
    assert f"version = {{{mr.__version__}}}" in mr.citation()


def test_what_a_fit_used():
    ball = mr.Sphere(2)
    x = ball.random_points(jax.random.key(0), 20)
    y = np.asarray(x) @ np.diag([1.0, 2.0, 3.0])
    args = mr.Ambient(ball), mr.Euclidean(3), x, y
    problem = mr.make_problem(
        *args, tension=1.0, loss=mr.Huber(), sigma=1.0, centres=30
    )
    model = mr.solve(problem, 1.0)
    assert keys(model)[2:] == [
        "huber1964robust",
        "schweikert1966interpolation",
        "franke1985thin",
    ]


def test_data_choices_and_names():
    poles = mr.datasets.palaeomagnetic_poles("gondwana")
    assert keys(poles, "reml")[2:] == ["torsvik2012phanerozoic", "reml"]
    assert keys(mr.datasets.polar_wander("europe"))[2:] == ["torsvik2008global"]
    assert keys({"a": [mr.AffineInvariantSPD(2)]})[2:] == ["pennec2006riemannian"]
    with pytest.raises(ValueError, match="citation: no entry 'knuth'; there are"):
        mr.citation("knuth")


def test_entries_are_bibtex():
    for key, entry in _entries().items():
        assert entry.count("{") == entry.count("}"), key
        assert {"title", "year"} <= set(re.findall(r"^  (\w+) +=", entry, re.MULTILINE))
