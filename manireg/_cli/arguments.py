"""What the options of `manireg fit` name: columns, numbers, orders."""

from pathlib import Path
from typing import Any

import numpy as np

from ..datasets._text_tables import TextTable
from .columns import numbers, refuse, split_names
from .noise import NoiseColumns


def check_not_read(out: Path, *tables: Path) -> None:
    for table in tables:
        table = table.expanduser()
        if out.exists() and table.exists() and out.samefile(table):
            raise ValueError(f"--out {out} is a table to read; name another file.")


def outputs_of(output: str | None, lat_lon: str | None) -> tuple[str, list[str]]:
    if output is not None and lat_lon is None:
        return "--output", split_names(output)
    if lat_lon is not None and output is None:
        return "--lat-lon", split_names(lat_lon)
    raise ValueError("Give either --output or --lat-lon, the output columns.")


def inputs_of(input: str | None, noise: NoiseColumns) -> list[str]:
    if input is not None:
        return split_names(input)
    if noise.x_min is not None:
        return []
    raise ValueError("Give --input, the input column, or --x-min and --x-max.")


def check_once(names: list[str]) -> None:
    for name in names:
        if names.count(name) > 1:
            raise ValueError(f"--input, --output: column `{name}` is named twice.")


def weights_of(table: TextTable, name: str) -> np.ndarray:
    w = numbers(table, [name], "--weights")[:, 0]
    cure = "Remove the row or give a small weight"
    refuse(table, name, w <= 0, "weights must be positive", cure)
    return w


def number_of(lam: str) -> float:
    try:
        return float(lam)
    except ValueError:
        raise ValueError(f"--lam is a number or auto, found {lam!r}.") from None


def order_of(order: str) -> Any:
    """A number, several, or `auto`."""
    if order == "auto":
        return order
    try:
        several = tuple(int(p) for p in order.split(","))
    except ValueError:
        raise ValueError(
            f"--order is 1, 2, 3 or 4, several with commas, or auto, found {order!r}."
        ) from None
    return several[0] if len(several) == 1 else several
