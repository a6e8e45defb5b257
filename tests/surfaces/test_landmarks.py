"""Landmarks as the field keeps them: read, matched, put onto the surface, doubted."""

import json
import warnings

import jax.numpy as jnp
import numpy as np
import pytest
import trimesh
from broken_meshes import F, W

import manireg as mr
from manireg._surfaces import landmark_fit
from manireg._surfaces.landmarks import as_landmarks
from manireg._surfaces.pairs import matched
from manireg._surfaces.placing import placed
from manireg._surfaces.suspects import left_out, suspects

NAMES = ["nose, tip", "Ear L", "Ear R", "chin", "7"]
PLACES = W[[0, 20, 40, 60, 80]]
MESH = trimesh.Trimesh(W, F, process=False)
SIZE = float(np.linalg.norm(np.ptp(W, axis=0)))


@pytest.fixture(scope="module")
def surface():
    return mr.load_surface(MESH)


def markups(names, places, system="LPS") -> str:
    points = [
        {"id": str(i), "label": n, "position": list(map(float, p)), "positionStatus": s}
        for i, (n, p, s) in enumerate(
            zip(names, places, ["defined"] * len(names), strict=True)
        )
    ]
    one = {"type": "Fiducial", "coordinateSystem": system, "controlPoints": points}
    return json.dumps({"markups": [one]})


def fcsv(names, places, system="LPS") -> str:
    head = ["# Markups fiducial file version = 4.11", f"# CoordinateSystem = {system}"]
    head.append("# columns = id,x,y,z,ow,ox,oy,oz,vis,sel,lock,label,desc,more")
    rows = [
        f'{i},{",".join(map(repr, map(float, p)))},0,0,0,1,1,1,0,"{n}",,'
        for i, (n, p) in enumerate(zip(names, places, strict=True))
    ]
    return "\n".join([*head, *rows, ""])


def pp(names, places) -> str:
    rows = [
        f'<point x="{x!r}" y="{y!r}" z="{z!r}" name="{n}" active="1"/>'
        for n, (x, y, z) in zip(names, places.tolist(), strict=True)
    ]
    return f"<!DOCTYPE PickedPoints>\n<PickedPoints>{''.join(rows)}</PickedPoints>"


def tps(places, name="skull") -> str:
    rows = [" ".join(map(repr, row)) for row in places.tolist()]
    return "\n".join([f"LM3={len(rows)}", *rows, f"ID={name}", ""])


def table(names, places, header=True, separator=",") -> str:
    rows = [
        separator.join([f'"{n}"', *map(repr, p)])
        for n, p in zip(names, places.tolist(), strict=True)
    ]
    head = [separator.join(["Name", "X [mm]", "Y [mm]", "Z [mm]"])] * header
    return "\n".join([*head, *rows, ""])


FORMATS = {
    "a.mrk.json": markups(NAMES, PLACES),
    "a.fcsv": fcsv(NAMES, PLACES),
    "a.pp": pp(NAMES, PLACES),
    "headed.csv": table(NAMES, PLACES),
    "bare.csv": table(NAMES, PLACES, header=False),
    "german.txt": table(NAMES, PLACES, separator=";"),
}


def written(folder, name, text):
    (folder / name).write_text(text)
    return folder / name


@pytest.mark.parametrize("name", FORMATS)
def test_names_and_positions(tmp_path, name):
    found = mr.read_landmarks(written(tmp_path, name, FORMATS[name]))
    assert found.names == tuple(NAMES) and found.named and found.vertices is None
    np.testing.assert_array_equal(found.positions, PLACES)
    slicer = name in ("a.mrk.json", "a.fcsv")
    assert found.system == ("LPS" if slicer else None)


@pytest.mark.parametrize(
    ("text", "names"),
    [
        ("5\n17\n2\n", None),
        ("vertex\n5\n17\n2\n", None),
        ("name,vertex\na,5\nb,17\nc,2\n", "abc"),
        ("a 5\nb 17\nc 2\n", "abc"),
        ("1;5\n2;17\n3;2\n", "123"),
    ],
)
def test_vertex_numbers(tmp_path, text, names):
    found = mr.read_landmarks(written(tmp_path, "a.csv", text))
    np.testing.assert_array_equal(found.vertices, [5, 17, 2])
    assert found.names == tuple(names or "123") and found.named == (names is not None)


def test_rows_of_three_numbers(tmp_path):
    text = "\n".join(",".join(map(repr, row)) for row in PLACES.tolist())
    found = mr.read_landmarks(written(tmp_path, "a.csv", text))
    np.testing.assert_array_equal(found.positions, PLACES)
    assert not found.named and found.names == tuple("12345")


def test_tps(tmp_path):
    one = mr.read_landmarks(written(tmp_path, "one.tps", tps(PLACES)))
    np.testing.assert_array_equal(one.positions, PLACES)
    both = tps(PLACES, "a") + tps(2 * PLACES, "b") + "SCALE=0.5\n"
    path = written(tmp_path, "two.tps", both)
    np.testing.assert_array_equal(
        mr.read_landmarks(path, specimen="b").positions, PLACES
    )
    np.testing.assert_array_equal(mr.read_landmarks(path, specimen=0).positions, PLACES)
    with pytest.raises(ValueError, match=r"2 specimens \(a, b\)"):
        mr.read_landmarks(path)
    flat = "LM=2\n1 2\n3 4\nID=x\n"
    with pytest.raises(ValueError, match="line 2: 2 coordinates; surfaces need 3"):
        mr.read_landmarks(written(tmp_path, "flat.tps", flat))


def test_what_has_no_place(tmp_path):
    text = json.loads(markups(NAMES, PLACES))
    text["markups"][0]["controlPoints"][1]["positionStatus"] = "undefined"
    slicer = mr.read_landmarks(written(tmp_path, "a.mrk.json", json.dumps(text)))
    meshlab = FORMATS["a.pp"].replace(
        'name="Ear L" active="1"', 'name="Ear L" active="0"'
    )
    gap = np.where(PLACES == PLACES[1], np.nan, PLACES)
    others = [
        mr.read_landmarks(written(tmp_path, "a.pp", meshlab)),
        mr.read_landmarks(
            written(
                tmp_path,
                "a.csv",
                table(NAMES, gap),
            )
        ),
    ]
    for found in (slicer, *others):
        assert found.missing == ("Ear L",) and len(found) == 4
        np.testing.assert_array_equal(found.positions, np.delete(PLACES, 1, axis=0))


@pytest.mark.parametrize(
    ("name", "text", "message"),
    [
        ("a.mrk.json", "{}", "no markups of 3D Slicer"),
        (
            "a.mrk.json",
            markups(NAMES, PLACES, "IJK"),
            "coordinate system IJK; expected",
        ),
        ("a.fcsv", "# columns = id,x,y\n1,2,3\n", "a line without three coordinates"),
        ("a.pp", "nothing", "no picked points of MeshLab"),
        ("a.tps", "1 2 3\n", "has no line `LM3=`"),
        ("a.tps", "LM3=3\n1 2 3\n", "3 landmarks announced, 1 found"),
        (
            "a.csv",
            "name,u,v\na,1,2\n",
            "expected columns `x,y,z` .* It has: name, u, v",
        ),
        ("a.csv", "vertex\n1.5\n", "vertex numbers are whole, found 1.5"),
        ("a.csv", "x,y,z\n1,2,b\n", "column `z` has 'b' in data row 1"),
        ("a.csv", "x,y,z\n,,\n", "holds no landmarks|needs a header line"),
    ],
)
def test_bad_files(tmp_path, name, text, message):
    with pytest.raises(ValueError, match=message):
        mr.read_landmarks(written(tmp_path, name, text))


def test_missing_file(tmp_path):
    with pytest.raises(FileNotFoundError, match="there is no such file"):
        mr.read_landmarks(tmp_path / "none.csv")


def marks(names, places=None):
    places = np.arange(3.0 * len(names)).reshape(-1, 3) if places is None else places
    return mr.Landmarks(tuple(names), places, None)


def test_matched_by_name():
    with pytest.warns(
        UserWarning, match="2 pairs; left out .* source: 'x'; .* 'd', 'e'"
    ):
        found = matched(marks(["a", "x", "B "]), marks(["b", "d", "a", "e"]))
    assert found.names == ("a", "B ") and found.numbers == [0, 2]
    assert found.target.names == ("a", "b")


@pytest.mark.parametrize(
    ("ours", "theirs", "order", "note"),
    [
        (
            ["F-1", "F-2", "F-3"],
            ["M_2", "M_1", "M_3"],
            [1, 0, 2],
            "numbers in their na",
        ),
        (
            ["p", "q", "r"],
            ["s", "t", "u"],
            [0, 1, 2],
            "no name .* in the order",
        ),
    ],
)
def test_names_that_differ(ours, theirs, order, note):
    with pytest.warns(UserWarning, match=note):
        found = matched(marks(ours), marks(theirs))
    assert found.target.names == tuple(theirs[i] for i in order)


def test_a_name_twice():
    with pytest.raises(
        ValueError, match="source_landmarks: landmark 'a' is there twice"
    ):
        matched(marks(["a", "b", "a"]), marks(["a", "b"]))
    places = np.array([[1.0, 2, 3], [4, 5, 6], [1, 2, 3]])
    with pytest.warns(UserWarning, match="'a' twice, at one place; counted once"):
        found = matched(marks(["a", "b", "a"], places), marks(["b", "a"]))
    assert found.names == ("a", "b")
    with pytest.raises(ValueError, match="found 3 on the source and 2 .* No name"):
        matched(marks(["a", "b", "c"]), marks(["d", "e"]))


@pytest.mark.parametrize("scale", [1e-9, 1.0, 1e9])
@pytest.mark.parametrize("system", ["LPS", "RAS"])
def test_coordinate_systems(tmp_path, system, scale):
    """Whatever the file says, where landmarks lie decides."""
    surface = mr.load_surface(trimesh.Trimesh(scale * W, F, process=False))
    as_is = written(tmp_path, "a.fcsv", fcsv(NAMES, scale * PLACES, system))
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        one = placed("target_landmarks", mr.read_landmarks(as_is), surface)
    flipped = fcsv(NAMES, scale * PLACES * [-1, -1, 1], system)
    other = mr.read_landmarks(written(tmp_path, "b.fcsv", flipped))
    with pytest.warns(
        UserWarning, match=f"{system} coordinates, .* x and y are negated"
    ):
        two = placed("target_landmarks", other, surface)
    np.testing.assert_allclose(one, scale * PLACES, atol=1e-12 * scale)
    np.testing.assert_allclose(two, scale * PLACES, atol=1e-12 * scale)


def outside(places, share):
    """The landmark 'chin' off the surface by a share of the size."""
    normal = np.asarray(mr.load_surface(MESH).cloud.normals)[60]
    return np.where(places == places[3], places + share * SIZE * normal, places)


def test_off_the_surface(surface):
    with pytest.warns(
        UserWarning, match="1 of 5 lie off .* 'chin'; its closest points"
    ):
        found = placed(
            "target_landmarks", marks(NAMES, outside(PLACES, 0.015)), surface
        )
    np.testing.assert_allclose(found, PLACES, atol=0.003 * SIZE)
    with pytest.raises(
        ValueError, match="landmark chin lies .* 2 % .* is this one mista"
    ):
        placed("target_landmarks", marks(NAMES, outside(PLACES, 0.03)), surface)


@pytest.mark.parametrize(
    ("by", "cure"),
    [
        ([-1, -1, 1], r"LPS and RAS.*\[-1, -1, 1\]"),
        (1e-3, "multiply positions by 1000"),
    ],
)
def test_what_would_bring_them_onto_it(surface, by, cure):
    with pytest.raises(ValueError, match=cure):
        placed("target_landmarks", marks(NAMES, PLACES * by), surface)


def test_numbers_from_one(surface, tmp_path):
    numbers = np.array([1, 30, len(W)])
    text = "vertex\n" + "\n".join(map(str, numbers))
    path = written(tmp_path, "a.csv", text)
    with pytest.warns(UserWarning, match="counts vertices from 1.* 1 is subtracted"):
        found = placed("source_landmarks", mr.read_landmarks(path), surface)
    np.testing.assert_allclose(found, W[numbers - 1], atol=1e-12)
    with pytest.raises(ValueError, match="vertex 162 does not exist; there are 162"):
        placed("source_landmarks", as_landmarks("source_landmarks", numbers), surface)


RNG = np.random.default_rng(0)
X = W[RNG.choice(len(W), 30, replace=False)]
Y = (
    X * [1.1, 0.9, 1.0]
    + 0.1 * np.sin(2 * X[:, [1, 2, 0]])
    + 0.005 * RNG.normal(size=(30, 3))
)
LABELS = [f"p{i}" for i in range(30)]


def test_left_out_residuals_are_those_of_left_out_fits():
    """Against scipy's interpolant without each."""
    from scipy.interpolate import RBFInterpolator

    from manireg._surfaces.suspects import RIDGE, _inverse

    distance = np.linalg.norm(X[:, None] - X[None], axis=2)
    exact = []
    for i in range(len(X)):
        rest = np.delete(np.arange(len(X)), i)
        spline = RBFInterpolator(
            X[rest], Y[rest], kernel="linear", degree=1,
            smoothing=RIDGE * distance.mean(),
        )  # fmt: skip
        exact.append(np.linalg.norm(spline(X[i : i + 1])[0] - Y[i]))
    np.testing.assert_allclose(left_out(_inverse(X), Y), exact, rtol=1e-6)


def test_sound_landmarks_are_not_doubted():
    for scale, shift in ((1.0, 0.0), (1e-9, 0.0), (1e9, 0.0), (1.0, 1e6)):
        assert suspects(scale * (X + shift), Y, LABELS) == []


@pytest.mark.parametrize(
    "pairs", [[(3, 17)], [(0, 5), (8, 21)], [(2, 9), (4, 11), (1, 29)]]
)
def test_swapped(pairs):
    y = Y.copy()
    for i, j in pairs:
        y[[i, j]] = Y[[j, i]]
    told = suspects(X, y, LABELS)
    assert len(told) == len(pairs)
    for i, j in pairs:
        text = f"'p{i}' and 'p{j}' seem to be swapped"
        assert any(text in t or f"'p{j}' and 'p{i}' seem" in t for t in told)


def test_one_twice():
    y = Y.copy()
    y[12] = Y[4]
    (told,) = suspects(X, y, LABELS)
    assert "'p4' and 'p12' are at one place on the target, but apart on the s" in told


def test_misplaced():
    y = Y.copy()
    y[7] += 0.8
    (told,) = suspects(X, y, LABELS)
    assert "'p7' seems misplaced" in told


def test_register_tells(tmp_path, monkeypatch):
    """Two swapped, from files of two programs; what is fitted is matched by name."""
    numbers = np.arange(0, 162, 8)
    names = [str(i) for i in numbers]
    theirs = numbers.copy()
    theirs[[2, 11]] = numbers[[11, 2]]
    a = written(tmp_path, "a.mrk.json", markups(names, W[numbers]))
    b = written(tmp_path, "b.pp", pp(names[::-1], W[theirs][::-1]))
    fitted = []

    def stop(source, target, x, y, **options):
        fitted.extend([x, y])
        raise InterruptedError

    monkeypatch.setattr(landmark_fit, "make_problem", stop)
    text = f"'{names[2]}' and '{names[11]}' seem to be swapped"
    with pytest.warns(UserWarning, match=text), pytest.raises(InterruptedError):
        mr.register(MESH, MESH, a, b, 1e-3, centres=20, progress=False)
    np.testing.assert_allclose(fitted[0], W[numbers], atol=1e-12)
    np.testing.assert_allclose(fitted[1], W[theirs], atol=1e-12)


@pytest.mark.slow
def test_sharp_landmarks_count_more():
    """Half of the landmarks are off: those with the larger sigma."""
    numbers = np.arange(0, 162, 8)
    off = np.arange(len(numbers)) % 2 == 1
    wrong = np.roll(W, 1, axis=0)[numbers] * 0.05 + W[numbers] * 0.95
    y = np.where(off[:, None], wrong, W[numbers])
    y = np.asarray(mr.load_surface(MESH).cloud.project(jnp.asarray(y)))
    options = {"centres": 20, "progress": False}
    alike = mr.register(MESH, MESH, numbers, y, 1e-4, **options)
    sigma = np.where(off, 1.0, 0.01)
    told = mr.register(MESH, MESH, numbers, y, 1e-4, sigma=sigma, **options)
    matrices = np.eye(3) * sigma[:, None, None] ** -2
    same = mr.register(MESH, MESH, numbers, y, 1e-4, precision=matrices, **options)
    error = lambda found: np.linalg.norm(found.vertices - W, axis=1).mean()
    assert error(told) < 0.5 * error(alike)
    np.testing.assert_allclose(same.vertices, told.vertices, atol=1e-6)


@pytest.mark.parametrize("other", ["C57BL6_J", "CAST_EIJ", "DBA_2J", "NZO", "WSB"])
def test_skulls_are_not_doubted(data_folder, other):
    """51 landmarks digitised by hand; any two that change places are found."""
    sets = [
        mr.read_landmarks(data_folder / "meshes" / f"skull_{name}.mrk.json")
        for name in ("A_J", other)
    ]
    pairs = matched(*sets)
    x, y = pairs.source.positions, pairs.target.positions
    assert x is not None and y is not None and len(x) == 51
    assert suspects(x, y, pairs.names) == []
    for i, j in np.random.default_rng(0).choice(51, (10, 2), replace=False):
        swapped = y.copy()
        swapped[[i, j]] = y[[j, i]]
        told = suspects(x, swapped, pairs.names)
        assert len(told) == 1 and repr(pairs.names[i]) in told[0]
        assert repr(pairs.names[j]) in told[0]


SCANS = [
    pytest.param(f"skull_{name}.ply", marks=pytest.mark.slow)
    for name in ("A_J", "C57BL6_J", "CAST_EIJ", "DBA_2J", "NZO", "WSB")
] + ["face_demo_10K.obj", "face_template_10K.obj"]


@pytest.mark.parametrize("name", SCANS)
def test_real_scans_and_their_landmarks(data_folder, name):
    """Dozens of components, holes, NaN: a surface, with the landmarks on it."""
    path = data_folder / "meshes" / name
    found = mr.load_surface(path)
    assert len(found.vertices) == len(found.of_vertex) > 9_000
    assert np.all(np.isfinite(found.cloud.bendings)) and np.all(
        np.isfinite(found.places)
    )
    if name.startswith("skull"):
        marks, count = path.with_suffix(".mrk.json"), 51
        assert "components of less than 1 %" in found.report.notable
    else:
        stem = name.removeprefix("face_").removesuffix("_10K.obj").title()
        kind = {"Demo": "DemoFace", "Template": "Template"}[stem]
        marks, count = path.with_name(f"face_{kind}Landmarks.csv"), 5
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)
        there = placed("landmarks", mr.read_landmarks(marks), found)
    assert there.shape == (count, 3)
