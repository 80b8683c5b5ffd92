"""The page of a comparison: whole, alone, the document's numbers, the same bytes twice, small; all kinds of shots."""

from __future__ import annotations

import re
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from tests.pages import Parsed, loads_nothing, picture_loads_nothing
from viewer import comparison_images as images
from viewer.comparison import draw, furthest, page_of, worst_shot
from viewer.comparison_curves import profile_picture
from viewer.look import svg

Arrays = dict[str, NDArray[Any]]

COMMAND = "luxloop compare data --model model.toml"
BEGINNINGS = {".png": b"\x89PNG", ".pdf": b"%PDF", ".svg": b"<?xml"}


def image(arrays: Arrays, name: str, side: int = 64, chips: int = 1, pairs: float = 0.0, missing: float = 0.0) -> Any:
    """A shot of chips above which light falls off; a share `missing` of what was measured is not in the model."""
    pixel_um, centre = 30.0 * 96 / side, (side - 1) / 2.0
    at = (np.arange(side) - centre) * pixel_um
    where = (np.arange(chips) - (chips - 1) / 2.0) * 500.0
    square = [(at[:, None] - y) ** 2 + (at - x) ** 2 for y in where for x in where]
    light = np.array(sum(180.0**4 / (180.0**2 + each) ** 2 for each in square))
    halo = np.array(sum(np.exp(-np.sqrt(each) / 200.0) for each in square))
    model = 40.0 + 2200.0 * light
    sigma = np.sqrt(4.0 + 0.05 * model)
    noise = np.random.default_rng(sum(name.encode())).standard_normal(model.shape) * sigma
    measured = model + missing * 2200.0 * halo + noise
    measured[:3, :5] = np.nan  # a corner is masked
    arrays |= {
        f"{name}/measured_dn": measured.astype(np.float32),
        f"{name}/model_dn": model.astype(np.float32),
        f"{name}/z": ((measured - model) / sigma).astype(np.float32),
    }
    setting = f"{pairs:g} pairs" if pairs else "no DBR"
    return {
        "id": name, "kind": "image", "sample": f"{'single chip' if chips == 1 else f'{chips} x {chips}'}, {setting}",
        "pixels": side * side - 15, "rms_error_percent": 8.8 if missing else 2.71, "noise_percent": 2.7,
        "mse": 0.81, "mse_dn2": 211.0, "chi2_per_pixel": 2.12 if missing else 1.01, "p": 1e-5 if missing else 0.42,
        "p_text": "< 1e-4" if missing else "0.42", "z": 41.3 if missing else 1.2,
        "worst_region": "0-100 um from the nearest chip", "gain_dn_mm2": 2213.4, "offset_dn": 0.31,
        "shift_um": [1.21, -0.43], "rotation_deg": 0.012, "saturated": 3, "masked": 15, "pixel_um": pixel_um,
        "centre_px": [centre, centre], "binning": 3,
    }  # fmt: skip


def spectrum(arrays: Arrays, name: str, angles: Iterable[float] = (0.0,)) -> Any:
    """A spectrum with fringes; the model's film is a little too thin."""
    wavelength_nm, aoi_deg = (one.ravel() for one in np.meshgrid(np.linspace(400.0, 800.0, 101), [*angles]))
    value, told = (0.2 + 0.1 * np.cos(n * 1e5 / wavelength_nm + aoi_deg) for n in (0.100, 0.1002))
    noise = 0.003 * np.random.default_rng(2).standard_normal(len(value))
    arrays |= {
        f"{name}/wavelength_nm": wavelength_nm, f"{name}/aoi_deg": aoi_deg, f"{name}/measured": value + noise,
        f"{name}/model": told, f"{name}/sigma": np.full(len(value), 0.003),
    }  # fmt: skip
    return _curve(name, "spectrum", "GaN on sapphire") | {"quantity": "R"}


def far_field(arrays: Arrays, name: str) -> Any:
    """A goniometer curve in two planes."""
    theta_deg, phi_deg = (one.ravel() for one in np.meshgrid(np.linspace(0.0, 85.0, 35), [0.0, 90.0]))
    model = np.cos(np.radians(theta_deg))
    noise = 0.01 * np.random.default_rng(3).standard_normal(len(model))
    arrays |= {
        f"{name}/theta_deg": theta_deg, f"{name}/phi_deg": phi_deg, f"{name}/measured": model + noise,
        f"{name}/model": model, f"{name}/sigma": np.full(len(model), 0.01),
    }  # fmt: skip
    return _curve(name, "far_field", "single chip, 5.5 pairs")


def _curve(name: str, kind: str, sample: str) -> Any:
    empty = ("mse", "mse_dn2", "gain_dn_mm2", "offset_dn", "shift_um", "rotation_deg", "saturated", "masked")
    return dict.fromkeys((*empty, "pixel_um", "centre_px")) | {
        "id": name, "kind": kind, "sample": sample, "pixels": 101, "rms_error_percent": 1.4, "noise_percent": 0.9,
        "chi2_per_pixel": 1.9, "p": 0.003, "p_text": "0.003", "z": 6.1, "worst_region": "600-700 nm",
    }  # fmt: skip


def fourier(name: str, line: str) -> Any:
    """The power of a residual with the fringes of a layer of 5 um."""
    thickness_um = np.linspace(0.1, 12.0, 200)
    power = 40.0 * np.exp(-((thickness_um - 5.0) ** 2)) + 1.0
    return {
        "shot": name, "line": line, "unit": "um", "band": 3.0, "optical_thickness_um": [*thickness_um],
        "power": [*power],
        "peak": {"optical_thickness_um": 5.0, "power": 41.0, "log_chance": -36.0},
    }  # fmt: skip


def profiles(shots: Iterable[Any]) -> list[Any]:
    """A curve per image against distance, and one of all against azimuth and spatial frequency."""
    x = np.linspace(20.0, 1000.0, 25)
    found = [
        {"against": "distance from the nearest chip", "unit": "um", "shot": shot["id"], "x": [*x],
         "relative_percent": [*(shot["rms_error_percent"] * np.exp(-x / 150.0) - 0.5)],
         "band_percent": [*(0.4 + x / 500.0)]} for shot in shots if shot["kind"] == "image"
    ]  # fmt: skip
    at = np.arange(0.0, 360.0, 15.0)
    found += [
        {"against": "wavelength", "unit": "nm", "shot": shot["id"], "line": line, "value_unit": "percentage points",
         "x": [400.0, 500.0, 600.0], "difference": [0.1, -0.9, 0.2], "band": [0.3, 0.3, 0.3]}
        for shot in shots if shot["kind"] == "spectrum" for line in ("0 deg", "30 deg")
    ]  # fmt: skip
    found.append({"against": "azimuth", "unit": "deg", "shot": "all", "x": [*at],
                  "relative_percent": [*(0.2 * np.sin(at))], "band_percent": [0.3] * len(at)})  # fmt: skip
    found.append({"against": "spatial frequency", "unit": "1/mm", "shot": "all", "x": [0.5, 1.0, 2.0, 4.0, 8.0],
                  "power": [40.0, 9.0, 1.3, 1.0, 0.98], "band": [0.4, 0.3, 0.2, 0.1, 0.05]})  # fmt: skip
    return found


def comparison(shots: list[Any], **changes: Any) -> dict[str, Any]:
    """What `luxloop compare` hands to the viewer."""
    far = [shot["id"] for shot in shots if shot["p"] < 0.01]
    region = "0-100 um from the nearest chip"
    return {
        "command": COMMAND, "sentence": f"{len(far)} of {len(shots)} shots differ from the model by more than noise",
        "made_by": ["luxloop dataset simulate truth.toml --out data --seed 5"],
        "model": {"file": "model.toml", "name": "paper", "sha256": "a" * 64},
        "dataset": {"path": "data", "name": "paper-like set", "sha256": "b" * 64},
        "solver": {"method": "anchored", "histories": 1_000_000, "seed": 7}, "trusted": True, "reason": "",
        "structure": {"p": 1e-5, "p_text": "< 1e-4", "z": 41.3, "draws": 10_000, "family": "radius",
                      "shot": (far or ["all"])[0], "region": region},
        "shots": shots, "profiles": profiles(shots),
        "fourier": [fourier(shot["id"], f"{angle} deg") for shot in shots if shot["kind"] == "spectrum"
                    for angle in (0, 30, 60)],
        "regions": [{"shot": name, "family": "radius", "region": region, "z": 41.3 - i}
                    for i, name in enumerate(far)],
    } | changes  # fmt: skip


def paper_like() -> tuple[dict[str, Any], Arrays]:
    """Single chips with two DBR settings, an array, a spectrum at three angles, a far field."""
    arrays: Arrays = {}
    shots = [
        image(arrays, f"{kind}-{pairs:g}", side, chips, pairs, missing=0.004 if chips == 1 else 0.0)
        for kind, side, chips, settings in (("single", 64, 1, (0.0, 5.5)), ("array", 96, 5, (5.5,)))
        for pairs in settings
    ]
    shots += [spectrum(arrays, "reflectance", (0.0, 30.0, 60.0)), far_field(arrays, "goniometer")]
    return comparison(shots), arrays


@pytest.fixture(scope="module")
def whole() -> tuple[dict[str, Any], Arrays, Parsed, str]:
    """Document, arrays, the page taken apart and the page of a set with all there can be."""
    document, arrays = paper_like()
    page = page_of(document, arrays)
    return document, arrays, Parsed(page), page


def test_a_page_is_whole_and_loads_nothing(whole: tuple[dict[str, Any], Arrays, Parsed, str]) -> None:
    """All sections, each led to; six pictures per image, two per spectrum, one per far field and coordinate."""
    parsed = loads_nothing(whole[3])
    assert parsed.attributes("id") == ["shots", "images", "regions", "curves", "spectra", "provenance"]
    assert len(parsed.pictures) == 3 * 6 + 2 + 1 + 4
    for picture in parsed.pictures:
        picture_loads_nothing(picture)


def test_the_numbers_are_those_of_the_document(whole: tuple[dict[str, Any], Arrays, Parsed, str]) -> None:
    """The sentence, errors beside noise, p, z, the fitted camera and the digests, as a person reads them."""
    text = whole[2].text
    for told in ("4 of 5 shots differ from the model by more than noise.", "8.8 %", "noise of 2.7 %", "< 1e-4",
                 "41.3 sigma", "10,000 simulated repeats", "+1.21", "-0.43", "2,213", "a" * 64, "b" * 64, COMMAND,
                 "luxloop dataset simulate truth.toml --out data --seed 5", "1,000,000 histories",
                 "41.3 sigma least likely to be noise: ", "strongest at 5 µm (0 deg), power 41",
                 "chance of 2.3e-16"):  # fmt: skip
        assert told in text


def test_a_map_is_about_the_centre_that_the_fit_found(whole: tuple[dict[str, Any], Arrays, Parsed, str]) -> None:
    """Rings and sectors of the words are about that one, too: x at 0 lies where the fit has shifted it to."""
    document, arrays = whole[:2]
    shot = document["shots"][0] | {"shift_um": [10.0, -4.0]}
    first, found = (images.image_of(one, arrays) for one in (shot | {"shift_um": None}, shot))
    assert found.at_mm(1) == pytest.approx(first.at_mm(1) - 0.010)
    assert found.at_mm(0) == pytest.approx(first.at_mm(0) + 0.004)


def test_every_figure_says_its_error_and_its_command(whole: tuple[dict[str, Any], Arrays, Parsed, str]) -> None:
    """Each caption names noise or sigma, and the command."""
    captions = re.findall(r"<figcaption>(.*?)</figcaption>", whole[3], re.DOTALL)
    assert len(captions) == 3 + 1 + 2
    for caption in captions:
        assert "noise" in caption
        assert COMMAND in caption


def test_the_same_document_gives_the_same_bytes(tmp_path: Path) -> None:
    """Twice the same page, and that is what lies in the file."""
    arrays: Arrays = {}
    document = comparison([image(arrays, "a", 16), spectrum(arrays, "r")])
    draw(document, arrays, tmp_path / "one.html")
    assert (tmp_path / "one.html").read_bytes() == page_of(document, arrays).encode()


def test_warnings_stand_below_the_sentence() -> None:
    """As text, whatever a path in them holds; a page of an earlier document has none."""
    arrays: Arrays = {}
    shot = image(arrays, "a", 16)
    page = page_of(comparison([shot], warnings=["look at <data>"]), arrays)
    assert "Warning: look at &lt;data&gt;." in page
    assert "Warning" not in page_of(comparison([shot]), arrays)


def test_an_image_takes_its_share_of_a_small_page() -> None:
    """An image of 128 x 128 takes less than a twenty-fourth of 5 MB."""
    arrays: Arrays = {}
    shot = image(arrays, "a", 128, 5, 2.5, missing=0.01)
    of_it = len(page_of(comparison([shot], profiles=[]), arrays))
    del arrays["a/z"]
    assert of_it - len(page_of(comparison([shot], profiles=[]), arrays)) < 5_000_000 / 24


@pytest.mark.parametrize("ending", sorted(BEGINNINGS))
def test_a_picture_is_of_the_kind_its_name_says(tmp_path: Path, ending: str) -> None:
    """The one picture that says most, as PNG, PDF and SVG, the same bytes twice; of an image and of a spectrum."""
    arrays: Arrays = {}
    for name, shot in (("image", image(arrays, "a", missing=0.01)), ("curve", spectrum(arrays, "r"))):
        written = []
        for path in (tmp_path / f"{name}1{ending}", tmp_path / f"{name}2{ending}"):
            draw(comparison([shot]), arrays, path)
            written.append(path.read_bytes())
        assert written[0].startswith(BEGINNINGS[ending])
        assert written[0] == written[1]


def test_the_furthest_shot_is_the_picture() -> None:
    """Among several the one with the largest z, and the title says so."""
    arrays: Arrays = {}
    shots = [image(arrays, "near"), image(arrays, "far", missing=0.01)]
    assert "Furthest: far" in worst_shot(comparison(shots), arrays).get_suptitle()


def test_a_shot_that_fits_better_than_most_is_not_the_furthest() -> None:
    """p near 1 is a z far below 0: such a shot comes last; of equal p the larger chi2 is first."""
    shots = [
        {"id": "best", "z": -3.7, "chi2_per_pixel": 0.9},
        {"id": "some", "z": 2.0, "chi2_per_pixel": 1.1},
        {"id": "most", "z": 3.7, "chi2_per_pixel": 5.0},
        {"id": "more", "z": 3.7, "chi2_per_pixel": 2.0},
    ]
    assert [shot["id"] for shot in furthest(shots)] == ["most", "more", "some", "best"]


def test_maps_lie_as_the_light_does() -> None:
    """Row 0 at the lowest y, pixels where they are in mm, residuals from -4 to 4 whatever their size."""
    arrays: Arrays = {}
    shot = image(arrays, "a", side=8)
    figure = worst_shot(comparison([shot]), arrays)
    shown = [one for axes in figure.axes for one in axes.get_images()]
    assert len(shown) == 4
    half_mm = 0.5 * 8 * shot["pixel_um"] / 1000.0
    x, y = (-um / 1000.0 for um in shot["shift_um"])
    for one in shown:
        assert one.origin == "lower"
        assert one.get_extent() == pytest.approx([x - half_mm, x + half_mm, y - half_mm, y + half_mm])
    np.testing.assert_array_equal(shown[0].get_array(), arrays["a/measured_dn"])
    assert [one.get_clim() for one in shown[2:]] == [(-4.0, 4.0)] * 2


def test_noise_alone_is_noise_on_the_same_pixels() -> None:
    """Mean 0 and sigma 1 within four of their own errors, and unused where the image is unused."""
    arrays: Arrays = {}
    one = images.image_of(image(arrays, "a", side=128), arrays)
    noise = images.noise_like(one)
    np.testing.assert_array_equal(np.isfinite(noise), np.isfinite(one.z))
    used = noise[np.isfinite(noise)]
    assert abs(used.mean()) < 4.0 / np.sqrt(used.size)
    assert abs(used.std() - 1.0) < 4.0 / np.sqrt(2.0 * used.size)


def test_joined_pixels_keep_a_sigma_of_one() -> None:
    """A large image is drawn with pixels joined: noise stays noise, a constant grows by the root of their number."""
    arrays: Arrays = {}
    one = images.image_of(image(arrays, "a", side=300), arrays)
    side = images.joined(one)
    assert side == 3
    noise = images.joined_sigma(images.noise_like(one), side)
    assert np.nanstd(noise) == pytest.approx(1.0, abs=4.0 / np.sqrt(2.0 * noise.size))
    assert images.joined_sigma(np.full((6, 6), 0.5), side) == pytest.approx(np.full((2, 2), 1.5))
    holed = np.full((4, 4), np.nan)
    holed[0, 0] = 2.0
    assert images.joined_sigma(holed, 4) == pytest.approx(np.array([[2.0]]))


def test_the_cut_goes_through_the_chips() -> None:
    """With an even number of rows the brightest row is that of a chip, not the dark middle between two."""
    arrays: Arrays = {}
    one = images.image_of(image(arrays, "a", side=97, chips=2), arrays)
    for axis, at in zip((0, 1), one.cut, strict=True):
        assert abs(one.at_mm(axis)[at]) == pytest.approx(0.25, abs=0.06)
    five = images.image_of(image(arrays, "b", side=96, chips=5), arrays)
    assert abs(five.at_mm(0)[five.cut[0]]) < 0.06  # of five bright rows the middle one


@pytest.mark.slow
def test_of_many_images_the_furthest_are_shown_and_the_page_stays_small() -> None:
    """24 images of 128 x 128: the rest is folded, and all of it is below 5 MB."""
    arrays: Arrays = {}
    shots = [image(arrays, f"image-{i}", 128, 5, 2.5, missing=0.001 * (i > 20)) for i in range(24)]
    page = page_of(comparison(shots), arrays)
    assert len(page) < 5_000_000
    parsed = loads_nothing(page)
    assert sum(tag == "details" for tag, _ in parsed.seen) == 18
    shown = re.findall(r"<h3>(image-\d+)", page)
    assert {"image-21", "image-22", "image-23"} < set(shown)


def test_a_spectrum_alone_has_a_page_without_images() -> None:
    """No section stands empty; twenty angles keep a short legend."""
    arrays: Arrays = {}
    page = page_of(comparison([spectrum(arrays, "psi", range(0, 60, 3))], profiles=[]), arrays)
    parsed = loads_nothing(page)
    assert parsed.attributes("id") == ["shots", "regions", "spectra", "provenance"]
    assert len(parsed.pictures) == 2


def test_a_fit_that_is_not_trusted_says_why() -> None:
    """The reason stands before all figures."""
    arrays: Arrays = {}
    reason = "the substrate's reflectance is at its limit, 1.00"
    page = page_of(comparison([image(arrays, "a", 16)], trusted=False, reason=reason), arrays)
    assert f"The fit itself is not trustworthy: {reason}" in Parsed(page).text
    assert page.index("not trustworthy") < page.index("<figure")


def test_words_of_others_cannot_break_the_page() -> None:
    """Markup in a sample's text is shown as it is."""
    arrays: Arrays = {}
    shot = image(arrays, "a", 16) | {"sample": "<script>alert(1)</script> & more"}
    parsed = loads_nothing(page_of(comparison([shot]), arrays))
    assert "<script>alert(1)</script> & more" in parsed.text


def test_names_of_others_are_no_formulas() -> None:
    """What stands between two $ is drawn as it is; and no axis relies on formulas."""
    arrays: Arrays = {}
    shots = [image(arrays, "a$x_$b", 16), spectrum(arrays, "c$y_$d")]
    parsed = loads_nothing(page_of(comparison(shots), arrays))
    assert not any(b"mathdefault" in picture for picture in parsed.pictures)
    whole = comparison(shots, sentence="$z_$ differs")
    assert b"$z_$ differs" in svg(worst_shot(whole, arrays))


def test_a_power_has_plain_numbers_at_its_axis() -> None:
    """Over decades, and within one."""
    for powers, labels in (([400.0, 0.02], {"0.1", "1", "10", "100"}), ([1.4, 0.8], {"0.9", "1"})):
        facts = {"shot": "a", "against": "spatial frequency", "unit": "1/mm", "x": [0.5, 1.0], "band": [0.01, 0.01]}
        drawn = profile_picture([facts | {"power": powers}], {}).decode()
        assert labels <= {*re.findall(r">([^<]*)</text>", drawn)}


def test_an_image_without_a_used_pixel_is_drawn() -> None:
    """All saturated: no cut can be chosen by light, and nothing fails."""
    arrays: Arrays = {}
    shot = image(arrays, "a", 16)
    arrays["a/measured_dn"][:] = np.nan
    arrays["a/z"][:] = np.nan
    assert len(loads_nothing(page_of(comparison([shot]), arrays)).pictures) == 6 + 3


def test_errors_of_angles_are_told_in_degrees() -> None:
    """Those of psi and delta; of the other shots percent, at the head of the page and in the table."""
    arrays: Arrays = {}
    angle = spectrum(arrays, "delta") | {"unit": "deg", "rms_error": 1.4, "noise": 0.1, "noise_percent": 0.1}
    page = page_of(comparison([spectrum(arrays, "R") | {"unit": "1"}, angle]), arrays)
    text = Parsed(page).text
    assert "1.4 deg rms error of delta, most above its noise of 0.1 deg" in text
    assert "1.40 deg 0.10 deg" in text
    assert "1.40 % 0.90 %" in text


def test_the_mse_is_said_to_be_on_the_scale_that_it_is_on() -> None:
    """A share of the measured maximum squared."""
    arrays: Arrays = {}
    text = Parsed(page_of(comparison([image(arrays, "single-0")]), arrays)).text
    assert "images scaled to the measured maximum, 0 to 1." in text
    assert "255" not in text


def test_z_is_said_to_be_that_of_p() -> None:
    """Not the largest contrast, which may be far larger."""
    arrays: Arrays = {}
    text = Parsed(page_of(comparison([image(arrays, "single-0")]), arrays)).text
    assert "z: that p as a normal distribution's sigma, so no larger than the draws can tell" in text
