"""What to cite: the entries of `references.bib` that what was used names."""

import dataclasses
import re
from collections.abc import Iterator
from importlib.metadata import version
from pathlib import Path
from typing import Any

ALWAYS = "manireg", "steinke2008nonparametric"


def citation(*used: Any) -> str:
    """BibTeX entries of manireg, of the paper whose method it is, and of what was used:
    its energy, tension, loss, metric, choice of lambda, uncertainty, data.

    **Arguments:** `used`: fitted maps, posteriors, cross-validations, registrations, data
    of `mr.datasets`; or names of entries, such as `"reml"`.

    **Raises** ValueError for a name without an entry.

    **Example:**

    ```python
    poles = mr.datasets.palaeomagnetic_poles("gondwana")
    print(mr.citation(mr.Tukey(), poles))
    ```
    """
    entries = _entries()
    keys = [*ALWAYS]
    for thing in used:
        keys += [thing] if isinstance(thing, str) else _named(thing)
    keys = dict.fromkeys(keys)
    unknown = [key for key in keys if key not in entries]
    if unknown:
        raise ValueError(f"citation: no entry {unknown[0]!r}; there are {[*entries]}.")
    text = "\n\n".join(entries[key] for key in keys)
    return text.replace("VERSION", version("manireg"))


def _entries() -> dict[str, str]:
    text = Path(__file__).with_name("references.bib").read_text(encoding="utf-8")
    entries = [entry.strip() for entry in re.split(r"\n(?=@)", text)]
    return {re.findall(r"@\w+\{(.+?),", entry)[0]: entry for entry in entries}


def _named(thing: Any) -> Iterator[str]:
    """The `references` of an object's class, and of all that it holds."""
    yield from getattr(type(thing), "references", ())
    if dataclasses.is_dataclass(thing):
        names = (field.name for field in dataclasses.fields(thing))
        parts = [getattr(thing, name, None) for name in names]
    elif isinstance(thing, tuple | list):
        parts = [*thing]
    else:
        parts = [*thing.values()] if isinstance(thing, dict) else []
    for part in parts:
        yield from _named(part)
