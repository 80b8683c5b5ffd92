"""The words of predictions: what is looked at and from where, and what comes back."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, Literal, Protocol

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    from luxloop.client import Answer
    from luxloop.errors import RemoteError
    from luxloop.model import Model
    from validation.dataset.manifest import FilmSample, Sample

Real = NDArray[np.float64]

POSE_COLUMNS = ("shift_row_px", "shift_column_px", "rotation_deg")
"""Names of a pose's numbers among the columns of a Jacobian."""


class Asks(Protocol):
    """What a predictor needs of a client; `luxloop.client.Client` does it."""

    def run(self, request: Any, *, fresh: bool = False) -> Answer:
        """The answer to one request; RemoteError where there is none."""

    def map(self, requests: Sequence[Any], **options: Any) -> Iterable[tuple[int, Answer | RemoteError]]:
        """(number, answer or failure) of each request, as they come in; options are those of `run`."""


@dataclass(frozen=True)
class Pose:
    """Where an image lies beside where it was said to lie."""

    shift_px: tuple[float, float] = (0.0, 0.0)
    """(row, column), in pixels of the view."""
    rotation_deg: float = 0.0
    """Of the image about the module's centre, x towards y."""

    def shift_um(self, pixel_um: float) -> tuple[float, float]:
        """(x, y) on the receiver of a view with such pixels."""
        return self.shift_px[1] * pixel_um, self.shift_px[0] * pixel_um


def run_of(sample: Sample, model: Model) -> str:
    """Equal for samples whose images are seen by the same histories: modules of the same numbers, whatever their ids.

    `model`: of the anchor, whose histories they are. A sample with effects of its own there is a module of its own.
    """
    return sample.id if sample.id in model.samples else sample.model_copy(update={"id": ""}).model_dump_json()


@dataclass(frozen=True)
class Sensor:
    """What makes a signal of light, for effects that act on signals: gain x irradiance + offset, up to full scale."""

    gain_dn: float
    offset_dn: float
    full_scale_dn: float


@dataclass(frozen=True)
class View:
    """A camera in front of a sample; its pixels are binned ones where images were binned."""

    sample: Sample
    rows: int
    columns: int
    pixel_um: float
    """Side of a pixel on the receiver."""
    centre_px: tuple[float, float]
    """(row, column) of the module's centre before the pose."""
    pose: Pose = Pose()
    sensor: Sensor | None = None
    """Where effects bend signals; none: as at a gain of 1 without offset."""


@dataclass(frozen=True)
class Anchored:
    """Where Monte Carlo is run, so that the twin is asked for differences only."""

    model: Model
    histories: int
    """At least so many for each sample."""
    seed: int = 1
    poses: Sequence[Pose] = ()
    """One for each view: where the difference between Monte Carlo and twin is seen from; none: unmoved cameras."""
    exit_seed: int = 1
    """Of the walk inside chips whose exits the twin lands: its derivatives have noise of their own."""
    stored_exits: bool = False
    """Whether Monte Carlo lands exits of that walk, too: what stands around a chip is moved without walking anew."""
    enough: tuple[tuple[str, int], ...] = ()
    """(id of a sample, histories) where fewer do: one chip lights its image with all of them, 25 share them."""

    def histories_of(self, sample: str) -> int:
        """Of a sample by its id."""
        return min(self.histories, dict(self.enough).get(sample, self.histories))


@dataclass(frozen=True, eq=False)
class Predicted:
    """An expected image, before the camera's gain."""

    irradiance_per_mm2: Real
    """(row, column), per flux of a chip."""
    jacobian_per_mm2: dict[str, Real]
    """(row, column) by path of the model, per that parameter's own unit, or by name of the pose's number."""
    noise_per_mm2: Real | None = None
    """(function, row, column) of an anchor: the covariance of two pixels is the sum over functions of their products.
    The noise of views with different samples is independent; where the anchor has `stored_exits`, of those with
    different chips only: samples of the same chip land the same exits."""
    twin_per_mm2: Real | None = None
    """(row, column), the twin's own image where there is an anchor: it errs, but not as the anchor's noise does,
    unless the anchor has `stored_exits`: then it lands the twin's own."""
    by_gain_per_mm2: Real | None = None
    """(row, column), by which the signal grows with the gain, where a sensor bends it: else as the image has it."""
    by_offset: Real | None = None
    """(row, column), by which the signal grows with the offset, where a sensor bends it: else 1."""
    by_pose_per_mm2: dict[str, Real] = field(default_factory=dict)
    """(row, column) by name of the pose's number, about an anchor: how the image itself changes, with the anchor's
    noise where the jacobian has the twin's. Empty without one."""
    of_all_light: frozenset[str] = frozenset()
    """Paths whose derivatives are of what an anchor has over the twin, too."""


@dataclass(frozen=True, eq=False)
class Traced(Predicted):
    """An image by Monte Carlo alone."""

    error_per_mm2: Real = field(kw_only=True)
    """(row, column), standard error of each pixel; its neighbours err with it."""


@dataclass(frozen=True, eq=False)
class Curve:
    """Rows of a spectrum or an ellipsometric curve of a film."""

    film: FilmSample
    quantity: Literal["R", "T", "psi", "delta"]
    wavelength_nm: Real
    """(row,)"""
    aoi_deg: Real
    """(row,)"""
    polarisation: Sequence[str]
    """(row,): s, p, u; "" with psi and delta."""
    bandwidth_nm: float = 0.0


@dataclass(frozen=True, eq=False)
class FarView:
    """Directions in which a goniometer looks at a sample."""

    sample: Sample
    theta_deg: Real
    """(row,), from the normal."""
    phi_deg: Real
    """(row,), from x towards y."""


@dataclass(frozen=True, eq=False)
class PredictedCurve:
    """Expected values of the rows of a curve, and how they change."""

    value: Real
    """(row,): R and T as shares, psi and delta in degrees, a far field in 1/sr per flux of a chip."""
    jacobian: dict[str, Real]
    """(row,) by path, per that parameter's own unit."""
    error: Real | None = None
    """(row,): standard error that Monte Carlo left in a far field."""
