"""Which landmark of one surface belongs to which of the other."""

import re
import warnings
from typing import NamedTuple

import numpy as np

from .landmarks import Landmarks

SHOWN = 8  # names in a message


class Matched(NamedTuple):
    """Landmarks in pairs."""

    names: tuple[str, ...]
    source: Landmarks
    target: Landmarks
    numbers: list[int]
    """Of each pair, its number among the landmarks of the source."""


def matched(source: Landmarks, target: Landmarks) -> Matched:
    """By name where both have names, else in order. What has no partner is left out and
    named in a warning."""
    source, kept = _once("source_landmarks", source)
    target, _ = _once("target_landmarks", target)
    both = source.named and target.named
    pairs, note = _by_name(source, target) if both else (None, "")
    if pairs is None:
        if len(source) != len(target):
            _refuse(source, target, both)
        pairs = [(i, i) for i in range(len(source))]
    if note:
        warnings.warn(f"landmarks: {note}", stacklevel=4)
    ours, theirs = [i for i, _ in pairs], [j for _, j in pairs]
    _tell_missing(source, target, set(ours), set(theirs))
    names = source if source.named or not target.named else target
    labels = names.take(ours if names is source else theirs).names
    index = [kept[i] for i in ours]
    return Matched(labels, source.take(ours), target.take(theirs), index)


def listed(names) -> str:
    names = list(names)
    more = f" and {len(names) - SHOWN} more" if len(names) > SHOWN else ""
    return ", ".join(map(repr, names[:SHOWN])) + more


def _once(name: str, landmarks: Landmarks) -> tuple[Landmarks, list[int]]:
    """Without the second of two that have one name and one place, and the numbers of those
    that are left."""
    first: dict[str, int] = {}
    kept = []
    for i, label in enumerate(landmarks.names):
        j = first.setdefault(_folded(label), i)
        if i == j or not landmarks.named:
            kept.append(i)
        elif not _one_place(landmarks, i, j):
            raise ValueError(
                f"{name}: landmark {label!r} is there twice, at two places"
                f"{_in_file(landmarks)}; remove or rename one."
            )
    if len(kept) < len(landmarks):
        again = [n for i, n in enumerate(landmarks.names) if i not in kept]
        warnings.warn(
            f"{name}: {listed(again)} twice, at one place; counted once.", stacklevel=5
        )
    return landmarks.take(kept), kept


def _one_place(landmarks: Landmarks, i: int, j: int) -> bool:
    places = landmarks.positions if landmarks.vertices is None else landmarks.vertices
    assert places is not None
    return bool(np.all(places[i] == places[j]))


def _by_name(source: Landmarks, target: Landmarks):
    """Pairs, or None where no name is common, and what to tell."""
    for key, note in (
        (_folded, ""),
        (_number, "matched by the numbers in their names"),
    ):
        theirs = {key(name): j for j, name in enumerate(target.names)}
        ours = {key(name): i for i, name in enumerate(source.names)}
        common = [n for n in ours if n is not None and n in theirs]
        unique = len(ours) == len(source) and len(theirs) == len(target)
        if common and unique:
            example = f" ({source.names[0]!r}, {target.names[0]!r})." if note else ""
            return [(ours[n], theirs[n]) for n in common], note + example
    first = f"{source.names[0]!r}, {target.names[0]!r}"
    return None, f"no name is in both sets ({first}); taken in the order of the files."


def _folded(name: str) -> str:
    return " ".join(name.casefold().split())


def _number(name: str) -> int | None:
    found = re.search(r"(\d+)\D*$", name)
    return int(found[1]) if found else None


def _tell_missing(source: Landmarks, target: Landmarks, ours: set, theirs: set) -> None:
    alone = []
    for landmarks, used, label in (
        (source, ours, "source"),
        (target, theirs, "target"),
    ):
        names = [n for i, n in enumerate(landmarks.names) if i not in used]
        lost = [*names, *landmarks.missing]
        if names:
            alone.append(f"only on the {label}: {listed(names)}")
        if len(lost) > len(names):
            alone.append(f"without a place on the {label}: {listed(landmarks.missing)}")
    if alone:
        warnings.warn(
            f"landmarks: {len(ours)} pairs; left out are those {'; '.join(alone)}.",
            stacklevel=5,
        )


def _refuse(source: Landmarks, target: Landmarks, named: bool) -> None:
    cure = ""
    if named:
        cure = (
            " No name is in both sets: the source has "
            f"{listed(source.names)}, the target {listed(target.names)}. Rename those of "
            "one."
        )
    raise ValueError(
        f"landmarks: at least 5 pairs are needed, found {len(source)} on the source and "
        f"{len(target)} on the target.{cure}"
    )


def _in_file(landmarks: Landmarks) -> str:
    return f" ({landmarks.origin})" if landmarks.origin else ""
