"""Times and rates as manifests take them."""

from __future__ import annotations

from photocurrent._errors import UsageError

#: A time: a text with a unit, such as `"5 ms"`, or a number of microseconds.
Time = str | float

#: A rate: a text with a unit, such as `"10 kHz"`, or a number of hertz.
Rate = str | float

_NS = {"ns": 1, "us": 1_000, "ms": 1_000_000, "s": 1_000_000_000}


def time(value: Time) -> str:
    """A time as a manifest takes it."""
    return value if isinstance(value, str) else f"{round(float(value) * 1000)} ns"


def rate(value: Rate) -> str:
    """A rate as a manifest takes it."""
    return value if isinstance(value, str) else f"{float(value)!r} Hz"


def ns(value: Time) -> int:
    """A time in nanoseconds."""
    if not isinstance(value, str):
        return round(float(value) * 1000)
    text = value.strip()
    unit = next((unit for unit in ("ns", "us", "ms", "s") if text.endswith(unit)), None)
    try:
        if unit is None:
            raise ValueError
        return round(float(text[: -len(unit)]) * _NS[unit])
    except ValueError:
        raise UsageError(
            f"error: `{value}` is no time\n  hint: such as \"5 ms\", or a number of microseconds"
        ) from None
