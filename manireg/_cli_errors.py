"""Mistakes at the command line."""

import contextlib
from pathlib import Path

import typer

from . import plot


@contextlib.contextmanager
def clean_errors():
    """Mistakes in the input end the program with one line and status 2."""
    try:
        yield
    except (ValueError, OSError, ModuleNotFoundError) as error:
        message = str(error)
    except RuntimeError as error:
        # equinox's message is the last paragraph before its ruler
        reason = str(error).split("\n---")[0].strip().splitlines()[-1]
        reason = reason.removeprefix("equinox.EquinoxRuntimeError: ")
        message = f"the fit failed: {reason} Try a larger --lam."
    else:
        return
    typer.secho(f"manireg: {' '.join(message.split())}", fg="red", err=True)
    raise typer.Exit(2)


def check_written(picture: Path | None, *others: Path) -> None:
    """Before any work: can the files be written?"""
    for path in (*others, *([picture] if picture else [])):
        if not path.absolute().parent.is_dir():
            raise ValueError(f"{path}: there is no folder {path.parent}.")
    if picture is not None:
        if picture.suffix not in (".png", ".pdf", ".svg"):
            raise ValueError(f"{picture}: a picture ends in .png, .pdf or .svg.")
        plot.figure()
