"""Tests language files: every mistake is named with its key and the valid values."""

from pathlib import Path

import pytest

from schemas.errors import InvalidLanguage, UsageError
from schemas.language.language_file import LanguageSpec, SpokenLanguage, load_language


def load(tmp_path: Path, text: str | bytes) -> LanguageSpec:
    path = tmp_path / "language.toml"
    path.write_bytes(text if isinstance(text, bytes) else text.encode())
    return load_language(str(path))


def test_an_empty_file_has_the_defaults(tmp_path):
    spec = load(tmp_path, "")
    assert spec.languages == {"en": 1.0}
    assert len(spec.families) == 15


def test_a_list_of_languages_gives_equal_shares(tmp_path):
    assert load(tmp_path, 'languages = ["en", "de"]').languages == {"en": 1.0, "de": 1.0}


@pytest.mark.parametrize(
    ("text", "fault"),
    [
        ("languages = {fr = 1}", "languages: unknown language 'fr'; valid: en, de, es, zh"),
        ("languages = {en = 0}", "languages: at least one language needs a share above 0"),
        ("registers = {polit = 1}", "unknown register 'polit'; valid: .*did you mean 'polite'"),
        ("features = {colours = 1}", "unknown feature 'colours'; valid: .*did you mean 'colour'"),
        ("features = {colour = -1}", "features.colour: .* greater than or equal to 0"),
        ("per_episode = 0", "per_episode: "),
        ("fit = 'two'", "fit: "),
        ("fit = 'any'\nredundant = 0.5", "`redundant` is for instructions that fit one object"),
        ("tempo = 1", "tempo: no such key"),
        ("nouns = {de = {robot_arm = ['Roboterarm']}}", "'Roboterarm' needs a gender, one of m, f, n"),
        ("nouns = {en = {robot_arm = ['chair']}}", "'chair' is already a noun of the kind 'chair'"),
        ("nouns = {en = {robot_arm = []}}", "en.robot_arm has no noun"),
        ('nouns = {en = {robot_arm = ["arm\\u0007"]}}', "has characters that are not text"),
        ("nouns = {xx = {robot_arm = ['arm']}}", "unknown language 'xx'"),
        (b"seed = \xff", "is not valid TOML"),
        (b'nouns = {en = {robot_arm = ["\\ud800"]}}', "is not valid TOML"),
    ],
)
def test_each_mistake_is_named(tmp_path, text, fault):
    with pytest.raises(InvalidLanguage, match=fault):
        load(tmp_path, text)


@pytest.mark.parametrize(
    ("reference", "fault"), [("none.toml", "no such file"), (".", "that is a directory"), ("a\0b", "NUL")]
)
def test_a_missing_language_file_is_a_usage_error(reference, fault):
    with pytest.raises(UsageError, match=fault):
        load_language(reference)


def test_nouns_of_the_file_are_written_and_read(tmp_path):
    language = SpokenLanguage(load(tmp_path, "nouns = {de = {robot_arm = ['Roboterarm:m']}}"), "de")
    pattern = next(each for each in language.grammar.sentences if each.before == "Dein Ziel ist ")
    (reading,) = language.reader.read("Dein Ziel ist der Roboterarm.")
    assert language.grammar.sentence(pattern, reading.expression) == "Dein Ziel ist der Roboterarm."
