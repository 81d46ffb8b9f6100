"""Fields on disk: what a file holds is compared with its checksums when it is first used.

Comparing all at once would cost several times what loading costs, and most of it is often not used: see
docs/formats.md, Checksums.
"""

from collections.abc import Callable, Mapping

from .language_field import CODES, CONTRAST, EVIDENCE, GROWTH, NEGATIVES, OBJECTS, LanguageField


def _guarded(name: str, file: str) -> property:
    def value(self: "StoredField") -> object:
        self._compare(file)
        return self.__dict__[name]

    def keep(self: "StoredField", value: object) -> None:
        self.__dict__[name] = value

    return property(value, keep)


class StoredField(LanguageField):
    """A field whose arrays are maps of files. Made by `load_field`.

    Attributes raise a FormatError where their file is damaged.
    """

    gaussian_ids = _guarded("gaussian_ids", CODES)  # type: ignore[assignment]
    code = _guarded("code", CODES)  # type: ignore[assignment]
    evidence = _guarded("evidence", EVIDENCE)  # type: ignore[assignment]
    negatives = _guarded("negatives", NEGATIVES)  # type: ignore[assignment]
    contrast = _guarded("contrast", CONTRAST)  # type: ignore[assignment]
    objects = _guarded("objects", OBJECTS)  # type: ignore[assignment]  # read as a whole when first used
    growth = _guarded("growth", GROWTH)  # type: ignore[assignment]  # so is this

    def compared_by(self, checks: Mapping[str, Callable[["StoredField"], None]]) -> "StoredField":
        """Return this field with checks to run once, before a file's arrays are used."""
        self.__dict__["_checks"] = dict(checks)
        return self

    def verify(self) -> None:
        """See LanguageField."""
        for file in tuple(self.__dict__.get("_checks", ())):
            self._compare(file)

    def _compare(self, file: str) -> None:
        checks = self.__dict__.get("_checks", {})
        if file in checks:
            checks[file](self)
            checks.pop(file, None)
