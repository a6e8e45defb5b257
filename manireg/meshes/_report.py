"""What was found on the way in, and what was done about it."""

from typing import NamedTuple

from .._input.shown import shown


class Finding(NamedTuple):
    """One fault of a mesh or a cloud of points."""

    fault: str
    """Such as "repeated vertices"."""
    number: int
    """How many there are."""
    first: int | None
    """Number of the first vertex or triangle that has it, where one has."""
    done: str
    """Such as "taken as one point"."""
    notable: bool = False
    """Whether it may change a result."""

    def __str__(self) -> str:
        first = "" if self.first is None else f" (first: {self.first})"
        return f"{self.number} {self.fault}{first}: {self.done}"


class Report(NamedTuple):
    """Of one surface; `print(report)` lists it."""

    vertices: int
    triangles: int
    extent: float
    """The longest side of the box around it, in the user's unit."""
    findings: tuple[Finding, ...]

    def __str__(self) -> str:
        triangles = f"{self.triangles} triangles" if self.triangles else "no triangles"
        extent = shown(float(f"{self.extent:.4g}"))
        first = f"{self.vertices} vertices, {triangles}, extent {extent}"
        return "\n".join([first, *(f"  {finding}" for finding in self.findings)])

    @property
    def notable(self) -> str:
        """In one line, what may change a result."""
        return "; ".join(str(f) for f in self.findings if f.notable)


def found(fault: str, bad, done: str, notable: bool = False) -> list[Finding]:
    """A finding of the numbers `bad`, none of an empty list."""
    if not len(bad):
        return []
    return [Finding(fault, len(bad), int(min(bad)), done, notable)]
