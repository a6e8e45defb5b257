"""What `manireg fit` is told of the noise of outputs and inputs."""

from typing import Annotated, Literal, NamedTuple

import numpy as np
import typer

import manireg as mr

from .._objective.robust import AbstractLoss
from .._selection.criteria import CriterionName
from .._selection.noise import Scatter
from ..datasets._text_tables import TextTable
from .axes import Axis, axis_of
from .columns import find, numbers, refuse
from .tables import Target

LossName = Literal["squared", "huber", "tukey", "student"]
MIDDLE = "input"  # the input column, where only the ends of ranges are given

Sigma = Annotated[
    str | None,
    typer.Option(
        help="Column of standard deviations: degrees, about any axis for rotations; in "
        "the unit of the outputs for `euclidean`."
    ),
]
A95 = Annotated[
    str | None,
    typer.Option(help="Instead: 95 % confidence radii on the sphere, degrees."),
]
Kappa = Annotated[
    str | None, typer.Option(help="Instead: Fisher's concentrations on the sphere.")
]
XSigma = Annotated[
    str | None,
    typer.Option(
        help="Column of standard deviations of the input, in its unit; of dates, seconds."
    ),
]
XMin = Annotated[
    str | None,
    typer.Option(
        help="With --x-max: the input may be anywhere between these columns. Without "
        f"--input, their middle is taken, `{MIDDLE}` in predictions."
    ),
]
XMax = Annotated[str | None, typer.Option(help="The other end, see --x-min.")]
Loss = Annotated[
    LossName,
    typer.Option(help="What residuals cost; all but `squared` let go of outliers."),
]
Scattering = Annotated[
    Scatter,
    typer.Option(
        help="Where data scatter more than --sigma, --a95 or --kappa say: `additive` "
        "adds a variance to all, `factor` multiplies them, `none` believes them."
    ),
]
Criterion = Annotated[
    CriterionName,
    typer.Option(
        help="What lambda is chosen by: the `error` of rows left out, `gcv` (generalised "
        "cross-validation) or `reml` (restricted likelihood)."
    ),
]
Wavelength = Annotated[
    float | None,
    typer.Option(
        help="Instead of --lam: a length in the unit of the input, of which waves keep "
        "half of their height, longer ones more (of dates: seconds)."
    ),
]
Level = Annotated[
    float,
    typer.Option(help="Confidence of regions, in predictions and picture, percent."),
]


def loss_of(name: LossName) -> AbstractLoss:
    losses = {
        "squared": mr.Squared,
        "huber": mr.Huber,
        "tukey": mr.Tukey,
        "student": mr.StudentT,
    }
    return losses[name]()


def check_level(level: float) -> None:
    if not 0 < level < 100:
        raise ValueError(
            f"--level is a percentage between 0 and 100, found {level:g}; give 95 or 68."
        )


class NoiseColumns(NamedTuple):
    """The columns that tell of it, None where not given."""

    sigma: str | None = None
    a95: str | None = None
    kappa: str | None = None
    x_sigma: str | None = None
    x_min: str | None = None
    x_max: str | None = None

    def found(self, table: TextTable) -> "NoiseColumns":
        """With the names that the table has."""
        if len([name for name in self[:3] if name is not None]) > 1:
            raise ValueError(
                "--sigma, --a95, --kappa: all say how precise rows are; give one of them."
            )
        if (self.x_min is None) != (self.x_max is None):
            raise ValueError("--x-min, --x-max: give both ends of the range.")
        if self.x_sigma is not None and self.x_min is not None:
            raise ValueError(
                "--x-sigma, --x-min: an input has a standard deviation or a range; give "
                "one of them."
            )
        names = {
            field: find(table, name, "--" + field.replace("_", "-"))
            for field, name in self._asdict().items()
            if name is not None
        }
        return NoiseColumns(**names)

    @property
    def names(self) -> list[str]:
        return [name for name in self if name is not None]

    def of_outputs(self, table: TextTable, there: Target) -> dict[str, np.ndarray]:
        """For `mr.fit`, in the unit of the target."""
        if self.sigma is not None:
            sigma = _positive(table, "--sigma", self.sigma, "standard deviations")
            return {"sigma": sigma / (there.degrees or 1.0)}
        for option, name, convert in (
            ("--a95", self.a95, mr.from_a95),
            ("--kappa", self.kappa, mr.from_kappa),
        ):
            if name is not None:
                _check_sphere(option, there)
                what = "confidence radii" if option == "--a95" else "concentrations"
                return {
                    "sigma": np.asarray(convert(_positive(table, option, name, what)))
                }
        return {}

    def of_inputs(self, table: TextTable, axes: list[Axis]) -> dict[str, np.ndarray]:
        """For `mr.fit`, of the only input."""
        if self.x_sigma is None and self.x_min is None:
            return {}
        if len(axes) > 1:
            raise ValueError(
                f"--x-sigma, --x-min, --x-max: for one input, found {len(axes)}."
            )
        if self.x_sigma is not None:
            what = "standard deviations of the input"
            return {"x_sigma": _positive(table, "--x-sigma", self.x_sigma, what)}
        low, high = self._ends(table, axes[0])
        return {"x_min": low, "x_max": high}

    def with_middle(self, table: TextTable) -> TextTable:
        """With the middle of the range as a column."""
        assert self.x_min is not None
        axis = axis_of(self.x_min, [table])
        middle = axis.texts(np.mean(self._ends(table, axis), axis=0))
        return table._replace(columns=table.columns | {MIDDLE: middle})

    def _ends(self, table: TextTable, axis: Axis) -> tuple[np.ndarray, np.ndarray]:
        """Both, from the origin of the axis."""
        assert self.x_min is not None and self.x_max is not None
        names = self.x_min, self.x_max
        for name in names:
            own = axis_of(name, [table])
            if (own.dates, own.zoned) != (axis.dates, axis.zoned):
                raise ValueError(
                    f"{table.path}: --x-min, --x-max: columns {', '.join(names)} and "
                    f"`{axis.name}` have to be written alike, all numbers or all dates."
                )
        low, high = (axis._replace(name=name).floats(table) for name in names)
        demand = f"--x-min: {names[0]} must not exceed {names[1]}"
        cure = "Exchange the options, or mend the row"
        refuse(table, names[0], low > high, demand, cure)
        return low, high


def _positive(table: TextTable, option: str, name: str, what: str) -> np.ndarray:
    values = numbers(table, [name], option)[:, 0]
    demand, cure = f"{what} must be positive", "Remove the row"
    refuse(table, name, values <= 0, demand, cure)
    return values


def _check_sphere(option: str, there: Target) -> None:
    if not (isinstance(there.manifold, mr.Sphere) and there.manifold.dim == 2):
        raise ValueError(
            f"{option} is of directions on the sphere; for other targets give standard "
            "deviations, --sigma."
        )
