"""The text form of OpenUSD (`.usda`) as a tree of prims with those attributes that a scene of Gaussians has.

Nothing is composed: references, payloads, sublayers and variants are stepped over, so a file opens no other file.
Brackets are followed with a counter, not by recursion, and arrays are as long as their text.

Source: openusd.org, "USDA File Format"; the lexer's escapes are those of `TfEscapeString`.
"""

import re
import warnings
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import NoReturn

import numpy as np

from ..base.arrays import Array
from ..errors import FormatError

MAX_NESTING = 200  # of prims, and of brackets in a skipped value
CHUNK_BYTES = 4 << 20  # of an array's text that are parsed at once
TIME_SAMPLES = ".timeSamples"
MIN_NUMPY_BYTES = 512  # of text: less is split faster in Python
SPECIFIERS = (b"def", b"over", b"class")
PREFIXES = ("drsplat:", "primvars:")
COLOR_SPACE, API_SCHEMAS = "colorSpace:name", "apiSchemas"
ATTRIBUTES = frozenset(
    {
        *(f"{name}{half}" for name in ("positions", "orientations", "scales", "opacities") for half in ("", "h")),
        "radiance:sphericalHarmonicsDegree", "radiance:sphericalHarmonicsCoefficients",
        "radiance:sphericalHarmonicsCoefficientsh", "projectionModeHint", "xformOpOrder", COLOR_SPACE,
    }
)  # fmt: skip
METADATA = frozenset({"colorSpace", "displayName", "defaultPrim", "upAxis", "metersPerUnit"})

Value = str | np.ndarray

_SPACE = re.compile(rb"(?:[\s;]++|\#[^\n]*+|//[^\n]*+|/\*(?:[^*]|\*(?!/))*+\*/)*+")
_WORD = re.compile(rb"[A-Za-z_\x80-\xff][\w:.\x80-\xff-]*+(?:\[\])?+")
_QUOTES = re.compile(rb"\"{3}|'{3}|\"|'")
_ENDS = {  # what ends text, and an escape, behind which a quote does not
    b'"""': re.compile(rb'\\.|"{3}', re.DOTALL), b"'''": re.compile(rb"\\.|'{3}", re.DOTALL),
    b'"': re.compile(rb'\\.|"|\n', re.DOTALL), b"'": re.compile(rb"\\.|'|\n", re.DOTALL),
}  # fmt: skip
_ASSET, _END_OF_ASSET = re.compile(rb"@(?!@@)[^@\n]*+@|@@@"), re.compile(rb"@@@")
_PATH = re.compile(rb"<[^>\n]*+>")
_SCALAR = re.compile(rb"[-+\w.]++")
_PLAIN = rb"[^()\[\]{\"'@<#]"
_SIMPLE = re.compile(  # most properties of small prims: one match instead of a dozen
    rb"(?:(?:custom|uniform)\s++)?+([A-Za-z_]\w*+(?:\[\])?+)[ \t]++([A-Za-z_][\w:.]*+)[ \t]*+=[ \t]*+"
    rb"(\"[^\"\\\n]*+\"|[-+\w.]++|\((?:" + _PLAIN + rb"++|\(" + _PLAIN + rb"*+\))*+\)|\[" + _PLAIN + rb"{0,4096}+\]"
    rb"|\[\"[^\"\\\n]*+\"\])(?=\n)(?!\s*+\()"
)
_BRACKETS = re.compile(rb"""[][(){}"'@<#/]""")
_END_OF_ARRAY, _NO_NUMBERS = re.compile(rb"\]"), re.compile(rb"[\[\"'@<{#]")
_ESCAPE = re.compile(rb"\\(x[0-9a-fA-F]{1,2}|[0-7]{1,3}|.)", re.DOTALL)
_CONTROLS = {b"a": b"\a", b"b": b"\b", b"f": b"\f", b"n": b"\n", b"r": b"\r", b"t": b"\t", b"v": b"\v"}
_TO_SPACES = bytes.maketrans(b"(),", b"   ")
_NARROW = ("float", "half", "point3f", "point3h", "quatf", "quath", "color", "vector3f", "normal3f")
_OPEN, _CLOSE = b"([{", {b"(": b")", b"[": b"]", b"{": b"}"}


@dataclass(eq=False)
class UsdPrim:
    """A prim: its schema, its name and display name, those attributes that are of use, and its children."""

    schema: str
    name: str
    is_defined: bool = True
    metadata: dict[str, Value] = field(default_factory=dict)
    attributes: dict[str, Value] = field(default_factory=dict)
    children: list["UsdPrim"] = field(default_factory=list)

    def text(self, name: str) -> str:
        """Return an attribute or metadatum that is text; "" where there is none."""
        value = self.attributes.get(name, self.metadata.get(name, ""))
        return value if isinstance(value, str) else ""


def is_wanted(name: str) -> bool:
    """Return whether the value of an attribute of this name is read."""
    return name in ATTRIBUTES or name.startswith(PREFIXES)


def parse_usda(buffer: memoryview) -> UsdPrim:
    """Return the layer as a prim without a name: its metadata, and the prims of its root as children.

    Raises: FormatError: text that is no layer, brackets that do not close or lie too deep in each other.
    """
    return _Parser(buffer).layer()


class _Parser:
    def __init__(self, buffer: memoryview) -> None:
        self.buffer, self.at = buffer, 0

    def layer(self) -> UsdPrim:
        root = UsdPrim("", "")
        self._space()
        if self._peek() == b"(":
            self._metadata(root)
        inside = [root]
        while True:
            self._space()
            if self.at == len(self.buffer):
                if len(inside) > 1:
                    self._fail(f"the end of prim '{inside[-1].name}'")
                return root
            if len(inside) > 1 and self._takes(b"}"):
                inside.pop()
                continue
            self._statement(inside)

    def _statement(self, inside: list[UsdPrim]) -> None:
        """Read a prim up to its opening brace, or a whole property."""
        simple = _SIMPLE.match(self.buffer, self.at) if len(inside) > 1 else None
        if simple is not None:
            self.at = simple.end()
            _keep(inside[-1], simple[2].decode(), _simple_value, simple[1].decode(), bytes(simple[3]))
            return
        word = self._word()
        if word in SPECIFIERS:
            schema = self._word().decode(errors="replace") if self._after_space() not in (b'"', b"'") else ""
            prim = UsdPrim(schema, self._string(), is_defined=word == b"def")
            if self._after_space() == b"(":
                self._metadata(prim)
            self._expect(b"{")
            inside[-1].children.append(prim)
            inside.append(prim)
            if len(inside) > MAX_NESTING:
                self._fail(f"prims in prims up to {MAX_NESTING} deep")
        elif word == b"variantSet":
            self._string()
            self._expect(b"=")
            self._skip()
        elif len(inside) == 1 and word != b"reorder":
            self._fail("def, over or class")
        elif word not in (b"custom", b"uniform", b"varying", b"config", b"reorder", b"prepend", b"append", b"add",
                          b"delete"):  # fmt: skip
            self._property(inside[-1], word.decode(errors="replace"))

    def _property(self, prim: UsdPrim, kind: str) -> None:
        name = kind if self._after_space() == b"=" else self._word().decode(errors="replace")
        if self._after_space() == b"=":
            self._expect(b"=")
            if is_wanted(name):
                _keep(prim, name, self._value, kind)
            else:
                self._skip()
                _keep(prim, name, lambda: None)
        if self._after_space() == b"(":
            noted = UsdPrim("", name)
            self._metadata(noted)
            if is_wanted(name) and (space := noted.text("colorSpace")):
                prim.metadata["colorSpace"] = space

    def _metadata(self, prim: UsdPrim) -> None:
        self._expect(b"(")
        while self._after_space() != b")":
            if self._peek() in (b'"', b"'"):
                self._string()
                continue
            name = self._word().decode(errors="replace")
            if self._after_space() != b"=":  # prepend, append, delete in front of a name
                continue
            self._expect(b"=")
            if name == API_SCHEMAS:
                begin = self.at
                self._skip()
                prim.metadata[name] = bytes(self.buffer[begin : self.at]).decode(errors="replace")
            elif name not in METADATA:
                self._skip()
            elif (value := self._value("")) is not None:
                prim.metadata[name] = value
        self._expect(b")")

    def _value(self, kind: str) -> Value | None:
        """Read text or numbers; step over anything else."""
        start = self._after_space()
        if start in (b'"', b"'"):
            return self._string()
        if start in (b"[", b"("):
            # Read an array or tuple of numbers; of anything else (text, arrays in arrays) return None
            begin, end = self.at, _END_OF_ARRAY.search(self.buffer, self.at)
            if self._peek() == b"[" and end and not _NO_NUMBERS.search(self.buffer[begin + 1 : end.start()]):
                self.at = end.end()
            else:
                self._skip()
            text = self.buffer[begin + 1 : self.at - 1]
            return None if _NO_NUMBERS.search(text) else _numbers_in(text, _dtype_of(kind))
        word = _SCALAR.match(self.buffer, self.at)
        if word is None:
            self._skip()
            return None
        self.at = word.end()
        return _scalar(bytes(word[0]))

    def _skip(self) -> None:
        """Step over a value: a word, text, or brackets with all in them."""
        closing: list[bytes] = []
        while True:
            start = self._after_space()
            if start in (b'"', b"'"):
                self._string()
            elif start == b"@":
                if self._matched(_ASSET, "a path between @")[0] == b"@@@":
                    end = _END_OF_ASSET.search(self.buffer, self.at)
                    self.at = end.end() if end else len(self.buffer)
                if not closing and self._after_space() == b"<":
                    continue
            elif start == b"<":
                self._matched(_PATH, "the end of a path")
            elif start and start in _OPEN:
                closing.append(_CLOSE[start])
                self.at += 1
                if len(closing) > MAX_NESTING:
                    self._fail(f"brackets in brackets up to {MAX_NESTING} deep")
            elif closing and start == closing[-1]:
                closing.pop()
                self.at += 1
            elif closing:
                self.at += start != b""
                following = _BRACKETS.search(self.buffer, self.at)
                if start in (b")", b"]", b"}") or following is None:
                    self._fail(f"'{closing[-1].decode()}'")
                self.at = following.start()
                self._space()
                if following[0] in b"#/" and self.at == following.start():
                    self.at += 1
            else:
                self._matched(_SCALAR, "a value")
            if not closing:
                return

    def _string(self) -> str:
        self._space()
        quotes = bytes(self._matched(_QUOTES, "text in quotes")[0])
        begin, raw = self.at, None
        for match in _ENDS[quotes].finditer(self.buffer, begin):
            if match[0] == quotes:
                raw, self.at = bytes(self.buffer[begin : match.start()]), match.end()
            if match[0][:1] != b"\\":
                break
        if raw is None:
            self._fail("text in quotes that ends")
        try:
            return _ESCAPE.sub(_unescaped, raw).decode() if b"\\" in raw else raw.decode()
        except UnicodeDecodeError:
            self._fail("text in UTF-8")

    def _word(self) -> bytes:
        self._space()
        return bytes(self._matched(_WORD, "a word")[0])

    def _matched(self, pattern: re.Pattern[bytes], what: str) -> re.Match[bytes]:
        match = pattern.match(self.buffer, self.at)
        if match is None:
            self._fail(what)
        self.at = match.end()
        return match

    def _space(self) -> None:
        match = _SPACE.match(self.buffer, self.at)
        self.at = match.end() if match else self.at

    def _peek(self) -> bytes:
        return bytes(self.buffer[self.at : self.at + 1])

    def _after_space(self) -> bytes:
        self._space()
        return self._peek()

    def _takes(self, what: bytes) -> bool:
        if self._peek() != what:
            return False
        self.at += 1
        return True

    def _expect(self, what: bytes) -> None:
        self._space()
        if not self._takes(what):
            self._fail(f"'{what.decode()}'")

    def _fail(self, expected: str) -> NoReturn:
        there = ascii(bytes(self.buffer[self.at : self.at + 24]))[1:]
        raise FormatError(f"USD text, byte {self.at:,}: expected {expected}, got {there}")


def _keep(prim: UsdPrim, name: str, value_of: Callable[..., Value | None], *arguments: object) -> None:
    """Set an attribute that is wanted; "" where there is one of that name, with another kind of value."""
    value = value_of(*arguments) if is_wanted(name) else None
    if value is not None:
        prim.attributes[name] = value
    elif name.removesuffix(TIME_SAMPLES) in ATTRIBUTES:
        prim.attributes[name] = ""


def _simple_value(kind: str, raw: bytes) -> Value | None:
    """Return the value that `_SIMPLE` matched."""
    if raw.startswith(b'"'):
        try:
            return raw[1:-1].decode()
        except UnicodeDecodeError:
            raise FormatError("USD text: expected text in UTF-8") from None
    if raw.startswith((b"(", b"[")):
        return None if raw.startswith(b'["') else _numbers_in(memoryview(raw)[1:-1], _dtype_of(kind))
    return _scalar(raw)


def _scalar(raw: bytes) -> Value | None:
    """Return a number or a truth; None for None and for words."""
    try:
        return np.array([float({b"true": b"1", b"false": b"0"}.get(raw, raw))])
    except ValueError:
        return None


def _unescaped(match: re.Match[bytes]) -> bytes:
    code = match[1]
    if code[:1] == b"x" and len(code) > 1:
        return bytes([int(code[1:], 16)])
    return bytes([int(code, 8) & 255]) if code[:1].isdigit() and code < b"8" else _CONTROLS.get(code, code)


def _dtype_of(kind: str) -> type:
    """Return float32 for the types that are no wider, float64 for doubles and whole numbers."""
    return np.float32 if kind.startswith(_NARROW) else np.float64


@np.errstate(over="ignore")
def _numbers_in(text: memoryview, dtype: type) -> Array:
    """Return the numbers of a list or of tuples in a list, flat, a piece of the text at a time.

    Raises: FormatError: something else than numbers with commas between them.
    """
    parts: list[Array] = [np.empty(0, dtype)]
    commas = begin = 0
    while begin < len(text):
        piece = bytes(text[begin : begin + CHUNK_BYTES])
        if begin + len(piece) < len(text):
            piece = piece[: piece.rfind(b",") + 1]
            if not piece:
                raise FormatError("USD text: expected numbers with commas between them")
        begin += len(piece)
        commas += piece.count(b",")
        parts.append(_parsed(piece.translate(_TO_SPACES)).astype(dtype))
    numbers: Array = np.concatenate(parts)
    if commas not in (max(len(numbers) - 1, 0), len(numbers)):
        raise FormatError(f"USD text: expected a comma after each number, got {commas:,} after {len(numbers):,}")
    return numbers


def _parsed(text: bytes) -> Array:
    try:
        if len(text) < MIN_NUMPY_BYTES:  # most of them: a box's
            return np.array([float(number) for number in text.split()])
        with warnings.catch_warnings():
            warnings.simplefilter("error", DeprecationWarning)
            return np.asarray(np.fromstring(text, np.float64, sep=" "))
    except (DeprecationWarning, ValueError):
        raise FormatError(f"USD text: expected numbers, got {ascii(text.strip()[:40])[1:]}") from None
