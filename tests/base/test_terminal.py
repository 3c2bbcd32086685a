import io
import sys

from carosac_toolkit.base.terminal import (
    TerminalText,
    has_control_characters,
    plain_output,
    plain_stream,
    printable,
)


def test_control_characters_are_shown():
    title, clear = "\x1b]0;owned\x07", "\x9b2J"
    assert printable(f"a{title}b{clear}\r") == r"a\x1b]0;owned\x07b\x9b2J\x0d"
    assert printable("safe\u202egnp.exe") == r"safe\u202egnp.exe"
    assert printable("Füße\t5 µm\n中文") == "Füße\t5 µm\n中文"
    assert has_control_characters("a\nb") and not has_control_characters("Füße 中文")


def test_a_line_that_is_rewritten_on_purpose_passes_a_plain_stream():
    stream = io.StringIO()
    plain = plain_stream(stream)
    plain.write(TerminalText("\r\x1b[K"))
    plain.writelines(["\r\x1b[K", "x"])
    assert stream.getvalue() == "\r\x1b[K" + r"\x0d\x1b[K" + "x"
    assert not plain.isatty()


def test_output_is_plain_until_the_block_ends(capsys):
    with plain_output():
        print("\x1b[31mred")
        print("\x1b[31mred", file=sys.stderr)
    print("\x1b[31mred")
    captured = capsys.readouterr()
    assert captured.out == "\\x1b[31mred\n\x1b[31mred\n" and captured.err == "\\x1b[31mred\n"
