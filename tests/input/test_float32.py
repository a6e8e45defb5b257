"""A process that forgets float64 is told so wherever it enters."""

import pickle
import subprocess
import sys

import numpy as np

import manireg as mr

PROGRAM = """
import pickle, sys
import jax, numpy as np, manireg as mr
from manireg import baselines

with open(sys.argv[1], "rb") as file:
    models, problem = pickle.load(file)
x = np.linspace(0.1, 0.9, 9)
y = np.stack([np.cos(x), np.sin(x), 0 * x], axis=1)
interval, sphere = mr.Interval(0, 1), mr.Sphere(2)
data = interval, sphere, x, y
entries = {
    **{type(m).__name__: lambda m=m: m(x) for m in models},
    "vmap": lambda: jax.vmap(models[0])(x),
    "solve": lambda: mr.solve(problem, 1e-3),
    "leave_one_out": lambda: mr.leave_one_out(problem, progress=False),
    "lambda_grid": lambda: mr.lambda_grid(problem),
    "make_problem": lambda: mr.make_problem(*data),
    "fit": lambda: mr.fit(*data, 1e-3),
    "cross_validate": lambda: mr.cross_validate(*data),
    "geodesic": lambda: mr.geodesic(sphere, y[0], y[3]),
    "eells_energy": lambda: mr.eells_energy(interval, sphere, models[0]),
    "thin_plate_energy": lambda: mr.thin_plate_energy(interval, models[0]),
    "PointCloud": lambda: mr.PointCloud(y, y),
    "sweep": lambda: mr.sweep(lambda lane, _: lane, x),
    "check_manifold": lambda: mr.check_manifold(sphere, y),
    "line_on_sphere": lambda: mr.datasets.line_on_sphere(jax.random.key(0), 9, 10.0),
    "von_mises_fisher": lambda: mr.datasets.von_mises_fisher(jax.random.key(0), y, 1.0),
    "thin plate": lambda: baselines.projected_thin_plate(*data, 1e-3),
    "averages": lambda: baselines.nadaraya_watson(*data, 0.1),
    "line": lambda: baselines.geodesic_regression(*data),
}
silent = []
for name, call in entries.items():
    try:
        call()
    except ValueError as error:
        if "float64" not in str(error):
            silent.append(f"{name}: {error}")
    else:
        silent.append(name)
jax.config.update("jax_enable_x64", True)  # too late for what is loaded
for name, call in [*entries.items()][: len(models) + 2]:
    try:
        call()
    except ValueError as error:
        if "holds float32 arrays" not in str(error):
            silent.append(f"{name}, late: {error}")
    else:
        silent.append(f"{name}, late")
print(len(entries), silent)
"""


def test_every_entry_point_checks(tmp_path):
    x = np.linspace(0.1, 0.9, 9)
    y = np.stack([np.cos(x), np.sin(x), 0 * x], axis=1)
    data = mr.Interval(0, 1), mr.Sphere(2), x, y
    problem = mr.make_problem(*data, centres=10)
    models = [
        mr.solve(problem, 1e-3),
        mr.baselines.nadaraya_watson(*data, 0.1),
        mr.baselines.projected_thin_plate(*data, 1e-3, centres=10),
    ]
    file = tmp_path / "models"
    file.write_bytes(pickle.dumps((models, problem)))
    command = [sys.executable, "-c", PROGRAM, str(file)]
    run = subprocess.run(command, capture_output=True, text=True)
    assert run.stdout == "21 []\n", run.stdout + run.stderr
