"""Benchmarks of an earlier version, as they would be written now."""

from __future__ import annotations

from typing import Any

from .schema import OF_TASKS, SCHEMA_VERSION, USUAL_LEFT_OUT, capture_kind


def upgraded(value: Any) -> Any:
    """A benchmark of version 1, which left the same photos out of all captures, as one of this version; all
    else as it is.
    """
    if not isinstance(value, dict) or value.get("schema_version") != 1:
        return value
    settings, records, published = (value.get(part) for part in ("settings", "records", "published"))
    if not (isinstance(settings, dict) and isinstance(records, list) and isinstance(published, dict)):
        return value
    left_out = settings.get("left_out", list(USUAL_LEFT_OUT))
    return value | {
        "schema_version": SCHEMA_VERSION, "settings": {k: v for k, v in settings.items() if k != "left_out"},
        "published": {capture_kind(left_out) if kind == "capture" else kind: each
                      for kind, each in published.items()},
        "records": [r | {"left_out": left_out}
                    if isinstance(r, dict) and r.get("kind") == "capture" and r.get("suite") in OF_TASKS
                    else r for r in records]}
