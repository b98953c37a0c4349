"""How bodies of the API's own types are written."""

import json

import schemathesis


@schemathesis.serializer("application/x-ndjson")
def lines(_context, value):
    """A stream of one line."""
    return json.dumps(value).encode() + b"\n"

