import math

import pytest

from carosac_toolkit.base.yaml import format_path, read_yaml


def test_every_value_knows_its_line():
    document = read_yaml("a: 1\nb:\n  c: [1,\n      2]\n  d: {e: x}\n")
    assert document.data == {"a": 1.0, "b": {"c": [1.0, 2.0], "d": {"e": "x"}}}
    assert document.line(("b", "c", 1)) == 4
    assert document.line(("b", "d", "e")) == 5
    assert document.line(("b", "d", "missing")) == 5
    assert not document.faults


@pytest.mark.parametrize(
    ("text", "value"),
    [
        ("1", 1.0), ("-0", -0.0), ("1e5", 1e5), ("1e-3", 1e-3), ("1.5E+3", 1500.0),
        (".5", 0.5), ("-.5", -0.5), ("5.", 5.0), (".inf", math.inf), ("1_000", 1000.0),
        ("08", 8.0), ("010", 10.0),  # decimal, as a reader without YAML 1.1 in mind takes them
        ("1:30", "1:30"), ("1:30.5", "1:30.5"), ("0x10", "0x10"), ("0o10", "0o10"),
        ("0b101", "0b101"), ("2001-01-01", "2001-01-01"), ("1e", "1e"), ("nan", "nan"),
        ("~", None), ("", None), ("null", None), ("true", True), ("False", False),
        ("yes", "yes"), ("no", "no"), ("on", "on"), ("off", "off"), ("y", "y"),
        ("'3'", "3"), ('"true"', "true"), ("!!bool x", "x"), ("!!float 1:30", "1:30"),
    ],
)  # fmt: skip
@pytest.mark.parametrize("head", ["", "%YAML 1.1\n---\n"])
def test_numbers_are_decimal_and_surprises_of_yaml_stay_text(text, value, head):
    data = read_yaml(f"{head}a: {text}\n").data["a"]
    if head and text in ("08", "-.5"):  # YAML 1.1 takes them as text, and units.py reads that
        value = text
    assert data == value
    assert type(data) is type(value)


@pytest.mark.parametrize(
    "text", ["a:\t1\t# one\nb:  [1,\t2]\t\n", "a: 1 # one\nb:\n  -\t1\n  - 2\n"]
)
def test_tabs_after_the_first_word_are_spaces(text):
    document = read_yaml(text)
    assert document.data == {"a": 1.0, "b": [1.0, 2.0]}
    assert not document.faults


@pytest.mark.parametrize(
    ("text", "line", "message"),
    [
        ("a: 1\nb: [1, 2\nc: 3\n", 3, "not YAML"),
        ("a: 1\n\tb: 2\n", 2, "a tab before the first word; YAML indents with spaces"),
        ("a:\n\tb: 2\n", 2, "a tab before the first word; YAML indents with spaces"),
        ("a:\n  b: 1\n c: 2\n", 3, "wrong indentation: 1 space here, 2 in line 2; the lines above"),
        ("a:\n  b: 1\n   c: 2\n", 3, "wrong indentation: 3 spaces here, 2 in line 2, which has"),
        ("x:\n  - {n: a}\n\n   - {n: b}\n", 4, "wrong indentation: 3 spaces here, 2 in line 2"),
        ("  a: 1\nb: 2\n", 2, "wrong indentation: 0 spaces here, 2 in line 1"),
        ("a: b: c\n", 1, "not YAML: column 5"),
        ("", 1, "empty"),
        ("a: 1\nb: 2\na: 3\n", 3, "a: given twice, first in line 1"),
        ("a: &x [*x]\n", 1, "contains itself"),
        ("a: 1\n---\nb: 2\n", 2, "another document"),
        ("a: \x07\n", 1, "not YAML"),
        ("? [1]\n: 2\n", 1, "a key must be a name"),
        ("a: &x 1\nb: &x 2\n", 2, "an anchor of this name stands further up"),
        ("a: " + "[" * 50_000, 1, "nested more than 64 levels deep"),
        ("a:\n" + "- " * 50_000, 2, "nested more than 64 levels deep"),
        ("#" * 200_001, 1, "200001 characters; allowed: 200000"),
        ("a: !!python/object:os.system {}\n", 1, None),
    ],
)
def test_faults_of_the_text_have_a_line(text, line, message):
    document = read_yaml(text)
    if message is None:  # an unknown tag builds nothing but plain data
        assert document.data == {"a": {}}
        return
    assert [where for where, _ in document.faults] == [line]
    assert message in document.faults[0][1]


def test_many_aliases_do_not_fill_the_memory():
    text = "a0: &a0 [1, 1, 1, 1, 1, 1, 1, 1, 1, 1]\n" + "".join(
        f"a{i}: &a{i} [{', '.join([f'*a{i - 1}'] * 10)}]\n" for i in range(1, 12)
    )
    assert "nested too deeply" in read_yaml(text).faults[0][1]


def test_paths_read_like_code():
    assert format_path(("chains", 2, "cable")) == "chains[2].cable"
