"""The ground of all result files: a frozen, typed model per JSON object.

A class states three things at once: what pamid writes (its constructor and `as_json`), what it
reads (`read`), and what `pamid schema` prints (`json_schema`).

- Written: every field that the writer sets, in the order of the class. Numbers that are not finite
  are refused where the text is made (pamid.base.json_file), with their place in the file.
- Read: keys that no field knows are ignored, so that a file of a later version still reads; null
  counts as missing; a field with a default may be missing. Text stands for text only, a number for
  a number, true and false for themselves.

`x: Number = Field(None, ...)`, with the default in the first place, is a field that a file may lack
and that a writer has to name: type checkers take only `default=` for a default.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from numbers import Integral, Real
from typing import Annotated, Any, ClassVar, Literal, TypeVar, Unpack

from pydantic import (
    BaseModel,
    BeforeValidator,
    ConfigDict,
    FailFast,
    Field,
    GetJsonSchemaHandler,
    InstanceOf,
    PlainValidator,
    ValidationError,
    ValidationInfo,
    WithJsonSchema,
    WrapValidator,
    model_validator,
)
from pydantic.json_schema import GenerateJsonSchema, JsonSchemaValue
from pydantic_core import CoreSchema, PydanticCustomError

T = TypeVar("T")
M = TypeVar("M", bound="Model")

DRAFT = "https://json-schema.org/draft/2020-12/schema"
_NULL = {"type": "null"}


class Mismatch(ValueError):
    """A JSON value that does not match its model.

    place: keys and indices down to it, "where.windows_s[0]"; expected: in words; value: what stands
    there; missing: nothing does; choices: the words that may stand there, where they are few.
    """

    def __init__(
        self, place: str, expected: str, value: object, missing: bool, choices: tuple[str, ...]
    ) -> None:
        super().__init__(f"{place} should be {expected}")
        self.place, self.expected = place, expected
        self.value, self.missing, self.choices = value, missing, choices


class _Missing:
    """Stands where a needed key is missing, so that its field states its type."""


MISSING = _Missing()


# ---- scalars -----------------------------------------------------------------------------------


def expected(what: str) -> PydanticCustomError:
    """The error of a value that should be `what`."""
    return PydanticCustomError("expected", "{what}", {"what": what})


def number(value: Any, info: ValidationInfo) -> float:
    if isinstance(value, bool) or not isinstance(value, Real):
        raise expected("a number")
    if info.context is None and isinstance(value, int):
        return value  # a setting that was given as 2 is written as 2
    try:
        return float(value)
    except OverflowError:
        raise expected("a finite number") from None


def _count(value: Any) -> int:
    if isinstance(value, bool) or not isinstance(value, Real):
        raise expected("a number")
    if isinstance(value, Integral):
        return int(value)
    if not float(value).is_integer():  # JSON has a single kind of number: 3.0 is a count, too
        raise expected("a whole number")
    return int(float(value))


def _flag(value: Any) -> bool:
    plain = value.item() if hasattr(value, "item") else value  # of NumPy
    if not isinstance(plain, bool):
        raise expected("true or false")
    return plain


Number = Annotated[float, PlainValidator(number), WithJsonSchema({"type": "number"})]
Count = Annotated[int, PlainValidator(_count), WithJsonSchema({"type": "integer"})]
# not pydantic's check: a path may hold bytes that are no UTF-8, as lone surrogates
Text = Annotated[str, InstanceOf()]
Flag = Annotated[bool, PlainValidator(_flag), WithJsonSchema({"type": "boolean"})]


# ---- containers --------------------------------------------------------------------------------


def _validated_items(value: Any, validated: Callable[[Any], Any]) -> Any:
    """Entry by entry: a file with a million wrong entries is refused at the first."""
    if not isinstance(value, dict):
        return validated(value)
    return {key: validated({key: item})[key] for key, item in value.items()}


def _two(value: Any) -> Any:
    if not isinstance(value, list | tuple) or len(value) != 2:
        raise expected("made of pairs of numbers")
    return value


def numbers_only(value: Any, info: ValidationInfo) -> Any:
    if info.context is None or not isinstance(value, dict):
        return value
    return {k: item for k, item in value.items() if item is not None and not isinstance(item, str)}


class _FailFast(FailFast):
    """A list with a million wrong entries is refused at the first."""

    def __hash__(self) -> int:  # annotations of a union are compared
        return hash(type(self))


ListOf = Annotated[tuple[T, ...], _FailFast()]
MapOf = Annotated[dict[Text, T], WrapValidator(_validated_items)]
Pair = Annotated[tuple[Number, Number], BeforeValidator(_two)]
#: of a file, texts and nulls among numbers are passed over
NumbersOnly = BeforeValidator(numbers_only)
Figures = Annotated[MapOf[Number], NumbersOnly]


class _NeverNull:
    def __get_pydantic_json_schema__(
        self, core: CoreSchema, handler: GetJsonSchemaHandler
    ) -> JsonSchemaValue:
        schema = handler(core)
        others = [option for option in schema.pop("anyOf", []) if option != _NULL]
        schema |= others[0] if len(others) == 1 else {"anyOf": others} if others else {}
        if schema.get("default", 0) is None:
            del schema["default"]
        return schema


class _MayLack:
    pass


#: in the annotation of a field that is not always written
MAY_LACK = _MayLack()


#: pamid always writes it; None if an older or partial file lacks it
Written = Annotated[T | None, _NeverNull()]
#: written only where there is something to say; None if it is missing
Sometimes = Annotated[T | None, _NeverNull(), MAY_LACK]


# ---- objects -----------------------------------------------------------------------------------


class Model(BaseModel):
    """A JSON object."""

    model_config = ConfigDict(
        frozen=True, extra="ignore", populate_by_name=True, protected_namespaces=()
    )

    #: keys that readers leave alone unless they ask for them, whatever an older version wrote there
    not_read: ClassVar[tuple[str, ...]] = ()
    #: earlier schemas of the same file -> what has changed since, as the end of a sentence
    earlier: ClassVar[dict[str, str]] = {}
    #: earlier schemas whose files still read: keys came and went, none has another meaning
    readable: ClassVar[tuple[str, ...]] = ()
    #: the command that writes it
    written_by: ClassVar[str] = ""

    def __init_subclass__(cls, *, schema: str = "", **config: Unpack[ConfigDict]) -> None:
        """schema: name and number of a file or a separate output, its key `schema`."""
        super().__init_subclass__(**config)
        if schema:
            annotations = cls.__dict__.get("__annotations__", {})
            cls.__annotations__ = {"schema_": Literal[schema], **annotations}
            cls.schema_ = Field(default=schema, alias="schema")  # type: ignore[attr-defined]

    def as_json(self) -> dict[str, Any]:
        """Plain dicts and lists of the fields that were set, in order."""
        fields = type(self).model_fields
        written = {
            field.alias or name: _plain(getattr(self, name))
            for name, field in fields.items()
            if name in self.model_fields_set or field.alias == "schema"
        }
        return written | {name: _plain(item) for name, item in (self.model_extra or {}).items()}

    @model_validator(mode="before")
    @classmethod
    def _null_is_missing(cls, data: Any, info: ValidationInfo) -> Any:
        if not isinstance(data, dict):
            return data
        known = {key for name, f in cls.model_fields.items() for key in (name, f.alias or name)}
        if info.context is None:
            if (strange := data.keys() - known) and cls.model_config["extra"] == "ignore":
                raise expected(f"written without {', '.join(sorted(strange))}")
            return data
        needed = {f.alias or name for name, f in cls.model_fields.items() if f.is_required()}
        given = {
            key: value
            for key, value in data.items()
            if (key not in cls.not_read or key in info.context["also"])
            and (value is not None or key in needed)
        }
        return dict.fromkeys(needed, MISSING) | given

    @classmethod
    def __get_pydantic_json_schema__(
        cls, core: CoreSchema, handler: GetJsonSchemaHandler
    ) -> JsonSchemaValue:
        schema = handler.resolve_ref_schema(handler(core))
        schema["required"] = [
            field.alias or name
            for name, field in cls.model_fields.items()
            if not any(part is MAY_LACK for part in field.metadata)
        ]
        for part in schema.get("properties", {}).values():
            part.pop("default", None)
        return schema


class _Untitled(GenerateJsonSchema):
    """JSON schemas without a title per key, which would only repeat it."""

    def field_title_should_be_set(self, schema: Any) -> bool:
        return False


def json_schema(kind: type[Model]) -> dict[str, Any]:
    """The JSON schema (draft 2020-12) of what is written of this kind."""
    schema = kind.model_json_schema(mode="serialization", schema_generator=_Untitled)
    if "$ref" in schema:  # a kind that holds itself
        schema = {**schema["$defs"][kind.__name__], "$defs": schema["$defs"]}
    name = schema["properties"]["schema"]["const"]
    return {"$schema": DRAFT, "$id": name, "title": schema.pop("title"), **schema}


def read(kind: type[M], content: Mapping[str, Any], *, also: tuple[str, ...] = ()) -> M:
    """The object that was read as JSON; Mismatch at the first value that is not what it should be.
    also: keys of its `not_read` that this reader needs."""
    try:
        return kind.model_validate(
            {key: value for key, value in content.items() if key != "schema"},
            context={"also": also},
        )
    except ValidationError as error:
        first = error.errors(include_url=False)[0]
    value, context = first["input"], first.get("ctx", {})
    choices: tuple[str, ...] = ()
    if first["type"] == "literal_error":
        what = str(context["expected"])
        choices = tuple(word.strip("'") for word in what.replace(" or ", ", ").split(", "))
    else:
        what = context.get("what") or _EXPECTED.get(first["type"], first["msg"])
    missing = value is MISSING
    raise Mismatch(_place(first["loc"]), what, value, missing, choices) from None


_EXPECTED = {
    "is_instance_of": "a text",
    "model_type": "an object",
    "dict_type": "an object",
    "tuple_type": "a list",
    "missing": "given",
}


def _place(keys: tuple[int | str, ...]) -> str:
    place = ""
    for key in keys:
        place += f"[{key}]" if isinstance(key, int) else f".{key}" if place else key
    return place


def _plain(value: Any) -> Any:
    if isinstance(value, Model):
        return value.as_json()
    if isinstance(value, dict):
        return {key: _plain(item) for key, item in value.items()}
    return [_plain(item) for item in value] if isinstance(value, tuple | list) else value
