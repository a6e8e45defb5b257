"""The Python code of the README runs, block after block."""

import re
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
import pytest
import trimesh

README = (Path(__file__).parents[1] / "README.md").read_text()
BLOCKS = re.findall(r"```python\n(.*?)```", README, flags=re.DOTALL)


def two_surfaces():
    """What the README calls `source`, `target` and their landmarks."""
    source = trimesh.creation.icosphere(2)
    target = source.copy().apply_scale([1.0, 1.2, 0.8])
    landmarks = np.array([0, 15, 30, 60, 90, 120, 150])
    return {
        "source": source,
        "target": target,
        "source_landmarks": landmarks,
        "target_landmarks": landmarks,
    }


def test_blocks_run_in_order(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    names = two_surfaces()
    for block in BLOCKS:
        exec(compile(block, "README.md", "exec"), names)
    plt.close("all")
    assert (tmp_path / "fit.png").stat().st_size > 10_000
    assert names["curves"].shape == (4, 70, 3)
    assert names["slope"].shape == (70, 3)
    assert names["found"].vertices == pytest.approx(names["target"].vertices, abs=1e-2)
