"""Which materials of a library are meant: ``error<0.05 tag:wood``, the same here and on the library's page.

``where.js`` is the twin of this file; it gets :data:`FIELDS` from here. A test runs both on the same rows.
"""

from __future__ import annotations

import math
import operator
import re
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass
from typing import Literal, NoReturn

from ...errors import ConfigError

Test = Callable[[Mapping], bool]

STATES = ("done", "failed", "running", "pending")
# where a word without a field is looked for, beside the tags
SEARCHED = ("name", "source", "method", "host", "reason")


@dataclass(frozen=True)
class Field:
    """What can be asked of a material.

    ``number`` and ``date`` are compared (a date to the day where a day is given), ``choice`` is one of some
    words, or several (``tag:wood,stone``: either), ``text`` contains what follows ``:`` or is what follows
    ``=``, of several words one.
    """

    kind: Literal["number", "date", "choice", "text"]
    says: str
    example: str


FIELDS = {
    "error": Field("number", "error on the photos seen", "error<0.05"),
    "left_out_error": Field("number", "error on photos left out", "left_out_error>0.1"),
    "burn_in": Field("number", "highlight burnt into roughness or specular", "burn_in>0.1"),
    "warnings": Field("number", "count of warnings", "warnings>0"),
    "seconds": Field("number", "time of the fit", "seconds>60"),
    "memory": Field("number", "most memory, GiB", "memory>1.5"),
    "attempts": Field("number", "how often it was begun", "attempts>1"),
    "resolution": Field("number", "pixels a side", "resolution:256"),
    "photos": Field("number", "count of photos", "photos>=9"),
    "date": Field("date", "when it ended, UTC", "date>2026-11-01"),
    "state": Field("choice", "done, failed, running or pending", "state:failed"),
    "tag": Field("choice", "one of its tags", "tag:wood,stone"),
    "method": Field("choice", "how it was fitted", "method:gan"),
    "name": Field("text", "name of the material", 'name:"old oak"'),
    "source": Field("text", "where its photos lay", "source:phone"),
    "host": Field("text", "machine that fitted it", "host=node-1"),
    "worker": Field("text", "worker that fitted it", "worker=w1"),
    "options": Field("text", "options of the fit", "options:budget"),
    "reason": Field("text", "why it failed", "reason:memory"),
    "id": Field("text", "first digits of its identity", "id:1a2b"),
}

_SPACE = r" \t\n\r\f\v\u00a0"
_TERM = re.compile(rf'(?:"(?:[^"]|"")*"|[^{_SPACE}"])+')
_PART = re.compile(r'(?:"(?:[^"]|"")*"|[^,"])+')
_QUOTED = re.compile(r'"((?:[^"]|"")*)"')
_COMPARISON = re.compile(r"([A-Za-z_]+)(<=|>=|[<>=:])([\s\S]*)")
_NUMBER = re.compile(r"[+-]?([0-9]+\.?[0-9]*|\.[0-9]+)([eE][+-]?[0-9]+)?")
_DATE = re.compile(r"[0-9]{4}(-[0-9]{2}(-[0-9]{2}(T[0-9]{2}(:[0-9]{2}(:[0-9]{2})?)?)?)?)?")
_COMPARE: dict[str, Callable[..., bool]] = {
    "<": operator.lt, "<=": operator.le, ">": operator.gt, ">=": operator.ge, "=": operator.eq,
    ":": operator.eq}


def matcher(text: str) -> Test:
    """A test whether a row of ``library.json`` is meant.

    Args:
        text: terms with spaces between them, all of which must hold; empty: every row. A term compares a
            field (:data:`FIELDS`), or is a word that the name, a tag, the source, the method, the host or the
            reason contains. Upper and lower case are the same, and so are a space and ``_``, which names have
            in its place. Double quotes hold a value with spaces or commas together: ``tag:"old wood"``. A
            missing number or date fulfils no comparison.

    Raises:
        ConfigError: what cannot be understood.
    """
    if text.count('"') % 2:
        _refuse('a " at the end too', text, 'quote as in tag:"old wood"')
    tests = [_test(term) for term in _TERM.findall(text)]
    return lambda row: all(test(row) for test in tests)


def number_of(row: Mapping, field: str) -> float | None:
    """The value of a number field of a row; None where it is missing or not finite."""
    if field == "warnings":
        return len(row.get("warnings") or ())
    value = row.get("peak_bytes" if field == "memory" else field)
    if value is None or not math.isfinite(value):
        return None
    return value / 2**30 if field == "memory" else value


def described() -> dict[str, dict]:
    """:data:`FIELDS` for the page."""
    return {name: asdict(field) for name, field in FIELDS.items()}


def _test(term: str) -> Test:
    found = _COMPARISON.fullmatch(term)
    if found is None:
        word = _folded(_unquoted(term))
        return lambda row: word in _searched(row)
    field, compare, value = found[1].lower(), found[2], found[3]
    if field not in FIELDS:
        _refuse("one of " + ", ".join(FIELDS), field,
                f'{_nearest(field)} is the nearest; write "{term}" in quotes to search for it as text')
    kind, example = FIELDS[field].kind, FIELDS[field].example
    if kind in ("choice", "text") and compare not in ":=":
        _refuse(f"{field}: or {field}=", field + compare, f"write as in {example}")
    if not _unquoted(value):
        _refuse(f"a value after {field}{compare}", "none", f"write as in {example}")
    if kind == "number":
        return _number_test(field, compare, _unquoted(value), example)
    if kind == "date":
        return _date_test(compare, _unquoted(value), example)
    words = {word for part in _PART.findall(value) if (word := _folded(_unquoted(part)))}
    return _choice_test(field, words) if kind == "choice" else _text_test(field, compare, words)


def _nearest(word: str) -> str:
    """The field that the fewest changes of a letter make of a word; of several the first."""
    def changes(field: str) -> int:
        # Levenshtein's distance of what has been read of the word to each beginning
        row = list(range(len(field) + 1))
        for number, letter in enumerate(word, 1):
            diagonal, row[0] = row[0], number
            for k, other in enumerate(field, 1):
                diagonal, row[k] = row[k], min(row[k] + 1, row[k - 1] + 1, diagonal + (letter != other))
        return row[-1]

    return min(FIELDS, key=changes)


def _number_test(field: str, compare: str, value: str, example: str) -> Test:
    if not _NUMBER.fullmatch(value):
        _refuse(f"a number after {field}{compare}", value, f"write as in {example}")
    limit, holds = float(value), _COMPARE[compare]
    return lambda row: (number := number_of(row, field)) is not None and holds(number, limit)


def _date_test(compare: str, value: str, example: str) -> Test:
    if not _DATE.fullmatch(value):
        _refuse(f"a date after date{compare}", value, f"write as in {example}")
    holds = _COMPARE[compare]
    return lambda row: bool(row.get("date")) and holds(row["date"][:len(value)], value)


def _choice_test(field: str, words: set[str]) -> Test:
    if field == "state" and (unknown := sorted(words - set(STATES))):
        _refuse("done, failed, running or pending", unknown[0], "write as in state:failed")
    if field == "tag":
        return lambda row: any(_folded(tag) in words for tag in row.get("tags") or ())
    return lambda row: _text(row, field) in words


def _text_test(field: str, compare: str, words: set[str]) -> Test:
    if compare == "=":
        return lambda row: _text(row, field) in words
    return lambda row: any(word in _text(row, field) for word in words)


def _unquoted(text: str) -> str:
    return _QUOTED.sub(lambda found: found[1].replace('""', '"'), text)


def _folded(text: str) -> str:
    return text.lower().replace("_", " ")


def _text(row: Mapping, field: str) -> str:
    return _folded(row.get(field) or "")


def _searched(row: Mapping) -> str:
    return _folded("\n".join([*(row.get(name) or "" for name in SEARCHED), *(row.get("tags") or ())]))


def _refuse(expected: str, got: str, fix: str) -> NoReturn:
    raise ConfigError(expected, got, fix)
