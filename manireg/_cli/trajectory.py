"""`manireg trajectory`."""

import time
from pathlib import Path
from typing import Annotated, Literal

import numpy as np
import typer

from .. import apps, plot
from ..apps._pose_files import PoseTable, read_poses, read_stamps, write_poses
from ..apps._stamps import Stamps
from ..apps._trajectory import Trajectory
from ..apps._trajectory_picture import trajectory_picture
from .arguments import check_not_read, order_of
from .errors import check_written, clean_errors
from .motion_table import motion_table
from .noise import Level, LossName, check_level, loss_of
from .report import print_rows
from .trajectory_rows import compared, described, fitted


def trajectory(
    poses: Annotated[
        Path,
        typer.Argument(
            help="TUM (t x y z qx qy qz qw), KITTI (12 numbers a line), or a table with "
            "names, as EuRoC's csv and those of inertial sensors (quaternion alone)."
        ),
    ],
    reference: Annotated[
        Path | None,
        typer.Option(help="The true trajectory: prints ATE and RPE before and after."),
    ] = None,
    rate: Annotated[
        float | None,
        typer.Option(min=1e-9, help="Write so many poses a second, evenly spaced."),
    ] = None,
    times: Annotated[
        Path | None,
        typer.Option(help="Write poses at the times of this file, in the same clock."),
    ] = None,
    input_rate: Annotated[
        float | None,
        typer.Option(min=1e-9, help="Poses a second of a file without times (KITTI)."),
    ] = None,
    stamps: Annotated[
        Path | None,
        typer.Option(help="Instead: a file with its times, one a line."),
    ] = None,
    unit: Annotated[
        Literal["s", "ms", "us", "ns"] | None,
        typer.Option(
            help="Of times; by default as the column's name or their size say."
        ),
    ] = None,
    position_sigma: Annotated[
        float | None,
        typer.Option(
            min=1e-300, help="Noise of positions along each axis, metres; else found."
        ),
    ] = None,
    orientation_sigma: Annotated[
        float | None,
        typer.Option(
            min=1e-300,
            help="Noise of orientations about each axis, degrees; else found.",
        ),
    ] = None,
    loss: Annotated[
        LossName,
        typer.Option(help="What residuals cost; all but `squared` let go of outliers."),
    ] = "squared",
    reject: Annotated[
        bool,
        typer.Option(
            help="Leave out poses far from what their neighbours in time say."
        ),
    ] = True,
    order: Annotated[
        str,
        typer.Option(
            help="Of the derivatives that are kept small; of several the better "
            "one is chosen, for positions and orientations each."
        ),
    ] = "2,3",
    centres: Annotated[
        int | None,
        typer.Option(min=4, help="Of the basis; by default as many as the data need."),
    ] = None,
    delta: Annotated[
        float, typer.Option(min=1e-9, help="Seconds that the RPE looks ahead.")
    ] = 1.0,
    out: Annotated[
        Path | None,
        typer.Option(help="The smoothed poses, in the format of the input."),
    ] = None,
    table: Annotated[
        Path | None,
        typer.Option(help="CSV file of velocities, angular rates and their regions."),
    ] = None,
    picture: Annotated[
        Path | None, typer.Option(help="Also draw it: PNG, PDF or SVG.")
    ] = None,
    level: Level = 95.0,
) -> None:
    """Smooth a trajectory of poses, fill its gaps, find its outliers and velocities.

    Positions and orientations are fitted as functions of time, noise and smoothness found
    from the data. Written are the input's own times, with gaps filled at its median step,
    or those of --rate or --times; of time stamps every digit is kept. The table has linear
    velocity along axes of space (m/s) and angular velocity about axes of the body
    (degrees/s) with standard errors (se_), and the radii of balls as large as the regions
    of --level percent of position (m), orientation (degrees) and both velocities;
    `no_data` is 1 in gaps longer than the smoother bridges.

    With --reference the ATE (root mean square of position after the best rotation and
    shift) and the RPE (over --delta seconds) of the input and of the smoothed poses are
    printed, at the reference's times with a pose within 0.01 s.

    Examples:

        manireg trajectory poses.tum --reference truth.tum --out smooth.tum
            --table motion.csv --picture flight.pdf

        manireg trajectory 00.txt --stamps times.txt --rate 100 --table motion.csv

        manireg trajectory imu.csv --out smooth.csv
    """
    with clean_errors():
        written = [path for path in (out, table) if path is not None]
        check_written(picture, *written)
        check_level(level)
        if not (written or picture or reference):
            raise ValueError("Give --out, --table, --picture or --reference.")
        if rate is not None and times is not None:
            raise ValueError("--rate, --times: give one of them.")
        others = [
            path for path in (poses, reference, times, stamps) if path is not None
        ]
        for path in written:
            check_not_read(path, *others)
        data = _timed(read_poses(poses, unit), poses, input_rate, stamps, unit)
        true = None
        if reference is not None:
            true = _timed(
                read_poses(reference, unit), reference, input_rate, stamps, unit
            )
        clock = data.stamps
        assert clock is not None
        first = clock.first
        start = time.perf_counter()
        t = clock.seconds(first)
        degrees = None if orientation_sigma is None else np.radians(orientation_sigma)
        found = apps.trajectory(
            t,
            data.positions,
            data.quaternions,
            quaternions="wxyz",
            position_sigma=position_sigma,
            orientation_sigma=degrees,
            loss=loss_of(loss),
            reject=reject,
            order=order_of(order),
            centres=centres,
        )
        asked = _asked(found, clock, rate, times, unit)
        motion = found.after(asked.seconds(first))
        seconds = time.perf_counter() - start
        rows = {"data": described(poses, data, t)} | fitted(found, clock)
        if true is not None:
            rows |= compared(found, data, true, t, first, delta)
        rows["poses written"] = str(len(asked.exact)) if written else "0"
        rows["time"] = f"{seconds:.1f} s"
        if out is not None:
            assert motion.quaternions is not None
            write_poses(out, data, asked, motion.positions, motion.quaternions)
        if table is not None:
            motion_table(table, found, asked, motion, level, first)
        if picture is not None:
            given = data.positions, data.quaternions
            drawn = trajectory_picture(found, *given, level / 100)
            plot.save(drawn, picture)
        print_rows(rows, written + ([picture] if picture else []))


def _timed(
    data: PoseTable, path: Path, rate: float | None, stamps: Path | None, unit
) -> PoseTable:
    """With stamps, where the file has none."""
    if data.stamps is not None:
        return data
    k = len(data.quaternions)
    if stamps is not None:
        found = read_stamps(stamps, unit)
        if len(found.exact) != k:
            raise ValueError(
                f"{stamps}: {len(found.exact)} times for the {k} poses of {path}."
            )
        return data._replace(stamps=found)
    if rate is None:
        raise ValueError(
            f"{path} has no times: give --input-rate, its poses a second (KITTI: 10), or "
            "--stamps, a file of times."
        )
    return data._replace(stamps=Stamps.at_rate(k, rate))


def _asked(found: Trajectory, clock: Stamps, rate, times: Path | None, unit) -> Stamps:
    if rate is not None:
        return clock.every(rate)
    if times is None:
        step = float(np.median(np.diff(np.unique(found.times))))
        return clock.with_gaps_filled(found.gaps, step)
    asked = read_stamps(times, unit)
    t = asked.seconds(clock.first)
    out = (t < found.times.min() - 1e-9) | (t > found.times.max() + 1e-9)
    if out.any():
        first = asked.texts()[int(np.argmax(out))]
        raise ValueError(
            f"{times}: {out.sum()} of {len(t)} times lie outside those of the poses, "
            f"first {first}; they are not extrapolated. Both have to be in the same clock "
            "and unit (--unit)."
        )
    return asked
