"""Taxonomy of categories: complete, without ambiguity, consistent with the category rules."""

from __future__ import annotations

from collections import Counter

import pytest
from pydantic import ValidationError

from factory.scenes.author.props.catalogue import CATALOGUE
from factory.scenes.rules import builtin_rules
from schemas.plan import ScenePlan
from schemas.scene_plan import category_of, load_taxonomy
from schemas.terms import BUILTIN_CATEGORIES


def test_every_category_of_a_rule_or_a_scene_has_a_place_in_the_taxonomy() -> None:
    used = {rule.category for rule in builtin_rules().rules}
    used |= {category for groups in BUILTIN_CATEGORIES.values() for group in groups for category in group}
    assert used == set(load_taxonomy())


def test_a_synonym_belongs_to_one_category() -> None:
    names = Counter(name for kind in load_taxonomy().values() for name in kind.synonyms)
    names.update(category.replace("_", " ") for category in load_taxonomy())
    assert [name for name, count in names.items() if count > 1] == []


def test_a_prim_that_is_named_by_a_synonym_has_the_category_of_the_synonym() -> None:
    rules = builtin_rules()
    wrong = {}
    for category, kind in load_taxonomy().items():
        for name in (category, *kind.synonyms) if category != "box" else kind.synonyms:  # any object can be named `box`
            rule = rules.match(f"SM_{name.title().replace(' ', '')}_01")
            if rule is None or rule.category != category:
                wrong[name] = rule and rule.category
    assert wrong == {}


def test_names_are_read_in_any_case_with_spaces_or_underscores() -> None:
    assert category_of("Couch") == "sofa"
    assert category_of("coffee_maker") == category_of("Coffee machine") == "coffee_machine"
    assert category_of("unicorn") is None


def test_at_least_45_categories_have_three_variants_each() -> None:
    rules, variants = builtin_rules(), Counter[str]()
    for name, entry in CATALOGUE.items():
        rule = rules.match(f"{name}_00")
        if rule is not None:
            variants[rule.category] += entry.variants
    assert sum(count >= 3 for count in variants.values()) >= 45


def test_the_error_of_a_plan_with_a_synonym_as_category_names_the_category() -> None:
    with pytest.raises(ValidationError, match="couch is a synonym of sofa"):
        ScenePlan(name="home", episodes=1, seen=("couch",))


def test_a_family_in_a_plan_has_its_built_in_categories() -> None:
    plan = ScenePlan(name="home", episodes=1)
    assert plan.categories == BUILTIN_CATEGORIES["home"]
    assert not set(plan.categories.seen) & set(plan.categories.held_out)
