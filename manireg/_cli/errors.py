"""Mistakes at the command line, and what else it says on the error stream."""

import contextlib
import os
import re
import warnings
from collections.abc import Iterator
from pathlib import Path

import jax
import typer

from .. import plot

INTERRUPTED = 130  # the status of a program that Ctrl-C ends, by custom


@contextlib.contextmanager
def clean_errors() -> Iterator[None]:
    """Mistakes in the input and fits that fail end the program with one line and status
    2; warnings are one line each."""
    try:
        with _notes():
            yield
            return
    except KeyboardInterrupt:
        _say("interrupted.", "red")
        raise typer.Exit(INTERRUPTED) from None
    except ModuleNotFoundError as error:
        message = str(error)
        if error.name and error.name in message and "pip install" not in message:
            message += f". Install it: pip install {error.name}."
    except MemoryError as error:
        message = _out_of_memory(str(error))
    except (ValueError, OSError) as error:
        message = str(error)
    except RuntimeError as error:
        message = _reason(str(error))
    _say(message, "red")
    raise typer.Exit(2)


@contextlib.contextmanager
def _notes() -> Iterator[None]:
    """Warnings meant for users, each once and without the line of code they come from."""
    with warnings.catch_warnings():
        warnings.simplefilter("always", UserWarning)
        others, said = warnings.showwarning, set()

        def show(message, category, *place, **more):
            if not issubclass(category, UserWarning):
                others(message, category, *place, **more)
            elif (note := _note(str(message))) not in said:
                said.add(note)
                _say(f"note: {note}", "yellow")

        warnings.showwarning = show
        yield


def _note(message: str) -> str:
    # JAX says so for each of some hundred programs
    if "persistent compilation cache" not in message:
        return message
    folder = jax.config.values["jax_compilation_cache_dir"]
    return (
        f"{folder}: some compiled programs could not be read or written, so they are "
        "compiled anew. If this comes again, delete the folder or use manireg --no-cache."
    )


def _say(message: str, colour: str) -> None:
    typer.secho(f"manireg: {' '.join(message.split())}", fg=colour, err=True)


def _reason(message: str) -> str:
    """What happened, without what Equinox and JAX write around it."""
    reason = message.split("EquinoxRuntimeError: ")[-1].split("\n---")[0].strip()
    if "RESOURCE_EXHAUSTED" in reason or "out of memory" in reason.lower():
        return _out_of_memory(reason)
    # our own messages name what failed: `fit: ...`
    ours = re.match(r"[a-z_]+: ", reason)
    return reason if ours else f"the computation failed: {reason}"


def _out_of_memory(message: str) -> str:
    asked = re.search(r"\d+ bytes|[\d.]+ ?[KMGT]i?B", message)
    size = f" ({asked[0]} were asked for)" if asked else ""
    return (
        f"out of memory{size}. Use fewer rows, predictions or --centres, or a machine "
        "with more memory."
    )


def check_written(picture: Path | None, *others: Path) -> None:
    """Before any work: can the files be written?"""
    for path in (*others, *([picture] if picture else [])):
        folder = path.absolute().parent
        if not folder.is_dir():
            raise ValueError(f"{path}: there is no folder {path.parent}.")
        if path.is_dir():
            raise ValueError(f"{path} is a folder; name a file.")
        if not os.access(path if path.exists() else folder, os.W_OK):
            raise ValueError(f"{path}: no permission to write it.")
    if picture is not None:
        if picture.suffix not in (".png", ".pdf", ".svg"):
            raise ValueError(f"{picture}: a picture ends in .png, .pdf or .svg.")
        plot.figure()
