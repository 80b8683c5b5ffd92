"""What is looked at of an effect before it is used: each of its hooks, and what it does there."""

from __future__ import annotations

import importlib
import pkgutil

import pytest

from containers import effects as catalogue
from containers.effect import Effect
from containers.effect_findings import findings_of
from containers.effect_trial import trial

KINDS = {
    kind.name: kind
    for module in pkgutil.iter_modules(catalogue.__path__)
    for kind in vars(importlib.import_module(f"{catalogue.__name__}.{module.name}")).values()
    if isinstance(kind, type) and issubclass(kind, Effect) and hasattr(kind, "name")
}
STACK = '''
from dataclasses import replace
import numpy as np
from containers.effect import StackEffect, parameter

class Mine(StackEffect):
    """A film is changed."""

    name = "mine"
    of = ("{of}",)
    formula = "f"
    reference = "a test"
    conserves = ("energy",)
    share: float = parameter("s", unit="", lower=0.0, upper=0.5, off=0.0)

    def {hook}:
        {body}
'''


def film_effect(of: str, hook: str, body: str) -> str:
    """The source of an effect of films that overrides one hook with a line."""
    return STACK.format(of=of, hook=hook, body=body)


def rows_effect(body: str) -> str:
    """One that makes media of its own."""
    return film_effect("film", "rows(self, rows)", body)


def beside_effect(body: str) -> str:
    """One that gives chips at other places other DBRs."""
    return film_effect("dbr", "beside(self, stack, x_um)", body)


def found(source: str) -> dict[str, tuple[bool, str]]:
    """What a trial of that source finds, by what it looked at."""
    return {check: (ok, said) for check, ok, said in trial(source.encode(), "mine.py")}


@pytest.mark.parametrize("name", sorted(KINDS))
def test_each_effect_of_the_catalogue_would_pass_its_own_trial(name: str) -> None:
    """Nothing is raised, and it changes at least one of the things that it is tried on."""
    kind = KINDS[name]
    said = {check: look() for check, look in findings_of(kind, kind.spec())}
    assert "it changes nothing" not in said["acts"]
    assert {f"conserves {law}" for law in kind.conserves} <= set(said)


ROWS = rows_effect("return rows if not self.share else replace(rows, index=rows.index + self.share)")
BESIDE = beside_effect(
    "return stack if not self.share * x_um else"
    ' stack.model_copy(update={"layers": stack.layers[1:] if x_um > 0.0 else stack.layers})'
)


@pytest.mark.parametrize(
    ("source", "touched"),
    [
        (ROWS, "it changes the media of a polymer on silicon;"),
        (BESIDE, "it changes the DBR of a chip on the right;"),
        (film_effect("film", "rows_(self, rows)", "return None"), "it changes nothing of a polymer on silicon,"),
    ],
    ids=["rows", "beside", "no hook"],
)
def test_each_hook_of_a_film_is_looked_at(source: str, touched: str) -> None:
    """Also where it is the only one; a hook of another name is none, which the sentence shows."""
    findings = found(source)
    assert all(ok for ok, _ in findings.values()), findings
    assert touched in findings["acts"][1]


@pytest.mark.parametrize(
    ("source", "check", "words"),
    [
        (rows_effect("return replace(rows, index=rows.index * 1.01)"), "off", "the media of a polymer"),
        (rows_effect("return replace(rows, index=rows.index - 2.0 * bool(self.share))"), "acts", "n > 0"),
        (rows_effect("return replace(rows, index=rows.index - 0.1j * self.share)"), "acts", "finite n, and k"),
        (rows_effect("return replace(rows, index=rows.index[:, : None if not self.share else -1])"), "acts", "shape"),
        (rows_effect("return replace(rows, thickness_nm=rows.thickness_nm - 700 * self.share)"), "acts", "0 nm"),
        (rows_effect("rows.index[:] += self.share; return rows"), "again", "in place"),
        (rows_effect("return rows if not self.share else undefined"), "acts", "NameError"),
        (beside_effect('return stack.model_copy(update={"layers": ()})'), "off", "x = 0"),
        (beside_effect('return stack.model_copy(update={"layers": ()}) if x_um else stack'), "off", "on the left"),
        (beside_effect("return stack if not self.share * x_um else None"), "acts", "NoneType"),
    ],
    ids=[
        "off", "n below 0", "k below 0", "a medium missing", "thickness", "in place", "raises", "centre",
        "off beside", "nothing",
    ],
)  # fmt: skip
def test_a_wrong_hook_of_a_film_is_refused_with_the_reason(source: str, check: str, words: str) -> None:
    """By the first look that sees it."""
    ok, said = found(source)[check]
    assert not ok
    assert words in said


def test_media_that_begin_to_absorb_do_not_conserve_energy() -> None:
    """They say that they do; on a clear film nothing may be lost."""
    source = film_effect(
        "dbr",
        "beside(self, stack, x_um)",
        "from containers.stack import added, with_layers; k = abs(self.share * x_um) / 1e4; "
        'return with_layers(stack, lambda one: one.model_copy(update={"medium": added(one.medium, k=k)}))',
    )
    ok, said = found(source)["conserves energy"]
    assert not ok
    assert "a film that absorbs" in said
