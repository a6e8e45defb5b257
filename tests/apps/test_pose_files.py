"""Pose files as others write them, and time stamps to the last digit."""

from decimal import Decimal
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from manireg.apps._pose_files import read_poses, read_stamps, write_poses
from manireg.apps._stamps import Stamps

FIRST = 1403715524907143168  # nanoseconds
TURNS = Rotation.from_quat(np.random.default_rng(0).normal(size=(5, 4)))
PLACES = np.random.default_rng(0).normal(size=(5, 3))
STAMPS = [FIRST + 20_000_001 * i for i in range(5)]


def euroc(path, offset=0.0):
    q = TURNS.as_quat(scalar_first=True)
    lines = [
        "#timestamp [ns], p_RS_R_x [m], p_RS_R_y [m], p_RS_R_z [m], q_RS_w [], q_RS_x [], "
        "q_RS_y [], q_RS_z [], v_RS_R_x [m s^-1], v_RS_R_y [m s^-1], v_RS_R_z [m s^-1]"
    ]
    for stamp, p, turn in zip(STAMPS, PLACES + offset, q):
        lines.append(",".join([str(stamp), *map(repr, [*p.tolist(), *turn.tolist()])]))
        lines[-1] += ",0.0,0.0,0.0"
    path.write_text("\n".join(lines) + "\n")
    return path


def same(table):
    turns = Rotation.from_quat(table.quaternions, scalar_first=True)
    assert (turns.inv() * TURNS).magnitude().max() < 1e-7
    np.testing.assert_allclose(table.positions, PLACES, atol=1e-8)


def test_euroc(tmp_path):
    table: Any = read_poses(euroc(tmp_path / "gt.csv"))
    assert table.kind == "csv" and table.scalar_first
    assert table.stamps.unit == Decimal("1e-9")
    assert table.stamps.texts() == [str(stamp) for stamp in STAMPS]
    same(table)
    out = tmp_path / "out.csv"
    write_poses(out, table, table.stamps, table.positions, table.quaternions)
    again = read_poses(out)
    assert out.read_text().startswith("#timestamp [ns],p_RS_R_x [m]")
    assert again.stamps == table.stamps
    same(again)


def test_tum(tmp_path):
    path = tmp_path / "poses.tum"
    rows = np.hstack([PLACES, TURNS.as_quat()])
    texts = ["1.403715529112143517e+09", *(f"1403715530.{i}00000001" for i in range(4))]
    path.write_text(
        "".join(f"{t} {' '.join(map(repr, r))}\n" for t, r in zip(texts, rows.tolist()))
    )
    table: Any = read_poses(path)
    assert table.kind == "tum" and not table.scalar_first
    assert table.stamps.texts() == ["1403715529.112143517", *texts[1:]]
    same(table)
    out = tmp_path / "out.tum"
    write_poses(out, table, table.stamps, table.positions, table.quaternions)
    first = out.read_text().split("\n")[0].split(" ")
    assert first[0] == "1403715529.112143517" and len(first) == 8
    same(read_poses(out))
    named = tmp_path / "named.txt"
    named.write_text("# timestamp tx ty tz qx qy qz qw\n" + path.read_text())
    table: Any = read_poses(named)
    assert table.kind == "tum"
    same(table)


def test_kitti(tmp_path):
    path = tmp_path / "00.txt"
    matrices = np.concatenate([TURNS.as_matrix(), PLACES[:, :, None]], axis=2)
    np.savetxt(path, matrices.reshape(5, 12), fmt="%.9e")
    table: Any = read_poses(path)
    assert table.kind == "kitti" and table.stamps is None
    same(table)
    out = tmp_path / "out.txt"
    write_poses(out, table, None, table.positions, table.quaternions)
    same(read_poses(out))


@pytest.mark.parametrize(
    "names", ["qw,qx,qy,qz", "q0,q1,q2,q3", "quat_w,quat_x,quat_y,quat_z"]
)
def test_orientations_alone(tmp_path, names):
    path = tmp_path / "imu.csv"
    rows = np.hstack([0.02 * np.arange(5)[:, None], TURNS.as_quat(scalar_first=True)])
    np.savetxt(path, rows, delimiter=",", header=f"time_s,{names}", comments="")
    table: Any = read_poses(path)
    assert table.positions is None and table.stamps.unit == 1
    turns = Rotation.from_quat(table.quaternions, scalar_first=True)
    assert (turns.inv() * TURNS).magnitude().max() < 1e-7


def test_scalar_last_columns_stay_so(tmp_path):
    path = tmp_path / "imu.csv"
    rows = np.hstack([0.02 * np.arange(5)[:, None], TURNS.as_quat()])
    np.savetxt(path, rows, delimiter=",", header="t,qx,qy,qz,qw", comments="")
    table: Any = read_poses(path)
    assert not table.scalar_first and table.columns[1:] == ("qx", "qy", "qz", "qw")
    out = tmp_path / "out.csv"
    write_poses(out, table, table.stamps, None, table.quaternions)
    turns = Rotation.from_quat(read_poses(out).quaternions, scalar_first=True)
    assert (turns.inv() * TURNS).magnitude().max() < 1e-7


def test_mistakes(tmp_path):
    path = tmp_path / "poses.txt"
    path.write_text("1 2 3 4 5\n" * 3)
    with pytest.raises(ValueError, match="5 columns without a header"):
        read_poses(path)
    path.write_text("t,a,b\n1,2,3\n2,3,4\n")
    with pytest.raises(ValueError, match="no quaternion among the columns t, a, b"):
        read_poses(path)
    path.write_text("t,time,qw,qx,qy,qz\n" + "1,2,1,0,0,0\n" * 3)
    with pytest.raises(ValueError, match="several columns may be the time: t, time"):
        read_poses(path)
    path.write_text("t,qw,qx,qy,qz\n" + "1,2,0,0,0\n" * 3)
    with pytest.raises(ValueError, match="poses.txt: quaternion: 3 of 3 have a length"):
        read_poses(path)
    path.write_text("t,qw,qx,qy,qz\n1,1,0,0,0\n2,nan,0,0,0\n3,1,0,0,0\n")
    with pytest.warns(UserWarning, match="1 of 3 rows have missing values"):
        assert len(read_poses(path).quaternions) == 2


def test_stamps_are_exact():
    stamps = Stamps.of([str(FIRST + 1), str(FIRST + 20_000_002)], None)
    assert stamps.unit == Decimal("1e-9")
    np.testing.assert_array_equal(stamps.seconds(stamps.first), [0.0, 0.020000001])
    finer = stamps.every(200.0)
    assert finer.texts() == [str(FIRST + 1 + 5_000_000 * i) for i in range(5)]
    tum = Stamps.of(["1403715524.907143169", "1403715524.927143170"], None)
    assert tum.unit == 1
    np.testing.assert_allclose(
        tum.seconds(stamps.first), [0.0, 0.020000001], atol=1e-18
    )
    thirds = tum.every(300.0).texts()
    assert thirds[1] == "1403715524.910476502"
    assert thirds[3] == "1403715524.917143169"
    assert Stamps.at_rate(3, 10.0).texts() == [f"0.{i}00000000" for i in range(3)]


def test_times_of_a_file(tmp_path):
    path = tmp_path / "times.txt"
    path.write_text("0.000000e+00\n1.036224e-01\n")
    assert read_stamps(path).texts() == ["0.000000", "0.1036224"]
    path.write_text("x,time_ns\n1,5\n2,7\n")
    assert read_stamps(path).seconds(Decimal(0)).tolist() == [5e-9, 7e-9]


def test_counters_are_no_times(tmp_path):
    path = tmp_path / "imu.csv"
    rows = np.hstack([np.arange(5)[:, None], TURNS.as_quat(scalar_first=True)])
    np.savetxt(path, rows, delimiter=",", header="packet,q0,q1,q2,q3", comments="")
    table: Any = read_poses(path)
    assert table.stamps is None and table.columns[0] == "time"
