"""Landmark files of 3D Slicer, MeshLab and tps programs."""

import csv
import json
import re
from pathlib import Path
from typing import Any, NamedTuple
from xml.etree import ElementTree

SYSTEMS = {"0": "RAS", "1": "LPS", "RAS": "RAS", "LPS": "LPS"}
FCSV = "id,x,y,z,ow,ox,oy,oz,vis,sel,lock,label,desc,associatednodeid"


class FoundLandmarks(NamedTuple):
    """What a file lists."""

    names: list[str] | None
    places: list[Any]
    """Three coordinates, a vertex number, or None without a place."""
    system: str | None = None


def read_markups(path: Path) -> FoundLandmarks:
    """`.mrk.json` of 3D Slicer; of several lists in a file, those of points."""
    try:
        lists = json.loads(path.read_text(encoding="utf-8-sig"))["markups"]
        points = [m for m in lists if m.get("type", "Fiducial") == "Fiducial"] or lists
        systems = {str(m.get("coordinateSystem", "LPS")).upper() for m in points}
        rows = [p for m in points for p in m["controlPoints"]]
        names = [str(p.get("label") or p.get("id") or "") for p in rows]
        places = [_markup_place(p) for p in rows]
    except (KeyError, TypeError, ValueError, AttributeError) as error:
        raise ValueError(
            f"{path}: no markups of 3D Slicer ({type(error).__name__}: {error})."
        ) from error
    if len(systems) > 1 or not systems <= set(SYSTEMS):
        listed = ", ".join(sorted(systems))
        raise ValueError(f"{path}: coordinate system {listed}; expected LPS or RAS.")
    return FoundLandmarks(names, places, SYSTEMS[systems.pop()] if systems else None)


def _markup_place(point) -> list[float] | None:
    if point.get("positionStatus", "defined") != "defined" or not point.get("position"):
        return None
    x, y, z = map(float, point["position"])
    return [x, y, z]


def read_fcsv(path: Path) -> FoundLandmarks:
    """`.fcsv` of 3D Slicer."""
    columns, system, rows = FCSV.split(","), "RAS", []
    for line in path.read_text(encoding="utf-8-sig").splitlines():
        comment = re.match(r"#\s*(\w+)\s*=\s*(.*)", line)
        if comment and comment[1].lower() == "columns":
            columns = [name.strip().lower() for name in comment[2].split(",")]
        elif comment and comment[1].lower() == "coordinatesystem":
            system = SYSTEMS.get(comment[2].strip().rstrip(",").upper(), "")
        elif line.strip() and not line.startswith("#"):
            rows.append(dict(zip(columns, next(csv.reader([line])))))
    if not system:
        raise ValueError(f"{path}: an unknown coordinate system; expected LPS or RAS.")
    try:
        places = [[float(row[a]) for a in "xyz"] for row in rows]
    except (KeyError, ValueError) as error:
        raise ValueError(
            f"{path}: a line without three coordinates ({error})."
        ) from error
    names = [row.get("label") or row.get("id", "") for row in rows]
    return FoundLandmarks(names, places, system)


def read_pp(path: Path) -> FoundLandmarks:
    """`.pp`, the picked points of MeshLab."""
    try:
        points = ElementTree.fromstring(path.read_bytes()).findall(".//point")
        on = lambda p: p.get("active", "1") not in ("0", "false")
        places = [
            [float(p.attrib[a]) for a in "xyz"] if on(p) else None for p in points
        ]
    except (ElementTree.ParseError, KeyError, ValueError) as error:
        raise ValueError(f"{path}: no picked points of MeshLab ({error}).") from error
    return FoundLandmarks([p.get("name", "") for p in points], places)


def read_tps(path: Path, specimen: str | int | None) -> FoundLandmarks:
    """One specimen of a `.tps` file in three dimensions; `SCALE` is multiplied in."""
    blocks: list[tuple[int, list, dict]] = []
    for number, line in enumerate(path.read_text(errors="replace").splitlines(), 1):
        key, equals, value = (part.strip() for part in line.partition("="))
        if equals and key.upper() in ("LM", "LM3"):
            blocks.append((int(value), [], {}))
        elif equals and blocks:
            blocks[-1][2][key.upper()] = value
        elif line.strip() and blocks and len(blocks[-1][1]) < blocks[-1][0]:
            blocks[-1][1].append((number, line.split()))
    if not blocks:
        raise ValueError(f"{path}: has no line `LM3=` of a tps file.")
    count, rows, more = blocks[_block(path, blocks, specimen)]
    if len(rows) < count:
        raise ValueError(f"{path}: {count} landmarks announced, {len(rows)} found.")
    scale, places = float(more.get("SCALE", 1.0)), []
    for number, words in rows:
        if len(words) != 3:
            raise ValueError(
                f"{path}, line {number}: {len(words)} coordinates; surfaces need 3."
            )
        lost = any(word.upper() in ("NA", "NAN") for word in words)
        places.append(None if lost else [scale * float(word) for word in words])
    return FoundLandmarks(None, places)


def _block(path: Path, blocks, specimen: str | int | None) -> int:
    labels = [more.get("ID", "") for _, _, more in blocks]
    if specimen is None and len(blocks) == 1:
        return 0
    if isinstance(specimen, int) and 0 <= specimen < len(blocks):
        return specimen
    if labels.count(str(specimen)) == 1:
        return labels.index(str(specimen))
    listed = ", ".join(labels[:5]) + (", ..." if len(labels) > 5 else "")
    raise ValueError(
        f"{path}: holds {len(blocks)} specimens ({listed}); take "
        f"`manireg.read_landmarks({str(path)!r}, specimen=...)` with one of these or a "
        "number from 0."
    )
