from drivers.core.config import find_key_lines

TEXT = '''# a comment = 1
top = 1
multi = """
fake = 1
[fake]
"""
list = [
  1, # [x]
  2,
]
a.b.c = 1

[table]
key = 'x'
"quoted.key" = 2
inline = { p = 1, q = { r = 2 } }
[table.sub]  # header
key = 3
[[rows]]
key = 1
[[rows]]
[rows.sub]
key = 2
'''


def test_every_key_has_its_line() -> None:
    lines = find_key_lines(TEXT)
    assert lines == {
        ("top",): 2,
        ("multi",): 3,
        ("list",): 7,
        ("a",): 11,
        ("a", "b"): 11,
        ("a", "b", "c"): 11,
        ("table",): 13,
        ("table", "key"): 14,
        ("table", "quoted.key"): 15,
        ("table", "inline"): 16,
        ("table", "inline", "p"): 16,
        ("table", "inline", "q"): 16,
        ("table", "inline", "q", "r"): 16,
        ("table", "sub"): 17,
        ("table", "sub", "key"): 18,
        ("rows",): 19,
        ("rows", "[0]"): 19,
        ("rows", "[0]", "key"): 20,
        ("rows", "[1]"): 21,
        ("rows", "[1]", "sub"): 22,
        ("rows", "[1]", "sub", "key"): 23,
    }
