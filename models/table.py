"""What every table of a user's file has in common once pydantic has read it."""

from __future__ import annotations

from typing import Annotated, Any

from pydantic import BaseModel, ConfigDict, Field, GetCoreSchemaHandler
from pydantic_core import CoreSchema

ShortName = Annotated[str, Field(max_length=64)]
Title = Annotated[str, Field(max_length=200)]


def _make_strict(schema: Any) -> None:
    if isinstance(schema, dict):
        if schema.get("type") in ("float", "int"):
            schema["strict"] = True
        for part in schema.values():
            _make_strict(part)
    elif isinstance(schema, list | tuple):
        for part in schema:
            _make_strict(part)


class Table(BaseModel):
    """A table of a document: frozen, unknown keys refused, numbers finite, never made of words."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False, defer_build=True)

    @classmethod
    def __get_pydantic_core_schema__(cls, source: Any, handler: GetCoreSchemaHandler) -> CoreSchema:
        """Make every number of the model strict: `true` is no 1, "20" is no 20, 3.0 is no count."""
        schema = handler(source)
        _make_strict(schema)
        return schema
