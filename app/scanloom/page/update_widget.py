"""Setting a widget's properties."""

from typing import Any


def update_widget(handle: Any, **values: Any) -> None:
    """Set those properties of a widget that differ; each set property is sent to the browser."""
    for name, value in values.items():
        if getattr(handle, name) != value:
            setattr(handle, name, value)
