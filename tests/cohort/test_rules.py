"""rules.toml is read by the letter; what matters to results, and only that, changes the settings."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest

from ronnaplan.cohort.index import Index
from ronnaplan.cohort.listing import bring_up_to_date
from ronnaplan.cohort.planning import decide, tasks_of
from ronnaplan.cohort.rules import EXAMPLE, CohortRule, Rules, Task, read_rules
from ronnaplan.documents.files import make_folder
from ronnaplan.errors import InputError
from ronnaplan.jobs.rules import first_fitting, never_reached
from tests.cohort.scans import tiny

SERIES = {
    **{"modality": "CT", "description": "Head 0.6", "protocol": "Head", "station": "CT1", "study": "QA"},
    **{"device": "Maker Model 7", "folder": "2026/Phantom/1"},
}


def test_the_example_is_read_and_its_first_fitting_rule_decides(tmp_path: Path) -> None:
    (tmp_path / "rules.toml").write_text(EXAMPLE)
    rules = read_rules(tmp_path / "rules.toml")
    assert [rule.name for rule in rules.rule] == ["daily phantom", "all others"]
    first = first_fitting(rules.rule, SERIES)
    assert first is not None
    assert first.expected == 6
    assert rules.limits == Rules().limits
    second = first_fitting(rules.rule, {**SERIES, "folder": "patients"})
    assert second is not None
    assert second.name == "all others"
    assert first_fitting(rules.rule, {**SERIES, "modality": "MR"}) is None
    assert set(tasks_of(rules)) == {"daily phantom", "all others"}


def test_brackets_in_a_pattern_stand_for_themselves() -> None:
    """Only * and ? do not, as the page says: descriptions such as these are common."""
    rule = CohortRule(name="x", description="Head [Bone] *")
    assert first_fitting((rule,), {**SERIES, "description": "HEAD [bone] 0.6"}) is not None
    assert first_fitting((rule,), {**SERIES, "description": "Head B 0.6"}) is None


@pytest.mark.parametrize(
    ("first", "second", "is_hidden"),
    [
        ({}, {"folder": "qa*"}, True),
        ({"folder": "QA*"}, {"folder": "qa/2026*", "station": "CT1"}, True),
        ({"folder": "a?c"}, {"folder": "A?c"}, True),
        ({"folder": "[*"}, {"folder": "[a]"}, True),
        ({}, {"modality": "*"}, False),
        ({"folder": "?"}, {"folder": "*"}, False),
        ({"folder": "qa*", "station": "CT1"}, {"folder": "qa*"}, False),
    ],
)
def test_a_rule_is_never_reached_only_if_an_earlier_one_fits_all_that_it_does(
    first: dict[str, str], second: dict[str, str], is_hidden: bool
) -> None:
    rules = [CohortRule(name="x", **first), CohortRule(name="y", **second)]  # type: ignore[arg-type]
    assert never_reached(rules) == [(rules[1], rules[0])] * is_hidden


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        ("[[rule]]\nname = 'x'\ndiameter = 5", "diameter: no field"),
        ("[[rule]]\nname = 'x'\n[[rule]]\nname = 'x'", "two rules have the same name"),
        ("[limits]\nseconds = '5'", "seconds"),
        ("[[rule]]\nname = 'x'\nexpected = true", "expected"),
        ("nonsense", "no|Expected|invalid"),
        ("home = '/'", "home: no field"),
        ("[[rule]]\nname = 'x'\ndiameters = [11,5]", r"\[11, 5\] may be 11.5 mm or 2 .* several \[11.0, 5.0\]"),
    ],
)
def test_what_is_no_rule_is_refused_by_name(tmp_path: Path, text: str, reason: str) -> None:
    (tmp_path / "rules.toml").write_text(text)
    with pytest.raises(InputError, match=reason):
        read_rules(tmp_path / "rules.toml")


def test_a_template_that_is_not_there_is_told_before_any_work(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"frame\.json"):
        tasks_of(Rules(home=tmp_path, rule=(CohortRule(name="x", template="frame.json"),)))


def test_settings_change_with_what_is_looked_for_and_not_with_the_patterns() -> None:
    def settings(**given: object) -> str:
        return Task(CohortRule(name=str(given.pop("name", "x")), **given), Path()).settings  # type: ignore[arg-type]

    assert settings() == settings(name="y", station="CT*", folder="a")
    different = [settings(), settings(diameters=(5.0,)), settings(expected=4), settings(marker="shell:1")]
    assert len({*different, settings(sheet=False)}) == 5


def test_an_archive_counts_as_a_folder_but_for_a_root_that_is_one(tmp_path: Path) -> None:
    shutil.make_archive(
        str(tmp_path / "in" / "Phantoms" / "2026"), "zip", tiny(tmp_path / "files" / "a", "6").parent
    )
    for root, folder in (("in", "phantoms/2026.zip/a"), ("in/Phantoms/2026.zip", "a")):
        with Index(make_folder(tmp_path / folder)) as index:
            bring_up_to_date(index, [str(tmp_path / root)])
            rules = Rules(rule=(CohortRule(name="x", folder=folder),))
            decide(index, rules, tasks_of(rules))
            assert index.count("waiting") == 1
