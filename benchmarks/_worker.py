"""Runs in processes of their own, so that each one's peak memory is seen."""

import argparse
import subprocess
import sys
from collections.abc import Iterable
from pathlib import Path

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
