"""Report and page of `manireg register`."""

from pathlib import Path
from typing import Any

from .. import plot
from .errors import check_written


def check_report(report: Path | None, page: Path | None, inverse: bool) -> None:
    """Before the work is done: what could not be written after it."""
    endings = {"--report": (report, (".json", ".csv")), "--page": (page, (".html",))}
    for option, (file, known) in endings.items():
        if file is not None and file.suffix.lower() not in known:
            raise ValueError(
                f"{option}: expected {' or '.join(known)}, found {file.name!r}."
            )
        if file is not None:
            check_written(None, file)
    if page is not None:
        plot.page_library()
    if inverse and report is None and page is None:
        raise ValueError("--inverse: is told in a report; give --report or --page.")


def write_report(
    found: Any, certificate: Any, report: Path | None, page: Path | None
) -> tuple[dict[str, str], list[Path]]:
    """What is printed of it, and the files."""
    files = [certificate.write(report)] if report is not None else []
    if page is not None:
        files.append(plot.page(found, certificate, page, page.stem))
    rows = dict(line.split("  ", 1) for line in str(certificate).splitlines())
    return {name: value.strip() for name, value in rows.items()}, files
