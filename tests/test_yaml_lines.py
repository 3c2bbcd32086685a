import pytest

from carosac_toolkit.yaml_lines import format_path, read_yaml


def test_every_value_knows_its_line():
    document = read_yaml("a: 1\nb:\n  c: [1,\n      2]\n  d: {e: x}\n")
    assert document.data == {"a": 1.0, "b": {"c": [1.0, 2.0], "d": {"e": "x"}}}
    assert document.line(("b", "c", 1)) == 4
    assert document.line(("b", "d", "e")) == 5
    assert document.line(("b", "d", "missing")) == 5
    assert not document.faults


def test_numbers_are_decimal_and_surprises_of_yaml_stay_text():
    document = read_yaml("[1e5, 1:30, 0x10, 010, .5, ~, no, '3']")
    assert document.data == ["1e5", "1:30", "0x10", 10.0, 0.5, None, False, "3"]


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
