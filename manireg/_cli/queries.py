"""Where `manireg fit` predicts: at the rows of a table, or on a grid over the data."""

from pathlib import Path

import numpy as np

from ..datasets._entries import is_data
from ..datasets._text_tables import TextTable, read_text_table
from .axes import Axis
from .columns import Missing, complete, find


def asked(predict: str, inputs: list[str], missing: Missing) -> list[TextTable]:
    """The table of inputs to predict at, if there is one."""
    if predict.isdecimal():
        return []
    file = Path(predict).expanduser()
    if not file.is_file() and is_data(predict):
        raise ValueError(f"--predict {predict} is no whole number, and no such file.")
    table = read_text_table(file)
    names = [find(table, name, "--input") for name in inputs]
    return [complete(table, names, missing)]


def rows(table: TextTable, axes: list[Axis]) -> tuple[np.ndarray, list[list[str]]]:
    """Inputs (n, m) to predict at, and their texts, as given."""
    floats = np.stack([axis.floats(table) for axis in axes], axis=-1)
    return floats, [axis.given(table) for axis in axes]


def grid(
    predict: str, x: np.ndarray, axes: list[Axis]
) -> tuple[np.ndarray, list[list[str]]]:
    """The same, of about as many points as asked for."""
    each = max(2, round(int(predict) ** (1 / len(axes))))
    ticks = [np.linspace(a, b, each) for a, b in zip(x.min(0), x.max(0), strict=True)]
    mesh = np.meshgrid(*ticks, indexing="ij")
    floats = np.stack(mesh, axis=-1).reshape(-1, len(axes))
    texts = [axis.texts(column) for axis, column in zip(axes, floats.T, strict=True)]
    return floats, texts
