"""What a page sends with an action, held against what the action declares before it is called."""

from __future__ import annotations

from collections.abc import Callable
from typing import Annotated, Any, Final

from pydantic import ConfigDict, Field, ValidationError, validate_call

from ronnaplan.errors import UsageError
from ronnaplan.untrusted import first_fault

LONGEST_TEXT: Final = 10_000
"""Characters of a name or of notes."""

MOST_PIXELS: Final = 1e5
"""No screen is larger."""

MOST_STEPS: Final = 1000.0
"""No wheel turns further at once."""

STRICT: Final = ConfigDict(strict=True, str_max_length=LONGEST_TEXT, allow_inf_nan=False, defer_build=True)

Pixels = Annotated[float, Field(ge=-MOST_PIXELS, le=MOST_PIXELS)]
"""A place or a length in a view."""

Steps = Annotated[float, Field(ge=-MOST_STEPS, le=MOST_STEPS)]
"""How far a wheel was turned."""

Strength = Annotated[float, Field(ge=0.05, le=20.0)]
"""How dense a whole scan is drawn."""

Share = Annotated[float, Field(ge=0.0, le=1.0)]
"""A part of a whole."""

Index = Annotated[int, Field(ge=0)]
"""A place in a list."""

Typed = float | str
"""What stands in a field for a number."""


def checked(name: str, action: Callable[..., Any]) -> Callable[..., Any]:
    """Return ``action`` so that it raises `UsageError` for arguments of another number or kind than it declares."""
    validated = validate_call(config=STRICT)(action)

    def call(*arguments: Any) -> Any:
        longest = max((len(one) for one in arguments if isinstance(one, str)), default=0)
        if longest > LONGEST_TEXT:  # pasted into a field: no fault of the page
            raise UsageError(f"a text of {longest} characters is not taken; enter {LONGEST_TEXT} at most")
        try:
            return validated(*arguments)
        except ValidationError as error:
            raise UsageError(f"the page asked for '{name}' wrongly ({first_fault(error)}); reload it") from error

    return call
