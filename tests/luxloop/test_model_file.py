"""A model as a file: read back equal, and every way to spoil it told with file, field, value, range and mend."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from luxloop.effect import AppliedEffect
from luxloop.errors import InputError
from luxloop.files import MAX_BYTES
from luxloop.model import Environment, Fit, Model, Surface
from luxloop.model_file import SHIPPED, diff, find_model, parse_toml, range_of, read_model, to_toml

names = st.from_regex(r"[a-z][a-z0-9_]{0,15}", fullmatch=True)
words = st.text(st.characters(exclude_categories=("Cs",)), max_size=30)
finite = st.floats(allow_nan=False, allow_infinity=False)
shares = st.floats(0.0, 1.0)
surfaces = st.one_of(
    st.builds(Surface, scatter=st.just("gaussian"), sigma_deg=st.floats(0.01, 40.0), reflectance=shares),
    st.builds(Surface, scatter=st.just("lambertian"), reflectance=shares),
)
environments = st.builds(
    Environment,
    peak_nm=st.floats(390.0, 770.0),
    flux_per_chip_w=st.floats(1e-12, 10.0),
    active_layer_depth=st.none() | shares,
    n_gan=st.floats(2.0, 3.0),
    layer_order=st.sampled_from(["gan_first", "aln_first"]),
    chip_bottom=st.sampled_from(["contact", "mirror", "air_gap"]),
    chip_absorption_per_cm=st.floats(0.0, 1e4),
    substrate=surfaces,
    receiver=surfaces,
)
effects = st.builds(
    AppliedEffect,
    name=names,
    parameters=st.dictionaries(names, finite | words | st.lists(finite, max_size=4).map(tuple), max_size=3),
    source_sha256=st.none() | st.just("0123456789abcdef" * 4),
)
fits = st.sampled_from(
    [
        {},
        {"environment.n_gan": Fit(free=True, lower=2.0, upper=3.0)},
        {"environment.chip_absorption_per_cm": Fit(lower=0.0, upper=1e4, prior_mean=1e-7, prior_sd=1e-300)},
    ]
)
models = st.builds(
    Model,
    name=st.text(st.characters(exclude_categories=("Cs", "Cc")), min_size=1, max_size=80),
    notes=st.text(st.characters(exclude_categories=("Cs",)), max_size=200),
    environment=environments,
    effects=st.lists(effects, max_size=3, unique_by=lambda effect: effect.name).map(tuple),
    fit=fits,
)
FULL = Model(
    name="full",
    notes='two lines,\none with """quotes""" and a \\backslash\x7f',
    effects=(AppliedEffect(name="tilt", parameters={"tilt_per_mm": 0.01, "gain": (0.1, -0.2), "order": "aln"}),),
    fit={"environment.n_gan": Fit(free=True, lower=2.0, upper=3.0, prior_mean=2.5, prior_sd=0.1)},
)


@settings(max_examples=150, derandomize=True, deadline=None)
@given(models)
def test_a_model_is_read_back_equal(model: Model) -> None:
    """Whatever the model, its file says the same: equal model, equal hash, and the same text when written again."""
    text = to_toml(model)
    again = parse_toml(text, "model.toml")
    assert again == model
    assert again.sha256 == model.sha256
    assert to_toml(again) == text


@settings(max_examples=60, derandomize=True, deadline=None)
@given(models, models)
def test_a_diff_is_empty_only_between_equal_models(a: Model, b: Model) -> None:
    """No change between a model and itself; both directions name the same paths with the values exchanged."""
    assert diff(a, a) == []
    forth, back = diff(a, b), diff(b, a)
    assert (forth == []) == (a == b)
    assert {(c.path, str(c.before), str(c.after)) for c in forth} == {
        (c.path, str(c.after), str(c.before)) for c in back
    }


def test_a_diff_names_path_values_and_unit() -> None:
    """A line per leaf that differs; an effect that comes is shown by its parameters, and its place."""
    after = FULL.with_value("environment.substrate.sigma_deg", 7.5).model_copy(update={"effects": ()})
    assert [str(change) for change in diff(FULL, after)] == [
        "environment.substrate.sigma_deg: 5 -> 7.5 deg",
        "effects.tilt.tilt_per_mm: 0.01 -> (none) 1/mm",
        "effects.tilt.gain: [0.1, -0.2] -> (none)",
        "effects.tilt.order: aln -> (none)",
        "effects: ['tilt'] -> []",
    ]


def test_the_order_of_effects_is_a_difference() -> None:
    """They are applied in their order, so the hash differs and the diff says so."""
    one, two = (AppliedEffect(name=name) for name in ("one", "two"))
    a, b = Model(name="a", effects=(one, two)), Model(name="a", effects=(two, one))
    assert a.sha256 != b.sha256
    assert [change.path for change in diff(a, b)] == ["effects"]


@pytest.mark.parametrize("name", SHIPPED)
def test_a_shipped_model_is_found_by_name_and_written_as_shipped(name: str) -> None:
    """Its file is what `to_toml` writes, so that unit, range and meaning beside each value are today's."""
    file = Path(__file__).parents[2] / "luxloop" / "models" / f"{name}.toml"
    assert find_model(name) == read_model(file)
    assert to_toml(find_model(name)) == file.read_text(encoding="utf-8")


def test_what_is_left_out_takes_the_clear_chips_value() -> None:
    """A file may say only what it changes."""
    model = parse_toml('schema = "luxloop-model/1"\nname = "a"\n[environment]\nn_gan = 2.5\n', "a.toml")
    assert model.environment == Environment(n_gan=2.5)


@pytest.mark.parametrize(
    ("old", "new", "field", "told"),
    [
        ("reflectance = 0.35", "reflectance = 1.35", "environment.receiver.reflectance", "0 to 1"),
        ("n_gan =", "n_gam =", "environment.n_gam", "did you mean n_gan?"),
        ("peak_nm = 445.0", "peak_nm = '445'", "environment.peak_nm", "390 to 770 nm"),
        ("peak_nm = 445.0", "peak_nm = nan", "environment.peak_nm", "390 to 770 nm"),
        ("peak_nm = 445.0", "peak_nm = true", "environment.peak_nm", "390 to 770 nm"),
        ("peak_nm = 445.0", "peak_nm = ", "line ", "TOML"),
        ("peak_nm = 445.0", "peak_nm = 445,0", "line ", "TOML"),
        ("peak_nm = 445.0", "peak_nm = 445.0\npeak_nm = 446.0", "line ", "overwrite"),
        ('name = "full"', "", "name", "missing"),
        ('name = "full"', 'name = ""', "name", "at least 1 character"),
        ('name = "full"', 'nam = "full"', "nam", "did you mean name?"),
        ('schema = "luxloop-model/1"', "", "schema", 'begin the file with schema = "luxloop-model/1"'),
        ("luxloop-model/1", "luxloop-model/2", "schema", "another luxloop"),
        ("[[effects]]", "[[effect]]", "effect", "did you mean effects?"),
        ("[[effects]]", "[effects]", "effects", "[[effects]]"),
        ("[effects.parameters]", "[effects.parametrs]", "effects.0.parametrs", "did you mean parameters?"),
        ("tilt_per_mm = 0.01", "tilt_per_mm = true", "effects.0.parameters.tilt_per_mm", "a number"),
        ("tilt_per_mm = 0.01", "tilt_per_mm = 2026-01-01", "effects.0.parameters.tilt_per_mm", "a number"),
        ('name = "tilt"', 'name = "Tilt it"', "effects.0.name", ""),
        ("free = true", "free = 1", "fit.environment.n_gan.free", ""),
        ("lower = 2.0", "lowr = 2.0", "fit.environment.n_gan.lowr", "did you mean lower?"),
        ("prior_sd = 0.1", "prior_sd = -0.1", "fit.environment.n_gan.prior_sd", "above 0"),
        ('[fit."environment.n_gan"]', '[fit."environment.n_gam"]', "fit.environment.n_gam", "did you mean"),
        ('scatter = "gaussian"', 'scatter = "lambertian"', "environment.substrate.sigma_deg", "remove sigma_deg"),
        ('scatter = "gaussian"', 'scatter = "gauss"', "environment.substrate.scatter", "gaussian or lambertian"),
        ("[environment]", "[environmant]\n[environment]", "environmant", "did you mean environment?"),
        ("[environment]", "environment = 3\n[a]", "line ", "overwrite"),
        ("[environment]\n", "[environment]\n[environment.substrat]\n", "environment.substrat", "substrate"),
    ],
)
def test_a_spoilt_file_is_refused_with_what_mends_it(old: str, new: str, field: str, told: str) -> None:
    """File, dotted path (or line), and either the range or the word that was meant."""
    text = to_toml(FULL)
    assert old in text
    with pytest.raises(InputError) as caught:
        parse_toml(text.replace(old, new, 1), "model.toml")
    assert caught.value.field.startswith(f"model.toml: {field}")
    assert told in str(caught.value)


@pytest.mark.parametrize("value", ["9" * 5000, "[" * 3000], ids=["digits", "brackets"])
def test_a_value_without_end_is_no_toml(value: str) -> None:
    """tomllib gives up on it otherwise than on wrong TOML."""
    with pytest.raises(InputError, match=r"mine\.toml: line 1: got .*, allowed: TOML; a number has at most"):
        parse_toml(f"schema = {value}", "mine.toml")


def test_a_line_that_is_no_toml_is_shown() -> None:
    """Its number and its text."""
    with pytest.raises(InputError) as caught:
        parse_toml('schema = "luxloop-model/1"\nname = full\n', "model.toml")
    assert (caught.value.field, caught.value.value) == ("model.toml: line 2", "name = full")
    with pytest.raises(InputError, match="line 2"):
        parse_toml('schema = "luxloop-model/1"\nname = "fu', "model.toml")


@pytest.mark.parametrize(
    ("content", "told"),
    [(None, "luxloop model new"), (b"\xff\xfe\x00", "UTF-8"), (b"#" * (MAX_BYTES + 1), "at most"), (b"", "schema")],
)
def test_a_file_that_is_none_is_refused(tmp_path: Path, content: bytes | None, told: str) -> None:
    """Absent, another encoding, far too large, empty."""
    path = tmp_path / "model.toml"
    if content is not None:
        path.write_bytes(content)
    with pytest.raises(InputError, match=told):
        read_model(path)


def test_a_folder_is_no_model(tmp_path: Path) -> None:
    """The operating system's reason becomes the mend."""
    with pytest.raises(InputError, match="directory"):
        read_model(tmp_path)


def test_a_misspelt_shipped_name_is_met_by_the_right_one() -> None:
    """Both names are listed too."""
    with pytest.raises(InputError, match=r"paper or clear_chip.*did you mean clear_chip\?"):
        find_model("clearchip")


def test_windows_line_ends_and_a_byte_order_mark_do_not_matter(tmp_path: Path) -> None:
    """Editors of Windows write both."""
    path = tmp_path / "model.toml"
    path.write_bytes(b"\xef\xbb\xbf" + to_toml(find_model("paper")).replace("\n", "\r\n").encode())
    assert read_model(path).environment == find_model("paper").environment


@pytest.mark.parametrize(
    ("owner", "field", "told"),
    [
        (Environment, "peak_nm", "390 to 770"),
        (Environment, "fwhm_nm", "above 0 to 100"),
        (Environment, "emission", "isotropic or in_plane_dipole"),
        (Environment, "active_layer_depth", "0 to 1"),
        (Fit, "prior_sd", "above 0"),
        (Fit, "lower", ""),
    ],
)
def test_a_range_is_told_as_people_say_it(owner: Any, field: str, told: str) -> None:
    """From the same limits that are enforced."""
    assert range_of(owner, field) == told
