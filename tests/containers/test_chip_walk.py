"""The walk inside a chip: the unfolded one against the plain one, and both against what must be."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from scipy import stats
from scipy.special import expn

from containers.bsdf import Facets, Fresnel, GaussianLobe, Lambertian, Mirror, Mixture
from containers.ray_tracing.arrays import AFTER_TOP, CONES, ENDS, FROM_SIDES, LIFT, PATH, SHUT, THROUGH_TOP, UNFOLD
from containers.ray_tracing.kernel import EVENT_OF_EXIT, WEIGHT_OF_EXIT
from containers.ray_tracing.packing import scene_arrays
from containers.scene import Emission, Face
from tests.ray_scenes import ESCAPE, SUBSTRATE, N, Single, bare, chip, exits_of, film_face, scene, taking

HALF, TOP = 14.0, 35.0
FACES = ("+x", "-x", "+y", "-y", "top")


def rough_top() -> Face:
    """Half of the top face is clear, half scatters both ways."""
    inside = Mixture((Fresnel(N, 1.0), Lambertian(0.5, 0.4)), (0.5, 0.5))
    return Face((inside,), (Fresnel(1.0, N),))


CHIPS: dict[str, dict[str, Any]] = {
    "clear": {},
    "absorbing": {"absorption_per_um": 0.01},
    "film": {"top": film_face(5.5), "absorption_per_um": 0.003},
    "film that takes light": {"top": taking(0.5, 0.3)},
    "film that takes light beyond the critical angle": {"top": taking(0.5, 0.3, beyond=0.9)},
    "sides that take light": {"sides": taking(0.4, 0.45), "absorption_per_um": 0.003},
    "lossy mirror": {"bottom": "mirror", "mirror": Mirror(0.9)},
    "lossy mirror, absorbing": {"bottom": "mirror", "mirror": Mirror(0.9), "absorption_per_um": 0.01},
    "Lambertian mirror": {"bottom": "mirror", "mirror": Lambertian(0.9)},
    "air gap, absorbing": {"bottom": "air_gap", "absorption_per_um": 0.01},
    "low index": {"index": np.array([1.5]), "top": bare(1.5), "sides": bare(1.5), "absorption_per_um": 0.01},
    "flat": {"width_um": 90.0, "thickness_um": 5.0, "absorption_per_um": 0.01},
    "tall": {"width_um": 10.0, "thickness_um": 60.0, "absorption_per_um": 0.01},
    "absorbing above": {"absorption_per_um": 0.01, "absorption_rise_per_um": 0.01},
    "absorbing below, film that takes light": {
        "top": taking(0.5, 0.3, beyond=0.9), "absorption_per_um": 0.01, "absorption_rise_per_um": -0.01,
    },
    "absorbing above, sides that take light, tall": {
        "sides": taking(0.4, 0.45), "absorption_per_um": 0.02, "absorption_rise_per_um": 0.015, "width_um": 10.0,
        "thickness_um": 60.0,
    },
    "absorbing below, lossy mirror": {
        "bottom": "mirror", "mirror": Mirror(0.9), "absorption_per_um": 0.02, "absorption_rise_per_um": -0.02,
    },
}  # fmt: skip


def face_of(rays: Single, half: float = HALF, top: float = TOP) -> np.ndarray[Any, Any]:
    """Which of `FACES` each exit is at; -1 for none."""
    near = 1e-4
    found = np.full(len(rays), -1)
    for axis in (0, 1):
        for back, sign in enumerate((1.0, -1.0)):
            at = (np.abs(sign * rays[:, axis] - half) < near) & (sign * rays[:, 3 + axis] > 0.0)
            found[at & (np.abs(rays[:, axis]) >= half - near)] = 2 * axis + back
    found[(np.abs(rays[:, 2] - top) < near) & (rays[:, 5] > 0.0) & (found < 0)] = 4
    return found


def same_means(a: Single, b: Single, counts: tuple[int, int], of: Any, most: float = 4.5) -> None:
    """Means per history of `of(rays)` (n,), weighted, agree."""
    totals = []
    for rays, count in ((a, counts[0]), (b, counts[1])):
        value = np.asarray(of(rays), float) * rays[:, WEIGHT_OF_EXIT]
        mean = value.sum() / count
        totals.append((mean, np.sqrt(max((value**2).sum() / count - mean**2, 0.0) / count)))
    (m, e), (n, f) = totals
    assert abs(m - n) <= most * np.hypot(e, f) + 1e-12, (m, n, e, f)


@pytest.mark.parametrize("name", CHIPS)
def test_the_unfolded_walk_is_the_plain_walk(name: str) -> None:
    """Ends, shares by face, places, directions and paths: all statistics agree on the same chip."""
    changes = CHIPS[name]
    of, count = scene(changes), 24_000
    half, top = of.chip.width_um / 2.0, of.chip.thickness_um
    if name in ("clear",):
        count = 8_000
    a, ledger_a, notes_a = exits_of(of, unfold=True, count=count, sobol=False)
    b, ledger_b, notes_b = exits_of(of, unfold=False, count=count, seed=2, sobol=False)
    counts = (count, count)
    for end in range(ENDS.index("roulette")):  # its net is small and has long tails
        p = (ledger_a[end] + ledger_b[end]) / 2.0
        assert abs(ledger_a[end] - ledger_b[end]) < 4.5 * np.sqrt(2.0 * abs(p) / count) + 1e-12, ENDS[end]
    assert np.all(face_of(a, half, top) >= 0)
    assert np.all(face_of(b, half, top) >= 0)
    for face in range(len(FACES)):
        same_means(a, b, counts, lambda rays, face=face: face_of(rays, half, top) == face)
    for event in (THROUGH_TOP, FROM_SIDES, AFTER_TOP):
        same_means(a, b, counts, lambda rays, event=event: rays[:, EVENT_OF_EXIT] == event)
    for axis in range(6):
        for power in (1, 2):
            same_means(a, b, counts, lambda rays, axis=axis, power=power: rays[:, axis] ** power)
    same_means(a, b, counts, lambda rays: (face_of(rays, half, top) < 2) * rays[:, 2] / top)
    same_means(a, b, counts, lambda rays: (face_of(rays, half, top) < 2) * np.abs(rays[:, 3]))
    same_means(a, b, counts, lambda rays: (face_of(rays, half, top) == 4) * rays[:, 5] ** 2)
    for face in (0, 2, 4):  # where light is at a face and where it goes hang together
        for place, way in ((0, 3), (1, 4), (2, 5), (0, 4), (1, 5)):
            of_pair = lambda rays, face=face, place=place, way=way: (  # noqa: E731  # used in the next line only
                (face_of(rays, half, top) == face) * rays[:, place] * rays[:, way]
            )
            same_means(a, b, counts, of_pair)
    for reach in (20.0, 100.0, 400.0):  # the mean of clear chips has long tails
        with_path = (np.column_stack([rays, notes[:, PATH]]) for rays, notes in ((a, notes_a), (b, notes_b)))
        same_means(*with_path, counts, lambda rays, reach=reach: rays[:, -1] < reach)
    with_lift = (np.column_stack([rays, notes[:, LIFT]]) for rays, notes in ((a, notes_a), (b, notes_b)))
    lifted_a, lifted_b = with_lift
    for face in (0, 4):
        for power in (1, 2):
            same_means(
                lifted_a, lifted_b, counts,
                lambda rays, face=face, power=power: (face_of(rays, half, top) == face) * rays[:, -1] ** power,
            )  # fmt: skip


@pytest.mark.parametrize("R", [0.5, 0.9])
def test_what_a_lossy_top_takes_has_been_dimmed_on_the_way_to_it(R: float) -> None:
    """Of light that ends there the chip has had its share: the ends of the unfolded walk are the plain one's."""
    of, count = scene({"top": taking(R, 0.3 * (1.0 - R), beyond=R), "absorption_per_um": 0.02}), 40_000
    _, unfolded, _ = exits_of(of, unfold=True, count=count, sobol=False)
    _, plain, _ = exits_of(of, unfold=False, count=count, seed=2, sobol=False)
    for end in ("chip", "dbr"):
        place = ENDS.index(end)
        assert unfolded[place] == pytest.approx(plain[place], abs=4.5 * np.sqrt(0.5 / count)), end


@pytest.mark.parametrize("unfold", [True, False])
def test_what_a_black_film_takes_is_an_exponential_integral(unfold: bool) -> None:
    """Light of a thin layer at height z between a film and a bottom that take all, beside sides that pass none:

    the film's end is E2(a (T - z)) / 2, the bottom's E2(a z) / 2, the rest is the chip's.
    """
    alpha, depth, count = 0.02, 0.7, 60_000
    black = taking(0.0, 0.0, beyond=0.0)
    changes = {"top": black, "sides": taking(1.0, 0.0), "bottom": "mirror", "mirror": Mirror(0.0)}
    of = scene({**changes, "absorption_per_um": alpha}, emission=Emission(layer_depth=depth))
    _, ledger, _ = exits_of(of, unfold=unfold, count=count, sobol=False)
    film, bottom = (expn(2, alpha * TOP * share) / 2.0 for share in (1.0 - depth, depth))
    for end, expected in (("dbr", film), ("substrate", bottom), ("chip", 1.0 - film - bottom)):
        assert ledger[ENDS.index(end)] == pytest.approx(expected, abs=4.5 * np.sqrt(0.25 / count)), end


@pytest.mark.parametrize("intensity", [(1.0, 1.0, 1.0), (2.0, 1.0, 2.0), (0.5, 1.0, 3.0)])
@pytest.mark.parametrize(("absorption", "rise"), [(0.0, 0.0), (0.01, 0.0), (0.01, 0.01), (0.01, -0.01)])
@pytest.mark.parametrize("R", [0.9, 1.0])
def test_light_born_in_the_escape_cones_only_is_all_the_light(
    intensity: tuple[float, float, float], absorption: float, R: float, rise: float
) -> None:
    """Above a smooth mirror trapped light is booked and not followed: the same exits and ends as if it were."""
    emission = Emission(layer_depth=0.8, cosine=np.array([-1.0, 0.0, 1.0]), intensity=np.array(intensity))
    absorbing = {"absorption_per_um": absorption, "absorption_rise_per_um": rise}
    of = scene({"bottom": "mirror", "mirror": Mirror(R), **absorbing}, emission=emission)
    count = 60_000
    assert scene_arrays(of).flags[CONES] == 1
    a, ledger_a, _ = exits_of(of, cones=True, count=count, sobol=False)
    b, ledger_b, _ = exits_of(of, cones=False, count=count, seed=2, sobol=False)
    for end in range(ENDS.index("roulette")):
        assert ledger_a[end] == pytest.approx(ledger_b[end], abs=4.5 * np.sqrt(0.5 / count)), ENDS[end]
    counts = (count, count)
    for face in range(len(FACES)):
        same_means(a, b, counts, lambda rays, face=face: face_of(rays) == face)
    for axis in range(6):
        for power in (1, 2):
            same_means(a, b, counts, lambda rays, axis=axis, power=power: rays[:, axis] ** power)


def test_light_born_outside_the_chip_is_not_put_into_its_cones() -> None:
    """Regression: with a mirror below, light from the top face was given directions of the chip's inside."""
    of = scene({"bottom": "mirror", "mirror": Mirror(0.97)}, emission=Emission(from_top=True))
    rays, ledger, _ = exits_of(of, count=8192)
    assert len(rays) == 8192
    assert np.all(rays[:, WEIGHT_OF_EXIT] == 1.0)
    assert rays[:, 5].min() > 0.0
    assert rays[:, 5].mean() == pytest.approx(2 / 3, abs=0.01)
    assert sum(ledger[: ENDS.index("roulette")]) == 0.0


@pytest.mark.parametrize("name", CHIPS)
def test_all_light_is_booked(name: str) -> None:
    """What leaves and what ends is what was born, but for what roulette made, to rounding."""
    rays, ledger, _ = exits_of(scene(CHIPS[name]), count=4096)
    *ends, roulette, emitted = ledger
    assert emitted == 1.0
    left = rays[:, WEIGHT_OF_EXIT].astype(float).sum() / 4096
    assert sum(ends) + left == pytest.approx(1.0 + roulette, abs=1e-6)  # exits are single precision


@pytest.mark.parametrize(
    "changes", [{"bottom": "mirror", "mirror": Mirror(1.0)}, {"substrate": Mirror(1.0)}], ids=["mirror", "contact"]
)
def test_a_quarter_of_the_light_escapes_from_a_clear_cuboid(changes: dict[str, Any]) -> None:
    """6 (1 - cos 23.71 deg) / 2 = 0.253 leaves, the rest is trapped and said to be, from every chip of any shape."""
    substrate = changes.pop("substrate", SUBSTRATE)
    for size in ({}, {"width_um": 90.0, "thickness_um": 5.0}):
        rays, ledger, _ = exits_of(scene({**changes, **size}, substrate=substrate), count=65_536)
        left = rays[:, WEIGHT_OF_EXIT].sum() / 65_536
        assert left == pytest.approx(ESCAPE, abs=1.5e-3)
        assert ledger[ENDS.index("trapped")] == pytest.approx(1.0 - ESCAPE, abs=1.5e-3)


def test_light_going_down_leaves_a_closed_chip_through_its_top() -> None:
    """Regression: what started downwards within the top's escape cone was booked as trapped (0.2117 left)."""
    down = Emission(cosine=np.array([-1.0, -0.95, -0.949]), intensity=np.array([1.0, 1.0, 0.0]))
    rays, ledger, _ = exits_of(scene({"bottom": "mirror", "mirror": Mirror(1.0)}, emission=down), count=4096)
    assert rays[:, WEIGHT_OF_EXIT].sum() / 4096 == pytest.approx(1.0, abs=0.03)
    rays, ledger, _ = exits_of(scene({"bottom": "air_gap"}, substrate=Mirror(1.0), emission=down), count=4096)
    assert len(rays) == 4096
    assert ledger[ENDS.index("trapped")] == 0.0


def test_a_mirror_that_scatters_traps_nothing() -> None:
    """Regression: a Lambertian mirror of reflectance 1 was taken for a smooth one."""
    rays, ledger, _ = exits_of(scene({"bottom": "mirror", "mirror": Lambertian(1.0)}), count=4096)
    assert len(rays) == 4096
    assert ledger[ENDS.index("trapped")] == 0.0


def test_trapped_light_in_a_chip_that_absorbs_ends_there_at_once() -> None:
    """Light without an open channel is absorbed in the end, however clear the chip: no endless walk."""
    for changes in ({"bottom": "air_gap"}, {"bottom": "mirror", "mirror": Mirror(1.0)}):
        rays, ledger, _ = exits_of(scene({**changes, "absorption_per_um": 1e-9}, substrate=Mirror(1.0)), count=65_536)
        assert rays[:, WEIGHT_OF_EXIT].sum() / 65_536 == pytest.approx(ESCAPE, abs=1.5e-3)
        assert ledger[ENDS.index("chip")] == pytest.approx(1.0 - ESCAPE, abs=1.5e-3)
        assert ledger[ENDS.index("trapped")] == 0.0


def rough(slope: float) -> Face:
    """Sides of facets."""
    return Face((Facets(N, 1.0, slope),), (Facets(1.0, N, slope),))


SHUT_IN: dict[str, dict[str, Any]] = {
    "mirror": {"bottom": "mirror", "mirror": Mirror(0.9)},
    "mirror, absorbing above": {
        "bottom": "mirror", "mirror": Mirror(0.9), "absorption_per_um": 0.02, "absorption_rise_per_um": 0.02,
    },
    "mirror, absorbing below": {
        "bottom": "mirror", "mirror": Mirror(0.9), "absorption_per_um": 0.02, "absorption_rise_per_um": -0.02,
    },
    "closed, film": {"bottom": "mirror", "mirror": Mirror(1.0), "absorption_per_um": 0.02, "top": film_face(5.5)},
    "air gap": {"bottom": "air_gap", "absorption_per_um": 0.02},
}  # fmt: skip


@pytest.mark.parametrize("name", SHUT_IN)
@pytest.mark.parametrize("upwards", [True, False])
def test_light_shut_in_by_nearly_smooth_sides_ends_where_the_walk_would_end_it(name: str, upwards: bool) -> None:
    """Exits to the last bit, ends within noise; light that starts near the top, most of it upwards or downwards."""
    ways = [0.5, 1.0, 3.0] if upwards else [3.0, 1.0, 0.5]
    high = Emission(layer_depth=0.8, cosine=np.array([-1.0, 0.0, 1.0]), intensity=np.array(ways))
    count, of = 60_000, scene({**SHUT_IN[name], "sides": rough(1e-7)}, emission=high)
    short, booked, _ = exits_of(of, count=count)
    walked, ledger, _ = exits_of(of, count=count, shut=False)
    np.testing.assert_array_equal(short, walked)
    if "absorption_per_um" in SHUT_IN[name]:  # else the mirror takes all of it either way
        assert np.any(booked != ledger)
    for end in range(ENDS.index("roulette")):  # by chance, or by a weight that varies less
        p = (booked[end] + ledger[end]) / 2.0
        assert abs(booked[end] - ledger[end]) < 4.5 * np.sqrt(p * (1.0 - p) / count) + 1e-12, ENDS[end]


@pytest.mark.parametrize("bottom", ["mirror", "air_gap", "contact"])
def test_nearly_smooth_sides_of_a_clear_closed_chip_trap_light(bottom: str) -> None:
    """As smooth ones do: there is nothing that takes it."""
    own = {"mirror": Mirror(1.0)} if bottom == "mirror" else {}
    of = scene({"bottom": bottom, "sides": rough(1e-7), **own}, substrate=Mirror(1.0))
    _, ledger, _ = exits_of(of, count=16_384)
    assert ledger[ENDS.index("trapped")] == pytest.approx(1.0 - ESCAPE, abs=0.015)


def test_a_mirror_that_takes_less_than_rounding_closes_the_chip() -> None:
    """Regression: tables round it to 1, and 0 / 0 was booked."""
    for sides in ({}, {"sides": rough(1e-7)}):
        _, ledger, _ = exits_of(scene({"bottom": "mirror", "mirror": Mirror(1.0 - 1e-14), **sides}), count=4096)
        assert ledger[ENDS.index("trapped")] == pytest.approx(1.0 - ESCAPE, abs=0.03)


def test_sides_that_turn_light_out_shut_nothing_in() -> None:
    """Nor do a bottom that scatters and a top that takes light; of several wavelengths the roughest side counts."""

    def shuts(changes: dict[str, Any], waves: int = 1) -> bool:
        of = scene(
            {"bottom": "mirror", "mirror": Mirror(0.9), **changes}, wavelength_weight=np.full(waves, 1.0 / waves)
        )
        return bool(scene_arrays(of).flags[SHUT])

    assert shuts({"sides": rough(1.41e-6)})  # of a standard deviation just below 1e-6
    assert not shuts({"sides": rough(1.42e-6)})
    waves = rough(1e-7), rough(1e-3)
    mixed = Face(*(tuple(getattr(one, side)[0] for one in waves) for side in ("inside", "outside")))
    several = {"index": np.array([N, N]), "top": Face(bare().inside * 2, bare().outside * 2)}
    assert not shuts({**several, "sides": mixed}, waves=2)
    assert not shuts({"sides": rough(1e-7), "top": taking(0.5, 0.3, beyond=0.9)})
    assert not shuts({"sides": rough(1e-7), "top": rough_top()})
    assert not shuts({"sides": rough(1e-7), "mirror": Lambertian(0.9)})
    assert not shuts({"sides": rough(1e-7), "bottom": "contact", "mirror": None})


NEARLY_CLOSED: dict[str, Any] = {"bottom": "mirror", "sides": rough(1e-5)}


@pytest.mark.parametrize(
    ("changes", "substrate", "end"),
    [
        ({**NEARLY_CLOSED, "mirror": Mirror(1.0)}, SUBSTRATE, "trapped"),
        ({**NEARLY_CLOSED, "mirror": Mirror(1.0), "absorption_per_um": 1e-9}, SUBSTRATE, "chip"),
        ({**NEARLY_CLOSED, "mirror": Mirror(1.0 - 1e-7)}, SUBSTRATE, "substrate"),
        ({}, GaussianLobe(1.0, 1e-6), "trapped"),
    ],
    ids=["plain", "in what absorbs a little", "on what takes a little", "unfolded"],
)
def test_a_walk_ends_however_little_a_chip_takes(changes: dict[str, Any], substrate: GaussianLobe, end: str) -> None:
    """To be turned out would take 1e8 steps and more. What is left is booked where it would end."""
    rays, ledger, _ = exits_of(scene(changes, substrate=substrate), count=64)
    assert 0.6 < ledger[ENDS.index(end)] < 0.9
    assert ledger[: ENDS.index("emitted")].sum() + rays[:, WEIGHT_OF_EXIT].sum() / 64 == pytest.approx(1.0, abs=1e-6)


def test_a_long_walk_that_leads_out_is_walked_to_its_end() -> None:
    """Flat, clear, on a narrow lobe: all leaves, after up to 13,000 hits of the bottom."""
    flat = scene({"width_um": 90.0, "thickness_um": 5.0}, substrate=GaussianLobe(1.0, np.deg2rad(0.5)))
    rays, ledger, _ = exits_of(flat, count=512)
    assert rays[:, WEIGHT_OF_EXIT].sum() == pytest.approx(512.0, abs=1e-3)
    assert ledger[ENDS.index("trapped")] == 0.0


def test_a_bottom_that_lets_light_through_loses_it() -> None:
    """Regression: what a substrate transmits was drawn again until it was reflected."""
    for bottom in ("contact", "air_gap"):
        through, ledger_a, _ = exits_of(scene({"bottom": bottom}, substrate=Lambertian(0.5, 0.4)), count=32_768)
        absorbed, ledger_b, _ = exits_of(scene({"bottom": bottom}, substrate=Lambertian(0.5)), count=32_768, seed=4)
        assert len(through) / 32_768 == pytest.approx(len(absorbed) / 32_768, abs=0.012)
        assert ledger_a[ENDS.index("substrate")] == pytest.approx(ledger_b[ENDS.index("substrate")], abs=0.012)


def test_a_top_of_two_mirrors_is_walked_face_by_face() -> None:
    """Regression: of a top with some metal on it the unfolded walk took all but the first part for absorbed (100 %).

    Upwards in the escape cone, above a perfect mirror: the sum of round trips.
    """
    inside = Mixture((Mirror(0.9), Fresnel(N, 1.0)), (0.2, 0.8))
    up = Emission(cosine=np.array([0.98999, 0.99, 1.0]), intensity=np.array([0.0, 1.0, 1.0]))
    closed = {"bottom": "mirror", "mirror": Mirror(1.0)}
    of = scene({"top": Face((inside,), (Fresnel(1.0, N),)), **closed}, emission=up)
    assert scene_arrays(of).flags[UNFOLD] == 0
    rays, ledger, _ = exits_of(of, count=16_384)
    bare_face = ((N - 1.0) / (N + 1.0)) ** 2
    out, lost = 0.8 * (1.0 - bare_face), 0.2 * 0.1
    assert rays[:, WEIGHT_OF_EXIT].sum() / 16_384 == pytest.approx(out / (out + lost), abs=5e-3)
    assert ledger[ENDS.index("dbr")] == pytest.approx(lost / (out + lost), abs=5e-3)


def test_a_top_that_scatters_is_walked_face_by_face() -> None:
    """Regression: below clear sides the unfolded walk took the scattered light for absorbed (73 % of all)."""
    of = scene({"top": rough_top()})
    assert scene_arrays(of).flags[UNFOLD] == 0
    rays, ledger, _ = exits_of(of, count=8192)
    assert ledger[ENDS.index("dbr")] < 0.15  # the part that scatters takes a tenth of half
    assert len(rays) / 8192 > 0.6


def test_absorption_follows_beer_and_lambert() -> None:
    """Light straight up from a known depth through a face that lets all pass: exp(-alpha path)."""
    up = Emission(layer_depth=0.25, cosine=np.array([0.9999, 1.0]))
    for alpha in (1e-3, 0.02, 0.2):
        clear_top = taking(0.0, 1.0)
        rays, ledger, notes = exits_of(scene({"top": clear_top, "absorption_per_um": alpha}, emission=up), count=4096)
        left = rays[:, WEIGHT_OF_EXIT].sum() / 4096
        assert left == pytest.approx(np.exp(-alpha * 0.75 * TOP), rel=4e-4)
        assert notes[:, PATH] == pytest.approx(np.full(len(notes), 0.75 * TOP), rel=2e-4)
        assert ledger[ENDS.index("chip")] == pytest.approx(1.0 - left, abs=1e-6)


@pytest.mark.parametrize("unfold", [True, False])
@pytest.mark.parametrize("rise", [0.02, -0.02, 0.01])
@pytest.mark.parametrize(("cosine", "ways"), [((0.9999, 1.0), 1), ((-1.0, -0.9999), -1)], ids=["up", "down"])
def test_absorption_that_rises_is_met_at_each_height(
    unfold: bool, rise: float, cosine: tuple[float, float], ways: int
) -> None:
    """Straight up from a height z0, or down and up again from a mirror: exp(-int a(z) dz) by Simpson's rule."""
    clear_top, z0, alpha = taking(0.0, 1.0), 0.25 * TOP, 0.02
    way = Emission(layer_depth=0.25, cosine=np.array(cosine))
    absorbing = {"absorption_per_um": alpha, "absorption_rise_per_um": rise}
    of = scene({"top": clear_top, "bottom": "mirror", "mirror": Mirror(1.0), **absorbing}, emission=way)
    rays, ledger, notes = exits_of(of, count=4096, unfold=unfold, cones=False)

    def depth(low: float, high: float) -> float:
        ends = [alpha + rise * (2.0 * z / TOP - 1.0) for z in (low, (low + high) / 2.0, high)]
        return float((high - low) * np.array([1.0, 4.0, 1.0]) @ ends / 6.0)

    whole = depth(z0, TOP) if ways > 0 else depth(0.0, z0) + depth(0.0, TOP)
    left = rays[:, WEIGHT_OF_EXIT].sum() / 4096
    assert left == pytest.approx(np.exp(-whole), rel=1e-3)
    assert ledger[ENDS.index("chip")] == pytest.approx(1.0 - left, abs=1e-6)
    noted = alpha * notes[:, PATH] + rise * notes[:, LIFT]
    assert noted == pytest.approx(np.full(len(notes), whole), rel=2e-4)


def test_a_rise_of_absorption_only_dims_what_leaves() -> None:
    """Exits of an evenly absorbing chip, each by exp(-b lift), are those of the chip that absorbs above or below."""
    alpha, count = 1e-2, 65_536
    for changes in ({}, {"bottom": "mirror", "mirror": Mirror(0.9)}, {"bottom": "air_gap"}):
        rays, _, notes = exits_of(scene({**changes, "absorption_per_um": alpha}), count=count)
        for rise in (alpha, -alpha):
            absorbing = {"absorption_per_um": alpha, "absorption_rise_per_um": rise}
            there, _, _ = exits_of(scene({**changes, **absorbing}), count=count, seed=8)
            for face in range(5):
                dimmed = rays[:, WEIGHT_OF_EXIT] * np.exp(-rise * notes[:, LIFT]) * (face_of(rays) == face)
                full = there[:, WEIGHT_OF_EXIT] * (face_of(there) == face)
                error = np.sqrt(dimmed.astype(float) @ dimmed + full.astype(float) @ full) / count
                assert dimmed.sum() / count == pytest.approx(full.sum() / count, abs=4.0 * error)


def test_absorption_only_dims_what_leaves() -> None:
    """Exits of a clear chip, each weighted by exp(-alpha path), are those of the absorbing chip."""
    rays, _, notes = exits_of(scene(), count=32_768)
    for alpha in (1e-3, 1e-2):
        dimmed = rays[:, WEIGHT_OF_EXIT] * np.exp(-alpha * notes[:, PATH])
        there, _, _ = exits_of(scene({"absorption_per_um": alpha}), count=32_768, seed=8)
        assert dimmed.sum() / 32_768 == pytest.approx(there[:, WEIGHT_OF_EXIT].sum() / 32_768, abs=0.008)


def test_exits_have_the_symmetry_of_the_square() -> None:
    """All four sides get the same share, places and directions are alike after turns by 90 deg."""
    rays, _, _ = exits_of(scene({"absorption_per_um": 0.002}), count=32_768, sobol=False)
    face = face_of(rays)
    shares = [rays[face == side, WEIGHT_OF_EXIT].sum() for side in range(4)]
    assert np.ptp(shares) < 5.0 * np.sqrt(max(shares))
    for first, second in ((0, 1), (3, 4)):
        assert stats.ks_2samp(rays[:, first], rays[:, second]).pvalue > 1e-3
        assert stats.ks_2samp(rays[:, first], -rays[:, first]).pvalue > 1e-3


def test_directions_of_exits_are_units_and_point_away() -> None:
    """From the face they are at, whatever the wave of unfolded tiles behind them."""
    for name, changes in CHIPS.items():
        rays, _, _ = exits_of(scene(changes), count=4096)
        of = chip(**changes)
        assert np.linalg.norm(rays[:, 3:6], axis=1) == pytest.approx(np.ones(len(rays)), abs=1e-5), name
        assert np.abs(rays[:, :2]).max() <= of.width_um / 2.0 * (1.0 + 1e-6)
        assert rays[:, 2].min() >= 0.0
        assert rays[:, 2].max() <= of.thickness_um * (1.0 + 1e-6)


def test_the_top_alone_leaves_lambertian_light_of_lambertian_light() -> None:
    """A chip lit through its volume sends light of an isotropic source out of the top as Fresnel and Snell say."""
    rays, _, _ = exits_of(
        scene({"sides": Face((Mirror(1.0),), (Mirror(1.0),)), "bottom": "mirror", "mirror": Mirror(0.0)}),
        count=65_536,
    )
    mu = np.linspace(np.sqrt(1.0 - 1.0 / N**2), 1.0, 20_001)
    T = 1.0 - Fresnel(N, 1.0).deltas(np.arccos(mu)).mirror
    expected = np.trapezoid(T, mu) / 2.0  # isotropic: mu is uniform from -1 to 1
    assert rays[:, WEIGHT_OF_EXIT].sum() / 65_536 == pytest.approx(expected, abs=4.0 * np.sqrt(expected / 65_536))


def test_an_air_gap_keeps_the_substrates_lobe_out_of_the_chip() -> None:
    """Light beyond the critical angle never reaches the substrate: only the escape cones' light leaves."""
    rays, ledger, _ = exits_of(
        scene({"bottom": "air_gap"}, substrate=GaussianLobe(1.0, np.radians(5.0))), count=65_536
    )
    assert rays[:, WEIGHT_OF_EXIT].sum() / 65_536 == pytest.approx(ESCAPE, abs=1.5e-3)
    assert ledger[ENDS.index("substrate")] == 0.0
