"""Runs in processes of their own, so that each one's peak memory is seen."""

import argparse
import subprocess
import sys
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import Any

from tqdm import tqdm

RESULTS = Path(__file__).parent / "results"


def add_options(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--out", type=Path, default=RESULTS)
    parser.add_argument("--worker", action="store_true", help=argparse.SUPPRESS)


def start_worker(script: str, out: Path, **options: Iterable[object]) -> None:
    """`script --worker`, with these values of its options; waits for its end."""
    command = [sys.executable, script, "--worker", "--out", str(out)]
    for name, values in options.items():
        command += [f"--{name}", *map(str, values)]
    subprocess.run(command, check=True)


def run_missing(
    script: str,
    out: Path,
    groups: Sequence[dict[str, Any]],
    targets: Callable[[dict[str, Any]], Iterable],
    read_runs: Callable[[Path], dict],
) -> None:
    """A worker for each group of options, on those of its targets without a run yet. Runs
    have the values of the group and the target as their key."""
    with tqdm(groups, unit="group") as bar:
        for group in bar:
            bar.set_postfix_str(", ".join(map(str, group.values())))
            done = read_runs(out)
            missing = [t for t in targets(group) if (*group.values(), t) not in done]
            if missing:
                one = {name: [value] for name, value in group.items()}
                start_worker(script, out, **one, targets=missing)
