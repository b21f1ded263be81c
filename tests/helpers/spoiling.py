"""Whole files and values spoilt in a few places, by bytes and by meaning, from a random number generator."""

from __future__ import annotations

import json
import random
import re
import struct

WORDS = """
    0 -0.0 1 -1 2 1e-300 1e-30 1e-9 1e9 1e30 1e300 1e308 -1e308 nan inf -inf 4294967295 4294967296 2147483648
    9223372036854775808 0x10 1_000 0.1 3.7 65536 true
"""
NUMBERS = (*WORDS.split(), "1" + "0" * 400, "9" * 5000)
PLAIN_TEXTS = r"""
    a ../../etc/passwd /dev/null /dev/zero . .. / {0} {path} %s $HOME None [a](b)
    in/pipe in/folder in -- - NaN a.toml C:\a
"""
ODD_TEXTS = ("", " ", "\u0000", "a\nb", "\u202e", "ü" * 300, "x" * 20_000, "\x1b[31m", "\ud800", "0" * 4301)
TEXTS = (*PLAIN_TEXTS.split(), *ODD_TEXTS)


def number(rng: random.Random) -> str:
    if rng.random() < 0.5:
        return rng.choice(NUMBERS)
    return repr(rng.choice((1, -1)) * rng.random() * 10.0 ** rng.randint(-12, 12))


def text(rng: random.Random) -> str:
    if rng.random() < 0.6:
        return rng.choice(TEXTS)
    return "".join(chr(rng.randint(1, 0x2FF)) for _ in range(rng.randint(1, 12)))


def toml_value(rng: random.Random, depth: int = 0) -> str:
    kind = rng.randint(0, 5 if depth < 3 else 3)
    if kind <= 1:
        return number(rng)
    if kind <= 3:
        return json.dumps(text(rng))
    inner = [toml_value(rng, depth + 1) for _ in range(rng.randint(0, 4))]
    if kind == 4:
        return f"[{', '.join(inner)}]"
    return "{" + ", ".join(f"k{number} = {entry}" for number, entry in enumerate(inner)) + "}"


def scale_number(line: str, factor: float) -> str:
    """The first number of a line times a factor."""
    return re.sub(r"\d+(\.\d+)?", lambda match: f"{float(match[0][:300]) * factor:g}", line, count=1)


def spoilt_lines(rng: random.Random, whole: str) -> str:
    """Text of lines KEY = VALUE, CSV, OBJ, XML: values, lines and letters are changed."""
    lines = whole.split("\n")
    for _ in range(rng.choice((1, 1, 1, 2, 3, 8))):
        line_index = rng.randrange(len(lines))
        kind = rng.randint(0, 14)
        key, equals, _ = lines[line_index].partition("=")
        if kind >= 10:
            factor = rng.choice((0.0, -1.0, 0.5, 2.0, 10.0 ** rng.randint(-9, 9)))
            lines[line_index] = scale_number(lines[line_index], factor)
        elif kind <= 3 and equals:
            lines[line_index] = f"{key}= {toml_value(rng)}"
        elif kind == 4:
            del lines[line_index]
            lines = lines or [""]
        elif kind == 5:
            lines.insert(line_index, lines[rng.randrange(len(lines))])
        elif kind == 6:
            other_index = rng.randrange(len(lines))
            lines[line_index], lines[other_index] = lines[other_index], lines[line_index]
        elif kind == 7:
            words = lines[line_index].split(" ")
            words[rng.randrange(len(words))] = rng.choice((number, text))(rng)
            lines[line_index] = " ".join(words)
        elif kind == 8:
            cells = lines[line_index].split(",")
            cells[rng.randrange(len(cells))] = number(rng)
            lines[line_index] = ",".join(cells)
        else:
            column = rng.randint(0, len(lines[line_index]))
            lines[line_index] = lines[line_index][:column] + text(rng) + lines[line_index][column + rng.randint(0, 3) :]
    if rng.random() < 0.03:
        lines.append("a = " + "[" * 3000 + "]" * 3000)
    if rng.random() < 0.03:
        lines.append(".".join("a" * 2000) + " = 1")
    return "\n".join(lines)


PLAIN_NUMBERS = [word for word in NUMBERS if len(word) < 25 and re.fullmatch(r"[-\d.e]+|-?inf|nan", word)]


def other_numbers(rng: random.Random, whole: str) -> str:
    """Text of which some numbers are others: it is still read, whatever its syntax is."""
    matches = list(re.finditer(r"-?\d+(\.\d+)?([eE][-+]?\d+)?", whole))
    chosen = rng.sample(matches, min(rng.choice((1, 1, 2, 5)), len(matches)))
    for match in sorted(chosen, key=re.Match.start, reverse=True):
        value = float(match[0][:300]) * rng.choice((0.0, -1.0, 0.5, 2.0, 10.0 ** rng.randint(-9, 9)))
        word = rng.choice((rng.choice(PLAIN_NUMBERS), f"{value:g}", str(rng.randint(-3, 300))))
        whole = whole[: match.start()] + word + whole[match.end() :]
    return whole


def spoilt_bytes(rng: random.Random, whole: bytes) -> bytes:
    """Bytes changed, cut, doubled, and numbers in them made extreme."""
    data = bytearray(whole)
    for _ in range(rng.choice((1, 1, 2, 4, 16))):
        if not data:
            break
        offset = rng.randrange(len(data)) if rng.random() < 0.5 else rng.randrange(min(len(data), 600))
        kind = rng.randint(0, 6)
        if kind == 0:
            data[offset] ^= 1 << rng.randint(0, 7)
        elif kind == 1:
            data[offset : offset + 4] = struct.pack("<I", rng.choice((0, 1, 2**31 - 1, 2**31, 2**32 - 1, 65536)))
        elif kind == 2:
            del data[offset:]
        elif kind == 3:
            del data[offset : offset + rng.randint(1, 40)]
        elif kind == 4:
            data[offset:offset] = data[offset : offset + rng.randint(1, 400)]
        elif kind == 5:
            data[offset : offset + 8] = struct.pack("<d", float(rng.choice(("nan", "inf", "-inf", "1e308", "0"))))
        else:
            data[offset:offset] = rng.randbytes(rng.randint(1, 16))
    return bytes(data)


def spoilt(rng: random.Random, whole: bytes) -> bytes:
    """A spoilt copy, by lines if it is text, mostly."""
    try:
        lines = whole.decode("utf-8")
    except UnicodeDecodeError:
        return spoilt_bytes(rng, whole)
    if rng.random() < 0.15:
        return spoilt_bytes(rng, whole)
    if rng.random() < 0.4:
        return other_numbers(rng, lines).encode()
    return spoilt_lines(rng, lines).encode("utf-8", "surrogatepass")
