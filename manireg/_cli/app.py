"""The command line: `manireg demo`, `fit`, `path`, `register` and `trajectory`."""

import contextlib
import os
from typing import Annotated

import jax
import typer

import manireg as mr

from .demo import demo
from .errors import clean_errors
from .fit import fit
from .path import path
from .register import register
from .trajectory import trajectory

app = typer.Typer(
    name="manireg",
    no_args_is_help=True,
    add_completion=False,
    rich_markup_mode="markdown",
    pretty_exceptions_show_locals=False,
    context_settings={"help_option_names": ["-h", "--help"]},
)

app.command()(demo)
app.command()(fit)
app.command()(path)
app.command()(register)
app.command()(trajectory)


def main() -> None:
    app()


@app.callback()
def setup(
    cache: Annotated[
        bool,
        typer.Option(help="Keep compiled programs for later commands, up to 256 MiB."),
    ] = True,
) -> None:
    """Regression between Riemannian manifolds with the Eells energy.

    Start with `manireg demo`, then `manireg fit --help` for tables, `manireg path --help`
    for palaeomagnetic poles, `manireg trajectory --help` for poses over time and `manireg
    register --help` for scanned surfaces.
    """
    jax.config.update("jax_enable_x64", True)
    # a device a core, to share the folds; too late where JAX has run in this process
    with contextlib.suppress(RuntimeError):
        jax.config.update("jax_num_cpu_devices", os.cpu_count() or 1)
    if not cache:
        jax.config.update("jax_enable_compilation_cache", False)
    with clean_errors():
        mr.cache_programs()
