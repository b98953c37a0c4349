"""What goes wrong, as exceptions that name the place and the value."""

from __future__ import annotations

import json
import re
from dataclasses import dataclass
from typing import Any

__all__ = [
    "Conflict",
    "Fault",
    "Forbidden",
    "InvalidInput",
    "NotFound",
    "Unavailable",
    "Union3dError",
    "from_problem",
]


@dataclass(frozen=True)
class Fault:
    """One thing that is wrong in what was given."""

    place: str
    """Where: the name of an argument, with indices, such as ``corners[17, 2]``."""
    detail: str
    """What is wrong there."""
    value: Any = None
    """What was given there; ``None`` where the place is enough."""

    def __str__(self) -> str:
        shown = "" if self.value is None else f" ({self.value})"
        return f"{self.place} {self.detail}{shown}"


class Union3dError(Exception):
    """A call was refused or failed; nothing has changed, unless its class says otherwise."""

    code: str
    """The kind of problem, such as ``id-conflict``: stable, and the same as over HTTP."""
    status: int
    """The HTTP status that goes with it."""
    detail: str
    """What happened, in words."""
    faults: list[Fault]
    """The first hundred things that are wrong in what was given, each with its place."""
    document: dict[str, Any]
    """All that is said of the problem (RFC 9457), with members such as ``oldest`` or ``newest``."""

    def __init__(self, document: dict[str, Any]) -> None:
        self.document = document
        self.code = str(document.get("type", "")).rpartition("/")[2] or "unknown"
        self.status = int(document.get("status", 0))
        self.detail = str(document.get("detail") or document.get("title") or "it failed")
        self.faults = [
            Fault(_place(fault), str(fault["detail"]), fault.get("value")) for fault in document.get("errors", [])
        ]
        super().__init__(self._message())

    def __reduce__(self) -> tuple[type[Union3dError], tuple[dict[str, Any]]]:
        return type(self), (self.document,)

    def _message(self) -> str:
        if self.code == "invalid" and self.faults:
            others = len(self.faults) - 1
            return str(self.faults[0]) + (f", and {others} other faults: see .faults" if others else "")
        return self.detail


class InvalidInput(Union3dError, ValueError):
    """An argument is wrong, or larger than what is taken at once."""


class NotFound(Union3dError, LookupError):
    """There is no such scene, or its past is not known that far."""


class Conflict(Union3dError):
    """What was asked contradicts what is there: an id at another place, other settings, another kind of scene."""


class Forbidden(Union3dError, PermissionError):
    """The server does not let this key, or no key, do that."""


class Unavailable(Union3dError):
    """It cannot be answered now: the server or the disk is away, or the answer took too long.

    Whether a change was applied is shown by ``seq`` afterwards; sending it again with the same ids is safe.
    """


def from_problem(text: str) -> Union3dError:
    """The exception of a problem document."""
    document: dict[str, Any]
    try:
        document = json.loads(text)
    except ValueError:
        document = {"detail": text[:200] or "the answer is empty", "status": 0}
    by_status: dict[int, type[Union3dError]] = {
        400: InvalidInput,
        401: Forbidden,
        403: Forbidden,
        404: NotFound,
        409: Conflict,
        410: NotFound,
        413: InvalidInput,
        415: InvalidInput,
        422: InvalidInput,
    }
    return by_status.get(int(document.get("status", 0)), Unavailable)(document)


def invalid(place: str, detail: str, value: object = None) -> InvalidInput:
    """The exception of an argument that is found to be wrong on this side."""
    pointer = {"place": place, "detail": detail, "value": value}
    return InvalidInput({"type": "/problems/invalid", "status": 422, "detail": f"{place} {detail}", "errors": [pointer]})


_AXES = {"x": 0, "y": 1, "z": 2}


def _place(fault: dict[str, Any]) -> str:
    """The place of a fault in the words of this package: ``/to_x/17`` of a message is ``end[17, 0]``."""
    if "place" in fault:
        return str(fault["place"])
    pointer = fault.get("pointer")
    if pointer is None:
        return str(fault.get("parameter", "the request"))
    if found := re.fullmatch(r"/(to_)?([xyz])/(\d+)", pointer):
        return f"{'end' if found[1] else 'start'}[{found[3]}, {_AXES[found[2]]}]"
    if found := re.fullmatch(r"/insert_id(.*)", pointer):
        pointer = "/ids" + found[1]
    if found := re.fullmatch(r"/(\w+)/(\d+)/(\d+)", pointer):
        return f"{found[1]}[{found[2]}, {found[3]}]"
    steps = [step.replace("~1", "/").replace("~0", "~") for step in pointer.split("/")[1:]]
    place = "".join(f"[{step}]" if step.isdigit() else f".{step}" for step in steps)
    return place.lstrip(".") or "the request"
