"""YAML files to strict models, every problem at once with file:line:column; for any kind of file."""

from __future__ import annotations

import re
import types
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from functools import lru_cache
from pathlib import Path
from stat import S_ISDIR, S_ISREG
from typing import Annotated, Any, TypeVar, Union, get_args, get_origin

from pydantic import BaseModel, ConfigDict, ValidationError
from ruamel.yaml import YAML
from ruamel.yaml.error import MarkedYAMLError, YAMLError
from ruamel.yaml.nodes import MappingNode, Node, ScalarNode, SequenceNode

from pmabench.base.errors import InvalidFile, Problem, did_you_mean, invalid, reading
from pmabench.base.quantities import MUSCLES, without_number

MAX_BYTES = 1_000_000
MAX_NODES = 100_000
MAX_DEPTH = 40
OFTEN = 50_000
"""Texts of up to this length are cached: calibrations and benches are read several times."""

MISTAKES = {
    "mapping values are not allowed": "is the line indented further than the one above? A text that holds ': ' "
    "needs quotes",
    "found character '\\t'": "a tab; YAML is indented with spaces",
    "found character": "a value that begins with this sign needs quotes",
    "could not find expected ':'": "a key without ':', or a line that is indented less than the text it belongs to",
    "expected <block end>": "the line is indented neither like the one above nor like a line further up",
    "expected ',' or": "a list or map in brackets lacks a comma or its closing bracket",
    "did not find expected": "a list or map in brackets lacks a comma or its closing bracket",
    "expected the node content": "a bracket is not closed, or a value is missing",
    "found unexpected end of stream": "a quote is not closed",
    "found undefined alias": "'*' begins a reference in YAML; a text that begins with it needs quotes",
}
"""How the YAML library's sentence begins -> what to look for in the line."""

VALUES = {
    "int": "a whole number",
    "float": "a number",
    "bool": "true or false",
    "string": "a text (in quotes)",
    "date": "a day, for instance 2026-11-23",
    "datetime": "a day with a time, for instance 2026-11-23 14:05:00",
}
"""What the schema library calls a value -> what is expected."""

_TAGS = {"str", "int", "float", "bool", "null", "seq", "map", "timestamp", "merge", "value"}

Location = tuple[str | int, ...]
Model = TypeVar("Model", bound="Strict")


class Strict(BaseModel):
    """A model that refuses unknown keys."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False, strict=False, populate_by_name=True)


Place = tuple[str, int, int]


@lru_cache(maxsize=64)
def _composed(text: str) -> Node | None:
    """The nodes of a text; they must not be changed."""
    yaml = YAML(typ="safe", pure=True)
    yaml.allow_duplicate_keys = False
    node: Node | None = yaml.compose(text)
    return node


class Document:
    """A YAML file: its plain data, the place of each value, and the texts that it was made of.

    With a top-level `include: other.yaml` the other file is read first; keys in this file replace equal ones.
    """

    def __init__(self, path: str, text: str) -> None:
        self.path = path
        self.texts: dict[str, str] = {path: text}
        self._places: dict[Location, tuple[Place, Place]] = {}
        """Places of each value and of its key; twice the value's if it has no key."""
        self.data = self._read(text)

    def place(self, location: Location, *, key: bool = False) -> Place:
        """Path, line and column (from 1) of the value or its key; of the nearest parent if it is missing."""
        for end in range(len(location), -1, -1):
            if found := self._places.get(location[:end]):
                return found[1 if key else 0]
        return (self.path, 1, 1)

    def problem(self, location: Location, message: str, *, key: bool = False) -> Problem:
        """A `Problem` at a value of this file."""
        return Problem(*self.place(location, key=key), message)

    def where(self, location: Location) -> str:
        """`path:line:column` of a value."""
        return ":".join(str(part) for part in self.place(location))

    def include(self, other: Document) -> None:
        """Take the other document as defaults for this one."""
        own = self.data
        own.pop("include", None)
        self.texts = {**self.texts, **other.texts}
        places, self._places = self._places, dict(other._places)
        self.data = other.data
        self._overlay(own, (), places)

    def override(self, name: str, text: str) -> None:
        """Set the value `text` (YAML) at the dotted `name`, as `--set name=value` does."""
        location: Location = tuple(
            int(part) if part.isascii() and part.isdecimal() else part for part in name.split(".")
        )
        self.put(location, text, f"--set {name}")

    def put(self, location: Location, text: str, source: str) -> None:
        """Set the value `text` (YAML) at a location; `source` names the origin of the value."""
        value = Document(source, f"value: {text}")
        target: Any = self.data
        for part in location[:-1]:
            if not ((isinstance(target, dict) and part in target) or _is_place(target, part)):
                known = map(str, target) if isinstance(target, dict) else ()
                raise invalid(source, f'there is no "{part}" in {self.path}{did_you_mean(str(part), known)}')
            target = target[part]
        if not isinstance(target, (dict, list)):
            raise invalid(source, f"there is nothing to set in {self.path}")
        self._forget(location)
        if isinstance(target, list) and not _is_place(target, location[-1]):
            raise invalid(source, f"the list in {self.path} has no place {location[-1]}")
        target[location[-1]] = value.data["value"]  # type: ignore[index]
        if source != self.path:
            self.texts[source] = text
        for inner, (place, _) in value._places.items():
            if inner:
                self._places[*location, *inner[1:]] = (place, place)

    def _overlay(self, own: dict[str, Any], at: Location, places: dict[Location, tuple[Place, Place]]) -> None:
        target: Any = self.data
        for part in at:
            target = target[part]
        for key, value in own.items():
            location = (*at, key)
            if isinstance(value, dict) and isinstance(target.get(key), dict):
                self._overlay(value, location, places)
                continue
            self._forget(location)
            target[key] = value
            self._places |= {loc: both for loc, both in places.items() if loc[: len(location)] == location}

    def _forget(self, location: Location) -> None:
        self._places = {loc: both for loc, both in self._places.items() if loc[: len(location)] != location}

    def _read(self, text: str) -> dict[str, Any]:
        try:
            node = _composed(text) if len(text) <= OFTEN else _composed.__wrapped__(text)
        except MarkedYAMLError as error:
            mark = error.problem_mark or error.context_mark
            line, column = (mark.line + 1, mark.column + 1) if mark else (0, 0)
            message = " ".join(str(error.problem or error.context or "not YAML").split())
            message = next((words for begin, words in MISTAKES.items() if message.startswith(begin)), message)
            raise invalid(self.path, f"not readable as YAML: {message}", line, column) from error
        except (YAMLError, ValueError, RecursionError) as error:
            raise invalid(self.path, f"not readable as YAML: {' '.join(str(error).split())[:200]}") from error
        if not isinstance(node, MappingNode):
            raise invalid(self.path, "a file of keys and values is expected, and this holds none", 1, 1)
        self._budget = MAX_NODES
        return dict(self._plain(node, ()))

    def _plain(self, node: Node, location: Location, key_place: Place | None = None) -> Any:
        self._budget -= 1
        at = (node.start_mark.line + 1, node.start_mark.column + 1)
        self._places[location] = ((self.path, *at), key_place or (self.path, *at))
        if self._budget < 0 or len(location) > MAX_DEPTH:
            raise invalid(self.path, "the file is too large or too deep", *at)
        if node.tag and node.tag.removeprefix("tag:yaml.org,2002:") not in _TAGS:
            raise invalid(self.path, f"tags are not allowed: {node.tag}", *at)
        if isinstance(node, ScalarNode):
            return _scalar(node)
        if isinstance(node, SequenceNode):
            return [self._plain(item, (*location, index)) for index, item in enumerate(node.value)]
        data: dict[str, Any] = {}
        for key_node, value_node in node.value:
            key = str(key_node.value)
            at = (key_node.start_mark.line + 1, key_node.start_mark.column + 1)
            if not isinstance(key_node, ScalarNode) or key == "<<":
                raise invalid(self.path, "a key must be a plain name", *at)
            if key in data:
                raise invalid(self.path, f'key "{key}" is given twice', *at)
            data[key] = self._plain(value_node, (*location, key), (self.path, *at))
        return data


def _is_place(data: Any, part: str | int) -> bool:
    """Whether `part` is the number of an item of a list."""
    return isinstance(data, list) and isinstance(part, int) and part < len(data)


_WORDS: dict[str, bool | None] = {
    **dict.fromkeys(("", "~", "null", "Null", "NULL")),
    **dict.fromkeys(("true", "True", "TRUE"), True),
    **dict.fromkeys(("false", "False", "FALSE"), False),
}


def _scalar(node: ScalarNode) -> str | int | float | bool | None:
    text = str(node.value)
    if node.style in {"'", '"', "|", ">"}:
        return text
    if text in _WORDS:
        return _WORDS[text]
    for kind in (int, float) if text[0] in "+-.0123456789" and "_" not in text else ():
        with suppress(ValueError):
            return kind(text)
    return text


def read_document(path: Path, depth: int = 0) -> Document:
    """Read a YAML file and its includes; raises `InvalidFile` with a one-sentence reason."""
    name = _shown(path)
    with reading(name):
        found = path.stat()
        if not S_ISREG(found.st_mode):
            kind = "a folder" if S_ISDIR(found.st_mode) else "no file (a device or a pipe)"
            raise invalid(name, f"is {kind}; a YAML file is expected")
        if found.st_size > MAX_BYTES:
            raise invalid(name, f"larger than {MAX_BYTES} bytes: not a file that people write")
        raw = path.read_bytes()
    try:
        text = raw.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise invalid(name, f"is not text in UTF-8 (byte {error.start})") from error
    if not text.strip():
        raise invalid(name, "is empty")
    document = Document(name, text)
    other = document.data.get("include")
    if other is not None:
        if not isinstance(other, str) or depth > 3 or Path(other).is_absolute():
            problem = "includes one other file by a relative path, at most three deep"
            raise InvalidFile([document.problem(("include",), problem)])
        document.include(read_document(path.parent / other, depth + 1))
    return document


def _shown(path: Path) -> str:
    """The path relative to the current folder, if it is inside."""
    with suppress(ValueError, OSError):
        return str(path.resolve().relative_to(Path.cwd()))
    return str(path)


_SCHEMA = re.compile(r"pmabench\.([a-z-]{1,40})/([0-9]{1,4})")


def _schema_of(model: type[BaseModel]) -> str:
    """Required value of the key `schema` in files of a model; empty if they have none."""
    field = model.model_fields.get("schema_")
    return str(get_args(field.annotation)[0]) if field is not None and get_args(field.annotation) else ""


def check_schema(model: type[BaseModel], document: Document) -> None:
    """Raise `InvalidFile` with this problem alone if the document is of another kind than the model."""
    written, expected = document.data.get("schema"), _schema_of(model)
    found, wanted = _SCHEMA.fullmatch(str(written)), _SCHEMA.fullmatch(expected)
    if found is None or wanted is None or found[0] == wanted[0]:
        return
    message = f"is a {found[1]} file ({written}) where a {wanted[1]} file is expected ({expected}); give another file"
    if found[1] == wanted[1]:
        message = f"is written in version {found[2]} of the {wanted[1]} file; this pmabench reads version {wanted[2]}"
    raise InvalidFile([document.problem(("schema",), message)])


def validate(model: type[Model], document: Document) -> Model:
    """The model of a document; raises `InvalidFile` with every problem."""
    check_schema(model, document)
    try:
        return model.model_validate(document.data)
    except ValidationError as error:
        problems = _problems(model, document, error)
    if "schema" not in document.data and (expected := _schema_of(model)):
        # what else is missing counts only once it is clear which kind of file it should be
        problems = [problem for problem in problems if not problem.message.endswith("is missing")]
        head = f'"schema" is missing, which says what kind of file it is: "schema: {expected}"'
        problems.append(document.problem(("schema",), head))
    raise InvalidFile(problems)


def _problems(model: type[BaseModel], document: Document, error: ValidationError) -> list[Problem]:
    """Each mistake once, at its value; at its key if that is unknown."""
    found: dict[tuple[Location, str], bool] = {}
    for item in error.errors(include_url=False):
        location = _in_data(document.data, item["loc"])
        found.setdefault((location, _sentence(model, item, location)), item["type"] == "extra_forbidden")
    return [document.problem(location, message, key=on_key) for (location, message), on_key in found.items()]


def _in_data(data: Any, location: Location) -> Location:
    """The location without pydantic's tags of unions, which are not in the file."""
    found: list[str | int] = []
    for index, part in enumerate(location):
        if isinstance(data, Mapping) and isinstance(part, str):
            if part in data:
                data = data[part]
            elif index < len(location) - 1:
                continue
            found.append(part)
        elif _is_place(data, part):
            data = data[part]
            found.append(part)
    return tuple(found)


def _sentence(model: type[BaseModel], item: Any, found: Location) -> str:
    """What is wrong; `found`: the location without the tags of unions."""
    kind, location, value = item["type"], item["loc"], item.get("input")
    name = str(found[-1]) if found else ""
    context = item.get("ctx", {})
    if kind == "extra_forbidden":
        known = [key for owner in _models_at(model, location[:-1]) for key in _annotations(owner)]
        if name[:1].isdigit() and value is None:
            return f'"{name}" begins a key of its own: write a number with a point, 10.5, not with a comma'
        return f'unknown key "{name}"{did_you_mean(name, known)}'
    if kind == "missing":
        return f'"{name}" is missing'
    if kind == "value_error":
        return str(context.get("error", item["msg"]))
    if kind in {"literal_error", "enum"}:
        options = [option.strip("' ") for option in str(context["expected"]).replace(" or ", ", ").split(",")]
        return f'"{value}" is not known here{did_you_mean(str(value), options)}'
    if kind in {"union_tag_invalid", "union_tag_not_found"}:
        options = [tag.strip("' ") for tag in str(context.get("expected_tags", "")).split(",") if tag.strip()]
        wanted = str(context.get("tag", ""))
        return f'"{wanted}" is not known here{did_you_mean(wanted, options)}' if wanted else item["msg"]
    if kind in {"model_type", "model_attributes_type", "dict_type"}:
        return f'"{name}" needs its own keys and values, not "{value}"'
    if kind in {"list_type", "tuple_type"}:
        return f'"{name}" needs a list, for instance [{value}]'
    return _wrong_value(kind, value, item["msg"])


def _annotations(model: type[BaseModel]) -> dict[str, Any]:
    """Annotation of each key of a model, by its name in the file."""
    return {field.alias or name: field.annotation for name, field in model.model_fields.items()}


def _models_at(model: Any, location: tuple[str | int, ...]) -> list[type[BaseModel]]:
    """Models that are possible at a location: follows annotations, with all branches of unions."""
    here = [model]
    for part in location:
        step: list[Any] = []
        for owner in (m for item in here for m in _unwrapped(item)):
            if isinstance(owner, type) and issubclass(owner, BaseModel):
                if isinstance(part, str):
                    step.append(_annotations(owner).get(part, owner))
            elif get_args(owner):
                step.append(get_args(owner)[-1 if get_origin(owner) in {dict, Mapping} else 0])
        here = step or here
    return [m for item in here for m in _unwrapped(item) if isinstance(m, type) and issubclass(m, BaseModel)]


def _unwrapped(annotation: Any) -> list[Any]:
    origin = get_origin(annotation)
    if origin is Annotated:
        return _unwrapped(get_args(annotation)[0])
    if origin in {Union, types.UnionType}:
        return [part for arg in get_args(annotation) for part in _unwrapped(arg)]
    return [annotation]


def document_text(document: Document) -> str:
    """Text of a document, followed by the texts that it includes; independent of the folder of the files."""
    (first, *rest) = sorted(document.texts.items(), key=lambda item: item[0] != document.path)
    return first[1] + "".join(f"\n# ---- {Path(path).name} ----\n" + _commented(text) for path, text in rest)


def _commented(text: str) -> str:
    return "".join(f"# {line}\n" for line in text.splitlines())


def among(alone: Sequence[str], of_a_muscle: Sequence[str]) -> Callable[[Any], str]:
    """Validator for one of these names; those in `of_a_muscle` may have a number from 1.

    For instance `pressure`, or `pressure_2` if a bench has several muscles.
    """
    numbers = [f"_{number}" for number in range(1, MUSCLES + 1)]

    def check(value: Any) -> str:
        name, number = without_number(str(value))
        if value not in alone and not (name in of_a_muscle and number in numbers):
            raise ValueError(f'"{value}" is not known here{did_you_mean(str(value), alone)}')
        return str(value)

    return check


def schema_of(alone: Sequence[str], of_a_muscle: Sequence[str]) -> dict[str, Any]:
    """The same as a JSON schema."""
    both = "|".join(f"{name}(_[1-{MUSCLES}])?" if name in of_a_muscle else name for name in alone)
    return {"type": "string", "pattern": f"^({both})$"}


def _wrong_value(kind: str, value: object, message: str) -> str:
    """What is wrong with a value, from the library's kind of error and its sentence."""
    first, _, rest = kind.partition("_")
    if first in VALUES and (rest in {"type", "parsing"} or rest.startswith("from_")):
        return f'"{value}" is not {VALUES[first]}'
    message = message.replace("Input should be", f'"{value}" should be')
    return message[0].lower() + message[1:] if message[:1].isupper() else message
