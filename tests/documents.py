"""Reading the JSON document that every verb prints."""

import json
from typing import Any


def result_of(text: str) -> dict[str, Any]:
    """The document's result, its numbers without their units."""
    return _without_units(json.loads(text)["result"])


def _without_units(value: Any) -> Any:
    if isinstance(value, dict):
        if value.keys() == {"value", "unit"}:
            return value["value"]
        return {name: _without_units(item) for name, item in value.items()}
    return [_without_units(item) for item in value] if isinstance(value, list) else value
